"""Check: the robot is free of the obstacles where it starts and where its phases end."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from uvms_ocp.preflight.findings import Finding, Severity
from uvms_ocp.preflight.forecast import Visit
from uvms_ocp.preflight.setup import Setup
from uvms_ocp.sim.closest_approach import closest_approach

CHECK = "obstacles"


def check_obstacles(setup: Setup, visits: Sequence[Visit]) -> Iterator[Finding]:
    """An error for each place at which a shape of the robot, its joints as at the start, would be inside an obstacle.

    The way between these places is not looked at: whether it is free, the clearance task and a plan have to see to.
    """
    if not setup.environment.obstacles:
        return
    yield from _touching(setup, setup.start, "the start", "")
    for visit in visits:
        q = visit.stances[0].configuration(setup)
        yield from _touching(setup, q, "the place where the vehicle is likeliest to stop", visit.phase.name)


def _touching(setup: Setup, q: np.ndarray, place: str, phase: str) -> Iterator[Finding]:
    closest = closest_approach(setup.robot, setup.environment, q[None], floor=False)
    if closest.distance <= 0:
        text = f"{place} is in collision, {closest.pair} by {-closest.distance:.2f} m; move it or the obstacle"
        figures = {"depth_m": -closest.distance}
        yield Finding(severity=Severity.ERROR, check=CHECK, phase=phase, text=text, figures=figures)
