"""Ways in which one channel fails, as functions of its right reading and the time, with a memory of
their own.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import Command, Reading, Readings, State, StateEstimate
from uvms_ocp.sim.sensors import SensorSuite

Corrupt = Callable[[Reading[Any], float], Reading[Any]]
DT = 0.02
"""[s] between readings of `told_on_a_way`."""

STEPS: dict[str, Any] = {
    "position": np.array([50.0, 0.0, 0.0]),
    "depth": 2.0,
    "attitude": np.array([0.0, 0.0, 0.5]),
    "angular_velocity": np.array([0.6, 0.0, 0.0]),
    "linear_velocity": np.array([5.0, 0.0, 0.0]),
    "joint_positions": 0.5,
    "altimeter_range": 100.0,
}
"""By channel, what a jump adds [unit of the channel]."""


def added(name: str, value: Any, step: Any) -> Any:
    """The value with a step on top; of an attitude a rotation vector in B."""
    if name == "attitude":
        return (pin.Quaternion(value) * pin.Quaternion(pin.exp3(step))).coeffs()
    return value + step


def frozen(name: str) -> Corrupt:
    """The first value for ever, with time stamps that go on."""
    first: list[Any] = []

    def corrupt(reading: Reading[Any], t: float) -> Reading[Any]:
        first[1:] = []
        first.append(reading.value)
        return replace(reading, value=first[0])

    return corrupt


def stuck(name: str) -> Corrupt:
    """A value far off, the same for ever."""
    freeze = frozen(name)

    def corrupt(reading: Reading[Any], t: float) -> Reading[Any]:
        reading = freeze(reading, t)
        return replace(reading, value=added(name, reading.value, STEPS[name]))

    return corrupt


def not_a_number(name: str) -> Corrupt:
    return lambda reading, t: replace(reading, value=reading.value * np.nan)


def future(name: str) -> Corrupt:
    return lambda reading, t: replace(reading, t=reading.t + 0.5)


def jump(name: str) -> Corrupt:
    return lambda reading, t: replace(reading, value=added(name, reading.value, STEPS[name]))


def bias(name: str) -> Corrupt:
    """A fifth of a jump."""
    return lambda reading, t: replace(reading, value=added(name, reading.value, 0.8 * STEPS[name]))


def spikes(name: str) -> Corrupt:
    """Every third reading is far off, first up, then down."""
    values: list[float] = []

    def corrupt(reading: Reading[Any], t: float) -> Reading[Any]:
        if not values or values[-1] != reading.t:
            values.append(reading.t)
        sign = (0.0, 1.0, -1.0)[len(values) % 3]
        return replace(reading, value=added(name, reading.value, sign * STEPS[name]))

    return corrupt


def lost(name: str) -> Corrupt:
    """The last reading for ever."""
    last: list[Reading[Any]] = []

    def corrupt(reading: Reading[Any], t: float) -> Reading[Any]:
        last.append(reading)
        return last[0]

    return corrupt


def late(name: str, delay: float = 0.3) -> Corrupt:
    """What was read `delay` [s] ago."""
    queue: deque[Reading[Any]] = deque()

    def corrupt(reading: Reading[Any], t: float) -> Reading[Any]:
        queue.append(reading)
        while len(queue) > 1 and queue[1].t <= t - delay:
            queue.popleft()
        return queue[0]

    return corrupt


DEFECTS: dict[str, Callable[[str], Corrupt]] = {
    "frozen": frozen,
    "stuck": stuck,
    "nan": not_a_number,
    "future": future,
    "jump": jump,
    "bias": bias,
    "spikes": spikes,
    "lost": lost,
    "late": late,
}


def told_on_a_way(
    guard: Callable[[Readings, float, Command], StateEstimate],
    robot: Robot,
    suite: SensorSuite,
    channel: str,
    defect: str,
) -> list[StateEstimate]:
    """Of a robot that moves on straight, with a defect of one channel after 2 s."""
    corrupt = DEFECTS[defect](channel)
    told = []
    q = robot.configuration(position=(0.0, 0.0, -36.0))
    v = np.full(robot.n_v, 0.01)
    for k in range(200):
        readings = suite.read(State(q=q, v=v), k * DT)
        t = k * DT
        q = np.concatenate([q[:3] + DT * v[:3], q[3:]])
        if t > 2.0 and getattr(readings, channel) is not None:
            readings = with_defect(readings, channel, corrupt, t)
        told.append(guard(readings, t, Command(v=v)))
    return told


def with_defect(readings: Readings, name: str, corrupt: Corrupt, t: float) -> Readings:
    """The readings, those of one channel corrupted."""
    return replace(readings, **{name: corrupt(getattr(readings, name), t)})
