"""The command line: every verb runs from end to end, and what a user can get wrong is told in one sentence."""

import json
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from PIL import Image

import preimage
from conftest import make_demonstration
from preimage import cli
from preimage.dataset import save
from recordings import WRITERS, shade, shades

DATA_FILE = "data/chunk-000/file-000.parquet"
QUICK = ["--iterations", "2", "--horizon", "4"]


@pytest.fixture
def refused(capsys):
    """Runs words that cannot work; the exit code and the sentence, after a check that it is one and that there is nothing else."""

    def run(*words: object) -> tuple[int, str]:
        with pytest.raises(SystemExit) as left:
            cli.main([str(word) for word in words])
        told = capsys.readouterr()
        assert told.out == ""
        assert told.err.startswith("preimage: ")
        assert told.err.count("\n") == 1
        assert told.err.endswith("\n")
        return left.value.code, told.err.removeprefix("preimage: ").strip()

    return run


@pytest.fixture
def other_data(tmp_path):
    """Writes a data set whose recordings are of another kind."""

    def write(**kind) -> Path:
        save([make_demonstration(seed, **kind) for seed in range(2)], tmp_path / "other", task="reach")
        return tmp_path / "other"

    return write


# What works


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


def test_train_leaves_a_run_that_says_everything_about_itself(run_folder):
    names = {path.name for path in run_folder.iterdir()}
    assert names >= {"config.json", "model.safetensors", "resume.pt", "log.jsonl", "shown.npz", "README.md", "learning_curve.png"}
    assert not [name for name in names if name.endswith(".part")]
    config = json.loads((run_folder / "config.json").read_text())
    assert (config["size"], config["num_demonstrations"], config["task"], config["train"]["updates"]) == ("tiny", 3, "reach", 2)
    assert [json.loads(line)["update"] for line in (run_folder / "log.jsonl").read_text().splitlines()] == [1, 2]
    assert "2 of 2" in (run_folder / "README.md").read_text()


def test_a_plan_to_an_episode_can_be_executed_and_judged(capsys, run_folder, data, tmp_path):
    cli.main(["plan", str(run_folder), "--goal", f"{data}:1", "--start", f"{data}:1", "--out", str(tmp_path / "plan"), *QUICK])
    assert "arrives at step" in capsys.readouterr().out
    plan, scene = preimage.load_plan(tmp_path / "plan")
    assert scene == preimage.load(data)[1].scene
    assert (len(plan), plan.frames.shape[1:]) == (4, (64, 64, 1))
    assert (tmp_path / "plan" / "imagined.mp4").is_file()
    assert (tmp_path / "plan" / "imagined.png").is_file()
    cli.main(["execute", str(tmp_path / "plan"), "--film", str(tmp_path / "film.gif")])
    assert "cm from the goal" in capsys.readouterr().out
    assert (tmp_path / "film.gif").is_file()


def test_plan_to_an_image_file(run_folder, demonstrations, tmp_path):
    Image.fromarray(demonstrations[0].last.frame[..., 0]).save(tmp_path / "goal.png")
    cli.main(["plan", str(run_folder), "--goal", str(tmp_path / "goal.png"), "--out", str(tmp_path / "plan"), *QUICK])
    plan, scene = preimage.load_plan(tmp_path / "plan")
    np.testing.assert_array_equal(plan.goal.frame, demonstrations[0].last.frame)
    assert (plan.goal.joints, scene) == (None, None)


def test_plan_to_joint_angles(run_folder, data, tmp_path):
    joints = ["--goal-joints", "0", "-0.5", "-2.5", "2", "--modalities", "joints"]
    cli.main(["plan", str(run_folder), "--goal", f"{data}:0", *joints, "--out", str(tmp_path / "plan"), *QUICK])
    assert preimage.load_plan(tmp_path / "plan")[0].goal.joints.tolist() == [0, -0.5, -2.5, 2]


