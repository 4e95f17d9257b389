"""The command line. Exit codes: 0 done, 1 the work failed or was interrupted, 2 the words are off.

A verb's room is loaded when the verb is known, for torch, matplotlib and mujoco take seconds to load and a misspelt word needs none.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from difflib import get_close_matches
from functools import partial
from importlib import import_module
from inspect import signature
from itertools import pairwise
from pathlib import Path

from preimage.cli.errors import fail, one_sentence

DESCRIPTION = "Learn from demonstrations; give a goal image; see the way imagined before the robot moves."


@dataclass(frozen=True)
class Verb:
    """Where a verb is at home, and what it does in one sentence."""

    room: str
    function: str
    summary: str


VERBS = {
    "demo": Verb("acting", "demo", "Let the bundled model plan to goals it never saw, execute the plans, and show films and a report."),
    "studio": Verb("showing", "studio", "Open a local page: click a goal, watch how it is imagined, and let the arm move."),
    "record": Verb("recording", "record_", "Record demonstrations of a task on the simulated arm, as a LeRobotDataset v3.0."),
    "check": Verb("recording", "check", "Say whether recordings can be learned from, what is wrong with them and what would help."),
    "train": Verb("training", "train_", "Train a network on the demonstrations of a data set."),
    "plan": Verb("acting", "plan_", "Imagine a way to a goal, or to several in a row."),
    "execute": Verb("acting", "execute_", "Let the simulated arm execute a plan, and judge where it ends."),
    "calibrate": Verb(
        "trusting",
        "calibrate_",
        "Learn from goals of known outcome how likely a run's plans succeed, and which goals to refuse; it is kept with the run.",
    ),
    "evaluate": Verb("measuring", "evaluate_", "Count how often plans to goals that were never shown arrive, beside what luck would give."),
    "reproduce": Verb("measuring", "reproduce_", "Get the paper's numbers again, cell by cell; what was stopped goes on where it was."),
    "report": Verb("measuring", "report_", "Write the page of results from the JSON files, and the table in the README."),
    "bench": Verb("measuring", "bench_", "Measure speed beside the machine's own limit."),
}


def main(arguments: list[str] | None = None) -> None:
    """Run one verb; whatever goes wrong ends in one sentence and an exit code."""
    verb, *rest = (sys.argv[1:] if arguments is None else arguments) or [""]
    if verb in ("--help", "-h"):
        print(overview())
        raise SystemExit(0)
    if verb == "--version":
        print(f"preimage {version()}")
        raise SystemExit(0)
    if verb == "--completion":
        from preimage.cli.completion import completion

        print(completion({name: function_of(each) for name, each in VERBS.items()}))
        raise SystemExit(0)
    if verb not in VERBS:
        fail(what_is_wrong_with(verb), code=2)
    with one_sentence(verb, rest):
        run(verb, rest)


def run(verb: str, arguments: list[str]) -> None:
    from preimage.cli.parsing import parsed

    parsed(by_preset(function_of(VERBS[verb]), arguments), arguments, prog=f"preimage {verb}")()


def function_of(verb: Verb) -> Callable[..., None]:
    return getattr(import_module(f"preimage.cli.{verb.room}"), verb.function)


def by_preset(function: Callable[..., None], arguments: list[str]) -> Callable[..., None]:
    """The verb with the defaults of the preset that `--as` names, so that each of them can be changed after it.

    What plans with a run and names none takes the preset that the run was trained by.
    """
    from preimage.presets import PlanOptions, TrainOptions

    named = [value for word, value in pairwise([*arguments, ""]) if word == "--as"]
    named += [word.removeprefix("--as=") for word in arguments if word.startswith("--as=")]
    parameters = signature(function).parameters
    kind = getattr(parameters.get("config"), "default", None)
    if named and isinstance(kind, PlanOptions | TrainOptions):
        return partial(function, config=type(kind).of(named[-1]))
    trained_as = preset_of(Path(arguments[0])) if isinstance(kind, PlanOptions) and "run" in parameters and arguments else None
    return partial(function, as_=trained_as, config=PlanOptions.of(trained_as)) if trained_as else function


def preset_of(run: Path) -> str | None:
    """The preset that a run folder says it was trained by; None where there is no such folder or it does not say."""
    from preimage.presets import PRESETS
    from preimage.storage.reading import read_json

    try:
        preset = read_json(run / "config.json").get("preset")
    except (OSError, ValueError):  # the verb says what is wrong with a run
        return None
    return preset if preset in PRESETS else None


def overview() -> str:
    """What `preimage --help` prints."""
    lines = [f"  {name:<{max(map(len, VERBS))}}  {verb.summary}" for name, verb in VERBS.items()]
    about = (
        "`preimage VERB --help` says what a verb takes; `preimage --version` says which preimage this is; "
        "`preimage --completion` prints what completes words in bash or zsh."
    )
    return "\n".join(["usage: preimage VERB [options]", "", DESCRIPTION, "", *lines, "", about])


def version() -> str:
    from importlib import metadata

    return metadata.version("preimage")


def what_is_wrong_with(verb: str) -> str:
    """One sentence about a first word that is no verb."""
    if not verb:
        return f"give a verb: {', '.join(VERBS)}; preimage --help says what they do"
    near = get_close_matches(verb, VERBS, n=1)
    return f"there is no verb {verb}: " + (f"did you mean {near[0]}?" if near else f"there are {', '.join(VERBS)}")
