"""Simulated sensors: readings of the true state, with rate, noise, bias, delay and drop-outs."""

from __future__ import annotations

import math
from bisect import insort
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from operator import add, itemgetter
from typing import Annotated, Any

import casadi as ca
import numpy as np
import pinocchio as pin

from uvms_ocp.checks import checked_constructor, unchecked_constructor
from uvms_ocp.codegen.buffered import BoundFunction, BufferedFunction
from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot import Robot, SymbolicModel, roles, spatial
from uvms_ocp.robot.robot import require_normalized
from uvms_ocp.robot.signals import CHANNELS, Reading, Readings, SensorSpec, SensorSpecs, State
from uvms_ocp.sim.fault_effects import ChannelFaults, FaultyChannel
from uvms_ocp.sim.faults import Fault
from uvms_ocp.sim.seafloor import Seafloor
from uvms_ocp.types import Count, Shape

_reading = unchecked_constructor(Reading)
_readings = unchecked_constructor(Readings)
_state = unchecked_constructor(State)

_IDEAL = SensorSpec()

_EARLY = 1e-9  # of a period or a second: a tick that rounding puts just before a sampling time counts

Truth = Callable[[State], Any]
Disturb = Callable[[Any, np.ndarray], Any]
Source = tuple[Truth, Disturb, int]


@checked_constructor
class Altimeter:
    """Range along -z of a frame of the robot to the seafloor, without noise. Holds working memory: not for two threads."""

    def __init__(self, robot: Robot, seafloor: Seafloor, frame: str = "altimeter") -> None:
        """frame: that of the sensor. Raises `FrameNotFound` for an unknown one."""
        self.robot = robot
        self._seafloor = seafloor
        self._q, self._origin, self._direction = np.zeros(robot.n_q), np.zeros(3), np.zeros(3)
        self._look = BoundFunction(_beam_function(robot, frame), [self._q], [self._origin, self._direction])

    def measure(self, q: Annotated[np.ndarray, Shape("self.robot.n_q")]) -> float:
        """Range [m] at configuration q (n_q,) [m, rad]; nan without an echo."""
        require_normalized(self.robot.model, q)
        return self._range(q)

    def _range(self, q: np.ndarray) -> float:
        """The same at a configuration of the simulation, which is known to fit."""
        self._q[:] = q
        self._look.evaluate()
        return self._seafloor.range_along(self._origin, self._direction)


@lru_cache(maxsize=16)
def _beam_function(robot: Robot, frame: str) -> ca.Function:
    """Function ``q -> origin (3,) [m], direction (3,) `` of a range sensor, in W. Too short to be worth compiling."""
    q = ca.SX.sym("q", robot.n_q)
    R_WS, p_WS = SymbolicModel(robot.model).forward_kinematics(q).pose(frame)
    return ca.Function("beam", [q], [ca.densify(p_WS), ca.densify(-R_WS[:, 2])], ["q"], ["origin", "direction"])


@checked_constructor
class SensorSuite:
    """All sensors of a robot. Holds their last readings: build one per run and read it at increasing times.

    Every channel has its own random stream, so that changing one leaves the noise of the others as it was.
    """

    def __init__(
        self,
        robot: Robot,
        seafloor: Seafloor,
        specs: SensorSpecs | None = None,
        seed: Count = 0,
        altimeter_frame: str | None = None,
        faults: tuple[Fault, ...] = (),
    ) -> None:
        """altimeter_frame: the one of the robot's description unless given; without any there is no altimeter.

        faults: those of other things than sensors are left out. Raises `InvalidInput` for a bias of the wrong length or a fault
        of a sensor that there is not, and `FrameNotFound` for an unknown altimeter frame.
        """
        specs = specs or SensorSpecs()
        self._readings: dict[str, Reading[Any] | None] = {}
        sources = sources_of(robot, seafloor, specs, altimeter_frame)
        if robot.description.dvl is not None and "linear_velocity" in sources:
            carried_by = {} if specs.linear_velocity == _IDEAL else self._readings
            sources["linear_velocity"] = _carried_from(robot.model.frames[robot.frame_id(roles.DVL)].placement, carried_by)
        present = {name: spec for name in CHANNELS if (spec := getattr(specs, name)) is not None and name in sources}
        streams = dict(zip(CHANNELS, np.random.SeedSequence(seed).spawn(len(CHANNELS)), strict=True))
        struck = faults_of_channels(robot, faults, {name: sources[name] for name in present}, seed)
        self._ideal = [(name, sources[name][0]) for name, spec in present.items() if spec == _IDEAL and name not in struck]
        ideal = dict(self._ideal)
        self._channels = [
            (name, _Channel(name, spec, *sources[name], streams[name])) for name, spec in present.items() if name not in ideal
        ]
        for name, own in struck.items():
            dict(self._channels)[name].apply_faults(own)
        self._seen = -math.inf
        """[s] time of the last readings of the ideal ones."""

    def read(self, state: State, t: float) -> Readings:
        """The last reading of every channel at time t [s], the time of the true `state`."""
        readings = self._readings
        # Copied once for all: a reading is a part of it, and nobody who writes to one reaches the true state.
        state = _state(q=state.q.copy(), v=state.v.copy(), a=state.a)
        if t > self._seen:
            self._seen = t
            for name, truth in self._ideal:
                readings[name] = _reading(value=truth(state), t=t)
        for name, channel in self._channels:
            readings[name] = channel.read(state, t)
        return _readings(**readings)


