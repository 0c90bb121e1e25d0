"""Metadata of a record beside its series, `RunMeta` of a run or `PlanMeta` of a plan, and their
JSON form.

Values that cannot be changed. What a robot, a mission or a method does not have is `None` or empty.
"""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping
from functools import cache
from importlib.metadata import version
from typing import Annotated, Any, Final, Literal

import numpy as np
from pydantic import Field, ValidationError, model_validator

from uvms_ocp.errors import InvalidInput, short
from uvms_ocp.model_errors import one_line
from uvms_ocp.record import meta_values, untrusted
from uvms_ocp.record.display import SmallTable, TableDisplay, format_value
from uvms_ocp.version import __version__

MIN_TICK = 1e-9
"""[s] shortest time between two rows."""
VERSION: Final = "0.2"
"""Version of the format; 0.1 had neither a version nor a kind, and is still read."""

VEHICLE_V = 6
"""Number of velocities of a vehicle."""
VEHICLE_Q = 7
"""Number of a vehicle's entries in q: position and quaternion."""
_DEPENDENCIES = ("pin", "casadi", "coal", "numpy")
"""Packages that the numbers of a record depend on."""


class RecordMeta(TableDisplay, meta_values.MetaValue):
    """Metadata that any record has, for figures, scenes and reports."""

    version: Literal["0.2"] = VERSION
    scenario: str
    """Name of the scenario or request, in a few words."""
    robot: str
    """Name of the robot."""
    robot_files: meta_values.RobotFilesMeta | None = None
    """Files of a robot of one's own; older records lack them."""
    joints: tuple[str, ...]
    """Names in the order of q."""
    endless: tuple[str, ...] = ()
    """Joints that turn without end, each (cos, sin) in q; older records lack them. See
    `joint_positions`.
    """
    sliding: tuple[str, ...] | None = None
    """Joints that slide, in m and N; all others turn, in rad and N m. `None` in older records,
    which do not say.
    """
    tools: tuple[str, ...] = ()
    """Frames of the tools, of which the first is also called ``tool``; empty in older records."""
    thrusters: tuple[str, ...] = ()
    """Names in the order of the series ``thrust``; empty in older records."""
    phases: Annotated[tuple[meta_values.PhaseMeta, ...], Field(min_length=1)]
    """The series ``phase`` counts them; a plan has one."""
    tasks: tuple[meta_values.TaskMeta, ...] = ()
    """Highest priority first, one per column of the series ``activations``."""
    tool_task: str | None = None
    """The task that brings the tool to its goal."""
    levels: tuple[meta_values.LevelMeta, ...] = ()
    """Levels whose rows are the columns of the series ``activity`` and ``residual``."""
    quantities: tuple[str, ...] = ()
    """``task.quantity``, one per column of the series ``quantities``."""
    thresholds: tuple[meta_values.ThresholdMeta, ...] = ()
    """Conditions that phases wait for."""
    limits: meta_values.LimitsMeta | None = None
    """Limits of the robot."""
    surroundings: meta_values.SurroundingsMeta = meta_values.SurroundingsMeta()
    """Floor, obstacles, frames and markers that are drawn."""
    packages: tuple[meta_values.PackageMeta, ...] = ()
    """Versions of what computed the record."""

    @model_validator(mode="after")
    def _has_names_of_one_meaning(self) -> RecordMeta:
        phase_names = [phase.name for phase in self.phases]
        meta_values.require_unique("phases", [meta_values.DONE, meta_values.ABORT, *phase_names])
        meta_values.require_unique("tasks", (task.name for task in self.tasks))
        meta_values.require_unique("quantities", self.quantities)
        return self

    def _table(self) -> SmallTable:
        rows = list[tuple[str, str]]()
        for name in type(self).model_fields:
            value = getattr(self, name)
            if value not in ("", (), None):
                rows.append((name, format_value(_by_name(value))))
        return SmallTable(title=f"{type(self).__name__} of {self.scenario}", rows=tuple(rows))


