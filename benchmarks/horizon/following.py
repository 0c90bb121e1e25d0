"""A tool that follows still and moving goals in a gusty current, by receding horizon and by the
velocity hierarchy.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from time import process_time
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin
from recording.report import Row

from uvms_ocp.control.force.dynamic import DynamicController
from uvms_ocp.control.nmpc import Nmpc
from uvms_ocp.control.velocity.kinematic import KinematicController
from uvms_ocp.mission.mission import Mission
from uvms_ocp.mission.phase import Phase
from uvms_ocp.ocp.problem import OcpLevel, OcpProblem, single_phase
from uvms_ocp.ocp.terms import At, Effort, Smoothness, TaskTerm
from uvms_ocp.robot.dynamics import Dynamics, robot_dynamics
from uvms_ocp.robot.kinematics import Kinematics
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import Command, State, StateEstimate
from uvms_ocp.sim.currents import GustyCurrent, UniformCurrent
from uvms_ocp.sim.dynamic_plant import DynamicPlant
from uvms_ocp.sim.environment import Environment
from uvms_ocp.sim.seafloor import FlatSeafloor
from uvms_ocp.solvers.hierarchy.active_set import LexicographicActiveSet
from uvms_ocp.solvers.nlp.options import SqpOptions
from uvms_ocp.tasks.attitude import HorizontalAttitude
from uvms_ocp.tasks.goals import PoseReference
from uvms_ocp.tasks.hierarchy import Hierarchy
from uvms_ocp.tasks.joints import JointLimits, JointTracking
from uvms_ocp.tasks.pose import ToolPose

CURRENT = np.array([0.3, 0.0, 0.0])
"""(3,) [m/s] mean of the water."""
GUSTS = 0.05  # [m/s] standard deviation of the gusts
DOUBLE = 0.1  # [m/s] standard deviation of gusts that are twice as strong
JOINTS = (0.0, -0.6, 0.0, -1.2, 0.0, -0.6, 0.0)
DT = 1 / 200
PERIOD = 1 / 20
"""[s] of control and of planning."""
POSTURE = 0.3
"""[rad] by which joints may leave their posture at no cost."""
STRICT = SqpOptions(tolerance=1e-2)
"""Options of a solver of strict levels: the tool gives effort a millimetre."""
Controller: TypeAlias = Callable[[StateEstimate, float], Command]


@dataclass(frozen=True, kw_only=True, slots=True)
class Experiment:
    """How much is run."""

    cases: tuple[str, ...]
    seeds: tuple[int, ...] = (1, 2, 3)
    seconds: float = 20.0
    """[s] of each run."""
    horizon: float = 3.0
    """[s] of each plan."""
    n_steps: int = 20
    """Steps of each plan."""
    gains: tuple[float, ...] = (1.0, 2.0, 4.0)
    """[1/s] of the hierarchy's tool."""


def start_of(robot: Robot) -> np.ndarray:
    """Configuration (n_q,) at rest."""
    return robot.configuration(position=(0, 0, -5), rpy=(0, 0, 0.5), joints=JOINTS)


def tool_position(robot: Robot, q: np.ndarray) -> np.ndarray:
    """(3,) [m] of a true state q (n_q,), which may be pressed against a joint's stop."""
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    position: np.ndarray = data.oMf[robot.frame_id("tool")].translation.copy()
    return position


def station(first: pin.SE3) -> PoseReference:
    """Stay where the goal is at first."""
    return lambda t: (first, np.zeros(6))


def circle(first: pin.SE3, *, radius: float = 0.3, speed: float = 0.1) -> PoseReference:
    """Horizontal, of radius [m], at full speed [m/s] after 2 s."""

    def at(t: float) -> tuple[pin.SE3, np.ndarray]:
        if t > 2:
            way = speed * (t - 1)
            rate = speed
        else:
            way = speed * t * t / 4
            rate = speed * t / 2
        s, c = np.sin(way / radius), np.cos(way / radius)
        moved = first.translation + radius * np.array([s, 1 - c, 0.0])
        return pin.SE3(first.rotation, moved), rate * np.array([c, s, 0.0, 0.0, 0.0, 0.0])

    return at


