"""How fast it is, beside what the machine could do at most, measured in the same run.

The limit is the faster of a large matrix product and the network's own largest convolution, at each precision. Training is told in
sequence steps a second (one step of one sequence, forward and backward) and as a share of that limit; planning in seconds from the
request to the plan.
"""

import resource
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import nn
from torch.utils.flop_counter import FlopCounterMode

from preimage import fast
from preimage.compute.devices import CPU, chip_of
from preimage.compute.freed_memory import keep_freed_memory
from preimage.data.sequences import Sequences
from preimage.method.plan import PlanConfig, imagine_library, plan
from preimage.method.train import Learner, TrainConfig, error_of, optimiser_of
from preimage.network.config import ModelConfig, Sensors
from preimage.network.pdvmrnn import PDVMRNN
from preimage.records import Percept
from preimage.robot import TASKS, Arm, record
from preimage.storage.runs import load_model

ARM = Sensors(64, 64, 1, ("yaw", "shoulder", "elbow", "wrist"), (-1.0,) * 4, (1.0,) * 4)
PEER = Sensors(48, 64, 1, ("pan", "tilt"), (-1.0,) * 2, (1.0,) * 2)
"""Frames and joints of P-VMDNN."""
PEER_CONFIG = ModelConfig(vision_channels=(6, 8, 8), motor_units=(16, 8, 6), top_channels=6, lateral_channels=2, seen_channels=2)
"""About P-VMDNN's 42,000 weights."""
REPEATS = 6
"""How often long work is timed; the fastest counts, for a machine has other things to do now and then."""
UNSEARCHED, TO_THE_END = PlanConfig(iterations=0), PlanConfig(enough=0.0)
"""A plan as it is recalled, and one that is searched for although it is good enough: the iterations are what they differ in."""
TIMED_SEED = 900
"""Draws the goals whose plans are timed."""


@dataclass(frozen=True)
class Work:
    """One amount of training work."""

    config: ModelConfig
    sensors: Sensors = ARM
    batch: int = 10
    steps: int = 16
    dtype: torch.dtype = torch.bfloat16


def bench(place: torch.device = CPU, *, quick: bool = False, tell: Callable[[str], None] = print) -> dict[str, Any]:
    """All figures, ready for JSON.

    Args:
        place: what is measured.
        quick: leave out the paper's size and the growth.
    """
    keep_freed_memory()
    limits = {name: limit_gflops(place, dtype) for name, dtype in (("fp32", torch.float32), ("bf16", torch.bfloat16))}
    tell(f"limit: {limits['fp32']:.0f} GFLOP/s in float32, {limits['bf16']:.0f} in bfloat16")
    result: dict[str, Any] = {"device": chip_of(place), "threads": torch.get_num_threads(), "limit_gflops": limits}
    if not fast.is_available():
        tell("tiny networks are not compiled, for numba is not there: pip install 'preimage[fast]'")
    works = {"small": Work(ModelConfig.small()), "peer": Work(PEER_CONFIG, PEER, batch=2, steps=80, dtype=torch.float32)}
    if not quick:
        works["paper"] = Work(ModelConfig.paper(), steps=60)
    result["train"] = {name: timed_training(work, place, limits, tell, name) for name, work in works.items()}
    result["plan"] = {"small": timed_plans("reach", place, tell), "peer": timed_iterations(PEER_CONFIG, PEER, place, steps=19)}
    tell(f"one iteration of the peer's work: {result['plan']['peer']['ms_per_iteration']} ms")
    if not quick:
        result["plan"]["paper"] = timed_iterations(ModelConfig.paper(), ARM, place, steps=60)
        result["growth"] = growth(place, tell)
    result["peak_memory_mb"] = peak_memory_mb(place)
    return result


def limit_gflops(place: torch.device, dtype: torch.dtype) -> float:
    """The most that was seen: a product of matrices that are large for the device, or a 3x3 convolution of the paper's second level."""
    size = 8192 if place.type == "cuda" else 1024
    one, other = (torch.randn(size, size, device=place).to(dtype) for _ in range(2))
    maps = torch.randn(10, 160, 16, 16, device=place).to(dtype, memory_format=torch.channels_last)
    weight = torch.randn(320, 160, 3, 3, device=place).to(dtype, memory_format=torch.channels_last)
    of_product, _ = fastest(lambda: one @ other, place)
    of_convolution, _ = fastest(lambda: nn.functional.conv2d(maps, weight, padding=1), place)
    product, convolution = 2 * size**3 / of_product, 2 * weight.numel() * maps.shape[0] * 256 / of_convolution
    return round(max(product, convolution) / 1e9, 1)


