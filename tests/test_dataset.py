"""What is saved is what is loaded; LeRobot finds what it expects; every damage is told in one sentence."""

import doctest
import io
import itertools
import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

import preimage.dataset
from preimage.dataset import fingerprint, load, save
from preimage.records import Demonstration, Scene

DATA, INDEX = "data/chunk-000/file-000.parquet", "meta/episodes/chunk-000/file-000.parquet"
CAMERA = "observation.images.camera"
SCENE = Scene("reach", (0.1, -0.2), {"goal": (0.5, 0.25, 0.03), "marker": (0.1, 0.0, 0.0)})


def make_demonstration(*, seed=0, num_steps=4, size=(6, 8, 1), num_joints=2, rate_hz=10.0, scene=None) -> Demonstration:
    rng = np.random.default_rng(seed)
    frames = rng.integers(0, 256, (num_steps, *size), np.uint8)
    joints = rng.normal(size=(num_steps, num_joints)).astype(np.float32).astype(np.float64)
    return Demonstration(frames, joints, rate_hz, tuple(f"joint {number}" for number in range(num_joints)), scene)


def assert_equal(left: list[Demonstration], right: list[Demonstration]) -> None:
    assert len(left) == len(right)
    for one, other in zip(left, right, strict=True):
        np.testing.assert_array_equal(one.frames, other.frames)
        np.testing.assert_array_equal(one.joints, other.joints)
        assert (one.frames.dtype, one.joints.dtype) == (other.frames.dtype, other.joints.dtype)
        assert (one.rate_hz, one.joint_names, one.scene) == (other.rate_hz, other.joint_names, other.scene)


@pytest.fixture
def demonstrations() -> list[Demonstration]:
    return [make_demonstration(seed=seed, num_steps=3 + seed, scene=SCENE) for seed in range(3)]


@pytest.fixture
def folder(demonstrations, tmp_path) -> Path:
    save(demonstrations, tmp_path / "data", task="reach the mark")
    return tmp_path / "data"


def edit_json(path: Path, change) -> None:
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def edit_rows(path: Path, change) -> None:
    """`change` the list of rows of a parquet file in place; columns keep their types."""
    table = pq.read_table(path)
    rows = table.to_pylist()
    change(rows)
    pq.write_table(pa.Table.from_pylist(rows, table.schema), path)


def png(size=(8, 6), mode="RGB") -> bytes:
    file = io.BytesIO()
    Image.new(mode, size).save(file, "PNG")
    return file.getvalue()


# Laws


def test_doctests():
    assert doctest.testmod(preimage.dataset).failed == 0


numbers = itertools.count()


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    height=st.integers(1, 9),
    width=st.integers(1, 9),
    channels=st.sampled_from([1, 3]),
    lengths=st.lists(st.integers(2, 6), min_size=1, max_size=4),
    num_joints=st.integers(1, 5),
    rate_hz=st.sampled_from([2.5, 10.0, 29.97]),
    scene=st.sampled_from([None, SCENE]),
)
def test_load_undoes_save(tmp_path, height, width, channels, lengths, num_joints, rate_hz, scene):
    saved = [
        make_demonstration(seed=seed, num_steps=length, size=(height, width, channels), num_joints=num_joints, rate_hz=rate_hz, scene=scene)
        for seed, length in enumerate(lengths)
    ]
    folder = tmp_path / str(next(numbers))
    save(saved, folder, task="anything")
    loaded = load(folder)
    assert_equal(loaded, saved)
    assert fingerprint(loaded) == fingerprint(saved)


def test_joints_are_rounded_to_float32_and_only_once(tmp_path):
    demonstration = Demonstration(np.zeros((2, 4, 4, 1), np.uint8), np.array([[0.1], [np.pi]]), 10.0, ("yaw",))
    save([demonstration], tmp_path / "once", task="t")
    once = load(tmp_path / "once")
    np.testing.assert_allclose(once[0].joints, demonstration.joints, rtol=6e-8)
    save(once, tmp_path / "twice", task="t")
    assert_equal(load(tmp_path / "twice"), once)


