"""The cases of the fuzz (`fuzz.py`): an input, what is damaged in it, and a command line, all drawn from one number."""

import re
import shutil
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from random import Random

VERBS = ["check", "train", "plan", "execute", "evaluate", "report", "record"]
"""All but those that take minutes whatever they are given: demo, reproduce, bench."""
LABOUR = re.compile(
    "--(updates|goals?|count|candidates|iterations|seeds|devices|num-nodes|pixels|batch-size|checkpoint-every|horizon|dimensions"
    "|mixup-arity|rest-steps|screening|finalists|demonstrations)"
)
"""Options by which more work can be asked for: they are given small numbers, for a long work is no fault."""
SMALL_WORDS = ["0", "1", "-1", "2", "3", "0.5", "nan", "inf", "", "x", "None"]
WORDS = [*SMALL_WORDS, "-inf", "1e308", "1e-308", "9" * 20, "é", "\udc80", "True", "[1]", "../x", "/dev/zero", "joint1", "top"]


@dataclass
class Case:
    """What is done: in order, the inputs that are copied, what is damaged in them, and the words of the command."""

    words: list[str]
    inputs: list[str]
    damages: list[str] = field(default_factory=list)
    keeps: bool = True
    """Whether the inputs have to be as they were: all but the run that a training goes on with."""


def case_of(chance: Random, inputs: Path, place: Path, options: dict[str, list[str]]) -> Case:
    """Draw a case, and lay its input out in a folder."""
    from mutations import damage

    case = BY_VERB[chance.choice(list(BY_VERB))](chance)
    for name in case.inputs:
        source = inputs / name
        shutil.copytree(source, place / name, symlinks=True) if source.is_dir() else shutil.copy(source, place / name)
    off = chance.random() < 0.35
    for _ in range(0 if off else chance.choice([1, 1, 1, 2, 3])):
        case.damages.append(damage(place / chance.choice(case.inputs), chance) if case.inputs else "")
    if (off or chance.random() < 0.1) and options.get(case.words[0]):
        for _ in range(chance.choice([1, 1, 2])):
            option = chance.choice(options[case.words[0]])
            words = SMALL_WORDS if LABOUR.match(option) else WORDS
            case.words += [option, *(chance.choice(words) for _ in range(chance.choice([1, 1, 1, 0, 2, 4])))]
    if chance.random() < 0.02:
        del case.words[chance.randrange(len(case.words))]
    return case


def a_data_set(chance: Random) -> str:
    return chance.choice(["ours", "v20", "v21", "v30", "plain"])


def check_case(chance: Random) -> Case:
    data = a_data_set(chance)
    return Case(["check", data, "--out", "page.html"], [data])


def train_case(chance: Random) -> Case:
    if chance.random() < 0.3:
        return Case(["train", "ours", "--out", "run", "--updates", "3", "--resume"], ["run", "ours"], keeps=False)
    data = a_data_set(chance)
    return Case(["train", data, "--out", "new", "--size", "tiny", "--updates", "1"], [data])


def plan_case(chance: Random) -> Case:
    goal, inputs = chance.choice([("ours:1", ["ours"]), ("goal.png", ["goal.png"]), ("ours:0:3", ["ours"])])
    words, inputs = ["plan", "run", "--goal", goal, "--out", "new", "--iterations", "1"], ["run", *inputs]
    if chance.random() < 0.3:
        words, inputs = [*words, "--joint-limits", "limits.json"], [*inputs, "limits.json", "limits.json"]
    if chance.random() < 0.2:
        joints = [chance.choice(["0", "0.1", "-0.2", "0.3", "100", "nan", "x"]) for _ in range(chance.choice([4, 4, 3, 5, 0]))]
        words += ["--modalities", chance.choice(["joints", "both"]), "--goal-joints", *joints]
    if chance.random() < 0.3 and "ours" in inputs:
        words += ["--start", chance.choice(["ours:0", "ours:2:1", "ours:99", "ours:x", "ours:0:-1", "goal.png"])]
    if chance.random() < 0.1:
        words += ["--as", chance.choice(["paper", "regression", "none"])]
    return Case(words, inputs)


def execute_case(chance: Random) -> Case:
    return Case(["execute", "plan", *chance.choice([[], [], ["--film", "film.mp4"], ["--film", "film.gif"]])], ["plan"])


def evaluate_case(chance: Random) -> Case:
    words = ["evaluate", "run", "--out", "new.json", "--iterations", "1"]
    if chance.random() < 0.5:
        return Case([*words, "--goals", "1", "--loop", chance.choice(["closed", "open", "recorded"])], ["run"])
    return Case([*words, "--data", "ours", "--episodes", "0", *chance.choice([[], ["--films", "films"]])], ["run", "ours"])


def report_case(_chance: Random) -> Case:
    return Case(["report", "--results", "results", "--out", "page.md", "--readme", "README.md"], ["results"])


def record_case(chance: Random) -> Case:
    task = chance.choice(["reach", "two-points", "move-object", "x"])
    return Case(["record", task, "--count", chance.choice(["1", "0", "-1"]), "--out", "new", "--pixels", "32"], [])


def words_case(chance: Random) -> Case:
    verb = chance.choice([*VERBS, "demo", "bench", "reproduce", "chekc", "", "--version", "--help", "-x"])
    harmless = ["--help"] if verb in ("demo", "bench", "reproduce", "record") else []
    return Case([verb, *(chance.choice([*WORDS, "ours", "goal.png"]) for _ in range(chance.randrange(3))), *harmless], ["ours", "goal.png"])


BY_VERB: dict[str, Callable[[Random], Case]] = {
    "check": check_case, "train": train_case, "plan": plan_case, "execute": execute_case, "evaluate": evaluate_case,
    "report": report_case, "record": record_case, "words": words_case,
}  # fmt: skip
