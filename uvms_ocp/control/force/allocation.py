"""Allocation: from the wrench a controller asks for to thrust inside the limits of every thruster."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from uvms_ocp.control.force.least_power import PowerLaw, least_power, null_space
from uvms_ocp.control.force.limited_thrust import LimitedThrust, limit_thrust
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.functions.buffered import BufferedFunction
from uvms_ocp.functions.elementwise import both, either, everywhere
from uvms_ocp.functions.kernels.binding import bind_kernels
from uvms_ocp.functions.kernels.layout import structure_of
from uvms_ocp.model.files.description import Power, Thruster
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.symbolic.joint_types import sparse
from uvms_ocp.model.thrusters import thrust_limits, thruster_matrix
from uvms_ocp.solvers.bounded_least_squares import BoundedProblem, room_for
from uvms_ocp.solvers.least_norm import Rows


@dataclass(frozen=True, slots=True, eq=False)
class AllocationResult:
    """Thrust for one wrench. Arrays are fresh and owned by the caller."""

    thrust: np.ndarray
    """(n_thrusters,) [N], inside the limits."""
    reached: np.ndarray
    """Wrench of that thrust (6,) [N, N m] in B."""
    unreachable: np.ndarray
    """Rest of the wrench asked for (6,) [N, N m], out of reach of the layout or of the limits."""
    saturated: bool
    """The limits, and not the layout alone, keep the wrench from being reached."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Allocation:
    """Thrust of n thrusters for a wrench on the vehicle: bounded weighted least squares, then least power.

    Minimises ``|diag(wrench_weight) (B thrust - wrench)|`` inside the limits; among equal wrenches it minimises
    the electrical power, to about 1e-4 of it. See `allocation_of` for a robot's. Raises `InvalidInput` for numbers
    that are not finite or out of range. Not for use from two threads at once.
    """

    matrix: np.ndarray
    """B (6, n) [N/N, N m/N]."""
    lower: np.ndarray
    """(n,) [N], at most 0."""
    upper: np.ndarray
    """(n,) [N], at least 0."""
    power_factor: np.ndarray
    """(n,) [W/N^exponent], more than 0: power is ``factor |thrust|^exponent``."""
    power_exponent: np.ndarray
    """(n,) [-], 1 to 3."""
    dead_zone: np.ndarray
    """(n,) [N]: smaller thrust cannot be commanded; it becomes 0 or the edge, whichever is nearer."""
    wrench_weight: np.ndarray = field(default_factory=lambda: np.ones(6))
    """(6,) [1/N, 1/(N m)]: what to give up first when not everything can be reached."""
    function: ca.Function = field(init=False, repr=False)
    """``wrench -> thrust, reached, unreachable, settled`` as `AllocationResult`, limits aside; settled [-]: 1 where neither
    limits nor dead zones are in the way of that, else `beyond` has the answer."""
    _quick: BufferedFunction = field(init=False, repr=False)
    """The function, to be called."""
    _limited: Any = field(init=False, repr=False)
    """A `LimitedThrust`"""
    _limit: Callable[[Any], int] = field(init=False, repr=False)
    """What `limit_thrust` makes of it."""

    def __post_init__(self) -> None:
        self._check()
        largest = np.maximum(np.maximum(self.upper, -self.lower), np.finfo(float).tiny)
        power = PowerLaw(factor=self.power_factor, exponent=self.power_exponent, largest=largest)
        object.__setattr__(self, "function", self._function(power))
        object.__setattr__(self, "_quick", BufferedFunction(self.function))
        limited, limit = limited_thrust(self, power)
        object.__setattr__(self, "_limited", limited)
        object.__setattr__(self, "_limit", limit)

    def allocate(self, wrench: ArrayLike) -> AllocationResult:
        """Thrust for a wrench (6,) [N, N m] about the origin of B, in B. Raises `InvalidInput` unless it is finite."""
        w = _six(wrench)
        thrust, reached, unreachable, settled = self._quick(w)
        return AllocationResult(thrust, reached, unreachable, False) if settled[0] else self.beyond(w)

    def beyond(self, wrench: np.ndarray) -> AllocationResult:
        """As `allocate`, slower, for a wrench (6,) [N, N m] that limits or dead zones are in the way of.

        Raises `InvalidInput` unless it is finite.
        """
        _require_finite(wrench)
        n, limited = len(self.lower), self._limited
        limited.wrench[:] = wrench.tolist()
        limited.unbounded[:n] = self._quick(wrench)[0].tolist()
        saturated = bool(self._limit(limited))
        thrust = np.array(limited.thrust[:n])
        reached = self.matrix @ thrust
        return AllocationResult(thrust, reached, wrench - reached, saturated)

    def _function(self, power: PowerLaw) -> ca.Function:
        wrench = ca.SX.sym("wrench", 6)
        thrust = ca.densify(least_power(wrench, self.matrix, self._inverse(power.quadratic()), power))
        reached = ca.densify(sparse(self.matrix) @ thrust)
        results = {"thrust": thrust, "reached": reached, "unreachable": wrench - reached}
        results["settled"] = self._settled(thrust)
        return ca.Function("allocate", [wrench], list(results.values()), ["wrench"], list(results))

    def _settled(self, thrust: ca.SX) -> ca.SX:
        """Whether thrust can be commanded as it is; not so for NaN."""
        lower, upper, edge = ca.DM(self.lower), ca.DM(self.upper), ca.DM(self.dead_zone)
        outside = either(thrust == 0.0, ca.fabs(thrust) >= edge)
        return everywhere(both(both(thrust >= lower, thrust <= upper), outside))

    def _inverse(self, weight: np.ndarray) -> np.ndarray:
        """Wrench to the thrust (n, 6) [N/N, N/(N m)] of least weighted squares without limits."""
        scale = np.sqrt(weight)
        weighted = self.wrench_weight[:, None] * self.matrix / scale
        return np.linalg.pinv(weighted, rcond=1e-9) * self.wrench_weight / scale[:, None]

    def _check(self) -> None:
        n = np.shape(self.matrix)[-1] if np.ndim(self.matrix) == 2 else 0
        for name, shape in _SHAPES.items():
            rows = tuple(n if size == -1 else size for size in shape)
            object.__setattr__(self, name, _checked(name, getattr(self, name), rows))
        _require((self.lower <= 0.0).all() and (self.upper >= 0.0).all(), "limits", "lower <= 0 <= upper")
        _require((self.power_factor > 0.0).all(), "power_factor", "more than 0")
        _require(((self.power_exponent >= 1.0) & (self.power_exponent <= 3.0)).all(), "power_exponent", "1 to 3")
        _require((self.wrench_weight > 0.0).all(), "wrench_weight", "more than 0")
        _require((self.dead_zone >= 0.0).all(), "dead_zone", "0 or more")


