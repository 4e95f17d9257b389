"""The cause and not a remedy is told, and what a spreadsheet or a copy does to a data set is read or named."""

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from planar_arm import (
    EIGHT,
    NAMES,
    PLAIN,
    TOP,
    as_table,
    assert_read_right,
    assert_refused_alike,
    checked,
    encoded,
    into_videos,
    write_plain,
    write_v2,
    write_v3,
)
from preimage.data.dataset import load, open_recordings
from preimage.examination import Kind
from preimage.storage.recordings import save
from recordings import WRITERS, write_rows, write_video


@pytest.mark.parametrize("version", ["v2", "v3", "plain"])
def test_a_git_lfs_pointer_is_called_so(tmp_path, version):
    folder = {
        "v2": lambda place: into_videos(write_v2(place)),
        "v3": lambda place: write_v3(place, EIGHT),
        "plain": write_plain,
    }[version](tmp_path / "data")
    for path in (*folder.rglob("*.parquet"), *folder.rglob("*.mp4"), *folder.rglob("*.png")):
        path.write_text(f"version https://git-lfs.github.com/spec/v1\noid sha256:{'7' * 64}\nsize 12345\n")
    assert_refused_alike(folder, "is a Git LFS pointer, .*git lfs pull")


@pytest.mark.parametrize("separator", [";", "\t", ","])
@pytest.mark.parametrize("decimal", [",", "."])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_the_table_of_a_spreadsheet_is_read(tmp_path, separator, decimal, encoding):
    table = as_table(NAMES, lambda _, joints: [f"{joint:.6f}".replace(".", decimal) for joint in joints], separator)
    folder = write_plain(tmp_path / "data", lambda joints: table(joints) + f"{separator}\n  \n", encoding=encoding)
    assert_read_right(folder)


def test_decimal_commas_between_commas_are_told(tmp_path):
    folder = write_plain(tmp_path / "data", lambda _: "shoulder,elbow\n0,5,1,2\n")
    assert_refused_alike(folder, "row 1 has 4 columns, the head 2: .*where commas stand before decimals, semicolons have to separate")


@pytest.mark.parametrize("suffix", [".bmp", ".webp", ".tiff", ".jpg"])
def test_pictures_may_be_of_any_format_of_goals(tmp_path, suffix):
    assert_read_right(write_plain(tmp_path / "data", suffix=suffix))


def test_pictures_in_a_subfolder_are_told(tmp_path):
    folder = write_plain(tmp_path / "data")
    for take in folder.glob("take *"):
        (take / "images").mkdir()
        for path in list(take.glob("*.png")):
            path.rename(take / "images" / path.name)
    assert_refused_alike(folder, "take 0 has no picture beside joints.csv \\(there is a folder images with 20\\)")
    faults = " ".join(finding.what for finding in checked(folder).findings)
    assert "take 0 has no picture beside joints.csv (there is a folder images with 20)" in faults


def test_a_folder_of_notes_is_no_episode(tmp_path):
    folder = write_plain(tmp_path / "data")
    (folder / "notes").mkdir()
    (folder / "notes/friday.txt").write_text("the cup fell over")
    assert_read_right(folder)


def test_a_trained_model_is_no_data_set(tmp_path):
    (tmp_path / "config.json").write_text("{}")
    with pytest.raises(ValueError, match=r"holds a trained model .* and no recordings"):
        load(tmp_path)


@pytest.mark.parametrize("there", [True, False])
def test_pictures_by_path_are_read_or_named(tmp_path, there):
    folder = write_v2(tmp_path / "data")
    for path in folder.glob("data/*/*.parquet"):
        rows = pq.read_table(path).to_pylist()
        for row in rows:
            name = f"images/{TOP}/episode_{row['episode_index']:06d}/frame_{row['frame_index']:06d}.png"
            if there:
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                (folder / name).write_bytes(row[TOP]["bytes"])
            row[TOP] = {"bytes": None, "path": name}
        write_rows(path, rows)
    if there:
        assert_read_right(folder)
    else:
        assert_refused_alike(folder, "has no picture: the table names a file \\(images/.*\\) instead of holding the picture")


