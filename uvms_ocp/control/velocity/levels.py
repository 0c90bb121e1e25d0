"""Build the levels of the hierarchy as one CasADi function: limits, tasks, jerk limits and minimum
velocity.

The acceleration limits alone let a velocity turn from full acceleration to full braking within one
tick, and a strict hierarchy does so wherever it pays. References are therefore approached with an
acceleration that falls to 0, and a level of its own bounds the jerk of each axis. That level is
below the tasks that keep the robot safe: braking for the sake of a limit is never eased.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import fields, replace
from functools import lru_cache
from itertools import takewhile
from numbers import Real
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from uvms_ocp.checks import checked, checked_dataclass, replace_with_symbols
from uvms_ocp.codegen.casadi_code import with_numbers
from uvms_ocp.control.velocity.jerk_limit import (
    jerk_limit_rows,
    unlimited_axes,
)
from uvms_ocp.control.velocity.reachable_rows import reachable_rows
from uvms_ocp.control.velocity.swing import (
    N_PASSIVE,
    countered_rows,
    lean_of,
    lean_rows,
    mean_attitude,
    swinging_axes,
)
from uvms_ocp.errors import InvalidInput, short
from uvms_ocp.record.meta_values import OWN_QUANTITIES
from uvms_ocp.robot import Robot, SymbolicModel, symbolic_bodies
from uvms_ocp.robot.limits import bounded_joints
from uvms_ocp.tasks.approach_speed import stopping_speed
from uvms_ocp.tasks.hierarchy import Hierarchy
from uvms_ocp.tasks.task import Rows, Task, TaskClass, TickSymbols, equality_rows
from uvms_ocp.types import Keyed, Period

LIMITS = "limits"
JERK_LIMIT = "easing"
REST = "rest"
LEAN = "lean"
"""Names of levels beside tasks: the limits on top, the jerk limits below the tasks that keep the
robot safe, minimum velocity at the bottom, and, where a vehicle swings, `lean_rows` above the jerk
limits.
"""
_SPEED = "vehicle.speed"
_AS_PARAMETERS = ("goal", "model")
"""Fields of tasks that rows read as parameters."""
_INPUTS = (
    "q",
    "velocity",
    "passive",
    "previous",
    "change",
    "altimeter_range",
    "parameters",
    "gates",
    "numbers",
)


@checked_dataclass(eq=False)
class LevelsProblem:
    """The levels of a tick, ready for a solver's ``bind``."""

    function: ca.Function
    """(q, velocity, passive, previous, change, altimeter_range, parameters, gates) -> (J, lower,
    upper, rate, activation, gate, quantities, activity), rows of all levels stacked. `passive`:
    motion that no thruster drives, see `N_PASSIVE` of `uvms_ocp.control.velocity.swing`; `previous`:
    velocity commanded one tick before; `change`: its difference from the command before that;
    `parameters`: those of all tasks, one after the other (`uvms_ocp.control.velocity.goals`). The
    output `gate` is 0 or 1: bounds are widened for values between.
    """
    names: tuple[str, ...]
    """Names of the levels, highest priority first."""
    sizes: tuple[int, ...]
    """Rows of each level."""
    quantity_names: tuple[str, ...]
    """Names of the output `quantities`: ``task.quantity``, then those beside tasks."""
    rests_on: Mapping[str, np.ndarray]
    """(n_quantities,) by channel of `Readings`: True for quantities that are unknown without the
    channel.
    """
    step: np.ndarray
    """(n_v,) [m/s, rad/s] largest change of each velocity in one tick; infinite where the
    acceleration has no limit.
    """


@checked
def build_levels(
    robot: Robot, hierarchy: Hierarchy, dt: Period, beside_tasks: Sequence[str] = ()
) -> LevelsProblem:
    """Stack the velocity limits of `robot`, the tasks of `hierarchy` and minimum velocity, for
    control period dt [s].

    beside_tasks: names of further quantities to measure, see `Mission.beside_tasks`:
    `OWN_QUANTITIES`, which the tick writes, ``vehicle.depth`` [m] of B below the origin of W,
    ``vehicle.speed`` [m/s] of B in W; other names are left out.

    Raises `FrameNotFound` or `NameNotFound` where a task names a frame or joint that the robot does
    not have.
    """
    key = tuple(_expression_key(task, robot) for task in hierarchy.tasks)
    numbers = list[float]()
    for task in hierarchy.tasks:
        numbers += [getattr(task, name) for name in numbers_of(task)]
    return _levels_with(tuple(numbers), robot, Keyed(key, hierarchy), dt, tuple(beside_tasks))


