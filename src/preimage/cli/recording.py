"""The verbs that make recordings and look through them: record, check.

What a verb's signature does not need is loaded in its function, so that a word that is off is answered at once.
"""

from pathlib import Path

from tyro.conf import Positional

from preimage.cli.screen import followed, following, known_task, validate_seed
from preimage.data.clocks import bounds, is_rate
from preimage.data.view import View
from preimage.network.config import ModelConfig
from preimage.records import number_of
from preimage.storage.output_folders import validate_output_file, validate_output_folder

CHECK_PAGE = {"noun": "page", "marks": (b"<!doctype html>", b"preimage check")}


def record_(task: Positional[str], count: int, out: Path, seed: int = 0, pixels: int = 64) -> None:
    """Record demonstrations of a task on the simulated arm, as a LeRobotDataset v3.0.

    Args:
        task: name of the task.
        count: how many demonstrations.
        out: folder to write, new or empty.
        seed: draws the scenes and the demonstrator's hand.
        pixels: height and width of the frames.
    """
    from preimage.robot import TASKS, Arm, record, with_frames
    from preimage.storage.recordings import save

    known_task(task)
    if not 16 <= pixels <= 1024:
        raise ValueError(f"--pixels is {pixels}: give 16 to 1024")
    validate_seed(seed)
    validate_output_folder(out)
    arm, filmed = Arm(), with_frames(TASKS[task], pixels)
    with following("recording", total=count) as follow:
        demonstrations = record(arm, filmed, count=count, seed=seed, progress=lambda done, _all: follow(done=done))
    save(demonstrations, out, task=task, joint_unit=arm.joint_unit)
    steps = sum(map(len, demonstrations))
    print(f"{number_of(count, 'demonstration')}, {number_of(steps, 'step')} at {TASKS[task].rate_hz:g} Hz, in {out}")


def check(
    data: Positional[Path],
    out: Path = Path("check.html"),
    episodes: tuple[int, ...] | None = None,
    without_episodes: tuple[int, ...] = (),
    rate_hz: float = ModelConfig.rate_hz,
    view: View = View(),  # noqa: B008, frozen
) -> None:
    """Say whether recordings can be learned from, what is wrong with them and what would help.

    Args:
        data: a LeRobotDataset, v3.0, v2.1 or v2.0, or a folder of pictures and tables of joints.
        out: page to write, with pictures.
        episodes: numbers of the episodes to look at; by default all.
        without_episodes: numbers of episodes to leave out.
        rate_hz: steps a second of the model that is going to be trained.
        view: how the recordings are looked at.
    """
    from preimage.data.dataset import describe, episode_numbers, read_episodes, written_here
    from preimage.examination import examine
    from preimage.report.examined import examined_page

    validate_output_file(out, **CHECK_PAGE)
    if not is_rate(rate_hz):
        raise ValueError(f"--rate-hz is {rate_hz}: {bounds()}")
    recordings = read_episodes(data, view=view, only=episodes, without=without_episodes)
    total = len(episode_numbers(data)) if episodes is None else len(episodes)
    recordings = followed(recordings, "reading episodes", total=total - len(without_episodes))
    examination = examine(recordings, rate_hz=rate_hz, joints_chosen=view.joints is not None or written_here(data))
    about = describe(data, state=view.state)
    camera = view.camera or next(iter(about.cameras))
    examined_page(examination, out, title=f"preimage check: {data.name}", camera=camera, joint_unit=about.joint_unit)
    for finding in examination.findings:
        print(finding)
    print(f"the pictures are in {out}")
    print(examination.verdict)
    if not examination.trainable:
        raise SystemExit(1)
