"""The cause and not a remedy is told, and what a spreadsheet or a copy does to a data set is read or named."""

import pyarrow.parquet as pq
import pytest

from planar_arm import (
    EIGHT,
    NAMES,
    TOP,
    as_table,
    assert_read_right,
    checked,
    encoded,
    into_videos,
    refused_alike,
    write_plain,
    write_v2,
    write_v3,
)
from preimage.data.dataset import load
from recordings import write_rows


@pytest.mark.parametrize("version", ["v2", "v3", "plain"])
def test_a_git_lfs_pointer_is_called_so(tmp_path, version):
    folder = {
        "v2": lambda place: into_videos(write_v2(place)),
        "v3": lambda place: write_v3(place, EIGHT),
        "plain": write_plain,
    }[version](tmp_path / "data")
    for path in (*folder.rglob("*.parquet"), *folder.rglob("*.mp4"), *folder.rglob("*.png")):
        path.write_text(f"version https://git-lfs.github.com/spec/v1\noid sha256:{'7' * 64}\nsize 12345\n")
    refused_alike(folder, "is a Git LFS pointer, .*git lfs pull")


@pytest.mark.parametrize("separator", [";", "\t", ","])
@pytest.mark.parametrize("decimal", [",", "."])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_the_table_of_a_spreadsheet_is_read(tmp_path, separator, decimal, encoding):
    table = as_table(NAMES, lambda _, joints: [f"{joint:.6f}".replace(".", decimal) for joint in joints], separator)
    folder = write_plain(tmp_path / "data", lambda joints: table(joints) + f"{separator}\n  \n", encoding=encoding)
    assert_read_right(folder)


def test_decimal_commas_between_commas_are_told(tmp_path):
    folder = write_plain(tmp_path / "data", lambda _: "shoulder,elbow\n0,5,1,2\n")
    refused_alike(folder, "row 1 has 4 columns, the head 2: .*where commas stand before decimals, semicolons have to separate")


@pytest.mark.parametrize("suffix", [".bmp", ".webp", ".tiff", ".jpg"])
def test_pictures_may_be_of_any_format_of_goals(tmp_path, suffix):
    assert_read_right(write_plain(tmp_path / "data", suffix=suffix))


def test_pictures_in_a_subfolder_are_told(tmp_path):
    folder = write_plain(tmp_path / "data")
    for take in folder.glob("take *"):
        (take / "images").mkdir()
        for path in list(take.glob("*.png")):
            path.rename(take / "images" / path.name)
    refused_alike(folder, "take 0 has no picture beside joints.csv \\(there is a folder images with 20\\)")
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
        refused_alike(folder, "has no picture: the table names a file \\(images/.*\\) instead of holding the picture")


def test_a_picture_outside_of_the_folder_is_not_read(tmp_path):
    (tmp_path / "secret.png").write_bytes(encoded(EIGHT[0][0][0]))
    for place, name in ((tmp_path / "up", "../secret.png"), (tmp_path / "away", str(tmp_path / "secret.png"))):
        folder = write_v2(place)
        for path in folder.glob("data/*/*.parquet"):
            rows = pq.read_table(path).to_pylist()
            for row in rows:
                row[TOP] = {"bytes": None, "path": name}
            write_rows(path, rows)
        refused_alike(folder, "only files in the folder of the data set are read")