def test_colour_stays_colour_where_one_pixel_of_one_episode_has_it(tmp_path):
    frames = np.zeros((2, 4, 4, 3), np.uint8)
    joints = np.zeros((2, 1))
    coloured = frames.copy()
    coloured[1, 2, 3, 0] = 1
    saved = [Demonstration(each, joints, 10.0, ("yaw",)) for each in (frames, coloured)]
    save(saved, tmp_path / "colour", task="t")
    assert_equal(load(tmp_path / "colour"), saved)
    save(saved[:1], tmp_path / "grey", task="t")
    assert load(tmp_path / "grey")[0].frames.shape == (2, 4, 4, 1)


def test_fingerprint_names_frames_joints_and_rate(demonstrations):
    first = demonstrations[0]
    frames, joints = first.frames.copy(), first.joints.copy()
    frames[0, 0, 0, 0] ^= 1
    joints[-1, -1] += 1e-3
    others = [
        demonstrations[1:],
        demonstrations[::-1],
        [Demonstration(frames, first.joints, first.rate_hz, first.joint_names), *demonstrations[1:]],
        [Demonstration(first.frames, joints, first.rate_hz, first.joint_names), *demonstrations[1:]],
        [Demonstration(first.frames, first.joints, 5.0, first.joint_names), *demonstrations[1:]],
    ]
    names = {fingerprint(each) for each in [demonstrations, *others]}
    assert len(names) == 1 + len(others)
    assert fingerprint(list(demonstrations)) in names


# What LeRobot expects


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
    save([make_demonstration(num_joints=1)], tmp_path / "data", task="t")
    assert pq.read_schema(tmp_path / "data" / DATA).field("observation.state").type == pa.float32()


def test_rows_count_steps_and_the_action_is_the_next_step(folder, demonstrations):
    table = pq.read_table(folder / DATA)
    state, action = (np.array(table[name].to_pylist()) for name in ("observation.state", "action"))
    joints = demonstrations[1].joints  # rows 3 to 6, after the 3 steps of episode 0
    np.testing.assert_array_equal(state[3:7], joints)
    np.testing.assert_array_equal(action[3:7], joints[[1, 2, 3, 3]])
    assert table["index"].to_pylist() == list(range(12))
    assert table["episode_index"].to_pylist() == [0] * 3 + [1] * 4 + [2] * 5
    assert table["frame_index"].to_pylist() == [*range(3), *range(4), *range(5)]
    np.testing.assert_allclose(table["timestamp"].to_numpy()[3:7], [0.0, 0.1, 0.2, 0.3], rtol=1e-6)
    assert set(table["task_index"].to_pylist()) == {0}


def test_frames_are_png_of_three_channels(folder, demonstrations):
    picture = pq.read_table(folder / DATA)[CAMERA][0].as_py()
    image = Image.open(io.BytesIO(picture["bytes"]))
    assert (image.format, image.mode, picture["path"]) == ("PNG", "RGB", "frame-000000.png")
    np.testing.assert_array_equal(np.asarray(image), np.repeat(demonstrations[0].frames[0], 3, axis=-1))


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


def test_statistics_are_those_numpy_finds(folder, demonstrations):
    statistics = json.loads((folder / "meta/stats.json").read_text())
    pixels = np.concatenate([each.frames for each in demonstrations]).reshape(-1) / 255
    joints = np.concatenate([each.joints for each in demonstrations])
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


def test_every_episode_has_its_own_statistics(folder, demonstrations):
    row = pq.read_table(folder / INDEX).to_pylist()[2]
    np.testing.assert_allclose(row["stats/observation.state/mean"], demonstrations[2].joints.mean(0))
    np.testing.assert_allclose(row[f"stats/{CAMERA}/max"], np.full((3, 1, 1), demonstrations[2].frames.max() / 255))
    assert row[f"stats/{CAMERA}/count"] == [5]


# Data sets from elsewhere


