"""What info.json says of paths, counts and shapes is not believed."""

import os

import pytest

from planar_arm import EIGHT, INFO, LINES, assert_read_right, assert_refused_alike, write_plain, write_v2
from preimage.data.dataset import load
from recordings import edit_json


@pytest.mark.parametrize(
    "pattern",
    [
        "/etc/passwd",
        "../other/{episode_index}.parquet",
        "data/../../{episode_index}.parquet",
        "data/{episode_chunk:0999999999d}.parquet",
        "data/{episode_index:>99999}.parquet",
        "data/{episode_index.__class__}.parquet",
        "data/{episode_index!r}.parquet",
        "data/{0}.parquet",
        "data/{episode_index",
        "data/\0.parquet",
        "d" * 1000,
        "",
        7,
        None,
    ],
)
def test_a_pattern_that_leads_astray_is_refused(tmp_path, pattern):
    folder = write_v2(tmp_path / "data", EIGHT[:1])
    edit_json(folder / INFO, lambda info: info.update(data_path=pattern))
    with pytest.raises(ValueError, match=r"has data_path|is not a regular file"):
        load(folder)


@pytest.mark.parametrize("count", [10**8, 10**18])
def test_a_number_of_episodes_is_not_believed(tmp_path, count):
    folder = write_v2(tmp_path / "data")
    edit_json(folder / INFO, lambda info: info.update(total_episodes=count))
    assert_read_right(folder)


@pytest.mark.parametrize("shape", [[10**9], [10**5, 10**5]])
@pytest.mark.parametrize("names", [None, ["state"]])
def test_a_state_of_a_thousand_million_values_is_refused(tmp_path, shape, names):
    folder = write_v2(tmp_path / "data")
    edit_json(folder / INFO, lambda info: info["features"]["observation.state"].update(shape=shape, names=names))
    assert_refused_alike(folder, "1024 values a step are the most that can be joints")


@pytest.mark.parametrize("name", [INFO, LINES, "data/chunk-000/episode_000002.parquet", "take/joints.csv", "take/0.png"])
def test_a_named_pipe_is_not_waited_for(tmp_path, name):
    folder = write_plain(tmp_path / "data") if "take" in name else write_v2(tmp_path / "data")
    path = folder / name.replace("take", "take 2").replace("0.png", "0000.png")
    path.unlink()
    os.mkfifo(path)
    with pytest.raises(ValueError, match="is not a regular file"):
        load(folder)


def test_json_nested_without_end_is_refused(tmp_path):
    folder = write_v2(tmp_path / "data")
    (folder / INFO).write_text("[" * 100_000)
    assert_refused_alike(folder, "info.json is not JSON")


@pytest.mark.parametrize("name", [INFO, LINES])
def test_half_a_character_is_no_text(tmp_path, name):
    folder = write_v2(tmp_path / "data")
    path = folder / name
    path.write_text(path.read_text().replace("{", r'{"note": "\ud83d", ', 1))
    assert_refused_alike(folder, "holds half a character")
    path.write_text(path.read_text().replace(r"\ud83d", r"\ud83d\ude00"))
    assert_read_right(folder)
