"""A bundled model plans to a goal that it never saw; the simulated arm executes the plan; a film shows both.

    python examples/01_reach.py --out demo

The planner gets what the camera and the joints tell at the start, and one picture of the goal. Where the goal lies it is not told.
"""

from dataclasses import replace
from pathlib import Path

import tyro

import preimage as pi


def main(out: Path = Path("demo"), goal: int = 7, quick: bool = False) -> None:
    """Plan, execute, film.

    Args:
        out: folder for the film and the figure.
        goal: seed that draws the goal.
        quick: search hardly at all, to see that everything runs.
    """
    arm = pi.Arm()
    options = pi.PlanOptions.full()
    planner = pi.load_planner("reach", replace(options, iterations=1) if quick else options)
    (tutor,) = pi.record(arm, pi.Reach(), count=1, seed=goal)  # somebody has to make the picture of the goal
    assert tutor.scene is not None

    plan = planner.plan(start=tutor.first, goal=pi.Percept(frame=tutor.last.frame))
    print(f"imagined {len(plan)} steps in {plan.seconds:.1f} s; step {plan.arrival_step} shows the goal best, error {plan.error:.2f}")

    trial = pi.execute(plan, arm, tutor.scene)  # blind: the arm follows what was imagined
    print(f"{'reached' if trial.success else 'missed'}: {100 * trial.deviation_m:.1f} cm from the goal")
    print("film:", pi.film(plan, trial, out / "reach.mp4"))
    print("figure:", pi.figure(plan, trial, out / "reach.png"))


if __name__ == "__main__":
    tyro.cli(main)
