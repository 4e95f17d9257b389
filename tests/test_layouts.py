"""Layouts of converters: names, shapes, columns, cameras and patterns as they are written out there."""

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from planar_arm import INFO, NAMES, TOP, assert_read_right, assert_refused_alike, into_videos, write_v2
from preimage.data.dataset import load
from preimage.data.view import View
from recordings import edit_json


@pytest.mark.parametrize("version", ["v2.0", "v2.1"])
def test_v20_is_read_as_v21(tmp_path, version):
    assert_read_right(into_videos(write_v2(tmp_path / "data", version=version)))


@pytest.mark.parametrize(
    ("names", "shape", "read"),
    [
        (["state"], [2], ("state_0", "state_1")),
        ({"motors": ["state"]}, [2], ("state_0", "state_1")),
        (["joint", "joint"], [2], ("joint_0", "joint_1")),
        ({"motors": NAMES}, [2], ("shoulder", "elbow")),
        ({"arm": ["shoulder"], "wrist": ["elbow"]}, [2], ("shoulder", "elbow")),
        ({"elbow": 1, "shoulder": 0}, [2], ("shoulder", "elbow")),
        ([["shoulder"], ["elbow"]], [2], ("shoulder", "elbow")),
        (NAMES, [1, 2], ("shoulder", "elbow")),
        ([NAMES], [1, 2], ("shoulder", "elbow")),
        (["state"], [2, 1], ("state_0", "state_1")),
    ],
)
def test_names_and_shapes_of_converters_are_read(tmp_path, names, shape, read):
    assert_read_right(write_v2(tmp_path / "data", names=names, shape=shape), read)


@pytest.mark.parametrize(("state", "asked"), [("state", "state"), ("observation.states.joint.position", "joint.position")])
def test_the_state_may_have_another_name(tmp_path, state, asked):
    folder = write_v2(tmp_path / "data", state=state, camera="image" if state == "state" else TOP)
    assert_refused_alike(folder, f"has no observation.state: choose one or more of {state}, action by --view.state")
    assert_read_right(folder, view=View(state=(asked,)))
    with pytest.raises(ValueError, match=f"has no column of numbers velocity: it has {state}, action"):
        load(folder, view=View(state=("velocity",)))


def test_the_state_may_be_in_parts(tmp_path):
    folder = write_v2(tmp_path / "data")
    for path in folder.glob("data/*/*.parquet"):
        table = pq.read_table(path)
        joints = np.array(table["observation.state"].to_pylist())
        parts = {f"observation.{name}": pa.array(joints[:, [column]].tolist()) for column, name in enumerate(("upper", "lower"))}
        for name, column in parts.items():
            table = table.append_column(name, column)
        pq.write_table(table.drop_columns(["observation.state"]), path)

    def split(info: dict) -> None:
        del info["features"]["observation.state"]
        for name in ("upper", "lower"):
            info["features"][f"observation.{name}"] = {"dtype": "float32", "shape": [1], "names": ["angle"]}

    edit_json(folder / INFO, split)
    assert_read_right(folder, ("upper_angle", "lower_angle"), View(state=("upper", "lower")))


def test_a_camera_has_a_short_name(tmp_path):
    assert_read_right(write_v2(tmp_path / "data"), view=View(camera="top"))


def test_the_words_of_v30_may_stand_in_the_patterns_of_v21(tmp_path):
    folder = into_videos(write_v2(tmp_path / "data"))
    info = folder / INFO
    info.write_text(info.read_text().replace("{episode_chunk:03d}", "{chunk_index:03d}"))
    assert_read_right(folder)


def test_patterns_written_on_windows_are_read(tmp_path):
    folder = into_videos(write_v2(tmp_path / "data"))
    edit_json(folder / INFO, lambda info: info.update({key: info[key].replace("/", "\\") for key in ("data_path", "video_path")}))
    assert_read_right(folder)


def test_a_column_that_is_there_twice_is_refused(tmp_path):
    folder = write_v2(tmp_path / "data")
    path = folder / "data/chunk-000/episode_000002.parquet"
    table = pq.read_table(path)
    pq.write_table(table.append_column("episode_index", table["frame_index"]), path)
    assert_refused_alike(folder, "episode_000002.parquet has several columns episode_index: give each a name of its own")
