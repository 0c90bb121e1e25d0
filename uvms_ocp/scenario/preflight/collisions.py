"""Check that the robot starts outside of the floor, and is free of obstacles where phases begin and end."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pinocchio as pin

from uvms_ocp.robot.shapes.hull import lowest_link, skid_points
from uvms_ocp.robot.size import size
from uvms_ocp.scenario.preflight.findings import Finding, Severity
from uvms_ocp.scenario.preflight.phase_forecast import Visit
from uvms_ocp.scenario.preflight.setup import Setup
from uvms_ocp.sim.nearest_passage import closest_approach

_SUNK = 0.08  # sizes of the robot that what stands on the floor may be in it
OBSTACLES = "obstacles"


def check_hull(setup: Setup) -> Iterator[Finding]:
    """Find a start at which the underside of the hull, as the plant has it, is in the floor; name
    the lowest link.
    """
    X_WB = pin.XYZQUATToSE3(np.asarray(setup.start[:7]))
    points = [X_WB.act(point) for point in skid_points(setup.robot)]
    depth = max((setup.floor_at(x, y) - z for x, y, z in points), default=0.0)
    if depth > _SUNK * size(setup.robot.model):
        severity = Severity.ERROR if setup.with_forces else Severity.WARNING
        text = (
            f"the hull starts {depth:.2f} m inside the floor, lowest with link"
            f" {lowest_link(setup.robot)}; raise the start"
        )
        yield severity.finding("start", text, depth_m=depth)


def check_obstacles(setup: Setup, visits: Sequence[Visit]) -> Iterator[Finding]:
    """Find places at which a shape of the robot, its joints as at the start, would be inside an
    obstacle.

    The way between these places is not looked at: whether it is free, the clearance task and a plan
    have to see to.
    """
    if not setup.environment.obstacles:
        return
    yield from _touching(setup, setup.start, "the start", "")
    for visit in visits:
        q = visit.stances[0].configuration(setup)
        yield from _touching(
            setup, q, "the place where the vehicle is likeliest to stop", visit.phase.name
        )


def _touching(setup: Setup, q: np.ndarray, place: str, phase: str) -> Iterator[Finding]:
    closest = closest_approach(setup.robot, setup.environment, q[None], floor=False)
    if closest.distance <= 0:
        text = (
            f"{place} is in collision, {closest.pair} by {-closest.distance:.2f} m; move it or the"
            " obstacle"
        )
        yield Severity.ERROR.finding(OBSTACLES, text, phase, depth_m=-closest.distance)
