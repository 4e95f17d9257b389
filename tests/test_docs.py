"""Every name of the code that docs/paper.md and docs/words.md give leads to something that is there."""

import importlib
import pkgutil
import re
from dataclasses import fields, is_dataclass
from pathlib import Path

import pytest

import preimage
from preimage.model import PDVMRNN
from preimage.sizes import ModelConfig, Sensors

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
ROOMS = {name for _, name, _ in pkgutil.iter_modules(preimage.__path__)}
NAMED = sorted(
    {
        name
        for text in ("paper.md", "words.md")
        for name in re.findall(r"`(\w+(?:\.\w+)+)`", (DOCS / text).read_text())
        if name.split(".")[0] in ROOMS
    }
)


@pytest.mark.parametrize("name", NAMED)
def test_names_in_the_documents_are_there(name):
    room, *parts = name.split(".")
    found = importlib.import_module(f"preimage.{room}")
    for part in parts:
        if is_dataclass(found) and part in {field.name for field in fields(found)}:
            return
        assert hasattr(found, part)
        found = getattr(found, part)


def test_table_one_as_the_document_tells_it():
    sensors = Sensors(64, 64, 1, ("a", "b", "c", "d"), (-1.0,) * 4, (1.0,) * 4)
    shapes = PDVMRNN(ModelConfig.paper(), sensors).state_shapes
    vision = ", ".join("{1}x{2}x{0}".format(*shapes[f"vision{level}"]) for level in (1, 2, 3))
    motor = ", ".join(str(*shapes[f"motor{level}"]) for level in (1, 2, 3))
    top = "{1}x{2}x{0}".format(*shapes["top"])
    assert f"vision {vision}; motor {motor}; shared top {top}" in (DOCS / "paper.md").read_text()


@pytest.mark.parametrize("path", ["docs/results.md", *(str(path.relative_to(ROOT)) for path in sorted((ROOT / "results").rglob("*.json")))])
def test_results_name_no_path_of_one_machine(path):
    assert not re.findall(r'[\s"`]/\w+/\S*', (ROOT / path).read_text())