def split_in_two(folder: Path) -> None:
    """Episode 2 moves into a chunk of its own, in the data and in the index."""
    rows, index = pq.read_table(folder / DATA), pq.read_table(folder / INDEX)
    for path in ("data/chunk-001/file-007.parquet", "meta/episodes/chunk-001/file-000.parquet"):
        (folder / path).parent.mkdir()
    late = pa.array(np.array(rows["episode_index"]) == 2)
    pq.write_table(rows.filter(late), folder / "data/chunk-001/file-007.parquet")
    pq.write_table(rows.filter(pa.array(np.array(rows["episode_index"]) != 2)), folder / DATA)
    moved = index.slice(2).to_pylist()
    moved[0] |= {"data/chunk_index": 1, "data/file_index": 7}
    pq.write_table(pa.Table.from_pylist(moved, index.schema), folder / "meta/episodes/chunk-001/file-000.parquet")
    pq.write_table(index.slice(0, 2), folder / INDEX)


def test_several_files_and_chunks_are_one_set(folder, demonstrations):
    split_in_two(folder)
    assert_equal(load(folder), demonstrations)


def test_without_our_extra_file_there_are_no_scenes(folder):
    (folder / "meta/preimage.json").unlink()
    assert [each.scene for each in load(folder)] == [None] * 3


@pytest.mark.parametrize(("names", "read"), [({"motors": ["pan", "lift"]}, ("pan", "lift")), (None, ("joint_0", "joint_1"))])
def test_joint_names_may_be_grouped_or_missing(folder, names, read):
    edit_json(folder / "meta/info.json", lambda info: info["features"]["observation.state"].update(names=names))
    assert load(folder)[0].joint_names == read


def add_camera(folder: Path) -> None:
    """A second camera, twice as high and wide as the first, and black."""
    table = pq.read_table(folder / DATA)
    pictures = pa.array([{"bytes": png((16, 12)), "path": None}] * len(table), table.schema.field(CAMERA).type)
    pq.write_table(table.append_column("observation.images.wrist", pictures), folder / DATA)
    edit_json(folder / "meta/info.json", lambda info: info["features"].update({"observation.images.wrist": info["features"][CAMERA]}))


def test_the_camera_can_be_chosen(folder, demonstrations):
    add_camera(folder)
    assert_equal(load(folder, camera=CAMERA), demonstrations)
    assert load(folder, camera="observation.images.wrist")[0].frames.shape == (3, 12, 16, 1)


# Errors on reading

INFO = "meta/info.json"


def change_info(**changes):
    return lambda folder: edit_json(folder / INFO, lambda info: info.update(changes))


def change_feature(name, **changes):
    return lambda folder: edit_json(folder / INFO, lambda info: info["features"][name].update(changes))


def drop_feature(name):
    return lambda folder: edit_json(folder / INFO, lambda info: info["features"].pop(name))


def write(path, content: bytes):
    return lambda folder: (folder / path).write_bytes(content)


def truncate(path):
    return lambda folder: (folder / path).write_bytes((folder / path).read_bytes()[:-100])


def remove(path):
    return lambda folder: (folder / path).unlink()


def change_row(row, **changes):
    return lambda folder: edit_rows(
        folder / DATA, lambda rows: rows[row].update({key.replace("__", "."): to for key, to in changes.items()})
    )


def change_frame(row, content):
    return lambda folder: edit_rows(folder / DATA, lambda rows: rows[row].update({CAMERA: {"bytes": content, "path": None}}))


def drop_row(path, row):
    return lambda folder: edit_rows(folder / path, lambda rows: rows.pop(row))


def drop_column(path, name):
    return lambda folder: pq.write_table(pq.read_table(folder / path).drop_columns([name]), folder / path)


def lengthen_names(folder):
    edit_json(folder / INFO, lambda info: info["features"]["observation.state"]["names"].append("gripper"))


def drop_scene(folder):
    edit_json(folder / "meta/preimage.json", lambda content: content["scenes"].pop())


