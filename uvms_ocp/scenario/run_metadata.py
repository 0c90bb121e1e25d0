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
_FLOOR_AROUND = 12.0  # [m] of a floor with protuberances that a record keeps around the mission

# [s] between places of a goal that moves, and how many there are at most
_WAY_STEP = 0.1
_MOST_PLACES = 3000


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RunOutcome:
    """How a run ended."""

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
    """A value that is computed after a run: where that fails it costs this value, told as a
    warning, and not the run.
    """
    try:
        return compute()
    except Exception as error:
        _log.warning(
            "%s", plain_line(f"not in the record: {name}, {type(error).__name__}: {error}")
        )
        return instead


def meta_without_mission(robot: Robot, name: str, phase: str, **fields: Any) -> RunMeta:
    """Metadata of a motion of one phase, without tasks. fields: other fields of `RunMeta`."""
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
    """Metadata of a run of the mission in `setup`.

    parts: names of plant, solver, controller, estimator and sensors. controller, monitor: those
    that ran, which know what happened.
    """
    robot = setup.robot
    tasks = setup.mission.hierarchy.tasks
    phases = setup.mission.all_phases
    state = controller.state
    alarms = sorted([*monitor.alarms, *controller.watchdog.alarms])
    problem = controller.problem
    rows = zip(problem.names, problem.sizes, strict=True)
    limited = meta_values.LimitsMeta.model_fields
    allowed = partial(quantity_stds, setup, ending.q)

    def spreads() -> dict[str, float]:
        """Compute spreads with what no reading can tell: declared constant errors, and what a
        channel came back elsewhere by.
        """
        unseen = np.hypot(declared_bias(robot, setup.sensors), monitor.unexplained)
        if ending.std is None:
            return {}
        return allowed(np.hypot(ending.std, unseen))

    tool_names = {roles.TOOL: robot.tools[0]} if len(robot.tools) > 1 else {}
    tools = {
        task.name: tool_names.get(task.frame, task.frame)
        for task in tasks
        if isinstance(task, (ToolPose, ToolPosition))
    }
    energy = getattr(controller.guide, "energy", None)
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
        levels=tuple(meta_values.LevelMeta(name=level, rows=n) for level, n in rows),
        quantities=tuple(problem.quantity_names),
        thresholds=tuple(
            meta_values.ThresholdMeta(**_condition_fields(condition), phase=phase.name)
            for phase in phases
            for condition in phase.conditions
        ),
        limits=meta_values.LimitsMeta(
            **{k: tuple(getattr(robot.limits, k).tolist()) for k in limited}
        ),
        surroundings=_surroundings(setup, markers, ending),
        packages=packages(),
        **parts,
        floating=bool(robot.n_vehicle),
        dt=dt,
        completed=state.completed,
        stopped=ending.stopped,
        pending="" if state.completed else controller.pending(),
        abort_phase="" if setup.mission.abort is None else setup.mission.abort.phase.name,
        events=_events(controller, ending),
        alarms=tuple(meta_values.AlarmMeta(t=t, text=text) for t, text in alarms),
        channels=monitor.channels,
        faults=faults,
        true_quantities=_values(ending.quantities),
        sensors_allow=()
        if ending.stopped == "cut off"
        else _values(computed_or({}, "what sensors allow", allowed)),
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
    """Return the `ENERGIES` [J] at t [s] as the plant has them, in a state of the mission; none
    where it has none.
    """
    if not {"thruster_energy", "joint_energy"} <= series.keys():
        return {}
    rows = np.searchsorted(series["t"], np.array([t, state.since]) - 1e-9).clip(
        max=len(series["t"]) - 1
    )
    total, total_before = (
        float(np.sum(series["thruster_energy"][row]) + series["joint_energy"][row]) for row in rows
    )
    return dict(zip(meta_values.ENERGIES, (total, total - total_before), strict=True))


def _events(
    controller: KinematicController, ending: RunOutcome
) -> tuple[meta_values.EventMeta, ...]:
    events = []
    for e, truth in zip(controller.events, ending.at_events, strict=False):
        met = [
            meta_values.MetConditionMeta(
                **_condition_fields(condition), estimated=x, release=condition.release
            )
            for condition, x in e.conditions
        ]
        why: dict[str, Any] = {"conditions": tuple(met), "true_quantities": _values(truth)}
        events.append(
            meta_values.EventMeta(t=e.t, source=e.source, target=e.target, reason=e.reason, **why)
        )
    return tuple(events)


def _condition_fields(condition: Condition) -> dict[str, Any]:
    """The fields of a `ConditionMeta`."""
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
    """Horizontal place (2,) [m] of the vehicle in W at q (n_q,) [m, rad]; a fixed base is at the
    origin.
    """
    if setup.robot.n_vehicle:
        return q[:2]
    return np.zeros(2)


def _goal_frames(mission: Mission, end: float) -> Iterator[meta_values.FrameMeta]:
    """Goals of all tasks that have a pose for one, those of phases too, with their ways until `end`
    [s], if they move.
    """
    t = np.linspace(0.0, end, 2 + min(int(end / _WAY_STEP), _MOST_PLACES))
    for task in mission.hierarchy.tasks:
        if isinstance(task, (PoseTask, ToolPosition)):
            goals = {None: task.goal} | {
                mission_phase.name: mission_phase.goals[task.name]
                for mission_phase in mission.all_phases
                if task.name in mission_phase.goals
            }
            for phase, goal in goals.items():
                name = f"goal of {task.name}" + ("" if phase is None else f" in {phase}")
                times = t if callable(goal) else t[:1]
                places = [
                    pin.SE3ToXYZQUAT(evaluate_pose(task.name, goal, k)[0]).tolist() for k in times
                ]
                if callable(goal):
                    way = tuple((k, *place) for k, place in zip(t.tolist(), places, strict=True))
                else:
                    way = ()
                yield meta_values.FrameMeta(name=name, pose=tuple(places[0]), phase=phase, way=way)


def _relief(setup: Setup, markers: Markers, end: np.ndarray) -> meta_values.FloorRelief | None:
    """The floor around the way from the start to the configuration `end` (n_q,), and around the
    markers.
    """
    points = np.array(
        [
            *(_place(setup, q) for q in (setup.start, end)),
            *(point[:2] for point in markers.values()),
        ]
    )
    low = points.min(axis=0) - _FLOOR_AROUND
    high = points.max(axis=0) + _FLOOR_AROUND
    return floor_relief(setup.environment.seafloor, low, high)
