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

# A plan as arrays and one text of values, in an ``.npz`` file or all of it in a ``.json`` file; and
# back, within bounds.

_TEXT = "summary"
_NO_PLAN = f"no text {_TEXT!r}; give the plan.npz that `Plan.save` wrote"
_LARGEST = 256 << 20  # [B] of a text

Arrays = Mapping[str, np.ndarray]
"""Arrays by name."""

_SHORTEST = (
    1e-6  # norm of a quaternion; that of a plan which breaks its constraints may be far from 1
)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class LevelReport:
    """Outcome of one level."""

    name: str
    status: str
    advice: str
    residual: float
    """Root of twice its cost, in the root of the unit of weighted rows squared: of the squares of
    the distances of weighted rows to their range at the ends of phases, and of the mean of these
    over the nominal time along the path. It is that of the motion, whatever the number of steps.
    """
    iterations: int
    prices: tuple[float, ...] = ()
    """Prices of the levels above: by how much the cost of this one, half the sum of squares of its
    rows, path terms as a mean over time, would fall for each unit of residual, as a norm, that the
    level above gave up (of cost, where that one has `relax`). To first order; empty where
    unknown.
    """
    __pydantic_config__: ClassVar = MetaValue.model_config


class VerdictTolerances(MetaValue):
    """By how much a motion that is called solved may leave what it promises."""

    motion: float = 1e-4
    """[m, rad, m/s, rad/s] Between a node and where its predecessor leads."""
    forces: float = 1e-3
    """[share of the largest force] Of forces that move it, and of their limits in the middle of
    steps.
    """
    force_between: float = 1e-2
    """[share of the limit] Of thrust and torque anywhere else in a step."""
    ranges: float = 3e-4
    """[unit of the quantity] Of positions, velocities, accelerations and rows of constraints, at
    nodes and between.
    """
    clearance: float = 1e-3
    """[m] Of distances between shapes, at nodes and between."""
    goal: float = 1e-3
    """Residual of a level of goals that is met; of weights below 1 times their root."""
    gain: float = 2e-3
    """[share of the residual] That one more step may promise for a level."""
    gain_floor: float = 1e-5
    """Gain of a residual that is none."""


class LevelVerdict(MetaValue):
    """Verdict on one level."""

    name: str
    residual: float
    """See `LevelReport.residual`."""
    gain: Number | None
    """By how much one more step would lower it, to first order, with the levels above held; `None`
    where that is not known.
    """
    missed: bool
    """The level has goals, and they are not met."""
    optimal: bool
    """The level is met, or no step promises more than the tolerance."""


class VerdictReport(MetaValue):
    """Findings of the judge of a plan, and its tolerances and resolution."""

    tolerances: VerdictTolerances
    levels: tuple[LevelVerdict, ...]
    time_resolution: float
    """[s] Between two looks inside a step, at most; where ranges are near it looks closer."""
    unseen: Number | None
    """[share of the tolerance] How much more than was seen may be left between two looks; `None`
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
    """See `uvms_ocp.planning.conservative_advancement.ClearanceReport`, and `NearestPair` for the
    last three.
    """

    unshaped: tuple[str, ...] = ()
    surfaces: tuple[str, ...] = ()
    collision_free: bool
    undecided: bool
    n_samples: int
    distance: float
    """[m]"""
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
    """[J]"""
    peak_thrust: float | None
    """[N]"""
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
    place = target.with_suffix(".npz")
    with as_output_errors(place, "choose another place"), place.open("wb") as file:
        np.savez(file, allow_pickle=False, **{key: np.array(text)}, **arrays)
    return place


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
    """The object in the text under a key, and the arrays beside it, of a file that anyone may have
    written.

    missing: what to say where there is none. Raises `InvalidInput`.
    """
    arrays = dict(read_arrays(source))
    text = arrays.pop(key, np.zeros(0))
    if text.dtype.kind != "U" or text.shape != ():
        raise InvalidInput(missing)
    return json_object(str(text)), arrays


def _from_text(source: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Lists beside the values are the arrays."""
    whole = json_object(read_text(source, _LARGEST))
    values = {name: whole.pop(name) for name in PlanValues.model_fields if name in whole}
    try:
        return values, {
            name: np.atleast_1d(np.array(item, dtype=float)) for name, item in whole.items()
        }
    except (ValueError, TypeError, OverflowError) as error:
        raise InvalidInput(f"lists that are no arrays of numbers: {str(error)[:100]}") from error