def limited_thrust(allocation: Allocation, power: PowerLaw) -> tuple[Any, Callable[[Any], int]]:
    """What an allocation is to `limit_thrust`, and that kernel; power: of all thrusters."""
    n = len(allocation.lower)
    sizes = {"m": 6, "n": room_for(n)}
    parts = [structure_of(layout, **sizes) for layout in (Rows, BoundedProblem, LimitedThrust)]
    p: Any = parts[-1]()
    p.problem.rows, p.problem.columns = 6, n
    p.redundant = null_space(allocation.matrix).size > 0
    p.wrench_weight[:] = allocation.wrench_weight.tolist()
    for k in range(6):
        p.matrix[k][:n] = allocation.matrix[k].tolist()
    for name in ("lower", "upper", "dead_zone"):
        getattr(p, name)[:n] = getattr(allocation, name).tolist()
    for name, values in (("factor", power.factor), ("exponent", power.exponent), ("largest", power.largest)):
        getattr(p, name)[:n] = values.tolist()
    p.quadratic[:n] = power.quadratic().tolist()
    return p, bind_kernels((limit_thrust,), parts)[0]


_SHAPES = {
    "matrix": (6, -1),
    "lower": (-1,),
    "upper": (-1,),
    "power_factor": (-1,),
    "power_exponent": (-1,),
    "dead_zone": (-1,),
    "wrench_weight": (6,),
}


def allocation_of(robot: Robot, *, force_weight: float = 1.0, moment_weight: float = 1.0) -> Allocation:
    """Return the allocation of a robot's thrusters.

    force_weight [1/N] and moment_weight [1/(N m)] say what to give up first when the limits bind.
    """
    thrusters = robot.description.thrusters
    lower, upper = thrust_limits(robot)
    powers = _powers(thrusters)
    return Allocation(
        matrix=thruster_matrix(robot),
        lower=lower,
        upper=upper,
        power_factor=np.array([power.watts / power.thrust**power.exponent for power in powers]),
        power_exponent=np.array([power.exponent for power in powers]),
        dead_zone=np.array([thruster.dead_zone for thruster in thrusters]),
        wrench_weight=np.repeat([force_weight, moment_weight], 3),
    )


def _powers(thrusters: tuple[Thruster, ...]) -> list[Power]:
    powers = [thruster.power for thruster in thrusters if thruster.power is not None]
    if len(powers) == len(thrusters):
        return powers
    # Without data for all, full thrust costs the same for each.
    return [Power(thrust=max(thruster.maximum, -thruster.minimum), watts=1.0) for thruster in thrusters]


def _six(wrench: ArrayLike) -> np.ndarray:
    w = np.asarray(wrench, dtype=float)
    if w.shape != (6,):
        raise InvalidInput(f"wrench of shape {w.shape} given; allowed: (6,) [N, N m]")
    return w


def _require_finite(w: np.ndarray) -> None:
    if not np.isfinite(w).all():
        raise InvalidInput(f"wrench {w} given; allowed: six finite numbers [N, N m]")


def _checked(name: str, value: ArrayLike, shape: tuple[int, ...]) -> np.ndarray:
    array = np.array(value, dtype=float)
    if array.shape != shape or not np.isfinite(array).all():
        raise InvalidInput(f"{name} of shape {array.shape} given; allowed: {shape}, finite numbers")
    array.flags.writeable = False
    return array


def _require(condition: object, name: str, allowed: str) -> None:
    if not condition:
        raise InvalidInput(f"{name} out of range; allowed: {allowed}")
