"""Dynamic control layer: forces and torques that make the robot follow reference velocities
([Gao2022] figure 4).
"""

from __future__ import annotations

from functools import lru_cache, partial

import numpy as np

from uvms_ocp.checks import (
    checked,
    checked_constructor,
    checked_dataclass,
    replace_unchecked,
    unchecked_constructor,
)
from uvms_ocp.codegen.kernel_layout import number_in_memory
from uvms_ocp.codegen.kernels import bind_kernels
from uvms_ocp.codegen.sequence import Source, Step, values_of
from uvms_ocp.control.faults.monitor import ActuatorMonitor
from uvms_ocp.control.faults.residual_filter import residual_filter_for
from uvms_ocp.control.faults.tuning import ActuatorHealthTuning
from uvms_ocp.control.force import thruster_lag, tick_functions, velocity_law
from uvms_ocp.control.force.observer import DisturbanceObserver, ObserverLaw
from uvms_ocp.control.force.tick import ForceTick, ask_forces, hear_forces
from uvms_ocp.control.load_filter import LoadLearning
from uvms_ocp.control.payload import LoadLearner, heaviest_load, require_learnable
from uvms_ocp.control.velocity.abort import ActuationFeedback
from uvms_ocp.control.velocity.kinematic import KinematicController
from uvms_ocp.errors import InvalidInput
from uvms_ocp.record.display import SmallTable, TableDisplay, rows_of
from uvms_ocp.robot import Command, Robot, SensorSpecs, StateEstimate, thrusters
from uvms_ocp.robot.dynamics import Dynamics
from uvms_ocp.types import Lead, Magnitude

_feedback = unchecked_constructor(ActuationFeedback)

DEFAULT_FAULT_TUNING = ActuatorHealthTuning()
"""Tuning of the search for faulty thrusters and joints, by default."""
_NEARLY = 0.999  # of a limit of thrust counts as at it


def is_at_limit(thrust: float, lower: float, upper: float) -> bool:
    """Return whether a thrust [N] is at a limit [N]. A kernel."""
    return not (_NEARLY * lower < thrust and thrust < _NEARLY * upper)


@checked_dataclass()
class VelocityGains:
    """Gains of the velocity loop, in units of the closed loop: the model takes care of mass and
    water.

    Raises `InvalidInput` for a gain below 0 or a lead below 1.
    """

    vehicle: Magnitude = 3.0
    """[1/s] proportional."""
    joints: Magnitude = 12.0
    """[1/s]"""
    vehicle_reset: Magnitude = 1.0
    """[1/s] inverse integral time: how fast the integral takes over."""
    joints_reset: Magnitude = 3.0
    """[1/s]"""
    observer_vehicle: Magnitude = 3.0
    """[rad/s] bandwidth of the disturbance observer; 0 turns it off."""
    observer_joints: Magnitude = 4.0
    """[rad/s]"""
    lead: Lead = 4.0
    """Thrusters are driven this many times faster than their lag."""


