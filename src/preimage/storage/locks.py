"""A folder with one writer: a lock that names the process that holds it and ends with that process.

The operating system holds the lock (`flock`, on Windows `LK_NBLCK`), so that it is free the moment its process is gone, however that
ended. The file only says who holds it. On a file system that knows no locks there is none, and nothing is refused.

>>> import tempfile
>>> with tempfile.TemporaryDirectory() as folder, locked(Path(folder)):
...     [path.name for path in Path(folder).iterdir()]
['.lock']
"""

import contextlib
import errno
import json
import os
import platform
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path

LOCK = ".lock"
BEYOND_THE_TEXT = 1 << 20
"""The byte that Windows locks: what is locked cannot be read there, and the text has to be."""
HELD = {errno.EACCES, errno.EAGAIN, errno.EDEADLK}
"""What the operating system says where another process holds the lock."""


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """This process is the only writer of a folder until the block ends.

    Raises:
        ValueError: another process is; the text names it.
        OSError: the folder cannot be written.
    """
    path = folder / LOCK
    file = acquired(path)
    try:
        about = {"pid": os.getpid(), "host": platform.node(), "since": f"{datetime.now():%Y-%m-%d %H:%M:%S}"}
        os.ftruncate(file, 0)
        os.write(file, json.dumps(about).encode())
        yield
    finally:
        if os.name == "nt":  # where an open file cannot be removed
            os.close(file)
            with contextlib.suppress(OSError):
                path.unlink()
        else:
            path.unlink(missing_ok=True)
            os.close(file)


def acquired(path: Path) -> int:
    """The open lock file, locked by this process."""
    while True:
        file = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            lock(file)
            if os.name == "nt" or is_the_same(file, path):
                return file
        except OSError as error:
            os.close(file)
            if error.errno in HELD:
                raise ValueError(f"{path.parent} is being written by {holder(path)}: wait until it ends, or stop it") from error
            raise
        os.close(file)  # its holder removed it between our opening and our locking: take the next


def lock(file: int) -> None:
    """Lock an open file, without waiting."""
    try:
        if sys.platform == "win32":
            import msvcrt

            os.lseek(file, BEYOND_THE_TEXT, os.SEEK_SET)
            msvcrt.locking(file, msvcrt.LK_NBLCK, 1)
            os.lseek(file, 0, os.SEEK_SET)
        else:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in HELD:
            raise


def is_the_same(file: int, path: Path) -> bool:
    """Whether the path still leads to the open file."""
    try:
        return os.path.samestat(os.fstat(file), path.stat())
    except FileNotFoundError:
        return False


def holder(path: Path) -> str:
    """Who holds a lock, in words."""
    try:
        about = json.loads(path.read_text(encoding="utf-8"))
        return f"process {about['pid']} on {about['host']} since {about['since']}"
    except (OSError, ValueError, KeyError, TypeError):  # it is about to write its name, or to leave
        return "another process"


def writer(folder: Path) -> str | None:
    """Who writes a folder, in words, looked up without a hand on its lock; None where nobody does, as far as can be seen from here."""
    try:
        about = json.loads((folder / LOCK).read_text(encoding="utf-8"))
        gone = about["host"] == platform.node() and not is_running(int(about["pid"]))
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return None if gone else holder(folder / LOCK)


def is_running(pid: int) -> bool:
    """Whether there is a process of this number on this machine."""
    if sys.platform == "win32":  # where os.kill would end it
        import ctypes

        process = ctypes.windll.kernel32.OpenProcess(0x1000, False, pid)  # PROCESS_QUERY_LIMITED_INFORMATION
        ctypes.windll.kernel32.CloseHandle(process)
        return bool(process)
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True
    return True
