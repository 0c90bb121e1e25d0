"""Write the metadata of the record of a run."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import repeat
from typing import Any, Literal, TypeVar

import numpy as np
import pinocchio as pin

from uvms_ocp.control.velocity.kinematic import KinematicController
from uvms_ocp.errors import plain_line
from uvms_ocp.estimation.estimator import declared_bias
from uvms_ocp.estimation.health.monitor import HealthMonitor
from uvms_ocp.mission import Condition, Mission, MissionState
from uvms_ocp.record import meta_values
from uvms_ocp.record.run_meta import RunMeta, packages
from uvms_ocp.robot import IDEAL_SENSORS, Robot, recorded_robots, roles
from uvms_ocp.robot.shapes.obstacles import describe_obstacles
from uvms_ocp.scenario.preflight.checks import quantity_stds
from uvms_ocp.scenario.preflight.setup import Setup
from uvms_ocp.sim.seafloor import floor_relief
from uvms_ocp.solvers.hierarchy.solution import Status
from uvms_ocp.tasks.goals import evaluate_pose
from uvms_ocp.tasks.pose import PoseTask, ToolPose, ToolPosition

Markers = Mapping[str, tuple[float, float, float]]
"""Points (3,) [m] in W to draw, by name."""

_log = logging.getLogger(__name__)
_T = TypeVar("_T")
_FLOOR_MARGIN = 12.0  # [m] around the mission to which records keep a floor that is not flat
_PATH_STEP = 0.1  # [s] between samples of a goal that moves
_MOST_SAMPLES = 3000  # of a goal that moves


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RunOutcome:
    """End of a run."""

    q: np.ndarray
    """(n_q,) [m, rad] the true configuration."""
    t: float
    """[s] time at which the run ended."""
    quantities: Mapping[str, float]
    """Values by ``task.quantity``, at the true state [m] or [rad]."""
    wall_s: float
    """[s] wall time that the simulation took."""
    at_events: Iterable[Mapping[str, float]] = repeat({})
    """The quantities at the end of each phase, event by event [m] or [rad]; empty where they are
    not known.
    """
    std: np.ndarray | None = None
    """(n_v,) [m, rad] standard deviation of the estimated configuration, where the estimator
    tells.
    """
    stopped: Literal["", "stopped", "diverged", "cut off"] = ""
    """Way in which the run was ended from outside; see `RunMeta.stopped`."""


def computed_or(instead: _T, name: str, compute: Callable[[], _T]) -> _T:
    """Return a value that is computed after a run, or `instead`, with a warning, where that fails:
    the run is worth more than this value.
    """
    try:
        return compute()
    except Exception as error:
        _log.warning(
            "%s", plain_line(f"not in the record: {name}, {type(error).__name__}: {error}")
        )
        return instead


def meta_without_mission(robot: Robot, name: str, phase: str, **fields: Any) -> RunMeta:
    """Make the metadata of a motion of one phase, without tasks. fields: other fields of `RunMeta`."""
    phases = (meta_values.PhaseMeta(name=phase),)
    floating = bool(robot.n_vehicle)
    shared: dict[str, Any] = {"packages": packages(), "solver": "none", "floating": floating}
    return RunMeta(
        scenario=name, **recorded_robots.robot_meta(robot), phases=phases, **shared, **fields
    )


def run_meta(
    *,
    name: str,
    setup: Setup,
    dt: float,
    parts: Mapping[str, Any],
    seed: int,
    markers: Markers,
    faults: tuple[meta_values.FaultMeta, ...],
    controller: KinematicController,
    monitor: HealthMonitor,
    ending: RunOutcome,
) -> RunMeta:
    """Make the metadata of a run of the mission in `setup`.

    parts: names of plant, solver, controller, estimator and sensors. controller, monitor: those
    that ran, which know what happened.
    """
    robot = setup.robot
    tasks = setup.mission.hierarchy.tasks
    phases = setup.mission.all_phases
    state = controller.state
    alarms = sorted([*monitor.alarms, *controller.watchdog.alarms])
    problem = controller.problem
    allowed_stds = partial(quantity_stds, setup, ending.q)

    def spreads() -> dict[str, float]:
        """Compute standard deviations of quantities, with errors that no reading shows: declared
        biases, and jumps of channels that came back.
        """
        unseen = np.hypot(declared_bias(robot, setup.sensors), monitor.unexplained)
        if ending.std is None:
            return {}
        return allowed_stds(np.hypot(ending.std, unseen))

    levels = [
        meta_values.LevelMeta(name=name, rows=n_rows)
        for name, n_rows in zip(problem.names, problem.sizes, strict=True)
    ]
    limits = {
        name: tuple(getattr(robot.limits, name).tolist())
        for name in meta_values.LimitsMeta.model_fields
    }
    sensors_allow: tuple[meta_values.QuantityMeta, ...] = ()
    if ending.stopped != "cut off":
        sensors_allow = _values(computed_or({}, "what sensors allow", allowed_stds))
    tools = _tools_by_task(setup)
    energy = getattr(controller.guide, "energy", None)
    abort = setup.mission.abort
    return RunMeta(
        scenario=name,
        **recorded_robots.robot_meta(robot),
        thrusters=robot.thruster_names,
        phases=tuple(
            meta_values.PhaseMeta(name=phase.name, title=phase.title, tasks=phase.on)
            for phase in phases
        ),
        tasks=tuple(
            meta_values.TaskMeta(name=task.name, label=task.label, tool=tools.get(task.name))
            for task in tasks
        ),
        tool_task=next(iter(tools), None),
        levels=tuple(levels),
        quantities=tuple(problem.quantity_names),
        thresholds=_thresholds(setup.mission),
        limits=meta_values.LimitsMeta(**limits),
        surroundings=_surroundings(setup, markers, ending),
        packages=packages(),
        **parts,
        floating=bool(robot.n_vehicle),
        dt=dt,
        completed=state.completed,
        stopped=ending.stopped,
        pending="" if state.completed else controller.pending(),
        abort_phase="" if abort is None else abort.phase.name,
        events=_events(controller, ending),
        alarms=tuple(meta_values.AlarmMeta(t=t, text=text) for t, text in alarms),
        channels=monitor.channels,
        faults=faults,
        true_quantities=_values(ending.quantities),
        sensors_allow=sensors_allow,
        spreads=_values(computed_or({}, "spreads", spreads)),
        statuses=tuple(status.value for status in Status),
        seed=seed,
        noise=setup.sensors != IDEAL_SENSORS,
        planned_energy=energy if isinstance(energy, float) else None,
        wall_s=ending.wall_s,
    )


def energy_used(
    series: Mapping[str, np.ndarray], state: MissionState, t: float
) -> dict[str, float]:
    """Return the `ENERGIES` [J] at t [s]: the total, and that since the mission's phase began; empty
    for a plant without energies.
    """
    if not {"thruster_energy", "joint_energy"} <= series.keys():
        return {}
    last_row = len(series["t"]) - 1
    rows = np.searchsorted(series["t"], np.array([t, state.since]) - 1e-9).clip(max=last_row)
    totals = []
    for row in rows:
        thrusters = np.sum(series["thruster_energy"][row])
        totals.append(float(thrusters + series["joint_energy"][row]))
    total, total_before = totals
    return dict(zip(meta_values.ENERGIES, (total, total - total_before), strict=True))


def _tools_by_task(setup: Setup) -> dict[str, str]:
    """Return the names of the tools' frames by the tasks that move them."""
    robot = setup.robot
    tools = {}
    for task in setup.mission.hierarchy.tasks:
        if not isinstance(task, (ToolPose, ToolPosition)):
            continue
        tools[task.name] = task.frame
        if task.frame == roles.TOOL and len(robot.tools) > 1:
            tools[task.name] = robot.tools[0]
    return tools