def fastest(work: Callable[[], Any], place: torch.device, repeats: int = 15) -> tuple[float, float]:
    """The least seconds, on the wall and of all cores together, of some repeats, after two that are not counted."""
    walls, cores = zip(*(seconds_of(work, place) for _ in range(repeats + 2)), strict=True)
    return min(walls[2:]), min(cores[2:])


def seconds_of(work: Callable[[], Any], place: torch.device) -> tuple[float, float]:
    began, began_cores = time.perf_counter(), time.process_time()
    work()
    if place.type == "cuda":
        torch.cuda.synchronize(place)
    return time.perf_counter() - began, time.process_time() - began_cores


def flops_of_step(model: PDVMRNN) -> int:
    """Floating-point operations of one step of one sequence, forward; training takes three times as many.

    Counted are matrix products and convolutions, a multiplication and an addition as two.
    """
    start = model.home_pixels[None], model.coding.encode(model.home_joints)[None]
    with FlopCounterMode(display=False) as counter:  # of one step itself: a loop may be compiled or replayed, out of the counter's sight
        model.at(model.pixel_bias.dtype)(start, model.initial_states(model.intention_table.prior_mean(1)))
    return counter.get_total_flops()


def update_of(work: Work, place: torch.device) -> tuple[PDVMRNN, Callable[[], None]]:
    """A network, and the forward and backward of a batch as training does them; the optimiser's step is left out, it is small."""
    model = PDVMRNN(work.config, work.sensors, work.batch).to(place)
    config = TrainConfig(precision="bfloat16" if work.dtype == torch.bfloat16 else "float32")
    learner = Learner(model, optimiser_of(model, config))
    sensors, shape = work.sensors, (work.batch, work.steps)
    frames = torch.full((*shape, sensors.height, sensors.width, sensors.channels), 127, dtype=torch.uint8)
    sequences = Sequences(frames, torch.zeros(*shape, sensors.num_joints), torch.full((work.batch,), work.steps), rest_steps=0)
    rows, blended = torch.arange(work.batch), torch.zeros(work.batch, dtype=torch.bool)
    no_noise = torch.zeros(work.batch, *model.pixel_bias.shape)
    generator = torch.Generator().manual_seed(0)

    def once() -> None:
        model.zero_grad()
        intention, charge = model.intention_table.draw(rows, generator)
        (error_of(learner, intention, sequences, no_noise, blended, config).total + charge).mean().backward()

    return model, once


def timed_training(work: Work, place: torch.device, limits: dict[str, float], tell: Callable[[str], None], name: str) -> dict[str, Any]:
    """Updates of a network, beside the limit."""
    model, once = update_of(work, place)
    seconds, cpu_seconds = fastest(once, place, REPEATS)
    seq_steps = work.batch * work.steps
    gflop_per_seq_step = 3 * flops_of_step(model) / 1e9
    gflops = gflop_per_seq_step * seq_steps / seconds
    limit = limits["bf16" if work.dtype == torch.bfloat16 else "fp32"]
    told = {
        "weights": sum(p.numel() for n, p in model.named_parameters() if not n.startswith("intention_table.")),
        "batch": work.batch,
        "steps": work.steps,
        "precision": str(work.dtype).removeprefix("torch."),
        "gflop_per_seq_step": round(gflop_per_seq_step, 4),
        "seq_steps_per_s": round(seq_steps / seconds, 1),
        "seq_steps_per_cpu_s": round(seq_steps / cpu_seconds, 1),
        "gflops": round(gflops, 1),
        "fraction_of_limit": round(gflops / limit, 3),
        "peak_memory_mb": peak_memory_mb(place),
    }
    tell(f"train {name}: {told['seq_steps_per_s']} sequence steps a second, {told['fraction_of_limit']:.0%} of the limit")
    return told


