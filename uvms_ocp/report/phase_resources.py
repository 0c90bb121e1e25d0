"""Resources that each phase of a run takes: time, energy, thrust, and distances to the limits."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from uvms_ocp.checks import checked
from uvms_ocp.record.display import TableRows
from uvms_ocp.record.meta_values import ABORT, DONE
from uvms_ocp.record.record import Record, keeps_every_tick
from uvms_ocp.record.row_files import parts
from uvms_ocp.record.run_meta import VEHICLE_V, RunMeta, joint_positions
from uvms_ocp.report import metrics

_QUICK = 1.0  # [s] within which thrust that changes moves nothing


@checked
def resources(record: Record) -> TableRows:
    """Return one row per visit to a phase, in order of time, and a last row ``total``: `phase` and
    `figures_between`.

    Raises `InvalidInput` for the record of a plan.
    """
    meta = record.run_meta
    last_time = float(record["t"][-1])
    names = [meta.phases[0].name, *(event.target for event in meta.events)]
    changes = [event.t for event in meta.events]
    spans = zip(names, [0.0, *changes, last_time], [*changes, last_time], strict=False)
    rows = []
    for name, start, end in spans:
        if name not in (ABORT, DONE):
            rows.append({"phase": name, **figures_between(record, start, end)})
    rows.append({"phase": "total", **figures_between(record, 0.0, last_time)})
    return TableRows(rows)


def repeated_phases(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return one row per phase of a mission that repeats itself, else none: number of visits, and
    mean and largest of a visit.

    rows: of `resources`, of which duration [s], energy [J] and path of the vehicle [m] are summed
    up; None where they are not known. A mission repeats itself that is more than twice in its
    phases on average.
    """
    visits: dict[str, list[dict[str, Any]]] = {}
    for row in rows[:-1]:
        visits.setdefault(row["phase"], []).append(row)
    n_visits = len(rows) - 1
    if n_visits <= 2 * len(visits):
        return []
    return [_repeated(name, phase_visits) for name, phase_visits in visits.items()]