def test_a_picture_outside_of_the_folder_is_not_read(tmp_path):
    (tmp_path / "secret.png").write_bytes(encoded(EIGHT[0][0][0]))
    for place, name in ((tmp_path / "up", "../secret.png"), (tmp_path / "away", str(tmp_path / "secret.png"))):
        folder = write_v2(place)
        for path in folder.glob("data/*/*.parquet"):
            rows = pq.read_table(path).to_pylist()
            for row in rows:
                row[TOP] = {"bytes": None, "path": name}
            write_rows(path, rows)
        assert_refused_alike(folder, "only files in the folder of the data set are read")


ROWS = {
    "pandas": as_table(["", *NAMES], lambda step, joints: [step, *joints]),
    "a column too many": as_table([*NAMES, ""], lambda _, joints: [*joints, ""]),
    "numpy.savetxt": lambda joints: "# shoulder elbow\n" + "".join(" ".join(f"{each:.9e}" for each in row) + "\n" for row in joints),
    "numpy.savetxt with commas": lambda joints: "# shoulder,elbow\n" + "".join(",".join(map(str, row)) + "\n" for row in joints.tolist()),
}


@pytest.mark.parametrize("writer", ROWS)
def test_tables_of_others_are_read(tmp_path, writer):
    assert_read_right(write_plain(tmp_path / "data", ROWS[writer]))


def test_motors_may_be_called_by_their_numbers(tmp_path):
    assert_read_right(write_plain(tmp_path / "data", as_table(["1", "2"], lambda _, joints: joints.tolist())), ("1", "2"))


def test_true_and_false_are_one_and_nothing(tmp_path):
    table = as_table([*NAMES, "grasped"], lambda step, joints: [*joints, step > 10])
    (one, *_) = load(write_plain(tmp_path / "data", table))
    assert one.joints[:, 2].tolist() == [float(step > 10) for step in range(20)]


@pytest.mark.parametrize(
    ("table", "sentence"),
    [
        (lambda joints: PLAIN(joints).partition("\n")[2], r"begins with numbers \(.*\): its first row should hold the names of the joints"),
        (as_table(["image", *NAMES], lambda step, joints: [f"{step}.png", *joints]), r"row 1 holds 0.png under image: .* take a column"),
        (as_table(["Zeit", *NAMES], lambda step, joints: [f"1.5.2024 9:{step}", *joints]), r"row 1 holds 1.5.2024 9:0 under Zeit"),
    ],
)
def test_what_is_no_number_is_named_with_its_column(tmp_path, table, sentence):
    assert_refused_alike(write_plain(tmp_path / "data", table), sentence)


def test_where_the_data_set_lies_instead_is_told(tmp_path):
    folder = write_v2(tmp_path / "hub/user/name", EIGHT[:1])
    for named in (tmp_path / "hub", folder / "meta"):
        with pytest.raises(ValueError, match=f"name {folder}, which is one"):
            load(named)


def test_recordings_of_another_format_are_told_what_to_become(tmp_path):
    folder = tmp_path / "data"  # beside which there is no other
    folder.mkdir()
    (folder / "episode_0.hdf5").write_bytes(b"")
    with pytest.raises(ValueError, match=r"convert its .hdf5 files to a LeRobot data set, or to a folder an episode"):
        load(folder)


@pytest.mark.parametrize(("times", "words"), [(3, "as of a video at 3 times the rate, or of 3 cameras"), (0.5, "took one in 2")])
def test_frames_that_are_a_multiple_of_the_rows_say_so(tmp_path, times, words):
    folder = into_videos(write_v2(tmp_path / "data"))
    for number, (frames, _) in enumerate(EIGHT):
        shown = [frames[step] for step in np.arange(0, len(frames), 1 / times).astype(int)]
        write_video(folder / f"videos/chunk-000/{TOP}/episode_{number:06d}.mp4", shown)
    assert_refused_alike(folder, words)
    assert words in " ".join(finding.what for finding in checked(folder).findings)


