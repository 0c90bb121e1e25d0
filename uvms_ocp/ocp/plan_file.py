"""Write and read plans as files: arrays beside one text of values, in ``.npz`` or ``.json``, within
bounds.

Every number comes back as it was: arrays are stored as they are, texts hold the shortest decimals
that round to the same.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import ValidationError

from uvms_ocp.errors import InvalidInput
from uvms_ocp.model_errors import one_line, printable
from uvms_ocp.ocp.tolerances import VerdictTolerances
from uvms_ocp.ocp.trajectory import Trajectory
from uvms_ocp.planning.conservative_advancement import ClearanceReport
from uvms_ocp.planning.scene import NearestPair
from uvms_ocp.record.array_file import read_arrays
from uvms_ocp.record.meta_values import MetaValue, Number, SurroundingsMeta
from uvms_ocp.record.output import as_output_errors
from uvms_ocp.record.untrusted import json_object, read_text
from uvms_ocp.robot.robot import Robot
from uvms_ocp.solvers import LexicographicResult, NlpStatus
from uvms_ocp.solvers.nlp.level_solver import NlpPoint

_TEXT = "summary"
_NO_PLAN = f"no text {_TEXT!r}; give the plan.npz that `Plan.save` wrote"
_LARGEST_TEXT = 256 << 20  # [B] largest size of a text in a file
# norm of a quaternion; that of a plan which breaks its constraints may be far from 1
_SMALLEST_NORM = 1e-6

Arrays = Mapping[str, np.ndarray]
"""Arrays by name."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class LevelReport:
    """Outcome of one level."""

    name: str
    """Name of the level."""
    status: str
    """Status of its solve."""
    advice: str
    """Advice for that status."""
    residual: float
    """Root of twice its cost, in the root of the unit of weighted rows squared: of the squares of
    the distances of weighted rows to their range at the ends of phases, and of the mean of these
    over the nominal time along the path. It is that of the motion, whatever the number of steps.
    """
    iterations: int
    """Number of the solver's iterations."""
    prices: tuple[float, ...] = ()
    """Prices of the levels above: by how much the cost of this one, half the sum of squares of its
    rows, path terms as a mean over time, would fall for each unit of residual, as a norm, that the
    level above gave up (of cost, where that one has `OcpLevel.relax`). To first order; empty where
    unknown.
    """
    __pydantic_config__: ClassVar = MetaValue.model_config


class LevelVerdict(MetaValue):
    """Verdict on one level."""

    name: str
    """Name of the level."""
    residual: float
    """Residual of the level, as `LevelReport.residual` defines it."""
    gain: Number | None
    """Fall of the residual that one more step promises, to first order, with the levels above held;
    `None` where that is not known.
    """
    missed: bool
    """True where the level has goals, and they are not met."""
    optimal: bool
    """True where the level is met, or no step promises more than the tolerance."""


class VerdictReport(MetaValue):
    """Findings of the judge of a plan, and its tolerances and resolution."""

    tolerances: VerdictTolerances
    """Tolerances by which the plan was judged."""
    levels: tuple[LevelVerdict, ...]
    """Verdicts on all levels."""
    time_resolution: float
    """[s] Longest interval between samples inside a step; where ranges are near it is shorter."""
    unseen: Number | None
    """[share of the tolerance] Bound on the violation between samples beyond that at samples; `None`
    where something is no number.
    """


class SolverValues(MetaValue):
    """Values of the solver's result beside its arrays; see
    `uvms_ocp.solvers.nlp.lexicographic_nlp.LexicographicResult`.
    """

    status: NlpStatus
    level_status: tuple[NlpStatus, ...]
    iterations: tuple[int, ...]
    anticipated: bool
    violation: float
    solve_time: Number


class ClearanceValues(MetaValue):
    """Result of the certificate of clearance; see
    `uvms_ocp.planning.conservative_advancement.ClearanceReport`, and `NearestPair` for the last
    three.
    """

    unshaped: tuple[str, ...] = ()
    surfaces: tuple[str, ...] = ()
    collision_free: bool
    undecided: bool
    n_samples: int
    distance: float
    """[m] smallest distance."""
    time: Number
    pair: str


