"""The house: a wing imports only wings below its own, and some doors are walled up altogether (DESIGN: "the house")."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import preimage

ROOT = Path(preimage.__file__).parent
WINGS = [
    *("records", "compute", "network", "fast", "data", "storage", "method", "ideas", "presets"),
    *("robot", "examination", "report", "evaluation", "studio", "cli"),
]
"""From the ground up. `presets` alone wires ideas into the method."""
PLANNER = {"robot", "mujoco", "examination", "report", "evaluation", "studio", "cli"}
WALLS = {  # wing or room -> what it never imports, wherever it stands
    "robot": {"torch"},
    "report": {"torch", "mujoco"},
    "examination": {"torch", "mujoco", "robot"},
    "network": {"mujoco"},
    "method": PLANNER | {"ideas", "presets"},
    "ideas": PLANNER | {"presets"},
    "presets": PLANNER,
}
"""The planner, which is the method, the ideas and the presets, never sees simulator, judge or test set; the method sees no idea."""
MADE_OF = {  # an idea -> the ideas that it is made of
    "end_correction": {"gripper_events", "memory"},
    "expected_joints": {"memory"},
    "gauss_newton": {"residuals"},
    "gripper_events": {"residuals"},
    "held_out_error": {"gauss_newton"},
    "hold_goal": {"residuals"},
    "last_look": {"memory"},
    "memory": {"gripper_events", "image_features", "kriging", "pauses", "unseen_parts"},
    "mixup": {"image_features"},
    "trust": {"calibration", "image_features", "kriging", "memory", "unseen_parts"},
    "moved_things": {"memory"},
    "leg": {"belief", "timed_search", "underway"},
    "replanning": {"belief", "gripper_events", "leg", "replan_config", "timed_search", "underway"},
    "timed_search": {"gauss_newton", "residuals"},
    "underway": {"residuals"},
    "watched": {"residuals"},
}
ROOMS = sorted(path for path in ROOT.rglob("*.py") if path not in (ROOT / "__init__.py", ROOT / "__main__.py"))


def wing_of(path: Path) -> str:
    return path.relative_to(ROOT).parts[0].removesuffix(".py")


def names_in(path: Path) -> set[str]:
    """Every name that a room imports, at its top or inside a function, in full."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path.name} imports relatively: write the whole name"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def imported(path: Path) -> set[str]:
    """Wings of ours and packages of others that a room imports."""
    return {name.split(".")[1] if name.startswith("preimage.") else name.split(".")[0] for name in names_in(path)}


def test_a_wing_imports_only_wings_below_it():
    through_a_ceiling = {
        str(path.relative_to(ROOT)): above
        for path in ROOMS
        if (above := imported(path) & set(WINGS[WINGS.index(wing_of(path)) + 1 :]) | imported(path) & {"preimage"})
    }
    assert not through_a_ceiling


def test_no_room_reaches_through_a_wall():
    assert not {str(path.relative_to(ROOT)): beyond for path in ROOMS if (beyond := imported(path) & WALLS.get(wing_of(path), set()))}


def test_an_idea_imports_no_other_than_what_it_is_made_of():
    ideas = {path.stem: path for path in (ROOT / "ideas").glob("*.py") if path.stem != "__init__"}
    others = {name: {each.split(".")[2] for each in names_in(path) if each.startswith("preimage.ideas.")} for name, path in ideas.items()}
    assert {name: used for name, used in others.items() if used} == MADE_OF


WIRES_NOTHING = {
    "preimage.ideas.waypoints.join",
    "preimage.ideas.memory.DemonstrationMemory",
    "preimage.ideas.calibration.Calibration",
    "preimage.ideas.watched.Considered",
    "preimage.ideas.belief.Belief",
    "preimage.ideas.belief.Imagined",
}
"""What joins plans that were made, what is kept of demonstrations, what was learned of trust in plans, and what a search or a replanner
tells of itself, anyone may name."""


def test_presets_alone_wire_ideas_into_the_method():
    others = [path for path in ROOMS if wing_of(path) not in ("ideas", "presets")]
    wired = {str(path.relative_to(ROOT)): {name for name in names_in(path) if name.startswith("preimage.ideas")} for path in others}
    assert not {path: names - WIRES_NOTHING for path, names in wired.items() if names - WIRES_NOTHING}


def test_contributors_read_of_the_wings_in_this_order():
    text = (Path(__file__).parents[1] / "CONTRIBUTING.md").read_text()
    rows = re.findall(r"^\| `(\w+)(?:\.py)?` \|", text, re.MULTILINE)
    assert rows == WINGS


def test_every_wing_that_is_listed_is_there():
    assert set(WINGS) == {wing_of(path) for path in ROOMS}


POSIX_ONLY = {"resource", "fcntl", "pwd", "grp", "termios", "tty", "pty", "syslog", "posix", "curses", "crypt", "spwd", "nis", "readline"}
"""Modules of the standard library that Windows does not have."""


def on_import(node: ast.AST) -> Iterator[ast.AST]:
    """What runs when a file is imported: all but the insides of functions."""
    for child in ast.iter_child_nodes(node):
        if not isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            yield child
            yield from on_import(child)


def modules_of(node: ast.AST) -> list[str]:
    """What an import names."""
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    return [node.module or ""] if isinstance(node, ast.ImportFrom) else []


def test_nothing_is_imported_at_once_that_windows_does_not_have():
    trees = {path.relative_to(ROOT): ast.parse(path.read_text()) for path in ROOT.rglob("*.py")}
    packages = {path: {name.split(".")[0] for node in on_import(tree) for name in modules_of(node)} for path, tree in trees.items()}
    assert not {str(path): missing for path, names in packages.items() if (missing := names & POSIX_ONLY)}
