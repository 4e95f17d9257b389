"""What was measured before: the evaluations of a folder of results, as the page shows them."""

from pathlib import Path
from typing import Any

from preimage.storage.reading import read_json

NAMES = ("task", "num_demonstrations", "size", "preset", "loop", "seed", "training_seed", "success", "goals", "interval")
"""Of an evaluation, what is shown."""


def evaluations(folder: Path | None) -> list[dict[str, Any]]:
    """One row for each evaluation of a folder; what is none, or cannot be read, is left out."""
    rows = []
    for path in sorted(folder.glob("*.json")) if folder else ():
        try:
            found = read_json(path)
        except ValueError:
            continue
        if not all(name in found for name in ("task", "success", "goals", "interval", "deviation_cm")):
            continue
        row = {name: found.get(name) for name in NAMES}
        command = found.get("provenance", {}).get("command") if isinstance(found.get("provenance"), dict) else None
        rows.append(row | {"deviation_cm": found["deviation_cm"].get("median"), "command": command, "name": path.stem})
    return rows