class PlanValues(MetaValue):
    """Values in a file of a plan beside its arrays."""

    version: Literal["1"] = "1"
    status: str
    reason: str
    advice: str
    robot: str
    duration: Number
    energy: float | None
    """[J] electrical energy; `None` where it is not known."""
    peak_thrust: float | None
    """[N] largest thrust; `None` without thrusters."""
    iterations: int
    solve_time: Number
    levels: tuple[LevelReport, ...]
    of_wrench: bool
    surroundings: SurroundingsMeta
    current: tuple[Number, Number, Number]
    plugin: str = ""
    verdict: VerdictReport | None = None
    solver: SolverValues | None = None
    clearance: ClearanceValues | None = None


def write_plan(target: Path, values: PlanValues, arrays: Arrays) -> Path:
    """Write ``.json`` where the name ends so, else ``.npz``; returns the path. Raises
    `OutputError`.
    """
    text = values.model_dump_json()
    if target.suffix != ".json":
        return write_arrays(target, _TEXT, text, arrays)
    lists = {name: array.tolist() for name, array in arrays.items()}
    with as_output_errors(target, "choose another place"):
        target.write_text(json.dumps(json.loads(text) | lists), encoding="utf-8")
    return target


def write_arrays(target: Path, key: str, text: str, arrays: Arrays) -> Path:
    """Write a text under a key beside arrays as ``.npz``, with that ending; returns the path.
    Raises `OutputError`.
    """
    path = target.with_suffix(".npz")
    with as_output_errors(path, "choose another place"), path.open("wb") as file:
        np.savez(file, allow_pickle=False, **{key: np.array(text)}, **arrays)
    return path


def read_plan(source: Path) -> tuple[PlanValues, dict[str, np.ndarray]]:
    """Read a file of `write_plan`; arrays hold finite numbers.

    Raises `InvalidInput`, in one line, for what is no such file, is damaged or too large.
    """
    try:
        if source.suffix == ".json":
            values, arrays = _from_text(source)
        else:
            values, arrays = from_arrays(source, _TEXT, _NO_PLAN)
        for name, array in arrays.items():
            if array.dtype != np.float64 or not np.isfinite(array).all():
                raise InvalidInput(
                    f"array {name[:60]!r} is {array.dtype} or not finite; allowed: finite float64"
                )
        return PlanValues.model_validate_json(json.dumps(values), strict=True), arrays
    except ValidationError as error:
        raise InvalidInput(
            f"{printable(str(source))}: not a plan: {one_line(error, PlanValues)}"
        ) from error
    except OSError as error:
        raise InvalidInput(f"{printable(str(source))}: not a plan: {error.strerror}") from error
    except InvalidInput as error:
        raise InvalidInput(
            f"{printable(str(source))}: not a plan written by uvms_ocp: {error}"
        ) from error


