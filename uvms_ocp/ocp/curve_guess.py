"""A curve around obstacles, of the shapes alone, as the guess of a plan in water."""

from __future__ import annotations

import numpy as np

from uvms_ocp.arguments import checked
from uvms_ocp.collision.coordinates import Coordinates
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.ocp.trajectory import Trajectory, through
from uvms_ocp.planning.request import PlanRequest, solve
from uvms_ocp.trajectories.polynomial import PiecewisePolynomial

_SAMPLES = 200


@checked
def along_curve(problem: OcpProblem, coordinates: Coordinates, curve: PiecewisePolynomial) -> Trajectory:
    """Guess along a curve of coordinates, at the pace that ends with the problem's nominal time."""
    t = np.linspace(curve.start, curve.end, _SAMPLES)
    share = (t - curve.start) / (curve.end - curve.start)
    return through(problem, share * problem.nominal_times()[-1], coordinates.configurations(curve.evaluate(t)))


def curve_guess(problem: OcpProblem, request: PlanRequest) -> Trajectory | None:
    """Guess along the curve that the request asks for; `None` where no curve is free of collision."""
    try:
        found = solve(request)
    except InvalidInput:  # what a curve cannot do, such as a goal of some joints alone, is no mistake here
        return None
    if found.plan is None or not found.plan.collision_free:
        return None
    return along_curve(problem, found.scene.coordinates, found.plan.trajectory)
