"""Allocation: from the wrench a controller asks for to thrust inside the limits of every thruster."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from uvms_ocp.control.actuator_health.effect import Effect
from uvms_ocp.control.force.thrust_sharing import MOST, ThrustSharing, share_out, take_effect
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.functions.kernels.binding import bind_kernels
from uvms_ocp.functions.kernels.layout import structure_of
from uvms_ocp.model.files.description import Power, Thruster
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.thrusters import thrust_limits, thruster_matrix
from uvms_ocp.solvers.bounded_least_squares import room_for


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
    effect: Effect | None = None
    """What thrusters make of their commands: what follows none is left out. `None`: all do what they are asked."""
    compiled: bool = field(default=True, repr=False)
    """Whether it is worth a compiler: not for a few wrenches."""
    memory: Any = field(init=False, repr=False)
    """A `ThrustSharing`"""
    _share_out: Callable[[Any], int] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self._check()
        structure = structure_of(ThrustSharing, **sharing_sizes(len(self.lower)))
        take, share = bind_kernels((take_effect, share_out), (structure,), compiled=self.compiled)
        object.__setattr__(self, "memory", structure())
        object.__setattr__(self, "_share_out", share)
        self.write(self.memory)
        take(self.memory)

    def write(self, memory: Any) -> None:
        """All that `take_effect` asks into a `ThrustSharing` with room for the `sharing_sizes` of these thrusters."""
        n, effect = len(self.lower), self.effect or Effect.sound(len(self.lower))
        memory.count, memory.wrench_weight[:] = n, self.wrench_weight.tolist()
        for k in range(6):
            memory.matrix[k][:n] = self.matrix[k].tolist()
        for name in ("lower", "upper", "power_factor", "power_exponent", "dead_zone"):
            getattr(memory, name)[:n] = getattr(self, name).tolist()
        memory.share[:n], memory.constant[:n] = effect.share.tolist(), effect.constant.tolist()

    def allocate(self, wrench: ArrayLike) -> AllocationResult:
        """Thrust for a wrench (6,) [N, N m] about the origin of B, in B.

        Raises `InvalidInput` unless it is finite, and below `MOST`.
        """
        w, memory = _six(wrench), self.memory
        memory.wrench[:] = w.tolist()
        if not self._share_out(memory):
            raise InvalidInput(f"wrench {w} given; allowed: six finite numbers below {MOST:g} [N, N m]")
        found = (np.array(memory.thrust[: memory.count]), np.array(memory.reached), np.array(memory.unreachable))
        return AllocationResult(*found, bool(memory.saturated))

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


def sharing_sizes(n: int) -> dict[str, int]:
    """Of a `ThrustSharing` [-] with room for n [-] thrusters."""
    return {"m": 6, "n": room_for(n)}


_SHAPES = {
    "matrix": (6, -1),
    "lower": (-1,),
    "upper": (-1,),
    "power_factor": (-1,),
    "power_exponent": (-1,),
    "dead_zone": (-1,),
    "wrench_weight": (6,),
}


def allocation_of(
    robot: Robot, *, force_weight: float = 1.0, moment_weight: float = 1.0, compiled: bool = True
) -> Allocation:
    """Return the allocation of a robot's thrusters.

    force_weight [1/N] and moment_weight [1/(N m)] say what to give up first when the limits bind. compiled: as
    `Allocation` has it.
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
        compiled=compiled,
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


def _checked(name: str, value: ArrayLike, shape: tuple[int, ...]) -> np.ndarray:
    array = np.array(value, dtype=float)
    if array.shape != shape or not np.isfinite(array).all():
        raise InvalidInput(f"{name} of shape {array.shape} given; allowed: {shape}, finite numbers")
    array.flags.writeable = False
    return array


def _require(condition: object, name: str, allowed: str) -> None:
    if not condition:
        raise InvalidInput(f"{name} out of range; allowed: {allowed}")
