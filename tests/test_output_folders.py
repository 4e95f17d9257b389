"""Nothing that is not ours is ever replaced or removed, whatever lies where a result is to be written."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from preimage.storage import output_folders
from preimage.storage.atomic_write import HOST, atomic_write
from preimage.storage.output_folders import Kind, output_folder, validate_output_file
from preimage.storage.plans import EPISODE, PLAN, load_plan, save_episode, save_plan
from test_plans import assert_equal, make_plan

NOTES = Kind("book", required=("notes.txt",), files=("more.txt",))


def write_notes(folder: Path, text: str = "new", *, overwrite: bool = False) -> None:
    with output_folder(folder, NOTES, overwrite=overwrite) as draft:
        (draft / "notes.txt").write_text(text)


def tree(folder: Path) -> dict[str, bytes | str]:
    """All that is under a folder, links as where they lead."""
    found: dict[str, bytes | str] = {}
    for place, folders, names in os.walk(folder):
        for name in [*folders, *names]:
            path = Path(place) / name
            key = str(path.relative_to(folder))
            found[key] = (
                os.readlink(path) if path.is_symlink() else path.read_bytes() if path.is_file() else "folder" if path.is_dir() else "pipe"
            )
    return found


def dead_pid() -> int:
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


@pytest.mark.parametrize("place", ["new", "new/deeper", "empty"])
def test_a_new_or_empty_folder_is_written(tmp_path, place):
    (tmp_path / "empty").mkdir()
    write_notes(tmp_path / place)
    assert (tmp_path / place / "notes.txt").read_text() == "new"
    assert not [name for name in tree(tmp_path) if name.split("/")[-1].startswith(".")]


def test_where_somebody_stands_is_written_to(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_notes(Path("."))
    assert tree(tmp_path) == {"notes.txt": b"new"}
    with pytest.raises(ValueError, match="is where you stand, and is not replaced"):
        write_notes(Path("."), overwrite=True)


def test_one_of_the_same_kind_is_replaced_when_asked_for(tmp_path):
    write_notes(tmp_path / "out", "former")
    with pytest.raises(ValueError, match="holds a book already: give a new folder, or --overwrite to replace it"):
        write_notes(tmp_path / "out")
    write_notes(tmp_path / "out", overwrite=True)
    assert tree(tmp_path) == {"out": "folder", "out/notes.txt": b"new"}


def make_clone(folder: Path) -> None:
    (folder / ".git").mkdir(parents=True)
    (folder / ".git/HEAD").write_text("ref: refs/heads/main")
    (folder / "notes.txt").write_text("mine")


FOREIGN = {
    "a clone": make_clone,
    "another file": lambda folder: (folder.mkdir(), (folder / "mine.txt").write_text("mine")),
    "ours and another file": lambda folder: (write_notes(folder), (folder / "mine.txt").write_text("mine")),
    "ours and a hidden file": lambda folder: (write_notes(folder), (folder / ".env").write_text("mine")),
    "ours and a folder": lambda folder: (write_notes(folder), (folder / "more.txt").mkdir()),
    "ours through a link": lambda folder: (write_notes(folder.with_name("real")), folder.symlink_to(folder.with_name("real"))),
    "a link in ours": lambda folder: (write_notes(folder), (folder / "more.txt").symlink_to("/etc/hosts")),
    "a link for ours": lambda folder: (folder.mkdir(), (folder / "notes.txt").symlink_to("/etc/hosts")),
    "a file": lambda folder: folder.write_text("mine"),
    "a broken link": lambda folder: folder.symlink_to("nowhere"),
    "a pipe in ours": lambda folder: (write_notes(folder), os.mkfifo(folder / "more.txt")),
}


@pytest.mark.parametrize("make", FOREIGN.values(), ids=FOREIGN.keys())
@pytest.mark.parametrize("overwrite", [True, False])
def test_what_is_not_ours_is_kept(tmp_path, make, overwrite):
    make(tmp_path / "out")
    before = tree(tmp_path)
    with pytest.raises(ValueError, match=r"give a new folder|give another place"):
        write_notes(tmp_path / "out", overwrite=overwrite)
    assert tree(tmp_path) == before


def test_what_came_to_be_meanwhile_is_kept(tmp_path):
    def write(folder: Path) -> None:
        with output_folder(folder, NOTES, overwrite=True) as draft:
            (draft / "notes.txt").write_text("new")
            folder.mkdir(exist_ok=True)
            (folder / "mine.txt").write_text("mine")
            (folder / "notes.txt").write_text("mine")

    with pytest.raises(ValueError, match="is not of it"):
        write(tmp_path / "new")
    (tmp_path / "empty").mkdir()
    with pytest.raises(OSError, match="came to be while this program ran, and is kept"):
        write(tmp_path / "empty")
    for folder in ("new", "empty"):
        assert tree(tmp_path / folder) == {"mine.txt": b"mine", "notes.txt": b"mine"}


@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError(28, "No space left on device"), ValueError])
def test_an_error_leaves_the_former_folder(tmp_path, error):
    write_notes(tmp_path / "out", "former")

    def fail() -> None:
        with output_folder(tmp_path / "out", NOTES, overwrite=True) as draft:
            (draft / "notes.txt").write_text("ne")
            raise error

    with pytest.raises((KeyboardInterrupt, OSError, ValueError)):
        fail()
    assert tree(tmp_path) == {"out": "folder", "out/notes.txt": b"former"}


def test_leftovers_of_killed_processes_are_removed_and_those_of_living_ones_kept(tmp_path):
    dead = dead_pid()
    (tmp_path / f".out.{dead}@{HOST}.part").mkdir()
    (tmp_path / f".out.{dead}@{HOST}.part/half.bin").write_text("ha")
    (tmp_path / f".a.json.{dead}@{HOST}.part").write_text("ha")
    alive = [f".b.{os.getppid()}@{HOST}.part", f".b.{dead}@elsewhere.part", ".mine.part", f"b.{dead}@{HOST}.part"]
    for name in alive:
        (tmp_path / name).write_text("mine")
    write_notes(tmp_path / "out")
    with atomic_write(tmp_path / "a.json") as path:
        path.write_text("{}")
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([*alive, "a.json", "out"])


@pytest.mark.parametrize("new_is_there", [True, False])
def test_a_process_killed_while_it_replaced_a_folder_leaves_one_of_both(tmp_path, new_is_there):
    former = tmp_path / f".out.{dead_pid()}@{HOST}.former"
    for folder, text in [(former, "former"), *[(tmp_path / "out", "new")] * new_is_there]:
        folder.mkdir()
        (folder / "notes.txt").write_text(text)
    with pytest.raises(ValueError, match="holds a book already"):
        write_notes(tmp_path / "out")
    assert tree(tmp_path) == {"out": "folder", "out/notes.txt": b"new" if new_is_there else b"former"}


def test_a_folder_that_cannot_be_moved_is_put_back(tmp_path, monkeypatch):
    write_notes(tmp_path / "out", "former")
    rename = Path.rename

    def refuse(path, target):
        if path.name.endswith(".part"):
            raise PermissionError(13, "Permission denied", str(path))
        return rename(path, target)

    monkeypatch.setattr(output_folders.Path, "rename", refuse)
    with pytest.raises(PermissionError):
        write_notes(tmp_path / "out", overwrite=True)
    assert tree(tmp_path) == {"out": "folder", "out/notes.txt": b"former"}


# Plans


def save_whole(folder: Path, seed: int = 0) -> None:
    with output_folder(folder, PLAN, overwrite=True) as draft:
        save_plan(make_plan(seed=seed), draft)
        save_episode(make_plan(seed=seed), draft / "lerobot", commands=make_plan(seed=seed).joints[:4])


def test_a_plan_folder_is_recognised_and_replaced(tmp_path):
    save_whole(tmp_path / "plan")
    save_whole(tmp_path / "plan", seed=1)
    assert_equal(load_plan(tmp_path / "plan")[0], make_plan(seed=1))
    assert PLAN.holds(tmp_path / "plan")
    assert EPISODE.holds(tmp_path / "plan/lerobot")


@pytest.mark.parametrize("linked", [True, False])
def test_a_clone_named_lerobot_is_kept(tmp_path, linked):
    make_clone(tmp_path / "clone" if linked else tmp_path / "lerobot")
    if linked:
        (tmp_path / "lerobot").symlink_to(tmp_path / "clone")
    before = tree(tmp_path)
    with pytest.raises(ValueError, match="no plan of ours"):
        save_whole(tmp_path)
    with pytest.raises(ValueError, match="no episode of ours"):
        save_episode(make_plan(), tmp_path / "lerobot", commands=np_zeros())
    assert tree(tmp_path) == before


def np_zeros():
    return make_plan().joints[:4] * 0


def test_a_recorded_data_set_is_no_planned_episode(folder):
    before = tree(folder)
    with pytest.raises(ValueError, match="no episode of ours"):
        save_episode(make_plan(), folder, commands=np_zeros())
    assert tree(folder) == before


def test_a_table_of_somebody_else_is_kept(tmp_path):
    (tmp_path / "joints.csv").write_text("mine")
    with pytest.raises(ValueError, match=r"joints.csv is not that of a plan, and is kept"):
        save_plan(make_plan(), tmp_path)
    assert tree(tmp_path) == {"joints.csv": b"mine"}


# Files


def test_a_file_that_is_not_ours_is_kept(tmp_path):
    marks = {"noun": "evaluation", "marks": (b'"provenance"',)}
    validate_output_file(tmp_path / "new.json", **marks)
    (tmp_path / "ours.json").write_text('{"provenance": {}}')
    validate_output_file(tmp_path / "ours.json", **marks)
    (tmp_path / "mine.json").write_text("{}")
    with pytest.raises(ValueError, match="is there already, is no evaluation of ours and is kept: give another name"):
        validate_output_file(tmp_path / "mine.json", **marks)
    with pytest.raises(ValueError, match="is a folder: give the name of a file"):
        validate_output_file(tmp_path, **marks)
    with pytest.raises(ValueError, match=r"which ends in .mp4: give such a name"):
        validate_output_file(tmp_path / "film.avi", "film", suffixes=(".mp4",))
