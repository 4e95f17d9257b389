"""What it takes to get a result again: the command, the commit, the versions, the machine, the day."""

import platform
import shlex
import shutil
import subprocess
import sys
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import torch

from preimage.compute.devices import CPU, chip_of


def provenance(place: torch.device = CPU) -> dict[str, Any]:
    """Of this process, ready for JSON.

    Args:
        place: what computes.
    """
    return {
        "command": shlex.join(["preimage", *sys.argv[1:]]),
        "commit": commit(),
        "versions": {name: version(name) for name in ("preimage", "torch", "mujoco", "numpy")} | {"python": platform.python_version()},
        "machine": f"{platform.machine()}, {torch.get_num_threads()} threads" + (f", {chip_of(place)}" if place.type == "cuda" else ""),
        "date": datetime.now(UTC).date().isoformat(),
    }


def commit() -> str | None:
    """The commit of the checkout this runs from; None where it was installed without one."""
    root = Path(__file__).parents[3]
    if not (root / ".git").exists() or shutil.which("git") is None:
        return None
    described = subprocess.run(["git", "describe", "--always", "--dirty"], cwd=root, capture_output=True, text=True, check=False)
    return described.stdout.strip() or None