def _expression_key(task: Task, robot: Robot) -> Hashable:
    """Return a key of all that the rows of a task depend on: its fields, but for goals, shapes and
    numbers, which are parameters.

    The key is equal to no other where that cannot be known: for a class that does not declare its
    `Task.symbolic_numbers`, or has fields without a hash.
    """
    if declared_numbers(task) is None:
        return object()
    numeric_fields = (*_AS_PARAMETERS, *numbers_of(task))
    names = [item.name for item in fields(task) if item.init and item.name not in numeric_fields]
    key = (type(task), task.n_parameters(robot), *(getattr(task, name) for name in names))
    try:
        hash(key)
    except TypeError:
        return object()
    return key


def declared_numbers(task: Task) -> tuple[str, ...] | None:
    """Return the `Task.symbolic_numbers` that the class of a task declares itself; `None` where it
    does not.

    Inherited ones do not count: the rows of a subclass may be its own, and take numbers alone.
    """
    return vars(type(task)).get("symbolic_numbers")


def numbers_of(task: Task) -> list[str]:
    """Return the names of the fields that rows take as symbols; none for a class that does not
    declare them.

    Raises `InvalidInput` for a declared name that is no field with one number.
    """
    names = declared_numbers(task) or ()
    for name in names:
        value = getattr(task, name, None)
        if not isinstance(value, Real):
            raise InvalidInput(
                f"{task.name}: symbolic_numbers of {type(task).__name__} has {name!r}, which is"
                f" {short(value)}; give names of fields of which each is one number"
            )
    return list(names)


def _with_symbols(tasks: Sequence[Task], numbers: ca.SX) -> Hierarchy:
    """Return the tasks with symbols in place of their numbers."""
    symbols = iter(ca.vertsplit(numbers))
    symbolic_tasks = list[Task]()
    for task in tasks:
        task_symbols = {name: next(symbols) for name in numbers_of(task)}
        symbolic_tasks.append(replace_with_symbols(task, **task_symbols))
    return Hierarchy(symbolic_tasks, [task.name for task in symbolic_tasks])


@lru_cache(maxsize=8)
def _levels_with(numbers: tuple[float, ...], *problem_key: Any) -> LevelsProblem:
    """Return the `_known_levels` with these numbers of tasks [units of the fields]; neither graph nor
    code is made anew for them.
    """
    problem = _known_levels(*problem_key)
    return replace(problem, function=with_numbers(problem.function, numbers))


