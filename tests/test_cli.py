"""The command line: every verb runs from end to end, and neither a full disk nor Ctrl-C loses anything."""

import json
import shutil
import signal
import subprocess
import sys

import numpy as np
import pytest
from PIL import Image

import preimage
from preimage import cli
from preimage.data.dataset import describe
from preimage.method import train as training
from preimage.storage.runs import BUNDLED, find_run
from shared import make_demonstration

QUICK = ["--iterations", "2", "--horizon", "4"]


@pytest.mark.parametrize("verb", [[], *([verb] for verb in cli.VERBS)], ids=lambda words: " ".join(words) or "preimage")
def test_help_of_every_verb_is_printed(capsys, verb):
    with pytest.raises(SystemExit) as left:
        cli.main([*verb, "--help"])
    told = capsys.readouterr()
    assert (left.value.code, told.err) == (0, "")
    assert "usage: preimage" in told.out


def test_record_writes_what_train_reads(capsys, tmp_path):
    cli.main(["record", "reach", "--count", "2", "--seed", "3", "--out", str(tmp_path / "data")])
    assert "2 demonstrations" in capsys.readouterr().out
    recorded = preimage.load(tmp_path / "data")
    again = preimage.record(preimage.Arm(), preimage.Reach(), count=2, seed=3)
    for one, other in zip(recorded, again, strict=True):
        np.testing.assert_array_equal(one.frames, other.frames)


def test_a_model_of_smaller_frames_is_evaluated_in_such(capsys, tmp_path):
    cli.main(["record", "reach", "--count", "2", "--pixels", "32", "--out", str(tmp_path / "data")])
    assert preimage.load(tmp_path / "data")[0].frames.shape[1:] == (32, 32, 1)
    cli.main(["train", str(tmp_path / "data"), "--out", str(tmp_path / "run"), "--size", "tiny", "--updates", "1"])
    cli.main(["evaluate", str(tmp_path / "run"), "--goals", "1", "--out", str(tmp_path / "result.json"), *QUICK])
    assert json.loads((tmp_path / "result.json").read_text())["pixels"] == 32


def test_small_frames_that_no_ladder_fits_are_brought_to_one(capsys, tmp_path):
    preimage.save([make_demonstration(size=(30, 50, 1)) for _ in range(2)], tmp_path / "data", task="reach")
    cli.main(["train", str(tmp_path / "data"), "--out", str(tmp_path / "run"), "--size", "tiny", "--updates", "1"])
    assert ": 50x30, seen at 48x32, in grey" in capsys.readouterr().out


def test_train_leaves_a_run_that_says_everything_about_itself(run_folder):
    names = {path.name for path in run_folder.iterdir()}
    assert names >= {"config.json", "model.safetensors", "resume.pt", "log.jsonl", "shown.npz", "README.md", "learning_curve.png"}
    assert not [name for name in names if name.endswith(".part")]
    config = json.loads((run_folder / "config.json").read_text())
    assert (config["size"], config["num_demonstrations"], config["task"], config["train"]["updates"]) == ("tiny", 3, "reach", 2)
    assert [json.loads(line)["update"] for line in (run_folder / "log.jsonl").read_text().splitlines()] == [1, 2]
    assert "2 of 2" in (run_folder / "README.md").read_text()


def test_one_demonstration_is_learned_and_planned_with_and_told_as_one(capsys, tmp_path):
    preimage.save([make_demonstration()], tmp_path / "data", task="reach")
    cli.main(["train", str(tmp_path / "data"), "--out", str(tmp_path / "run"), "--size", "tiny", "--updates", "1"])
    told = capsys.readouterr().out
    assert ": 1 episode, 6 steps at" in told
    assert "trained on 1 demonstration;" in told
    assert "trained on 1 demonstration\n" in (tmp_path / "run/README.md").read_text()
    cli.main(["plan", str(tmp_path / "run"), "--goal", f"{tmp_path}/data:0", "--out", str(tmp_path / "plan"), *QUICK])
    assert " at step" in capsys.readouterr().out


def test_texts_name_every_bundled_model(capsys, refused):
    with pytest.raises(SystemExit):
        cli.main(["demo", "--help"])
    assert f"which of the bundled models: {' or '.join(BUNDLED)}" in " ".join(capsys.readouterr().out.replace("│", " ").split())
    assert refused("demo", "--task", "juggle")[1] == f"there is no bundled model of juggle; there are {', '.join(BUNDLED)}"
    assert {folder.name for folder in find_run(BUNDLED[0]).parent.iterdir()} == set(BUNDLED)