def sources_of(robot: Robot, seafloor: Seafloor, specs: SensorSpecs, altimeter_frame: str | None) -> dict[str, Source]:
    """Return, by channel, the true value, how an error acts on it and the number of its components.

    A true specific force raises `InvalidInput` for a state without its acceleration.
    """
    joint_q, joint_v, n = robot.joint_q, robot.joint_v, robot.n_joints
    sources: dict[str, Source] = {
        "joint_positions": (lambda state: state.q[joint_q], _joint_disturbance(robot), n),
        "joint_velocities": (lambda state: state.v[joint_v], add, n),
    }
    if robot.n_vehicle:
        # A rotation vector in B turns a quaternion.
        turned = BufferedFunction(_turn_function())
        sources |= {
            "position": (lambda state: state.q[:3], add, 3),
            "depth": (lambda state: state.q.item(2), _add_scalar, 1),
            "attitude": (lambda state: state.q[3:7], (lambda quaternion, error: turned(quaternion, error)[0]), 3),
            "angular_velocity": (lambda state: state.v[3:6], add, 3),
            "linear_velocity": (lambda state: state.v[:3], add, 3),
            "specific_force": (_specific_force(robot.model.gravity.linear), add, 3),
        }
    frame = altimeter_frame or robot.description.altimeter
    if specs.altimeter_range is not None and frame is not None:
        measure = Altimeter(robot, seafloor, frame)._range
        sources["altimeter_range"] = (lambda state: measure(state.q), _add_scalar, 1)
    return sources


def _carried_from(X_BD: pin.SE3, readings: Mapping[str, Reading[Any] | None]) -> Source:
    """A Doppler log at X_BD [m]: errors are along its axes, and a gyroscope's reading, if any, carries it to the origin of B."""
    S_BD, R_BD = pin.skew(X_BD.translation), X_BD.rotation.copy()

    def truth(state: State) -> np.ndarray:
        gyroscope = readings.get("angular_velocity")
        return state.v[:3] if gyroscope is None else state.v[:3] - S_BD @ (state.v[3:6] - gyroscope.value)

    return truth, lambda value, error: value + R_BD @ error, 3


def faults_of_channels(
    robot: Robot, faults: Sequence[Fault], sources: Mapping[str, Source], seed: int = 0
) -> dict[str, ChannelFaults]:
    """Return the faults of sensors by channel, fresh for a run. sources: of the channels that there are, of `sources_of`.

    Raises `InvalidInput` for a fault of another channel; those of other things than sensors are left out.
    """
    found: dict[str, list[Fault]] = {}
    for fault in faults:
        channel = fault.location.channel
        if channel and channel not in sources:
            raise InvalidInput(f"{fault}: there is no sensor {channel}; there are {', '.join(sources)}")
        if channel:
            found.setdefault(channel, []).append(fault)
    streams = {name: np.random.SeedSequence([seed, int.from_bytes(name.encode(), "big")]) for name in found}
    return {name: ChannelFaults(_struck(robot, name, *sources[name][1:]), own, streams[name]) for name, own in found.items()}


