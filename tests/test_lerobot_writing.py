"""LeRobot finds what it expects; what cannot be written is told, and leaves nothing behind."""

import io
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from PIL import Image

from preimage.data.dataset import load
from preimage.storage.recordings import save
from recordings import (
    CAMERA,
    DATA,
    INDEX,
    INFO,
    assert_equal,
    noise,
)


def test_info_agrees_with_lerobot(folder):
    """Keys and types as in an info.json written by LeRobot 0.6.1."""
    info = json.loads((folder / "meta/info.json").read_text())
    names = ["joint 0", "joint 1"]
    number = {"dtype": "int64", "shape": [1], "names": None}
    assert info == {
        "codebase_version": "v3.0",
        "fps": 10,
        "features": {
            CAMERA: {"dtype": "image", "shape": [6, 8, 3], "names": ["height", "width", "channels"]},
            "observation.state": {"dtype": "float32", "shape": [2], "names": names},
            "action": {"dtype": "float32", "shape": [2], "names": names},
            "timestamp": {"dtype": "float32", "shape": [1], "names": None},
            "frame_index": number,
            "episode_index": number,
            "index": number,
            "task_index": number,
        },
        "total_episodes": 3,
        "total_frames": 12,
        "total_tasks": 1,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": None,
        "robot_type": None,
        "splits": {"train": "0:3"},
    }
    assert isinstance(info["fps"], int)


def test_data_columns_have_the_types_and_metadata_of_lerobot(folder):
    schema = pq.read_schema(folder / DATA)
    assert {field.name: str(field.type) for field in schema} == {
        CAMERA: "struct<bytes: binary, path: string>",
        "observation.state": "fixed_size_list<element: float>[2]",
        "action": "fixed_size_list<element: float>[2]",
        "timestamp": "float",
        "frame_index": "int64",
        "episode_index": "int64",
        "index": "int64",
        "task_index": "int64",
    }
    described = json.loads(schema.metadata[b"huggingface"])["info"]["features"]
    assert list(described) == schema.names
    assert described[CAMERA] == {"_type": "Image"}
    assert described["action"] == {"feature": {"dtype": "float32", "_type": "Value"}, "length": 2, "_type": "List"}
    assert described["index"] == {"dtype": "int64", "_type": "Value"}


def test_a_single_joint_is_a_number_not_a_list_of_one(tmp_path):
    """A feature of shape (1,) is a plain value to LeRobot."""
    save([noise(num_joints=1)], tmp_path / "data", task="t")
    assert pq.read_schema(tmp_path / "data" / DATA).field("observation.state").type == pa.float32()


def test_rows_count_steps_and_the_action_is_the_next_step(folder, noisy):
    table = pq.read_table(folder / DATA)
    state, action = (np.array(table[name].to_pylist()) for name in ("observation.state", "action"))
    joints = noisy[1].joints  # rows 3 to 6, after the 3 steps of episode 0
    np.testing.assert_array_equal(state[3:7], joints)
    np.testing.assert_array_equal(action[3:7], joints[[1, 2, 3, 3]])
    assert table["index"].to_pylist() == list(range(12))
    assert table["episode_index"].to_pylist() == [0] * 3 + [1] * 4 + [2] * 5
    assert table["frame_index"].to_pylist() == [*range(3), *range(4), *range(5)]
    np.testing.assert_allclose(table["timestamp"].to_numpy()[3:7], [0.0, 0.1, 0.2, 0.3], rtol=1e-6)
    assert set(table["task_index"].to_pylist()) == {0}


def test_frames_are_png_of_three_channels(folder, noisy):
    picture = pq.read_table(folder / DATA)[CAMERA][0].as_py()
    image = Image.open(io.BytesIO(picture["bytes"]))
    assert (image.format, image.mode, picture["path"]) == ("PNG", "RGB", "frame-000000.png")
    np.testing.assert_array_equal(np.asarray(image), np.repeat(noisy[0].frames[0], 3, axis=-1))


def test_tasks_have_the_words_as_pandas_index(folder):
    table = pq.read_table(folder / "meta/tasks.parquet")
    assert table.to_pylist() == [{"task_index": 0, "task": "reach the mark"}]
    pandas = json.loads(table.schema.metadata[b"pandas"])
    assert pandas["index_columns"] == ["task"]
    assert [column["name"] for column in pandas["columns"]] == ["task_index", "task"]


def test_the_index_says_where_each_episode_lies(folder):
    rows = pq.read_table(folder / INDEX).to_pylist()
    places = [{name: value for name, value in row.items() if not name.startswith("stats/")} for row in rows]
    assert places[1] == {
        "episode_index": 1,
        "tasks": ["reach the mark"],
        "length": 4,
        "data/chunk_index": 0,
        "data/file_index": 0,
        "dataset_from_index": 3,
        "dataset_to_index": 7,
        "meta/episodes/chunk_index": 0,
        "meta/episodes/file_index": 0,
    }