def test_evaluate_writes_counts_and_baselines(capsys, run_folder, tmp_path):
    words = ["--task", "reach", "--goals", "2", "--seed", "9", "--out", str(tmp_path / "result.json"), "--iterations", "1"]
    cli.main(["evaluate", str(run_folder), *words])
    result = json.loads((tmp_path / "result.json").read_text())
    wanted = "task model size num_demonstrations goals seed loop success interval deviation_cm seconds_per_plan rows baselines provenance"
    assert set(wanted.split()) <= set(result)
    assert (result["goals"], result["seed"], len(result["rows"])) == (2, 9, 2)
    printed = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in printed] == ["preimage", "do_nothing", "nearest_demonstration", "prior_mean"]


@pytest.fixture(scope="module", params=["v2.1", "plain"])
def foreign(request, tmp_path_factory) -> tuple[Path, Path]:
    """Recordings of someone else, 160x96 in colour, and what was trained on a part of each picture."""
    place = tmp_path_factory.mktemp("foreign")
    data = WRITERS[request.param](place / "data")
    words = ["--size", "tiny", "--updates", "2", "--view.crop", "0", "64", "96", "96", "--view.size", "32", "32"]
    cli.main(["train", str(data), "--out", str(place / "run"), *words])
    return data, place / "run"


def test_a_run_keeps_how_it_saw_its_recordings(foreign):
    view = json.loads((foreign[1] / "config.json").read_text())["view"]
    assert view == {
        "camera": None,
        "joints": ["pan", "lift"],
        "crop": [0, 64, 96, 96],
        "size": [32, 32],
        "colour": "colour",
        "recorded": [96, 160],
    }


def test_training_tells_in_a_few_lines_what_it_sees(foreign, capsys, tmp_path):
    cli.main(["train", str(foreign[0]), "--out", str(tmp_path / "run"), "--size", "tiny", "--updates", "1"])
    *_, camera, joints, trained = capsys.readouterr().out.splitlines()
    assert camera.endswith(": 160x96, seen at 64x32, in colour")
    assert joints == "2 of 3 joints: pan, lift; left out, for they do not move: frozen"
    assert trained.startswith("trained on 2 demonstrations")


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


def test_a_run_goes_on_with_the_view_it_began_with(foreign, tmp_path):
    data, run = foreign
    shutil.copytree(run, tmp_path / "run")
    cli.main(["train", str(data), "--out", str(tmp_path / "run"), "--resume"])
    assert (tmp_path / "run/config.json").read_bytes() == (run / "config.json").read_bytes()


# What a user gets wrong


def test_words_that_are_off(capsys):
    for words in (["dance"], ["record"], ["record", "reach", "--count", "many", "--out", "x"], []):
        with pytest.raises(SystemExit) as left:
            cli.main(words)
        assert left.value.code == 2
        assert "Traceback" not in capsys.readouterr().err


def test_unknown_task(refused, tmp_path):
    assert refused("record", "juggle", "--count", 1, "--out", tmp_path / "x")[0] == 2
    assert "juggle is no task; known are reach" in refused("record", "juggle", "--count", 1, "--out", tmp_path / "x")[1]


def test_record_does_not_write_over_anything(refused, data):
    code, sentence = refused("record", "reach", "--count", 1, "--out", data)
    assert (code, sentence) == (2, f"{data} is there already: give a new folder")


@pytest.mark.parametrize(("count", "seed"), [(0, 0), (-3, 0), (1, -1)])
def test_record_of_nothing(capsys, tmp_path, count, seed):
    with pytest.raises(SystemExit) as left:
        cli.main(["record", "reach", "--count", str(count), "--seed", str(seed), "--out", str(tmp_path / "x")])
    assert left.value.code == 2
    assert "preimage: " in capsys.readouterr().err
    assert not (tmp_path / "x").exists()


def test_missing_data_set(refused, tmp_path):
    code, sentence = refused("train", tmp_path / "nowhere", "--out", tmp_path / "run")
    assert code == 2
    assert sentence == f"{tmp_path}/nowhere is not a folder: name one that holds a LeRobot data set"
    assert not (tmp_path / "run").exists()


