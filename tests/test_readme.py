"""What the README shows can be done: its Python runs, its commands have the verbs and options they name, its links lead somewhere."""

import contextlib
import io
import re
import shlex
from pathlib import Path

import pytest

import preimage
from preimage import cli
from preimage.storage.runs import BUNDLED

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
PYTHON, BASH = (re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL) for language in ("python", "bash"))
COMMANDS = [line for block in BASH for line in block.splitlines() if line.startswith("preimage ")]
SCALED_DOWN = {  # so that it takes seconds: fewer demonstrations, a smaller network, less learning, a shorter search
    "count=100": "count=3",
    "pi.ModelConfig.small()": "pi.ModelConfig.tiny(), config=pi.TrainConfig(updates=2)",
    "goal=test.last": "goal=test.last, config=pi.PlanConfig(iterations=2)",
}


@pytest.mark.slow
def test_the_first_block_of_python_runs(tmp_path, monkeypatch, capsys):
    code = PYTHON[0]
    assert len(code.strip().splitlines()) <= 11
    for written, scaled in SCALED_DOWN.items():
        assert written in code
        code = code.replace(written, scaled)
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "README.md", "exec"), {})
    arrival, *_ = capsys.readouterr().out.split()
    assert int(arrival) >= 0
    assert (tmp_path / "reach.gif").stat().st_size > 0


def test_data_of_ones_own_are_saved_as_the_readme_says(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    exec(compile(PYTHON[1], "README.md", "exec"), {})
    (demonstration,) = preimage.load(tmp_path / "my-data")
    assert (len(demonstration), len(demonstration.joint_names)) == (40, 6)


def test_there_are_no_other_blocks_of_python():
    assert len(PYTHON) == 2


def help_of(verb: str) -> str:
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), pytest.raises(SystemExit):
        cli.main([verb, "--help"])
    return printed.getvalue()


def test_commands_have_the_verbs_and_options_they_name():
    assert COMMANDS
    words = [shlex.split(command)[1:] for command in COMMANDS]
    assert {verb for verb, *_ in words} <= set(cli.VERBS)
    told = {verb: help_of(verb) for verb, *_ in words}
    named = {(verb, word) for verb, *rest in words for word in rest if word.startswith("--")}
    assert not [f"{verb} {option}" for verb, option in named if not re.search(rf"{option}\b", told[verb])]


def test_the_table_lists_every_verb_once():
    assert re.findall(r"^\| `preimage (\w+)`", README, re.MULTILINE) == list(cli.VERBS)


def test_every_bundled_model_is_named():
    (named,) = re.findall(r"is asked for, (.*) stand for the bundled models", README)
    assert tuple(re.findall(r"`([a-z-]+)`", named)) == BUNDLED


def test_make_has_the_targets_that_the_texts_name():
    targets = set(re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    texts = README + (ROOT / "CONTRIBUTING.md").read_text()
    assert set(re.findall(r"^make (\w+)", texts, re.MULTILINE)) <= targets


def test_links_lead_somewhere():
    missing = []
    for text in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "docs/words.md", "docs/paper.md"):
        links = re.findall(r"\]\(([^)#]+)\)", (ROOT / text).read_text())
        missing += [(text, link) for link in links if "://" not in link and not ((ROOT / text).parent / link).exists()]
    assert not missing


def test_the_results_can_be_written_between_their_marks():
    before, between_and_after = README.split("<!-- results:begin -->")
    between, after = between_and_after.split("<!-- results:end -->")
    assert before
    assert "| 100 |" in between
    assert after


def test_the_version_is_the_same_everywhere():
    from importlib.metadata import version

    assert f"version: {version('preimage')}" in (ROOT / "CITATION.cff").read_text()
    assert f"## {version('preimage')}" in (ROOT / "CHANGELOG.md").read_text()