def _by_name(value: Any) -> Any:
    """Return the names of values of many fields; those without one are counted."""
    if not isinstance(value, tuple):
        return value
    if not any(isinstance(item, meta_values.MetaValue) for item in value):
        return value
    return tuple(getattr(item, "name", {}) for item in value)


class RunMeta(RecordMeta):
    """Metadata of a run: a mission, simulated tick by tick."""

    kind: Literal["run"] = "run"
    plant: str
    solver: str
    controller: str = ""
    """Name of what ran, a user's own or the toolkit's; empty in older records."""
    estimator: str = ""
    """Name of the estimator that ran; empty in older records."""
    sensors: str = ""
    """Name of the sensors that ran; empty in older records."""
    floating: bool
    """True where q begins with the pose of a vehicle."""
    dt: Annotated[float, Field(ge=MIN_TICK, le=meta_values.LARGEST)]
    """Control period [s]; the mean one of its rows where not every tick was kept."""
    completed: bool
    """True where every phase came to its end."""
    stopped: Literal["", "stopped", "diverged", "cut off"] = ""
    """Why it ended early: by hand, by motion beyond what a record holds, or with its program; empty
    where it did not.
    """
    pending: str = ""
    """Conditions that an incomplete mission still waited for."""
    abort_phase: str = ""
    """Name of the phase in which the mission is given up, if it has one."""
    events: tuple[meta_values.EventMeta, ...] = ()
    alarms: tuple[meta_values.AlarmMeta, ...] = ()
    faults: tuple[meta_values.FaultMeta, ...] = ()
    """Faults that were injected; the mission was not given them."""
    channels: tuple[str, ...] = ()
    """Names of the sensors, one per column of the series ``health``; empty in older records."""
    true_quantities: tuple[meta_values.QuantityMeta, ...] = ()
    """Quantities at the true state at the end."""
    sensors_allow: tuple[meta_values.QuantityMeta, ...] = ()
    """Standard deviations of the estimate at the end, as far as the noise of the sensors tells;
    none with ideal sensors.
    """
    spreads: tuple[meta_values.QuantityMeta, ...] = ()
    """Standard deviations of the estimate at the end, as the estimator gave them; none in older
    records.
    """
    statuses: tuple[str, ...] = ()
    """Words for the numbers of the series ``status``."""
    seed: int = 0
    noise: bool = False
    planned_energy: meta_values.Number | None = None
    """Energy [J] that the plan takes which was followed; `None` where none was, or it is not known.
    """
    wall_s: meta_values.Number = 0.0
    """Time [s] that the simulation took."""

    @model_validator(mode="after")
    def _fits_together(self) -> RunMeta:
        """Check that channels have one meaning by name, and events lead from phase to phase."""
        meta_values.require_unique("channels", self.channels)
        ends = {meta_values.DONE, meta_values.ABORT}
        targets = ends.union(phase.name for phase in self.phases)
        phase = self.phases[0].name
        t = -meta_values.LARGEST
        for event in self.events:
            if event.source != phase or phase in ends or event.target not in targets:
                transition = f"from {event.source[:60]!r} to {event.target[:60]!r}"
                raise ValueError(
                    f"an event at {event.t:g} s leads {transition}; the mission was in"
                    f" {phase[:60]!r}"
                )
            if event.t <= t:
                raise ValueError(
                    f"an event at {event.t:g} s after one at {t:g} s; events stand in order of time"
                )
            phase = event.target
            t = event.t
        is_done = phase == meta_values.DONE
        if self.events and self.completed != is_done:
            verdict = "completed" if self.completed else "not completed"
            raise ValueError(f"a mission that is {verdict}; its last event leads to {phase[:60]!r}")
        return self

    @property
    def allowance(self) -> dict[str, float]:
        """`sensors_allow` by name [m] or [rad]."""
        return {item.name: item.value for item in self.sensors_allow}

    def spread(self, name: str) -> float | None:
        """Return the standard deviation [m] or [rad] of ``task.quantity`` at the end, by the
        estimator; `None` if it gave none.
        """
        return _value_of(name, self.spreads)

    def true_quantity(self, name: str) -> float | None:
        """Return the value of ``task.quantity`` at the true state at the end, in its unit [m] or
        [rad]; `None` if not measured.
        """
        return _value_of(name, self.true_quantities)


