"""The intentions in two dimensions: where the training sequences lie, what is imagined in between, and the way a search took.

The plane is that of the two directions in which the training intentions differ most, the first two coordinates of the space that is
searched. A point of the plane leaves the other coordinates open; they are taken as the mean of the training intentions nearby.
"""

import threading
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from preimage.method.seam import Problem
from preimage.network.coding import to_frames
from preimage.network.inputs import home
from preimage.network.pdvmrnn import PDVMRNN, Generated
from preimage.presets import PlanOptions
from preimage.records import Percept
from preimage.robot.kinematics import ACTIVE_JOINTS, forward_kinematics
from preimage.studio.asked import FARTHEST
from preimage.studio.opened import OpenedRun
from preimage.studio.pictures import strip, text_of

NEAR = 0.25
"""Distance at which a training intention counts half of what it would count at no distance, in standard deviations."""


class Intentions:
    """The plane of a run's intentions."""

    def __init__(self, run: OpenedRun) -> None:
        self._run, self._lock = run, threading.Lock()
        self._map: dict[str, Any] | None = None

    @torch.no_grad()
    def map(self) -> dict[str, Any]:
        """Where the training intentions lie, and how what is imagined from each of them ends."""
        with self._lock:
            if self._map is None:
                problem = self._problem()
                ends = to_frames(problem.rollouts.pixels[:, -1]).cpu().numpy()
                joints = problem.model.coding.decode(problem.rollouts.log_codes[:, -1].exp()).double().cpu().numpy()
                points = plane(problem.space.training).cpu().numpy().round(3).tolist()
                size = {"height": ends.shape[1], "width": ends.shape[2]}
                self._map = {"points": points, "ends": text_of(strip(ends)), "colours": self._colours(joints)} | size
            return self._map

    @torch.no_grad()
    def film(self, point: tuple[float, float]) -> dict[str, Any]:
        """What is imagined from a point of the plane."""
        problem = self._problem()
        here = torch.tensor([point]).to(problem.space.training).clamp(-FARTHEST, FARTHEST)
        coordinates = nearby(here, problem.space.training)
        generated = problem.imagine(problem.space.intention(coordinates))
        return self._described(generated)

    def _described(self, generated: Generated) -> dict[str, Any]:
        frames = to_frames(generated.pixels[0]).cpu().numpy()
        joints = self._run.planner("paper").model.coding.decode(generated.log_codes[0].exp()).double().cpu().numpy()
        way = self._run.table.way(joints).round(4).tolist() if self._run.table else None
        size = {"height": frames.shape[1], "width": frames.shape[2]}
        return {"steps": len(frames), "film": text_of(strip(frames)), "joints": joints.round(4).tolist(), "way": way} | size

    def _problem(self) -> Problem:
        planner = self._run.planner("paper")
        start = home(planner.model)
        return Problem.between(planner.model, start, start, planner.options)

    def _colours(self, joints: Float[np.ndarray, "N J"]) -> list[dict[str, Any]]:
        """What the points can be coloured by: where they end on the table, or in which joints."""
        if self._run.table:
            x, y, _ = forward_kinematics(joints[:, : len(ACTIVE_JOINTS)]).T
            named = {"how far from the base it ends (m)": x, "how far to the left it ends (m)": y}
        else:
            named = {f"{name} at the end": values for name, values in zip(self._run.sensors.joint_names, joints.T, strict=True)}
        return [{"name": name, "values": values.round(4).tolist()} for name, values in named.items()]


@torch.no_grad()
def regenerate_first(model: PDVMRNN, start: Percept | None) -> UInt8[np.ndarray, "T H W C"]:
    """The frames of the first training sequence as the network regenerates it, from its start or, where that is not known, from home."""
    start = start or home(model)
    problem = Problem.between(model, start, start, PlanOptions())
    space = model.intention_table.space(None)
    return to_frames(problem.imagine(space.intention(space.training[:1])).pixels[0]).cpu().numpy()


def plane(points: Float[Tensor, "B K"]) -> Float[Tensor, "B 2"]:
    """The first two coordinates; of intentions that differ in one alone, the second is 0."""
    return torch.nn.functional.pad(points[:, :2], (0, max(0, 2 - points.shape[1])))


def nearby(here: Float[Tensor, "1 2"], training: Float[Tensor, "N K"]) -> Float[Tensor, "1 K"]:
    """The point itself in the plane, and in all other directions the mean of the training intentions, weighted by nearness."""
    nearness = 1 / (NEAR**2 + (plane(training) - here).square().sum(1))
    others = (nearness[:, None] ** 2 * training).sum(0) / (nearness**2).sum()
    kept = min(2, training.shape[1])
    return torch.cat([here[0, :kept], others[kept:]])[None]
