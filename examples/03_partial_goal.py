"""A goal may be half known: only how it looks, only how it feels, or both. The other half is imagined.

    python examples/03_partial_goal.py

The network learned vision and joints together, so a picture of the goal calls forth the joints that belong to it, and the joints the
picture. The last column tells how far the half that was not given is from the true one.
"""

from dataclasses import replace

import numpy as np
import tyro

import preimage as pi


def main(seed: int = 3, goals: int = 3, quick: bool = False) -> None:
    """Plan to the same goals from the picture, from the joints, and from both.

    Args:
        seed: draws the goals.
        goals: how many.
        quick: one goal, hardly any search, to see that everything runs.
    """
    arm, model, memory = pi.Arm(), pi.from_pretrained("reach"), pi.load_memory("reach")
    options = replace(pi.PlanOptions.full(), iterations=1) if quick else pi.PlanOptions.full()
    tutored = pi.record(arm, pi.Reach(), count=1 if quick else goals, seed=seed)
    print("given    goal   from the goal   joints off   picture off")
    for modalities in ("vision", "joints", "both"):
        planner = pi.Planner(model, memory, replace(options, modalities=modalities))
        for number, tutor in enumerate(tutored):
            assert tutor.scene is not None
            goal = pi.Percept(
                frame=None if modalities == "joints" else tutor.last.frame,
                joints=None if modalities == "vision" else tutor.last.joints,
            )
            plan = planner.plan(start=tutor.first, goal=goal)
            trial = pi.execute(plan, arm, tutor.scene)
            joints_off = np.degrees(np.abs(plan.joints[plan.arrival_step] - tutor.last.joints)).mean()
            greys_off = np.abs(plan.frames[plan.arrival_step].astype(float) - tutor.last.frame).mean()
            print(f"{modalities:8s} {number:4d} {100 * trial.deviation_m:12.1f} cm {joints_off:11.1f}° {greys_off:9.2f} greys")


if __name__ == "__main__":
    tyro.cli(main)
