"""How fast it is, beside what the machine could do at most, measured in the same run.

The limit is the faster of a large matrix product and the network's own largest convolution, at each precision. Training is reported in
sequence steps a second (one step of one sequence, forward and backward) and as a share of that limit; planning in seconds from the
request to the plan. Work is measured at both precisions, first at the one that `auto` takes here, under its own name.
"""

import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
import torch
from torch import nn
from torch.utils.flop_counter import FlopCounterMode

from preimage import fast
from preimage.compute.devices import CPU, chip_of
from preimage.compute.freed_memory import keep_freed_memory
from preimage.compute.precision import Resolved, computes_bfloat16, describe_precision, instruction_set, resolve_precision
from preimage.compute.processes import ProcessGroup
from preimage.data.sequences import Sequences
from preimage.method.batches import error_of, plain_batch
from preimage.method.config import PlanConfig, TrainConfig
from preimage.method.learner import Learner, Progress, optimiser_of
from preimage.method.plan import plan
from preimage.method.train import train
from preimage.network.config import ModelConfig, Sensors
from preimage.network.pdvmrnn import PDVMRNN
from preimage.presets import Planner, PlanOptions, TrainOptions, load_planner
from preimage.records import Demonstration, Percept
from preimage.robot import TASKS, Arm, record
from preimage.storage.runs import find_run, read_settings

ARM = Sensors(64, 64, 1, ("yaw", "shoulder", "elbow", "wrist"), (-1.0,) * 4, (1.0,) * 4)
PEER = Sensors(48, 64, 1, ("pan", "tilt"), (-1.0,) * 2, (1.0,) * 2)
"""Frames and joints of P-VMDNN."""
PEER_CONFIG = ModelConfig(vision_channels=(6, 8, 8), motor_units=(16, 8, 6), top_channels=6, lateral_channels=2, seen_channels=2)
"""About P-VMDNN's 42,000 weights."""
REPEATS, AT_MOST_S = 6, 5.0
"""How often work is timed, and for how long at the most; the fastest counts, as a machine is busy with other things now and then."""
UNSEARCHED, TO_THE_END = (replace(PlanOptions.full(), **each) for each in ({"iterations": 0}, {"tolerance": 0.0}))
"""A plan that stays at its initial guess, and one that is searched for although the guess is good enough: they differ in the iterations."""
TASK, TIMED_SEED = "reach", 900
"""The bundled model whose plans and training are timed, and the seed that draws the goals."""
TIMED_UPDATES = 5
"""Updates of a training that are measured, after one that is not; the rest is extrapolated."""
SHORTER = 10
"""The paper's sequences are cut to this share where a precision is emulated, or an update would take minutes."""
START_UPS = {
    "import_s": ("-c", "import preimage"),
    "import_all_s": ("-c", "from preimage import *"),
    "help_s": ("-m", "preimage", "--help"),
}
"""What is timed in a Python process of its own."""

Measured = TypeVar("Measured")
Report = Callable[[str], None]


@dataclass(frozen=True)
class Work:
    """One amount of training work."""

    config: ModelConfig
    sensors: Sensors = ARM
    batch: int = 10
    steps: int = 16
    precision: Resolved = "bfloat16"


def bench(device: torch.device = CPU, *, quick: bool = False, report: Report = print) -> dict[str, Any]:
    """All figures, ready for JSON.

    Args:
        device: what is measured.
        quick: leave out the paper's size and the growth, and plan to fewer goals: a minute instead of five.
        report: gets a line for each figure.
    """
    keep_freed_memory()
    taken = resolve_precision("auto", device)
    other: Resolved = "float32" if taken == "bfloat16" else "bfloat16"
    result: dict[str, Any] = {"device": chip_of(device), "threads": torch.get_num_threads()}
    result |= {"instruction_set": instruction_set(device), "precision": taken}
    report(f"{result['device']}, {result['threads']} threads, {result['instruction_set']}; {describe_precision('auto', device)}")
    result["start_up"] = {name: seconds_of_start(words) for name, words in START_UPS.items()}
    report(", ".join(f"{name.removesuffix('_s')} {seconds} s" for name, seconds in result["start_up"].items()))
    limits = {name: limit_gflops(device, dtype) for name, dtype in (("fp32", torch.float32), ("bf16", torch.bfloat16))}
    result["limit_gflops"] = limits
    report(f"limit: {limits['fp32']:.0f} GFLOP/s in float32, {limits['bf16']:.0f} in bfloat16")
    if not fast.is_available():
        report("the loop is not compiled, for numba is not there: pip install 'preimage[fast]'")
    works = works_at(taken, other, device, quick=quick)
    result["train"] = {name: timed_training(work, device, limits, report, name) for name, work in works.items()}
    demonstrations = record(Arm(), TASKS[TASK], count=5 if quick else 15, seed=TIMED_SEED)
    result["whole_training"] = whole_training(demonstrations, device, taken, report)
    result["plan"] = timed_searches(demonstrations, device, taken, other, report, quick=quick)
    if not quick:
        result["growth"] = growth(device, taken, report)
    peak = peak_memory_mb(device)
    return result if peak is None else result | {"peak_memory_mb": peak}