DAMAGES = [
    (remove(INFO), "{0} has no meta/info.json, so it is no LeRobot data set: name the folder that holds meta/ and data/"),
    (write(INFO, b'{"fps": 1'), "{0}/meta/info.json is not JSON: the file is damaged, copy the data set again"),
    (write(INFO, b"\xff\xfe"), "{0}/meta/info.json is not JSON: the file is damaged, copy the data set again"),
    (write(INFO, b"[]"), "{0}/meta/info.json holds a list, not an object: the file is damaged, copy the data set again"),
    (
        change_info(codebase_version="v2.1"),
        "{0} is a LeRobot data set of version v2.1: only v3.0 can be read, convert it with LeRobot first",
    ),
    (change_info(fps=0), "{0}/meta/info.json has fps 0: it should be the number of steps a second"),
    (change_info(fps="ten"), "{0}/meta/info.json has fps 'ten': it should be the number of steps a second"),
    (
        change_info(features=None),
        "{0}/meta/info.json has no usable features: they should describe each column by its dtype, shape and names",
    ),
    (change_info(total_episodes=None), "{0}/meta/info.json has total_episodes None: it should be the number of episodes"),
    (
        change_feature(CAMERA, dtype="video"),
        "observation.images.camera is stored as video, which cannot be read yet: convert the data set to dtype image with LeRobot",
    ),
    (drop_feature(CAMERA), "the data set has no camera: one of its features should have dtype image"),
    (
        add_camera,
        "the data set has the cameras observation.images.camera, observation.images.wrist: choose one with camera=",
    ),
    (drop_feature("observation.state"), "the data set has no observation.state: the joint angles should be stored under that name"),
    (
        change_feature("observation.state", names=3),
        "observation.state has the names 3 in meta/info.json: they should be a list with the name of each joint",
    ),
    (
        lengthen_names,
        f"{{0}}/{DATA}, episode 0, step 0 has 2 values of observation.state, meta/info.json names 3: let them agree",
    ),
    (remove(INDEX), "{0} has no episodes in meta/episodes: record one or more, or copy the data set again"),
    (drop_row(INDEX, 1), "meta/episodes in {0} lists 2 episodes, meta/info.json counts 3: copy the data set again"),
    (truncate(INDEX), f"{{0}}/{INDEX} cannot be read as parquet: the file is damaged or incomplete, copy the data set again"),
    (drop_column(INDEX, "length"), f"{{0}}/{INDEX} has no column length: a LeRobot data set of version v3.0 needs it"),
    (remove(DATA), f"{{0}}/{DATA} is missing: copy the data set again"),
    (truncate(DATA), f"{{0}}/{DATA} cannot be read as parquet: the file is damaged or incomplete, copy the data set again"),
    (write(DATA, b""), f"{{0}}/{DATA} cannot be read as parquet: the file is damaged or incomplete, copy the data set again"),
    (drop_column(DATA, CAMERA), f"{{0}}/{DATA} has no column observation.images.camera: a LeRobot data set of version v3.0 needs it"),
    (drop_row(DATA, 4), f"{{0}}/{DATA} has 3 steps of episode 1, its index says 4: copy the data set again"),
    (change_row(5, observation__state=[0.0, np.nan]), "{0}, episode 1: joints holds nan at step 2, joint joint 1"),
    (change_row(5, observation__state=[None, 0.0]), "{0}, episode 1: joints holds nan at step 2, joint joint 0"),
    (
        change_frame(4, png()[:45]),
        f"{{0}}/{DATA}, episode 1, step 1 has a frame that cannot be decoded: copy the data set again or leave that episode out",
    ),
    (
        change_frame(4, None),
        f"{{0}}/{DATA}, episode 1, step 1 has a frame that cannot be decoded: copy the data set again or leave that episode out",
    ),
    (change_frame(4, png(mode="RGBA")), f"{{0}}/{DATA}, episode 1, step 1 has a frame of mode RGBA: it should be 8-bit grey or RGB"),
    (
        change_frame(4, png((5, 6))),
        f"{{0}}/{DATA}, episode 1, step 1 has a frame of (6, 5, 3), the first is of (6, 8, 3) (H, W, C): give all one size",
    ),
    (drop_scene, "{0}/meta/preimage.json has 2 scenes for 3 episodes: remove it to load the data set without scenes"),
    (
        write("meta/preimage.json", b'{"scenes": [3]}'),
        "{0}/meta/preimage.json has no usable scenes: repair it, or remove it to load the data set without scenes",
    ),
]