def test_truncated_parquet(refused, other_data, tmp_path):
    file = other_data() / DATA_FILE
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    code, sentence = refused("train", tmp_path / "other", "--out", tmp_path / "run")
    assert code == 2
    assert "cannot be read as parquet" in sentence
    assert not (tmp_path / "run").exists()


def test_nan_in_the_joints_of_a_data_set(refused, other_data, tmp_path):
    file = other_data() / DATA_FILE
    table = pq.read_table(file)
    rows = table.to_pylist()
    rows[8]["observation.state"][1] = float("nan")
    pq.write_table(pa.Table.from_pylist(rows, schema=table.schema), file)
    code, sentence = refused("train", tmp_path / "other", "--out", tmp_path / "run")
    assert code == 2
    assert "episode 1: joints holds nan at step 2, joint " in sentence


def test_frames_of_other_proportions_than_the_models(refused, run_folder, other_data, tmp_path):
    data = other_data(size=(32, 48, 1), num_joints=4)
    code, sentence = refused("plan", run_folder, "--goal", f"{data}:0", "--out", tmp_path / "plan")
    assert code == 2
    assert sentence.endswith("is 48x32 pixels, the model sees 64x64: scale or crop it")
    assert not (tmp_path / "plan").exists()


def test_a_view_that_does_not_fit(refused, data, tmp_path):
    train = "train", data, "--out", tmp_path / "run", "--size", "tiny"
    assert (
        "the crop (0, 0, 65, 64) (top, left, height, width) does not lie in a picture of 64x64"
        in refused(*train, "--view.crop", 0, 0, 65, 64)[1]
    )
    assert "has no camera wrist" in refused(*train, "--view.camera", "wrist")[1]
    assert "has no joint elbow" in refused(*train, "--view.joints", "elbow")[1]


def test_frames_that_no_ladder_fits(refused, other_data, tmp_path):
    code, sentence = refused("train", other_data(size=(30, 30, 1)), "--out", tmp_path / "run", "--size", "tiny")
    assert code == 2
    assert "frames are 30x30" in sentence


def test_an_image_of_another_size_than_the_models_frames(refused, run_folder, tmp_path):
    Image.new("L", (640, 480)).save(tmp_path / "goal.png")
    code, sentence = refused("plan", run_folder, "--goal", tmp_path / "goal.png", "--out", tmp_path / "plan")
    assert (code, sentence) == (2, f"{tmp_path}/goal.png is 640x480 pixels, the model sees 64x64: scale or crop it")


def test_a_goal_that_is_no_image(refused, run_folder, tmp_path):
    (tmp_path / "goal.png").write_text("a cup on the left")
    code, sentence = refused("plan", run_folder, "--goal", tmp_path / "goal.png", "--out", tmp_path / "plan")
    assert (code, sentence) == (2, f"{tmp_path}/goal.png is not an image that can be read: give a PNG or JPEG file")


def test_a_goal_that_is_nowhere(refused, run_folder, tmp_path):
    assert "is neither an image file nor a step of a data set" in refused("plan", run_folder, "--goal", "cup.png", "--out", tmp_path)[1]


@pytest.mark.usefixtures("unchecked")
def test_five_joints_for_a_model_of_four(refused, run_folder, data, other_data, tmp_path):
    plan = "plan", run_folder, "--out", tmp_path / "plan"
    five = other_data(num_joints=5)
    code, sentence = refused(*plan, "--goal", f"{data}:0", "--start", f"{five}:0")
    assert (code, sentence) == (2, f"{five} has no joint joint1: it has joint 0, joint 1, joint 2, joint 3, joint 4")
    joints = "--goal-joints", 0, 0, 0, 0, 0, "--modalities", "joints"
    assert refused(*plan, "--goal", f"{data}:0", *joints) == (2, "the goal has 5 joints, the model was trained with 4")


