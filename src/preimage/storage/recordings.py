"""Demonstrations to disk as a whole: a LeRobotDataset v3.0 (`data.lerobot_writer`) that is there completely, or not at all."""

from collections.abc import Sequence
from pathlib import Path

from preimage.data.lerobot_writer import validate_alike, write_files
from preimage.records import Demonstration
from preimage.storage.output_folders import output_folder


def save(demonstrations: Sequence[Demonstration], folder: Path | str, *, task: str, joint_unit: str | None = None) -> None:
    """`folder` holds the demonstrations, all of them; after a failure it is as it was before, and a killed process leaves nothing that
    the next one does not remove.

    The action of a step is the joints one step later, the last repeated: what a replay commands. Grey frames are written as three
    equal channels, for LeRobot expects three.

    Args:
        task: what is shown, in words, for policies conditioned on language.
        joint_unit: the unit of the joints, where it is known; LeRobot has no place for it, so it stands in ours.

    Raises:
        ValueError: there is something in the folder, or the demonstrations do not agree in frame size, joints or rate.
        OSError: the disk is full or forbidden.
    """
    validate_alike(demonstrations)
    with output_folder(Path(folder)) as draft:
        write_files(demonstrations, draft, task=task, joint_unit=joint_unit)
