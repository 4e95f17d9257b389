"""What the README shows can be done: its Python and its commands run, its account of the models is theirs, its links lead somewhere."""

import contextlib
import io
import json
import re
import shlex
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest

import preimage
from preimage import cli
from preimage.storage.runs import BUNDLED, find_run

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
PYTHON, BASH = (re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL) for language in ("python", "bash"))
LINES = [shlex.split(line, comments=True) for block in BASH for line in block.splitlines()]
COMMANDS = [words for program, *words in LINES if program == "preimage" and words != ["--version"]]
SHELL = {"make", "source", "pip"}
"""What brings the command where it is; what is left are commands of ours."""
SCALED_DOWN = {  # so that it takes seconds: fewer demonstrations, a smaller network, less learning, a shorter search
    "count=100": "count=3",
    "pi.ModelConfig.small()": "pi.ModelConfig.tiny(), config=pi.TrainOptions(updates=2)",
    "pi.remember(demonstrations, model)": "pi.remember(demonstrations, model), HASTY",
}
HASTY = replace(preimage.PlanOptions.full(), iterations=2)
SEARCH = {"--iterations": "1", "--horizon": "4"}
SMALLER = {
    "record": {"--count": "5"},
    "train": {"--size": "tiny", "--updates": "2"},
    "plan": SEARCH,
    "evaluate": {"--goals": "1", **SEARCH},
}
"""The same for commands: what their options become."""


@pytest.mark.slow
def test_the_first_block_of_python_runs(tmp_path, monkeypatch, capsys):
    code = PYTHON[0]
    assert len(code.strip().splitlines()) <= 11
    for written, scaled in SCALED_DOWN.items():
        assert written in code
        code = code.replace(written, scaled)
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "README.md", "exec"), {"HASTY": HASTY})
    arrival, *_ = capsys.readouterr().out.split()
    assert int(arrival) >= 0
    assert (tmp_path / "reach.gif").stat().st_size > 0


def test_data_of_ones_own_are_saved_as_the_readme_says(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    exec(compile(PYTHON[1], "README.md", "exec"), {})
    (demonstration,) = preimage.load(tmp_path / "converted-data")
    assert (len(demonstration), len(demonstration.joint_names)) == (40, 6)


def test_there_are_no_other_blocks_of_python():
    assert len(PYTHON) == 2


def scaled_down(words: list[str]) -> list[str]:
    """A command with the options that make it take seconds in place of its own."""
    smaller = SMALLER.get(words[0], {})
    kept = [word for word, before in zip(words, ["", *words], strict=False) if not {word, before} & smaller.keys()]
    return [*kept, *(word for option in smaller.items() for word in option)]


@pytest.mark.slow
def test_the_commands_run_as_they_are_written_and_in_order(tmp_path, monkeypatch, capsys):
    assert {program for program, *_ in LINES} == {"preimage", *SHELL}
    monkeypatch.chdir(tmp_path)
    for words in COMMANDS:
        cli.main(scaled_down(words))
    outputs = {word for words in COMMANDS for option, word in pairwise(words) if option in ("--out", "--film", "--films")}
    assert outputs
    assert not [path for path in outputs if not (tmp_path / path).exists()]


def test_commands_are_scaled_down_without_losing_their_other_options():
    assert scaled_down(["record", "reach", "--count", "100", "--out", "data"]) == ["record", "reach", "--out", "data", "--count", "5"]
    assert scaled_down(["execute", "plans/first"]) == ["execute", "plans/first"]


def test_the_account_of_the_bundled_models_is_that_of_their_cards():
    rows = re.findall(r"^\| `([a-z-]+)` \| `(preimage [^`]+)` \| (\d) \|$", README, re.MULTILINE)
    configs = {name: json.loads((find_run(name) / "config.json").read_text()) for name in BUNDLED}
    made = {(name, config["provenance"]["command"], str(config["train"]["seed"])) for name, config in configs.items()}
    assert set(rows) == made
    assert not [name for name, command, _ in made if f"`{command}`" not in (find_run(name) / "README.md").read_text()]
    assert {(config["size"], config["num_demonstrations"]) for config in configs.values()} == {("small", 100)}


def help_of(verb: str) -> str:
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), pytest.raises(SystemExit):
        cli.main([verb, "--help"])
    return printed.getvalue()


def test_commands_have_the_verbs_and_options_they_name():
    assert COMMANDS
    assert {verb for verb, *_ in COMMANDS} <= set(cli.VERBS)
    helps = {verb: help_of(verb) for verb, *_ in COMMANDS}
    named = {(verb, word) for verb, *rest in COMMANDS for word in rest if word.startswith("--")}
    assert not [f"{verb} {option}" for verb, option in named if not re.search(rf"{option}\b", helps[verb])]


def test_options_named_in_the_texts_are_there():
    helps = "".join(help_of(verb) for verb in cli.VERBS)
    texts = README + (ROOT / "docs" / "paper.md").read_text()
    others = {"--index-url", "--version", "--help", "--completion"}  # of pip, and of the command itself
    named = set(re.findall(r"(?<![\w-])--[a-z][a-z.-]+", texts)) - others
    assert not [option for option in named if not re.search(rf"{re.escape(option)}\b", helps)]


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