def timed_plans(name: str, place: torch.device, tell: Callable[[str], None], goals: int = 15) -> dict[str, Any]:
    """Goals that a bundled model never saw: the first from nothing, then each from the request to the plan.

    A goal that is in doubt is searched for several times, so the median, the mean and the longest stand beside each other.
    """
    demonstrations = record(Arm(), TASKS[name], count=goals, seed=TIMED_SEED)
    began = time.perf_counter()
    model = load_model(name).to(place)
    plan(model, start=demonstrations[0].first, goal=Percept(demonstrations[0].last.frame))
    cold_s = time.perf_counter() - began
    library = imagine_library(model)
    plans = [plan(model, start=one.first, goal=Percept(one.last.frame), library=library) for one in demonstrations]
    seconds = np.array([one.seconds for one in plans])
    first = {"start": demonstrations[0].first, "goal": Percept(demonstrations[0].last.frame), "library": library}
    without, to_the_end = (plan(model, **first, config=config) for config in (UNSEARCHED, TO_THE_END))
    told = {
        "cold_s": round(cold_s, 3),
        "warm_s": round(float(np.median(seconds)), 3),
        "warm_s_mean": round(float(seconds.mean()), 3),
        "warm_s_longest": round(float(seconds.max()), 3),
        "ms_per_iteration": round(1000 * (to_the_end.seconds - without.seconds) / (len(to_the_end.errors) - 1), 1),
        "goals": goals,
        "seed": TIMED_SEED,
    }
    tell(f"plan {name}: {told['warm_s']} s (median; mean {told['warm_s_mean']} s), from nothing {told['cold_s']} s")
    return told


def timed_iterations(config: ModelConfig, sensors: Sensors, place: torch.device, *, steps: int, iterations: int = 4) -> dict[str, Any]:
    """Error regression by the gradient through time, the paper's way, of one intention over so many steps, without the plan around it."""
    search = PlanConfig(method="descend", candidates=1, guesses=1, iterations=iterations, enough=0.0, horizon=steps)
    around = seconds_of_plan(config, sensors, place, replace(search, iterations=0))
    seconds = seconds_of_plan(config, sensors, place, search) - around
    return {"ms_per_iteration": round(1000 * seconds / iterations, 2), "horizon": steps, "candidates": 1}


def seconds_of_plan(config: ModelConfig, sensors: Sensors, place: torch.device, search: PlanConfig) -> float:
    """A plan to a frame of noise by a network that learned nothing, which takes as long as one that did."""
    model = PDVMRNN(config, sensors, 16).to(place).requires_grad_(False)
    frame = np.random.default_rng(0).integers(0, 255, (sensors.height, sensors.width, sensors.channels)).astype(np.uint8)
    library = imagine_library(model, config=search)
    return min(plan(model, goal=Percept(frame), config=search, library=library).seconds for _ in range(REPEATS))


def growth(place: torch.device, tell: Callable[[str], None]) -> dict[str, dict[str, float]]:
    """Seconds of one iteration of a plan as horizon and candidates grow, and of a training update as batch and frames do."""
    small = ModelConfig.small()

    def planning(horizon: int = 16, candidates: int = 2) -> float:
        return seconds_of_plan(small, ARM, place, PlanConfig(iterations=1, enough=0.0, horizon=horizon, candidates=candidates, guesses=1))

    def training(batch: int = 10, size: int = 64) -> float:
        _, once = update_of(Work(small, replace(ARM, height=size, width=size), batch=batch), place)
        return fastest(once, place, REPEATS)[0]

    grown = {
        "horizon": {str(n): round(planning(horizon=n), 4) for n in (8, 16, 32, 64)},
        "candidates": {str(n): round(planning(candidates=n), 4) for n in (1, 2, 4, 8)},
        "batch": {str(n): round(training(batch=n), 4) for n in (5, 10, 20, 40)},
        "pixels": {str(n * n): round(training(size=n), 4) for n in (32, 64, 128)},
    }
    for name, seconds in grown.items():
        tell(f"growth with {name}: {', '.join(f'{n}: {s:.2f} s' for n, s in seconds.items())}")
    return grown


def peak_memory_mb(place: torch.device) -> float:
    """The most memory this process, or its device, has held."""
    if place.type == "cuda":
        return round(torch.cuda.max_memory_allocated(place) / 2**20, 1)
    return round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, 1)
