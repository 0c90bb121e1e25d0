"""Metrics of a run, read from its `Record`: largest values, swings, errors of the estimate."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from uvms_ocp.checks import checked
from uvms_ocp.record.record import Record, keeps_every_tick, quantity as quantity
from uvms_ocp.record.row_files import parts
from uvms_ocp.record.run_meta import VEHICLE_V, RunMeta, joint_errors, joint_positions
from uvms_ocp.record.swings import WINDOW, Swing, swings_among, tilts_of
from uvms_ocp.record.tables import column_units
from uvms_ocp.solvers.hierarchy.solution import Status

_EXACT_STATUSES = frozenset(status.value for status in Status if status.exact)

CHANCE = 0.95
"""Probability that a true error is within its bound."""

_RATE_TOLERANCE = 1.02  # share of a joint's limit of velocity up to which it counts as kept
_RATE_TOLERANCE_IN_FAULT = 1.2  # the same, while a fault is new
_NEW_FAULT = 0.5  # [s] for which a fault, or its end, is new
_AT_STOP = 1e-9  # [rad or m] beyond a limit of position, from which on a stop pushes back
_TOUCH = 0.1  # [s] for which a joint that only touches its stop may be beyond its limit


@checked
def max_velocity_step(record: Record) -> float | None:
    """Return the largest change of any component of the command in one tick, from rest at the start.

    `None` where the record has fewer rows than ticks.
    """
    if not keeps_every_tick(record):
        return None
    command = record["command"]
    largest = np.abs(command[:1]).max(initial=0.0)
    for after, before in parts(command[1:], command[:-1]):
        largest = max(largest, np.abs(after - before).max(initial=0.0))
    return float(largest)


def none_if_nan(value: float | None) -> float | None:
    """Return the value [in its unit], or `None` for NaN, such as an altitude without an echo."""
    if value is None or np.isnan(value):
        return None
    return value


def largest_or_none(values: np.ndarray | None) -> float | None:
    """Return the largest of the values (n,) [in their unit] that are numbers; `None` where all are
    NaN.
    """
    if values is None or np.isnan(values).all():
        return None
    return float(np.nanmax(values))


def extremes_of(record: Record, name: str) -> tuple[str, ...]:
    """Return the names of the series that hold the least and the largest values of a series.

    They are the series itself where every tick has a row.
    """
    lowest = f"{name}_least"
    highest = f"{name}_most"
    if lowest in record.series:
        return (lowest, highest)
    return (name,)


def smallest_altimeter_range(record: Record) -> float | None:
    """Return the smallest range [m] of the altimeter in any tick; `None` without an echo."""
    ranges = record[extremes_of(record, "altimeter_range")[0]]
    echoes = ranges[np.isfinite(ranges)]
    if echoes.size:
        return float(echoes.min())
    return None


def mean_sizes(record: Record, name: str, index: Any) -> np.ndarray:
    """Return the mean absolute values of a series since the row before, at an index of it."""
    mean_name = f"{name}_mean"
    if mean_name in record.series:
        return np.abs(record[mean_name][index])
    return np.abs(record[name][index])


def failed_ticks(record: Record) -> dict[str, int] | None:
    """Count the ticks that the solver did not solve exactly, by its status; `None` where some
    failed and not every tick has a row.
    """
    codes, counts = np.unique(record["status"], return_counts=True)
    names = [record.run_meta.statuses[code] for code in codes]
    ticks_by_status = zip(names, counts.tolist(), strict=True)
    failed = {name: ticks for name, ticks in ticks_by_status if name not in _EXACT_STATUSES}
    if failed and not keeps_every_tick(record):
        return None
    return failed


def largest_tilt(record: Record) -> float | None:
    """Return the largest tilt [rad] of the frames that tasks keep level, while such a task is on;
    `None` where it never is.

    Without such a task it is the vehicle's.
    """
    meta = record.run_meta
    largest_series = extremes_of(record, "quantities")[-1]
    tilts = []
    for column, task in enumerate(meta.tasks):
        tilt = quantity(record, f"{task.name}.tilt", largest_series)
        if tilt is not None:
            is_on = record["activations"][:, column] > 0.0
            tilts.append(np.where(is_on, tilt, np.nan))
    if not tilts and meta.floating:
        roll, pitch = tilts_of(record["q"]).values()
        tilts.append(np.arccos(np.cos(roll) * np.cos(pitch)))
    largest = [largest_or_none(tilt) for tilt in tilts]
    return max((value for value in largest if value is not None), default=None)


def quantities_at(record: Record, t: float) -> dict[str, float]:
    """Return all quantities [in their units] at time t [s], as estimated."""
    first_row = int(np.searchsorted(record["t"], t - 1e-9))
    values = record["quantities"][min(first_row, len(record) - 1)]
    return dict(zip(record.meta.quantities, values.tolist(), strict=True))


def swings(record: Record) -> list[Swing]:
    """Return what swings at the end of a run, as `swings_among`: errors that the last phase waits
    for, roll and pitch.

    Raises `InvalidInput` for a plan's record.
    """
    meta = record.run_meta
    phase_code = int(record["phase"][-1])
    phase = meta.phases[phase_code].name
    window_start = max(0, len(record) - round(WINDOW / meta.dt))
    phase_start = int(np.argmax(record["phase"] == record["phase"][-1]))
    start = max(window_start, phase_start)
    errors = {}
    for threshold in meta.thresholds:
        if threshold.phase != phase or threshold.sign != "<":
            continue
        series = quantity(record, threshold.quantity)
        if series is not None:
            errors[threshold.quantity] = (series[start:], threshold.limit)
    tilts = {}
    if meta.floating:
        tilts = tilts_of(record["q"][window_start:])
    return list(swings_among(errors, tilts, meta.dt))


def error_bound(record: Record, quantity: str) -> float | None:
    """Bound a true distance or angle at the end [m] or [rad] with probability `CHANCE`.

    By the estimate alone: its value there, and the covariance of its error, taken for the same in
    all three axes. `None` where the estimator gave no covariance.
    """
    std = record.run_meta.spread(quantity)
    estimate = quantities_at(record, float(record["t"][-1])).get(quantity)
    if std is None or estimate is None or not np.isfinite([std, estimate]).all():
        return None
    return norm_bound(estimate, std)


def norm_bound(measured: float, spread: float) -> float:
    """Bound the norm of three numbers [m or rad] with probability `CHANCE`.

    Mean and variance of its square are those of a multiple of chi-squared [Patnaik1949]. measured
    [m or rad]: the norm of their means. spread [m or rad]: root of the sum of their variances,
    which are alike.
    """
    if spread == 0.0:
        return measured
    from scipy.special import gammaincinv  # a tenth of a second

    variance = spread**2 / 3.0  # of each of the three numbers
    # Mean, and half the variance, of the square of the norm.
    mean = spread**2 + measured**2
    half_variance = variance * (3.0 * variance + 2.0 * measured**2)
    half_freedom = 0.5 * mean**2 / half_variance
    return float(np.sqrt(half_variance / mean * 2.0 * gammaincinv(half_freedom, CHANCE)))


def estimate_table(record: Record) -> list[dict[str, Any]]:
    """Return rows ``position`` [m], ``attitude`` [rad], ``joints`` that turn [rad] and ``sliding
    joints`` [m], with the errors of the estimate; none with ideal sensors.

    ``rms`` error of an axis over the second half of the run, ``spread``: the standard deviation
    that the filter gave, also root mean square, and ``ratio`` of their squares, which is 1 where
    the process model holds, and None where the spread is 0. No rows in older records.
    """
    if not {"q_estimated", "q_std"} <= record.series.keys():
        return []
    second_half = slice(len(record) // 2, None)
    q = record["q"][second_half]
    q_estimated = record["q_estimated"][second_half]
    std = record["q_std"][second_half]
    rows = []
    if record.run_meta.floating:
        rows += _vehicle_error_rows(q, q_estimated, std)
    errors = joint_errors({"q": q, "q_estimated": q_estimated}, record.meta)
    if errors is None or errors.shape[1] == 0:
        return rows
    joint_std = std[:, -errors.shape[1] :]
    slides = sliding_joints(record.run_meta)
    for name, chosen in (("joints", ~slides), ("sliding joints", slides)):
        if chosen.any():
            rows.append(_error_row(name, errors[:, chosen], joint_std[:, chosen]))
    return rows


def _vehicle_error_rows(
    q: np.ndarray, q_estimated: np.ndarray, std: np.ndarray
) -> list[dict[str, Any]]:
    """Return the rows of position and attitude of `estimate_table`."""
    position_errors = (q_estimated - q)[:, :3]
    # The distance of two quaternions is half the angle between them; their signs do not matter.
    quaternions = q[:, 3:7]
    estimated = q_estimated[:, 3:7]
    signs = np.sign((quaternions * estimated).sum(axis=1, keepdims=True))
    distances = np.linalg.norm(signs * estimated - quaternions, axis=1, keepdims=True)
    angle_errors = 2.0 * distances / np.sqrt(3.0)  # [rad] of each of the three axes
    return [
        _error_row("position", position_errors, std[:, :3]),
        _error_row("attitude", angle_errors, std[:, 3:6]),
    ]


def _error_row(name: str, errors: np.ndarray, stds: np.ndarray) -> dict[str, Any]:
    """Return a row of `estimate_table` for errors and standard deviations (n, k) of some axes."""
    rms_error = float(np.sqrt(np.mean(errors**2)))
    rms_std = float(np.sqrt(np.mean(stds**2)))
    ratio = None
    if rms_std:
        ratio = (rms_error / rms_std) ** 2
    return {
        "of": name,
        "rms": rms_error,
        "spread": rms_std,
        "ratio": ratio,
    }


def sliding_joints(meta: RunMeta) -> np.ndarray:
    """Return whether each joint (n_joints,) slides; none does in older records, which do not say."""
    return np.array([joint in (meta.sliding or ()) for joint in meta.joints], dtype=bool)


def passed_rates(record: Record) -> list[dict[str, Any]]:
    """Return one row per joint whose true velocity passed its limit, by more than 2 %, or 20 %
    where a fault is new: at its largest excess.

    joint, t [s], rate and limit [unit], which is rad/s or m/s, and the share of the limit.
    """
    meta = record.run_meta
    limits = record.meta.limits
    if limits is None:
        return []
    first_joint = VEHICLE_V if meta.floating else 0
    extremes = [np.abs(record[name][:, first_joint:]) for name in extremes_of(record, "v")]
    rates = np.max(extremes, axis=0)
    bounds = np.array(limits.velocity[first_joint:])
    t = record["t"]
    in_fault = _while_faults_are_new(meta, t)
    tolerances = np.where(in_fault, _RATE_TOLERANCE_IN_FAULT, _RATE_TOLERANCE)
    excess = rates - bounds * tolerances[:, None]
    worst_rows = excess.argmax(axis=0)
    joints = np.arange(len(bounds))
    names: Sequence[str] = meta.joints
    if len(names) != len(bounds):
        names = [f"axis {joint + 1}" for joint in joints]
    units = column_units("v", record["v"].shape[1], meta)[first_joint:]
    too_fast = (excess[worst_rows, joints] > 0.0) & (bounds > 0.0)
    table = []
    for joint in np.flatnonzero(too_fast).tolist():
        rate = rates[worst_rows[joint], joint]
        table.append(
            {
                "joint": names[joint],
                "t": float(t[worst_rows[joint]]),
                "rate": float(rate),
                "unit": units[joint],
                "limit": float(bounds[joint]),
                "share": float(rate / bounds[joint]),
            }
        )
    return table


def pressed_stops(record: Record) -> list[dict[str, Any]]:
    """Return one row per joint that lay against a stop: its true position was beyond a limit for
    longer than a touch. The kinematic plant has no stops.

    joint, t [s] when it first did, duration [s] of all times together, and the largest excess
    [unit], which is rad or m. Where not every tick has a row, the duration is of whole rows.
    """
    meta = record.run_meta
    limits = record.meta.limits
    if (
        limits is None
        or meta.plant == "kinematic"
        or len(meta.joints) != len(limits.position_lower)
    ):
        return []
    names = extremes_of(record, "q")
    lowest = joint_positions(record.series, meta, names[0])
    highest = joint_positions(record.series, meta, names[-1])
    if lowest is None or highest is None:
        return []
    below = np.array(limits.position_lower) - lowest
    above = highest - np.array(limits.position_upper)
    excess = np.maximum(below, above)
    t = record["t"]
    lengths = np.diff(t, append=t[-1] + meta.dt)
    slides = sliding_joints(meta)
    table = []
    is_beyond = excess > _AT_STOP
    durations = lengths @ is_beyond
    for joint in np.flatnonzero(durations > _TOUCH).tolist():
        at_stop = is_beyond[:, joint]
        table.append(
            {
                "joint": meta.joints[joint],
                "t": float(t[at_stop][0]),
                "duration": float(durations[joint]),
                "excess": float(excess[at_stop, joint].max()),
                "unit": "m" if slides[joint] else "rad",
            }
        )
    return table


def _while_faults_are_new(meta: RunMeta, t: np.ndarray) -> np.ndarray:
    """Return whether at each time (n,) [s] a fault has just begun or ended."""
    is_new = np.zeros(len(t), dtype=bool)
    for fault in meta.faults:
        for change in (fault.t, fault.end):
            if change is not None:
                is_new |= (t >= change) & (t <= change + _NEW_FAULT)
    return is_new
