"""Folders of pictures and tables: what they may look like, and what is told where they do not."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from preimage.data.dataset import describe, load, read_episodes
from preimage.data.view import View
from recordings import NAMES, joints_of, shade, write_plain


@pytest.fixture
def folder(tmp_path) -> Path:
    return write_plain(tmp_path / "data")


def test_numbers_in_names_put_episodes_and_frames_in_order(tmp_path):
    """8.png comes before 10.png, and take 9 before take 10."""
    recorded = load(write_plain(tmp_path / "data", lengths=(5, 4, 4)), view=View(joints=tuple(NAMES)))
    for episode, one in enumerate(recorded):
        assert one.frames[:, 16, 50].mean(-1).astype(int).tolist() == [shade(episode, step) for step in range(len(one))]
        np.testing.assert_array_equal(one.joints, joints_of(episode, len(one)))


def test_the_rate_is_in_a_file_or_in_the_times(folder):
    (folder / "rate_hz").write_text(" 12.5 \n")
    assert describe(folder).rate_hz == 12.5
    (folder / "rate_hz").unlink()
    add_times(folder, [0.0, 0.0334, 0.0666, 0.1, 0.2])
    assert describe(folder).rate_hz == 29.94  # the median step counts, not the one that came late
    episode = next(read_episodes(folder))
    assert episode.timestamps_s.tolist() == [0.0, 0.0334, 0.0666, 0.1, 0.2]
    assert episode.joint_names == tuple(NAMES)


def add_times(folder: Path, times: list[float]) -> None:
    """Puts a column of times before the first table."""
    table = folder / "take 8/joints.csv"
    head, *rows = table.read_text().splitlines()
    table.write_text("\n".join([f"time_s,{head}", *(f"{time},{row}" for time, row in zip(times, rows, strict=True))]))


def test_columns_are_told_by_their_names_in_whatever_order_an_episode_has_them(folder):
    before = [one.joints for one in load(folder)]
    path = folder / "take 9/joints.csv"
    path.write_text("\n".join(",".join(reversed(row.split(","))) for row in path.read_text().splitlines()))
    for one, joints in zip(load(folder), before, strict=True):
        np.testing.assert_array_equal(one.joints, joints)


def test_pictures_may_be_jpeg_and_other_files_lie_beside_them(folder):
    take = folder / "take 8"
    for path in take.glob("*.png"):
        Image.open(path).save(path.with_suffix(".JPG"), "JPEG", quality=95)
        path.unlink()
    (take / "notes.txt").write_text("the cup fell over")
    (folder / ".git").mkdir()
    assert [len(one) for one in load(folder)] == [5, 4]


def test_a_fourth_channel_is_depth_unless_it_is_opaque_everywhere(folder):
    for path in folder.rglob("*.png"):
        Image.open(path).convert("RGBA").save(path)
    assert load(folder)[0].frames.shape[-1] == 3
    Image.fromarray(np.full((96, 160, 4), 100, np.uint8)).save(folder / "take 8/9.png")
    frames = load(folder)[0].frames
    assert frames.shape[-1] == 4
    assert (frames[1] == 100).all()  # colours are not weighed by the depth
    assert load(folder, view=View(colour="colour"))[0].frames.shape[-1] == 3


def table(content: str):
    return lambda folder: (folder / "take 9/joints.csv").write_text(content)


DAMAGES = [
    (lambda folder: (folder / "rate_hz").unlink(), "tells no rate: write the pictures a second into .*rate_hz, or a column time_s"),
    (lambda folder: (folder / "rate_hz").write_text("fast"), "rate_hz holds 'fast': it should hold the number of pictures a second"),
    (lambda folder: (folder / "rate_hz").write_text("0"), "rate_hz holds '0': it should hold the number of pictures a second"),
    (lambda folder: (folder / "take 9/joints.csv").unlink(), r"take 9/joints.csv is missing: it should hold the joints, one row a picture"),
    (table(""), "take 9/joints.csv is empty or no table"),
    (table("pan,frozen,lift\n1,2\n"), "take 9/joints.csv, row 1 has 2 columns, the head 3: let them agree"),
    (
        table("pan,frozen,lift\n1,2,left\n"),
        "take 9/joints.csv, row 1 holds left under lift: it should hold numbers",
    ),
    (table("pan,pan,lift\n1,2,3\n"), "has the head pan,pan,lift: it should give each joint a name of its own"),
    (table("pan,tilt\n1,2\n"), "has the joints pan, tilt, the first episode pan, frozen, lift: give all the same"),
    (table("pan,frozen,lift\n1,2,3\n"), "episode 1 has 4 frames for 1 steps of joints"),
    (table("pan,frozen,lift\n" + "1,,3\n" * 4), "episode 1: joints holds nan at step 0, joint frozen"),
    (lambda folder: (folder / "take 9/9.png").unlink(), "episode 1 has 3 frames for 4 steps of joints"),
    (lambda folder: (folder / "take 9/9.png").write_bytes(b"x"), r"take 9/9.png has a frame that cannot be decoded"),
    (
        lambda folder: Image.new("RGB", (9, 9)).save(folder / "take 9/9.png"),
        r"step 1 has a frame of \(9, 9, 3\), the first is of \(96, 160, 3\)",
    ),
]


@pytest.mark.parametrize(("damage", "sentence"), DAMAGES, ids=[sentence[:60] for _, sentence in DAMAGES])
def test_damage_is_told_in_one_sentence(folder, damage, sentence):
    damage(folder)
    with pytest.raises(ValueError, match=sentence):
        load(folder)


def test_there_is_one_camera(folder):
    with pytest.raises(ValueError, match="has no camera wrist: a folder of pictures has one"):
        load(folder, view=View(camera="wrist"))


def test_the_patient_reader_goes_on_after_a_broken_table(folder):
    (folder / "take 8/joints.csv").write_text("nonsense\n")
    (folder / "take 9/joints.csv").unlink()
    _, broken = read_episodes(folder)
    assert (len(broken.frames), len(broken.joints)) == (4, 0)
    assert "is missing" in broken.faults[0]
