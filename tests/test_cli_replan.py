"""The command line where a loop looks while the arm moves, and where something goes wrong on purpose."""

import json

import pytest

from preimage import cli

QUICK = ["--iterations", "1", "--horizon", "4"]


@pytest.fixture(scope="module")
def plan_folder(run_folder, data, tmp_path_factory):
    folder = tmp_path_factory.mktemp("plans") / "plan"
    cli.main(["plan", str(run_folder), "--goal", f"{data}:1", "--start", f"{data}:1", "--out", str(folder), *QUICK])
    return folder


def test_a_plan_is_made_anew_while_it_is_executed(capsys, run_folder, plan_folder):
    cli.main(["execute", str(plan_folder), "--run", str(run_folder), "--loop", "replan", "--disturb", "push", "--window", "all", *QUICK])
    first, *_, last = capsys.readouterr().out.splitlines()
    assert first.startswith("step 0: ")
    assert first.endswith(" ms")
    assert last.endswith("cm from the goal")


def test_a_run_goes_to_one_goal_after_the_other(capsys, run_folder, data):
    cli.main(["execute", str(run_folder), "--goal", f"{data}:0", f"{data}:1", "--loop", "replan", "--disbelief", "99", *QUICK])
    assert "cm from the goal" in capsys.readouterr().out


def test_loops_are_counted_beside_each_other(capsys, run_folder, tmp_path):
    out = tmp_path / "all.json"
    cli.main(["evaluate", str(run_folder), "--goals", "1", "--disturb", "all", "--out", str(out), "--disbelief", "99", *QUICK])
    result = json.loads(out.read_text())
    assert {(cell["loop"], cell["disturb"]) for cell in result["cells"]} >= {("closed", None), ("open", "push"), ("replan", "goal")}
    assert all(cell["goals"] == 1 for cell in result["cells"])
    assert "replan goal all" in capsys.readouterr().out


def test_one_loop_tells_how_long_its_steps_took(run_folder, tmp_path):
    out = tmp_path / "one.json"
    cli.main(["evaluate", str(run_folder), "--goals", "1", "--loop", "replan", "--no-baselines", "--out", str(out), *QUICK])
    result = json.loads(out.read_text())
    assert result["replan"]["window"] == 5
    assert len(result["rows"][0]["doubts"]) >= 1


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--loop", "replan"], "--loop replan asks the network at every step: give the one that made the plan, as --run reach"),
        (
            ["--loop", "open", "--run", "move-object"],
            "was not made by move-object, or leads to several goals: give that run, or the run and --goal",
        ),
        (["--disturb", "goal"], "--disturb goal needs goals to choose from: preimage evaluate has them"),
        (["--goal", "a", "b"], "--goal names 2 goals: give --loop replan, or plan to them first (preimage plan)"),
    ],
)
def test_what_a_loop_cannot_do_is_refused(refused, plan_folder, words, sentence):
    code, told = refused("execute", plan_folder, *words)
    assert code == 2
    assert sentence in told


def test_no_object_can_be_moved_where_there_is_none(refused, run_folder, tmp_path):
    code, told = refused("evaluate", run_folder, "--goals", "1", "--disturb", "object", "--out", tmp_path / "out.json", *QUICK)
    assert code == 2
    assert "--disturb object moves an object, and reach has none: take move-object" in told