def works_at(taken: Resolved, other: Resolved, device: torch.device, *, quick: bool) -> dict[str, Work]:
    """The training work that is timed, by name: at the precision that is taken, and at the other, which the name then says."""
    works = {"small": Work(ModelConfig.small(), precision=taken), f"small, {other}": Work(ModelConfig.small(), precision=other)}
    works["peer"] = Work(PEER_CONFIG, PEER, batch=2, steps=80, precision="float32")
    if not quick:
        works["paper"] = Work(ModelConfig.paper(), steps=60, precision=taken)
        emulated = other == "bfloat16" and not computes_bfloat16(device)
        works[f"paper, {other}"] = replace(works["paper"], steps=60 // SHORTER if emulated else 60, precision=other)
    return works


def timed_searches(
    demonstrations: list[Demonstration], device: torch.device, taken: Resolved, other: Resolved, report: Report, *, quick: bool
) -> dict[str, dict[str, Any]]:
    """Plans of the bundled model, and iterations of the paper's own search at three sizes."""
    searches = {
        "small": timed_plans(demonstrations, device, taken, report),
        f"small, {other}": timed_plans(demonstrations[: 1 if quick else 5], device, other, report),
        "small, Adam": timed_iterations(ModelConfig.small(), ARM, device, taken, steps=16),
        "peer": timed_iterations(PEER_CONFIG, PEER, device, "float32", steps=19),
    }
    if not quick:
        searches["paper"] = timed_iterations(ModelConfig.paper(), ARM, device, taken, steps=60)
    for name in ("small, Adam", "peer", "paper"):
        if name in searches:
            report(f"the paper's search, {name.removesuffix(', Adam')}: {searches[name]['ms_per_iteration']} ms an iteration of Adam")
    return searches


def seconds_of_start(words: tuple[str, ...]) -> float:
    """Seconds until a Python process of its own has done this, the faster of two."""

    def start() -> float:
        began = time.perf_counter()
        subprocess.run([sys.executable, *words], check=True, stdout=subprocess.DEVNULL)
        return time.perf_counter() - began

    return round(min(start() for _ in range(2)), 2)


def limit_gflops(device: torch.device, dtype: torch.dtype) -> float:
    """The highest rate measured: a product of matrices that are large for the device, or a 3x3 convolution of the paper's second level."""
    size = 8192 if device.type == "cuda" else 1024
    one, other = (torch.randn(size, size, device=device).to(dtype) for _ in range(2))
    maps = torch.randn(10, 160, 16, 16, device=device).to(dtype, memory_format=torch.channels_last)
    weight = torch.randn(320, 160, 3, 3, device=device).to(dtype, memory_format=torch.channels_last)
    of_product, _ = fastest(lambda: one @ other, device, repeats=15)
    of_convolution, _ = fastest(lambda: nn.functional.conv2d(maps, weight, padding=1), device, repeats=15)
    product, convolution = 2 * size**3 / of_product, 2 * weight.numel() * maps.shape[0] * 256 / of_convolution
    return round(max(product, convolution) / 1e9, 1)


def fastest(work: Callable[[], Any], device: torch.device, repeats: int = REPEATS) -> tuple[float, float]:
    """The least seconds, on the wall and of all cores together."""
    walls, cores = zip(*repeated(lambda: seconds_of(work, device), repeats), strict=True)
    return min(walls), min(cores)


def repeated(measure: Callable[[], Measured], repeats: int = REPEATS) -> list[Measured]:
    """Several measurements after one that does not count; fewer where they would take longer than `AT_MOST_S`, but at least one."""
    began = time.perf_counter()
    measure()
    if time.perf_counter() - began < AT_MOST_S / (repeats + 2):  # caches and clocks settle within two
        measure()
    began, measured = time.perf_counter(), [measure()]
    while len(measured) < repeats and (time.perf_counter() - began) * (1 + 1 / len(measured)) < AT_MOST_S:
        measured.append(measure())
    return measured


def seconds_of(work: Callable[[], Any], device: torch.device) -> tuple[float, float]:
    began, began_cores = time.perf_counter(), time.process_time()
    work()
    if device.type == "cuda":
        torch.cuda.synchronize(device)
    return time.perf_counter() - began, time.process_time() - began_cores


def flops_of_step(model: PDVMRNN) -> int:
    """Floating-point operations of one step of one sequence, forward; training takes three times as many.

    Counted are matrix products and convolutions, a multiplication and an addition as two.
    """
    start = model.home_pixels[None], model.coding.encode(model.home_joints)[None]
    with FlopCounterMode(display=False) as counter:  # of one step itself: a loop may be compiled or replayed, out of the counter's sight
        model.at(model.pixel_bias.dtype)(start, model.initial_states(model.intention_table.prior_mean(1)))
    return counter.get_total_flops()


def update_of(work: Work, device: torch.device) -> tuple[PDVMRNN, Callable[[], None]]:
    """A network, and the forward and backward of a batch as training does them; the optimiser's step is left out, as it is small."""
    model = PDVMRNN(work.config, work.sensors, work.batch).to(device)
    config = TrainConfig(precision=work.precision)
    learner = Learner(model, optimiser_of(model, config))
    sensors, shape = work.sensors, (work.batch, work.steps)
    frames = torch.full((*shape, sensors.height, sensors.width, sensors.channels), 127, dtype=torch.uint8)
    sequences = Sequences(frames, torch.zeros(*shape, sensors.num_joints), torch.full((work.batch,), work.steps), rest_steps=0)
    batch = plain_batch(torch.arange(work.batch), sequences)
    generator = torch.Generator().manual_seed(0)

    def once() -> None:
        model.zero_grad()
        intention, charge = model.intention_table.draw(batch.rows[:, 0], generator)
        (error_of(learner, intention.flatten(), batch, config).total + charge).mean().backward()

    return model, once


def timed_training(work: Work, device: torch.device, limits: dict[str, float], report: Report, name: str) -> dict[str, Any]:
    """Updates of a network, beside the limit."""
    model, once = update_of(work, device)
    seconds, cpu_seconds = fastest(once, device)
    seq_steps = work.batch * work.steps
    gflop_per_seq_step = 3 * flops_of_step(model) / 1e9
    gflops = gflop_per_seq_step * seq_steps / seconds
    limit = limits["bf16" if work.precision == "bfloat16" else "fp32"]
    timed = {
        "weights": sum(p.numel() for n, p in model.named_parameters() if not n.startswith("intention_table.")),
        "batch": work.batch,
        "steps": work.steps,
        "precision": work.precision,
        "gflop_per_seq_step": round(gflop_per_seq_step, 4),
        "seq_steps_per_s": round(seq_steps / seconds, 1),
        "seq_steps_per_cpu_s": round(seq_steps / cpu_seconds, 1),
        "gflops": round(gflops, 1),
        "fraction_of_limit": float(f"{gflops / limit:.3g}"),  # of a small network on a busy machine, three decimals would be nothing
    }
    peak = peak_memory_mb(device)
    report(f"train {name}: {timed['seq_steps_per_s']} sequence steps a second, {timed['fraction_of_limit']:.0%} of the limit")
    return timed if peak is None else timed | {"peak_memory_mb": peak}


def whole_training(demonstrations: list[Demonstration], device: torch.device, precision: Resolved, report: Report) -> dict[str, Any]:
    """Minutes of the training that made the bundled model, extrapolated from some updates of it on other demonstrations."""
    folder, seconds = find_run(TASK), []
    settings = read_settings(TrainOptions, folder, "train")
    stretch = replace(settings, updates=TIMED_UPDATES + 1, precision=precision)

    def note(done: Progress) -> None:
        seconds.append(done.seconds)

    train(demonstrations, read_settings(ModelConfig, folder, "model"), config=stretch, progress=note, group=ProcessGroup(device=device))
    an_update = float(np.median(seconds[1:]))
    minutes = round(settings.updates * an_update / 60, 1)
    report(f"a whole training of {TASK}: {minutes} minutes, extrapolated from {TIMED_UPDATES} of its {settings.updates} updates")
    timed = {"task": TASK, "precision": precision, "updates": settings.updates, "measured_updates": TIMED_UPDATES}
    return timed | {"s_per_update": round(an_update, 3), "minutes_extrapolated": minutes}


def timed_plans(demonstrations: list[Demonstration], device: torch.device, precision: Resolved, report: Report) -> dict[str, Any]:
    """Goals that a bundled model never saw: the first from nothing, then each from the request to the plan.

    A goal that is in doubt is searched for several times, so the median, the mean and the longest stand beside each other.
    """
    began = time.perf_counter()
    planner = load_planner(TASK, replace(PlanOptions.full(), precision=precision), device=device)
    first = {"start": demonstrations[0].first, "goal": Percept(demonstrations[0].last.frame)}
    planner.plan(**first)
    cold_s = time.perf_counter() - began
    plans = [planner.plan(start=one.first, goal=Percept(one.last.frame)) for one in demonstrations]
    seconds = np.array([one.seconds for one in plans])
    searches = (replace(each, precision=precision) for each in (UNSEARCHED, TO_THE_END))
    without, to_the_end = (Planner(planner.model, planner.memory, each).plan(**first) for each in searches)
    timed = {
        "precision": precision,
        "cold_s": round(cold_s, 3),
        "warm_s": round(float(np.median(seconds)), 3),
        "warm_s_mean": round(float(seconds.mean()), 3),
        "warm_s_longest": round(float(seconds.max()), 3),
        "ms_per_iteration": round(1000 * (to_the_end.seconds - without.seconds) / (len(to_the_end.errors) - 1), 1),
        "goals": len(demonstrations),
        "seed": TIMED_SEED,
    }
    said = f"{timed['warm_s']} s (median; mean {timed['warm_s_mean']} s), from nothing {timed['cold_s']} s"
    report(f"plan {TASK} in {precision}: {said}")
    return timed


def timed_iterations(
    config: ModelConfig, sensors: Sensors, device: torch.device, precision: Resolved, *, steps: int, iterations: int = 3
) -> dict[str, Any]:
    """Error regression by the gradient through time, the paper's way, of one intention over so many steps, without the plan around it."""
    search = PlanConfig(candidates=1, iterations=iterations, horizon=steps, precision=precision)
    around = seconds_of_plan(config, sensors, device, replace(search, iterations=0))
    seconds = seconds_of_plan(config, sensors, device, search) - around
    timed = {"precision": precision, "horizon": steps, "candidates": 1}
    return timed | {"ms_per_iteration": round(1000 * seconds / iterations, 2)}


def seconds_of_plan(config: ModelConfig, sensors: Sensors, device: torch.device, search: PlanConfig) -> float:
    """A plan to a frame of noise by a network that learned nothing, which takes as long as one that did."""
    model = PDVMRNN(config, sensors, 16).to(device).requires_grad_(False)
    frame = np.random.default_rng(0).integers(0, 255, (sensors.height, sensors.width, sensors.channels)).astype(np.uint8)
    return min(repeated(lambda: plan(model, goal=Percept(frame), config=search).seconds))


def growth(device: torch.device, precision: Resolved, report: Report) -> dict[str, dict[str, float]]:
    """Seconds of one iteration of a plan as horizon and candidates grow, and of a training update as batch and frames do."""
    small = ModelConfig.small()
    one_iteration = PlanConfig(iterations=1, precision=precision)

    def planning(horizon: int = 16, candidates: int = 2) -> float:
        return seconds_of_plan(small, ARM, device, replace(one_iteration, horizon=horizon, candidates=candidates))

    def training(batch: int = 10, size: int = 64) -> float:
        _, once = update_of(Work(small, replace(ARM, height=size, width=size), batch=batch, precision=precision), device)
        return fastest(once, device)[0]

    grown = {
        "horizon": {str(n): round(planning(horizon=n), 4) for n in (8, 16, 32, 64)},
        "candidates": {str(n): round(planning(candidates=n), 4) for n in (1, 2, 4, 8)},
        "batch": {str(n): round(training(batch=n), 4) for n in (5, 10, 20, 40)},
        "pixels": {str(n * n): round(training(size=n), 4) for n in (32, 64, 128)},
    }
    for name, seconds in grown.items():
        report(f"growth with {name}: {', '.join(f'{n}: {s:.2f} s' for n, s in seconds.items())}")
    return grown


def peak_memory_mb(device: torch.device) -> float | None:
    """The most memory this process, or its device, has held; None where the system does not say (Windows)."""
    if device.type == "cuda":
        return round(torch.cuda.max_memory_allocated(device) / 2**20, 1)
    if sys.platform == "win32":
        return None
    import resource

    unit = 2**20 if sys.platform == "darwin" else 2**10  # bytes there, kilobytes elsewhere (getrusage(2))
    return round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit, 1)