def _thresholds(mission: Mission) -> tuple[meta_values.ThresholdMeta, ...]:
    thresholds = []
    for phase in mission.all_phases:
        for condition in phase.conditions:
            fields = _condition_fields(condition)
            thresholds.append(meta_values.ThresholdMeta(**fields, phase=phase.name))
    return tuple(thresholds)


def _events(
    controller: KinematicController, ending: RunOutcome
) -> tuple[meta_values.EventMeta, ...]:
    events = []
    for event, truth in zip(controller.events, ending.at_events, strict=False):
        conditions = []
        for condition, estimated in event.conditions:
            conditions.append(
                meta_values.MetConditionMeta(
                    **_condition_fields(condition),
                    estimated=estimated,
                    release=condition.release,
                )
            )
        events.append(
            meta_values.EventMeta(
                t=event.t,
                source=event.source,
                target=event.target,
                reason=event.reason,
                conditions=tuple(conditions),
                true_quantities=_values(truth),
            )
        )
    return tuple(events)


def _condition_fields(condition: Condition) -> dict[str, Any]:
    """Return the fields that a condition has as a `ConditionMeta`."""
    return {"quantity": condition.quantity, "limit": condition.limit, "sign": condition.sign}


def _values(quantities: Mapping[str, float]) -> tuple[meta_values.QuantityMeta, ...]:
    return tuple(
        meta_values.QuantityMeta(name=name, value=value) for name, value in quantities.items()
    )


