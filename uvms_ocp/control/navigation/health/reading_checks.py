"""All that can be said against one new reading before the filter sees it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from uvms_ocp.control.navigation.health.channel_state import ChannelState
from uvms_ocp.control.navigation.health.floor_watch import Belief, FloorWatch, spot_of
from uvms_ocp.control.navigation.health.history import Estimate, History
from uvms_ocp.control.navigation.health.plausible import Gate, confirmed, gates_of
from uvms_ocp.control.navigation.health.repeats import Repeats
from uvms_ocp.control.navigation.health.sanity import mistimed, nonsense, shapes_of
from uvms_ocp.control.navigation.health.still_encoders import StillEncoders
from uvms_ocp.control.navigation.health.tuning import HealthTuning
from uvms_ocp.model.kinematics import STEEP, AltimeterBeam
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.sensing import SensorSpec
from uvms_ocp.model.state import Command, Reading

_NOTHING = Belief(used=True, why=None)
_WHOLE = ("attitude",)  # whose components cannot be judged one by one: some hardly change


class ReadingChecks:
    """Sense, time stamp, repetition, and what the estimate at the time of the reading allows. Build one per run."""

    def __init__(
        self,
        robot: Robot,
        specs: Mapping[str, SensorSpec],
        states: Mapping[str, ChannelState],
        tuning: HealthTuning,
        altimeter_frame: str | None,
    ) -> None:
        """specs, states: of every channel that the robot has."""
        self._specs, self._states, self._tuning, self._shapes = specs, states, tuning, shapes_of(robot)
        self._dt = 0.0
        self._gates = gates_of(robot, specs, tuning)
        self._repeats = {
            name: Repeats(spec.sigma, each=_each(robot, name), chance=tuning.chance) for name, spec in specs.items()
        }
        encoders = specs.get("joint_positions")
        self._encoders = StillEncoders(
            robot, delay=0.0 if encoders is None else encoders.delay, travel=tuning.encoder_travel
        )
        self._beam = AltimeterBeam(robot, altimeter_frame) if "altimeter_range" in specs and altimeter_frame else None
        self._floor = FloorWatch(specs["altimeter_range"].sigma if self._beam else 0.0, tuning)

    def begin(self, command: Command | None, dt: float) -> None:
        """A tick, dt [s] after the last one, during which the command has been acting."""
        self._dt = dt
        self._encoders.ask(command, dt)

    def belief(self, name: str, reading: Reading[Any], t: float, history: History) -> Belief:
        """Whether to use a new reading of a channel at time t [s]."""
        state = self._states[name]
        last = -math.inf if state.used is None else state.used.t
        why = nonsense(name, reading, self._shapes.get(name))
        if why is None:
            why = mistimed(reading.t, last, t, self._tuning.clock)
        if why is None:
            why = self._by_itself(name, reading, t)
        if why is not None:
            return Belief(used=False, why=why, sane=False)
        belief = self._against_estimate(name, reading, history)
        return belief if belief.why else Belief(used=True, why=self._late(name, reading, t))

    def _by_itself(self, name: str, reading: Reading[Any], t: float) -> str | None:
        """What values alone and their age say."""
        age = t - reading.t - self._specs[name].delay
        if age > self._tuning.too_late:
            return f"late by {age:.3g} s, more than can be made use of"
        if is_empty(name, reading):
            return None
        if name == "joint_positions" and (why := self._encoders.frozen(reading.value)):
            return why
        gate = self._gates.get(name)
        return self._repeats[name].frozen(reading.value) or (gate.impossible(reading.value) if gate else None)

    def _late(self, name: str, reading: Reading[Any], t: float) -> str | None:
        """t [s]: when it came."""
        age = t - reading.t - self._specs[name].delay
        return f"late by {age:.3g} s" if age > self._tuning.late + self._dt else None

    def _against_estimate(self, name: str, reading: Reading[Any], history: History) -> Belief:
        estimate = history.at(reading.t)
        if estimate is None or is_empty(name, reading):
            return _NOTHING
        if name == "altimeter_range":
            return self._echo(reading, estimate)
        gate = self._gates.get(name)
        return _NOTHING if gate is None else self._gated(gate, self._states[name], reading, estimate)

    def _gated(self, gate: Gate, state: ChannelState, reading: Reading[Any], estimate: Estimate) -> Belief:
        carried = any(name in self._states and self._states[name].is_good for name in gate.by)
        last = reading.t if state.taken is None else state.taken
        why = gate.objection(reading, estimate, last, carried=carried)
        if why is None:
            state.agreed += 1
            return _NOTHING
        if confirmed(state.agreed):
            return Belief(used=False, why=why)
        state.agreed = 0
        return Belief(used=True, why=None)

    def _echo(self, reading: Reading[Any], estimate: Estimate) -> Belief:
        beam = None if self._beam is None else self._beam.at(estimate.q)
        if beam is None or beam.cosine <= STEEP:
            return _NOTHING
        return self._floor.belief(spot_of(beam, float(reading.value), reading.t))


def is_empty(name: str, reading: Reading[Any]) -> bool:
    """Whether it is an echo that did not come back."""
    return name == "altimeter_range" and math.isnan(reading.value)


def _each(robot: Robot, name: str) -> bool:
    joints = name not in ("joint_positions", "joint_velocities") or robot.n_joints == len(robot.home)
    return joints and name not in _WHOLE
