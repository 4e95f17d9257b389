"""Every example in the source runs, none is passed over."""

import doctest
import importlib
import importlib.util
from pathlib import Path
from types import ModuleType

import preimage

ROOT = Path(preimage.__file__).parent
NEEDED = {"gym.py": "gymnasium", "closed.py": "starlette"} | dict.fromkeys(
    ("simd.py", "convolution.py", "compiled.py", "program.py"), "numba"
)
"""The libraries of files that may not be there."""
WITH_EXAMPLES = sorted(path for path in ROOT.rglob("*.py") if ">>> " in path.read_text())


class OwnFinder(doctest.DocTestFinder):
    """Takes a function for the module's own by its name: wrapped by the check of shapes, it has the globals of another."""

    def _from_module(self, module: ModuleType, object: object) -> bool:
        return getattr(object, "__module__", None) == module.__name__


def tried(path: Path) -> tuple[int, int]:
    """How many examples of a file failed, and how many ran."""
    parts = path.relative_to(ROOT.parent).with_suffix("").parts
    module = importlib.import_module(".".join(part for part in parts if part != "__init__"))
    runner = doctest.DocTestRunner()
    for test in OwnFinder().find(module):
        runner.run(test)
    return runner.failures, runner.tries


def test_every_example_in_the_source_runs_and_passes():
    assert WITH_EXAMPLES
    here = [path for path in WITH_EXAMPLES if importlib.util.find_spec(NEEDED.get(path.name, "torch"))]
    written = {path: sum(line.lstrip().startswith(">>> ") for line in path.read_text().splitlines()) for path in here}
    outcomes = {str(path.relative_to(ROOT)): (*tried(path), written[path]) for path in here}
    assert not {path: told for path, told in outcomes.items() if told != (0, told[2], told[2])}, "failed, ran, written"