def _struck(robot: Robot, name: str, disturb: Disturb, n: int) -> FaultyChannel:
    """A channel as its faults need it."""
    neutral = pin.neutral(robot.model)
    origins = {"attitude": np.array([0.0, 0.0, 0.0, 1.0]), "joint_positions": neutral[robot.joint_q]}
    joints = robot.joints if name.startswith("joint_") else ()
    return FaultyChannel(name=name, disturb=disturb, n=n, origin=origins.get(name), joints=joints)


def _specific_force(gravity: np.ndarray) -> Truth:
    """Compute the specific force at the origin of B, in B; gravity (3,) [m/s2] in W."""

    def force(state: State) -> np.ndarray:
        if state.a is None:
            raise InvalidInput("specific_force needs the acceleration of the true state; give State(a=...), as plants do")
        of_axes = np.cross(state.v[3:6], state.v[:3])  # v is that of B in B, whose axes turn
        return np.asarray(state.a[:3] + of_axes - spatial.quaternion_to_matrix(state.q[3:7]).T @ gravity)

    return force


def _add_scalar(value: float, error: np.ndarray) -> float:
    return value + float(error[0])


@lru_cache(maxsize=1)
def _turn_function() -> ca.Function:
    quaternion, error = ca.SX.sym("quaternion", 4), ca.SX.sym("error", 3)
    return ca.Function("turn", [quaternion, error], [spatial.quaternion_multiply(quaternion, spatial.quaternion_exp(error))])


def _joint_disturbance(robot: Robot) -> Disturb:
    """Joints whose configuration is not a vector space (cos, sin) move along their manifold."""
    if all(joint.n_q == joint.n_v for joint in robot.joints):
        return add
    model, q, v = robot.model, pin.neutral(robot.model), np.zeros(robot.n_v)

    def disturb(joints: np.ndarray, error: np.ndarray) -> np.ndarray:
        q[robot.joint_q], v[robot.joint_v] = joints, error
        return pin.integrate(model, q, v)[robot.joint_q]

    return disturb


class _Channel:
    """One sensor: takes a reading at the first tick of each of its periods, delivers it after its delay."""

    def __init__(
        self, name: str, spec: SensorSpec, truth: Truth, disturb: Disturb, n: int, stream: np.random.SeedSequence
    ) -> None:
        if len(spec.biases) not in (1, n):
            raise InvalidInput(f"bias of {name} has {len(spec.biases)} entries; give a number or {n} numbers")
        self._rate, self._delay, self._sigma, self._dropout = spec.rate, spec.delay, spec.sigma, spec.dropout
        self._exact, self._truth, self._disturb, self._n = spec.exact, truth, disturb, n
        # Two streams, so that drop-outs leave the noise of the other readings as it was.
        self._noise, self._losses = (np.random.default_rng(child) for child in stream.spawn(2))
        self._bias, self._biased = np.broadcast_to(np.array(spec.biases), (n,)), any(spec.biases)
        self._due = -math.inf
        """[s] time of the next reading."""
        self._last: Reading[Any] | None = None
        self._taken = -math.inf
        """[s] when the last reading was taken, whatever its stamp says."""
        self._under_way: list[tuple[float, float, Reading[Any]]] = []
        """When each arrives and was taken [s], in order of arrival."""
        self._faults: ChannelFaults | None = None

    def apply_faults(self, faults: ChannelFaults) -> None:
        """Have these faults from now on."""
        self._faults = faults

    def read(self, state: State, t: float) -> Reading[Any] | None:
        if t >= self._due:
            self._sample(state, t)
        while self._under_way and t >= self._under_way[0][0] - _EARLY:
            _, taken, reading = self._under_way.pop(0)
            if taken > self._taken:  # a newer one may have overtaken it
                self._taken, self._last = taken, reading
        return self._last

    def _sample(self, state: State, t: float) -> None:
        rate = self._rate
        self._due = t if rate == math.inf else (math.floor(t * rate + _EARLY) + 1 - _EARLY) / rate
        value = self._truth(state)
        if not self._exact:
            error = self._noise.standard_normal(self._n)
            error *= self._sigma
            if self._biased:
                error += self._bias
            value = self._disturb(value, error)
        if not (self._dropout and self._losses.random() < self._dropout):
            if self._faults is None:
                self._under_way.append((t + self._delay, t, _reading(value=value, t=t)))
            elif (sample := self._faults(value, t)) is not None:
                arrival = t + self._delay + sample.extra_delay
                insort(self._under_way, (arrival, t, _reading(value=sample.value, t=sample.stamp)), key=itemgetter(0))
