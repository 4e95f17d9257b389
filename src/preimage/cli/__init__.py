"""The command line. Exit codes: 0 done, 1 the work failed or was interrupted, 2 the words are off."""

import sys
from collections.abc import Callable

import tyro

from preimage.cli.acting import demo, execute_, plan_
from preimage.cli.learning import check, record_, train_
from preimage.cli.measuring import bench_, evaluate_, report_, reproduce_
from preimage.compute.processes import ProcessLost, speaks
from preimage.method.train import NonFinite

VERBS: dict[str, Callable[..., None]] = {
    "demo": demo,
    "record": record_,
    "check": check,
    "train": train_,
    "plan": plan_,
    "execute": execute_,
    "evaluate": evaluate_,
    "reproduce": reproduce_,
    "report": report_,
    "bench": bench_,
}


def main(arguments: list[str] | None = None) -> None:
    """Run one verb; whatever a user can cause ends in one sentence and an exit code."""
    description = "Learn from demonstrations; give a goal image; see the way imagined before the robot moves."
    try:
        tyro.extras.subcommand_cli_from_dict(VERBS, prog="preimage", description=description, args=arguments)
    except ValueError as error:
        fail(str(error), code=2)
    except (NonFinite, ProcessLost) as error:
        fail(str(error), code=1)
    except FileExistsError as error:
        fail(f"{error.filename} is there already and is no folder: give another place", code=1)
    except OSError as error:
        fail(f"{error.filename}: {error.strerror}" if error.filename else error.strerror or str(error), code=1)
    except KeyboardInterrupt:
        fail("interrupted; what was saved is kept", code=1)


def fail(sentence: str, *, code: int) -> None:
    if speaks():
        print(f"preimage: {sentence}", file=sys.stderr)
    raise SystemExit(code)
