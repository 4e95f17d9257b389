"""Which episodes there are and which are taken, and what of them cannot be learned from; `check` and `train` agree."""

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from planar_arm import EIGHT, INFO, LINES, TOP, assert_read_right, checked, into_videos, recorded, refused_alike, write_v2, write_v3
from preimage import cli
from preimage.data.dataset import open_recordings, read_episodes
from preimage.examination import Kind
from recordings import edit_json, write_video


@pytest.mark.parametrize("told", [False, True])
def test_episodes_taken_out_of_the_index_are_not_there(tmp_path, told):
    folder = write_v2(tmp_path / "data")
    lines = (folder / LINES).read_text().splitlines(keepends=True)
    (folder / LINES).write_text("".join(line for number, line in enumerate(lines) if number not in (2, 5)))
    if told:
        edit_json(folder / INFO, lambda info: info.update(total_episodes=6))
    opened = open_recordings(folder)
    assert opened.episodes == (0, 1, 3, 4, 6, 7)
    assert [episode.index for episode in read_episodes(folder)] == [0, 1, 3, 4, 6, 7]
    np.testing.assert_allclose(opened.demonstrations[2].joints, EIGHT[3][1], atol=1e-6)
    assert checked(folder).trainable


@pytest.mark.parametrize("version", ["v2", "v3"])
def test_an_index_in_any_order_is_read(tmp_path, version):
    order = [3, 1, 0, 2, 7, 5, 6, 4]
    if version == "v3":
        return assert_read_right(write_v3(tmp_path / "data", EIGHT, order=order))
    folder = write_v2(tmp_path / "data")
    lines = (folder / LINES).read_text().splitlines()
    (folder / LINES).write_text("\ufeff" + "\n".join(lines[number] for number in order) + "\n\n")
    assert_read_right(folder)


def test_rows_in_any_order_are_put_in_order(tmp_path):
    folder = write_v2(tmp_path / "data")
    path = folder / "data/chunk-000/episode_000003.parquet"
    pq.write_table(pq.read_table(path).take(np.random.default_rng(0).permutation(20)), path)
    assert_read_right(folder)


def test_an_episode_that_is_listed_twice_is_refused(tmp_path):
    folder = write_v2(tmp_path / "data")
    lines = (folder / LINES).read_text()
    (folder / LINES).write_text(lines + lines.splitlines()[3] + "\n")
    refused_alike(folder, "lists episode 3 twice")


def one_bad_episode(place: Path) -> Path:
    folder = into_videos(write_v2(place))
    write_video(folder / f"videos/chunk-000/{TOP}/episode_000003.mp4", list(EIGHT[3][0][:-1]))
    return folder


def test_a_bad_episode_can_be_left_out_and_the_sentence_says_how(tmp_path):
    folder = one_bad_episode(tmp_path / "data")
    refused_alike(folder, "episode 3 has 19 frames for 20 steps of joints: .* leave that episode out \\(--without-episodes 3\\)")
    assert "--without-episodes 3" in " ".join(finding.help for finding in checked(folder).findings)
    assert checked(folder, without=(3,)).trainable
    assert open_recordings(folder, without=(3,)).episodes == (0, 1, 2, 4, 5, 6, 7)
    assert open_recordings(folder, only=(1, 2)).episodes == (1, 2)
    with pytest.raises(ValueError, match="has no episode 9: it has 0 to 7"):
        open_recordings(folder, without=(9,))
    with pytest.raises(ValueError, match=r"no episode of .* is left"):
        open_recordings(folder, only=(3,), without=(3,))


def test_the_run_keeps_which_episodes_it_was_given(tmp_path, capsys):
    folder, run = one_bad_episode(tmp_path / "data"), str(tmp_path / "run")
    words = ["--size", "tiny", "--updates", "1"]
    cli.main(["train", str(folder), "--out", run, *words, "--without-episodes", "3", "--hold-out", "3"])
    data = json.loads((tmp_path / "run/config.json").read_text())["data"]
    assert (data["episodes"], data["held_out"]) == ([0, 1, 2, 4, 5, 6, 7], [2, 6])
    cli.main(["train", str(folder), "--out", run, "--resume"])
    capsys.readouterr()
    quick = ["--iterations", "1", "--horizon", "4", "--out", str(tmp_path / "result.json")]
    cli.main(["evaluate", run, "--data", str(folder), *quick])
    assert capsys.readouterr().out.startswith("2 episodes never trained on: 2, 6\n")
    cli.main(["evaluate", run, "--data", str(folder), "--episodes", "5", "6", *quick])
    assert capsys.readouterr().out.startswith("1 episode never trained on: 6\n")
    cli.main(["check", str(folder), "--without-episodes", "3", "--out", str(tmp_path / "check.html")])
    assert json.loads((tmp_path / "run/config.json").read_text())["task"] == "reach"


# What cannot be learned from is refused by both


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda frames, joints: (frames, 0 * joints), "no joint ever moves"),
        (lambda frames, joints: (0 * frames, joints), "no frame shows anything"),
        (lambda frames, joints: (np.repeat(frames[:1], len(frames), 0), joints), "the frames stay the same while the arm moves"),
    ],
)
def test_what_check_calls_a_fault_train_refuses(tmp_path, refused, change, sentence):
    folder = write_v2(tmp_path / "data", [change(frames, joints) for frames, joints in EIGHT])
    assert not checked(folder).trainable
    code, said = refused("train", folder, "--out", tmp_path / "run", "--size", "tiny", "--updates", 1)
    assert code == 2
    assert sentence in said


def test_first_frames_of_the_episode_before_are_named(tmp_path):
    episodes = recorded(24)
    stale = [
        (np.concatenate([episodes[number - 1][0][-1:] if number else frames[:1], frames[1:]]), joints)
        for number, (frames, joints) in enumerate(episodes)
    ]
    (finding,) = [finding for finding in checked(write_v3(tmp_path / "data", stale)).findings if finding.kind is Kind.STALE]
    assert finding.places == tuple((number, 0) for number in range(1, 24))
