"""Allocation to the thrusters that are left: none of what is dead or stuck, so much of what is weak, reversed the other way."""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from uvms_ocp.control.actuator_health.effect import Effect
from uvms_ocp.control.force.allocation import Allocation, AllocationResult
from uvms_ocp.model.symbolic.joint_types import sparse


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
        self.function = self._function()
        """As `Allocation.function`, of all thrusters."""

    def allocate(self, wrench: ArrayLike) -> AllocationResult:
        """Thrust in the water for a wrench (6,) [N, N m], as `Allocation.allocate`."""
        return self._of_all(self._allocation.allocate(np.asarray(wrench, dtype=float) - self._known))

    def beyond(self, wrench: np.ndarray) -> AllocationResult:
        """As `Allocation.beyond`, for a wrench (6,) [N, N m]."""
        return self._of_all(self._allocation.beyond(wrench - self._known))

    def _of_all(self, result: AllocationResult) -> AllocationResult:
        thrust = self._constant.copy()
        thrust[self._left] += result.thrust
        return AllocationResult(thrust, result.reached + self._known, result.unreachable, result.saturated)

    def _function(self) -> ca.Function:
        inner, wrench = self._allocation.function, ca.SX.sym("wrench", 6)
        left, reached, unreachable, settled = inner(wrench - self._known)
        spread = sparse(np.eye(len(self._constant))[:, self._left])
        thrust = ca.densify(ca.DM(self._constant) + spread @ left)
        results = [thrust, reached + self._known, unreachable, settled]
        return ca.Function(inner.name(), [wrench], results, inner.name_in(), inner.name_out())


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
