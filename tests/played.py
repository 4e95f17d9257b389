"""Plans that need no network: what a demonstrator did, for tests of what becomes of plans."""

import numpy as np

from preimage.records import Demonstration, Percept, Plan, Stopped


def plan_of(demonstration: Demonstration, arrival_step: int | None = None) -> Plan:
    """The plan that imagines exactly what the demonstrator did."""
    return Plan(
        frames=demonstration.frames,
        joints=demonstration.joints,
        arrival_step=len(demonstration) - 1 if arrival_step is None else arrival_step,
        rate_hz=demonstration.rate_hz,
        joint_names=demonstration.joint_names,
        start=demonstration.first,
        goal=Percept(demonstration.last.frame),
        error=0.0,
        errors=np.zeros(1),
        intention=np.zeros(1),
        stopped=Stopped.CONVERGED,
        seconds=0.0,
    )
