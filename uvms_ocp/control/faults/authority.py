"""Control authority: the largest force along each axis that the remaining thrusters can give while
the others are balanced.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from uvms_ocp.codegen.kernel_layout import Layout, Sized, Vector, view
from uvms_ocp.control.faults.verdicts import ThrusterEffectiveness, effective_thrust
from uvms_ocp.robot.thrusters import AXES
from uvms_ocp.solvers.linear_program import LinearProgram, linear_program, solve_program, value_of

_GONE = 0.02  # share of the reach of sound thrusters that counts as none
_LEAST = 0.05  # share that a mission needs on the axes that nothing else holds
# and nothing between them, where the righting moment may do
_ROLL = 3
_PITCH = 4


class AuthorityMemory(Layout):
    """Inputs and results of `judge_authority`."""

    matrix: Annotated[list[Vector], Sized(6, "n_thrusters")]
    """(6, n_thrusters) [N/N, N m/N] wrench about the origin of B by the thrust of each thruster."""
    lower: Annotated[Vector, Sized("n_thrusters")]
    """(n_thrusters,) [N] lower limits of what may be asked."""
    upper: Annotated[Vector, Sized("n_thrusters")]
    """(n_thrusters,) [N] upper limits of what may be asked."""
    trim: Annotated[Vector, Sized(6)]
    """(6,) [N, N m] that holds the robot still."""
    righting: Annotated[Vector, Sized(6)]
    """(6,) [N, N m] that the water balances on its own, within the tilt that is allowed."""
    program: LinearProgram
    reach: Annotated[list[Vector], Sized(6, 2)]
    """(6, 2) [N, N m] largest additional force down and up each axis; NaN where it cannot hold."""
    sound: Annotated[list[Vector], Sized(6, 2)]
    """(6, 2) [N, N m] largest additional force of sound thrusters."""
    holds: bool
    can_go_on: bool


def judge_authority(authority: AuthorityMemory, effectiveness: ThrusterEffectiveness) -> None:
    """Compute the control authority left with this effectiveness: twenty-four linear programs."""
    n = len(authority.lower)
    authority.program.lower[:n] = authority.lower[:n]
    authority.program.upper[:n] = authority.upper[:n]
    _reach_out(authority, False)
    for i in range(n):
        authority.program.lower[i] = min(
            effective_thrust(effectiveness, i, authority.lower[i]),
            effective_thrust(effectiveness, i, authority.upper[i]),
        )
        authority.program.upper[i] = max(
            effective_thrust(effectiveness, i, authority.lower[i]),
            effective_thrust(effectiveness, i, authority.upper[i]),
        )
    _reach_out(authority, True)
    _conclude_authority(authority)


def _reach_out(authority: AuthorityMemory, trimmed: bool) -> None:
    """Find the largest forces along all axes within the limits of the program; trimmed: of what is
    left, from the wrench that holds the robot still.
    """
    for axis in range(6):
        for way in range(2):
            largest = _largest_along(authority, axis, way, trimmed)
            if trimmed:
                authority.reach[axis][way] = largest
            else:
                authority.sound[axis][way] = largest


def _largest_along(authority: AuthorityMemory, axis: int, way: int, trimmed: bool) -> float:
    """Return the largest x with ``matrix T + s = trim + way x e``, T within its limits, s within
    what the water balances.

    way: 0 down the axis, 1 up. NaN where there is none.
    """
    program = authority.program
    n = len(authority.lower)
    for k in range(6):
        _write_balance(authority, k, k == axis and _ROLL <= axis <= _PITCH, trimmed)
    program.A[axis][n + 6] = 1.0 - 2.0 * way
    program.lower[n + 6] = 0.0
    program.upper[n + 6] = math.inf
    program.c[n + 6] = 1.0
    if solve_program(program):
        return value_of(program)
    return math.nan


def _write_balance(authority: AuthorityMemory, k: int, is_own_axis: bool, trimmed: bool) -> None:
    """Compute the reach on axis k; is_own_axis: by the thrusters alone, whatever the water
    balances.
    """
    program = authority.program
    n = len(authority.lower)
    for i in range(len(program.c)):
        program.A[k][i] = authority.matrix[k][i] if i < n else 0.0
    program.A[k][n + k] = 1.0
    program.upper[n + k] = 0.0 if is_own_axis else authority.righting[k]
    program.lower[n + k] = -program.upper[n + k]
    if trimmed and not is_own_axis:
        program.b[k] = authority.trim[k]
    else:
        program.b[k] = 0.0


def _conclude_authority(authority: AuthorityMemory) -> None:
    """Return whether the robot can be held still, and pushed either way on every axis that the
    water does not hold.
    """
    authority.holds = True
    enough = True
    for axis in range(6):
        for way in range(2):
            authority.holds = authority.holds and math.isfinite(authority.reach[axis][way])
            held = _ROLL <= axis <= _PITCH
            enough = enough and (
                held or authority.reach[axis][way] >= _LEAST * authority.sound[axis][way]
            )
    authority.can_go_on = authority.holds and enough


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Authority:
    """Forces that are left along each axis of B, beside the wrench that holds the robot still."""

    reach: np.ndarray
    """(6, 2) [N, N m] largest additional force down and up the axis, the other axes balanced; NaN
    where it cannot even hold.
    """
    sound: np.ndarray
    """(6, 2) [N, N m] reach of sound thrusters."""
    holds: bool
    """The robot can be held still."""
    can_go_on: bool
    """The robot can be held still and pushed either way on every axis that the water does not
    hold.
    """

    @property
    def lost(self) -> tuple[str, ...]:
        """Axes along which there is no force of its own either way any more."""
        n_lost_ways = self._out_of_reach().sum(axis=1)
        return tuple(axis for k, axis in enumerate(AXES) if n_lost_ways[k] == 2)

    @property
    def one_sided(self) -> tuple[str, ...]:
        """Axes along which there is force one way only."""
        n_lost_ways = self._out_of_reach().sum(axis=1)
        return tuple(axis for k, axis in enumerate(AXES) if n_lost_ways[k] == 1)

    def __str__(self) -> str:
        """Describe the authority in one line."""
        if not self.holds:
            return "the thrusters that are left cannot hold the robot still"
        parts = [f"{axis} can no longer be driven on its own" for axis in self.lost]
        parts += [f"{axis} can be driven one way only" for axis in self.one_sided]
        shares = np.min(self.reach / np.maximum(self.sound, np.finfo(float).tiny), axis=1)
        described_axes = (*self.lost, *self.one_sided)
        for axis, share in zip(AXES, shares, strict=True):
            if axis not in described_axes and share < 0.95:
                parts.append(f"{axis} {100 * share:.0f} %")
        if parts:
            return f"left of the reach: {', '.join(parts)}"
        return "nothing is out of reach"

    def _out_of_reach(self) -> np.ndarray:
        """Check (6, 2) which of what sound thrusters reach is out of reach."""
        return (self.sound > _GONE * self.sound.max()) & ~(self.reach > _GONE * self.sound)


def authority_in(memory: AuthorityMemory) -> Authority:
    """Read the authority in an `AuthorityMemory`."""
    return Authority(
        reach=view(memory.reach).copy(),
        sound=view(memory.sound).copy(),
        holds=bool(memory.holds),
        can_go_on=bool(memory.can_go_on),
    )


def authority_program(n: int) -> type[LinearProgram]:
    """Return the type of the `program` of an `AuthorityMemory` of n thrusters."""
    return linear_program(6, n + 7)
