"""A file is there as a whole, or as it was before."""

from pathlib import Path

import pytest

from preimage.storage.atomic_write import atomic_write


def test_what_was_written_is_there_and_nothing_else(tmp_path):
    with atomic_write(tmp_path / "new" / "a.txt") as path:
        path.write_text("all of it")
        assert not (tmp_path / "new" / "a.txt").exists()
    assert (tmp_path / "new" / "a.txt").read_text() == "all of it"
    assert len(list((tmp_path / "new").iterdir())) == 1


def break_off(path: Path, error: BaseException | type[BaseException]) -> None:
    """Write half of a file, then fail."""
    with atomic_write(path) as unfinished:
        unfinished.write_text("ha")
        raise error


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError, OSError(28, "No space left on device"), RuntimeError("unexpected pos")])
def test_an_error_leaves_what_was_there_before(tmp_path, error):
    (tmp_path / "a.txt").write_text("before")
    with pytest.raises((KeyboardInterrupt, ValueError, OSError)):
        break_off(tmp_path / "a.txt", error)
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("a.txt", "before")]


def test_a_full_disk_names_the_file_and_the_reason(tmp_path):
    with pytest.raises(OSError, match=r"a.txt could not be written \(No space left on device\); what was saved before is kept"):
        break_off(tmp_path / "a.txt", OSError(28, "No space left on device"))


def test_a_full_disk_is_an_oserror_when_torch_tells_it_by_a_runtime_error(tmp_path):
    torch_says = RuntimeError("[enforce fail at inline_container.cc:672] . unexpected pos 704 vs 598\nand a long trace")
    with pytest.raises(OSError, match=r"unexpected pos 704 vs 598\)"):
        break_off(tmp_path / "a.pt", torch_says)
