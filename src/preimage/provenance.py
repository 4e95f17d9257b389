"""What it takes to get a result again: the command, the commit, the versions, the machine, the day."""

import platform
import shlex
import subprocess
import sys
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import torch


def provenance() -> dict[str, Any]:
    """Of this process, ready for JSON."""
    here = Path(__file__).parent
    described = subprocess.run(["git", "describe", "--always", "--dirty"], cwd=here, capture_output=True, text=True, check=False)
    return {
        "command": shlex.join(["preimage", *sys.argv[1:]]),
        "commit": described.stdout.strip() or None,
        "versions": {name: version(name) for name in ("preimage", "torch", "mujoco", "numpy")} | {"python": platform.python_version()},
        "machine": f"{platform.machine()}, {torch.get_num_threads()} threads",
        "date": datetime.now(UTC).date().isoformat(),
    }
