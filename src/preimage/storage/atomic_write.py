"""Files and folders that are either complete or absent: written beside their place, then moved into it.

What is being written has a name that says by whom, `.NAME.PID@HOST.part`. A process that is killed leaves it behind; the next one that
writes beside it removes it.
"""

import contextlib
import json
import os
import platform
import re
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from preimage.storage.locks import is_running

HOST = re.sub(r"[^A-Za-z0-9-]", "-", platform.node()) or "localhost"
UNFINISHED = re.compile(rf"\.(?P<name>.+)\.(?P<pid>\d+)@{re.escape(HOST)}\.part")


def unfinished_path(path: Path) -> Path:
    """Where this process writes what is to become `path`."""
    return path.with_name(f".{path.name}.{os.getpid()}@{HOST}.part")


def remove_leftovers(folder: Path) -> None:
    """Remove what processes of this machine that are no longer running left unfinished in a folder."""
    for path in folder.glob(".*.part"):
        owner = UNFINISHED.fullmatch(path.name)
        if owner and not is_running(int(owner["pid"])):
            remove(path)


def remove(path: Path) -> None:
    """Remove a file, a folder or a link that this program made; what a link points at stays."""
    with contextlib.suppress(OSError):  # another process may remove the same
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Lends a path to write to; afterwards `path` holds all that was written, or, after an error, what it held before.

    Raises:
        OSError: the disk is full or read-only, or `path` is a folder.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        remove_leftovers(path.parent)
        unfinished = unfinished_path(path)
        try:
            yield unfinished
            os.replace(unfinished, path)
        finally:
            unfinished.unlink(missing_ok=True)
    except (OSError, RuntimeError) as error:  # torch.save reports a full disk as a RuntimeError
        reason = getattr(error, "strerror", None) or str(error).strip().splitlines()[0]
        raise OSError(f"{path} could not be written ({reason}); what was saved before is kept") from error


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write JSON that a person can read, complete or not at all."""
    with atomic_write(path) as unfinished:
        unfinished.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
