"""Data sets that LeRobot or others wrote are read, with images or videos; every damage is told in one sentence."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from preimage.data.dataset import describe, load
from preimage.data.view import View
from preimage.storage.recordings import save
from recordings import (
    CAMERA,
    DATA,
    INDEX,
    INFO,
    WRIST,
    assert_equal,
    change_info,
    drop_column,
    edit_json,
    edit_rows,
    png,
    remove,
    write,
)


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


def test_several_files_and_chunks_are_one_set(folder, noisy):
    split_in_two(folder)
    assert_equal(load(folder), noisy)


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
    pq.write_table(table.append_column(WRIST, pictures), folder / DATA)
    edit_json(folder / "meta/info.json", lambda info: info["features"].update({WRIST: info["features"][CAMERA]}))


def test_the_camera_can_be_chosen(folder, noisy):
    add_camera(folder)
    assert_equal(load(folder, view=View(camera=CAMERA)), noisy)
    assert load(folder, view=View(camera=WRIST))[0].frames.shape == (3, 12, 16, 1)


def test_channels_may_come_first(folder):
    edit_json(folder / INFO, lambda info: info["features"][CAMERA].update(shape=[3, 480, 640], names=["channels", "height", "width"]))
    assert describe(folder).cameras == {CAMERA: (480, 640, 3)}


def test_the_unit_of_the_joints_is_told_where_it_is_known(folder, tmp_path):
    assert describe(folder).joint_unit == "rad"
    save(load(folder), tmp_path / "unknown", task="reach")
    assert describe(tmp_path / "unknown").joint_unit is None


# Errors on reading


def change_feature(name, **changes):
    return lambda folder: edit_json(folder / INFO, lambda info: info["features"][name].update(changes))


def drop_feature(name):
    return lambda folder: edit_json(folder / INFO, lambda info: info["features"].pop(name))


def truncate(path):
    return lambda folder: (folder / path).write_bytes((folder / path).read_bytes()[:-100])


def change_row(row, **changes):
    return lambda folder: edit_rows(
        folder / DATA, lambda rows: rows[row].update({key.replace("__", "."): to for key, to in changes.items()})
    )


def change_frame(row, content):
    return lambda folder: edit_rows(folder / DATA, lambda rows: rows[row].update({CAMERA: {"bytes": content, "path": None}}))


def drop_row(path, row):
    return lambda folder: edit_rows(folder / path, lambda rows: rows.pop(row))


def lengthen_names(folder):
    edit_json(folder / INFO, lambda info: info["features"]["observation.state"]["names"].append("gripper"))


def drop_scene(folder):
    edit_json(folder / "meta/preimage.json", lambda content: content["scenes"].pop())


DAMAGES = [
    (
        remove(INFO),
        "{0} has no meta/info.json, so it is no LeRobot data set, and no folder in it has pictures and a joints.csv: "
        "name the folder that holds meta/ and data/, or the folders of the episodes",
    ),
    (write(INFO, b'{"fps": 1'), "{0}/meta/info.json is not JSON: the file is damaged, copy the data set again"),
    (write(INFO, b"\xff\xfe"), "{0}/meta/info.json is not JSON: the file is damaged, copy the data set again"),
    (write(INFO, b"[]"), "{0}/meta/info.json holds a list, not an object: the file is damaged, copy the data set again"),
    (
        change_info(codebase_version="v1.6"),
        "{0} is a LeRobot data set of version v1.6: only v2.0, v2.1 and v3.0 can be read, convert it with LeRobot first",
    ),
    (change_info(fps=0), "{0}/meta/info.json has fps 0: it should be the number of steps a second; rates are 0.2 to 1000 Hz"),
    (change_info(fps="ten"), "{0}/meta/info.json has fps 'ten': it should be the number of steps a second; rates are 0.2 to 1000 Hz"),
    (change_info(fps=float("inf")), "{0}/meta/info.json has fps inf: it should be the number of steps a second; rates are 0.2 to 1000 Hz"),
    (change_info(chunks_size=0), "{0}/meta/info.json has chunks_size 0: it should be the number of episodes a folder"),
    (
        change_info(features=None),
        "{0}/meta/info.json has no usable features: they should describe each column by its dtype, shape and names",
    ),
    (change_info(total_episodes=None), "{0}/meta/info.json has total_episodes None: it should be the number of episodes"),
    (drop_feature(CAMERA), "the data set has no camera: one of its features should have dtype image or video"),
    (
        add_camera,
        f"the data set has the cameras {CAMERA}, {WRIST}: choose one by --view.camera, or View(camera=...)",
    ),
    (drop_feature("observation.state"), "the data set has no observation.state: choose one or more of action by --view.state"),
    (
        change_feature("observation.state", names=3),
        "observation.state has the names 3 in meta/info.json: they should be a list with the name of each joint",
    ),
    (
        lengthen_names,
        f"{{0}}/{DATA}, episode 0, step 0 has 2 values of the joints, meta/info.json names 3: let them agree",
    ),
    (remove(INDEX), "{0} has no episodes in meta/episodes: record one or more, or copy the data set again"),
    (truncate(INDEX), f"{{0}}/{INDEX} cannot be read as parquet: the file is damaged or incomplete, copy the data set again"),
    (drop_column(INDEX, "length"), f"{{0}}/{INDEX} has no column length: a LeRobot data set needs it"),
    (
        lambda folder: edit_rows(folder / INDEX, lambda rows: rows[1].update(length=None)),
        "{0}/meta/episodes does not tell length of every episode: the index is damaged, copy the data set again",
    ),
    (remove(DATA), f"{{0}}/{DATA} is missing: copy the data set again"),
    (truncate(DATA), f"{{0}}/{DATA} cannot be read as parquet: the file is damaged or incomplete, copy the data set again"),
    (write(DATA, b""), f"{{0}}/{DATA} cannot be read as parquet: the file is damaged or incomplete, copy the data set again"),
    (drop_column(DATA, CAMERA), f"{{0}}/{DATA} has no column observation.images.camera: a LeRobot data set needs it"),
    (
        drop_row(DATA, 4),
        "{0}, episode 1 has 3 steps of joints, its index says 4: copy the data set again or leave that episode out (--without-episodes 1)",
    ),
    (
        change_row(5, observation__state=[0.0, np.nan]),
        "{0}, episode 1: joints holds nan at step 2, joint joint 1; leave it out by --without-episodes 1",
    ),
    (
        change_row(5, observation__state=[None, 0.0]),
        "{0}, episode 1: joints holds nan at step 2, joint joint 0; leave it out by --without-episodes 1",
    ),
    (
        change_frame(4, png()[:45]),
        f"{{0}}/{DATA}, episode 1, step 1 has a frame that cannot be decoded as PNG, JPEG, WebP, BMP or TIFF: "
        "copy the data set again or leave that episode out (--without-episodes 1)",
    ),
    (
        change_frame(4, None),
        f"{{0}}/{DATA}, episode 1, step 1 has no picture: copy the data set again or leave that episode out (--without-episodes 1)",
    ),
    (
        change_frame(4, png(mode="RGBA")),
        f"{{0}}/{DATA}, episode 1, step 1 has a frame with a fourth channel, the first is in colour: "
        "look at all alike, by --view.colour grey",
    ),
    (
        lambda folder: edit_json(folder / INFO, lambda info: info.update(data_path="{chunk}.parquet")),
        "{0}/meta/info.json has data_path '{{chunk}}.parquet': it should be the pattern of the files' names, "
        "in which {{episode_chunk}}, {{chunk_index}}, {{file_index}} may stand",
    ),
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
    with pytest.raises(ValueError, match="nowhere is not a folder: name that of a data set"):
        load(tmp_path / "nowhere")


def test_unknown_camera_is_told(folder):
    with pytest.raises(ValueError, match=f"no camera top: it has {CAMERA}$"):
        load(folder, view=View(camera="top"))


def test_a_flipped_bit_in_a_frame_is_seen(folder):
    """Pages carry checksums, so what still parses but is no longer what was written is refused."""
    content = bytearray((folder / DATA).read_bytes())
    content[content.index(b"IDAT") + 20] ^= 1
    (folder / DATA).write_bytes(content)
    with pytest.raises(ValueError, match="cannot be read as parquet"):
        load(folder)