def test_nan_in_the_joints_of_a_goal(refused, run_folder, data, tmp_path):
    joints = "--goal-joints", 0, "nan", 0, 0, "--modalities", "joints"
    code, sentence = refused("plan", run_folder, "--goal", f"{data}:0", *joints, "--out", tmp_path / "plan")
    assert (code, sentence) == (2, "the goal's joints are not finite: [0.0, nan, 0.0, 0.0]")


@pytest.mark.parametrize(
    ("option", "value", "least"),
    [
        ("updates", 0, "1 or more"),
        ("batch-size", 0, "1 or more"),
        ("warmup-updates", 0, "1 or more"),
        ("checkpoint-every", 0, "1 or more"),
        ("rest-steps", -1, "0 or more"),
        ("seed", -1, "0 or more"),
        ("learning-rate", "nan", "a number above 0"),
        ("learning-rate", "inf", "a number above 0"),
        ("intention-learning-rate", 0.0, "a number above 0"),
        ("open-loop-share", 1.5, "a share between 0 and 1"),
    ],
)
def test_settings_of_training_out_of_range(refused, data, tmp_path, option, value, least):
    code, sentence = refused("train", data, "--out", tmp_path / "run", f"--{option}", value)
    assert (code, sentence) == (2, f"--{option} is {value}: give {least}")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("option", "value", "least"),
    [
        ("candidates", 0, "1 or more"),
        ("iterations", -1, "0 or more"),
        ("horizon", 0, "1 or more"),
        ("delay-penalty", 0.0, "a number above 0"),
    ],
)
def test_settings_of_the_search_out_of_range(refused, run_folder, data, tmp_path, option, value, least):
    code, sentence = refused("plan", run_folder, "--goal", f"{data}:0", "--out", tmp_path / "plan", f"--{option}", value)
    assert (code, sentence) == (2, f"--{option} is {value}: give {least}")
    code, sentence = refused("evaluate", run_folder, "--out", tmp_path / "result.json", f"--{option}", value)
    assert (code, sentence) == (2, f"--{option} is {value}: give {least}")


def test_goal_joints_that_would_not_be_looked_at(refused, run_folder, data, tmp_path):
    code, sentence = refused("plan", run_folder, "--goal", f"{data}:0", "--goal-joints", 0, 0, 0, 0, "--out", tmp_path / "plan")
    assert code == 2
    assert "--goal-joints is not looked at while --modalities is vision" in sentence


@pytest.mark.parametrize("verb", [["plan", "--goal", "x", "--out"], ["evaluate", "--out"]], ids=lambda words: words[0])
def test_unknown_run_folder(refused, tmp_path, verb):
    code, sentence = refused(verb[0], tmp_path / "run", *verb[1:], tmp_path / "out")
    assert code == 2
    assert f"{tmp_path}/run is no run folder: it has no config.json; give a folder that `preimage train` wrote" in sentence


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("config.json", b"{"),
        ("config.json", b"{}"),
        ("config.json", b"[]"),
        ("config.json", b"\xff"),
        ("model.safetensors", b""),
        ("model.safetensors", b"{" * 100),
        ("model.safetensors", None),
        ("shown.npz", b"PK"),
        ("shown.npz", None),
    ],
)
def test_a_run_with_a_broken_file(refused, run_folder, tmp_path, name, content):
    broken = tmp_path / "run"
    shutil.copytree(run_folder, broken)
    (broken / name).unlink()
    if content is not None:
        (broken / name).write_bytes(content)
    code, sentence = refused("evaluate", broken, "--goals", 1, "--out", tmp_path / "result.json")
    assert code == 2
    assert str(broken) in sentence


def test_train_does_not_write_over_a_run(refused, run_folder, data):
    before = {path.name: path.read_bytes() for path in run_folder.iterdir()}
    code, sentence = refused("train", data, "--out", run_folder, "--size", "tiny")
    assert code == 2
    assert "is not empty: give a new folder, or --resume to go on with the run in it" in sentence
    assert before == {path.name: path.read_bytes() for path in run_folder.iterdir()}


def test_resume_of_a_run_that_is_not_there(refused, data, tmp_path):
    assert refused("train", data, "--out", tmp_path / "run", "--resume")[0] == 2


