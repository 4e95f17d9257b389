"""The rooms stand in one order: each imports only rooms before it, and some doors are walled up altogether (DESIGN: "the house")."""

import ast
from pathlib import Path

import pytest

import preimage

ROOT = Path(preimage.__file__).parent
ORDER = [
    "wording",
    "records",
    "whole_file",
    "coding",
    "blurring",
    "memory",
    "devices",
    "robot",
    "view",
    "pictures",
    "lerobot_reading",
    "lerobot_writing",
    "plain_folder",
    "dataset",
    "examination",
    "maps",
    "cells",
    "lanes",
    "planes",
    "compiled",
    "program",
    "intention",
    "sizes",
    "switches",
    "model",
    "sequences",
    "blending",
    "shifting",
    "limits",
    "prediction_error",
    "batch_error",
    "beginning",
    "hub",
    "runs",
    "processes",
    "interrupts",
    "training",
    "cloning",
    "regression",
    "recall",
    "first_guess",
    "arrival",
    "planning",
    "one_step",
    "legs",
    "plans",
    "sources",
    "execution",
    "environments",
    "evaluation",
    "provenance",
    "experiments",
    "bench",
    "report",
    "held_out",
    "demo",
    "options",
    "cli",
]
WALLS = {  # room -> what it never imports, wherever it stands
    "robot": {"torch"},
    "maps": {"mujoco"},
    "cells": {"mujoco"},
    "lanes": {"torch"},
    "planes": {"torch"},
    "compiled": {"torch"},
    "program": {"robot", "mujoco", "model"},
    "intention": {"robot", "mujoco"},
    "model": {"robot", "mujoco", "dataset"},
    "prediction_error": {"robot", "mujoco", "dataset"},
    "sequences": {"robot", "mujoco"},
    "training": {"robot", "mujoco", "planning"},
    "regression": {"robot", "mujoco", "dataset", "training", "runs", "execution", "evaluation"},
    "planning": {"robot", "mujoco", "dataset", "training", "runs", "execution", "evaluation"},
    "environments": {"torch", "model", "planning"},
    "execution": {"torch", "model", "planning"},
    "examination": {"torch", "mujoco", "robot"},
    "report": {"torch", "mujoco", "robot", "model", "planning", "training"},
}
MODULES = sorted(path for path in ROOT.rglob("*.py") if path != ROOT / "__init__.py")


def room_of(path: Path) -> str:
    return path.relative_to(ROOT).parts[0].removesuffix(".py")


def imported(path: Path) -> set[str]:
    """Rooms of ours and packages of others that a module imports, at its top or inside a function."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path.name} imports relatively: write the whole name"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return {name.split(".")[1] if name.startswith("preimage.") else name.split(".")[0] for name in names}


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(ROOT)))
def test_a_room_imports_only_rooms_before_it(path):
    room = room_of(path)
    assert room in ORDER, f"{room} is a new room: give it its place in ORDER"
    assert not (later := imported(path) & set(ORDER[ORDER.index(room) + 1 :])), f"{room} imports later rooms: {sorted(later)}"
    assert "preimage" not in imported(path), f"{room} imports the package itself: name the room"
    assert not (beyond := imported(path) & WALLS.get(room, set())), f"{room} reaches through a wall: {sorted(beyond)}"


def test_every_room_that_is_listed_is_there():
    assert set(ORDER) == {room_of(path) for path in MODULES}
