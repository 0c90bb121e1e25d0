"""Pairs of channels that tell of the same motion, and which of a pair is to blame."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from uvms_ocp.control.navigation.health.channel_state import ChannelState
from uvms_ocp.control.navigation.health.disagreement import (
    DepthAgainstPosition,
    RateAgainstAttitude,
    VelocityAgainstPosition,
)
from uvms_ocp.control.navigation.health.history import Estimate
from uvms_ocp.model.health import Trust
from uvms_ocp.model.sensing import SensorSpec
from uvms_ocp.model.state import Reading

_RECENT = 10.0  # [s] for which a refused reading speaks against its channel when it comes to blame


class Quarrel(NamedTuple):
    """Two channels that cannot both be right."""

    channels: tuple[str, str]
    why: str
    likely: str = ""
    """The one to blame where nothing else tells, if it is known."""
    bars: bool = False
    """The one that is blamed is not used until they agree again: the filter cannot find out by itself."""


class CrossChecks:
    """Hears every reading that is used. Build one per run."""

    def __init__(self, specs: Mapping[str, SensorSpec]) -> None:
        """specs: of every channel that the robot has."""
        noise = {name: spec.sigma + max(map(abs, spec.biases)) for name, spec in specs.items()}
        position, attitude, depth = (noise.get(name, 0.0) for name in ("position", "attitude", "depth"))
        self._velocity = VelocityAgainstPosition(position)
        self._rate = RateAgainstAttitude(attitude)
        self._depth = DepthAgainstPosition(float(np.hypot(position, depth)))

    def hear(self, name: str, reading: Reading[Any], estimate: Estimate) -> tuple[Quarrel, ...]:
        """What the reading of a channel makes clear; the estimate is that of when it was taken."""
        value, t = reading.value, reading.t
        if name == "position":
            return self._fix(value, t, estimate)
        if name == "linear_velocity":
            self._velocity.velocity(_in_world(estimate, value), t)
        elif name == "depth":
            self._depth.depth(float(value), t)
        elif name == "angular_velocity":
            self._rate.rate(value, t)
        elif name == "attitude" and (why := self._rate.attitude(value, t)):
            return (Quarrel(("angular_velocity", "attitude"), why, likely="angular_velocity"),)
        return ()

    def _fix(self, p: np.ndarray, t: float, estimate: Estimate) -> tuple[Quarrel, ...]:
        moving = self._velocity.position(p, t)
        deep = self._depth.position(p, _in_world(estimate, estimate.v[:3]), t)
        velocity = ("linear_velocity", "position")
        found = (
            Quarrel(velocity, moving, likely="linear_velocity", bars=True) if moving else None,
            Quarrel(("depth", "position"), deep) if deep else None,
        )
        return tuple(quarrel for quarrel in found if quarrel)


_RIVALS = {
    "attitude": ("angular_velocity",),
    "angular_velocity": ("attitude",),
    "position": ("linear_velocity", "depth"),
    "depth": ("position", "linear_velocity"),
    "linear_velocity": ("position",),
}


def is_contested(channel: str, states: Mapping[str, ChannelState]) -> bool:
    """Whether a suspect channel may be why the estimate does not agree with this one."""
    rivals = (states[name] for name in _RIVALS.get(channel, ()) if name in states)
    return any(rival.verdict.trust is Trust.SUSPECT for rival in rivals)


def blamed(quarrel: Quarrel, states: Mapping[str, ChannelState], t: float) -> tuple[str, ...]:
    """The one of the two whose readings were refused not long before time t [s]; otherwise the likely one, or both.

    Where a rate drifts from attitudes or fixes it is the rate that is biased: those jump, which is refused.
    """
    there = tuple(name for name in quarrel.channels if name in states)
    guilty = tuple(name for name in there if t - states[name].impossible_at <= _RECENT)
    if len(guilty) == 1:
        return guilty
    return (quarrel.likely,) if quarrel.likely in there else there


def _in_world(estimate: Estimate, v_B: np.ndarray) -> np.ndarray:
    return pin.Quaternion(estimate.q[3:7]) * v_B
