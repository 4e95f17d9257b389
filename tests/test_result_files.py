"""Results that somebody changed, or that are none, are named: the page is made of what is as it says, or not at all."""

import json
import re
import shutil
from pathlib import Path
from random import Random

import pytest

from mutations import change_a_value
from preimage.report import results
from preimage.report.result_files import read_result, read_results
from preimage.report.results import write_results

RESULTS = Path(__file__).parents[1] / "results"
KINDS = ["bench", "reach-100-small-seed0-recognition", "reach-100-small-seed0-modalities", "move-object-100-small-seed0-open"]
KINDS += ["g1-bottle-47-small-blends-held-out"]


@pytest.fixture
def charts_once(monkeypatch) -> None:
    """A chart of what was not changed is drawn once, for each takes a fifth of a second."""
    monkeypatch.setattr(results, "growth_chart", once(results.growth_chart, lambda growth: growth))
    monkeypatch.setattr(results, "intention_map", once(results.intention_map, lambda one: [one["goals_m"], one["map"]]))


def once(draw, drawn_from):
    drawn = set()

    def chart(one, to):
        if (seen := json.dumps(drawn_from(one))) not in drawn:
            drawn.add(seen)
            draw(one, to)
        return to

    return chart


ROW = {"success": 1, "goals": 2, "interval": [0.1, 0.9], "deviation_cm": 1.0, "seconds": 1.0, "iterations": 3}
ABLATION = {"kind": "ablation", "task": "reach", "num_demonstrations": 100, "loop": "closed", "rows": {"full": ROW}}


def test_all_results_of_the_repository_are_read():
    assert len(read_results(RESULTS)) == len(list(RESULTS.glob("*.json")))


@pytest.mark.usefixtures("charts_once")
@pytest.mark.parametrize("kind", KINDS)
def test_a_result_that_was_changed_anywhere_is_reported_or_named(tmp_path, kind):
    chance, whole = Random(0), json.loads((RESULTS / f"{kind}.json").read_text())
    whole.pop("rows", None)
    shutil.copy(RESULTS / "reach-100-small-seed0-closed.json", tmp_path)
    refused = 0
    for value in [None, "x", -1, 1e400, [], {}, [[1]], True, 10**30]:
        for _ in range(6):
            (tmp_path / "changed.json").write_text(json.dumps(change_a_value(whole, chance, value)))
            try:
                write_results(tmp_path, tmp_path / "page.md")
            except ValueError as error:
                refused += 1
                assert str(error).startswith(f"{tmp_path / 'changed.json'} is no result (")  # noqa: PT017
    assert refused


@pytest.mark.parametrize("content", [b"", b"[1]", b"{", b"\xff", b"[" * 100_000, b'{"task": NaN}', rb'{"task": "\ud83d"}'])
def test_what_is_no_json_object_is_named(tmp_path, content):
    (tmp_path / "other.json").write_bytes(content)
    with pytest.raises(ValueError, match=r"other.json is no result \(.*\): remove it, or write it anew"):
        read_result(tmp_path / "other.json")


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ({"cells": 3}, "cells is 3"),
        ({"cells": [{"loop": "replan", "disturb": 3, "window": 5}]}, "disturb is 3"),
        ({"kind": "ablation", "task": "reach", "num_demonstrations": 100, "loop": "closed", "rows": {"full": {}}}, "full has no success"),
        (
            {"kind": "ablation", "task": "reach", "num_demonstrations": 1, "loop": "x", "rows": {}, "paper": {"a": 1}},
            "paper has no success_rate",
        ),
        (ABLATION | {"rows": {"full": ROW | {"gained": 1, "p": 0.5}}}, "full has some of gained, lost, p, and not all"),
        (ABLATION | {"training_seeds": 3}, "training_seeds is 3"),
        ({"kind": {}, "cells": 3}, "cells is 3"),
        ({"kind": "trust", "model": "reach", "seed": "5"}, "seed is '5'"),
    ],
)
def test_tables_of_what_goes_wrong_of_ideas_and_of_trust_are_checked(content: dict, reason: str, tmp_path: Path) -> None:
    (tmp_path / "one.json").write_text(json.dumps(content))
    with pytest.raises(ValueError, match=re.escape(reason)):
        read_results(tmp_path)