def _repeated(name: str, rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return the row of a phase, from the rows of its visits."""
    row: dict[str, Any] = {"phase": name, "visits": len(rows)}
    for figure in ("duration_s", "energy_j", "path_length_m"):
        values = [row[figure] for row in rows if row[figure] is not None]
        mean = None
        if values:
            mean = float(np.mean(values))
        row[f"mean_{figure}"] = mean
        row[f"largest_{figure}"] = max(values, default=None)
    return row


def figures_between(record: Record, start: float, end: float) -> dict[str, Any]:
    """Return energy and peaks from `start` to `end` [s]; `None` where plant or robot file do not
    give them.

    Path of the vehicle and of the joints, energy of thrusters and joints, peak thrust, time with
    thrusters at their limits, least distance of a joint to its limits, largest velocity and torque
    in units of their limits.
    """
    meta = record.run_meta
    t = record["t"]
    first_row = int(np.searchsorted(t, start - 1e-9))
    last_row = min(int(np.searchsorted(t, end - 1e-9)), len(record) - 1)
    rows = slice(first_row, last_row + 1)
    spans = np.diff(t[rows])  # [s] between the rows
    # Means of thinned rows are of the span before their row.
    if keeps_every_tick(record):
        span_rows = slice(None, -1)
    else:
        span_rows = slice(1, None)
    length = 0.0
    joint_columns = slice(None)
    if meta.floating:
        length = path_length(record["q"][rows, :3])
        joint_columns = slice(VEHICLE_V, None)
    joint_paths = spans @ metrics.mean_sizes(record, "v", (rows, joint_columns))[span_rows]
    thruster_energy = _gain(record, "thruster_energy", rows)
    joint_energy = _gain(record, "joint_energy", rows)
    if thruster_energy is None or joint_energy is None:
        energy = None
    else:
        energy = thruster_energy + joint_energy
    if "saturated" in record.series:
        saturated = metrics.mean_sizes(record, "saturated", rows)
        saturation_time = float(spans @ saturated[span_rows])
    else:
        saturation_time = None
    if record.meta.limits is None:
        rate_limits = effort_limits = None
    else:
        rate_limits = record.meta.limits.velocity
        effort_limits = record.meta.limits.effort
    smallest = partial(np.min, initial=np.inf)
    return {
        "duration_s": end - start,
        "path_length_m": length,
        **_by_kind(meta, "joint_path", joint_paths, np.sum),
        "thruster_energy_j": thruster_energy,
        "joint_energy_j": joint_energy,
        "energy_j": energy,
        "peak_thrust_n": largest_thrust(record, rows),
        "saturation_time_s": saturation_time,
        **_by_kind(meta, "joint_margin", _joint_margins(record, rows), smallest),
        "velocity_share": _share(record, "v", rate_limits, rows),
        "torque_share": _share(record, "torque", effort_limits, rows),
    }


def energy_of_quick_thrust(record: Record) -> float | None:
    """Return the energy [J] that thrusters took above what their thrust, averaged over a second,
    would have taken: mostly of noise.

    Power grows faster than thrust. `None` where the record is shorter, has fewer rows than ticks,
    or no energy of thrusters.
    """
    if not {"thrust", "thruster_energy"} <= record.series.keys() or not keeps_every_tick(record):
        return None
    dt = record.run_meta.dt
    width = round(_QUICK / dt)  # ticks of the average
    if not 2 < width < len(record):
        return None
    thrusts = record["thrust"]
    energies = record["thruster_energy"]
    if thrusts.ndim != 2 or thrusts.shape != energies.shape:  # a file of other programs
        return None
    excess = 0.0
    for thrust, energy in zip(thrusts.T, energies.T, strict=True):
        excess += _quick_energy(thrust, energy, width, dt)
    if np.isfinite(excess):
        return excess
    return None


def _quick_energy(thrust: np.ndarray, energy: np.ndarray, width: int, dt: float) -> float:
    """Return the energy [J] that a thruster took above what its thrust (n,) [N], averaged over
    `width` ticks, would have taken.

    energy: (n,) [J] that it took so far. What power a thrust takes is interpolated in the run.
    """
    power = np.diff(energy) / dt
    mean_thrust = (thrust[1:] + thrust[:-1]) / 2.0
    order = np.argsort(mean_thrust)
    padded = np.pad(mean_thrust, (width // 2 + 1, (width - 1) // 2), "edge")
    sums = np.cumsum(padded)
    steady_thrust = (sums[width:] - sums[:-width]) / width
    steady_power = np.interp(steady_thrust, mean_thrust[order], power[order])
    return dt * float(np.sum(power - steady_power))


def _gain(record: Record, name: str, rows: slice) -> float | None:
    """Return how much a running total grew; of thrusters only where the power of each is known."""
    if name not in record.series:
        return None
    total = record[name]
    if total.ndim > 1:
        total = total.sum(axis=1)
    gain = float(total[rows.stop - 1] - total[rows.start])
    if np.isnan(gain):
        return None
    return gain


def path_length(points: np.ndarray) -> float:
    """Return the length [m] of a path through points (n, 3) [m]."""
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def largest_thrust(record: Record, rows: slice = slice(None)) -> float | None:
    """Return the largest thrust [N] of any thruster in these rows; `None` without thrusters."""
    if "thrust" not in record.series:
        return None
    extremes = metrics.extremes_of(record, "thrust")
    return max(float(np.abs(record[name][rows]).max(initial=0.0)) for name in extremes)


def _by_kind(
    meta: RunMeta, name: str, values: np.ndarray, reduce: Callable[[np.ndarray], float]
) -> dict[str, float | None]:
    """Return a figure of the joints that turn, and one in m of those that slide, if there are any.

    values: (n_joints,), or (0,) where they are not known. reduce: makes one figure of the joints'.
    """
    slides = metrics.sliding_joints(meta)
    if slides.any() and len(values) == len(slides):
        chosen = {"rad": values[~slides], "m": values[slides]}
    else:
        chosen = {"rad": values}
    figures = dict[str, float | None]()
    for unit, joint_values in chosen.items():
        figure = float(reduce(joint_values))
        figures[f"{name}_{unit}"] = figure if np.isfinite(figure) else None
    return figures


def _joint_margins(record: Record, rows: slice) -> np.ndarray:
    """Return the least distance of each joint (n_joints,) [rad or m] from its limits; (0,) where it
    is not known.
    """
    meta = record.run_meta
    if meta.limits is None or joint_positions({"q": record["q"][:1]}, meta) is None:
        return np.empty(0)
    lower = np.array(meta.limits.position_lower)
    upper = np.array(meta.limits.position_upper)
    margins = np.full(lower.shape, np.inf)
    for name in metrics.extremes_of(record, "q"):
        q = record[name][rows]
        # Turns of endless joints are counted from row to row: they need all rows at once.
        n_rows = len(q) if meta.endless else 0
        for (part,) in parts(q, rows=n_rows):
            positions = joint_positions({"q": part}, meta)
            distances = np.minimum(positions - lower, upper - positions).min(axis=0)
            margins = np.minimum(margins, distances)
    return margins


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
        for series_name in metrics.extremes_of(record, name):
            for (part,) in parts(record[series_name][rows]):
                shares = np.abs(part[:, limited]) / bounds[limited]
                largest_shares.append(shares.max(initial=0.0))
    return float(max(largest_shares, default=0.0))