def _surroundings(
    setup: Setup, markers: Markers, ending: RunOutcome
) -> meta_values.SurroundingsMeta:
    return meta_values.SurroundingsMeta(
        frames=tuple(_goal_frames(setup.mission, ending.t)),
        markers=tuple(
            meta_values.MarkerMeta(name=name, position=point) for name, point in markers.items()
        ),
        obstacles=describe_obstacles(setup.environment.obstacles),
        floor_z=setup.floor_at(*_place(setup, setup.start)),
        floor=computed_or(None, "the floor around it", lambda: _relief(setup, markers, ending.q)),
    )


def _place(setup: Setup, q: np.ndarray) -> np.ndarray:
    """Return the horizontal place (2,) [m] of the vehicle in W at q (n_q,) [m, rad]; a fixed base is at the
    origin.
    """
    if setup.robot.n_vehicle:
        return q[:2]
    return np.zeros(2)


def _goal_frames(mission: Mission, end: float) -> Iterator[meta_values.FrameMeta]:
    """Yield the goals of all tasks whose goal is a pose, and the goals that phases set in their place;
    goals that move have their path until `end` [s].
    """
    t = np.linspace(0.0, end, 2 + min(int(end / _PATH_STEP), _MOST_SAMPLES))
    for task in mission.hierarchy.tasks:
        if not isinstance(task, (PoseTask, ToolPosition)):
            continue
        yield _goal_frame(task.name, task.goal, None, t)
        for phase in mission.all_phases:
            if task.name in phase.goals:
                yield _goal_frame(task.name, phase.goals[task.name], phase.name, t)


def _goal_frame(task: str, goal: Any, phase: str | None, t: np.ndarray) -> meta_values.FrameMeta:
    """Return a goal of a task in one phase, or in all where `phase` is `None`; of a goal that moves with
    its path at the times (n,) [s].
    """
    name = f"goal of {task}"
    if phase is not None:
        name += f" in {phase}"
    moves = callable(goal)
    times = t if moves else t[:1]
    poses = [pin.SE3ToXYZQUAT(evaluate_pose(task, goal, time)[0]).tolist() for time in times]
    way = []
    if moves:
        way = [(time, *pose) for time, pose in zip(t.tolist(), poses, strict=True)]
    return meta_values.FrameMeta(name=name, pose=tuple(poses[0]), phase=phase, way=tuple(way))


def _relief(setup: Setup, markers: Markers, end: np.ndarray) -> meta_values.FloorRelief | None:
    """Return the floor of a rectangle around the start, the configuration `end` (n_q,) and the
    markers.
    """
    points = [_place(setup, setup.start), _place(setup, end)]
    points += [np.array(point[:2]) for point in markers.values()]
    low = np.min(points, axis=0) - _FLOOR_MARGIN
    high = np.max(points, axis=0) + _FLOOR_MARGIN
    return floor_relief(setup.environment.seafloor, low, high)
