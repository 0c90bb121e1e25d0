"""Check what the series of a stored record have to be, so that every report and figure can bear
them.
"""

from __future__ import annotations

import numpy as np

from uvms_ocp.errors import InvalidInput
from uvms_ocp.record.meta_values import LARGEST, UNIT_NORM_TOLERANCE, LimitsMeta
from uvms_ocp.record.row_files import parts
from uvms_ocp.record.run_meta import (
    MIN_TICK,
    VEHICLE_Q,
    VEHICLE_V,
    PlanMeta,
    RunMeta,
    is_floating,
)
from uvms_ocp.record.tables import SERIES, Series

PLANNED = ("x", "x_rate", "x_acceleration", "x_jerk", "x_snap")
"""Series of planned axes, and of their derivatives."""
_LOAD = ("load_weight", "load_weight_error", "load_mass", "load_mass_error")
"""(n,) real numbers, or (n, n_tools) of several tools."""
_COLUMNS = ("altimeter_range", "altimeter_std", "joint_energy", "tick_time", "controller_time")
"""(n,) real numbers."""
_TABLES = (
    "q",
    "v",
    "command",
    "activations",
    "activity",
    "residual",
    "quantities",
    "disturbance",
    "q_std",
)
_PLANT_TABLES = ("thrust", "asked_thrust", "torque", "thruster_energy", "clearance", "current")
MEASURED = tuple(name for name in SERIES if name.startswith("measured_"))
"""Series of readings, each with when it was taken; NaN at ticks without a new one."""
_REAL = (*_COLUMNS, *_LOAD, *_TABLES, *_PLANT_TABLES, *PLANNED, *MEASURED)
_UNKNOWN = ("thruster_energy", "load_mass", *MEASURED)
"""Series in which NaN means that a value is not known."""
_ENDLESS = ("altimeter_range", "altimeter_std", "activity", "residual", "quantities")
"""Series in which infinity may stand too, such as for a range without an echo, and at ticks whose
input the solver refused.
"""
_WORST_HEALTH = 2
"""Codes of health: 0 good, 1 suspect, 2 lost."""


def check_series(series: Series, meta: RunMeta | PlanMeta) -> None:
    """Raise `InvalidInput` where the series of a file are not what `Record` promises, or do not fit
    the metadata.
    """
    if "t" not in series:
        raise InvalidInput("no series 't'")
    _check_times(series["t"])
    for name, array in series.items():
        _check_kind(name, array, series["t"])
    for name, (lower, upper) in _widths(series, meta).items():
        if name in series:
            _check_width(name, series[name].shape, lower, upper)
    _check_counts(series, meta)
    if "q" in series and is_floating(series, meta):
        _check_quaternions(series["q"], series["t"])
    _check_health(series, meta)
    if isinstance(meta, RunMeta):
        _check_start_and_events(series["t"], meta)


def _check_times(t: np.ndarray) -> None:
    are_times = t.dtype == np.float64 and t.ndim == 1 and t.size and (np.abs(t) <= LARGEST).all()
    if not are_times or (np.diff(t) < MIN_TICK).any():
        raise InvalidInput(
            f"times t of shape {t.shape}; allowed: one or more [s], finite, each later than the one"
            " before"
        )


def _check_kind(name: str, array: np.ndarray, t: np.ndarray) -> None:
    """Raise `InvalidInput` for the wrong shape or type, and for what is not finite but is always
    known.
    """
    allowed_ndim: tuple[int, ...]
    if name in (*_COLUMNS, "saturated", "brakes"):
        allowed_ndim = (1,)
    elif name in _REAL and name not in _LOAD:
        allowed_ndim = (2,)
    else:
        allowed_ndim = (1, 2)
    if array.ndim not in allowed_ndim or len(array) != len(t) or array.dtype.kind == "U":
        if allowed_ndim == (2,):
            expected = f"{len(t)} rows of numbers"
        else:
            expected = f"numbers for {len(t)} times"
        raise InvalidInput(
            f"series {name!r} is {array.dtype} of shape {array.shape}; allowed: {expected}"
        )
    if name in _REAL and array.dtype != np.float64:
        raise InvalidInput(f"series {name!r} is {array.dtype}; allowed: float64")
    if name in _REAL:
        for rows, times in parts(array, t):
            _check_magnitudes(name, rows, times)


def _check_magnitudes(name: str, array: np.ndarray, t: np.ndarray) -> None:
    """Raise `InvalidInput` for NaN and infinity where they mean nothing, and for too large
    numbers.
    """
    is_finite = np.isfinite(array)
    if name in _UNKNOWN:
        allowed = np.isnan(array)
    elif name in _ENDLESS:
        allowed = ~is_finite
    else:
        allowed = np.zeros_like(is_finite)
    is_known = is_finite | allowed
    if not is_known.all():
        raise InvalidInput(
            f"series {name!r} has NaN or infinity at t = {_first_wrong(t, is_known):g} s; record it"
            " anew"
        )
    is_small = ~is_finite | (np.abs(array) <= LARGEST)
    if not is_small.all():
        raise InvalidInput(
            f"series {name!r} is larger than {LARGEST:g} at t = {_first_wrong(t, is_small):g} s;"
            " record it anew"
        )


def _first_wrong(t: np.ndarray, is_right: np.ndarray) -> float:
    """Return the first of the times t (n,) [s] at which not all of the entries (n, ...) are."""
    return float(t[np.argmin(is_right.reshape(len(t), -1).all(axis=1))])


