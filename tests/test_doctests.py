"""Every example in the source runs, none is passed over."""

import doctest
import importlib
from pathlib import Path
from types import ModuleType

import pytest

import preimage

ROOT = Path(preimage.__file__).parent
WITH_EXAMPLES = sorted(path for path in ROOT.rglob("*.py") if ">>> " in path.read_text())


class OwnFinder(doctest.DocTestFinder):
    """Takes a function for the module's own by its name: wrapped by the check of shapes, it has the globals of another."""

    def _from_module(self, module: ModuleType, object: object) -> bool:
        return getattr(object, "__module__", None) == module.__name__


@pytest.mark.parametrize("path", WITH_EXAMPLES, ids=lambda path: str(path.relative_to(ROOT)))
def test_examples(path):
    parts = path.relative_to(ROOT.parent).with_suffix("").parts
    if path.name == "gym.py":
        pytest.importorskip("gymnasium")
    if path.name in ("simd.py", "convolution.py", "compiled.py", "program.py"):
        pytest.importorskip("numba")
    module = importlib.import_module(".".join(part for part in parts if part != "__init__"))
    runner = doctest.DocTestRunner()
    for test in OwnFinder().find(module):
        runner.run(test)
    written = sum(line.lstrip().startswith(">>> ") for line in path.read_text().splitlines())
    assert (runner.failures, runner.tries) == (0, written)
