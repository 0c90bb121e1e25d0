"""Metrics of a run, read from its `Record`: errors of the estimate, resources of each phase,
largest values.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from uvms_ocp.checks import checked
from uvms_ocp.record.display import TableRows
from uvms_ocp.record.meta_values import ABORT, DONE
from uvms_ocp.record.record import Record, keeps_every_tick, quantity as quantity
from uvms_ocp.record.row_files import parts
from uvms_ocp.record.run_meta import VEHICLE_V, RunMeta, joint_errors, joint_positions
from uvms_ocp.record.swings import WINDOW, Swing, swings_among, tilts_of
from uvms_ocp.record.tables import column_units
from uvms_ocp.solvers.hierarchy.solution import Status

_EXACT_STATUSES = frozenset(status.value for status in Status if status.exact)

CHANCE = 0.95
"""Probability that a true error is within its bound."""

_QUICK = 1.0  # [s] within which thrust that changes moves nothing

# shares of a joint's limit of velocity that are kept, and while a fault is new
_PASSED = 1.02
_STRUCK = 1.2
_NEW = 0.5  # [s] that a fault is


# Series and scalars that several reports need.


@checked
def max_velocity_step(record: Record) -> float | None:
    """Largest change of any component of the command in one tick, from rest at the start; `None` of
    fewer rows than ticks.
    """
    if not keeps_every_tick(record):
        return None
    command = record["command"]
    steps = (
        np.abs(after - before).max(initial=0.0)
        for after, before in parts(command[1:], command[:-1])
    )
    return float(max((np.abs(command[:1]).max(initial=0.0), *steps)))


def none_if_nan(value: float | None) -> float | None:
    """The value [in its unit]; `None` for what is no number, such as an altitude without an
    echo.
    """
    if value is None or np.isnan(value):
        return None
    return value


def largest_or_none(values: np.ndarray | None) -> float | None:
    """Return the largest of the values (n,) [in their unit] that are finite; `None` where none
    is.
    """
    if values is None or np.isnan(values).all():
        return None
    return float(np.nanmax(values))


def extremes_of(record: Record, name: str) -> tuple[str, ...]:
    """Return the names of the series that have the least and largest values of one: its own, where
    every tick has a row.
    """
    names = (f"{name}_least", f"{name}_most")
    if names[0] in record.series:
        return names
    return (name,)


def least_altimeter_range(record: Record) -> float | None:
    """Return the smallest range [m] of the altimeter in any tick; `None` without an echo."""
    ranges = record[extremes_of(record, "altimeter_range")[0]]
    echoes = ranges[np.isfinite(ranges)]
    if echoes.size:
        return float(echoes.min())
    return None


def mean_sizes(record: Record, name: str, index: Any) -> np.ndarray:
    """Return mean sizes of a series since the row before, at an index of it."""
    return np.abs(record[f"{name}_mean" if f"{name}_mean" in record.series else name][index])


def failed_ticks(record: Record) -> dict[str, int] | None:
    """Count the ticks that the solver did not solve exactly, by its status; `None` where some
    failed and not every tick has a row.
    """
    codes, counts = np.unique(record["status"], return_counts=True)
    names = [record.run_meta.statuses[code] for code in codes]
    failed = {
        name: int(count)
        for name, count in zip(names, counts, strict=True)
        if name not in _EXACT_STATUSES
    }
    if failed and not keeps_every_tick(record):
        return None
    return failed


def largest_tilt(record: Record) -> float | None:
    """Return the largest tilt [rad] while a task on it is on, `None` where it never is; without
    such a task the vehicle's.
    """
    meta = record.run_meta
    (*_, largest_series) = extremes_of(record, "quantities")
    tilts = [
        (k, quantity(record, f"{task.name}.tilt", largest_series))
        for k, task in enumerate(meta.tasks)
    ]
    on = [
        np.where(record["activations"][:, k] > 0.0, tilt, np.nan)
        for k, tilt in tilts
        if tilt is not None
    ]
    if not on and meta.floating:
        roll, pitch = tilts_of(record["q"]).values()
        on = [np.arccos(np.cos(roll) * np.cos(pitch))]
    return max(
        (value for series in on if (value := largest_or_none(series)) is not None), default=None
    )


def quantities_at(record: Record, t: float) -> dict[str, float]:
    """All quantities [in their units] at time t [s], as estimated."""
    row = record["quantities"][min(int(np.searchsorted(record["t"], t - 1e-9)), len(record) - 1)]
    return dict(zip(record.meta.quantities, row.tolist(), strict=True))


def swings(record: Record) -> list[Swing]:
    """Return what swings at the end of a run, as `swings_among`: errors that the last phase waits
    for, roll and pitch.

    Raises `InvalidInput` for a plan's record.
    """
    meta = record.run_meta
    window = max(0, len(record) - round(WINDOW / meta.dt))
    since = max(window, int(np.argmax(record["phase"] == record["phase"][-1])))
    phase = meta.phases[int(record["phase"][-1])].name
    waited = [
        (item, quantity(record, item.quantity))
        for item in meta.thresholds
        if item.phase == phase and item.sign == "<"
    ]
    errors = {
        item.quantity: (series[since:], item.limit) for item, series in waited if series is not None
    }
    return list(
        swings_among(errors, tilts_of(record["q"][window:]) if meta.floating else {}, meta.dt)
    )


# What the estimator got wrong, beside what it said of itself.


def error_bound(record: Record, quantity: str) -> float | None:
    """Bound a true distance or angle at the end [m] or [rad] with probability `CHANCE`.

    By the estimate alone: its value there, and the covariance of its error, taken for the same in
    all three axes. `None` where the estimator gave no covariance.
    """
    spread = record.run_meta.spread(quantity)
    measured = quantities_at(record, float(record["t"][-1])).get(quantity)
    if spread is None or measured is None or not np.isfinite([spread, measured]).all():
        return None
    return norm_bound(measured, spread)


def norm_bound(measured: float, spread: float) -> float:
    """Bound the norm of three numbers [m or rad] with probability `CHANCE`.

    Mean and variance of its square are those of a multiple of chi-squared [Patnaik1949]. measured
    [m or rad]: the norm of their means. spread [m or rad]: root of the sum of their variances,
    which are alike.
    """
    if spread == 0.0:
        return measured
    from scipy.special import gammaincinv  # a tenth of a second

    variance = spread**2 / 3.0
    # of the square; half its variance
    mean = spread**2 + measured**2
    half = variance * (3.0 * variance + 2.0 * measured**2)
    return float(
        np.sqrt(half / mean * 2.0 * gammaincinv(0.5 * mean**2 / half, CHANCE))
    )  # by chi squared


def estimate_table(record: Record) -> list[dict[str, Any]]:
    """Rows ``position`` [m], ``attitude`` [rad], ``joints`` that turn [rad] and ``sliding joints``
    [m]; none with ideal sensors.

    ``rms`` error of an axis over the second half of the run, ``spread``: the standard deviation
    that the filter gave, also root mean square, and ``ratio`` of their squares, which is 1 where
    the process model holds, and None where the spread is 0. No rows in older records.
    """
    if not {"q_estimated", "q_std"} <= record.series.keys():
        return []
    q, measured, spread = (
        record[name][len(record) // 2 :] for name in ("q", "q_estimated", "q_std")
    )
    floating = record.run_meta.floating
    errors = joint_errors({"q": q, "q_estimated": measured}, record.meta)
    n = 0 if errors is None else errors.shape[1]
    if n:
        slides = _slides(record.run_meta)
    else:
        slides = np.zeros(0, dtype=bool)
    kinds = {"joints": ~slides, "sliding joints": slides}
    rows = [
        _row(name, errors[:, of], spread[:, -n:][:, of]) for name, of in kinds.items() if of.any()
    ]
    if not floating:
        return rows
    # The distance of two quaternions is half the angle between them; their signs do not matter.
    signs = np.sign((q[:, 3:7] * measured[:, 3:7]).sum(axis=1, keepdims=True))
    turns = (
        2.0
        * np.linalg.norm(signs * measured[:, 3:7] - q[:, 3:7], axis=1, keepdims=True)
        / np.sqrt(3.0)
    )
    return [
        _row("position", (measured - q)[:, :3], spread[:, :3]),
        _row("attitude", turns, spread[:, 3:6]),
        *rows,
    ]


def _row(name: str, errors: np.ndarray, spreads: np.ndarray) -> dict[str, Any]:
    error, spread = (float(np.sqrt(np.mean(values**2))) for values in (errors, spreads))
    return {
        "of": name,
        "rms": error,
        "spread": spread,
        "ratio": (error / spread) ** 2 if spread else None,
    }


# Resource allocation: what each phase takes in time, energy, thrust and room to the limits.


@checked
def resources(record: Record) -> TableRows:
    """One row per visit to a phase, in order of time, and a last row ``total``: `phase` and
    `figures_between`.

    Raises `InvalidInput` for the record of a plan.
    """
    t = record["t"]
    meta = record.run_meta
    ends = [*(event.t for event in meta.events), float(t[-1])]
    names = [meta.phases[0].name, *(event.target for event in meta.events)]
    spans = [
        span
        for span in zip(names, [0.0, *ends], ends, strict=False)
        if span[0] not in (ABORT, DONE)
    ]
    rows = [{"phase": name, **figures_between(record, start, end)} for name, start, end in spans]
    return TableRows([*rows, {"phase": "total", **figures_between(record, 0.0, float(t[-1]))}])


def repeated_phases(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """One row per phase of a mission that repeats itself, else none: number of visits, and mean and
    largest of a visit.

    rows: of `resources`, of which duration [s], energy [J] and path of the vehicle [m] are summed
    up; None where they are not known. A mission repeats itself that is more than twice in its
    phases on average.
    """
    visits: dict[str, list[dict[str, Any]]] = {}
    for row in rows[:-1]:
        visits.setdefault(row["phase"], []).append(row)
    return [
        _repeated(name, phase_visits)
        for name, phase_visits in visits.items()
        if len(rows) > 2 * len(visits) + 1
    ]


def _repeated(name: str, rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    row: dict[str, Any] = {"phase": name, "visits": len(rows)}
    for figure in ("duration_s", "energy_j", "path_length_m"):
        values = [row[figure] for row in rows if row[figure] is not None]
        row |= {
            f"mean_{figure}": float(np.mean(values)) if values else None,
            f"largest_{figure}": max(values, default=None),
        }
    return row


def figures_between(record: Record, start: float, end: float) -> dict[str, Any]:
    """Energy and peaks from `start` to `end` [s]; `None` where plant or robot file do not give
    them.

    Path of the vehicle and of the joints, energy of thrusters and joints, peak thrust, time with
    thrusters at their limits, least distance of a joint to its limits, largest velocity and torque
    in units of their limits.
    """
    first_row, last_row = (int(np.searchsorted(record["t"], t - 1e-9)) for t in (start, end))
    rows = slice(first_row, min(last_row, len(record) - 1) + 1)
    limits = record.meta.limits
    spans = np.diff(record["t"][rows])
    # Means are of the span before their row.
    if keeps_every_tick(record):
        mean_rows = slice(None, -1)
    else:
        mean_rows = slice(1, None)
    thrusters = _gain(record, "thruster_energy", rows)
    joints = _gain(record, "joint_energy", rows)
    meta = record.run_meta
    of_joints = rows, slice(VEHICLE_V if meta.floating else 0, None)
    if "saturated" in record.series:
        saturated = mean_sizes(record, "saturated", rows)
    else:
        saturated = None
    return {
        "duration_s": end - start,
        "path_length_m": path_length(record["q"][rows, :3]) if meta.floating else 0.0,
        **_by_kind(
            meta, "joint_path", spans @ mean_sizes(record, "v", of_joints)[mean_rows], np.sum
        ),
        "thruster_energy_j": thrusters,
        "joint_energy_j": joints,
        "energy_j": None if thrusters is None or joints is None else thrusters + joints,
        "peak_thrust_n": largest_thrust(record, rows),
        "saturation_time_s": None if saturated is None else float(spans @ saturated[mean_rows]),
        **_by_kind(
            meta, "joint_margin", _joint_margins(record, rows), partial(np.min, initial=np.inf)
        ),
        "velocity_share": _share(record, "v", None if limits is None else limits.velocity, rows),
        "torque_share": _share(record, "torque", None if limits is None else limits.effort, rows),
    }


def energy_of_quick_thrust(record: Record) -> float | None:
    """Energy [J] that thrusters took above what their thrust, averaged over a second, would have
    taken: mostly of noise.

    Power grows faster than thrust. `None` where the record is shorter, has fewer rows than ticks,
    or no energy of thrusters.
    """
    dt = record.run_meta.dt
    width = round(_QUICK / record.run_meta.dt)
    ticks = {"thrust", "thruster_energy"} <= record.series.keys() and keeps_every_tick(record)
    if not ticks or not 2 < width < len(record):
        return None
    thrusts = record["thrust"]
    energies = record["thruster_energy"]
    excess = 0.0
    if thrusts.ndim != 2 or thrusts.shape != energies.shape:  # of another's file
        return None
    for thrust, energy in zip(thrusts.T, energies.T, strict=True):
        power = np.diff(energy) / dt
        thrust = (thrust[1:] + thrust[:-1]) / 2.0
        order = np.argsort(thrust)
        sums = np.cumsum(np.pad(thrust, (width // 2 + 1, (width - 1) // 2), "edge"))
        steady = np.interp((sums[width:] - sums[:-width]) / width, thrust[order], power[order])
        excess += dt * float(np.sum(power - steady))
    if np.isfinite(excess):
        return excess
    return None


def passed_rates(record: Record) -> list[dict[str, Any]]:
    """One row per joint whose true velocity passed its limit by more than 2 %, 20 % where a fault
    is new: the largest.

    joint, t [s], rate and limit [unit], which is rad/s or m/s, and the share of the limit.
    """
    meta = record.run_meta
    limits = record.meta.limits
    if limits is None:
        return []
    first_joint = VEHICLE_V if meta.floating else 0
    rates = np.max(
        [np.abs(record[name][:, first_joint:]) for name in extremes_of(record, "v")], axis=0
    )
    bounds = np.array(limits.velocity[first_joint:])
    t = record["t"]
    struck = np.zeros(len(t), dtype=bool)
    for fault in meta.faults:
        for moment in (fault.t, fault.end):
            struck |= False if moment is None else (t >= moment) & (t <= moment + _NEW)
    over = rates - bounds * np.where(struck, _STRUCK, _PASSED)[:, None]
    worst = over.argmax(axis=0)
    joints = np.arange(len(bounds))
    names: Sequence[str]
    if len(meta.joints) == len(bounds):
        names = meta.joints
    else:
        names = [f"axis {j + 1}" for j in joints]
    units = column_units("v", record["v"].shape[1], meta)[first_joint:]
    return [
        {
            "joint": names[j],
            "t": float(t[worst[j]]),
            "rate": float(rates[worst[j], j]),
            "unit": units[j],
            "limit": float(bounds[j]),
            "share": float(rates[worst[j], j] / bounds[j]),
        }
        for j in np.flatnonzero((over[worst, joints] > 0.0) & (bounds > 0.0)).tolist()
    ]


def _gain(record: Record, name: str, rows: slice) -> float | None:
    """Increase of a running total; of thrusters only where the power of each is known."""
    if name not in record.series:
        return None
    if record[name].ndim == 1:
        total = record[name]
    else:
        total = record[name].sum(axis=1)
    gain = float(total[rows.stop - 1] - total[rows.start])
    if np.isnan(gain):
        return None
    return gain


def path_length(points: np.ndarray) -> float:
    """Length [m] of a path through points (n, 3) [m]."""
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def largest_thrust(record: Record, rows: slice = slice(None)) -> float | None:
    """Largest thrust [N] of any thruster in these rows; `None` where there is none."""
    if "thrust" not in record.series:
        return None
    return max(
        float(np.abs(record[name][rows]).max(initial=0.0)) for name in extremes_of(record, "thrust")
    )


def _by_kind(
    meta: RunMeta, name: str, values: np.ndarray, of: Callable[[np.ndarray], float]
) -> dict[str, float | None]:
    """A figure of the joints that turn, and in m of those that slide, if there are any; values
    (n_joints,), or (0,).
    """
    slides = _slides(meta)
    if slides.any() and len(values) == len(slides):
        chosen = {"rad": values[~slides], "m": values[slides]}
    else:
        chosen = {"rad": values}
    figures = {unit: float(of(joint_values)) for unit, joint_values in chosen.items()}
    return {
        f"{name}_{unit}": value if np.isfinite(value) else None for unit, value in figures.items()
    }


def _slides(meta: RunMeta) -> np.ndarray:
    """Whether each joint (n_joints,) does; none in older records, which do not say."""
    return np.array([joint in (meta.sliding or ()) for joint in meta.joints], dtype=bool)


def _joint_margins(record: Record, rows: slice) -> np.ndarray:
    """Least distance of each joint (n_joints,) [rad or m] from its limits; none where nobody
    knows.
    """
    meta = record.run_meta
    if meta.limits is None or joint_positions({"q": record["q"][:1]}, meta) is None:
        return np.empty(0)
    lower = np.array(meta.limits.position_lower)
    upper = np.array(meta.limits.position_upper)
    minima = [np.full(lower.shape, np.inf)]
    for q in (record[name][rows] for name in extremes_of(record, "q")):
        samples = (
            joint_positions({"q": part}, meta)
            for (part,) in parts(q, rows=len(q) if meta.endless else 0)
        )  # turns count
        minima += [
            np.minimum(positions - lower, upper - positions).min(axis=0) for positions in samples
        ]
    return np.min(minima, axis=0)


def _share(
    record: Record, name: str, limits: tuple[float, ...] | None, rows: slice
) -> float | None:
    """Return the largest value in units of its limit; what may not move at all has no unit."""
    if name not in record.series or limits is None:
        return None
    bounds = np.array(limits)
    limited = bounds > 0.0
    with np.errstate(over="ignore"):  # a limit may be as small as it likes
        largest_shares = []
        for series_name in extremes_of(record, name):
            for (part,) in parts(record[series_name][rows]):
                shares = np.abs(part[:, limited]) / bounds[limited]
                largest_shares.append(shares.max(initial=0.0))
        return float(max(largest_shares, default=0.0))
