"""Whose fault it is: a user's error in one sentence, an error of ours named as ours, an interruption in true words."""

import json
import os
import re

import numpy as np
import pytest

import preimage
from preimage import cli
from preimage.method.learner import NonFinite
from test_output_folders import make_clone, tree

QUICK = ["--iterations", "1", "--horizon", "4"]


@pytest.fixture
def failing(monkeypatch, refused, tmp_path):
    """Runs a verb whose work ends with an error."""

    def run(work) -> tuple[int, str]:
        monkeypatch.setattr("preimage.storage.plans.load_plan", lambda _folder: work())
        return refused("execute", tmp_path)

    return run


def raise_(error: BaseException):
    raise error


@pytest.mark.parametrize(
    "work",
    [
        lambda: int("seven"),  # out of an expression
        lambda: json.loads("{"),  # out of a library
        lambda: np.zeros(3).reshape(2, 2),
        lambda: {}["goal"],
        lambda: preimage.Plan(),
        lambda: raise_(AssertionError("what only we can cause")),
        lambda: raise_(ValueError("raised by somebody else")),
        lambda: raise_(RuntimeError("a long\ntext of a library")),
        lambda: raise_(RecursionError()),
    ],
)
def test_an_error_inside_preimage_is_named_as_ours(failing, work):
    code, sentence = failing(work)
    assert code == 1
    assert re.match(r"an error inside preimage \(\w+.*\): it is not yours; please report it ", sentence)
    trace = sentence.rsplit(" ", 1)[1]
    with open(trace) as file:
        assert "Traceback" in file.read()
    os.unlink(trace)


def test_what_failed_is_told_in_its_own_words(failing):
    assert failing(lambda: raise_(NonFinite("the visual error is not finite"))) == (1, "the visual error is not finite")
    assert failing(lambda: raise_(OSError(28, "No space left on device", "a.json"))) == (1, "a.json: No space left on device")
    assert failing(lambda: raise_(MemoryError()))[0] == 1
    assert failing(lambda: raise_(KeyboardInterrupt())) == (1, "interrupted; nothing was written")


@pytest.mark.parametrize("name", [os.fsdecode(b"run \xff"), "nul\0"])
def test_a_name_that_is_no_text_is_told_before_anything_is_done(refused, data, tmp_path, name):
    code, sentence = refused("train", data, "--out", f"{tmp_path}/{name}", "--size", "tiny", "--updates", 1)
    assert code == 2
    assert sentence.endswith("is no text in UTF-8: rename the file or folder") or "holds a character of number 0" in sentence
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["evaluate", "reach", "--goals", -1], "--goals is -1: give 1 to "),
        (["evaluate", "reach", "--goals", 10**30], f"--goals is {10**30}: give 1 to "),
        (["evaluate", "reach", "--seed", -1], "--seed is -1: give a whole number from 0"),
        (["evaluate", "reach", "--seed", 10**30], f"--seed is {10**30}: give a whole number from 0"),
        (["demo", "--goals", 0], "--goals is 0: give 1 to "),
        (["record", "reach", "--count", 1, "--seed", 10**30], f"--seed is {10**30}: give a whole number"),
        (["train", "DATA", "--seed", 10**20], f"seed (--seed) is {10**20}: give 1000000000 or less"),
        (["train", "DATA", "--updates", 10**30], "or less"),
        (["plan", "reach", "--goal", "DATA:0", "--horizon", 10**12], f"horizon (--horizon) is {10**12}: give 100000 or less"),
        (["plan", "reach", "--goal", "DATA:0", "--rate-hz", "nan"], "--rate-hz is nan: give 0.2 to 1000 rows a second"),
        (["plan", "reach", "--goal", "DATA:0", "--rate-hz", 1e-9], "--rate-hz is 1e-09: give 0.2 to 1000 rows a second"),
    ],
)
def test_numbers_beyond_reason(refused, data, tmp_path, words, sentence):
    words = [str(word).replace("DATA", str(data)) for word in words]
    code, told = refused(*words, "--out", tmp_path / "out")
    assert code == 2
    assert sentence in told
    assert not list(tmp_path.iterdir())


