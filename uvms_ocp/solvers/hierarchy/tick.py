"""What a bound solver is: a callable from the inputs of the levels' Function to one result.

`[rate]` is the unit of a row, `[velocity]` that of an entry of v.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Protocol, runtime_checkable

import casadi as ca
from numpy.typing import ArrayLike

from uvms_ocp.arguments import Shape, checked
from uvms_ocp.arrays import Array
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.solvers.hierarchy.solution import Status

LEVEL_OUTPUTS = ("J", "lower", "upper", "rate", "activation", "gate")


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TickResult:
    """Outcome of one tick; the arrays belong to the caller."""

    v: Annotated[Array, Shape("n")]
    """(n,) [velocity] always finite."""
    status: Status
    """How far v can be relied on."""
    residual: Annotated[Array, Shape("M")]
    """(M,) [rate] signed distance of J v to [lower, upper], 0 where the gate is 0."""
    extras: tuple[Array, ...]
    """(m,) or (m, n) [any] outputs of the levels' Function after the six of the levels, in its order."""
    solve_time: float
    """[s], evaluation of the levels included."""


class Tick(Protocol):
    """A solver bound to a Function that computes the levels."""

    def __call__(self, *inputs: ArrayLike) -> TickResult:
        """Inputs in the order of the levels' Function. Raises `InvalidInput` for a wrong number or shape."""


@runtime_checkable
class SharedTick(Tick, Protocol):
    """One that can read its inputs where they are."""

    def adopt(self, *inputs: Array) -> Callable[[], TickResult]:
        """The call with these arrays, (m,) or (m, n) [any], as they are then, without copies. No other call comes after it."""


def check_levels_function(levels: ca.Function, sizes: Sequence[int]) -> None:
    """Raises `InvalidInput` unless ``levels`` starts with ``LEVEL_OUTPUTS`` and has the rows of ``sizes``."""
    given = tuple(levels.name_out()[: len(LEVEL_OUTPUTS)])
    if given != LEVEL_OUTPUTS:
        raise InvalidInput(f"levels function returns {given}; its first outputs must be {LEVEL_OUTPUTS}")
    if levels.size1_out(0) != sum(sizes) or any(size < 0 for size in sizes):
        raise InvalidInput(f"sizes {tuple(sizes)} sum to {sum(sizes)}; the levels have {levels.size1_out(0)} rows")


def dense_inputs(function: ca.Function) -> list[ca.MX]:
    """A dense symbol for every input of ``function``, with its name."""
    return [ca.MX.sym(name, *function.size_in(i)) for i, name in enumerate(function.name_in())]


def dense_outputs(function: ca.Function, symbols: Sequence[ca.MX]) -> list[ca.MX]:
    """Outputs of ``function`` at ``symbols``, without structural zeros."""
    return [ca.densify(output) for output in function.call(list(symbols))]


def dense(function: ca.Function) -> ca.Function:
    """``function`` with the same names and dense inputs and outputs."""
    inputs = dense_inputs(function)
    return ca.Function(
        function.name(), inputs, dense_outputs(function, inputs), function.name_in(), function.name_out()
    )
