"""Where results go: nothing that this program did not write is ever replaced or removed.

An output folder is new, empty, or one of the same kind that may be replaced: it holds what such a folder holds, and nothing else. It is
written beside its place and moved there as a whole, so that a killed process leaves the former one.

>>> import tempfile
>>> notes = Kind("notes", required=("notes.txt",))
>>> with tempfile.TemporaryDirectory() as scratch:
...     with output_folder(Path(scratch) / "mine", notes) as draft:
...         _ = (draft / "notes.txt").write_text("all of them")
...     [path.name for path in (Path(scratch) / "mine").iterdir()]
['notes.txt']
"""

import errno
import glob
import os
import stat
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from fnmatch import fnmatch
from pathlib import Path

from preimage.storage.atomic_write import UNFINISHED, remove, remove_leftovers, unfinished_path
from preimage.storage.locks import is_running

FORMER = ".former"
"""How the name of a folder ends while another takes its place."""
LEFT_BY_OTHERS = {".DS_Store", "Thumbs.db", "desktop.ini"}
"""What file managers leave in any folder that was looked at."""


def is_regular_file(path: Path) -> bool:
    """Whether a path is a file itself, and not a link to one."""
    return is_a(path, stat.S_ISREG)


def is_regular_folder(path: Path) -> bool:
    """Whether a path is a folder itself, and not a link to one."""
    return is_a(path, stat.S_ISDIR)


def is_a(path: Path, kind: Callable[[int], bool]) -> bool:
    try:
        return kind(path.lstat().st_mode)
    except (OSError, ValueError):
        return False


@dataclass(frozen=True)
class Kind:
    """What a folder of one kind holds."""

    noun: str
    """What to call it: `plan`."""
    required: tuple[str, ...]
    """Files that it has to hold to be recognised."""
    files: tuple[str, ...] = ()
    """Files that it may hold besides."""
    pattern: str | None = None
    """Of the names of more files that it may hold."""
    folders: Mapping[str, "Kind"] = field(default_factory=dict)
    """Folders that it may hold, each of a kind of its own."""
    required_folders: tuple[str, ...] = ()
    """Those of them that it has to hold."""

    def holds(self, folder: Path) -> bool:
        """Whether a folder is one of this kind and nothing else is in it."""
        return self.foreign_in(folder) is None

    def foreign_in(self, folder: Path) -> str | None:
        """The first reason why a folder is not one of this kind; None where it is."""
        if not is_regular_folder(folder):
            return f"{folder} is a link" if folder.is_symlink() else f"{folder} is no folder"
        for name in self.required:
            if not is_regular_file(folder / name):
                return f"{folder} holds no {name}"
        for name in self.required_folders:
            if not is_regular_folder(folder / name):
                return f"{folder} holds no {name}"
        for path in sorted(folder.iterdir()):
            if path.name in self.folders:
                if reason := self.folders[path.name].foreign_in(path):
                    return reason
            elif not self.may_hold(path.name) or not is_regular_file(path):
                return f"{path} is not of it"
        return None

    def may_hold(self, name: str) -> bool:
        """Whether a file of this name may be in such a folder."""
        return name in {*self.required, *self.files, *LEFT_BY_OTHERS} or bool(self.pattern and fnmatch(name, self.pattern))


def validate_output_file(path: Path, noun: str, *, suffixes: Sequence[str] = (), marks: Sequence[bytes] = ()) -> None:
    """Raises ValueError where a file cannot be written to a path, or one that is there is not replaced.

    Args:
        noun: what to call it: `film`.
        suffixes: how the path may end; by default anyhow.
        marks: what a file has to hold to be replaced; by default any file of the suffixes is.
    """
    if suffixes and path.suffix.lower() not in suffixes:
        raise ValueError(f"{path} is to be a {noun}, which ends in {' or '.join(suffixes)}: give such a name")
    if path.is_dir():
        raise ValueError(f"{path} is a folder: give the name of a file")
    if not os.path.lexists(path):
        return
    if not path.is_file() or (marks and not holds_marks(path, marks)):
        raise ValueError(f"{path} is there already, is no {noun} of ours and is kept: give another name")


