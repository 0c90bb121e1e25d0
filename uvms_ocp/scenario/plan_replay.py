"""Carry out a plan on a plant: open loop, with the forces of the planned motion alone, or with
feedback.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
import pinocchio as pin

from uvms_ocp.checks import checked, checked_dataclass
from uvms_ocp.control.force.computed_torque import OPEN_LOOP
from uvms_ocp.control.plan_following import PlanTracker
from uvms_ocp.errors import InvalidInput
from uvms_ocp.estimation.estimator import PassThrough
from uvms_ocp.ocp.motion_record import TOOL, frame_poses, tool_series
from uvms_ocp.ocp.plan import Plan
from uvms_ocp.ocp.trajectory import Trajectory
from uvms_ocp.record.meta_values import AlarmMeta
from uvms_ocp.record.record import Record
from uvms_ocp.robot import IDEAL_SENSORS, Robot, State, Water
from uvms_ocp.robot.dynamics import Dynamics, robot_dynamics
from uvms_ocp.scenario.run_metadata import meta_without_mission
from uvms_ocp.sim import (
    DynamicPlant,
    Environment,
    FlatSeafloor,
    Plant,
    SensorSuite,
    closest_approach,
    simulate,
)
from uvms_ocp.types import Period

PlantOrEnvironment: TypeAlias = Plant | Environment
"""A plant in any state, or an environment in which the robot starts as the plan does."""
_DEEP = FlatSeafloor(z=-1e4)
"""Floor below a plant whose own is not known; the echo of the altimeter is not used."""


@dataclass(frozen=True, kw_only=True, slots=True)
class TrackingError:
    """Departure of a plant from a plan."""

    position: float
    """[m] largest distance of the frame from its planned position."""
    end_position: float
    """[m] distance at the end."""
    end_orientation: float
    """[rad] angle at the end."""


@checked_dataclass(eq=False)
class ReplayResult:
    """Record and errors of a plan carried out on a plant."""

    record: Record
    """True states, thrust, torque and energy, tick by tick; figures and scenes take it. An alarm
    says where the plan goes below the sea floor of an environment.
    """
    mismatch: TrackingError
    """Error of the tool, or of the robot's last frame where it has none."""


@checked
def replay(
    plan: Plan, where: PlantOrEnvironment, *, feedback: bool = True, dt: Period = 1 / 200
) -> ReplayResult:
    """Carry out a plan on a plant, or on a `DynamicPlant` in an environment that starts in the
    plan's first state.

    feedback: of positions and velocities, else the forces of the planned motion alone; by computed
    torque both. dt [s]: control period. Raises `InvalidInput` for a plan of a wrench: no plant
    takes one.
    """
    robot = plan.robot
    trajectory = plan.trajectory
    if trajectory.has_wrench:
        raise InvalidInput(
            "a plan with Actuation.WRENCH has no thrust to send; plan with Actuation.THRUSTERS"
        )
    dynamics = robot_dynamics(robot)
    plant: Plant
    if isinstance(where, Environment):
        plant = _plant(plan, where, dynamics)
        floor = where.seafloor
    else:
        plant = where
        floor = _DEEP
    gains = None if feedback else OPEN_LOOP
    water = Water(velocity=np.array(plan.current))
    recorder = simulate(
        plant=plant,
        sensors=SensorSuite(robot, floor, IDEAL_SENSORS).read,
        estimator=PassThrough(robot),
        controller=PlanTracker(trajectory, robot, dynamics, dt=dt, gains=gains, water=water),
        dt=dt,
        duration=plan.duration + dt,
    )
    if isinstance(where, Environment):
        below = _below(plan, where)
    else:
        below = ()
    record = _record(plan, recorder.series(), dt, "with feedback" if feedback else "blind", below)
    frame = TOOL if robot.has_frame(TOOL) else "base_link"
    return ReplayResult(
        record=record,
        mismatch=tracking_error(trajectory, record["t"], record["q"], robot=robot, frame=frame),
    )


def _plant(plan: Plan, environment: Environment, dynamics: Dynamics) -> DynamicPlant:
    start = plan.trajectory.q[0], plan.trajectory.v[0]
    plant = DynamicPlant(plan.robot, start[0], dynamics=dynamics, environment=environment)
    plant.state = State(q=start[0], v=start[1], a=np.zeros(plan.robot.n_v))
    return plant


def _below(plan: Plan, environment: Environment) -> tuple[AlarmMeta, ...]:
    """Return an alarm with the place at which a plan goes deepest below the floor, if it does: what
    was flown then says little of the plan.
    """
    path = plan.trajectory
    water = replace(environment, obstacles=())
    approach = closest_approach(plan.robot, water, path.q)
    if approach.distance >= 0:
        return ()
    text = (
        f"the plan goes {-approach.distance:.2g} m below the sea floor ({approach.pair}); keep"
        " clear of the floor as of an obstacle"
    )
    return (AlarmMeta(t=float(path.t[approach.row]), text=text),)


def _record(
    plan: Plan,
    series: dict[str, np.ndarray],
    dt: float,
    manner: str,
    alarms: tuple[AlarmMeta, ...] = (),
) -> Record:
    """Make a record of one phase, without tasks: no mission is carried out, but a motion."""
    robot = plan.robot
    plant = "dynamic" if "thrust" in series else "kinematic"
    is_over = series["t"][-1] >= plan.duration - dt / 2
    fields = {
        "thrusters": robot.thruster_names,
        "surroundings": plan.surroundings,
        "plant": plant,
        "dt": dt,
        "alarms": alarms,
        "completed": bool(is_over),
        "stopped": "" if is_over else "diverged",
    }
    meta = meta_without_mission(robot, f"plan carried out {manner}", "plan", **fields)
    if not robot.has_frame(TOOL):
        tool = {}
    else:
        tool = {TOOL: tool_series(robot, series["q"])}
    return Record(
        series=series | tool | {"phase": np.zeros(len(series["t"]), dtype=np.int64)}, meta=meta
    )


def tracking_error(
    trajectory: Trajectory, t: np.ndarray, q: np.ndarray, *, robot: Robot, frame: str
) -> TrackingError:
    """Compare the pose of a frame at the recorded q (n, n_q) [m, rad] with the planned one at the
    times t (n,) [s].

    Raises `FrameNotFound` for an unknown frame.
    """
    planned_q = trajectory.states_at(robot.model, t)[0]
    planned_poses = frame_poses(robot, frame, planned_q)
    poses = frame_poses(robot, frame, q)
    distances = []
    for planned, actual in zip(planned_poses, poses, strict=True):
        error = planned.inverse() * actual
        distances.append(float(np.linalg.norm(error.translation)))
    angle = float(np.linalg.norm(pin.log3(error.rotation)))
    return TrackingError(position=max(distances), end_position=distances[-1], end_orientation=angle)
