"""Thrust allocation: from the wrench a controller asks for to commands inside the limits of every
thruster that works.

Of a thruster that is dead or stuck nothing is asked, of a weak one more, of a reversed one the
opposite; the thrust of a stuck one is compensated. Thrusters are first-order lags, which commands
are ahead of. The thrust is that in the water: a weak thruster takes the power of what it is asked,
which is more.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from uvms_ocp.checks import checked_constructor, checked_dataclass
from uvms_ocp.codegen.kernel_layout import Layout, Sized, Vector, assign, structure_of
from uvms_ocp.codegen.kernels import bind_kernels
from uvms_ocp.control.faults.verdicts import ThrusterEffectiveness
from uvms_ocp.control.force.minimum_power import (
    LimitedThrustMemory,
    limited_thrust,
    minimum_power,
    prepare_minimum_power,
)
from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot.description import Power, Thruster
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.thrusters import thrust_limits, thruster_matrix
from uvms_ocp.solvers.bounded_least_squares import dot, room_for
from uvms_ocp.types import Array as Numbers, Range, Shape

LARGEST_WRENCH = 1e12
"""[N, N m] that any part of a wrench may be."""

_ARRAYS = (
    "matrix",
    "lower",
    "upper",
    "power_factor",
    "power_exponent",
    "dead_zone",
    "wrench_weight",
)


class AllocationMemory(Layout):
    """Memory of an `Allocation`, with room for n thrusters, of which `count` are used."""

    count: int
    matrix: Annotated[list[Vector], Sized("m", "n")]
    """(6, n) [N/N, N m/N] wrench about the origin of B by the thrust of each thruster."""
    lower: Annotated[Vector, Sized("n")]
    """(n,) [N]"""
    upper: Annotated[Vector, Sized("n")]
    """(n,) [N]"""
    power_factor: Annotated[Vector, Sized("n")]
    """(n,) [W/N^exponent] electrical power is ``power_factor |thrust|^power_exponent``."""
    power_exponent: Annotated[Vector, Sized("n")]
    """(n,) """
    dead_zone: Annotated[Vector, Sized("n")]
    """(n,) [N]"""
    wrench_weight: Annotated[Vector, Sized("m")]
    """(6,) [1/N, 1/(N m)] weights of forces and moments where not all can be reached."""
    share: Annotated[Vector, Sized("n")]
    """(n,) [-] of `ThrusterEffectiveness`: thrust that comes, by thrust that is asked for."""
    constant: Annotated[Vector, Sized("n")]
    """(n,) [N]"""
    # found by `apply_effectiveness`
    left: LimitedThrustMemory
    """Thrusters that follow."""
    place: Annotated[list[int], Sized("n")]
    """Index of each of them among all."""
    stuck_wrench: Annotated[Vector, Sized("m")]
    """(6,) [N, N m] of those that are stuck."""
    # found by `allocate_thrust`
    wrench: Annotated[Vector, Sized("m")]
    """(6,) [N, N m] asked for; given."""
    thrust: Annotated[Vector, Sized("n")]
    """(n,) [N] thrust for the wrench, inside the limits."""
    reached: Annotated[Vector, Sized("m")]
    """(6,) [N, N m]"""
    within: Annotated[Vector, Sized("m")]
    """(6,) [N, N m] wrench that the limits allow, dead zones aside."""
    unreachable: Annotated[Vector, Sized("m")]
    """(6,) [N, N m]"""
    saturated: bool


def apply_effectiveness(allocation: AllocationMemory) -> None:
    """Apply the effectiveness, share and constant, from now on."""
    n = 0
    for i in range(allocation.count):
        if allocation.share[i] != 0.0:
            _keep(allocation, i, n)
            n += 1
    allocation.left.powers.count = n
    allocation.left.problem.rows = len(allocation.matrix)
    allocation.left.problem.columns = n
    for k in range(len(allocation.matrix)):
        allocation.left.powers.wrench_weight[k] = allocation.wrench_weight[k]
        allocation.stuck_wrench[k] = dot(
            allocation.matrix[k], allocation.constant, allocation.count
        )
    prepare_minimum_power(allocation.left.powers)


def allocate_thrust(allocation: AllocationMemory) -> bool:
    """Find the thrust for the wrench; return whether it and its square are finite: if not, there is
    none.
    """
    finite = True
    for k in range(len(allocation.matrix)):
        finite = finite and abs(allocation.wrench[k]) < LARGEST_WRENCH
        allocation.left.wrench[k] = allocation.wrench[k] - allocation.stuck_wrench[k]
    if finite:
        minimum_power(allocation.left.powers, allocation.left.wrench, allocation.left.unbounded)
        allocation.saturated = limited_thrust(allocation.left)
        _to_all(allocation)
    return finite


def _keep(allocation: AllocationMemory, i: int, to: int) -> None:
    """Copy the numbers of thruster i, which follows its commands, to a place among those that do."""
    remaining = allocation.left
    share = allocation.share[i]
    size = abs(allocation.share[i])
    allocation.place[to] = i
    for k in range(len(allocation.matrix)):
        remaining.powers.matrix[k][to] = allocation.matrix[k][i]
    remaining.lower[to] = min(share * allocation.lower[i], share * allocation.upper[i])
    remaining.upper[to] = max(share * allocation.lower[i], share * allocation.upper[i])
    remaining.dead_zone[to] = allocation.dead_zone[i] * size
    remaining.powers.largest[to] = max(remaining.upper[to], -remaining.lower[to])
    remaining.powers.factor[to] = allocation.power_factor[i] / math.exp(
        allocation.power_exponent[i] * math.log(size)
    )
    remaining.powers.exponent[to] = allocation.power_exponent[i]


def _to_all(allocation: AllocationMemory) -> None:
    """Copy the solution to all thrusters."""
    allocation.thrust[: allocation.count] = allocation.constant[: allocation.count]
    for j in range(allocation.left.powers.count):
        allocation.thrust[allocation.place[j]] += allocation.left.thrust[j]
    for k in range(len(allocation.matrix)):
        reached = 0.0
        within = 0.0
        for j in range(allocation.left.powers.count):
            reached += allocation.left.powers.matrix[k][j] * allocation.left.thrust[j]
            within += allocation.left.powers.matrix[k][j] * allocation.left.within[j]
        allocation.reached[k] = reached + allocation.stuck_wrench[k]
        allocation.within[k] = within + allocation.stuck_wrench[k]
        allocation.unreachable[k] = allocation.left.wrench[k] - reached


# Allocation: from the wrench a controller asks for to thrust inside the limits of every thruster.


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


@checked_dataclass(checked_constructor, eq=False)
class Allocation:
    """Thrust of n thrusters for a wrench on the vehicle: bounded weighted least squares, then least
    power.

    Minimises ``|diag(wrench_weight) (B thrust - wrench)|`` inside the limits; among equal wrenches it minimises
    the electrical power, to about 1e-4 of it. See `allocation_of` for a robot's. Raises `InvalidInput` for numbers
    that are not finite or out of range. Not for use from two threads at once.
    """

    matrix: Annotated[Numbers, Shape(6, "n"), Range(open=True)]
    """B (6, n) [N/N, N m/N]."""
    lower: Annotated[Numbers, Shape("n"), Range(-LARGEST_WRENCH, 0.0)]
    """(n,) [N]"""
    upper: Annotated[Numbers, Shape("n"), Range(0.0, LARGEST_WRENCH)]
    """(n,) [N]"""
    power_factor: Annotated[Numbers, Shape("n"), Range(0.0, open=True)]
    """(n,) [W/N^exponent]: power is ``factor |thrust|^exponent``."""
    power_exponent: Annotated[Numbers, Shape("n"), Range(1.0, 3.0)]
    """(n,)"""
    dead_zone: Annotated[Numbers, Shape("n"), Range(0.0, LARGEST_WRENCH)]
    """(n,) [N]: smaller thrust cannot be commanded; it becomes 0 or the edge, whichever is
    nearer.
    """
    wrench_weight: Annotated[Numbers, Shape(6), Range(0.0, open=True)] = field(
        default_factory=lambda: np.ones(6)
    )
    """(6,) [1/N, 1/(N m)]: what to give up first when not everything can be reached."""
    effectiveness: ThrusterEffectiveness | None = None
    """Effectiveness; a thruster that follows no command is left out. `None`: all are sound."""
    compiled: bool = field(default=True, repr=False)
    """Compile the kernel; not worth it for a few wrenches."""
    memory: AllocationMemory = field(init=False, repr=False)
    _allocate: Callable[[AllocationMemory], int] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        structure = allocation_type(len(self.lower))
        apply, allocate = bind_kernels(
            (apply_effectiveness, allocate_thrust), (structure,), compiled=self.compiled
        )
        object.__setattr__(self, "memory", structure())
        object.__setattr__(self, "_allocate", allocate)
        self.write(self.memory)
        apply(self.memory)

    def write(self, memory: AllocationMemory) -> None:
        """Write this allocation into an `AllocationMemory` with room for its thrusters."""
        n = len(self.lower)
        effectiveness = self.effectiveness or ThrusterEffectiveness.sound(len(self.lower))
        assign(memory, count=n, share=effectiveness.share, constant=effectiveness.constant)
        assign(memory, **{name: getattr(self, name) for name in _ARRAYS})

    def allocate(self, wrench: ArrayLike) -> AllocationResult:
        """Compute the thrust for a wrench (6,) [N, N m] about the origin of B, in B.

        Raises `InvalidInput` unless it is finite, and below `LARGEST_WRENCH`.
        """
        w = np.asarray(wrench, dtype=float)
        if w.shape != (6,):
            raise InvalidInput(f"wrench of shape {w.shape} given; allowed: (6,) [N, N m]")
        memory = self.memory
        memory.wrench[:] = w.tolist()
        if not self._allocate(memory):
            raise InvalidInput(
                f"wrench {w} given; allowed: six finite numbers below {LARGEST_WRENCH:g} [N, N m]"
            )
        wrenches = (
            np.array(memory.thrust[: memory.count]),
            np.array(memory.reached),
            np.array(memory.unreachable),
        )
        return AllocationResult(*wrenches, bool(memory.saturated))


def allocation_type(n: int) -> type[AllocationMemory]:
    """Return the type of an `AllocationMemory` with room for n thrusters."""
    return structure_of(AllocationMemory, m=6, n=room_for(n))


def allocation_of(
    robot: Robot, *, force_weight: float = 1.0, moment_weight: float = 1.0, compiled: bool = True
) -> Allocation:
    """Return the allocation of a robot's thrusters.

    When the limits bind, the acceleration that is given up is least in the norm of the kinetic
    energy (Gauss's principle of least constraint), axis by axis and without added mass: a newton
    metre turns a small hull more than a newton moves it. force_weight and moment_weight [-] say
    what to give up besides. compiled: as `Allocation` has it.
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
        wrench_weight=np.repeat([force_weight, moment_weight], 3) * _least_constraint(robot),
        compiled=compiled,
    )


def _least_constraint(robot: Robot) -> np.ndarray:
    """Return the weights (6,) [-, 1/m] of forces and moments: 1 over the radius of gyration about
    each axis, of all bodies at home.
    """
    if not robot.n_vehicle:
        return np.ones(6)
    inertia = np.diag(pin.crba(robot.model, robot.model.createData(), robot.configuration()))[:6]
    return np.sqrt(inertia[0] / np.maximum(inertia, 1e-6 * inertia[0]))


def _powers(thrusters: tuple[Thruster, ...]) -> list[Power]:
    powers = [thruster.power for thruster in thrusters if thruster.power is not None]
    if len(powers) == len(thrusters):
        return powers
    # Without data for all, full thrust costs the same for each.
    return [Power(thrust=thruster.largest_thrust, watts=1.0) for thruster in thrusters]