@checked_constructor
class DynamicController(TableDisplay):
    """Tracks the velocities of a kinematic layer: a callable ``(StateEstimate, t) -> Command`` with
    thrust and torque.

    The force of `VelocityLaw` less the disturbance of an `ObserverLaw`, shared out by an
    `Allocation`; thrusters are inverted through their lag.
    """

    def __init__(
        self,
        *,
        robot: Robot,
        dynamics: Dynamics,
        kinematic: KinematicController,
        gains: VelocityGains | None = None,
        health: ActuatorHealthTuning | None = DEFAULT_FAULT_TUNING,
        sensors: SensorSpecs | None = None,
        load: LoadLearning | None = None,
    ) -> None:
        """health: thresholds of the search for faulty thrusters and joints; `None` turns it off.

        sensors: what is known of their delays, by which the loops are slower than `gains`; not late
        unless given. load: how what the tool carries is learnt; `None` learns nothing. Raises
        `InvalidInput` for a vehicle without thrusters, for a kinematic controller of another robot
        and for learning without the observer, or where an axis bears no force or any;
        `FrameNotFound` for learning without a tool.
        """
        if robot.n_vehicle and not robot.description.thrusters:
            raise InvalidInput(
                f"robot {robot.name!r} has no thrusters; give some in its YAML, or use the"
                " kinematic plant"
            )
        self.kinematic = kinematic
        gains = gains or VelocityGains()
        self._robot = robot
        dead_times = velocity_law.DeadTimes()
        if sensors is not None:
            dead_times = velocity_law.dead_times(sensors)
        derating = velocity_law.bandwidth_derating(
            dead_times, vehicle=gains.vehicle, joints=gains.joints, dt=kinematic.dt
        )
        measures_joint_rates = sensors is not None and sensors.joint_velocities is not None
        laws = _laws(robot, dynamics, gains, health, derating, measures_joint_rates, kinematic.dt)
        self._tick = ForceTick(laws)
        self.memory = self._tick.memory
        """Memory of the force layer, a `ForceMemory`."""
        # Parts of it are made anew whenever they are asked for.
        self._detection = self.memory.detection
        self._allocation = self.memory.allocation
        self.monitor: ActuatorMonitor | None = None
        if laws.search is not None:
            self.monitor = ActuatorMonitor(robot, self._detection, kinematic.watchdog.alarms)
        """Monitor of thrusters and joints; `None` where it is off, and without the observer, whose
        findings it reads.
        """
        self._fault = ""
        self._fault_summary = ""
        self._jammed = tuple[int, ...]()
        self._at_limits = ""
        self.learner = None if load is None else _learner(laws, load)
        """Learner of the tool's load; `None` where nothing is learnt."""
        self._loads = dict[str, np.ndarray]()
        if self.learner is not None:
            for name, value in self.learner.telemetry().items():
                self._loads[name] = np.array(value, dtype=float)
        n_q = len(kinematic.memory.q)
        n_v = len(kinematic.memory.v)
        if (n_q, n_v) != (robot.n_q, robot.n_v):
            raise InvalidInput(
                f"kinematic: for {n_v} axes and configurations of {n_q} numbers, while robot"
                f" {robot.name!r} has {robot.n_v} and {robot.n_q}; give one of the same robot"
            )
        self._hear_forces, self._ask_forces = bind_kernels(
            (hear_forces, ask_forces), (type(kinematic.memory), type(self.memory))
        )

    def __call__(self, estimate: StateEstimate, t: float) -> Command:
        """Return the command for the tick at time t [s]."""
        memories = (self.kinematic.memory, self.memory)
        tick = self.kinematic.observe(estimate, t)
        self._hear_forces(*memories)
        command = self.kinematic.command(tick)
        self._ask_forces(*memories)
        if self.kinematic.guide is not None:
            self._tick.inputs.feedback[0] *= self.kinematic.guide.bandwidth
        outputs = self._ticked()
        self._report(tick.t)
        return self._to_command(command, outputs)

    @property
    def force(self) -> ForceTick:
        """The force layer."""
        return self._tick

    def steps(self) -> list[Step]:
        """Return the steps of the force layer in a tick, once the velocity layer has left its
        command in memory.
        """
        asking = Step("ask_forces", self._ask_forces, (self.kinematic.memory, self.memory))
        forcing = Step("force", self._tick.kernel, (self.memory,))
        if self.learner is None:
            return [asking, forcing]
        return [
            asking,
            Step("carry_load", partial(self._carry_load, self.learner)),
            forcing,
            Step("learn_load", partial(self._learn_load, self.learner)),
        ]

    def _carry_load(self, learner: LoadLearner) -> None:
        """Turn the learnt load with the arm, before the tick."""
        inputs = self._tick.inputs
        learner.carry(inputs.q, inputs.v, self._tick.state.estimate)

    def _learn_load(self, learner: LoadLearner) -> None:
        """Learn from what the tick has observed."""
        inputs = self._tick.inputs
        observed = self._tick.observed
        learner.learn(inputs.q, inputs.v, observed.estimate, observed.share, self._tick.observes)
        for name, value in learner.telemetry().items():
            self._loads[name][...] = value

    def load_series(self) -> dict[str, Source]:
        """Return the series of the load that is learnt, in memory; empty where nothing is."""
        return {**self._loads}

    def force_series(self) -> dict[str, Source]:
        """Return the series of the force layer for the record, on the memory that the newest tick
        has left; verdicts on thrusters and joints are those of `monitor`.
        """
        outputs = self._tick.places()
        return {
            "disturbance": outputs["disturbance"],
            "wrench": outputs["vehicle_force"],
            "unreachable": outputs["unreachable"],
            "saturated": number_in_memory(self.memory.allocation, "saturated"),
        }

    @checked
    def catch_up(
        self, estimate: StateEstimate, t: float, ticks: int, at_limits: tuple[int, ...]
    ) -> None:
        """Take note of what kernels alone have done for so many ticks, the last with this estimate
        at t [s].

        at_limits: which thrusters were at their limits when they last were, up to the tick before.
        """
        self._tick.require_possible()
        self._name_thrusters(at_limits)
        distress = self.kinematic.memory.distress  # of the force layer in the tick before
        feedback = self._feedback(bool(distress.short), distress.push, distress.spent)
        self.kinematic.catch_up(estimate, t, ticks, feedback)
        self._report(t)

    def _report(self, t: float) -> None:
        """Log at time t [s] that brakes were locked, that a locked joint seems to move, and what fault
        detection has changed.
        """
        joint = self.memory.overspeed.joint
        if joint >= 0:
            lock = self.memory.overspeed.lock
            name = self._robot.joint_of_axis[joint]
            what = "about to be faster than it may, unasked"
            if self.memory.overspeed.shaking:
                what = "shakes unasked"
            alarm = f"{name} {what}: brakes locked for {lock:g} s at least"
            self.kinematic.watchdog.alarms.append((t, alarm))
        moving = self.memory.overspeed.moving
        if moving >= 0:
            name = self._robot.joint_of_axis[moving]
            alarm = f"{name} seems to move though brakes lock it: its readings are wrong, it stays locked"
            self.kinematic.watchdog.alarms.append((t, alarm))
        if self._detection.changed and self.monitor is not None:
            self._update_monitor(self.monitor, t)

    def _feedback(self, short: bool, push: float, spent: float) -> ActuationFeedback:
        return _feedback(
            short=short,
            push=push,
            spent=spent,
            fault=self._fault,
            fault_summary=self._fault_summary,
            jammed=self._jammed,
            at_limits=self._at_limits,
        )

    def _name_thrusters(self, at_limits: tuple[int, ...]) -> None:
        self._at_limits = ", ".join(f"thruster{number + 1}" for number in at_limits)

    def _table(self) -> SmallTable:
        faults = "not searched for"
        if self.monitor is not None:
            faults = self._fault_summary or "none found"
        values = {
            "bandwidth borne by the vehicle [-]": self.memory.bandwidth_share,
            "bandwidth borne by the joints [-]": self.memory.joint_bandwidth_share,
            "faults of thrusters and joints": faults,
            "load of the tool": "not learnt" if self.learner is None else "learnt",
        }
        below = self.kinematic._table()
        return SmallTable(title=type(self).__name__, rows=(*below.rows, *rows_of(values)))

    def _ticked(self) -> list[np.ndarray]:
        """Run the force tick, with what is learnt of the load; return the parts of
        `ForceOutputs`.
        """
        if self.learner is None:
            return self._tick.step()
        self._carry_load(self.learner)
        outputs = self._tick.step()
        self._learn_load(self.learner)
        return outputs

    def _to_command(self, command: Command, outputs: list[np.ndarray]) -> Command:
        """Make the command of these outputs, and tell the layer below what the thrusters met."""
        thrust, torque, *_, push = outputs
        allocation = self._allocation
        short = bool(self._allocation.saturated)
        if short:
            self._name_thrusters(
                tuple(
                    i
                    for i in range(allocation.count)
                    if is_at_limit(thrust[i], allocation.lower[i], allocation.upper[i])
                )
            )
        spent = self._tick.state.spent.item()
        self.kinematic.note_feedback(self._feedback(short, push.item(), spent))
        telemetry = {**command.telemetry, **values_of(self.force_series()), "saturated": short}
        if self.monitor is not None:
            telemetry |= self.monitor.telemetry()
        telemetry |= values_of(self.load_series())
        return replace_unchecked(
            command,
            thrust=thrust,
            torque=torque,
            brakes=bool(self.memory.locks),
            telemetry=telemetry,
        )

    def _update_monitor(self, monitor: ActuatorMonitor, t: float) -> None:
        """Report what fault detection found at time t [s], and leave jammed joints alone."""
        detection = self._detection
        monitor.update(t)
        if detection.jam or detection.thruster >= 0:
            n = self._robot.n_vehicle
            joints = detection.joints
            self._jammed = tuple(n + j for j in range(joints.count) if joints.jammed[j])
            self._fault_summary = monitor.faulty
            if self.learner is not None:
                self.learner.leave(self._jammed)
        self._fault = ""
        if self.memory.gives_up:
            self._fault = f"{self._fault_summary}: {monitor.authority}"


