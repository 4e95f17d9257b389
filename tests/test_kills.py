"""Killed at any moment, a verb leaves what was there before it or what it makes; a training goes on to the same bits.

The commands are forked from a process that has everything loaded (`fuzz.Program`), so that a kill falls into what they do, and not into
the seconds in which torch is loaded.
"""

import os
import re
import shutil
import signal
from pathlib import Path
from random import Random

import pytest

from fuzz import Program
from test_output_folders import tree

pytestmark = [pytest.mark.slow, pytest.mark.skipif(not hasattr(os, "fork"), reason="the commands run in forked processes")]

TRAIN = ["train", "ours", "--out", "new", "--size", "tiny", "--updates", "6", "--checkpoint-every", "2", "--batch-size", "2"]
BITS = ("model.safetensors", "shown.npz")
"""What has to be equal in every bit; the others hold seconds, and the command line."""
PLAN = ["plan", "run", "--goal", "ours:1", "--out", "new", "--iterations", "1"]
EVALUATE = ["evaluate", "run", "--goals", "1", "--out", "new.json", "--iterations", "1"]


@pytest.fixture(scope="module")
def program():
    program = Program()
    yield program
    program.close()


@pytest.fixture
def place(program, tmp_path):
    """A folder with all the inputs, and a temporary folder."""
    for source in program.inputs.iterdir():
        shutil.copytree(source, tmp_path / source.name) if source.is_dir() else shutil.copy(source, tmp_path)
    return tmp_path


def names(place: Path) -> set[str]:
    """All that is there but for what the next run removes."""
    return {name for name in tree(place) if not re.search(r"(^|/)\.[^/]*\.(part|former)(/|$)", name)}


def clear(place: Path) -> None:
    """Without what a verb made."""
    for path in place.glob("new*"):
        shutil.rmtree(path) if path.is_dir() else path.unlink()


def test_killed_at_random_moments_a_training_ends_with_the_same_bits(program, place, pytestconfig):
    """From before its folder is there to its model card, by SIGKILL, SIGTERM or Ctrl-C, and resumed until it is done."""
    chance, run, words = Random(0), place / "new", TRAIN
    reference = program.run(words, place)
    assert reference.code == 0, reference.err
    run.rename(place / "whole")
    whole = tree(place / "whole")
    kills = done = 0
    while kills < pytestconfig.getoption("--kills"):
        by = chance.choice([signal.SIGKILL, signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
        resumed = [*words, "--resume"] if run.exists() else words
        ended = program.run(resumed, place, by=by, after_s=chance.uniform(0, reference.seconds))
        assert ended.code in ({0, -by} if by == signal.SIGKILL else {0, 1, -by}), ended.err
        kills += ended.code != 0
        if ended.code == 0 or chance.random() < 0.1:
            ended = program.run([*words, "--resume"] if run.exists() else words, place)
            assert ended.code == 0, ended.err
            assert all(tree(run)[name] == whole[name] for name in BITS)
            assert set(tree(run)) == set(whole)
            shutil.rmtree(run)
            done += 1
    ended = program.run([*words, "--resume"] if run.exists() else words, place)
    assert ended.code == 0, ended.err
    assert set(tree(run)) == set(whole)
    assert all(tree(run)[name] == whole[name] for name in BITS)
    print(f"{kills} kills, {done + 1} trainings brought to their end, each with the same bits")


@pytest.mark.parametrize(
    ("words", "again"),
    [
        (["record", "reach", "--count", "2", "--pixels", "32", "--out", "new"], None),
        (PLAN, [*PLAN, "--overwrite"]),
        (EVALUATE, EVALUATE),
        (["execute", "plan", "--film", "new.gif"], ["execute", "plan", "--film", "new.gif"]),
        (["check", "ours", "--out", "new.html"], ["check", "ours", "--out", "new.html"]),
    ],
    ids=lambda words: words and words[0],
)
def test_a_killed_verb_leaves_what_was_there_or_what_it_makes(program, place, pytestconfig, words, again):
    """`again` is how it is said where its output is there already; None where that is removed first."""
    chance, before = Random(0), names(place)
    reference = program.run(words, place)
    assert reference.code == 0, reference.err
    whole = names(place)
    for _ in range(pytestconfig.getoption("--kills") // 2):
        if not again:
            clear(place)
        program.run(again or words, place, after_s=chance.uniform(0, reference.seconds))
        assert names(place) in (whole, before)
    if not again:
        clear(place)
    ended = program.run(again or words, place)
    assert ended.code == 0, ended.err
    assert set(tree(place)) == whole


def test_a_killed_report_leaves_files_that_are_whole(program, place, pytestconfig):
    """It writes several, each at once; the next one writes those that are missing."""
    chance, before, words = Random(0), names(place), ["report", "--results", "results", "--out", "new.md", "--readme", "README.md"]
    reference = program.run(words, place)
    assert reference.code == 0, reference.err
    whole = tree(place)
    for _ in range(pytestconfig.getoption("--kills") // 2):
        for name in set(whole) - before:
            if (place / name).is_file():
                (place / name).unlink()
        program.run(words, place, after_s=chance.uniform(0, reference.seconds))
        assert all(tree(place)[name] == whole[name] for name in names(place))
    ended = program.run(words, place)
    assert ended.code == 0, ended.err
    assert tree(place) == whole