@pytest.mark.parametrize("name", ["a:b", "file:x", "%03d", "a b?c#d", "new\nline", "-o"])
@pytest.mark.parametrize("version", WRITERS)
def test_the_name_of_a_folder_is_no_address(tmp_path, monkeypatch, version, name):
    """Libraries take what has a colon in it for an address; it is relative here, for an absolute path begins otherwise."""
    monkeypatch.chdir(tmp_path)
    WRITERS[version](tmp_path / name)
    opened = load(name)
    save(opened, Path(f"{name} again"), task="pick")
    assert [len(one) for one in load(f"{name} again")] == [len(one) for one in opened]


def test_a_table_under_another_name_is_named(tmp_path):
    folder = write_plain(tmp_path / "data")
    for path in folder.glob("*/joints.csv"):
        path.rename(path.with_name("Joints.csv"))
    assert_refused_alike(folder, "a table of joints is called joints.csv, and .*take 0/Joints.csv is not")


def test_quotes_and_blanks_about_numbers_are_no_part_of_them(tmp_path):
    assert_read_right(
        write_plain(tmp_path / "data", lambda joints: '"shoulder", "elbow"\n' + "".join(f'"{a}", "{b}"\n' for a, b in joints))
    )


def test_a_joint_of_which_nothing_was_recorded_is_left_out(tmp_path):
    """And told; a single number that is missing is a fault still."""
    episodes = [(frames, np.column_stack([joints, np.full(len(joints), np.nan)])) for frames, joints in EIGHT]
    folder = write_v2(tmp_path / "data", episodes, names=[*NAMES, "spare"])
    assert_read_right(folder)
    assert open_recordings(folder).summary[-1] == "2 of 3 joints: shoulder, elbow; left out, for nothing was recorded of it: spare"
    assert "spare holds no number anywhere; training leaves it out" in [each.what for each in checked(folder).findings]
    episodes[3][1][5, 2] = 0.0
    assert_refused_alike(write_v2(tmp_path / "other", episodes, names=[*NAMES, "spare"]), "joints holds nan")


def test_leaving_out_all_episodes_is_no_help(tmp_path):
    folder = write_plain(tmp_path / "data")
    for path in [*folder.glob("*/*.png")]:
        path.with_name(f"right {path.name}").write_bytes(path.read_bytes())
    (finding,) = [each for each in checked(folder).findings if each.kind is Kind.LENGTHS]
    assert finding.help == "record these again: which frame belongs to which joints cannot be known"


def test_what_is_no_position_is_not_offered_as_a_joint(tmp_path):
    episodes = [(frames, np.column_stack([joints, 0.3 * joints[:, 0], np.full(len(joints), 0.1)])) for frames, joints in EIGHT]
    folder = write_v2(tmp_path / "data", episodes, names=[*NAMES, "effort_0", "effort_1"])
    assert_refused_alike(folder, "leave it out by --view.joints shoulder elbow, or name")


@pytest.mark.parametrize(
    ("path", "kind"),
    [
        ("bag 1/bag_0.mcap", ".mcap"),
        ("1.0.0/droid-train.tfrecord-00000-of-00031", ".tfrecord"),
        ("train/data-00000-of-00001.arrow", ".arrow"),
    ],
)
def test_recordings_of_another_kind_are_called_so(tmp_path, path, kind):
    (tmp_path / "data" / path).parent.mkdir(parents=True)
    (tmp_path / "data" / path).write_bytes(b"x")
    assert_refused_alike(tmp_path / "data", f"convert its {kind} files to a LeRobot data set")


def test_rows_that_lack_a_number_in_every_episode_are_to_be_taken_out(tmp_path):
    folder = write_plain(
        tmp_path / "data", lambda joints: "shoulder,elbow\n" + "".join(f"{'' if a == joints[0, 0] else a},{b}\n" for a, b in joints)
    )
    (finding,) = [each for each in checked(folder).findings if each.kind is Kind.NOT_FINITE]
    assert finding.help == "take these rows and their pictures out"
