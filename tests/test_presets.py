"""Laws of the presets: what each is made of, that each idea can be switched by itself, and that settings refuse what cannot be."""

import json
import shutil
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bars import bar
from preimage.cli import acting, by_preset, main, measuring, training
from preimage.evaluation import demo
from preimage.ideas.memory import DemonstrationMemory
from preimage.method.config import PlanConfig, TrainConfig
from preimage.method.error_regression import adam
from preimage.method.plan import random_guesses
from preimage.network.config import ModelConfig
from preimage.network.inputs import home
from preimage.network.pdvmrnn import PDVMRNN
from preimage.presets import Planner, PlanOptions, TrainOptions, load_memory, load_planner, network_config
from preimage.storage.networks import write_tensors
from preimage.storage.run_files import MEMORY

PRESETS = "paper", "regression", "full"


def test_the_paper_has_no_idea() -> None:
    paper = PlanOptions.paper()
    assert paper == PlanOptions()
    assert {field.name: getattr(paper, field.name) for field in fields(PlanConfig)} == vars(PlanConfig())
    ideas = paper.ideas(None)
    assert (ideas.initial_guess, ideas.search) == (random_guesses, adam)
    assert (list(ideas.terms), list(ideas.corrections)) == ([], [])
    assert TrainOptions().augmentations() == []


def test_only_full_needs_a_memory(trained: PDVMRNN, memory: DemonstrationMemory) -> None:
    assert [PlanOptions.of(preset).needs_memory for preset in PRESETS] == [False, False, True]
    for preset in ("paper", "regression"):
        assert PlanOptions.of(preset).ideas(None) is not None
    with pytest.raises(ValueError, match="these plans need a memory of the demonstrations: give one, or plan as paper or regression"):
        Planner(trained, None, PlanOptions.full())
    for planner, options in ((Planner(trained), PlanOptions.regression()), (Planner(trained, memory), PlanOptions.full())):
        assert replace(planner.options, precision="auto") == options


def test_a_preset_that_does_not_exist_is_refused() -> None:
    with pytest.raises(ValueError, match="best is no preset: give paper, regression or full"):
        PlanOptions.of("best")


SWITCHES: dict[str, Any] = {
    "search": "gauss_newton",
    "guess": "nearest",
    "hold_goal": True,
    "expected_joints": True,
    "end_correction": True,
    "gripper_events": True,
}


def parts(options: PlanOptions, memory: DemonstrationMemory) -> list[str]:
    """What plans are made with, by name."""
    ideas = options.ideas(memory)
    made_of = [ideas.initial_guess, ideas.search, *ideas.terms, *ideas.corrections]
    return [getattr(part, "__name__", type(part).__name__) for part in made_of]


@pytest.mark.parametrize("idea", SWITCHES)
def test_each_idea_is_switched_by_itself(idea: str, memory: DemonstrationMemory) -> None:
    paper, alone = parts(PlanOptions(), memory), parts(PlanOptions(**{idea: SWITCHES[idea]}), memory)
    assert alone != paper
    assert len(set(paper) - set(alone)) <= 1, "it replaces a part, or adds some"


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("size", ["tiny", "small", "paper"])
def test_the_papers_intention_is_free_and_that_of_full_latent(size: str, preset: Any) -> None:
    network, latent = network_config(size, preset), network_config(size, "full")
    assert network.intention == ("latent" if preset == "full" else "free")
    assert (network.vision_channels, network.motor_units) == (latent.vision_channels, latent.motor_units)
    assert network_config("paper", "paper") == ModelConfig.paper()


# What is kept of a run


def test_the_paper_reads_no_memory_though_it_lies_there(run_folder: Path, tmp_path: Path) -> None:
    shutil.copytree(run_folder, tmp_path / "run")
    (tmp_path / "run" / MEMORY).write_bytes(b"no memory")
    for preset in ("paper", "regression"):
        assert load_planner(tmp_path / "run", PlanOptions.of(preset)).memory is None
    with pytest.raises(ValueError, match=MEMORY):
        load_planner(tmp_path / "run")


def test_a_memory_of_another_version_is_refused(run_folder: Path, tmp_path: Path) -> None:
    shutil.copytree(run_folder, tmp_path / "run")
    kept = load_memory(run_folder).tensors()
    write_tensors(tmp_path / "run" / MEMORY, {name: value for name, value in kept.items() if name != "arrivals"})
    with pytest.raises(ValueError, match=r"is broken or of another version .*: train again"):
        load_memory(tmp_path / "run")


