"""What is known of thrusters and joints: sound, suspect or faulty, and how."""

from __future__ import annotations

import enum
import math
from collections.abc import Sequence
from dataclasses import dataclass


class Health(enum.IntEnum):
    """How far an actuator does what it is asked."""

    GOOD = 0
    SUSPECT = 1
    """The motion is not what it should be, and this may be why."""
    FAULTY = 2
    """Named, and no longer relied on."""


class FaultKind(enum.IntEnum):
    """What is wrong."""

    NONE = 0
    DEAD = 1
    WEAK = 2
    STUCK = 3
    REVERSED = 4
    JAMMED = 5

    @property
    def word(self) -> str:
        """Such as ``dead``."""
        return self.name.lower()


@dataclass(frozen=True, kw_only=True, slots=True)
class ThrusterVerdict:
    """On one thruster."""

    health: Health = Health.GOOD
    kind: FaultKind = FaultKind.NONE
    """Of what is faulty."""
    share: float = 1.0
    """[-] of the thrust that is asked for."""
    constant: float = 0.0
    """[N] of a stuck thruster."""
    confidence: float = 0.0
    """[-] what the next best explanation leaves unexplained, over what this does."""
    since: float = math.nan
    """[s] time from which on it explains the motion."""


@dataclass(frozen=True, kw_only=True, slots=True)
class JointVerdict:
    """On one joint."""

    health: Health = Health.GOOD
    kind: FaultKind = FaultKind.NONE
    since: float = math.nan
    """[s] time from which on it has not moved."""


def thruster_alarm(number: int, name: str, verdict: ThrusterVerdict) -> str:
    """One line on a faulty thruster, counted from 1 as in faults that are asked for."""
    who = f"thruster{number} {verdict.kind.word} ({name})"
    if verdict.kind is FaultKind.STUCK:
        return f"{who}: gives {verdict.constant:.0f} N whatever it is asked; taken out, the others make up for it"
    given = f"{who}: gives {100 * verdict.share:.0f} % of what it is asked"
    if verdict.kind is FaultKind.DEAD:
        return f"{given}; taken out"
    return f"{given}; {'driven the other way' if verdict.kind is FaultKind.REVERSED else 'asked for more'}"


def joint_alarm(number: int, name: str) -> str:
    """One line on a jammed joint, counted from 1."""
    return f"joint{number} jammed ({name}): pushed, and does not move; the others do without it"


def thrusters_named(verdicts: Sequence[ThrusterVerdict]) -> list[str]:
    """Those that are faulty, such as ``thruster3 dead``."""
    return [f"thruster{i + 1} {verdict.kind.word}" for i, verdict in enumerate(verdicts) if verdict.kind]


def joints_named(verdicts: Sequence[JointVerdict]) -> list[str]:
    """Those that are faulty, such as ``joint2 jammed``."""
    return [f"joint{j + 1} {verdict.kind.word}" for j, verdict in enumerate(verdicts) if verdict.kind]
