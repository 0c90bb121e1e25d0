"""What comes of the thrust that is asked for, thruster by thruster, as far as faults are known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from uvms_ocp.functions.elementwise import Array, where
from uvms_ocp.functions.kernels.layout import Layout, Sized


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Effect(Layout):
    """Thrust in the water is ``share * asked + constant``, of numbers and of CasADi expressions alike."""

    share: Annotated[Array, Sized("n_thrusters")]
    """(n_thrusters,) [-]: 1 is sound, 0 dead or stuck, below 0 reversed."""
    constant: Annotated[Array, Sized("n_thrusters")]
    """(n_thrusters,) [N] of a stuck thruster."""

    @staticmethod
    def sound(n: int) -> Effect:
        """n thrusters that do what they are asked."""
        return Effect(share=np.ones(n), constant=np.zeros(n))

    @property
    def works(self) -> Array:
        """(n_thrusters,) whether anything follows the command at all."""
        return self.share != 0.0

    @property
    def share_or_one(self) -> Array:
        """(n_thrusters,) [-] to divide by."""
        return where(self.works, self.share, 1.0)

    def given(self, asked: Array) -> Array:
        """Thrust in the water (n_thrusters,) [N] for the asked one (n_thrusters,) [N]."""
        return self.share * asked + self.constant

    def asked(self, given: Array) -> Array:
        """What to ask (n_thrusters,) [N] for the thrust given (n_thrusters,) [N] in the water; 0 of what does not follow."""
        return where(self.works, (given - self.constant) / self.share_or_one, 0.0)


def given_by(e: Effect, i: int, asked: float) -> float:
    """As `Effect.given`, of thruster i, as a kernel: thrust [N] for that asked [N]."""
    return e.share[i] * asked + e.constant[i]
