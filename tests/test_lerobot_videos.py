"""Each step of an episode finds its own frame in the videos of v2.1 and v3.0; every damage is told in one sentence."""

import io
import struct

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from PIL import Image

from preimage.data.dataset import describe, load
from preimage.data.decoding import ORIENTATION_OF_MATRIX, video_frames
from preimage.data.view import View
from recordings import (
    CAMERA,
    INDEX,
    INFO,
    WRITERS,
    assert_equal,
    change_info,
    drop_column,
    edit_json,
    remove,
    shade,
    shades,
    write,
    write_v21,
    write_v30,
    write_video,
)


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_videos_are_read_frame_by_step(tmp_path, version):
    """Each step shows its own shade on the right: no frame is lost, repeated or taken from the neighbour in the file."""
    lengths = (5, 4, 6)
    folder = WRITERS[version](tmp_path / "data", lengths=lengths)
    for episode, one in enumerate(load(folder)):
        assert one.frames.shape == (lengths[episode], 32, 64, 3)  # 96x160 shrunk
        seen = one.frames[:, 8:24, 40:56].mean((1, 2, 3))
        np.testing.assert_allclose(seen, [shade(episode, step) for step in range(lengths[episode])], atol=3)


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
@pytest.mark.parametrize("episode", range(2))
def test_one_episode_alone_is_the_same_as_among_all(tmp_path, version, episode):
    folder = WRITERS[version](tmp_path / "data")
    (alone,) = load(folder, view=View(joints=("lift",)), only=(episode,))
    among = load(folder, view=View(joints=("lift",)))[episode]
    assert_equal([alone], [among])


def test_describe_reads_no_frame(tmp_path):
    folder = write_v21(tmp_path / "data")
    for path in folder.rglob("*.mp4"):
        path.unlink()
    told = describe(folder)
    assert (told.version, told.cameras, told.joint_names) == ("LeRobotDataset v2.1", {CAMERA: (96, 160, 3)}, ("pan", "frozen", "lift"))
    assert (told.rate_hz, told.num_episodes, told.joint_unit) == (10.0, 2, None)


V21_DATA, V21_VIDEO = "data/chunk-000/episode_000001.parquet", f"videos/chunk-000/{CAMERA}/episode_000001.mp4"
V30_VIDEO = f"videos/{CAMERA}/chunk-000/file-000.mp4"


