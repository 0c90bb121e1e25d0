"""Smooth activations: cosine steps with which tasks and rows come and go."""

from __future__ import annotations

import math

import casadi as ca

from uvms_ocp.checks import checked_dataclass, checked_on_failure
from uvms_ocp.codegen.elementwise import is_symbolic
from uvms_ocp.errors import InvalidInput


@checked_dataclass(check=checked_on_failure, kw_only=False)
class SmoothActivation:
    """A cosine step over ``start <= x <= end``: C1 everywhere, 0 or 1 outside ([Gao2022] eq. 22).

    Raises `InvalidInput` unless ``start < end`` and both are finite.
    """

    start: float
    """[unit of x] x at which the step begins."""
    end: float
    """[unit of x] x at which the step ends."""

    def __post_init__(self) -> None:
        if not is_symbolic(self.start) and not (
            math.isfinite(self.start) and math.isfinite(self.end) and self.start < self.end
        ):
            raise InvalidInput(
                f"SmoothActivation({self.start}, {self.end}): start and end must be finite and"
                " start < end"
            )

    def increasing(self, x: ca.SX | float) -> ca.SX:
        """Return 0 where x [its unit] is below `start`, 1 where it is above `end`."""
        phase = ca.fmin(ca.fmax((x - self.start) / (self.end - self.start), 0), 1)
        return 0.5 - 0.5 * ca.cos(math.pi * phase)

    def decreasing(self, x: ca.SX | float) -> ca.SX:
        """Return 1 where x [its unit] is below `start`, 0 where it is above `end`."""
        return 1 - self.increasing(x)
