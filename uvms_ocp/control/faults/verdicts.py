"""Verdicts on thrusters and joints, and the effectiveness of the thrusters."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from uvms_ocp.codegen.elementwise import Array, where
from uvms_ocp.codegen.kernel_layout import Layout, Sized


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ThrusterEffectiveness(Layout):
    """Thrust in the water is ``share * asked + constant``, of numbers and of CasADi expressions
    alike.
    """

    share: Annotated[Array, Sized("n_thrusters")]
    """(n_thrusters,): 1 is sound, 0 dead or stuck, below 0 reversed."""
    constant: Annotated[Array, Sized("n_thrusters")]
    """(n_thrusters,) [N] of a stuck thruster."""

    @staticmethod
    def sound(n: int) -> ThrusterEffectiveness:
        """Return the effectiveness of n thrusters that do what they are asked."""
        return ThrusterEffectiveness(share=np.ones(n), constant=np.zeros(n))

    @property
    def works(self) -> Array:
        """Which thrusters (n_thrusters,) follow their commands at all."""
        return self.share != 0.0

    def given(self, commanded: Array) -> Array:
        """Compute the thrust in the water (n_thrusters,) [N] for the commanded one (n_thrusters,)
        [N].
        """
        return self.share * commanded + self.constant

    def asked(self, delivered: Array) -> Array:
        """Invert the effectiveness: command (n_thrusters,) [N] for a thrust (n_thrusters,) [N]; 0
        of what does not follow.
        """
        return where(
            self.works, (delivered - self.constant) / where(self.works, self.share, 1.0), 0.0
        )


def effective_thrust(effectiveness: ThrusterEffectiveness, i: int, commanded: float) -> float:
    """Compute the thrust in the water [N] of thruster i for the commanded one [N]. A kernel."""
    return effectiveness.share[i] * commanded + effectiveness.constant[i]


# What is known of thrusters and joints: sound, suspect or faulty, and how.


class ActuatorHealth(enum.IntEnum):
    """Degree to which an actuator follows its commands."""

    GOOD = 0
    SUSPECT = 1
    """The motion is not what it should be, and this may be why."""
    FAULTY = 2
    """Named, and no longer relied on."""


class FaultKind(enum.IntEnum):
    """Kind of the fault."""

    NONE = 0
    DEAD = 1
    WEAK = 2
    STUCK = 3
    REVERSED = 4
    JAMMED = 5

    @property
    def word(self) -> str:
        """Name of the fault in texts, such as ``dead``."""
        return self.name.lower()


@dataclass(frozen=True, kw_only=True, slots=True)
class ThrusterVerdict:
    """Verdict of the monitor on one thruster."""

    health: ActuatorHealth = ActuatorHealth.GOOD
    kind: FaultKind = FaultKind.NONE
    """Kind of the fault."""
    share: float = 1.0
    """Share of the commanded thrust that it gives."""
    constant: float = 0.0
    """[N] of a stuck thruster."""
    confidence: float = 0.0
    """Residual of the next best explanation, over that of this one."""
    since: float = math.nan
    """[s] time from which on it explains the motion."""


@dataclass(frozen=True, kw_only=True, slots=True)
class JointVerdict:
    """Verdict of the monitor on one joint."""

    health: ActuatorHealth = ActuatorHealth.GOOD
    kind: FaultKind = FaultKind.NONE
    since: float = math.nan
    """[s] time from which on it has not moved."""


def thruster_alarm(number: int, name: str, verdict: ThrusterVerdict) -> str:
    """Describe a faulty thruster in one line; number: counted from 1, as in the names of injected
    faults.
    """
    thruster = f"thruster{number} {verdict.kind.word} ({name})"
    if verdict.kind is FaultKind.STUCK:
        return (
            f"{thruster}: gives {verdict.constant:.0f} N whatever it is asked; taken out, the others"
            " make up for it"
        )
    finding = f"{thruster}: gives {100 * verdict.share:.0f} % of what it is asked"
    if verdict.kind is FaultKind.DEAD:
        return f"{finding}; taken out"
    if verdict.kind is FaultKind.REVERSED:
        return f"{finding}; driven the other way"
    return f"{finding}; asked for more"
