"""Every name of the code that docs/paper.md and docs/words.md give leads to something that is there."""

import importlib
import importlib.util
import pkgutil
import re
from dataclasses import fields, is_dataclass
from pathlib import Path

import preimage
from preimage.method.config import PlanConfig
from preimage.network.config import ModelConfig, Sensors
from preimage.network.pdvmrnn import PDVMRNN

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
WINGS = {name for _, name, _ in pkgutil.iter_modules(preimage.__path__)}
NAMED = sorted(
    {
        name
        for text in ("paper.md", "words.md")
        for name in re.findall(r"`(\w+(?:\.\w+)+)`", (DOCS / text).read_text())
        if name.split(".")[0] in WINGS
    }
)


def is_there(name: str) -> bool:
    """Whether a dotted name leads to a room, or through one to a class, a function or a field."""
    wing, *parts = name.split(".")
    found = importlib.import_module(f"preimage.{wing}")
    for part in parts:
        if is_dataclass(found) and part in {field.name for field in fields(found)}:
            return True
        if hasattr(found, "__path__") and importlib.util.find_spec(f"{found.__name__}.{part}"):
            found = importlib.import_module(f"{found.__name__}.{part}")
        elif hasattr(found, part):
            found = getattr(found, part)
        else:
            return False
    return True


def test_names_in_the_documents_are_there():
    assert NAMED
    assert not [name for name in NAMED if not is_there(name)]


def test_every_idea_has_its_row_in_the_account_of_the_paper():
    text = (DOCS / "paper.md").read_text()
    ideas = {name for _, name, _ in pkgutil.iter_modules([str(Path(preimage.__path__[0]) / "ideas")])}
    assert ideas == set(re.findall(r"^\| `ideas\.(\w+)` \|", text, re.MULTILINE))


def test_numbers_of_the_paper_preset_are_those_of_the_code():
    text = (DOCS / "paper.md").read_text()
    network, search = ModelConfig.paper(), PlanConfig.paper()
    for sentence in (
        f"{network.intention_noise:g} of their spread (`network.config.ModelConfig.intention_noise`)",
        f"a standard deviation of {search.initial_deviation:g} of theirs",
        f"{search.candidates} candidates side by side",
        f"after {search.screening} iterations (`method.config.PlanConfig.screening`)",
        f"the best {search.finalists} go on",
        f"a rate of {search.learning_rate:g} standard deviations",
        f"after {search.iterations} iterations (`method.config.PlanConfig.iterations`)",
    ):
        assert sentence in text
    assert float(re.findall(r"(\S+) of their squared size", text)[0]) == network.intention_cost


def test_table_one_as_the_document_tells_it():
    sensors = Sensors(64, 64, 1, ("a", "b", "c", "d"), (-1.0,) * 4, (1.0,) * 4)
    shapes = PDVMRNN(ModelConfig.paper(), sensors).state_shapes
    vision = ", ".join("{1}x{2}x{0}".format(*shapes[f"vision{level}"]) for level in (1, 2, 3))
    motor = ", ".join(str(*shapes[f"motor{level}"]) for level in (1, 2, 3))
    top = "{1}x{2}x{0}".format(*shapes["top"])
    assert f"vision {vision}; motor {motor}; shared top {top}" in (DOCS / "paper.md").read_text()


def test_results_name_no_path_of_one_machine():
    paths = [DOCS / "results.md", *(ROOT / "results").rglob("*.json")]
    assert not {path.name: found for path in paths if (found := re.findall(r'[\s"`]/\w+/\S*', path.read_text()))}
