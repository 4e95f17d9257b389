"""Recordings of someone else on the command line: what is seen of them, and what a plan for their arm leaves."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import preimage
from preimage import cli
from recordings import WRITERS, shade, shades

QUICK = ["--iterations", "2", "--horizon", "4"]


@pytest.fixture(scope="module", params=["v2.1", "plain"])
def foreign(request, tmp_path_factory) -> tuple[Path, Path]:
    """Recordings of someone else, 160x96 in colour, and what was trained on a part of each picture, the last episode held out."""
    place = tmp_path_factory.mktemp("foreign")
    data = WRITERS[request.param](place / "data", lengths=(5, 4, 6))
    words = ["--size", "tiny", "--updates", "2", "--hold-out", "3", "--view.crop", "0", "64", "96", "96", "--view.size", "32", "32"]
    cli.main(["train", str(data), "--out", str(place / "run"), *words])
    return data, place / "run"


def test_a_run_keeps_how_it_saw_its_recordings(foreign):
    view = json.loads((foreign[1] / "config.json").read_text())["view"]
    assert view == {
        "camera": None,
        "state": None,
        "joints": ["pan", "lift"],
        "crop": [0, 64, 96, 96],
        "size": [32, 32],
        "colour": "colour",
        "recorded": [96, 160],
        "wraps": [],
        "turns": [],
        "seams": [],
        "poles": [],
        "quaternions": [],
        "rotations": [],
        "rotation_turns": [],
        "rotation_poles": [],
    }


def test_training_tells_in_a_few_lines_what_it_sees(foreign, capsys, tmp_path):
    cli.main(["train", str(foreign[0]), "--out", str(tmp_path / "run"), "--size", "tiny", "--updates", "1"])
    *_, camera, joints, warnings, precision, trained = capsys.readouterr().out.splitlines()
    assert camera.endswith(": 160x96, seen at 64x32, in colour")
    assert warnings.endswith(f"preimage check {foreign[0]} says where, and what would help")
    assert precision.startswith("precision: ")
    assert joints == "2 of 3 joints: pan, lift; left out, for it does not move: frozen"
    assert trained.startswith("trained on 3 demonstrations;")


def test_a_goal_is_seen_as_the_recordings_were(foreign, tmp_path):
    """The same step as a file, as the file at twice the size, and as an episode of the data."""
    data, run = foreign
    frame = Image.fromarray(shades(1, 4, (96, 160))[-1])
    frame.save(tmp_path / "same.png")
    frame.resize((320, 192)).save(tmp_path / "twice.png")
    goals = []
    for number, goal in enumerate((tmp_path / "same.png", tmp_path / "twice.png", f"{data}:1")):
        cli.main(["plan", str(run), "--goal", str(goal), "--out", str(tmp_path / f"plan {number}"), *QUICK])
        goals.append(preimage.load_plan(tmp_path / f"plan {number}")[0].goal.frame.astype(int))
    assert goals[0].shape == (32, 32, 3)
    assert goals[0][16, 2].tolist() == [200, 20, 20]  # the crop begins in the red half, 16 pixels before its end
    assert goals[0][16, 20].tolist() == [shade(1, 3)] * 3
    for other in goals[1:]:
        np.testing.assert_allclose(other[:, 8:], goals[0][:, 8:], atol=4)


def test_held_out_recordings_are_seen_as_the_others_were(foreign, tmp_path):
    data, run = foreign
    cli.main(["evaluate", str(run), "--data", str(data), "--out", str(tmp_path / "result.json"), *QUICK])
    result = json.loads((tmp_path / "result.json").read_text())
    assert (result["episodes"], result["data"]["rest_was_trained_on"]) == ([2], True)
    assert list(result["imagined_by_joint"]) == ["pan", "lift"]


def test_an_episode_for_the_arm_holds_the_joints_that_were_left_out(foreign, tmp_path):
    data, run = foreign
    cli.main(["plan", str(run), "--start", f"{data}:0", "--goal", f"{data}:1", "--out", str(tmp_path / "plan"), *QUICK])
    (episode,) = preimage.load(tmp_path / "plan/lerobot")
    table = np.loadtxt(tmp_path / "plan/joints.csv", delimiter=",", skiprows=1, ndmin=2)
    assert episode.joint_names == ("pan", "frozen", "lift")
    assert set(episode.joints[:, 1]) == {0.5}
    np.testing.assert_allclose(episode.joints[: len(table), [0, 2]], table[:, 1:], atol=1e-6)


def test_a_run_goes_on_with_the_view_it_began_with(foreign, tmp_path):
    data, run = foreign
    shutil.copytree(run, tmp_path / "run")
    cli.main(["train", str(data), "--out", str(tmp_path / "run"), "--resume"])
    assert (tmp_path / "run/config.json").read_bytes() == (run / "config.json").read_bytes()


def test_goal_joints_of_a_joint_that_wraps_are_given_as_the_robot_reads_them(tmp_path):
    """The joint turns from 100 degrees on past 180 and reads -110 in the end, which the model knows as -260 to -110; 170 is -190 there."""
    folder = WRITERS["plain"](tmp_path / "data", lengths=(12, 12, 12), size=(32, 32))
    share = np.sin(np.linspace(0, np.pi / 2, 12))
    turned, lift = 100 + 150 * share, 40 * share**2
    for take in folder.glob("take *"):
        rows = [f"{(angle + 180) % 360 - 180},{height}" for angle, height in zip(turned, lift, strict=True)]
        (take / "joints.csv").write_text("\n".join(["pan,lift", *rows]) + "\n")
    cli.main(["train", str(folder), "--out", str(tmp_path / "run"), "--size", "tiny", "--updates", "1"])
    words = ["--modalities", "joints", "--goal-joints", "170", "30", "--out", str(tmp_path / "plan")]
    cli.main(["plan", str(tmp_path / "run"), "--goal", f"{folder}:0", *words, *QUICK])
    plan, _ = preimage.load_plan(tmp_path / "plan")
    assert plan.goal.joints == pytest.approx([-190, 30])