def _widths(series: Series, meta: RunMeta | PlanMeta) -> dict[str, tuple[float, float]]:
    """Return the fewest and the most columns of each series that has some."""
    n_rows = sum(level.rows for level in meta.levels)
    widths = {
        "activations": len(meta.tasks),
        "activity": n_rows,
        "residual": n_rows,
        "quantities": len(meta.quantities),
        "current": 3,
    }
    for name in MEASURED:
        columns = SERIES[name].columns
        if "@" not in "".join(columns):
            widths[name] = len(columns)
    if isinstance(meta, PlanMeta):
        widths |= dict.fromkeys(PLANNED, len(meta.axes))
        widths["clearance"] = len(meta.clearance_groups)
    if meta.limits is not None:
        _check_limits(meta.limits, floating=is_floating(series, meta))
        widths["torque"] = len(meta.limits.effort)
    bounds: dict[str, tuple[float, float]] = {name: (n, n) for name, n in widths.items()}
    return bounds | _motion_widths(series, meta)


def _motion_widths(series: Series, meta: RunMeta | PlanMeta) -> dict[str, tuple[float, float]]:
    """Return columns of q and of series with one for each velocity; q has more than v where a turn
    takes several numbers.
    """
    n_vehicle_v = 0
    n_vehicle_q = 0
    if is_floating(series, meta):
        n_vehicle_v = VEHICLE_V
        n_vehicle_q = VEHICLE_Q
    n_v_lower: float = len(meta.joints) + n_vehicle_v
    n_v_upper: float = np.inf
    if meta.limits is not None:
        n_v_upper = len(meta.limits.velocity)
        n_v_lower = max(n_v_lower, n_v_upper)
    elif "v" in series and series["v"].shape[1] >= n_v_lower:
        n_v_lower = n_v_upper = series["v"].shape[1]
    n_q_lower = n_v_lower + n_vehicle_q - n_vehicle_v
    widths = {"q": (n_q_lower, np.inf)}
    for name in ("v", "command", "disturbance", "q_std"):
        widths[name] = (n_v_lower, n_v_upper)
    # A reading of all joints has a column for each, and one for its time.
    if "v" in series:
        n_readings = series["v"].shape[1] - n_vehicle_v + 1
        widths["measured_joint_velocities"] = (n_readings, n_readings)
    if "q" in series:
        n_readings = series["q"].shape[1] - n_vehicle_q + 1
        widths["measured_joint_positions"] = (n_readings, n_readings)
    return widths


def _check_limits(limits: LimitsMeta, *, floating: bool) -> None:
    n_vehicle = VEHICLE_V if floating else 0
    n_velocity = len(limits.velocity)
    n_position = len(limits.position_lower)
    if n_velocity - n_position != n_vehicle:
        raise InvalidInput(
            f"{n_velocity} limits of velocity and {n_position} of position; allowed:"
            f" {n_vehicle} more of velocity, those of the vehicle"
        )


def _check_width(name: str, shape: tuple[int, ...], lower: float, upper: float) -> None:
    if lower <= shape[1] <= upper:
        return
    if upper == lower:
        columns = f"{lower}"
    elif upper == np.inf:
        columns = f"{lower} or more"
    else:
        columns = f"{lower} to {upper:g}"
    raise InvalidInput(
        f"series {name!r} has shape {shape}; its metadata allow {shape[0]} rows of {columns}"
    )


def _check_counts(series: Series, meta: RunMeta | PlanMeta) -> None:
    counts = {"phase": len(meta.phases)}
    if isinstance(meta, RunMeta):
        counts["status"] = len(meta.statuses)
    for name, n in counts.items():
        if name not in series:
            continue
        values = series[name]
        are_indices = values.dtype.kind in "iu" and values.ndim == 1
        if not are_indices or values.min() < 0 or values.max() >= n:
            raise InvalidInput(
                f"series {name!r} counts what the metadata do not have; allowed: whole numbers"
                f" below {n}"
            )


def _check_quaternions(q: np.ndarray, t: np.ndarray) -> None:
    for q_part, t_part in parts(q, t):
        norms = np.linalg.norm(q_part[:, 3:VEHICLE_Q], axis=1)
        is_unit = np.abs(norms - 1.0) <= UNIT_NORM_TOLERANCE
        if not is_unit.all():
            raise InvalidInput(
                "series 'q' has a quaternion, columns 3 to 6, whose norm is not 1 at t ="
                f" {_first_wrong(t_part, is_unit):g} s"
            )


def _check_health(series: Series, meta: RunMeta | PlanMeta) -> None:
    if "health" not in series:
        return
    values = series["health"]
    n = len(meta.channels) if isinstance(meta, RunMeta) else 0
    are_codes = values.ndim == 2 and values.shape[1] == n and values.dtype.kind in "iu"
    if are_codes and values.size:
        are_codes = 0 <= values.min() <= values.max() <= _WORST_HEALTH
    if not are_codes:
        shape = f"series 'health' is {values.dtype} of shape {values.shape}"
        raise InvalidInput(
            f"{shape}; allowed: whole numbers from 0 to {_WORST_HEALTH}, a column for each of {n}"
            " channels"
        )


def _check_start_and_events(t: np.ndarray, meta: RunMeta) -> None:
    if t[0] != 0.0:
        raise InvalidInput(f"a run that begins at t = {t[0]:g} s; allowed: 0 s")
    for event in meta.events:
        if not t[0] <= event.t <= t[-1]:
            raise InvalidInput(
                f"an event at {event.t:g} s; allowed: {t[0]:g} to {t[-1]:g} s, the times of the"
                " record"
            )