def back_and_forth(first: pin.SE3, *, way: float = 0.5, speed: float = 0.1) -> PoseReference:
    """A way [m] along y at a speed [m/s], turning round at once: what only a look ahead can be
    ready for.
    """

    def at(t: float) -> tuple[pin.SE3, np.ndarray]:
        place = speed * t % (2 * way)
        direction = 1.0
        if place >= way:
            place = 2 * way - place
            direction = -1.0
        moved = first.translation + np.array([0.0, place, 0.0])
        velocity = np.array([0.0, speed * direction, 0.0, 0.0, 0.0, 0.0])
        return pin.SE3(first.rotation, moved), velocity

    return at


CASES: dict[str, tuple[Callable[[pin.SE3], PoseReference], float]] = {
    "station": (station, GUSTS),
    "circle 0.3 m, 0.05 m/s": (lambda first: circle(first, speed=0.05), GUSTS),
    "circle 0.3 m, 0.1 m/s": (circle, GUSTS),
    "back and forth 0.5 m, 0.1 m/s": (back_and_forth, GUSTS),
    "circle 0.3 m, 0.1 m/s, double gusts": (circle, DOUBLE),
}
"""Goal, and standard deviation of the gusts [m/s]."""


def problem(robot: Robot, goal: PoseReference, experiment: Experiment) -> OcpProblem:
    """The tool is weighed against effort in one level."""
    task = ToolPose(goal=goal)
    tool = (TaskTerm(task=task, at=At.PATH, weight=100.0), TaskTerm(task=task, weight=9.0))
    return single_phase(
        robot=robot,
        start=State(q=start_of(robot), v=np.zeros(robot.n_v)),
        duration=experiment.horizon,
        n_steps=experiment.n_steps,
        levels=[OcpLevel(name="follow", terms=(*tool, Effort(), Smoothness(weight=0.09)))],
        current=CURRENT,
    )


def strict(robot: Robot, goal: PoseReference, experiment: Experiment) -> OcpProblem:
    """Tool, then tilt and a range of postures, then effort, in strict order."""
    home = JointTracking(joints=robot.joint_names, goal=np.array(JOINTS))
    posture = TaskTerm(task=home, at=At.PATH, tolerance=POSTURE)
    tilt = TaskTerm(task=HorizontalAttitude(), at=At.PATH, weight=100.0)
    tool = problem(robot, goal, experiment).levels[0].terms[:2]
    costs = (Effort(), Smoothness(weight=0.09))
    levels = (
        OcpLevel(name="tool", terms=tool),
        OcpLevel(name="tilt and posture", terms=(tilt, posture)),
        OcpLevel(name="effort", terms=costs),
    )
    return replace(problem(robot, goal, experiment), levels=levels)


def hierarchy(
    robot: Robot, dynamics: Dynamics, goal: PoseReference, gain: float
) -> DynamicController:
    """Joint limits, tilt, tool with a gain [1/s], posture; above the dynamic control layer with its
    observer.
    """
    tasks = [
        JointLimits(),
        HorizontalAttitude(),
        ToolPose(goal=goal, gain_linear=gain, gain_angular=gain),
        JointTracking(joints=robot.joint_names, goal=np.array(JOINTS)),
    ]
    phase = Phase(name="follow", transitions=(), activations={task.name: 1.0 for task in tasks})
    mission = Mission(hierarchy=Hierarchy(tasks), phases=(phase,))
    kinematic = KinematicController(
        robot=robot, mission=mission, solver=LexicographicActiveSet(), dt=DT
    )
    return DynamicController(robot=robot, dynamics=dynamics, kinematic=kinematic)


