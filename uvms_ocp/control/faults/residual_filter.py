"""Filter the commands of the actuators tick by tick as the observer filters its residual, so that a
look compares the two at the same delay.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from uvms_ocp.codegen.elementwise import Array, where
from uvms_ocp.control.faults.tuning import ActuatorHealthTuning


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class FilteredCommands:
    """Filtered commands of the actuators, as numbers or CasADi expressions."""

    thrust: Array
    """(n_thrusters,) [N], filtered as the observer filters the residual."""
    way: Array
    """(n_v,) [m/s, rad/s] sum of the reference velocities since the last look."""
    ticks: Array
    """() since the last look; at 0 it is time for one, where the tick was taken in."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ResidualFilter:
    """Low-pass filter of commanded thrust, to compare it with the residual of the observer, which
    lags as much.
    """

    share: float
    """Share of the distance to a new thrust that the filter goes in a tick."""
    every: int
    """Ticks from look to look."""

    def after(self, before: FilteredCommands, thrust: Array, reference: Array) -> FilteredCommands:
        """Return the filtered commands a tick later.

        thrust (n_thrusters,) [N] asked of thrusters that all follow; reference (n_v,) [m/s, rad/s]
        of the velocity.
        """
        ticks = before.ticks + 1.0
        return FilteredCommands(
            thrust=before.thrust + self.share * (thrust - before.thrust),
            way=where(before.ticks == 0.0, 0.0, before.way) + reference,
            ticks=where(ticks >= self.every, 0.0, ticks),
        )


def residual_filter_for(
    tuning: ActuatorHealthTuning, *, bandwidth: float, dt: float
) -> ResidualFilter:
    """Return the filter for a residual of a bandwidth [rad/s]; dt [s] of a tick."""
    return ResidualFilter(
        share=1.0 - math.exp(-bandwidth * dt), every=max(1, round(tuning.sample_time / dt))
    )