@lru_cache(maxsize=8)
def _known_levels(
    robot: Robot, keyed_hierarchy: Keyed, dt: float, beside_tasks: tuple[str, ...]
) -> LevelsProblem:
    """Make the levels once for all runs of a robot and its tasks; the last input of their function
    are the numbers of tasks.
    """
    symbols = tick_symbols(robot, dt)
    n_numbers = sum(len(numbers_of(task)) for task in keyed_hierarchy.value.tasks)
    numbers = ca.SX.sym("numbers", n_numbers)
    hierarchy = _with_symbols(keyed_hierarchy.value.tasks, numbers)
    previous = ca.SX.sym("previous", robot.n_v)
    change = ca.SX.sym("change", robot.n_v)
    parameters = ca.SX.sym("parameters", sum(task.n_parameters(robot) for task in hierarchy.tasks))
    gates = ca.SX.sym("gates", len(hierarchy.tasks))
    passive = ca.SX.sym("passive", N_PASSIVE)
    task_rows = _task_rows(robot, hierarchy, symbols, parameters)
    leaning = list[_Level]()
    if swinging_axes(robot):
        still = mean_attitude(symbols, passive)
        lean = lean_of(still, passive)
        if robot.n_joints:
            leaning.append(_Level(LEAN, lean_rows(still, lean)))
        means = _task_rows(robot, hierarchy, still, parameters)
        for k, task in enumerate(hierarchy.tasks):
            if not _is_safety(task):
                task_rows[k] = countered_rows(task_rows[k], means[k], symbols, passive, lean)
    task_levels = list[_Level]()
    for k, task in enumerate(hierarchy.tasks):
        rows = _reachable(task, task_rows[k], symbols, previous, gates[k])
        task_levels.append(_Level(task.name, rows, gates[k]))
    n_safe = len(list(takewhile(_is_safety, hierarchy.tasks)))
    levels = [
        _Level(LIMITS, _limit_rows(symbols, previous)),
        *task_levels[:n_safe],
        *leaning,
        _Level(JERK_LIMIT, jerk_limit_rows(symbols, previous, change)),
        *task_levels[n_safe:],
        _Level(REST, _rest_rows(symbols, previous)),
    ]
    quantities = dict[str, ca.SX]()
    for task, rows in zip(hierarchy.tasks, task_rows, strict=True):
        for name, value in rows.quantities.items():
            quantities[f"{task.name}.{name}"] = value
    for name, value in _beside_tasks(symbols).items():
        if name in beside_tasks:
            quantities[name] = value
    inputs = [
        symbols.q,
        symbols.velocity,
        passive,
        previous,
        change,
        symbols.altimeter_range,
        parameters,
        gates,
        numbers,
    ]
    outputs = _stacked(levels, quantities)
    function = ca.Function(
        "levels", inputs, list(outputs.values()), list(_INPUTS), list(outputs), {"cse": True}
    )
    return LevelsProblem(
        function=function,
        names=tuple(level.name for level in levels),
        sizes=tuple(level.rows.n_rows for level in levels),
        quantity_names=tuple(quantities),
        rests_on=_rests_on(symbols, hierarchy.tasks, quantities),
        step=robot.limits.acceleration * dt,
    )


def _beside_tasks(symbols: TickSymbols) -> dict[str, ca.SX]:
    """Return all quantities beside those of tasks, by name."""
    quantities = dict.fromkeys(OWN_QUANTITIES, ca.SX(0))
    if not symbols.robot.n_vehicle:
        return quantities
    return {**quantities, "vehicle.depth": -symbols.q[2], _SPEED: ca.norm_2(symbols.velocity[:3])}


class _Level(NamedTuple):
    """A level of the hierarchy: its name, rows, and the gate of all of them."""

    name: str
    rows: Rows
    gate: ca.SX = ca.SX(1)


def _is_safety(task: Task) -> bool:
    """Check whether a task keeps the robot safe, or ranks above those that do."""
    return task.task_class <= TaskClass.SAFETY


def _reachable(task: Task, rows: Rows, symbols: TickSymbols, previous: ca.SX, gate: ca.SX) -> Rows:
    """Return the rows of a task as the acceleration limits can follow them. Bounds that keep the
    robot safe are followed as fast as these limits allow, all others smoothly.
    """
    eased = task.equality or not _is_safety(task)
    return reachable_rows(
        rows, equality=task.equality, eased=eased, symbols=symbols, previous=previous, gate=gate
    )


def _stacked(levels: Sequence[_Level], quantities: dict[str, ca.SX]) -> dict[str, ca.SX]:
    """Return dense outputs of the levels function; a gate between 0 and 1 is already part of the
    bounds.
    """
    rows = [level.rows for level in levels]
    gate = ca.vertcat(*[ca.repmat(level.gate, level.rows.n_rows, 1) for level in levels])
    activity = ca.vertcat(*[level_rows.activation for level_rows in rows]) * gate
    outputs = {
        "J": ca.vertcat(*[level_rows.jacobian for level_rows in rows]),
        "lower": ca.vertcat(*[level_rows.lower for level_rows in rows]),
        "upper": ca.vertcat(*[level_rows.upper for level_rows in rows]),
        "rate": ca.vertcat(*[level_rows.rate for level_rows in rows]),
        "activation": activity,
        "gate": gate > 0,
        "quantities": ca.vertcat(ca.SX(0, 1), *quantities.values()),
        "activity": activity,
    }
    return {name: ca.densify(value) for name, value in outputs.items()}