def controllers(
    robot: Robot, dynamics: Dynamics, goal: PoseReference, experiment: Experiment
) -> Iterator[tuple[str, Controller]]:
    """Make all controllers that are compared, with their names."""
    # Processor time leaves out what other programs take meanwhile, the clock on the wall does not.
    yield "NMPC", Nmpc(problem(robot, goal, experiment), dt=DT, period=PERIOD, clock=process_time)
    yield "NMPC, clock on the wall", Nmpc(problem(robot, goal, experiment), dt=DT, period=PERIOD)
    levels = strict(robot, goal, experiment)
    yield (
        "NMPC, strict levels",
        Nmpc(levels, dt=DT, period=PERIOD, clock=process_time, options=STRICT),
    )
    yield (
        "NMPC, strict levels, clock on the wall",
        Nmpc(levels, dt=DT, period=PERIOD, options=STRICT),
    )
    for gain in experiment.gains:
        yield f"hierarchy, tool gain {gain:g} /s", hierarchy(robot, dynamics, goal, gain)


def run(
    robot: Robot, plant: DynamicPlant, controller: Controller, goal: PoseReference, seconds: float
) -> dict[str, Any]:
    """Follow the goal for so long [s]; errors [mm] of the tool, energy [J], thrust [N], processor
    time per call.
    """
    errors = []
    times = []
    peak = 0.0
    for i in range(round(seconds / DT)):
        estimate = StateEstimate(q=plant.state.q, v=plant.state.v, altimeter_range=30.0)
        begin = process_time()
        command = controller(estimate, i * DT)
        times.append(process_time() - begin)
        plant.step(command, DT)
        tool = tool_position(robot, plant.state.q)
        errors.append(float(np.linalg.norm(tool - goal((i + 1) * DT)[0].translation)))
        peak = max(peak, float(np.abs(plant.telemetry()["thrust"]).max()))
    spent = plant.telemetry()
    return {
        "rms error [mm]": 1e3 * float(np.sqrt(np.mean(np.square(errors)))),
        "largest error [mm]": 1e3 * max(errors),
        "thruster energy [J]": float(np.sum(spent["thruster_energy"])),
        "joint energy [J]": float(spent["joint_energy"]),
        "peak thrust [N]": peak,
        "processor time [ms per s]": 1e3 * sum(times[1:]) / seconds,
    }


def deadlines(nmpc: Nmpc) -> dict[str, Any]:
    """Count and time all solves but the first; `late` by the controller's own clock."""
    statistics = nmpc.statistics
    own_clock_ms = 1e3 * np.array(statistics.solve_times)
    processor_ms = 1e3 * np.array(statistics.processor_times)
    return {
        "solves": len(own_clock_ms),
        "late": statistics.missed,
        "unfit": statistics.rejected,
        "solve p50 [ms]": float(np.median(processor_ms)),
        "solve p99 [ms]": float(np.percentile(processor_ms, 99)),
        "solve p99, own clock [ms]": float(np.percentile(own_clock_ms, 99)),
    }


def rows(experiment: Experiment) -> Iterator[Row]:
    """One row per case, seed and controller."""
    robot = load_robot("girona_maris7_full")
    dynamics = robot_dynamics(robot)
    first = Kinematics(robot, start_of(robot)).pose("tool")
    for case in experiment.cases:
        goal_of, gusts = CASES[case]
        for seed in experiment.seeds:
            water = GustyCurrent(base=UniformCurrent(CURRENT), sigma=gusts, seed=seed)
            environment = Environment(seafloor=FlatSeafloor(z=-40), current=water)
            for name, controller in controllers(robot, dynamics, goal_of(first), experiment):
                plant = DynamicPlant(
                    robot, start_of(robot), dynamics=dynamics, environment=environment
                )
                row: dict[str, Any] = {"case": case, "controller": name, "seed": seed}
                row |= run(robot, plant, controller, goal_of(first), experiment.seconds)
                if isinstance(controller, Nmpc):
                    row |= deadlines(controller)
                yield row
