"""What a bound solver is: a callable from the inputs of the levels' Function to one result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.solvers.hierarchy.level import Array
from uvms_ocp.solvers.hierarchy.solution import Status

LEVEL_OUTPUTS = ("J", "lower", "upper", "rate", "activation", "gate")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TickResult:
    """Outcome of one tick; the arrays belong to the caller."""

    v: Array
    """(n,) generalized velocity, always finite."""
    status: Status
    residual: Array
    """(M,) signed distance of J v to [lower, upper], 0 where the gate is 0."""
    extras: tuple[Array, ...]
    """Outputs of the levels' Function after the six of the levels, in its order."""
    solve_time: float
    """[s], evaluation of the levels included."""


class Tick(Protocol):
    """A solver bound to a Function that computes the levels."""

    def __call__(self, *inputs: ArrayLike) -> TickResult:
        """Inputs in the order of the levels' Function; raise ``InvalidInput`` for a wrong number or shape."""


class Buffered:
    """A Function evaluated in fixed memory, ten times faster than a call that converts matrices."""

    __slots__ = ("_buffer", "_evaluate", "_function", "_inputs", "_outputs", "_views")

    def __init__(self, function: ca.Function) -> None:
        """All inputs and outputs of ``function`` must be dense."""
        self._function = function
        self._buffer, self._evaluate = function.buffer()
        self._inputs = [_storage(function.size_in(i)) for i in range(function.n_in())]
        self._outputs = [_storage(function.size_out(i)) for i in range(function.n_out())]
        self._views = [_memory(array) for array in (*self._inputs, *self._outputs)]
        for i in range(len(self._inputs)):
            self._buffer.set_arg(i, self._views[i])
        for i in range(len(self._outputs)):
            self._buffer.set_res(i, self._views[len(self._inputs) + i])

    def __call__(self, inputs: Sequence[ArrayLike]) -> list[Array]:
        """Outputs as fresh arrays; columns are one-dimensional."""
        if len(inputs) != len(self._inputs):
            names = ", ".join(self._function.name_in())
            raise InvalidInput(f"{len(inputs)} inputs given; the tick takes {len(self._inputs)}: {names}")
        for i, value in enumerate(inputs):
            self._write(i, value)
        self._evaluate()
        return [array.copy() for array in self._outputs]

    @property
    def failed(self) -> bool:
        """True if the last evaluation was abandoned, which leaves the outputs meaningless."""
        return bool(self._buffer.ret())

    def _write(self, i: int, value: ArrayLike) -> None:
        target = self._inputs[i]
        if type(value) is not np.ndarray or value.shape != target.shape:
            value = self._shaped(i, value)
        target[...] = value

    def _shaped(self, i: int, value: ArrayLike) -> Array:
        target, array = self._inputs[i], np.asarray(value, dtype=np.float64)
        if array.size != target.size or array.squeeze().shape != target.squeeze().shape:
            raise InvalidInput(f"input {self._function.name_in(i)!r} has shape {array.shape}; give {target.shape}")
        return array.reshape(target.shape)


def check_levels_function(levels: ca.Function, sizes: Sequence[int]) -> None:
    """Raise ``InvalidInput`` unless ``levels`` starts with ``LEVEL_OUTPUTS`` and has the rows of ``sizes``."""
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


def _storage(shape: tuple[int, int]) -> Array:
    return np.zeros(shape[0]) if shape[1] == 1 else np.zeros(shape, order="F")


def _memory(array: Array) -> memoryview:
    # CasADi reads column-major memory and refuses views that are not C-contiguous.
    return array.T.data
