"""`preimage check`: the doctor for somebody's own recordings, in words on the screen and in pictures on a page."""

from pathlib import Path

from tyro.conf import Positional

from preimage.dataset import read_episodes
from preimage.examination import examine
from preimage.report import examined_page
from preimage.view import View


def check(data: Positional[Path], out: Path = Path("check.html"), view: View = View()) -> None:  # noqa: B008, frozen
    """Say whether recordings can be learned from, what is wrong with them and what would help.

    Args:
        data: a LeRobotDataset, v3.0 or v2.1, or a folder of pictures and tables of joints.
        out: page to write, with pictures.
        view: how the recordings are looked at.
    """
    examination = examine(read_episodes(data, view=view))
    examined_page(examination, out, title=f"preimage check: {data.name}")
    for finding in examination.findings:
        print(finding)
    print(f"the pictures are in {out}")
    print(examination.verdict)
    if not examination.trainable:
        raise SystemExit(1)
