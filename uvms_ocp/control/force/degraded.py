"""Allocation to the thrusters that are left: none of what is dead or stuck, so much of what is weak, reversed the other way."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from uvms_ocp.control.actuator_health.effect import Effect
from uvms_ocp.control.force.allocation import Allocation, AllocationResult


class DegradedAllocation:
    """An `Allocation` over what follows commands, with its laws; what is stuck is a known wrench that is made up for.

    Its thrust is that in the water: a weak thruster takes the power of what it is asked, which is more.
    """

    def __init__(self, whole: Allocation, effect: Effect) -> None:
        self.matrix = whole.matrix
        """B (6, n) [N/N, N m/N] of all thrusters."""
        self._left, self._constant = effect.works, effect.constant
        self._known = whole.matrix @ effect.constant
        self._allocation = _of_what_is_left(whole, effect)

    def allocate(self, wrench: ArrayLike) -> AllocationResult:
        """Thrust in the water for a wrench (6,) [N, N m], as `Allocation.allocate`."""
        result = self._allocation.allocate(np.asarray(wrench, dtype=float) - self._known)
        thrust = self._constant.copy()
        thrust[self._left] += result.thrust
        return AllocationResult(thrust, result.reached + self._known, result.unreachable, result.saturated)


def _of_what_is_left(whole: Allocation, effect: Effect) -> Allocation:
    left = effect.works
    size = np.abs(effect.share[left])
    ends = np.array([effect.share * whole.lower, effect.share * whole.upper])[:, left]
    return Allocation(
        matrix=whole.matrix[:, left],
        lower=ends.min(axis=0),
        upper=ends.max(axis=0),
        power_factor=whole.power_factor[left] / size ** whole.power_exponent[left],
        power_exponent=whole.power_exponent[left],
        dead_zone=whole.dead_zone[left] * size,
        wrench_weight=whole.wrench_weight,
    )
