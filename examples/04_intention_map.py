"""Where do intentions lie? A map of the training intentions, each coloured by the goal its sequence ends at.

    python examples/04_intention_map.py --out demo

Nobody told the network where a goal lies: it saw sequences, and gave alike ones intentions near each other. Stars are sequences that were
never shown, recognised from the whole of them.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import tyro

import preimage as pi
from preimage.evaluation.experiments import principal_plane, rank_correlation
from preimage.report.charts import intention_map
from preimage.robot import forward_kinematics
from preimage.storage.runs import find_run


def main(out: Path = Path("demo"), novel: int = 8, seed: int = 21, quick: bool = False) -> None:
    """Draw the map.

    Args:
        out: folder for the picture.
        novel: how many sequences that were never shown.
        seed: draws them.
        quick: one of them, hardly any search, to see that everything runs.
    """
    options = pi.PlanOptions.regression()  # of a whole sequence there is nothing that a memory could add
    planner = pi.load_planner("reach", replace(options, iterations=1) if quick else options)
    training = planner.model.intention_table.intentions().flatten().numpy()
    ends = {"training": np.stack([shown.joints[-1] for shown in pi.read_shown(find_run("reach"))])}

    sequences = pi.record(pi.Arm(), pi.Reach(), count=1 if quick else novel, seed=seed)
    recognised = np.concatenate([planner.recognise(one).intention.flatten().numpy() for one in sequences])
    ends["novel"] = np.stack([one.joints[-1] for one in sequences])

    goals_m = {name: forward_kinematics(joints)[:, :2].tolist() for name, joints in ends.items()}
    flat = principal_plane(training)
    drawn = {"map": {"training": flat(training), "novel": flat(recognised)}, "goals_m": goals_m}
    alike = rank_correlation(training, goals_m["training"])
    print(f"{len(training)} training intentions; their distances go with those of the goals, rank correlation {alike:.2f}")
    print("map:", intention_map(drawn, out / "intention_map.png"))


if __name__ == "__main__":
    tyro.cli(main)
