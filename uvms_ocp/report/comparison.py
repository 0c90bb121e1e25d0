"""Compare runs or plans, and the smoothness of phase changes of several runs."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from uvms_ocp.checks import checked
from uvms_ocp.errors import InvalidInput
from uvms_ocp.ocp.plan import Plan
from uvms_ocp.record.display import TableRows
from uvms_ocp.record.record import Record, require_every_tick
from uvms_ocp.record.run_meta import level_rows
from uvms_ocp.report import metrics, phase_resources

WINDOW = 1.0  # [s] after a phase change that belongs to it

_NOT_ABOVE = (",AD]", ",O]")  # labels of actions and of what is optimised


@checked
def compare(
    first: Record | Plan | Mapping[str, Record | Plan], second: Record | Plan | None = None
) -> TableRows:
    """Return a row for each figure, with the values of all runs or of all plans.

    Either two, whose columns are ``first``, ``second``, or any number by name, such as
    ``compare({"strict": a, "iCAT": b})``, whose columns are those names. Beside them is ``change``
    [%] from the first to the second, or ``change of NAME`` for each of more; `None` where one lacks
    the figure. Raises `InvalidInput` for fewer than two, for a run against a plan, and for a name
    that is a column's.
    """
    records = _named_records(first, second)
    figures_of = {name: dict(_figures(record)) for name, record in records.items()}
    reference, *others = figures_of.values()
    if len(others) == 1:
        change_names = ["change"]
    else:
        change_names = [f"change of {name}" for name in list(records)[1:]]
    rows = []
    for figure in dict.fromkeys(itertools.chain(*figures_of.values())):
        row: dict[str, Any] = {"figure": figure}
        row |= {name: figures.get(figure) for name, figures in figures_of.items()}
        for name, figures in zip(change_names, others, strict=True):
            row[name] = _change(reference.get(figure), figures.get(figure))
        rows.append(row)
    return TableRows(rows)


def _named_records(
    first: Record | Plan | Mapping[str, Record | Plan], second: Record | Plan | None
) -> dict[str, Record]:
    """Return the records that are compared, by the names of their columns."""
    if isinstance(first, Mapping):
        if second is not None:
            raise InvalidInput(
                f"first = {len(first)} runs by name, and second beside them; give all of them by name"
            )
        compared = dict(first)
    elif second is None:
        raise InvalidInput("second = None; give two, or several by name: {'strict': a, 'iCAT': b}")
    else:
        compared = {"first": first, "second": second}
    if len(compared) < 2:
        raise InvalidInput(f"{len(compared)} runs by name; give two or more")
    records = dict[str, Record]()
    for name, motion in compared.items():
        is_column = name.partition(" ")[0] in ("figure", "change")
        if is_column:
            raise InvalidInput(f"a run is called {name!r}, as a column is; give another name")
        if isinstance(motion, Record):
            records[name] = motion
        else:
            records[name] = motion.to_record()
    (reference_name, reference), *others = records.items()
    for name, record in others:
        if record.meta.kind != reference.meta.kind:
            raise InvalidInput(
                f"{reference_name} is a {reference.meta.kind}, {name} a {record.meta.kind};"
                " give runs alone or plans alone"
            )
    return records


def _figures(record: Record) -> Iterator[tuple[str, Any]]:
    """Yield names and values of the figures by which runs, or plans, are compared."""
    if record.meta.kind == "run":
        return _run_figures(record)
    return _plan_figures(record)


def _run_figures(record: Record) -> Iterator[tuple[str, Any]]:
    """Yield names and values of the figures by which runs are compared."""
    meta = record.run_meta
    tool_error = f"{meta.tool_task}.position_error"
    resources = phase_resources.resources(record)
    yield "completed", meta.completed
    yield "phases", " ".join(row["phase"] for row in resources[:-1])
    for name, value in resources[-1].items():
        if name != "phase":
            yield name, value
    yield "tool_position_error_m", metrics.none_if_nan(meta.true_quantity(tool_error))
    estimated = metrics.quantities_at(record, float(record["t"][-1]))
    yield "estimated_tool_position_error_m", metrics.none_if_nan(estimated.get(tool_error))
    yield "tool_position_bound_m", metrics.error_bound(record, tool_error)
    yield "sensors_allow_tool_position_m", meta.allowance.get(tool_error)
    yield "largest_tilt_rad", metrics.largest_tilt(record)
    yield "max_velocity_step", metrics.max_velocity_step(record)


def _plan_figures(record: Record) -> Iterator[tuple[str, Any]]:
    """Yield names and values of the figures by which plans are compared."""
    yield "plan", record.meta.scenario
    yield "duration_s", float(record["t"][-1] - record["t"][0])
    axes = [i for i, name in enumerate(record.plan_meta.axes) if name in ("x", "y", "z")]
    yield "path_length_m", phase_resources.path_length(record["x"][:, axes])
    thruster_energy = _total(record, "thruster_energy")
    joint_energy = _total(record, "joint_energy")
    yield "thruster_energy_j", thruster_energy
    yield "joint_energy_j", joint_energy
    if thruster_energy is None or joint_energy is None:
        yield "energy_j", None
    else:
        yield "energy_j", thruster_energy + joint_energy
    yield "peak_thrust_n", phase_resources.largest_thrust(record)
    nearest = record.plan_meta.min_clearance
    if nearest is None:
        yield "min_clearance_m", None
    else:
        yield "min_clearance_m", nearest.distance


def _total(record: Record, name: str) -> float | None:
    """Return the sum of the last row of a running total; `None` where it is not known."""
    if name not in record.series:
        return None
    return metrics.none_if_nan(float(np.sum(record[name][-1])))


def _change(before: Any, after: Any) -> float | None:
    """Return the change [%] between two numbers; `None` where there is none to tell."""
    if isinstance(before, (bool, str)) or before is None or after is None or before == 0:
        return None
    return 100.0 * (after - before) / abs(before)


@checked
def transition_series(record: Record) -> dict[str, np.ndarray]:
    """Return series over time ``t`` (n,) [s] of the commanded velocity, and the times ``changes``
    (k,) [s] of phase changes.

    ``step`` (n,): largest change of any axis since the tick before, as a share of its acceleration
    limit times dt. ``jerk`` (n,) [m/s3, rad/s3]: largest second difference of any axis. ``lost``
    (n,) [m/s, rad/s]: largest norm, over the tasks that are fully on and of a class above the
    actions, of what the task misses of the rate that the acceleration limits let it reach. Raises
    `InvalidInput` for a plan, without limits, or with fewer rows than ticks.
    """
    if record.meta.limits is None:
        raise InvalidInput(
            "this record tells no limits; shares of the acceleration limits need them"
        )
    dt = require_every_tick(record).dt
    limits = np.array(record.meta.limits.acceleration)
    limited = limits > 0.0  # what may not move at all has no share
    change = np.diff(record["command"], axis=0, prepend=0.0)
    second_change = np.diff(change, axis=0, prepend=0.0)
    step_shares = np.abs(change[:, limited]) / dt / limits[limited]
    starts = np.flatnonzero(np.diff(record["phase"])) + 1
    return {
        "t": record["t"],
        "step": step_shares.max(axis=1, initial=0.0),
        "jerk": np.abs(second_change).max(axis=1, initial=0.0) / dt**2,
        "lost": _lost_rates(record),
        "changes": record["t"][starts],
    }


@checked
def transition_table(records: Mapping[str, Record]) -> list[dict[str, Any]]:
    """Return one row per run and phase change, and one per run for all ticks: largest step, jerk
    and loss, root mean square jerk.

    A change lasts `WINDOW`; its time, like that of the whole run, is in the column ``t_s``.
    """
    rows = list[dict[str, Any]]()
    for name, record in records.items():
        rows += _transition_rows(name, record)
    return rows


def _transition_rows(run: str, record: Record) -> Iterator[dict[str, Any]]:
    series = transition_series(record)
    t = series["t"]
    phase = record["phase"]
    names = [phase_meta.name for phase_meta in record.meta.phases]
    for change in series["changes"].tolist():
        in_window = (t >= change) & (t < change + WINDOW)
        first_row = int(np.argmax(in_window))
        label = f"{names[phase[first_row - 1]]}-{names[phase[first_row]]}"
        yield _transition_row(run, label, change, series, in_window)
    yield _transition_row(run, "all", float(t[-1]), series, np.full(len(t), True))


def _transition_row(
    run: str, label: str, time: float, series: Mapping[str, np.ndarray], rows: np.ndarray
) -> dict[str, Any]:
    """Sum up the series of `transition_series` over some rows."""
    jerk = series["jerk"][rows]
    return {
        "run": run,
        "change": label,
        "t_s": time,
        "step": float(series["step"][rows].max()),
        "jerk": float(jerk.max()),
        "jerk_rms": float(np.sqrt(np.mean(jerk**2))),
        "lost": float(series["lost"][rows].max()),
    }


def _lost_rates(record: Record) -> np.ndarray:
    """Return, for each tick, the largest norm [m/s, rad/s] of the rates that tasks above the
    actions miss while they are fully on.
    """
    columns = {}
    for column, task in enumerate(record.meta.tasks):
        if not task.label.endswith(_NOT_ABOVE):
            columns[task.name] = column
    lost = np.zeros(len(record))
    for name, rows in level_rows(record.meta):
        if name not in columns:
            continue
        is_on = record["activations"][:, columns[name]] >= 1.0
        missed = np.linalg.norm(record["residual"][:, rows], axis=1)
        lost = np.maximum(lost, np.where(is_on, missed, 0.0))
    return lost