@lru_cache(maxsize=8)
def _laws(
    robot: Robot,
    dynamics: Dynamics,
    gains: VelocityGains,
    health: ActuatorHealthTuning | None,
    derating: velocity_law.BandwidthDerating,
    measures_joint_rates: bool,
    dt: float,
) -> tick_functions.ForceLaws:
    """Return the laws of a robot, one object for many runs, so that what is derived from them is
    made once; dt [s].
    """
    has_observer = gains.observer_vehicle and robot.n_vehicle
    search = health if has_observer else None
    residual_filter = None
    if search is not None:
        bandwidth = derating.vehicle * gains.observer_vehicle
        residual_filter = residual_filter_for(search, bandwidth=bandwidth, dt=dt)
    return tick_functions.ForceLaws(
        robot=robot,
        velocity=velocity_law.VelocityLaw(
            dynamics=dynamics.symbolic,
            K_p=_per_axis(robot, gains.vehicle, gains.joints),
            reset=_per_axis(robot, gains.vehicle_reset, gains.joints_reset),
            dt=dt,
        ),
        lag=thruster_lag.thruster_lag(robot, lead=gains.lead, dt=dt),
        lift=float(thrusters.largest_wrench(robot)[2]),
        derating=derating,
        measures_joint_rates=measures_joint_rates,
        observer=_observer_law(robot, gains, dt),
        residual_filter=residual_filter,
        search=search,
    )