@pytest.mark.parametrize("name", ["first_joints", "arrivals", "final_pictures", "event_joint"])
def test_a_memory_of_other_numbers_than_were_written_is_refused(run_folder: Path, tmp_path: Path, name: str) -> None:
    shutil.copytree(run_folder, tmp_path / "run")
    kept = load_memory(run_folder).tensors()
    write_tensors(tmp_path / "run" / MEMORY, {**kept, name: kept[name].double()})
    with pytest.raises(ValueError, match=rf"\({name} is of torch.float64, and was written as torch\.\w+\): train again"):
        load_memory(tmp_path / "run")


def test_a_planner_plans_in_turn_and_imagines_without_a_goal(trained: PDVMRNN, memory: DemonstrationMemory) -> None:
    planner = Planner(trained, memory, replace(PlanOptions.full(), precision="float32", iterations=0))
    assert len(planner.plan_in_turn(goals=[bar(0.4).last, bar(0.8).last])) == 2
    assert planner.imagine_without_goal(bar(0.4).first).goal.frame is None


# What cannot be is refused, in Python as on the command line


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("config", "settings", "sentence"),
    [
        (TrainConfig, {"batch_size": 0}, r"batch_size \(--batch-size\) is 0: give 1(\.0)? or more"),
        (TrainConfig, {"warmup_updates": 0}, r"warmup_updates \(--warmup-updates\) is 0: give 1(\.0)? or more"),
        (TrainConfig, {"updates": 0}, r"updates \(--updates\) is 0: give 1(\.0)? or more"),
        (TrainConfig, {"learning_rate": float("nan")}, r"learning_rate \(--learning-rate\) is nan: give a number above 0"),
        (TrainConfig, {"gradient_norm": float("inf")}, r"gradient_norm \(--gradient-norm\) is inf: give a number above 0"),
        (TrainConfig, {"final_share": 2.0}, r"final_share \(--final-share\) is 2.0: give a share between 0 and 1"),
        (TrainOptions, {"batch_size": 0}, r"batch_size \(--batch-size\) is 0: give 1(\.0)? or more"),
        (TrainOptions, {"mixup": 1.0}, r"mixup \(--mixup\) is 1: give less, so that some demonstrations are shown as they are"),
        (TrainOptions, {"mixup": float("nan")}, r"mixup \(--mixup\) is nan: give a share between 0 and 1"),
        (TrainOptions, {"mixup_arity": 1}, r"mixup_arity \(--mixup-arity\) is 1: give 2(\.0)? or more"),
        (TrainOptions, {"later_starts": -0.1}, r"later_starts \(--later-starts\) is -0.1: give a share between 0 and 1"),
        (PlanConfig, {"candidates": 0}, r"candidates \(--candidates\) is 0: give 1(\.0)? or more"),
        (PlanConfig, {"iterations": -1}, r"iterations \(--iterations\) is -1: give 0(\.0)? or more"),
        (PlanConfig, {"initial_deviation": -1.0}, r"initial_deviation \(--initial-deviation\) is -1.0: give 0(\.0)? or more"),
        (PlanConfig, {"dimensions": 0}, r"dimensions \(--dimensions\) is 0: give 1(\.0)? or more"),
        (PlanConfig, {"modalities": "touch"}, "modalities is touch: give vision, joints or both"),
        (PlanOptions, {"candidates": 0}, r"candidates \(--candidates\) is 0: give 1(\.0)? or more"),
        (PlanOptions, {"tolerance": -1}, r"tolerance \(--tolerance\) is -1: give 0(\.0)? or more"),
        (PlanOptions, {"search": "gradient"}, r"search \(--search\) is gradient: give adam or gauss_newton"),
        (PlanOptions, {"guess": "near"}, r"guess \(--guess\) is near: give random or nearest or kriged"),
        (ModelConfig, {"intention_dimensions": 0}, r"intention_dimensions \(--intention-dimensions\) is 0: give 1(\.0)? or more"),
        (TrainOptions, {"learning_rate": 1e308}, r"learning_rate \(--learning-rate\) is 1e\+308: give 1000000000 or less"),
        (ModelConfig, {"rate_hz": 1e-308}, r"rate_hz \(--rate-hz\) is 1e-308: give 0.2 to 1000 steps a second"),
    ],
)
def test_settings_refuse_what_cannot_be(config: type, settings: dict[str, Any], sentence: str) -> None:
    """Once a share of 1 gave NaN, no warm-up a division by zero, and no candidate the least of nothing."""
    with pytest.raises(ValueError, match=f"^{sentence}"):
        config(**settings)