def test_a_plan_to_an_episode_can_be_executed_and_judged(capsys, run_folder, data, tmp_path):
    cli.main(["plan", str(run_folder), "--goal", f"{data}:1", "--start", f"{data}:1", "--out", str(tmp_path / "plan"), *QUICK])
    assert " at step" in capsys.readouterr().out
    plan, scene = preimage.load_plan(tmp_path / "plan")
    assert scene == preimage.load(data)[1].scene
    assert (len(plan), plan.frames.shape[1:]) == (4, (64, 64, 1))
    assert (tmp_path / "plan" / "imagined.mp4").is_file()
    assert (tmp_path / "plan" / "imagined.png").is_file()
    cli.main(["execute", str(tmp_path / "plan"), "--film", str(tmp_path / "film.gif")])
    assert "cm from the goal" in capsys.readouterr().out
    assert (tmp_path / "film.gif").is_file()


def test_a_plan_to_several_goals_is_one_plan_that_can_be_executed(capsys, run_folder, data, tmp_path):
    goals = [f"{data}:0", f"{data}:2", f"{data}:1"]
    cli.main(["plan", str(run_folder), "--goal", *goals, "--start", f"{data}:1", "--out", str(tmp_path / "plan"), *QUICK])
    printed = capsys.readouterr().out.splitlines()
    plan, scene = preimage.load_plan(tmp_path / "plan")
    steps = [int(line.split("after ")[1].split()[0]) for line in printed[:3]]
    assert [line[:11] for line in printed[:3]] == [f"goal {number} of 3" for number in (1, 2, 3)]
    assert plan.arrival_step == sum(steps)
    assert scene == preimage.load(data)[1].scene
    np.testing.assert_array_equal(plan.goal.frame, preimage.load(data)[1].last.frame)
    cli.main(["execute", str(tmp_path / "plan")])
    assert "cm from the goal" in capsys.readouterr().out


def test_joints_of_one_goal_among_several_are_told(refused, run_folder, data, tmp_path):
    words = "--goal-joints", 0, 0, 0, 0, "--modalities", "joints"
    code, sentence = refused("plan", run_folder, "--goal", f"{data}:0", f"{data}:1", "--out", tmp_path / "plan", *words)
    assert (code, sentence) == (2, "--goal-joints are the joints of one goal, and --goal names 2: plan to one goal, or without joints")


def test_a_plan_leaves_an_episode_that_keeps_to_the_limits(capsys, run_folder, data, tmp_path):
    home = float(np.mean([one.joints[0, 0] for one in preimage.load(data)]))
    limits = {"joint1": {"lower": home - 0.001, "upper": home + 0.001, "step": 0.0005}}
    (tmp_path / "limits.json").write_text(json.dumps(limits))
    late = ["--delay-penalty", "0.01"]  # a network that knows nothing arrives at once
    words = ["plan", str(run_folder), "--goal", f"{data}:1", "--out", str(tmp_path / "plan"), *QUICK, *late]
    cli.main([*words, "--joint-limits", str(tmp_path / "limits.json"), "--rate-hz", "2.5"])
    assert "joint1 kept above " in capsys.readouterr().out
    (episode,) = preimage.load(tmp_path / "plan" / "lerobot")
    table = np.loadtxt(tmp_path / "plan" / "joints.csv", delimiter=",", skiprows=1, ndmin=2)[:, 1:]
    for commands in (episode.joints[:, 0], table[:, 0]):
        assert np.abs(commands - home).max() <= 0.001 + 1e-6
        assert np.abs(np.diff(commands)).max(initial=0) <= 0.0005 + 2e-6
    assert (episode.joint_names, episode.rate_hz) == (preimage.load(data)[0].joint_names, 2.5)
    assert describe(tmp_path / "plan" / "lerobot").joint_unit == "rad"
    cli.main([*words, "--overwrite"])  # into the same folder, without the file
    assert "joint1 kept above" not in capsys.readouterr().out
    assert preimage.load(tmp_path / "plan" / "lerobot")[0].rate_hz == 10  # by default that of the recordings


def test_plan_to_an_image_file(run_folder, demonstrations, tmp_path):
    Image.fromarray(demonstrations[0].last.frame[..., 0]).save(tmp_path / "goal.png")
    cli.main(["plan", str(run_folder), "--goal", str(tmp_path / "goal.png"), "--out", str(tmp_path / "plan"), *QUICK])
    plan, scene = preimage.load_plan(tmp_path / "plan")
    np.testing.assert_array_equal(plan.goal.frame, demonstrations[0].last.frame)
    assert (plan.goal.joints, scene) == (None, None)


def test_plan_to_joint_angles(run_folder, data, tmp_path):
    shown = preimage.load(data)[0].last.joints.tolist()
    joints = ["--goal-joints", *map(str, shown), "--modalities", "joints"]
    cli.main(["plan", str(run_folder), "--goal", f"{data}:0", *joints, "--out", str(tmp_path / "plan"), *QUICK])
    assert preimage.load_plan(tmp_path / "plan")[0].goal.joints.tolist() == shown


