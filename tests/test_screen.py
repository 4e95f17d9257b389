"""Where there is no terminal a line now and then says how far the work is; where there is one, a bar."""

import io
import sys
from types import ModuleType, SimpleNamespace

import pytest
from rich.console import Console

from preimage.cli import screen
from preimage.cli import tensorboard as scalars
from preimage.cli.errors import what_is_kept


@pytest.fixture
def clock(monkeypatch):
    """A clock that the test turns."""
    now = [0.0]
    monkeypatch.setattr(screen.time, "monotonic", lambda: now[0])
    return now


def test_a_log_gets_a_line_now_and_then(clock, capsys, monkeypatch):
    monkeypatch.setattr(screen, "LINE_EVERY_S", 30.0)
    with screen.following("training", total=100) as follow:
        for done in range(1, 101):
            clock[0] = 2.0 * done
            follow(done=done, text=f"error {done}")
    assert capsys.readouterr().err.splitlines() == [
        "training: 15 of 100, about 2.8 minutes left; error 15",
        "training: 30 of 100, about 2.3 minutes left; error 30",
        "training: 45 of 100, about 1.8 minutes left; error 45",
        "training: 60 of 100, about 1.3 minutes left; error 60",
        "training: 75 of 100, about 50 s left; error 75",
        "training: 90 of 100, about 20 s left; error 90",
    ]


def test_a_work_that_goes_on_counts_the_time_of_what_it_did_itself(clock, capsys, monkeypatch):
    monkeypatch.setattr(screen, "LINE_EVERY_S", 30.0)
    with screen.following("training", total=100) as follow:
        for done in range(81, 101):
            clock[0] = 2.0 * (done - 80)
            follow(done=done)
    assert capsys.readouterr().err.splitlines() == ["training: 95 of 100, about 10 s left"]


def test_what_is_prepared_before_the_first_is_not_taken_for_its_time(clock, capsys, monkeypatch):
    """Goals are drawn for minutes before the first is planned to: "1 of 675, about 45 hours left"."""
    monkeypatch.setattr(screen, "LINE_EVERY_S", 30.0)
    with screen.following("calibrating", total=60) as follow:
        for done in range(1, 20):
            clock[0] = 240 + 2.0 * done
            follow(done=done)
    assert capsys.readouterr().err.splitlines() == ["calibrating: 1 of 60", "calibrating: 16 of 60, about 1.5 minutes left"]


def test_a_short_work_says_nothing_in_a_log(capsys):
    assert list(screen.followed("abc", "reading")) == ["a", "b", "c"]
    with screen.waiting("planning"):
        pass
    assert capsys.readouterr().err == ""


def test_a_long_search_says_that_it_goes_on(monkeypatch, capsys):
    monkeypatch.setattr(screen, "LINE_EVERY_S", 0.01)
    with screen.waiting("planning"):
        screen.time.sleep(0.2)
    assert capsys.readouterr().err.startswith("planning: 0 s so far\n")


def test_on_a_terminal_a_bar_moves_and_goes(monkeypatch):
    file = io.StringIO()
    monkeypatch.setattr(screen, "console", Console(file=file, force_terminal=True, width=100))
    with screen.following("training", total=2) as follow:
        follow(done=2, text="error 1")
    with screen.waiting("planning"):
        pass
    assert "training  error 1" in file.getvalue()
    assert "2/2" in file.getvalue()
    assert "planning" in file.getvalue()


def test_other_processes_than_the_first_show_nothing(capsys):
    with screen.following("training", total=1, shown=False) as follow:
        follow(done=1)
    assert capsys.readouterr().err == ""


def test_what_is_kept_of_an_interrupted_training_is_what_lies_there(tmp_path):
    words = ["data", "--out", str(tmp_path)]
    assert what_is_kept("train", words) == "nothing was written"
    (tmp_path / "config.json").touch()
    assert what_is_kept("train", words) == f"{tmp_path} has no checkpoint yet, and --resume begins again"
    (tmp_path / "resume.pt").touch()
    assert what_is_kept("train", words) == "what was saved is kept, and --resume goes on with it"
    assert what_is_kept("plan", words) == "nothing was written"
    assert what_is_kept("reproduce", []) == "what is done is kept, and the same command goes on"


def test_the_errors_go_to_tensorboard_from_the_update_that_is_gone_on_with(tmp_path, monkeypatch):
    added = []

    class Writer:
        def __init__(self, folder: str, purge_step: int) -> None:
            added.append((folder, purge_step))

        def add_scalar(self, name: str, value: float, step: int) -> None:
            added.append((name, value, step))

        def close(self) -> None:
            added.append("closed")

    module = ModuleType("torch.utils.tensorboard")
    module.__dict__["SummaryWriter"] = Writer
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", module)
    add = scalars.scalars_to(tmp_path)
    for update in (3, 4):
        add(SimpleNamespace(update=update, updates=4, visual=2.0, proprioceptive=0.5, seconds=0.1))
    of_one = [("error/visual", 2.0), ("error/proprioceptive", 0.5), ("seconds", 0.1)]
    assert added == [(str(tmp_path / "tensorboard"), 3), *((*each, step) for step in (3, 4) for each in of_one), "closed"]


def test_without_tensorboard_it_is_said_what_to_install(monkeypatch):
    monkeypatch.setattr(scalars, "find_spec", lambda name: None)
    with pytest.raises(ValueError, match=r"pip install 'preimage\[tensorboard\]', or leave it out"):
        scalars.validate_tensorboard()
