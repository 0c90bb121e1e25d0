"""A vehicle that keeps station in a gusty current, goes to small way points and moves its arm,
while actuators fail.

Or while its tool carries what the controller has to learn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.checks import replace_unchecked
from uvms_ocp.codegen.kernel_layout import assign
from uvms_ocp.control.faults.monitor import ActuatorMonitor
from uvms_ocp.control.faults.tuning import ActuatorHealthTuning
from uvms_ocp.control.force.dynamic import DynamicController
from uvms_ocp.control.load_filter import LoadLearning
from uvms_ocp.control.payload import LoadEstimate
from uvms_ocp.control.velocity.abort import ActuationFeedback
from uvms_ocp.control.velocity.kinematic import KinematicController
from uvms_ocp.estimation.estimator import Estimator, PassThrough
from uvms_ocp.estimation.fallbacks import Watchdog
from uvms_ocp.mission import Below, Mission, Phase, Transition
from uvms_ocp.record.meta_values import DONE
from uvms_ocp.robot.coefficients import links_in_water
from uvms_ocp.robot.description import TrimBody
from uvms_ocp.robot.dynamics import cached_dynamics, robot_dynamics
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import IDEAL_SENSORS, Command, State, StateEstimate, robot_sensors
from uvms_ocp.robot.static_balance import with_trim
from uvms_ocp.robot.thrusters import thrust_limits
from uvms_ocp.sim.currents import GustyCurrent, UniformCurrent
from uvms_ocp.sim.dynamic_plant import DynamicPlant
from uvms_ocp.sim.environment import Environment
from uvms_ocp.sim.seafloor import FlatSeafloor
from uvms_ocp.sim.sensors import SensorSuite
from uvms_ocp.solvers import LexicographicActiveSet
from uvms_ocp.tasks import Hierarchy, VehiclePose

DT = 1 / 200  # [s]
STATION = np.array([0.0, 0.0, -20.0])  # [m]
_WAY = np.array([1.5, 1.0, 0.7])  # [m] to the farthest way point, either way
# [1/s], [m/s], [rad/s]
_GAIN = 0.5
_FASTEST = 0.3
_FASTEST_JOINT = 0.3


@dataclass(frozen=True, kw_only=True)
class ThrusterFault:
    """A fault of one thruster gives from `onset` [s] on: ``share * asked + constant`` [N]."""

    thruster: int
    share: float = 0.0
    constant: float = 0.0
    onset: float = 10.0


@dataclass(frozen=True, kw_only=True)
class Hover:
    """One run."""

    robot: str = "girona_maris7_full"
    seed: int = 0
    faults: tuple[ThrusterFault, ...] = ()
    jam: tuple[int, float] | None = None
    """A joint and when it jams [s]."""
    duration: float = 30.0
    moves: float = 1.0
    """size of the way."""
    current: float = 0.5
    """[m/s]"""
    gusts: float = 0.05
    """[m/s] standard deviation."""
    wrong: tuple[float, float] = (1.0, 1.0)
    """true added mass and drag, in those that the controller knows."""
    watched: bool = True
    stays: float = 0.0
    """[s] for which it and its arm stay where they are."""
    noise: bool = True
    """Whether sensors have any."""
    payload: tuple[float, float] = (0.0, 0.0)
    """Mass [kg] and volume [m3] that the tool carries from the start."""
    load: LoadLearning | None = None


@dataclass(kw_only=True)
class Outcome:
    """Alarms, errors and commands of one run."""

    monitor: ActuatorMonitor | None
    alarms: list[tuple[float, str]]
    errors: np.ndarray
    """(n,) [m] true distance from where the vehicle should be at each tick."""
    commands: np.ndarray
    """(n, n_thrusters) [N]"""
    given_up: str = ""
    learnt: list[LoadEstimate] = field(default_factory=list)
    """Estimates of the load at each tick."""


def failed(command: Command, robot: Robot, faults: Sequence[ThrusterFault], t: float) -> Command:
    """Apply the faults of thrusters to a command at time t [s]."""
    assert command.thrust is not None
    thrust = np.clip(command.thrust, *thrust_limits(robot))
    for fault in faults:
        if t >= fault.onset:
            thrust[fault.thruster] = fault.share * thrust[fault.thruster] + fault.constant
    return replace_unchecked(command, thrust=thrust)


class WayPoints(KinematicController):
    """Stands in for a mission: the same in every run of a seed, and quick."""

    def __init__(self, robot: Robot, hover: Hover) -> None:
        self.robot = robot
        self.dt = DT
        self.watchdog = Watchdog()
        self.given_up = ""
        self.guide = None
        self.memory = _velocity_layer(robot).memory
        self.memory.awaits_first = False
        self._rng = np.random.default_rng(hover.seed + 1000)
        self._moves = hover.moves
        self._v = np.zeros(robot.n_v)
        self._joints = np.array(robot.home)
        self.goal = STATION.copy()
        self._yaw = 0.0
        self._next = hover.stays + float(self._rng.uniform(2.0, 6.0))

    def observe(self, estimate: StateEstimate, t: float) -> Any:
        self.estimate = estimate
        self.t = t
        assign(self.memory, q=estimate.q, v=estimate.v, t=t, joint_age=estimate.joint_age)
        return self

    def note_feedback(self, feedback: ActuationFeedback) -> None:
        self.given_up = self.given_up or feedback.fault

    def command(self, tick: Any) -> Command:
        if self.t >= self._next:
            self._choose()
        q = self.estimate.q
        limits = self.robot.limits
        R = pin.Quaternion(q[3:7]).toRotationMatrix()
        linear = _GAIN * (R.T @ (self.goal - q[:3]))
        linear *= min(1.0, _FASTEST / max(float(np.linalg.norm(linear)), 1e-9))
        angular = _GAIN * pin.log3(R.T @ pin.rpy.rpyToMatrix(0.0, 0.0, self._yaw))
        joints = np.clip(_GAIN * (self._joints - q[7:]), -_FASTEST_JOINT, _FASTEST_JOINT)
        largest = 0.8 * limits.velocity
        desired = np.clip(np.concatenate([linear, angular, joints]), -largest, largest)
        step = 0.5 * np.minimum(limits.acceleration, 5.0) * DT
        self._v = self._v + np.clip(desired - self._v, -step, step)
        assign(self.memory, command=self._v)
        return Command(v=self._v.copy())

    def _choose(self) -> None:
        rng = self._rng
        home = np.array(self.robot.home)
        self._next = self.t + float(rng.uniform(4.0, 9.0))
        self.goal = STATION + self._moves * rng.uniform(-1.0, 1.0, 3) * _WAY
        self._yaw = self._moves * float(rng.uniform(-1.0, 1.0))
        self._joints = home + 0.15 * rng.uniform(-1.0, 1.0, len(home))


def _velocity_layer(robot: Robot) -> KinematicController:
    """One whose memory the force layer reads; it is never run."""
    arrival = Below(quantity="PC.position_error", limit=0.01)
    phase = Phase(
        name="hover", activations={"PC": 1.0}, transitions=(Transition(to=DONE, when=(arrival,)),)
    )
    task = VehiclePose(goal=pin.SE3.Identity())
    mission = Mission(hierarchy=Hierarchy((task,)), phases=(phase,))
    return KinematicController(robot=robot, mission=mission, solver=LexicographicActiveSet(), dt=DT)


def run(hover: Hover) -> Outcome:
    """Simulate, by default with the noise, rates and delays of the robot's sensors."""
    robot = load_robot(hover.robot)
    rng = np.random.default_rng(hover.seed)
    plant, floor = _plant(robot, hover, rng.uniform(0.0, 2.0 * np.pi))
    specs = robot_sensors(robot.description) if hover.noise else IDEAL_SENSORS
    suite = SensorSuite(robot, floor, specs, hover.seed)
    estimator: Any = Estimator(robot, specs) if hover.noise else PassThrough(robot, specs)
    points = WayPoints(robot, hover)
    health = ActuatorHealthTuning() if hover.watched else None
    model = cached_dynamics(robot)
    controller = DynamicController(
        robot=robot, dynamics=model, kinematic=points, health=health, load=hover.load
    )
    monitor = controller.monitor
    outcome = Outcome(
        monitor=monitor,
        alarms=points.watchdog.alarms,
        errors=np.zeros(0),
        commands=np.zeros((0, 0)),
    )
    errors = []
    commands = []
    command: Command | None = None
    for k in range(round(hover.duration / DT)):
        t = k * DT
        command = controller(estimator(suite.read(plant.state, t), t, command), t)
        before = plant.state
        plant.step(failed(command, robot, hover.faults, t), DT)
        if hover.jam is not None and t >= hover.jam[1]:
            plant.state = _jammed(plant.state, before, hover.jam[0])
        errors.append(float(np.linalg.norm(plant.state.q[:3] - points.goal)))
        commands.append(command.thrust)
        if controller.learner is not None:
            outcome.learnt.append(controller.learner.loads[0])
    outcome.errors = np.array(errors)
    outcome.commands = np.array(commands)
    outcome.given_up = points.given_up
    return outcome