def _value_of(name: str, quantities: tuple[meta_values.QuantityMeta, ...]) -> float | None:
    """Return the value of a quantity by its name, if it is there."""
    for quantity in quantities:
        if quantity.name == name:
            return quantity.value
    return None


class PlanMeta(RecordMeta):
    """Metadata of a plan: a motion that no one has made yet."""

    kind: Literal["plan"] = "plan"
    axes: tuple[str, ...]
    """Planned axes, one per column of the series ``x``."""
    axis_limits: meta_values.AxisLimitsMeta
    breaks: tuple[meta_values.Number, ...]
    """Times [s] where the pieces of the trajectory meet, both ends included."""
    clearance_wanted: meta_values.Number
    """Clearance [m] that was wanted."""
    link_clearance_wanted: meta_values.Number | None = None
    """Clearance [m] that was wanted between two links; `None`: that of obstacles."""
    clearance_groups: tuple[str, ...] = ()
    """Obstacles from which the columns of the series ``clearance`` are the distance."""
    min_clearance: meta_values.ClearanceMeta | None = None
    """The smallest distance met; `None` where nothing can meet."""

    @model_validator(mode="after")
    def _limits_each_axis(self) -> PlanMeta:
        n = len(self.axes)
        for limits in (self.axis_limits.x_rate, self.axis_limits.x_acceleration):
            if limits is not None and len(limits) != n:
                raise ValueError(f"axis_limits have one number for each of {n} axes")
        meta_values.require_unique("axes", self.axes)
        return self


def is_floating(series: Mapping[str, Any], meta: RunMeta | PlanMeta) -> bool:
    """Return whether q begins with the pose of a vehicle; a plan shows it by its velocities.
    series: (n, ...) each, by name.
    """
    if isinstance(meta, RunMeta):
        return meta.floating
    return "v" in series and series["v"].shape[1] - len(meta.joints) == VEHICLE_V


def joint_positions(series: Mapping[str, Any], meta: RunMeta | PlanMeta, name: str = "q") -> Any:
    """Return one number per joint (n, n_joints) [rad or m], without jumps, from the series ``q``
    or ``q_estimated`` of a record.

    `None` where it has no such series, or joints of several axes. series: (n, ...) each, by name.
    """
    if name not in series:
        return None
    q = series[name]
    column = VEHICLE_Q if is_floating(series, meta) else 0
    if q.shape[1] != column + len(meta.joints) + len(meta.endless):
        return None
    positions = []
    for joint in meta.joints:
        position = q[:, column]
        column += 1
        if joint in meta.endless:
            sine = q[:, column]
            position = np.unwrap(np.arctan2(sine, position))
            column += 1
        positions.append(position)
    return np.array(positions).reshape(len(positions), len(q)).T


def joint_errors(series: Mapping[str, Any], meta: RunMeta | PlanMeta) -> Any:
    """Return estimate less truth of each joint (n, n_joints) [rad or m], as `joint_positions`;
    endless ones the shorter way.
    """
    true = joint_positions(series, meta, "q")
    estimated = joint_positions(series, meta, "q_estimated")
    if true is None or estimated is None:
        return None
    is_endless = np.array([joint in meta.endless for joint in meta.joints], dtype=float)
    turn = 2 * np.pi * is_endless  # [rad]
    return estimated - true - turn * np.round((estimated - true) / (2 * np.pi))


