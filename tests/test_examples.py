"""Every example runs, at a size that takes seconds, and leaves what it says."""

import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"
LEFT = {
    "01_reach.py": ("reach.mp4", "reach.png"),
    "02_recognise.py": ("recognised.png",),
    "03_partial_goal.py": (),
    "04_intention_map.py": ("intention_map.png",),
    "05_your_own_data.py": ("check.html", "my-run/model.safetensors", "my-plan/joints.csv"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", LEFT)
def test_an_example_runs(name, tmp_path):
    place = ["--out", str(tmp_path / "out")] if LEFT[name] else []
    words = [sys.executable, "-W", "error", str(EXAMPLES / name), "--quick", *place]
    outcome = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert outcome.returncode == 0, outcome.stderr
    assert outcome.stdout
    for left in LEFT[name]:
        assert (tmp_path / "out" / left).stat().st_size > 0


def test_every_example_is_run_here_and_named_in_the_readme():
    assert {path.name for path in EXAMPLES.glob("*.py")} == set(LEFT)
    readme = (EXAMPLES.parent / "README.md").read_text()
    assert not [name for name in LEFT if f"examples/{name}" not in readme]
