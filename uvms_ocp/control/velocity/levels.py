"""From tasks to the levels of one tick: a CasADi Function that stacks limits, tasks, easing and minimum velocity."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import takewhile
from typing import NamedTuple

import casadi as ca
import numpy as np

from uvms_ocp.arguments import Period, checked
from uvms_ocp.control.velocity.easing import easing_rows
from uvms_ocp.control.velocity.reachable_rows import reachable_rows
from uvms_ocp.model.limits import bounded_joints
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.symbolic.tree import SymbolicModel
from uvms_ocp.tasks.hierarchy import Hierarchy
from uvms_ocp.tasks.limits import stopping_speed
from uvms_ocp.tasks.task import Rows, Task, TaskClass, TickSymbols, equality_rows

LIMITS, EASING, REST = "limits", "easing", "rest"
"""Names of the levels that every hierarchy has: the first, the one below the tasks that keep the robot safe, the last."""
_INPUTS = ("q", "velocity", "previous", "change", "altimeter_range", "parameters", "gates")


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class LevelsProblem:
    """The levels of a tick, ready for a solver's ``bind``."""

    function: ca.Function
    """(q, velocity, previous, change, altimeter_range, parameters, gates) ->
    (J, lower, upper, rate, activation, gate, quantities, activity), rows of all levels stacked; `previous` is the velocity
    commanded one tick before, `change` its difference from that of the tick before it; the parameters are those of all tasks,
    one after the other (`uvms_ocp.control.velocity.parameters`). The gate is 0 or 1: what lies between is in the bounds."""
    names: tuple[str, ...]
    """Of the levels."""
    sizes: tuple[int, ...]
    """Rows of each level."""
    quantity_names: tuple[str, ...]
    """``task.quantity``, in the order of the output `quantities`."""
    rests_on: Mapping[str, np.ndarray]
    """(n_quantities,) [-] by channel of `Readings`: which of them it tells, and are unknown without it."""
    step: np.ndarray
    """(n_v,) [m/s, rad/s] largest change of each velocity in one tick; infinite where the acceleration has no limit."""


@checked
def build_levels(robot: Robot, hierarchy: Hierarchy, dt: Period) -> LevelsProblem:
    """Stack the velocity limits of `robot`, the tasks of `hierarchy` and minimum velocity, for control period dt [s].

    Raises `FrameNotFound` or `NameNotFound` where a task names a frame or joint that the robot does not have.
    """
    symbols = tick_symbols(robot, dt)
    previous, change = ca.SX.sym("previous", robot.n_v), ca.SX.sym("change", robot.n_v)
    parameters = ca.SX.sym("parameters", sum(task.n_parameters(robot) for task in hierarchy.tasks))
    gates = ca.SX.sym("gates", len(hierarchy.tasks))
    tasks = _task_rows(robot, hierarchy, symbols, parameters)
    wanted = [
        _Level(task.name, _reachable(task, rows, symbols, previous, gate), gate)
        for task, rows, gate in zip(hierarchy.tasks, tasks, ca.vertsplit(gates), strict=True)
    ]
    n_safe = len(list(takewhile(_is_safety, hierarchy.tasks)))
    levels = [
        _Level(LIMITS, _limit_rows(symbols, previous)),
        *wanted[:n_safe],
        _Level(EASING, easing_rows(symbols, previous, change)),
        *wanted[n_safe:],
        _Level(REST, _rest_rows(symbols, previous)),
    ]
    quantities = {
        f"{task.name}.{name}": value
        for task, rows in zip(hierarchy.tasks, tasks, strict=True)
        for name, value in rows.quantities.items()
    }
    inputs = [symbols.q, symbols.velocity, previous, change, symbols.altimeter_range, parameters, gates]
    outputs = _stacked(levels, quantities)
    return LevelsProblem(
        function=ca.Function("levels", inputs, [*outputs.values()], list(_INPUTS), [*outputs], {"cse": True}),
        names=tuple(level.name for level in levels),
        sizes=tuple(level.rows.n_rows for level in levels),
        quantity_names=tuple(quantities),
        rests_on=_rests_on(symbols, hierarchy.tasks, quantities),
        step=robot.limits.acceleration * dt,
    )


class _Level(NamedTuple):
    name: str
    rows: Rows
    gate: ca.SX = ca.SX(1)


def _is_safety(task: Task) -> bool:
    return task.task_class <= TaskClass.SAFETY


def _reachable(task: Task, rows: Rows, symbols: TickSymbols, previous: ca.SX, gate: ca.SX) -> Rows:
    """Bounds that keep the robot safe are followed as fast as the acceleration limits allow."""
    eased = task.equality or not _is_safety(task)
    return reachable_rows(rows, equality=task.equality, eased=eased, symbols=symbols, previous=previous, gate=gate)