def holds_marks(path: Path, marks: Sequence[bytes]) -> bool:
    """Whether a file holds all of these bytes."""
    content = path.read_bytes()
    return all(mark in content for mark in marks)


def validate_output_folder(folder: Path, kind: Kind | None = None, *, overwrite: bool = False) -> None:
    """Raises ValueError where a folder is neither new nor empty nor one of the kind that may be replaced.

    Args:
        kind: what may be replaced; by default nothing.
        overwrite: whether a folder of the same kind may be replaced.
    """
    folder = Path(os.path.abspath(folder))
    restore(folder)
    if not os.path.lexists(folder) or is_empty(folder):
        return
    if not folder.is_dir():
        raise ValueError(f"{folder} is there already and is no folder: give another place")
    if kind is None:
        raise ValueError(f"{folder} is there already: give a new folder")
    reason = kind.foreign_in(folder)
    if reason:
        raise ValueError(f"{folder} is not empty and is not replaced, for it is no {kind.noun} of ours ({reason}): give a new folder")
    if not overwrite:
        raise ValueError(f"{folder} holds a {kind.noun} already: give a new folder, or --overwrite to replace it")
    if folder.resolve() == Path.cwd():
        raise ValueError(f"{folder} is where you stand, and is not replaced: give a new folder")


def is_empty(folder: Path) -> bool:
    """Whether a folder holds nothing but what a killed process of this machine left unfinished."""
    if not folder.is_dir():
        return False
    remove_leftovers(folder)
    return not any(path.name not in LEFT_BY_OTHERS for path in folder.iterdir())


@contextmanager
def output_folder(folder: Path, kind: Kind | None = None, *, overwrite: bool = False) -> Iterator[Path]:
    """Lends a folder to write to; afterwards `folder` is what was written, or, after an error, what it was before.

    Args:
        kind: what may be replaced; by default nothing.
        overwrite: whether a folder of the same kind may be replaced.

    Raises:
        ValueError: it is neither new nor empty nor such a folder.
        OSError: the disk is full or read-only.
    """
    folder = Path(os.path.abspath(folder))  # with a name of its own, also where it is given as `.`
    validate_output_folder(folder, kind, overwrite=overwrite)
    into = is_empty(folder)  # it stays itself, for it may be where somebody stands, a link, or a disk of its own
    draft = unfinished_path(folder / "draft" if into else folder)
    draft.parent.mkdir(parents=True, exist_ok=True)
    remove_leftovers(draft.parent)
    try:
        draft.mkdir()
        yield draft
        if into:
            recognised_by = kind.required if kind else ()
            for path in sorted(draft.iterdir(), key=lambda each: each.name in recognised_by):  # these come last
                move(path, folder / path.name)
        else:
            validate_output_folder(folder, kind, overwrite=overwrite)  # again: something may have been put there
            replace_folder(draft, folder)
    finally:
        remove(draft)


def move(path: Path, target: Path) -> None:
    """Move a file or a folder to a place where nothing is."""
    if os.path.lexists(target):
        raise FileExistsError(errno.EEXIST, "came to be while this program ran, and is kept", str(target))
    path.rename(target)


def replace_folder(draft: Path, folder: Path) -> None:
    """A draft takes the place of a folder, which is removed last."""
    if not os.path.lexists(folder):
        draft.rename(folder)
        return
    former = draft.with_suffix(FORMER)
    folder.rename(former)
    try:
        draft.rename(folder)
    except BaseException:
        former.rename(folder)
        raise
    remove(former)


def restore(folder: Path) -> None:
    """Where a process was killed while it replaced a folder, the former one is back, or, where the new one is there, gone."""
    for former in folder.parent.glob(f".{glob.escape(folder.name)}.*{FORMER}"):
        owner = UNFINISHED.fullmatch(former.with_suffix(".part").name)
        if not owner or owner["name"] != folder.name or is_running(int(owner["pid"])):
            continue
        if os.path.lexists(folder):
            remove(former)
        else:
            former.rename(folder)