def test_resume_with_other_data(refused, run_folder, other_data):
    code, sentence = refused("train", other_data(), "--out", run_folder, "--resume")
    assert code == 2
    assert "was trained on other demonstrations" in sentence


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("change", [{"train": {"nonsense": 1}}, {"train": None}, {"model": [1]}, {"data": None}, {"data": [1]}])
def test_resume_of_a_run_with_settings_that_are_not_known(refused, run_folder, data, tmp_path, change):
    broken = tmp_path / "run"
    shutil.copytree(run_folder, broken)
    config = json.loads((broken / "config.json").read_text())
    (broken / "config.json").write_text(json.dumps(config | change))
    code, sentence = refused("train", data, "--out", broken, "--resume")
    assert code == 2
    assert sentence.startswith(str(broken))


@pytest.mark.parametrize("change", [{"model": [1]}, {"sensors": None}, {"num_sequences": "3"}])
@pytest.mark.usefixtures("unchecked")
def test_plan_with_a_run_whose_settings_are_not_known(refused, run_folder, data, tmp_path, change):
    broken = tmp_path / "run"
    shutil.copytree(run_folder, broken)
    config = json.loads((broken / "config.json").read_text())
    (broken / "config.json").write_text(json.dumps(config | change))
    code, sentence = refused("plan", broken, "--goal", f"{data}:0", "--out", tmp_path / "plan")
    assert code == 2
    assert sentence.startswith(f"{broken} cannot be loaded (")


def test_execute_without_a_plan(refused, tmp_path):
    code, sentence = refused("execute", tmp_path)
    assert (code, sentence) == (2, f"{tmp_path} holds no plan (plan.json): give a folder that `preimage plan` wrote")


def test_execute_a_plan_that_nothing_can_judge(refused, run_folder, demonstrations, tmp_path, capsys):
    Image.fromarray(demonstrations[0].last.frame[..., 0]).save(tmp_path / "goal.png")
    cli.main(["plan", str(run_folder), "--goal", str(tmp_path / "goal.png"), "--out", str(tmp_path / "plan"), *QUICK])
    capsys.readouterr()
    code, sentence = refused("execute", tmp_path / "plan")
    assert code == 2
    assert "is for a goal without a scene, which nothing can judge: plan with --goal DATA:EPISODE" in sentence


def test_an_output_that_cannot_be_written(refused, data, tmp_path):
    (tmp_path / "file").write_text("in the way")
    code, sentence = refused("train", data, "--out", tmp_path / "file" / "run", "--size", "tiny", "--updates", 1)
    assert code == 1
    assert str(tmp_path / "file") in sentence
    assert "Errno" not in sentence


# Full disks and Ctrl-C

FULL_DISK = """
import resource, sys
from preimage import cli
import preimage.training as training

def fill(told):
    if told.update == 2:
        resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, resource.RLIM_INFINITY))

plain = training.train
cli.train = lambda *arguments, progress, **words: plain(*arguments, **words, progress=lambda told: (progress(told), fill(told)))
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
    assert not list((tmp_path / "plan").iterdir())


def test_ctrl_c_saves_and_the_run_can_be_resumed(data, tmp_path, capsys, monkeypatch):
    plain = cli.train

    def interrupted(*arguments, progress, **words):
        return plain(*arguments, **words, progress=lambda told: (progress(told), signal.raise_signal(signal.SIGINT)))

    run = tmp_path / "run"
    monkeypatch.setattr(cli, "train", interrupted)
    with pytest.raises(SystemExit) as left:
        cli.main(["train", str(data), "--out", str(run), "--size", "tiny", "--updates", "2"])
    assert left.value.code == 1
    assert capsys.readouterr().err.splitlines()[-1] == "preimage: interrupted; what was saved is kept"
    monkeypatch.undo()
    cli.main(["train", str(data), "--out", str(run), "--resume"])
    assert [json.loads(line)["update"] for line in (run / "log.jsonl").read_text().splitlines()] == [1, 2]
