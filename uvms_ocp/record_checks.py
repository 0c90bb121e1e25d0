"""What the series of a stored record have to be, so that every report and figure can bear them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.meta_values import LARGEST, NEARLY_ONE, LimitsMeta
from uvms_ocp.run_meta import SHORTEST_TICK, VEHICLE_V, PlanMeta, RunMeta, is_floating

Series = Mapping[str, np.ndarray]
"""Time series by name, (n, ...) each."""

_AXES = ("x", "x_rate", "x_acceleration", "x_jerk", "x_snap")
_LOAD = ("load_weight", "load_weight_error", "load_mass", "load_mass_error")
_COLUMNS = ("altimeter_range", "altimeter_spread", "joint_energy", "tick_time", "controller_time", *_LOAD)
"""(n,) real numbers."""
_TABLES = ("q", "v", "command", "gates", "activity", "residual", "quantities", "disturbance", "q_spread")
_PLANT_TABLES = ("thrust", "asked_thrust", "torque", "thruster_energy", "clearance", "current")
_REAL = (*_COLUMNS, *_TABLES, *_PLANT_TABLES, *_AXES)
_UNKNOWN = ("thruster_energy", "load_mass")
"""Where NaN means that it is not known."""
_ENDLESS = ("altimeter_range", "altimeter_spread", "activity", "residual", "quantities")
"""Where infinity too may stand, such as for a range without an echo, and at ticks whose input the solver refused."""
_VEHICLE_Q = 7
_WORST_HEALTH = 2
"""Codes of health: 0 good, 1 suspect, 2 lost."""


def check_series(series: Series, meta: RunMeta | PlanMeta) -> None:
    """Raise `InvalidInput` where the series of a file are not what `Record` promises, or do not fit the metadata."""
    if "t" not in series:
        raise InvalidInput("no series 't'")
    _check_times(series["t"])
    for name, array in series.items():
        _check_kind(name, array, series["t"])
    for name, (least, most) in _widths(series, meta).items():
        if name in series and not least <= series[name].shape[1] <= most:
            columns = f"{least}" if most == least else f"{least} or more" if most == np.inf else f"{least} to {most:g}"
            shape = series[name].shape
            raise InvalidInput(f"series {name!r} has shape {shape}; its metadata allow {shape[0]} rows of {columns}")
    _check_counts(series, meta)
    _check_quaternions(series, meta)
    _check_health(series, meta)
    if isinstance(meta, RunMeta):
        _check_start_and_events(series["t"], meta)


def _check_times(t: np.ndarray) -> None:
    right = t.dtype == np.float64 and t.ndim == 1 and t.size and (np.abs(t) <= LARGEST).all()
    if not right or (np.diff(t) < SHORTEST_TICK).any():
        raise InvalidInput(
            f"times t of shape {t.shape}; allowed: one or more [s], finite, each later than the one before"
        )


def _check_kind(name: str, array: np.ndarray, t: np.ndarray) -> None:
    """Raise `InvalidInput` for the wrong shape or type, and for what is not finite but is always known."""
    allowed = (1,) if name in (*_COLUMNS, "saturated") else (2,) if name in _REAL else (1, 2)
    if array.ndim not in allowed or len(array) != len(t) or array.dtype.kind == "U":
        wanted = f"{len(t)} rows of numbers" if allowed == (2,) else f"numbers for {len(t)} times"
        raise InvalidInput(f"series {name!r} is {array.dtype} of shape {array.shape}; allowed: {wanted}")
    if name in _REAL and array.dtype != np.float64:
        raise InvalidInput(f"series {name!r} is {array.dtype}; allowed: float64")
    if name in _REAL:
        _check_sizes(name, array, t)


def _check_sizes(name: str, array: np.ndarray, t: np.ndarray) -> None:
    there = np.isfinite(array)
    allowed = np.isnan(array) if name in _UNKNOWN else ~there if name in _ENDLESS else np.zeros_like(there)
    if not (there | allowed).all():
        raise InvalidInput(
            f"series {name!r} has NaN or infinity at t = {_first_wrong(t, there | allowed):g} s; record it anew"
        )
    small = ~there | (np.abs(array) <= LARGEST)
    if not small.all():
        raise InvalidInput(
            f"series {name!r} is larger than {LARGEST:g} at t = {_first_wrong(t, small):g} s; record it anew"
        )


def _first_wrong(t: np.ndarray, right: np.ndarray) -> float:
    return float(t[np.argmin(right.reshape(len(t), -1).all(axis=1))])


def _widths(series: Series, meta: RunMeta | PlanMeta) -> dict[str, tuple[float, float]]:
    """The fewest and the most columns of each series that has some."""
    rows = sum(level.rows for level in meta.levels)
    exact = {"gates": len(meta.tasks), "activity": rows, "residual": rows, "quantities": len(meta.quantities)}
    exact["current"] = 3
    if isinstance(meta, PlanMeta):
        exact |= {name: len(meta.axes) for name in _AXES} | {"clearance": len(meta.clearance_groups)}
    if meta.limits is not None:
        _check_limits(meta.limits, floating=is_floating(series, meta))
        exact["torque"] = len(meta.limits.effort)
    return {name: (n, n) for name, n in exact.items()} | _motion_widths(series, meta)


def _motion_widths(series: Series, meta: RunMeta | PlanMeta) -> dict[str, tuple[float, float]]:
    """Of q and of what has a column for each velocity; q has more than v where a turn takes several numbers."""
    joints, floating = len(meta.joints), is_floating(series, meta)
    n_v: tuple[float, float] = (joints + (VEHICLE_V if floating else 0), np.inf)
    if meta.limits is not None:
        n_v = (max(n_v[0], len(meta.limits.velocity)), len(meta.limits.velocity))
    elif "v" in series and series["v"].shape[1] >= n_v[0]:
        n_v = (series["v"].shape[1],) * 2
    least = n_v[0] + (_VEHICLE_Q - VEHICLE_V if floating else 0)
    return {"q": (least, np.inf)} | dict.fromkeys(("v", "command", "disturbance", "q_spread"), n_v)


def _check_limits(limits: LimitsMeta, *, floating: bool) -> None:
    vehicle = VEHICLE_V if floating else 0
    if len(limits.velocity) - len(limits.position_lower) != vehicle:
        given = f"{len(limits.velocity)} limits of velocity and {len(limits.position_lower)} of position"
        raise InvalidInput(f"{given}; allowed: {vehicle} more of velocity, those of the vehicle")


def _check_counts(series: Series, meta: RunMeta | PlanMeta) -> None:
    counted = {"phase": len(meta.phases)} | ({"status": len(meta.statuses)} if isinstance(meta, RunMeta) else {})
    for name, n in counted.items():
        if name in series:
            values = series[name]
            if values.dtype.kind not in "iu" or values.ndim != 1 or values.min() < 0 or values.max() >= n:
                raise InvalidInput(
                    f"series {name!r} counts what the metadata do not have; allowed: whole numbers below {n}"
                )


def _check_health(series: Series, meta: RunMeta | PlanMeta) -> None:
    if "health" not in series:
        return
    values, n = series["health"], len(meta.channels) if isinstance(meta, RunMeta) else 0
    columns = values.ndim == 2 and values.shape[1] == n and values.dtype.kind in "iu"
    if not columns or (values.size and not 0 <= values.min() <= values.max() <= _WORST_HEALTH):
        raise InvalidInput(
            f"series 'health' is {values.dtype} of shape {values.shape}; "
            f"allowed: whole numbers from 0 to {_WORST_HEALTH}, a column for each of {n} channels"
        )


def _check_quaternions(series: Series, meta: RunMeta | PlanMeta) -> None:
    if "q" in series and is_floating(series, meta):
        norms = np.linalg.norm(series["q"][:, 3:_VEHICLE_Q], axis=1)
        right = np.abs(norms - 1.0) <= NEARLY_ONE
        if not right.all():
            when = _first_wrong(series["t"], right)
            raise InvalidInput(f"series 'q' has a quaternion, columns 3 to 6, whose norm is not 1 at t = {when:g} s")


def _check_start_and_events(t: np.ndarray, meta: RunMeta) -> None:
    if t[0] != 0.0:
        raise InvalidInput(f"a run that begins at t = {t[0]:g} s; allowed: 0 s")
    for event in meta.events:
        if not t[0] <= event.t <= t[-1]:
            raise InvalidInput(f"an event at {event.t:g} s; allowed: {t[0]:g} to {t[-1]:g} s, the times of the record")