@pytest.mark.parametrize(("damage", "sentence"), DAMAGES, ids=[sentence.replace("{0}", "")[:60] for _, sentence in DAMAGES])
def test_damage_is_told_in_one_sentence(folder, damage, sentence):
    damage(folder)
    with pytest.raises(ValueError) as caught:  # noqa: PT011 the whole text is compared below
        load(folder)
    assert str(caught.value) == sentence.format(folder)


def test_missing_folder_is_told(tmp_path):
    with pytest.raises(ValueError, match="nowhere is not a folder: name one that holds a LeRobot data set"):
        load(tmp_path / "nowhere")


def test_unknown_camera_is_told(folder):
    with pytest.raises(ValueError, match=f"no camera top: it has {CAMERA}$"):
        load(folder, camera="top")


def test_a_flipped_bit_in_a_frame_is_seen(folder):
    """Pages carry checksums, so what still parses but is no longer what was written is refused."""
    content = bytearray((folder / DATA).read_bytes())
    content[content.index(b"IDAT") + 20] ^= 1
    (folder / DATA).write_bytes(content)
    with pytest.raises(ValueError, match="cannot be read as parquet"):
        load(folder)


# Errors on writing


@pytest.mark.parametrize(
    ("demonstrations", "sentence"),
    [
        ([], "there is no demonstration: give one or more"),
        ([make_demonstration(size=(4, 4, 2))], "frames have 2 channels: a LeRobot data set takes 1 (grey) or 3 (colour)"),
        ([make_demonstration(num_joints=0)], "demonstrations have no joints: a LeRobot data set needs 1 or more"),
        ([make_demonstration(rate_hz=0.0)], "rate_hz is 0.0: give the number of steps a second, above 0"),
        (
            [make_demonstration(), make_demonstration(size=(4, 4, 1))],
            "demonstration 1 has frames of (height, width, channels) (4, 4, 1), the first (6, 8, 1): one data set takes one kind",
        ),
        (
            [make_demonstration(num_joints=1), make_demonstration()],
            "demonstration 1 has joints ('joint 0', 'joint 1'), the first ('joint 0',): one data set takes one kind",
        ),
        (
            [make_demonstration(), make_demonstration(rate_hz=5.0)],
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


def test_save_refuses_a_folder_with_something_in_it(folder, demonstrations):
    before = contents(folder.parent)
    with pytest.raises(ValueError, match="data is there already: give a new folder or an empty one"):
        save(demonstrations, folder, task="t")
    with pytest.raises(ValueError, match=r"info\.json is there already"):
        save(demonstrations, folder / INFO, task="t")
    assert contents(folder.parent) == before


def test_save_takes_an_empty_folder_and_makes_parents(demonstrations, tmp_path):
    (tmp_path / "empty").mkdir()
    for name in ("empty", "new/deeper"):
        save(demonstrations, tmp_path / name, task="t")
        assert_equal(load(tmp_path / name), demonstrations)


@pytest.mark.parametrize("place", ["ParquetWriter.write_table", "write_table"])
def test_a_full_disk_leaves_nothing_and_touches_nothing(folder, demonstrations, monkeypatch, place):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    before = contents(folder.parent)
    monkeypatch.setattr(f"pyarrow.parquet.{place}", full)
    with pytest.raises(OSError, match="No space left on device"):
        save(demonstrations, folder.parent / "other", task="t")
    assert contents(folder.parent) == before
    assert list(folder.parent.iterdir()) == [folder]
