"""What a user can get wrong on the command line is told in one sentence, and nothing is written."""

import re
import shutil
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import torch
from PIL import Image
from safetensors.torch import save_file

from preimage import cli
from preimage.storage.recordings import save
from preimage.storage.run_files import WEIGHTS
from recordings import DATA, edit_json
from shared import make_demonstration


@pytest.fixture
def other_data(tmp_path):
    """Writes a data set whose recordings are of another kind."""

    def write(**kind) -> Path:
        save([make_demonstration(seed, **kind) for seed in range(2)], tmp_path / "other", task="reach")
        return tmp_path / "other"

    return write


def test_words_that_are_off(capsys):
    for words in (["dance"], ["record"], ["record", "reach", "--count", "many", "--out", "x"], []):
        with pytest.raises(SystemExit) as left:
            cli.main(words)
        assert left.value.code == 2
        assert "Traceback" not in capsys.readouterr().err


def test_unknown_task(refused, tmp_path):
    assert refused("record", "juggle", "--count", 1, "--out", tmp_path / "x")[0] == 2
    assert "--pixels is 8: give 16 to 1024" in refused("record", "reach", "--count", 1, "--out", tmp_path / "x", "--pixels", 8)[1]
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
    assert sentence == f"{tmp_path}/nowhere is not a folder: name that of a data set"
    assert not (tmp_path / "run").exists()


def test_truncated_parquet(refused, other_data, tmp_path):
    file = other_data() / DATA
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    code, sentence = refused("train", tmp_path / "other", "--out", tmp_path / "run")
    assert code == 2
    assert "cannot be read as parquet" in sentence
    assert not (tmp_path / "run").exists()


def test_nan_in_the_joints_of_a_data_set(refused, other_data, tmp_path):
    file = other_data() / DATA
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


def test_frames_that_no_ladder_fits(refused, data, tmp_path):
    code, sentence = refused("train", data, "--out", tmp_path / "run", "--size", "tiny", "--view.size", 30, 30)
    assert code == 2
    assert "frames are 30x30" in sentence


def test_an_image_of_another_size_than_the_models_frames(refused, run_folder, tmp_path):
    Image.new("L", (640, 480)).save(tmp_path / "goal.png")
    code, sentence = refused("plan", run_folder, "--goal", tmp_path / "goal.png", "--out", tmp_path / "plan")
    assert (code, sentence) == (2, f"{tmp_path}/goal.png is 640x480 pixels, the model sees 64x64: scale or crop it")


def test_a_goal_that_is_no_image(refused, run_folder, tmp_path):
    (tmp_path / "goal.png").write_text("a cup on the left")
    code, sentence = refused("plan", run_folder, "--goal", tmp_path / "goal.png", "--out", tmp_path / "plan")
    assert (code, sentence) == (
        2,
        f"{tmp_path}/goal.png is not an image that can be read: it cannot be decoded as PNG, JPEG, WebP, BMP or TIFF",
    )


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
        ("later-starts", 1.5, "a share between 0 and 1"),
        ("final-share", -0.1, "a share between 0 and 1"),
        ("mixup-arity", 1, "2 or more"),
    ],
)
def test_settings_of_training_out_of_range(refused, data, tmp_path, option, value, least):
    code, sentence = refused("train", data, "--out", tmp_path / "run", f"--{option}", value)
    assert code == 2
    assert sentence.replace(".0 or", " or").startswith(f"{option.replace('-', '_')} (--{option}) is {value}: give {least}")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("option", "value", "least"),
    [
        ("candidates", 0, "1 or more"),
        ("iterations", -1, "0 or more"),
        ("horizon", 0, "1 or more"),
        ("delay-penalty", 0.0, "a number above 0"),
        ("tolerance", -1.0, "0 or more"),
        ("finite-difference-step", "nan", "a number above 0"),
    ],
)
def test_settings_of_the_search_out_of_range(refused, run_folder, data, tmp_path, option, value, least):
    for verb in (["plan", run_folder, "--goal", f"{data}:0"], ["evaluate", run_folder]):
        code, sentence = refused(*verb, "--out", tmp_path / "out", f"--{option}", value)
        assert code == 2
        assert sentence.replace(".0 or", " or").startswith(f"{option.replace('-', '_')} (--{option}) is {value}: give {least}")
    assert not (tmp_path / "out").exists()


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


# What other programs write


def of_a_transformer(folder: Path) -> None:
    save_file({f"model.layers.{layer}.mlp.weight": torch.ones(2, 2) for layer in range(3)}, folder / WEIGHTS, metadata={"format": "pt"})


@pytest.mark.parametrize(
    ("damage", "sentence"),
    [
        (of_a_transformer, r"is a checkpoint of another network \(model.layers.0.mlp.weight and 2 more\), and none of `preimage train`"),
        (
            lambda folder: torch.save({"weight": torch.ones(2)}, folder / WEIGHTS),
            "is a pickled file of PyTorch, which is not opened, and none",
        ),
        (
            lambda folder: (folder / "config.json").write_text('{"model_type": "llama", "hidden_size": 64}'),
            r"is no run, but holds a model of another program \(llama\): its config.json has none of model, sensors, num_sequences; give a",
        ),
        (lambda folder: (folder / "config.json").write_text("{}"), "is no run: its config.json has none of model, sensors, num_sequences"),
    ],
    ids=["transformer", "pickled", "config of another", "empty config"],
)
def test_the_model_of_another_program_is_named_as_such(refused, run_folder, tmp_path, damage, sentence):
    shutil.copytree(run_folder, tmp_path / "run")
    damage(tmp_path / "run")
    code, told = refused("plan", tmp_path / "run", "--goal", "x.png", "--out", tmp_path / "plan")
    assert code == 2
    assert re.search(sentence, told)


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


def with_settings(run_folder: Path, place: Path, change: dict) -> Path:
    shutil.copytree(run_folder, place / "run")
    edit_json(place / "run" / "config.json", lambda config: config.update(change))
    return place / "run"


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("change", [{"train": {"nonsense": 1}}, {"train": None}, {"model": [1]}, {"data": None}, {"data": [1]}])
def test_resume_of_a_run_with_settings_that_are_not_known(refused, run_folder, data, tmp_path, change):
    broken = with_settings(run_folder, tmp_path, change)
    code, sentence = refused("train", data, "--out", broken, "--resume")
    assert code == 2
    assert sentence.startswith(str(broken))


@pytest.mark.parametrize("change", [{"model": [1]}, {"sensors": None}, {"num_sequences": "3"}])
@pytest.mark.usefixtures("unchecked")
def test_plan_with_a_run_whose_settings_are_not_known(refused, run_folder, data, tmp_path, change):
    broken = with_settings(run_folder, tmp_path, change)
    code, sentence = refused("plan", broken, "--goal", f"{data}:0", "--out", tmp_path / "plan")
    assert code == 2
    assert sentence.startswith(f"{broken} cannot be loaded (")


def test_execute_without_a_plan(refused, tmp_path):
    code, sentence = refused("execute", tmp_path)
    assert (code, sentence) == (2, f"{tmp_path} holds no plan (plan.json): give a folder that `preimage plan` wrote")


def test_execute_a_plan_that_nothing_can_judge(refused, run_folder, demonstrations, tmp_path, capsys):
    Image.fromarray(demonstrations[0].last.frame[..., 0]).save(tmp_path / "goal.png")
    cli.main(["plan", str(run_folder), "--goal", str(tmp_path / "goal.png"), "--out", str(tmp_path / "plan"), "--iterations", "1"])
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
