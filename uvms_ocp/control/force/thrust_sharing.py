"""A wrench shared out among the thrusters that follow, as kernels: what is stuck is a known wrench that is made up for.

Of what is dead or stuck nothing is asked, of what is weak so much, of what is reversed the other way. The thrust is that in
the water: a weak thruster takes the power of what it is asked, which is more.
"""

from __future__ import annotations

import math
from typing import Annotated

from uvms_ocp.control.force.least_power import least_power, prepare_powers
from uvms_ocp.control.force.limited_thrust import LimitedThrust, limit_thrust
from uvms_ocp.functions.kernels.layout import Layout, Sized, Vector

MOST = 1e12
"""[N, N m] that any part of a wrench may be."""


class ThrustSharing(Layout):
    """Of an `Allocation`, whose fields are described there. Room for n thrusters, of which `count` are there."""

    count: int
    matrix: Annotated[list[Vector], Sized("m", "n")]
    """(6, n) [N/N, N m/N]"""
    lower: Annotated[Vector, Sized("n")]
    """(n,) [N]"""
    upper: Annotated[Vector, Sized("n")]
    """(n,) [N]"""
    power_factor: Annotated[Vector, Sized("n")]
    """(n,) [W/N^exponent]"""
    power_exponent: Annotated[Vector, Sized("n")]
    """(n,) [-]"""
    dead_zone: Annotated[Vector, Sized("n")]
    """(n,) [N]"""
    wrench_weight: Annotated[Vector, Sized("m")]
    """(6,) [1/N, 1/(N m)]"""
    share: Annotated[Vector, Sized("n")]
    """(n,) [-] as those of `Effect`."""
    constant: Annotated[Vector, Sized("n")]
    """(n,) [N]"""
    # found by `take_effect`
    left: LimitedThrust
    """Of the thrusters that follow."""
    place: Annotated[list[int], Sized("n")]
    """Of each of them among all."""
    known: Annotated[Vector, Sized("m")]
    """(6,) [N, N m] of those that are stuck."""
    # found by `share_out`
    wrench: Annotated[Vector, Sized("m")]
    """(6,) [N, N m] asked for; given."""
    thrust: Annotated[Vector, Sized("n")]
    """(n,) [N] as those of `AllocationResult`."""
    reached: Annotated[Vector, Sized("m")]
    """(6,) [N, N m]"""
    unreachable: Annotated[Vector, Sized("m")]
    """(6,) [N, N m]"""
    saturated: bool


def take_effect(a: ThrustSharing) -> None:
    """From now on: share and constant."""
    n = 0
    for i in range(a.count):
        if a.share[i] != 0.0:
            _keep(a, i, n)
            n += 1
    a.left.powers.count = n
    a.left.problem.rows = len(a.matrix)
    a.left.problem.columns = n
    _find_known(a)
    prepare_powers(a.left.powers)


def _find_known(a: ThrustSharing) -> None:
    for k in range(len(a.matrix)):
        a.left.powers.wrench_weight[k] = a.wrench_weight[k]
        a.known[k] = 0.0
        for i in range(a.count):
            a.known[k] += a.matrix[k][i] * a.constant[i]


def share_out(a: ThrustSharing) -> bool:
    """Find the thrust for the wrench; whether that is a number, and one whose square is: if not, there is none."""
    finite = True
    for k in range(len(a.matrix)):
        finite = finite and abs(a.wrench[k]) < MOST
        a.left.wrench[k] = a.wrench[k] - a.known[k]
    if finite:
        least_power(a.left.powers, a.left.wrench, a.left.unbounded)
        a.saturated = limit_thrust(a.left)
        _to_all(a)
    return finite


def _keep(a: ThrustSharing, i: int, to: int) -> None:
    """Thruster i, which follows."""
    left, share, size = a.left, a.share[i], abs(a.share[i])
    a.place[to] = i
    for k in range(len(a.matrix)):
        left.powers.matrix[k][to] = a.matrix[k][i]
    left.lower[to] = min(share * a.lower[i], share * a.upper[i])
    left.upper[to] = max(share * a.lower[i], share * a.upper[i])
    left.dead_zone[to] = a.dead_zone[i] * size
    left.powers.largest[to] = max(left.upper[to], -left.lower[to])
    left.powers.factor[to] = a.power_factor[i] / math.exp(a.power_exponent[i] * math.log(size))
    left.powers.exponent[to] = a.power_exponent[i]


def _to_all(a: ThrustSharing) -> None:
    """What is found to where it belongs."""
    for i in range(a.count):
        a.thrust[i] = a.constant[i]
    for j in range(a.left.powers.count):
        a.thrust[a.place[j]] += a.left.thrust[j]
    for k in range(len(a.matrix)):
        reached = 0.0
        for j in range(a.left.powers.count):
            reached += a.left.powers.matrix[k][j] * a.left.thrust[j]
        a.reached[k] = reached + a.known[k]
        a.unreachable[k] = a.left.wrench[k] - reached
