"""Arrays of a trajectory and of a solver's result, by names, what is proven of it, and back."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np

from uvms_ocp.collision.collision_scene import Nearest
from uvms_ocp.collision.conservative_advancement import ClearanceReport
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.robot import Robot
from uvms_ocp.ocp.plans.plan_file import Arrays, ClearanceValues, SolverValues
from uvms_ocp.ocp.trajectory import Trajectory
from uvms_ocp.solvers.nlp.level_solver import NlpPoint
from uvms_ocp.solvers.nlp.lexicographic_nlp import LexicographicResult
from uvms_ocp.solvers.nlp.nlp_status import NlpStatus

_SHORTEST = 1e-6  # norm of a quaternion; that of a plan which breaks its constraints may be far from 1


def trajectory_arrays(t: Trajectory) -> dict[str, np.ndarray]:
    """By the names of the fields."""
    return {"t": t.t, "q": t.q, "v": t.v, "a": t.a, "thrust": t.thrust, "torque": t.torque}


def stored_trajectory(robot: Robot, arrays: Arrays, *, of_wrench: bool) -> Trajectory:
    """The trajectory of `trajectory_arrays`. Raises `InvalidInput` for arrays that are none of this robot."""
    n = len(arrays["t"]) if "t" in arrays and arrays["t"].ndim == 1 else 0
    thrusters = robot.n_vehicle if of_wrench else len(robot.description.thrusters)
    widths = {"q": robot.n_q, "v": robot.n_v, "a": robot.n_v, "thrust": thrusters, "torque": robot.n_joints}
    shapes = {name: (n - (name in ("a", "thrust", "torque")), width) for name, width in widths.items()}
    for name, shape in shapes.items():
        given = arrays[name].shape if name in arrays else None
        if n < 2 or given != shape:
            raise InvalidInput(f"array {name!r} has shape {given}; {robot.name} with {n} times needs {shape}")
    _check_values(robot, arrays)
    return Trajectory(t=arrays["t"], **{name: arrays[name] for name in widths}, of_wrench=of_wrench)


def _check_values(robot: Robot, arrays: Arrays) -> None:
    t = arrays["t"]
    if t[0] != 0.0 or not (np.diff(t) > 0).all():
        raise InvalidInput("times t do not rise from 0")
    if robot.n_vehicle and np.linalg.norm(arrays["q"][:, 3:7], axis=1).min() < _SHORTEST:
        raise InvalidInput("array 'q' has a quaternion, columns 3 to 6, of norm 0")


def result_arrays(result: LexicographicResult) -> dict[str, np.ndarray]:
    """All arrays of the result of a solver; multipliers as far as there are any."""
    arrays = {"x": result.x}
    for i, (values, residuals, point) in enumerate(zip(result.values, result.residuals, result.points, strict=True)):
        arrays |= {f"values_{i}": values, f"residuals_{i}": residuals, f"point_{i}": point.x}
        if point.x_multipliers is not None and point.row_multipliers is not None:
            arrays |= {f"x_multipliers_{i}": point.x_multipliers, f"row_multipliers_{i}": point.row_multipliers}
    return arrays


def solver_values(result: LexicographicResult) -> SolverValues:
    """Its values beside the arrays."""
    return SolverValues(
        status=result.status.value,
        level_status=tuple(status.value for status in result.level_status),
        iterations=result.iterations,
        anticipated=result.anticipated,
        violation=result.violation,
        solve_time=result.solve_time,
    )


def stored_result(values: SolverValues, arrays: Arrays) -> LexicographicResult:
    """The result of `result_arrays` and `solver_values`. Raises `InvalidInput` for what does not belong together."""
    levels = range(len(values.level_status))
    n = arrays["x"].shape if "x" in arrays and arrays["x"].ndim == 1 else None
    try:
        points = tuple(_point(arrays, i) for i in levels)
        rows = {point.row_multipliers.shape for point in points if point.row_multipliers is not None}
        right = len(rows) <= 1 and all(point.x.shape == n for point in points) and len(values.iterations) == len(levels)
        if n is None or not right:
            raise InvalidInput("arrays of the solver's result do not fit each other")
        return LexicographicResult(
            x=arrays["x"],
            status=_status(values.status),
            level_status=tuple(_status(status) for status in values.level_status),
            values=tuple(arrays[f"values_{i}"] for i in levels),
            residuals=tuple(arrays[f"residuals_{i}"] for i in levels),
            iterations=values.iterations,
            anticipated=values.anticipated,
            violation=values.violation,
            points=points,
            solve_time=values.solve_time,
        )
    except (KeyError, ValueError) as error:
        raise InvalidInput(f"the solver's result lacks {str(error)[:100]}") from error


def _status(value: str) -> NlpStatus:
    """Raises `ValueError` for a word that is no status."""
    return NlpStatus(value)  # type: ignore[call-arg]  # looked up by its value alone


def _point(arrays: Arrays, i: int) -> NlpPoint:
    """Raises `KeyError` where it has no x, `InvalidInput` for multipliers of another size."""
    x, own, rows = arrays[f"point_{i}"], arrays.get(f"x_multipliers_{i}"), arrays.get(f"row_multipliers_{i}")
    if (own is None) != (rows is None) or (own is not None and own.shape != x.shape):
        raise InvalidInput("multipliers of the solver's result do not fit its points")
    if rows is not None and rows.ndim != 1:
        raise InvalidInput(f"multipliers of rows have shape {rows.shape}; allowed: a vector")
    return NlpPoint(x=x, x_multipliers=own, row_multipliers=rows)


def clearance_values(report: ClearanceReport) -> ClearanceValues:
    """What the certificate found, as values."""
    nearest = asdict(report.nearest)
    return ClearanceValues(
        collision_free=report.collision_free,
        undecided=report.undecided,
        n_samples=report.n_samples,
        unshaped=report.unshaped,
        **nearest,
    )


def stored_clearance(values: ClearanceValues) -> ClearanceReport:
    """The report of `clearance_values`."""
    return ClearanceReport(
        collision_free=values.collision_free,
        undecided=values.undecided,
        n_samples=values.n_samples,
        nearest=Nearest(distance=values.distance, time=values.time, pair=values.pair),
        unshaped=values.unshaped,
    )