# Arrays of a trajectory and of a solver's result, by names, what is proven of it, and back.


def trajectory_arrays(t: Trajectory) -> dict[str, np.ndarray]:
    """Return the arrays of a trajectory by the names of its fields."""
    return {"t": t.t, "q": t.q, "v": t.v, "a": t.a, "thrust": t.thrust, "torque": t.torque}


def stored_trajectory(robot: Robot, arrays: Arrays, *, of_wrench: bool) -> Trajectory:
    """The trajectory of `trajectory_arrays`. Raises `InvalidInput` for arrays that are none of this
    robot.
    """
    if "t" in arrays and arrays["t"].ndim == 1:
        n = len(arrays["t"])
    else:
        n = 0
    if of_wrench:
        thrusters = robot.n_vehicle
    else:
        thrusters = len(robot.description.thrusters)
    widths = {
        "q": robot.n_q,
        "v": robot.n_v,
        "a": robot.n_v,
        "thrust": thrusters,
        "torque": robot.n_joints,
    }
    shapes = {
        name: (n - (name in ("a", "thrust", "torque")), width) for name, width in widths.items()
    }
    for name, shape in shapes.items():
        given = arrays[name].shape if name in arrays else None
        if n < 2 or given != shape:
            raise InvalidInput(
                f"array {name!r} has shape {given}; {robot.name} with {n} times needs {shape}"
            )
    t = arrays["t"]
    if t[0] != 0.0 or not (np.diff(t) > 0).all():
        raise InvalidInput("times t do not rise from 0")
    if robot.n_vehicle and np.linalg.norm(arrays["q"][:, 3:7], axis=1).min() < _SHORTEST:
        raise InvalidInput("array 'q' has a quaternion, columns 3 to 6, of norm 0")
    return Trajectory(t=arrays["t"], **{name: arrays[name] for name in widths}, of_wrench=of_wrench)


def result_arrays(result: LexicographicResult) -> dict[str, np.ndarray]:
    """All arrays of the result of a solver; multipliers as far as there are any."""
    arrays = {"x": result.x}
    for i, (values, residuals, point) in enumerate(
        zip(result.values, result.residuals, result.points, strict=True)
    ):
        arrays |= {f"values_{i}": values, f"residuals_{i}": residuals, f"point_{i}": point.x}
        if point.x_multipliers is not None and point.row_multipliers is not None:
            arrays |= {
                f"x_multipliers_{i}": point.x_multipliers,
                f"row_multipliers_{i}": point.row_multipliers,
            }
    return arrays


def solver_values(result: LexicographicResult) -> SolverValues:
    """Its values beside the arrays."""
    return SolverValues(**{name: getattr(result, name) for name in SolverValues.model_fields})


def stored_result(values: SolverValues, arrays: Arrays) -> LexicographicResult:
    """The result of `result_arrays` and `solver_values`. Raises `InvalidInput` for what does not
    belong together.
    """
    levels = range(len(values.level_status))
    if "x" in arrays and arrays["x"].ndim == 1:
        n = arrays["x"].shape
    else:
        n = None
    try:
        points = tuple(_point(arrays, i) for i in levels)
        rows = {
            point.row_multipliers.shape for point in points if point.row_multipliers is not None
        }
        right = (
            len(rows) <= 1
            and all(point.x.shape == n for point in points)
            and len(values.iterations) == len(levels)
        )
        if n is None or not right:
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
    """Raises `KeyError` where it has no x, `InvalidInput` for multipliers of another size."""
    x = arrays[f"point_{i}"]
    own = arrays.get(f"x_multipliers_{i}")
    rows = arrays.get(f"row_multipliers_{i}")
    if (own is None) != (rows is None) or (own is not None and own.shape != x.shape):
        raise InvalidInput("multipliers of the solver's result do not fit its points")
    if rows is not None and rows.ndim != 1:
        raise InvalidInput(f"multipliers of rows have shape {rows.shape}; allowed: a vector")
    return NlpPoint(x=x, x_multipliers=own, row_multipliers=rows)


def clearance_values(report: ClearanceReport) -> ClearanceValues:
    """Return the result of the certificate as values."""
    values = asdict(report)
    return ClearanceValues(**values.pop("nearest"), **values)


def stored_clearance(values: ClearanceValues) -> ClearanceReport:
    """The report of `clearance_values`."""
    given = values.model_dump()
    return ClearanceReport(
        nearest=NearestPair(**{name: given.pop(name) for name in ("distance", "time", "pair")}),
        **given,
    )