def _stacked(levels: Sequence[_Level], quantities: dict[str, ca.SX]) -> dict[str, ca.SX]:
    """Dense outputs of the levels function; a gate between 0 and 1 is already part of the bounds."""
    gate = ca.vertcat(*(ca.repmat(level.gate, level.rows.n_rows, 1) for level in levels))
    rows = [level.rows for level in levels]
    activity = ca.vertcat(*(r.activation for r in rows)) * gate
    outputs = {
        "J": ca.vertcat(*(r.jacobian for r in rows)),
        "lower": ca.vertcat(*(r.lower for r in rows)),
        "upper": ca.vertcat(*(r.upper for r in rows)),
        "rate": ca.vertcat(*(r.rate for r in rows)),
        "activation": activity,
        "gate": gate > 0,
        "quantities": ca.vertcat(ca.SX(0, 1), *quantities.values()),
        "activity": activity,
    }
    return {name: ca.densify(value) for name, value in outputs.items()}


def _rests_on(symbols: TickSymbols, tasks: Sequence[Task], quantities: dict[str, ca.SX]) -> dict[str, np.ndarray]:
    """By channel, which quantities depend on it; what is measured of distances depends on the whole configuration."""
    robot, q, values = symbols.robot, symbols.q, ca.vertcat(ca.SX(0, 1), *quantities.values())
    measured = {task.name for task in tasks if task.nearest_pairs is not None}
    near = np.array([name.rpartition(".")[0] in measured for name in quantities], dtype=bool)
    n = 7 if robot.n_vehicle else 0
    of_q = {"position": q[: min(n, 3)], "attitude": q[min(n, 3) : n], "joint_positions": q[n:]}
    found = {name: _depends(values, part) | near for name, part in of_q.items()}
    return {**found, "altimeter_range": _depends(values, symbols.altimeter_range)}


def _depends(values: ca.SX, on: ca.SX) -> np.ndarray:
    """Which of the values (m,) depend on any of the symbols."""
    return np.array([bool(on.numel()) and ca.depends_on(value, on) for value in ca.vertsplit(values)], dtype=bool)


def tick_symbols(robot: Robot, dt: float) -> TickSymbols:
    """What tasks are written in, at a control period dt [s]."""
    q = ca.SX.sym("q", robot.n_q)
    return TickSymbols(
        robot=robot,
        kinematics=SymbolicModel(robot.model).forward_kinematics(q),
        q=q,
        velocity=ca.SX.sym("velocity", robot.n_v),
        altimeter_range=ca.SX.sym("altimeter_range"),
        dt=dt,
    )


def _task_rows(robot: Robot, hierarchy: Hierarchy, symbols: TickSymbols, parameters: ca.SX) -> list[Rows]:
    ends = np.cumsum([0, *(task.n_parameters(robot) for task in hierarchy.tasks)])
    return [
        task.rows(symbols, parameters[int(start) : int(end)])
        for task, start, end in zip(hierarchy.tasks, ends, ends[1:], strict=False)
    ]


def _limit_rows(symbols: TickSymbols, previous: ca.SX) -> Rows:
    """Velocity and position limits, reached no faster than the acceleration limits allow from the previous velocity.

    Joints keep a speed from which they can still stop before their limit. Not read by the regularised pseudo-inverse.
    """
    robot = symbols.robot
    reach = ca.DM(robot.limits.acceleration * symbols.dt)
    lower, upper = ca.SX(-robot.limits.velocity), ca.SX(robot.limits.velocity)
    for joint, q_lower, q_upper in bounded_joints(robot.joints, robot.limits):
        i, q = joint.idx_v, symbols.q[joint.idx_q]
        braking = {"deceleration": float(robot.limits.acceleration[i]), "dt": symbols.dt}
        lower[i] = ca.fmax(lower[i], -stopping_speed(q - q_lower, **braking))
        upper[i] = ca.fmin(upper[i], stopping_speed(q_upper - q, **braking))
    zeros = ca.SX.zeros(robot.n_v)
    return Rows(
        jacobian=ca.SX.eye(robot.n_v),
        rate=zeros,
        lower=ca.fmin(ca.fmax(lower, previous - reach), previous + reach),
        upper=ca.fmin(ca.fmax(upper, previous - reach), previous + reach),
        activation=zeros,
    )


def _rest_rows(symbols: TickSymbols, previous: ca.SX) -> Rows:
    """Minimise the remaining velocity ([Gao2022] Table 3, last row), coming to rest in proportion."""
    n_v = symbols.robot.n_v
    rows = equality_rows(ca.SX.eye(n_v), ca.SX.zeros(n_v))
    return reachable_rows(rows, equality=True, eased=True, symbols=symbols, previous=previous, gate=ca.SX(1))