def _rests_on(
    symbols: TickSymbols, tasks: Sequence[Task], quantities: dict[str, ca.SX]
) -> dict[str, np.ndarray]:
    """Return which quantities depend on each channel. Quantities of tasks of distances depend on the
    whole configuration.
    """
    robot = symbols.robot
    q = symbols.q
    values = ca.vertcat(ca.SX(0, 1), *quantities.values())
    measured = {task.name for task in tasks if task.nearest_pairs is not None}
    is_of_distances = np.array(
        [name.rpartition(".")[0] in measured for name in quantities], dtype=bool
    )
    n = 7 if robot.n_vehicle else 0
    of_q = {"position": q[: min(n, 3)], "attitude": q[min(n, 3) : n], "joint_positions": q[n:]}
    dependencies = {name: _depends(values, part) | is_of_distances for name, part in of_q.items()}
    dependencies["linear_velocity"] = np.array([name == _SPEED for name in quantities], dtype=bool)
    return {**dependencies, "altimeter_range": _depends(values, symbols.altimeter_range)}


def _depends(values: ca.SX, on: ca.SX) -> np.ndarray:
    """Check which of the values (m,) depend on any of the symbols."""
    if on.numel() == 0:
        return np.zeros(values.numel(), dtype=bool)
    return np.array([ca.depends_on(value, on) for value in ca.vertsplit(values)], dtype=bool)


def tick_symbols(robot: Robot, dt: float) -> TickSymbols:
    """Return the symbols that tasks are written in, at a control period dt [s]."""
    q = ca.SX.sym("q", robot.n_q)
    return TickSymbols(
        robot=robot,
        kinematics=SymbolicModel(robot.model).forward_kinematics(q),
        q=q,
        velocity=ca.SX.sym("velocity", robot.n_v),
        altimeter_range=ca.SX.sym("altimeter_range"),
        dt=dt,
    )


def _task_rows(
    robot: Robot, hierarchy: Hierarchy, symbols: TickSymbols, parameters: ca.SX
) -> list[Rows]:
    """Return the rows of all tasks, each with its part of the parameters."""
    rows = list[Rows]()
    first = 0
    for task in hierarchy.tasks:
        end = first + task.n_parameters(robot)
        rows.append(task.rows(symbols, parameters[first:end]))
        first = end
    return rows


def _limit_rows(symbols: TickSymbols, previous: ca.SX) -> Rows:
    """Make the rows of velocity and position limits, reached no faster than the acceleration limits
    allow from the previous velocity.

    Joints keep a speed from which they can still stop before their limit. The regularised
    pseudo-inverse does not read these rows.
    """
    robot = symbols.robot
    reach = ca.DM(robot.limits.acceleration * symbols.dt)
    lower = ca.SX(-robot.limits.velocity)
    upper = ca.SX(robot.limits.velocity)
    for joint, q_lower, q_upper in bounded_joints(robot.joints, robot.limits):
        i = joint.idx_v
        q = joint.position(symbols.q)
        braking = {"deceleration": float(robot.limits.acceleration[i]), "dt": symbols.dt}
        lower[i] = ca.fmax(lower[i], -stopping_speed(q - q_lower, **braking))
        upper[i] = ca.fmin(upper[i], stopping_speed(q_upper - q, **braking))
    zeros = ca.SX.zeros(robot.n_v)
    free = symbolic_bodies.sparse(unlimited_axes(robot))
    return Rows(
        jacobian=ca.SX.eye(robot.n_v),
        rate=zeros,
        lower=ca.fmin(ca.fmax(lower, previous - reach), previous + reach) - free,
        upper=ca.fmin(ca.fmax(upper, previous - reach), previous + reach) + free,
        activation=zeros,
    )


def _rest_rows(symbols: TickSymbols, previous: ca.SX) -> Rows:
    """Minimise the remaining velocity ([Gao2022] Table 3, last row), coming to rest in
    proportion.
    """
    n_v = symbols.robot.n_v
    rows = equality_rows(ca.SX.eye(n_v), ca.SX.zeros(n_v))
    return reachable_rows(
        rows, equality=True, eased=True, symbols=symbols, previous=previous, gate=ca.SX(1)
    )