def level_rows(meta: RecordMeta) -> list[tuple[str, slice]]:
    """Return the name of each level, and which columns of `activity` and `residual` are its
    rows.
    """
    rows_by_level = list[tuple[str, slice]]()
    start = 0
    for level in meta.levels:
        end = start + level.rows
        rows_by_level.append((level.name, slice(start, end)))
        start = end
    return rows_by_level


_KINDS: dict[str, type[RunMeta] | type[PlanMeta]] = {"run": RunMeta, "plan": PlanMeta}


@cache
def packages() -> tuple[meta_values.PackageMeta, ...]:
    """Return this package, Python and what the numbers depend on."""
    version_texts = {"uvms_ocp": __version__, "python": platform.python_version()}
    for name in _DEPENDENCIES:
        version_texts[name] = version(name)
    installed = []
    for name, text in version_texts.items():
        installed.append(meta_values.PackageMeta(name=name, version=text))
    return tuple(installed)


def versions(installed: tuple[meta_values.PackageMeta, ...]) -> dict[str, str]:
    """Return versions by package, for reports."""
    return {package.name: package.version for package in installed}


def write_meta(meta: RunMeta | PlanMeta) -> str:
    """Return the JSON text that `read_meta` reads."""
    return meta.model_dump_json()


def read_meta(text: str) -> RunMeta | PlanMeta:
    """Read the metadata in a JSON text of this format or of 0.1.

    Raises `InvalidInput`, in one line, for what is neither, and names the keys that are wrong.
    """
    values = untrusted.json_object(text, "metadata", "an object with a kind and a version")
    if "version" not in values:
        values = _from_0_1(values)
    model = _model(values)
    try:
        return model.model_validate_json(json.dumps(values), strict=True)
    except ValidationError as error:
        raise InvalidInput(one_line(error, model)) from error


def _model(values: dict[str, Any]) -> type[RunMeta] | type[PlanMeta]:
    """Return the class of metadata of this version and kind; raise `InvalidInput` for others."""
    if values["version"] != VERSION:
        raise InvalidInput(
            f"format {short(values['version'])}; this version reads {VERSION} and 0.1: install a"
            " newer one"
        )
    kind = str(values.get("kind"))
    if kind not in _KINDS:
        raise InvalidInput(
            f"a record of neither a run nor a plan, but {short(kind)}; give what `run` or `plan`"
            " wrote"
        )
    return _KINDS[kind]


def _from_0_1(values: dict[str, Any]) -> dict[str, Any]:
    """Bring metadata of format 0.1 to this format; what is damaged stays as it is and is refused
    later.
    """
    if "completed" in values:
        kind = "run"
    elif "min_clearance" in values:
        kind = "plan"
    else:
        kind = "none"
    converted = {**values, "kind": kind, "version": VERSION}
    field_names = {
        "markers": "position",
        "frames": "pose",
        "true_quantities": "value",
        "versions": "version",
    }
    for key, field in field_names.items():
        if key in values:
            converted[key] = _named_values(values[key], field)
    surroundings = dict[str, Any]()
    for key in meta_values.SurroundingsMeta.model_fields:
        if key in converted:
            surroundings[key] = converted.pop(key)
    converted["surroundings"] = surroundings
    if "versions" in converted:
        converted["packages"] = converted.pop("versions")
    if kind == "plan":
        converted["min_clearance"] = _clearance(values["min_clearance"])
    return converted


def _named_values(values: Any, field: str) -> Any:
    """Return a mapping as a list of values with a name each."""
    if isinstance(values, dict):
        return [{"name": name, field: value} for name, value in values.items()]
    return values


def _clearance(values: Any) -> Any:
    """Return time, distance and pair of the smallest distance by name; `None` where it is infinite,
    as nothing can meet.
    """
    if not isinstance(values, list) or len(values) != 3:
        return values
    t, distance, pair = values
    if distance == float("inf"):
        return None
    return {"t": t, "distance": distance, "between": pair}
