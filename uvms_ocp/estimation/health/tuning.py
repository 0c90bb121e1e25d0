"""Tuning of the health monitor, and the reasons why a channel is not good."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import IntEnum
from importlib.resources import files
from typing import Any

import tomllib

from uvms_ocp.checks import checked_dataclass
from uvms_ocp.codegen.kernel_layout import Layout
from uvms_ocp.robot.channels import UNITS
from uvms_ocp.types import Positive

_TEXTS: dict[str, str] = tomllib.loads(
    (files("uvms_ocp.estimation.health") / "reasons.toml").read_text(encoding="utf-8")
)


@checked_dataclass()
class HealthTuning:
    """Bounds of what robot, water and floor make possible. Raises `InvalidInput` for a number that
    is not finite and > 0.
    """

    clean: Positive = 1.0
    """[s] without complaint after which a channel is good again: five readings of a 5 Hz sensor."""
    clock: Positive = 0.001
    """[s] by which a time stamp may lie in the future: the difference of clocks that are kept
    together.
    """
    late: Positive = 0.02
    """[s] beyond its delay after which a reading is late: 2 cm at 1 m/s."""
    current: Positive = 1.0
    """[m/s] of water, which moves a vehicle beyond its own velocity limits."""
    slope: Positive = 3.0
    """Slope of a floor; the steepest way over 1350 lines across floors with large protuberances is
    2.8.
    """
    relief: Positive = 10.0
    """[m] of the highest step of a floor: nearly twice the highest of large protuberances."""


# Why a channel is not good: codes and the numbers that their texts need, for kernels, and the
# texts, for people.


class Reason(IntEnum):
    """Complaint against a channel."""

    NONE = 0
    STAMP = 1
    SHAPE = 2
    NO_NUMBER = 3
    LENGTH = 4
    RANGE = 5
    FUTURE = 6
    BEFORE = 7
    TOO_LATE = 8
    STILL = 9
    REPEATED = 10
    LARGE = 11
    OFF = 12
    LATE = 13
    NEARER = 14
    AS_BEFORE = 15
    FARTHER = 16
    DRIFT = 17
    """Largest difference of DVL and position fixes."""
    TURN = 18
    """Largest difference of gyro and attitude."""
    DEPTH = 19
    SILENT = 20
    NO_ECHO = 21
    REFUSED = 22
    DEPTH_DRIFT = 23
    ENCODER_DRIFT = 24


class Complaint(Layout):
    """Reason why a channel is not good, and the numbers of its text."""

    code: int
    """Code of the `Reason`."""
    first: float
    """[unit in the text] first number of the text."""
    second: float
    """[unit in the text] second number of the text."""


def set_complaint(why: Complaint, code: int, first: float, second: float) -> bool:
    """Write the code of a `Reason` and the numbers of its text, and return True: there is a
    complaint.
    """
    why.code = code
    why.first = first
    why.second = second
    return True


def copy_complaint(to: Complaint, source: Complaint) -> None:
    """Copy the source."""
    set_complaint(to, source.code, source.first, source.second)


class ReasonTexts:
    """Texts of the reasons why channels are not good."""

    def __init__(self, joints: Sequence[str], units: Mapping[str, str] = UNITS) -> None:
        """joints: their names. units: of the channels."""
        self._joints = joints
        self._units = units
        self._shapes: list[str] = []

    def shape(self, actual: tuple[int, ...], expected: tuple[int, ...]) -> int:
        """Keep the text on a value of a wrong shape, and return its number, from 1."""
        text = f"a value of shape {actual} in place of {expected or 'a number'}"
        if text not in self._shapes:
            self._shapes.append(text)
        return self._shapes.index(text) + 1

    def of(self, channel: str, why: Any) -> str:
        """Describe a reason that the health memory keeps as numbers."""
        a = why.first
        b = why.second
        if why.code == Reason.SHAPE:
            return self._shapes[int(a) - 1]
        if why.code == Reason.STILL:
            return f"{self._joints[int(a)]} does not change while {b:.2g} were asked of it"
        if why.code == Reason.ENCODER_DRIFT:
            return (
                f"encoder and rate of {self._joints[int(a)]} disagree by {b:.2g}"
                f" {self._units['joint_velocities']}"
            )
        if why.code == Reason.LARGE:
            return f"{a:.3g} {self._units[channel]}, more than the {b:.2g} that can be"
        if why.code == Reason.OFF:
            return f"{a:.3g} {self._units[channel]} off the estimate, allowed {b:.2g}"
        component = f", component {b:.0f}" if b else ""
        text = _TEXTS[Reason(why.code).name.lower()]
        return text.format(a=a, b=b, component=component)
