"""The wrench that holds the robot still, averaged once it has settled after a fault."""

from __future__ import annotations

from typing import Annotated

from uvms_ocp.codegen.kernel_layout import Layout, Sized, Vector

# [s] from a verdict to the judgement on what can still be reached, of the wrench that was needed in
# the second half
_WAIT = 6.0


class WrenchBalance(Layout):
    """Mean over the second half of a wait."""

    runs: bool
    """There is anything to wait for."""
    began: float
    """[s]"""
    total: Annotated[Vector, Sized(6)]
    """(6,) [N, N m]"""
    count: int
    mean: Annotated[Vector, Sized(6)]
    """(6,) [N, N m] where it is time to judge."""


def begin_wrench_balance(b: WrenchBalance, t: float) -> None:
    """Anew, at time t [s]; infinity where what was seen is not to be trusted: from the next look
    on.
    """
    b.began = t
    b.count = 0
    for k in range(6):
        b.total[k] = 0.0


def update_wrench_balance(b: WrenchBalance, wrench: Vector, t: float) -> bool:
    """A wrench (6,) [N, N m] at time t [s]; whether it is time to judge."""
    b.began = min(b.began, t)
    if t - b.began > 0.5 * _WAIT:
        b.count += 1
        for k in range(6):
            b.total[k] += wrench[k]
    if t - b.began < _WAIT or b.count == 0:
        return False
    for k in range(6):
        b.mean[k] = b.total[k] / b.count
    b.runs = False
    return True
