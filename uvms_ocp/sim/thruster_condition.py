"""In what condition thrusters are: which are dead, stuck, weak or reversed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from uvms_ocp.sim.faults import Fault

_SHARES = {"dead": 0.0, "stuck": 0.0, "reversed": -1.0}


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ThrusterCondition:
    """Faults of all thrusters of a robot. Their steady thrust is ``share sound + offset``, for that
    of sound ones.
    """

    share: np.ndarray
    """(n,) 1 sound, less weak, negative reversed, 0 dead or stuck."""
    offset: np.ndarray
    """(n,) [N] thrust at which they are stuck."""
    dead: np.ndarray
    """(n,) True for those that give nothing."""


def condition_of(faults: Sequence[Fault], thrust: np.ndarray) -> ThrusterCondition:
    """Compute the state of the thrusters under these faults, thrust (n,) [N] now."""
    share = np.ones(len(thrust))
    offset = np.zeros(len(thrust))
    dead = np.zeros(len(thrust), dtype=bool)
    for fault in faults:
        if fault.location.family != "thruster":
            continue
        k = fault.location.number - 1
        if fault.kind == "stuck":
            offset[k] = fault.values[0] if fault.values else thrust[k]
        if fault.kind == "dead":
            dead[k] = True
        if fault.kind == "weak":
            share[k] *= fault.values[0]
        else:
            share[k] *= _SHARES[fault.kind]
    return ThrusterCondition(share=share, offset=np.where(dead, 0.0, offset), dead=dead)