def _learner(laws: tick_functions.ForceLaws, settings: LoadLearning) -> LoadLearner:
    observer = laws.observer
    require_learnable(laws.robot, observed=observer is not None)
    assert observer is not None
    return LoadLearner(
        laws.velocity.dynamics,
        observer.response,
        settings,
        tools=laws.robot.tools,
        limit=observer.limit,
        bandwidth=observer.bandwidth,
        heaviest=heaviest_load(laws.robot),
        dt=observer.dt,
    )


def _per_axis(robot: Robot, vehicle: float, joints: float) -> np.ndarray:
    return np.concatenate([np.full(robot.n_vehicle, vehicle), np.full(robot.n_joints, joints)])


def _observer_law(robot: Robot, gains: VelocityGains, dt: float) -> ObserverLaw | None:
    if not gains.observer_vehicle:
        return None
    joint_bandwidth = gains.observer_joints or gains.observer_vehicle
    return ObserverLaw(
        bandwidth=_per_axis(robot, gains.observer_vehicle, joint_bandwidth),
        limit=thrusters.largest_force(robot),
        dt=dt,
    )


def observer_of(
    robot: Robot,
    dynamics: Dynamics,
    gains: VelocityGains,
    dt: float,
    current: np.ndarray | None = None,
) -> DisturbanceObserver | None:
    """Return the observer that `gains` ask for, at control period dt [s]; None where its bandwidth is 0.

    current (3,) [m/s] in W: as far as it is known.
    """
    law = _observer_law(robot, gains, dt)
    if law is None:
        return None
    return DisturbanceObserver(law, dynamics.symbolic, robot.n_q, current)
