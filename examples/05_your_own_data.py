"""Recordings of your own: a plain folder of pictures and tables of joints is checked, learned from and planned with.

    python examples/05_your_own_data.py --out demo

The recordings are made up here, a bright square that two joints move over a picture, so that you see what goes where; put yours in their
place. The commands are those of the command line, and they are all that is needed.
"""

import csv
from pathlib import Path

import numpy as np
import tyro
from PIL import Image

from preimage.cli import main as preimage

RATE_HZ = 5


def make_up(take: Path, rng: np.random.Generator, num_steps: int = 12) -> None:
    """One episode: 0000.png, 0001.png and so on, and joints.csv with a row for each of them."""
    take.mkdir(parents=True)
    ends = rng.uniform(-1, 1, (2, 2)) * (0.1, 1)  # starts are alike, goals are not
    way = np.minimum(np.linspace(0, 1.3, num_steps), 1)[:, None]  # it rests where it has arrived
    joints = ends[:, 0] + way * (ends[:, 1] - ends[:, 0])
    with (take / "joints.csv").open("w", newline="") as file:
        csv.writer(file).writerows([("pan", "tilt"), *joints.round(4).tolist()])
    for step, (pan, tilt) in enumerate(joints):
        picture = np.full((48, 64), 90, np.uint8)
        row, column = round(18 + 16 * tilt), round(26 + 24 * pan)
        picture[row : row + 12, column : column + 12] = 230
        Image.fromarray(picture).save(take / f"{step:04d}.png")


def main(out: Path = Path("demo"), episodes: int = 24, updates: int = 300, quick: bool = False) -> None:
    """Make recordings up, check them, train the smallest network on them, and plan to a picture.

    Args:
        out: folder for recordings, run and plan; of former ones nothing may be there.
        episodes: how many recordings.
        updates: how long to train.
        quick: hardly any recordings and training, to see that everything runs.
    """
    data, run, rng = out / "my-data", out / "my-run", np.random.default_rng(0)
    for number in range(4 if quick else episodes):
        make_up(data / f"take {number}", rng)
    make_up(out / "not-shown", rng)
    (data / "rate_hz").write_text(f"{RATE_HZ}\n")

    preimage(["check", f"{data}", "--out", f"{out / 'check.html'}"])
    preimage(["train", f"{data}", "--out", f"{run}", "--size", "tiny", "--updates", "2" if quick else f"{updates}"])
    goal = out / "not-shown" / "0011.png"  # any picture that the same camera took
    preimage(["plan", f"{run}", "--start", f"{data}:0", "--goal", f"{goal}", "--out", f"{out / 'my-plan'}"])


if __name__ == "__main__":
    tyro.cli(main)