def halve(path):
    return lambda folder: (folder / path).write_bytes((folder / path).read_bytes()[: (folder / path).stat().st_size // 2])


def shorten_video(path, length):
    return lambda folder: write_video(folder / path, shades(1, length, (96, 160)))


VIDEO_DAMAGES = [
    ("v2.1", remove(V21_VIDEO), f"{{0}}/{V21_VIDEO} is missing: copy the data set again"),
    (
        "v2.1",
        write(V21_VIDEO, b"no video"),
        f"{{0}}/{V21_VIDEO} cannot be decoded as video (Invalid data found when processing input): "
        "the file is damaged or incomplete, copy the data set again or leave that episode out (--without-episodes 1)",
    ),
    (
        "v2.1",
        halve(V21_VIDEO),
        f"{{0}}/{V21_VIDEO} cannot be decoded as video (Invalid data found when processing input): "
        "the file is damaged or incomplete, copy the data set again or leave that episode out (--without-episodes 1)",
    ),
    (
        "v2.1",
        shorten_video(V21_VIDEO, 3),
        "{0}, episode 1 has 3 frames for 4 steps of joints: copy the data set again or leave that episode out (--without-episodes 1)",
    ),
    (
        "v2.1",
        shorten_video(V21_VIDEO, 6),
        "{0}, episode 1 has 6 frames for 4 steps of joints: copy the data set again or leave that episode out (--without-episodes 1)",
    ),
    ("v2.1", remove(V21_DATA), f"{{0}}/{V21_DATA} is missing: copy the data set again"),
    (
        "v2.1",
        drop_column(V21_DATA, "observation.state"),
        f"{{0}}/{V21_DATA} has no column observation.state: a LeRobot data set needs it",
    ),
    ("v2.1", remove("meta/episodes.jsonl"), "{0} has no meta/episodes.jsonl: copy the data set again"),
    (
        "v2.1",
        write("meta/episodes.jsonl", b'{"episode_index": 0}'),
        "{0}/meta/episodes.jsonl, line 1 does not tell an episode's number and length: the file is damaged, copy the data set again",
    ),
    (
        "v2.1",
        write("meta/episodes.jsonl", b""),
        "{0} has no episodes in meta/episodes.jsonl: record one or more, or copy the data set again",
    ),
    (
        "v2.1",
        change_info(video_path=None),
        "{0}/meta/info.json has video_path None: it should be the pattern of the files' names, "
        "in which {{video_key}}, {{episode_chunk}}, {{chunk_index}}, {{episode_index}}, {{file_index}} may stand",
    ),
    ("v3.0", remove(V30_VIDEO), f"{{0}}/{V30_VIDEO} is missing: copy the data set again"),
    (
        "v3.0",
        shorten_video(V30_VIDEO, 7),
        "{0}, episode 1 has 2 frames for 4 steps of joints (2 for each, as where the camera took one in 2): "
        "copy the data set again or leave that episode out (--without-episodes 1)",
    ),
    (
        "v3.0",
        drop_column(INDEX, f"videos/{CAMERA}/from_timestamp"),
        f"{{0}}/{INDEX} has no column videos/{CAMERA}/from_timestamp: a LeRobot data set needs it",
    ),
]


@pytest.mark.parametrize(("version", "damage", "sentence"), VIDEO_DAMAGES, ids=[f"{one[0]} {one[2][:60]}" for one in VIDEO_DAMAGES])
def test_damage_to_videos_is_told_in_one_sentence(tmp_path, version, damage, sentence):
    folder = WRITERS[version](tmp_path / "data")
    damage(folder)
    with pytest.raises(ValueError) as caught:  # noqa: PT011 the whole text is compared below
        load(folder)
    assert str(caught.value) == sentence.format(folder)


def test_damage_in_the_middle_of_a_video_is_seen_or_heard_of(tmp_path):
    folder = write_v21(tmp_path / "data", lengths=(25, 4))
    path = folder / f"videos/chunk-000/{CAMERA}/episode_000000.mp4"
    content = bytearray(path.read_bytes())
    start = content.index(b"mdat") + 4
    middle = (start + len(content)) // 2
    content[start + 200 : middle] = bytes(middle - start - 200)
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"episode_000000\.mp4 (is damaged at|cannot be decoded)|episode 0 has \d+ frames for 25 steps"):
        load(folder)


def test_images_of_v21_lie_among_the_data(tmp_path):
    folder = write_v21(tmp_path / "data")
    edit_json(folder / INFO, lambda info: info["features"][CAMERA].update(dtype="image"))
    for episode, length in enumerate((5, 4)):
        table = pq.read_table(folder / f"data/chunk-000/episode_{episode:06d}.parquet")
        pictures = [{"bytes": encoded(frame), "path": None} for frame in shades(episode, length, (48, 64))]
        pq.write_table(table.append_column(CAMERA, pa.array(pictures)), folder / f"data/chunk-000/episode_{episode:06d}.parquet")
    for episode, one in enumerate(load(folder)):
        np.testing.assert_array_equal(one.frames, shades(episode, len(one), (48, 64)))


def encoded(frame: np.ndarray) -> bytes:
    file = io.BytesIO()
    Image.fromarray(frame).save(file, "PNG")
    return file.getvalue()


@pytest.mark.parametrize("between_keys", [1, 250])
def test_an_episode_is_found_wherever_the_key_frames_are(tmp_path, between_keys):
    folder = write_v30(tmp_path / "data")
    frames = [frame for episode, length in enumerate((5, 4, 6)) for frame in shades(episode, length, (96, 160))]
    write_video(folder / V30_VIDEO, frames, between_keys=between_keys)
    for episode in (2, 1, 0):
        (one,) = load(folder, only=(episode,))
        np.testing.assert_allclose(one.frames[:, 16, 48, 0], [shade(episode, step) for step in range(len(one))], atol=3)


# How a film is held


def turn(video, matrix) -> None:
    """Write a display matrix into the head of the track, as a phone does."""
    content = video.read_bytes()
    fixed = struct.pack(">9i", *(round(65536 * number) for number in (*matrix[0], 0, *matrix[1], 0, 0, 0)), 1 << 30)
    upright = struct.pack(">9i", 65536, 0, 0, 0, 65536, 0, 0, 0, 1 << 30)
    head = content.index(b"tkhd")
    place = content.index(upright, head)
    video.write_bytes(content[:place] + fixed + content[place + len(fixed) :])


def corners(size=(64, 96)) -> np.ndarray:
    """A frame whose four quarters differ, so that no turn of it looks like another."""
    frame = np.full((*size, 3), 20, np.uint8)
    frame[:32, :48], frame[:32, 48:], frame[32:, :48] = (200, 20, 20), (20, 200, 20), (20, 20, 200)
    return frame


@pytest.mark.parametrize("matrix", ORIENTATION_OF_MATRIX)
def test_a_film_is_seen_as_players_show_it(tmp_path, matrix):
    """Where a pixel (column, row) goes is the product with the matrix (ISO 14496-12, 6.2.2)."""
    write_video(tmp_path / "film.mp4", [corners()] * 4)
    turn(tmp_path / "film.mp4", matrix)
    (columns, rows), height, width = np.array(matrix), 64, 96
    row, column = np.mgrid[:height, :width]
    to_column, to_row = (columns[axis] * column + rows[axis] * row for axis in (0, 1))
    shown = np.zeros((np.ptp(to_row) + 1, np.ptp(to_column) + 1, 3), np.uint8)
    shown[to_row - to_row.min(), to_column - to_column.min()] = corners()
    frames = list(video_frames(tmp_path / "film.mp4", rate_hz=10))
    assert len(frames) == 4
    for frame in frames:
        assert frame.shape == shown.shape
        assert np.abs(frame.astype(int) - shown).mean() < 4


def test_a_film_that_is_turned_by_45_degrees_is_refused(tmp_path):
    write_video(tmp_path / "film.mp4", [corners()] * 4)
    half = np.sqrt(0.5)
    turn(tmp_path / "film.mp4", ((half, half), (-half, half)))
    (sentence,) = video_frames(tmp_path / "film.mp4", rate_hz=10)
    assert sentence == f"{tmp_path / 'film.mp4'} is to be shown turned by other than a quarter turn: save it as it is to be looked at"


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_a_data_set_filmed_by_a_phone_on_end_is_seen_upright(tmp_path, version):
    folder = WRITERS[version](tmp_path / "data")
    for video in folder.rglob("*.mp4"):
        turn(video, ((0, 1), (-1, 0)))
    for one in load(folder):
        assert one.frames.shape[1:] == (64, 32, 3)
        assert one.frames[:, :24].mean() != pytest.approx(one.frames[:, 40:].mean(), abs=5)  # what was left is above