def _plant(robot: Robot, hover: Hover, heading: float) -> tuple[DynamicPlant, FlatSeafloor]:
    flow = hover.current * np.array([np.cos(heading), np.sin(heading), 0.05])
    current = GustyCurrent(base=UniformCurrent(flow), sigma=hover.gusts, seed=hover.seed)
    real = with_wrong_water(robot, *hover.wrong)
    floor = FlatSeafloor(z=-60.0)
    mass, volume = hover.payload
    if mass:
        load = TrimBody(
            name="load", link="tool", position=(0.0, 0.0, 0.0), mass=mass, volume=volume
        )
        real = with_trim(real, [load])
    start = np.array(robot.configuration(position=STATION))
    environment = Environment(seafloor=floor, current=current)
    plant = DynamicPlant(
        real, start, dynamics=robot_dynamics(real), environment=environment, max_step=DT
    )
    return plant, floor


def _jammed(state: State, before: State, joint: int) -> State:
    q = state.q.copy()
    v = state.v.copy()
    q[7 + joint] = before.q[7 + joint]
    v[6 + joint] = 0.0
    return State(q=q, v=v)


def with_wrong_water(robot: Robot, mass: float, drag: float) -> Robot:
    """The robot with other added mass and drag of its links that have coefficients, in shares of
    its own.
    """
    factors = {"added_mass": mass, "linear_drag": drag, "quadratic_drag": drag}
    links = {}
    for name, link in robot.description.links.items():
        nominal = link.coefficients
        if nominal is not None:
            scaled = {
                key: _scaled(getattr(nominal, key), factor) for key, factor in factors.items()
            }
            link = link.model_copy(update={"coefficients": nominal.model_copy(update=scaled)})
        links[name] = link
    description = robot.description.model_copy(update={"links": links})
    return replace(robot, description=description, hydrodynamics=links_in_water(description))


def _scaled(values: Any, factor: float) -> Any:
    if values is None:
        return None
    return tuple(np.multiply(values, factor).tolist())
