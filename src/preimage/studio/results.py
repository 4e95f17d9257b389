"""What was measured before: the evaluations of a folder of results, as the page shows them."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from preimage.report.result_files import is_evaluation, read_result

NAMES = ("task", "num_demonstrations", "size", "preset", "loop", "seed", "training_seed", "success", "goals", "interval")
"""Of an evaluation, what is shown."""


def evaluations(folder: Path | None) -> Iterator[dict[str, Any]]:
    """One row for each evaluation of a folder; what is none, or cannot be read, is left out."""
    for path in sorted(folder.glob("*.json")) if folder else ():
        try:
            found = read_result(path)
        except ValueError:
            continue
        if is_evaluation(found):
            about = {"deviation_cm": found["deviation_cm"].get("median"), "command": found.get("provenance", {}).get("command")}
            yield {name: found.get(name) for name in NAMES} | about | {"name": path.stem}