# Joints of a goal


def test_degrees_for_radians_are_told_with_the_range(refused, data, run_folder, tmp_path):
    joints = "--modalities", "joints", "--goal-joints", 100, 100, 100, 100
    code, sentence = refused("plan", run_folder, "--goal", f"{data}:0", *joints, "--out", tmp_path / "plan")
    assert code == 2
    assert re.fullmatch(r"--goal-joints has joint1 at 100: it was demonstrated from \S+ to \S+ rad; 100 degrees are 1.745 rad", sentence)
    assert not list(tmp_path.iterdir())


def test_an_episode_out_of_range_is_told(refused, data, run_folder, tmp_path):
    demonstration = preimage.load(data)[0]
    far = preimage.Demonstration(demonstration.frames, demonstration.joints + 1.5, 10.0, demonstration.joint_names)
    preimage.save([far], tmp_path / "far", task="reach")
    code, sentence = refused("plan", run_folder, "--goal", f"{tmp_path}/far:0", "--modalities", "both", "--out", tmp_path / "plan")
    assert code == 2
    assert sentence.startswith("--goal has joint1 at ")


# What lies where a plan is to be written


def test_a_plan_beside_a_clone_is_refused_before_it_is_searched_for(refused, data, run_folder, tmp_path, monkeypatch):
    make_clone(tmp_path / "lerobot")
    monkeypatch.chdir(tmp_path)
    before = tree(tmp_path)
    for more in ([], ["--overwrite"]):
        code, sentence = refused("plan", run_folder, "--goal", f"{data}:0", "--out", ".", *more)
        assert code == 2
        assert "is not empty and is not replaced, for it is no plan of ours" in sentence
    assert tree(tmp_path) == before


def test_a_plan_is_replaced_only_when_asked_for(refused, capsys, data, run_folder, tmp_path):
    words = ["plan", str(run_folder), "--goal", f"{data}:0", "--out", str(tmp_path / "plan"), *QUICK]
    cli.main(words)
    capsys.readouterr()
    before = tree(tmp_path)
    code, sentence = refused(*words)
    assert (code, sentence) == (2, f"{tmp_path}/plan holds a plan already: give a new folder, or --overwrite to replace it")
    assert tree(tmp_path) == before
    cli.main([*words, "--overwrite"])
    assert set(tree(tmp_path)) == set(before)


def test_an_evaluation_does_not_replace_what_is_not_one(refused, tmp_path):
    (tmp_path / "mine.json").write_text("{}")
    code, sentence = refused("evaluate", "reach", "--goals", 1, "--out", tmp_path / "mine.json")
    assert (code, sentence) == (2, f"{tmp_path}/mine.json is there already, is no evaluation of ours and is kept: give another name")


@pytest.mark.parametrize(
    "edit",
    [
        {"positions_m": {}},
        {"positions_m": {"goal": [0.4, 0.1]}},
        {"positions_m": {"goal": [1e200, 0, 0]}},
        {"start_joints": [0.0]},
        {"start_joints": [9, 9, 9, 9]},
    ],
)
def test_a_plan_whose_scene_cannot_be_laid_out(refused, capsys, data, run_folder, tmp_path, edit):
    cli.main(["plan", str(run_folder), "--goal", f"{data}:0", "--out", str(tmp_path / "plan"), *QUICK])
    capsys.readouterr()
    about = json.loads((tmp_path / "plan/plan.json").read_text())
    about["scene"] |= edit
    (tmp_path / "plan/plan.json").write_text(json.dumps(about))
    code, sentence = refused("execute", tmp_path / "plan")
    assert code == 2
    assert sentence.startswith("the scene of reach ")
