"""The house: a wing imports only wings below its own, and some doors are walled up altogether (DESIGN: "the house")."""

import ast
from pathlib import Path

import preimage

ROOT = Path(preimage.__file__).parent
WINGS = [
    *("records", "compute", "network", "fast", "data", "storage", "ideas", "method"),
    *("robot", "examination", "report", "evaluation", "cli"),
]
"""From the ground up."""
NOT_YET = {"network/pdvmrnn.py", "ideas/memory.py", "ideas/end_correction.py", "ideas/waypoints.py"}
"""Rooms that moved before what they know was taken apart."""
WALLS = {  # wing or room -> what it never imports, wherever it stands
    "robot": {"torch"},
    "report": {"torch", "mujoco"},
    "examination": {"torch", "mujoco", "robot"},
    "network": {"mujoco"},
    "ideas": {"robot", "mujoco", "evaluation"},
    "method": {"robot", "mujoco", "evaluation"},
}
ROOMS = sorted(path for path in ROOT.rglob("*.py") if path not in (ROOT / "__init__.py", ROOT / "__main__.py"))


def wing_of(path: Path) -> str:
    return path.relative_to(ROOT).parts[0].removesuffix(".py")


def imported(path: Path) -> set[str]:
    """Wings of ours and packages of others that a room imports, at its top or inside a function."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path.name} imports relatively: write the whole name"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return {name.split(".")[1] if name.startswith("preimage.") else name.split(".")[0] for name in names}


def test_a_wing_imports_only_wings_below_it():
    through_a_ceiling = {
        str(path.relative_to(ROOT)): above
        for path in ROOMS
        if str(path.relative_to(ROOT)) not in NOT_YET
        and (above := imported(path) & set(WINGS[WINGS.index(wing_of(path)) + 1 :]) | imported(path) & {"preimage"})
    }
    assert not through_a_ceiling


def test_no_room_reaches_through_a_wall():
    assert not {str(path.relative_to(ROOT)): beyond for path in ROOMS if (beyond := imported(path) & WALLS.get(wing_of(path), set()))}


def test_every_wing_that_is_listed_is_there():
    assert set(WINGS) == {wing_of(path) for path in ROOMS}
