"""The estimate of one who takes readings for the truth: what the monitor lets through, as it is."""

from __future__ import annotations

import ctypes
from typing import Annotated

from uvms_ocp.control.navigation.filter.memory import NUMBER
from uvms_ocp.control.navigation.health.health_memory import HealthMemory
from uvms_ocp.control.navigation.pass_through import PassThrough
from uvms_ocp.functions.kernels.layout import Layout, Sized, structure_of


class Repeated(Layout):
    """Which channels q and v are made of."""

    n: int
    """[-] channels of either."""
    of_q: Annotated[list[int], Sized(3)]
    """(n,) [-] their numbers, one after the other."""
    of_v: Annotated[list[int], Sized(3)]
    """(n,) [-]"""


def repeated_by(estimator: PassThrough) -> ctypes.Structure:
    """A `Repeated` as this one repeats them."""
    made, n = structure_of(Repeated)(), len(estimator.q_channels)
    made.n = n
    made.of_q[:n], made.of_v[:n] = (
        [int(NUMBER[name]) for name in names] for names in (estimator.q_channels, estimator.v_channels)
    )
    return made


def repeat(m: HealthMemory, r: Repeated) -> None:
    """`now` as the readings say that are used. A kernel."""
    at, there = 0, 0
    for k in range(r.n):
        c = m.channels[r.of_q[k]]
        for i in range(c.size):
            m.now.q[at] = c.used_value[i]
            at += 1
        d = m.channels[r.of_v[k]]
        for i in range(d.size):
            m.now.v[there] = d.used_value[i]
            there += 1