def from_arrays(
    source: Path, key: str, missing: str
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Read the object in the text under a key, and the arrays beside it, of a file that anyone may
    have written.

    missing: message where there is no such text. Raises `InvalidInput`.
    """
    arrays = dict(read_arrays(source))
    text = arrays.pop(key, np.zeros(0))
    if text.dtype.kind != "U" or text.shape != ():
        raise InvalidInput(missing)
    return json_object(str(text)), arrays


def _from_text(source: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Read a text, in which the lists beside the values are the arrays."""
    texts = json_object(read_text(source, _LARGEST_TEXT))
    values = {name: texts.pop(name) for name in PlanValues.model_fields if name in texts}
    try:
        arrays = {name: np.atleast_1d(np.array(item, dtype=float)) for name, item in texts.items()}
    except (ValueError, TypeError, OverflowError) as error:
        raise InvalidInput(f"lists that are no arrays of numbers: {str(error)[:100]}") from error
    return values, arrays


def trajectory_arrays(trajectory: Trajectory) -> dict[str, np.ndarray]:
    """Return the arrays of a trajectory by the names of its fields."""
    return {
        "t": trajectory.t,
        "q": trajectory.q,
        "v": trajectory.v,
        "a": trajectory.a,
        "thrust": trajectory.thrust,
        "torque": trajectory.torque,
    }


def stored_trajectory(robot: Robot, arrays: Arrays, *, of_wrench: bool) -> Trajectory:
    """Return the trajectory of `trajectory_arrays`. Raises `InvalidInput` for arrays that do not fit
    this robot.
    """
    if "t" in arrays and arrays["t"].ndim == 1:
        n = len(arrays["t"])
    else:
        n = 0
    n_thrust = robot.n_vehicle if of_wrench else len(robot.description.thrusters)
    required_shapes = {
        "q": (n, robot.n_q),
        "v": (n, robot.n_v),
        "a": (n - 1, robot.n_v),
        "thrust": (n - 1, n_thrust),
        "torque": (n - 1, robot.n_joints),
    }
    for name, required in required_shapes.items():
        shape = arrays[name].shape if name in arrays else None
        if n < 2 or shape != required:
            raise InvalidInput(
                f"array {name!r} has shape {shape}; {robot.name} with {n} times needs {required}"
            )
    t = arrays["t"]
    if t[0] != 0.0 or not (np.diff(t) > 0).all():
        raise InvalidInput("times t do not rise from 0")
    if robot.n_vehicle and np.linalg.norm(arrays["q"][:, 3:7], axis=1).min() < _SMALLEST_NORM:
        raise InvalidInput("array 'q' has a quaternion, columns 3 to 6, of norm 0")
    return Trajectory(
        t=t,
        q=arrays["q"],
        v=arrays["v"],
        a=arrays["a"],
        thrust=arrays["thrust"],
        torque=arrays["torque"],
        of_wrench=of_wrench,
    )


def result_arrays(result: LexicographicResult) -> dict[str, np.ndarray]:
    """Return all arrays of the result of a solver; multipliers as far as there are any."""
    arrays = {"x": result.x}
    levels = zip(result.values, result.residuals, result.points, strict=True)
    for i, (values, residuals, point) in enumerate(levels):
        arrays[f"values_{i}"] = values
        arrays[f"residuals_{i}"] = residuals
        arrays[f"point_{i}"] = point.x
        if point.x_multipliers is not None and point.row_multipliers is not None:
            arrays[f"x_multipliers_{i}"] = point.x_multipliers
            arrays[f"row_multipliers_{i}"] = point.row_multipliers
    return arrays


def solver_values(result: LexicographicResult) -> SolverValues:
    """Return the values of the result of a solver beside its arrays."""
    return SolverValues(**{name: getattr(result, name) for name in SolverValues.model_fields})


def stored_result(values: SolverValues, arrays: Arrays) -> LexicographicResult:
    """Return the result of `result_arrays` and `solver_values`. Raises `InvalidInput` for arrays and
    values that do not belong together.
    """
    levels = range(len(values.level_status))
    try:
        points = tuple(_point(arrays, i) for i in levels)
        row_shapes = {
            point.row_multipliers.shape for point in points if point.row_multipliers is not None
        }
        is_consistent = (
            "x" in arrays
            and arrays["x"].ndim == 1
            and len(row_shapes) <= 1
            and all(point.x.shape == arrays["x"].shape for point in points)
            and len(values.iterations) == len(levels)
        )
        if not is_consistent:
            raise InvalidInput("arrays of the solver's result do not fit each other")
        return LexicographicResult(
            x=arrays["x"],
            values=tuple(arrays[f"values_{i}"] for i in levels),
            residuals=tuple(arrays[f"residuals_{i}"] for i in levels),
            points=points,
            **dict(values),
        )
    except (KeyError, ValueError) as error:
        raise InvalidInput(f"the solver's result lacks {str(error)[:100]}") from error


def _point(arrays: Arrays, i: int) -> NlpPoint:
    """Return the point of a level. Raises `KeyError` where it has no x, `InvalidInput` for
    multipliers of another size.
    """
    x = arrays[f"point_{i}"]
    x_multipliers = arrays.get(f"x_multipliers_{i}")
    row_multipliers = arrays.get(f"row_multipliers_{i}")
    has_one_of_two = (x_multipliers is None) != (row_multipliers is None)
    if has_one_of_two or (x_multipliers is not None and x_multipliers.shape != x.shape):
        raise InvalidInput("multipliers of the solver's result do not fit its points")
    if row_multipliers is not None and row_multipliers.ndim != 1:
        raise InvalidInput(
            f"multipliers of rows have shape {row_multipliers.shape}; allowed: a vector"
        )
    return NlpPoint(x=x, x_multipliers=x_multipliers, row_multipliers=row_multipliers)


def clearance_values(report: ClearanceReport) -> ClearanceValues:
    """Return the result of the certificate as values."""
    values = asdict(report)
    return ClearanceValues(**values.pop("nearest"), **values)


def stored_clearance(values: ClearanceValues) -> ClearanceReport:
    """Return the report of `clearance_values`."""
    nearest = NearestPair(distance=values.distance, time=values.time, pair=values.pair)
    others = values.model_dump(exclude={"distance", "time", "pair"})
    return ClearanceReport(nearest=nearest, **others)
