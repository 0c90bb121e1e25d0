"""In what condition thrusters are: which are dead, stuck, weak or reversed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from uvms_ocp.sim.faults.fault import Fault


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ThrusterCondition:
    """Of all thrusters of a robot."""

    share: np.ndarray
    """(n,) [-] of the thrust that is asked for: 1 sound, less weak, negative reversed."""
    held: np.ndarray
    """(n,) [N] thrust at which they are stuck; NaN where they are not."""
    dead: np.ndarray
    """(n,) [-] whether they give nothing."""

    def thrust(self, asked: np.ndarray) -> np.ndarray:
        """Steady thrust (n,) [N] for that of sound thrusters, asked (n,) [N]."""
        given = np.where(np.isnan(self.held), self.share * asked, self.held)
        return np.where(self.dead, 0.0, given)


def condition_of(faults: Sequence[Fault], thrust: np.ndarray) -> ThrusterCondition | None:
    """What these faults make of the thrusters, thrust (n,) [N] now; `None` where all are sound."""
    own = [fault for fault in faults if fault.strikes.family == "thruster"]
    if not own:
        return None
    share, held, dead = np.ones(len(thrust)), np.full(len(thrust), np.nan), np.zeros(len(thrust), dtype=bool)
    for fault in own:
        k = fault.strikes.number - 1
        if fault.kind == "dead":
            dead[k] = True
        elif fault.kind == "stuck":
            held[k] = fault.values[0] if fault.values else thrust[k]
        else:
            share[k] *= fault.values[0] if fault.kind == "weak" else -1.0
    return ThrusterCondition(share=share, held=held, dead=dead)