def test_a_setting_that_is_changed_is_checked_again() -> None:
    with pytest.raises(ValueError, match="candidates"):
        replace(PlanOptions.full(), candidates=0)


# --as


class Caught(BaseException):
    """What a verb was about to work with."""


def caught(words: list[str], monkeypatch: pytest.MonkeyPatch, room: Any, name: str) -> Any:
    """The options with which a verb goes to work."""
    seen: list[Any] = []

    def catch(*given: Any, **named: Any) -> None:
        seen.extend([*given, *named.values()])
        raise Caught

    monkeypatch.setattr(room, name, catch)
    with pytest.raises(Caught):
        main(words)
    return next(each for each in seen if isinstance(each, PlanOptions | TrainOptions))


@pytest.fixture(params=["plan", "evaluate", "demo"])
def verb(request: pytest.FixtureRequest, run_folder: Path, data: Path, tmp_path: Path) -> tuple[list[str], Any, str]:
    return {
        "plan": (["plan", str(run_folder), "--goal", f"{data}:0", "--out", str(tmp_path / "plan")], acting, "load_planner"),
        "evaluate": (["evaluate", str(run_folder), "--out", str(tmp_path / "result.json")], measuring, "load_planner"),
        "demo": (["demo", "--out", str(tmp_path / "demo")], demo, "load_planner"),
    }[request.param]


def test_a_verb_plans_as_it_is_told_and_each_part_can_be_changed_after_it(
    verb: tuple[list[str], Any, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    words, room, name = verb
    plain = {
        (): PlanOptions.full(),
        ("--as", "full"): PlanOptions.full(),
        ("--as", "paper"): PlanOptions.paper(),
        ("--as=regression",): PlanOptions.regression(),
        ("--as", "paper", "--candidates", "3"): PlanOptions(candidates=3),
        ("--iterations", "2", "--as", "regression"): replace(PlanOptions.regression(), iterations=2),
        ("--as", "paper", "--hold-goal", "--search", "gauss_newton"): PlanOptions(hold_goal=True, search="gauss_newton"),
        ("--no-gripper-events", "--tolerance", "0"): replace(PlanOptions.full(), gripper_events=False, tolerance=0.0),
    }
    for more, options in plain.items():
        assert caught([*words, *more], monkeypatch, room, name) == options, more


def test_training_as_the_paper_is_its_network_and_no_idea(run_folder: Path, data: Path, tmp_path: Path) -> None:
    words = ["train", str(data), "--size", "tiny", "--updates", "1"]
    main([*words, "--out", str(tmp_path / "paper"), "--as", "paper", "--batch-size", "2"])
    config = json.loads((tmp_path / "paper" / "config.json").read_text())
    assert (config["preset"], config["model"]["intention"], config["train"]["batch_size"]) == ("paper", "free", 2)
    assert (config["train"]["mixup"], config["train"]["later_starts"]) == (0, 0)
    assert json.loads((run_folder / "config.json").read_text())["model"]["intention"] == "latent"
    planner = load_planner(tmp_path / "paper", replace(PlanOptions.paper(), iterations=1, candidates=2))
    assert np.isfinite(planner.plan(goal=home(planner.model)).error)


def test_training_takes_an_idea_after_the_preset(data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    words = ["train", str(data), "--out", str(tmp_path / "run"), "--as", "regression", "--mixup", "0.5"]
    assert caught(words, monkeypatch, training, "train") == TrainOptions(mixup=0.5)


def test_a_preset_that_does_not_exist_is_refused_on_the_command_line(capsys: pytest.CaptureFixture, tmp_path: Path) -> None:
    for verb in (["demo"], ["plan", "reach", "--goal", "x", "--out", str(tmp_path / "plan")]):
        with pytest.raises(SystemExit) as left:
            main([*verb, "--as", "best"])
        assert left.value.code == 2
        assert "paper, regression or full" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "preset"), [(["RUN"], "paper"), (["RUN", "--as", "full"], "full"), (["reach"], "full"), (["nowhere"], "full")]
)
def test_what_plans_with_a_run_takes_the_preset_it_was_trained_by(words: list[str], preset: str, tmp_path: Path) -> None:
    (tmp_path / "config.json").write_text('{"preset": "paper"}')
    asked: dict[str, object] = {}

    def verb(run: str, as_: str = "full", config: PlanOptions = PlanOptions.full()) -> None:  # noqa: B008, frozen
        asked.update(preset=as_, config=config)

    by_preset(verb, [word.replace("RUN", str(tmp_path)) for word in words])("any")
    assert asked == {"preset": preset, "config": PlanOptions.of(preset)}