def test_evaluate_writes_counts_and_baselines(capsys, run_folder, tmp_path):
    words = ["--task", "reach", "--goals", "2", "--seed", "9", "--out", str(tmp_path / "result.json"), "--iterations", "1"]
    cli.main(["evaluate", str(run_folder), *words])
    result = json.loads((tmp_path / "result.json").read_text())
    wanted = "task model size num_demonstrations goals seed loop success interval deviation_cm seconds_per_plan rows baselines provenance"
    assert set(wanted.split()) <= set(result)
    assert (result["goals"], result["seed"], len(result["rows"])) == (2, 9, 2)
    printed = capsys.readouterr().out.splitlines()
    assert result["baselines"]["memory_alone"]["deviation_cm"] != result["baselines"]["do_nothing"]["deviation_cm"]
    baselines = ["do_nothing", "nearest_demonstration", "memory_alone", "prior_mean"]
    assert [line.split()[0] for line in printed] == ["preimage", *baselines]


# Full disks and Ctrl-C

FULL_DISK = """
import resource, sys
from preimage import cli
import preimage.method.train as training

def fill(told):
    if told.update == 2:
        resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, resource.RLIM_INFINITY))

plain = training.train
training.train = lambda *arguments, progress, **words: plain(*arguments, **words, progress=lambda told: (progress(told), fill(told)))
cli.main(sys.argv[1:])
"""


@pytest.mark.slow
def test_a_full_disk_while_saving_loses_nothing(data, tmp_path):
    run = tmp_path / "run"
    words = "train", data, "--out", run, "--size", "tiny", "--updates", "3", "--checkpoint-every", "1"
    outcome = subprocess.run([sys.executable, "-c", FULL_DISK, *map(str, words)], capture_output=True, text=True, check=False)
    assert outcome.returncode == 1, outcome.stderr
    *_, sentence = outcome.stderr.splitlines()
    assert sentence.startswith(f"preimage: {run}/model.safetensors could not be written (")
    assert "Traceback" not in outcome.stderr
    assert not list(run.glob(".*.part"))
    assert preimage.load_model(run) is not None  # of the first update
    cli.main(["train", str(data), "--out", str(run), "--resume"])
    assert [json.loads(line)["update"] for line in (run / "log.jsonl").read_text().splitlines()] == [1, 2, 3]


def test_a_full_disk_while_planning_is_told(refused, run_folder, data, tmp_path, monkeypatch):
    def full(*_arguments, **_words):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez_compressed", full)
    code, sentence = refused("plan", run_folder, "--goal", f"{data}:0", "--out", tmp_path / "plan", *QUICK)
    assert code == 1
    assert "No space left on device" in sentence
    assert "Errno" not in sentence
    assert not list(tmp_path.iterdir())


def test_ctrl_c_saves_and_the_run_can_be_resumed(data, tmp_path, capsys, monkeypatch):
    plain = training.train

    def interrupted(*arguments, progress, **words):
        return plain(*arguments, **words, progress=lambda told: (progress(told), signal.raise_signal(signal.SIGINT)))

    run = tmp_path / "run"
    monkeypatch.setattr(training, "train", interrupted)
    with pytest.raises(SystemExit) as left:
        cli.main(["train", str(data), "--out", str(run), "--size", "tiny", "--updates", "2"])
    assert left.value.code == 1
    assert capsys.readouterr().err.splitlines()[-1] == "preimage: interrupted; what was saved is kept, and --resume goes on with it"
    monkeypatch.undo()
    cli.main(["train", str(data), "--out", str(run), "--resume", "--updates", "5", "--learning-rate", "0.5"])
    told = capsys.readouterr().out
    assert f"{run} goes on with the settings it was started with; those given now are left aside" in told
    assert f"{run} goes on to 5 updates instead of 2" in told
    config = json.loads((run / "config.json").read_text())["train"]
    assert (config["updates"], config["learning_rate"]) == (5, preimage.TrainConfig.learning_rate)
    assert [json.loads(line)["update"] for line in (run / "log.jsonl").read_text().splitlines()] == [1, 2, 3, 4, 5]


def test_fewer_updates_than_a_run_has_are_refused(refused, run_folder, data):
    code, sentence = refused("train", data, "--out", run_folder, "--resume", "--updates", 1)
    assert (code, sentence) == (2, f"{run_folder} has 2 updates already: give --updates 2 or more")


@pytest.mark.skipif(shutil.which("bash") is None, reason="completes words in bash")
@pytest.mark.parametrize(
    ("words", "completed"),
    [
        (["pl"], ["plan"]),
        (["record", "--p"], ["--pixels"]),
        (["train", "--hold"], ["--hold-out"]),
        (["plan", "reach", "READ"], ["README.md"]),
    ],
)
def test_words_are_completed_in_a_shell(capsys, tmp_path, words, completed):
    with pytest.raises(SystemExit):
        cli.main(["--completion"])
    (tmp_path / "README.md").touch()
    typed = " ".join(["preimage", *words])
    script = f'{capsys.readouterr().out}\nCOMP_WORDS=({typed}); COMP_CWORD={len(words)}; _preimage; printf "%s\\n" "${{COMPREPLY[@]}}"'
    told = subprocess.run(["bash", "-c", script], capture_output=True, text=True, check=True, cwd=tmp_path)
    assert told.stdout.split() == completed
