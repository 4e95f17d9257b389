"""Data sets that LeRobot 0.6.1 itself wrote (tests/data), by its own LeRobotDataset.create, add_frame, save_episode and finalize.

Both have two episodes at 10 Hz of a robot of three joints: `lerobot-images` five steps each with pictures of 16x16 pixels,
`lerobot-video` eight with pictures of 64x64, in one AV1 video as LeRobot encodes them. What they show is told by the functions below.
"""

from pathlib import Path

import numpy as np
import pytest

from preimage.data.dataset import load

DATA = Path(__file__).parent / "data"


def joints_of(episode: int, num_steps: int) -> np.ndarray:
    step = np.arange(num_steps)
    return np.stack([0.1 * step + 0.5 * episode, -0.25 * step, 0.05 * step * (1 + episode)], 1).astype(np.float32)


def frames_of(episode: int, num_steps: int, side: int) -> np.ndarray:
    """Red grows to the right and with time, green downwards and from one episode to the next, blue with time."""
    step, row, column = np.mgrid[:num_steps, :side, :side]
    by = 160 // side
    return np.stack([by * column + 8 * step, by * row + 60 * episode, 20 * step + 10], -1).astype(np.uint8)


@pytest.mark.parametrize(("name", "num_steps", "side", "coding_loss"), [("lerobot-images", 5, 16, 0), ("lerobot-video", 8, 64, 6)])
def test_what_lerobot_wrote_is_read(name, num_steps, side, coding_loss):
    episodes = load(DATA / name)
    assert len(episodes) == 2
    for episode, read in enumerate(episodes):
        assert (read.rate_hz, read.joint_names) == (10.0, ("pan", "lift", "grip"))
        np.testing.assert_array_equal(read.joints.astype(np.float32), joints_of(episode, num_steps))
        off = np.abs(read.frames.astype(int) - frames_of(episode, num_steps, side))
        assert off.shape == (num_steps, side, side, 3)
        assert off.max() <= coding_loss