def test_statistics_are_those_numpy_finds(folder, noisy):
    statistics = json.loads((folder / "meta/stats.json").read_text())
    pixels = np.concatenate([each.frames for each in noisy]).reshape(-1) / 255
    joints = np.concatenate([each.joints for each in noisy])
    assert set(statistics) == set(json.loads((folder / "meta/info.json").read_text())["features"])
    for name, values, method in ((CAMERA, pixels, "inverted_cdf"), ("observation.state", joints, "linear")):
        found = statistics[name]
        assert set(found) == {"min", "max", "mean", "std", "count", "q01", "q10", "q50", "q90", "q99"}
        assert found["count"] == [12]
        expected = {"min": values.min(0), "max": values.max(0), "mean": values.mean(0), "std": values.std(0)}
        expected |= {f"q{share:02d}": np.quantile(values, share / 100, axis=0, method=method) for share in (1, 10, 50, 90, 99)}
        for which, value in expected.items():
            wanted = np.full((3, 1, 1), value) if name == CAMERA else value
            assert np.shape(found[which]) == wanted.shape
            np.testing.assert_allclose(found[which], wanted, rtol=1e-12)


def test_every_episode_has_its_own_statistics(folder, noisy):
    row = pq.read_table(folder / INDEX).to_pylist()[2]
    np.testing.assert_allclose(row["stats/observation.state/mean"], noisy[2].joints.mean(0))
    np.testing.assert_allclose(row[f"stats/{CAMERA}/max"], np.full((3, 1, 1), noisy[2].frames.max() / 255))
    assert row[f"stats/{CAMERA}/count"] == [5]


# Errors on writing


@pytest.mark.parametrize(
    ("demonstrations", "sentence"),
    [
        ([], "there is no demonstration: give one or more"),
        ([noise(size=(4, 4, 2))], "frames have 2 channels: a LeRobot data set takes 1 (grey) or 3 (colour)"),
        ([noise(num_joints=0)], "demonstrations have no joints: a LeRobot data set needs 1 or more"),
        ([noise(rate_hz=0.0)], "rate_hz is 0.0: give the number of steps a second, above 0"),
        (
            [noise(), noise(size=(4, 4, 1))],
            "demonstration 1 has frames of (height, width, channels) (4, 4, 1), the first (6, 8, 1): one data set takes one kind",
        ),
        (
            [noise(num_joints=1), noise()],
            "demonstration 1 has joints ('joint 0', 'joint 1'), the first ('joint 0',): one data set takes one kind",
        ),
        (
            [noise(), noise(rate_hz=5.0)],
            "demonstration 1 has a rate in Hz of 5.0, the first 10.0: one data set takes one kind",
        ),
    ],
)
def test_what_cannot_be_saved_is_told_and_nothing_is_left(tmp_path, demonstrations, sentence):
    with pytest.raises(ValueError) as caught:  # noqa: PT011 the whole text is compared below
        save(demonstrations, tmp_path / "data", task="t")
    assert str(caught.value) == sentence
    assert list(tmp_path.iterdir()) == []


def contents(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_save_refuses_a_folder_with_something_in_it(folder, noisy):
    before = contents(folder.parent)
    with pytest.raises(ValueError, match="data is there already: give a new folder"):
        save(noisy, folder, task="t")
    with pytest.raises(ValueError, match=r"info\.json is there already"):
        save(noisy, folder / INFO, task="t")
    assert contents(folder.parent) == before


def test_save_takes_an_empty_folder_and_makes_parents(noisy, tmp_path):
    (tmp_path / "empty").mkdir()
    for name in ("empty", "new/deeper"):
        save(noisy, tmp_path / name, task="t")
        assert_equal(load(tmp_path / name), noisy)


@pytest.mark.parametrize("place", ["ParquetWriter.write_table", "write_table"])
def test_a_full_disk_leaves_nothing_and_touches_nothing(folder, noisy, monkeypatch, place):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    before = contents(folder.parent)
    monkeypatch.setattr(f"pyarrow.parquet.{place}", full)
    with pytest.raises(OSError, match="No space left on device"):
        save(noisy, folder.parent / "other", task="t")
    assert contents(folder.parent) == before
    assert list(folder.parent.iterdir()) == [folder]


KILLED = """
import os, signal, sys
from pathlib import Path
import preimage.storage.recordings as recordings
from recordings import noises
def killed(demonstrations, folder, **_):
    (folder / "data").mkdir()
    os.kill(os.getpid(), signal.SIGKILL)
recordings.write_files = killed
recordings.save(noises(), Path(sys.argv[1]), task="t")
"""


@pytest.mark.skipif(os.name == "nt", reason="a process kills itself by a signal")
def test_what_a_killed_process_left_is_removed_by_the_next_one_that_saves_there(noisy, tmp_path):
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([*sys.path, str(Path(__file__).parent)])}
    subprocess.run([sys.executable, "-c", KILLED, tmp_path / "data"], env=environment, check=False)
    (left,) = tmp_path.iterdir()
    assert left.name.startswith(".data.")
    save(noisy, tmp_path / "data", task="t")
    assert [path.name for path in tmp_path.iterdir()] == ["data"]
