"""Which episodes there are and which are taken, and what of them cannot be learned from; `check` and `train` agree."""

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from planar_arm import EIGHT, INFO, LINES, TOP, assert_read_right, assert_refused_alike, checked, into_videos, recorded, write_v2, write_v3
from preimage import cli
from preimage.data.dataset import open_recordings, read_episodes
from preimage.examination import Kind
from recordings import edit_json, edit_rows, write_rows, write_video


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
    assert_refused_alike(folder, "lists episode 3 twice")


def one_bad_episode(place: Path) -> Path:
    folder = into_videos(write_v2(place))
    write_video(folder / f"videos/chunk-000/{TOP}/episode_000003.mp4", list(EIGHT[3][0][:-1]))
    return folder


def test_a_bad_episode_can_be_left_out_and_the_sentence_says_how(tmp_path):
    folder = one_bad_episode(tmp_path / "data")
    assert_refused_alike(folder, "episode 3 has 19 frames for 20 steps of joints: .* leave that episode out \\(--without-episodes 3\\)")
    assert "--without-episodes 3" in " ".join(finding.help for finding in checked(folder).findings)
    assert checked(folder, without=(3,)).trainable
    assert open_recordings(folder, without=(3,)).episodes == (0, 1, 2, 4, 5, 6, 7)
    assert open_recordings(folder, only=(1, 2)).episodes == (1, 2)
    with pytest.raises(ValueError, match="has no episode 9: it has 0 to 7"):
        open_recordings(folder, without=(9,))
    with pytest.raises(ValueError, match=r"no episode of .* is left"):
        open_recordings(folder, only=(3,), without=(3,))


@pytest.mark.slow
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


@pytest.mark.parametrize("layout", ["v2", "v3", "unnamed"])
def test_two_tasks_by_their_numbers_are_named(tmp_path, layout):
    folder = write_v3(tmp_path / "data", EIGHT) if layout == "v3" else write_v2(tmp_path / "data")
    if layout == "v3":
        index = next(folder.glob("meta/episodes/*/*.parquet"))
        pq.write_table(pq.read_table(index).drop_columns(["tasks"]), index)
        pq.write_table(pa.table({"task_index": [0, 1], "__index_level_0__": ["pick", "place"]}), folder / "meta/tasks.parquet")
    else:
        (folder / LINES).write_text("".join(json.dumps({"episode_index": number, "length": 20}) + "\n" for number in range(8)))
    if layout == "v2":
        (folder / "meta/tasks.jsonl").write_text('{"task_index": 0, "task": "pick"}\n{"task_index": 1, "task": "place"}\n')
    for path in folder.glob("data/*/*.parquet"):
        write_rows(path, [row | {"task_index": row["episode_index"] % 2} for row in pq.read_table(path).to_pylist()])
    (finding,) = [finding for finding in checked(folder).findings if finding.kind is Kind.TASKS]
    pick, place = ("task 0", "task 1") if layout == "unnamed" else ("pick", "place")
    assert f"{pick!r} (episodes 0, 2, 4, 6), {place!r} (episodes 1, 3, 5, 7)" in finding.what
    assert open_recordings(folder).task is None
    assert open_recordings(folder, only=(1, 3)).task == place


def test_all_that_an_episode_shows_is_its_task(tmp_path):
    folder = write_v2(tmp_path / "data")
    shown = [["pick", "place"] if number < 6 else ["place"] for number in range(8)]
    lines = [json.dumps({"episode_index": number, "length": 20, "tasks": tasks}) for number, tasks in enumerate(shown)]
    (folder / LINES).write_text("\n".join(lines))
    (finding,) = [finding for finding in checked(folder).findings if finding.kind is Kind.TASKS]
    assert "'pick, place' (episodes 0 to 5), 'place' (episodes 6, 7)" in finding.what


@pytest.mark.parametrize("kept", ["index", "timestamp"])
def test_rows_without_a_frame_index_are_put_in_order_by_what_counts_them(tmp_path, kept):
    folder, rng = write_v2(tmp_path / "data"), np.random.default_rng(0)
    for path in folder.glob("data/*/*.parquet"):
        rows = pq.read_table(path).to_pylist()
        for row in rows:
            step = row.pop("frame_index")
            row |= {"index": 20 * row["episode_index"] + step} if kept == "index" else {"frame_index": 0}
        write_rows(path, [rows[row] for row in rng.permutation(20)])
    assert_read_right(folder)


def test_a_step_without_joints_is_named(tmp_path):
    folder = write_v2(tmp_path / "data")
    path = folder / "data/chunk-000/episode_000004.parquet"
    edit_rows(path, lambda rows: rows[7].update({"observation.state": None}))
    (finding,) = [finding for finding in checked(folder).findings if finding.kind is Kind.NOT_FINITE]
    assert finding.places == ((4, 7),)
    assert_refused_alike(folder, "episode 4: joints holds nan at step 7")


@pytest.mark.parametrize(
    ("late", "words"),
    [(2, "the picture lags the joints by 2"), (3, "the picture lags the joints by 3"), (-2, "the joints lag the picture by 2")],
)
def test_pictures_and_joints_of_different_moments_are_told_in_steps(tmp_path, late, words):
    episodes = []
    for frames, joints in recorded(8, 40):
        behind = np.maximum(np.arange(40) - abs(late), 0)
        episodes.append((frames[behind], joints) if late > 0 else (frames, joints[behind]))
    (finding,) = [finding for finding in checked(write_v3(tmp_path / "data", episodes)).findings if finding.kind is Kind.LAG]
    assert words in finding.what
