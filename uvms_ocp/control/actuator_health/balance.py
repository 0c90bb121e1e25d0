"""The wrench that holds the robot still, averaged once it has settled after a fault."""

from __future__ import annotations

from typing import Annotated

from uvms_ocp.functions.kernels.layout import Layout, Sized, Vector


class Balance(Layout):
    """Mean over the second half of a wait."""

    wait: float
    """[s] from a verdict to a judgement."""
    runs: bool
    """Whether there is anything to wait for."""
    began: float
    """[s]"""
    total: Annotated[Vector, Sized(6)]
    """(6,) [N, N m]"""
    count: int
    mean: Annotated[Vector, Sized(6)]
    """(6,) [N, N m] where it is time to judge."""


def begin_balance(b: Balance, t: float) -> None:
    """Anew, at time t [s]; infinity where what was seen is not to be trusted: from the next look on."""
    b.began = t
    b.count = 0
    for k in range(6):
        b.total[k] = 0.0


def take_in_balance(b: Balance, wrench: Vector, t: float) -> bool:
    """A wrench (6,) [N, N m] at time t [s]; whether it is time to judge."""
    b.began = min(b.began, t)
    if t - b.began > 0.5 * b.wait:
        b.count += 1
        for k in range(6):
            b.total[k] += wrench[k]
    if t - b.began < b.wait or b.count == 0:
        return False
    for k in range(6):
        b.mean[k] = b.total[k] / b.count
    b.runs = False
    return True
