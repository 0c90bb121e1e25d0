"""A kernel is the same function in Python and in C."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest
import refused_kernels
from compiler import IN_C_AND_PYTHON, needs_compiler
from sample_kernels import Curious, Memory, Motion, Roots, advance, inquire, take_roots, tick

from uvms_ocp.codegen.kernel_layout import (
    NOT_COUNTED,
    CallbackBinding,
    Layout,
    column_view,
    connect,
    functions_in,
    structure_of,
)
from uvms_ocp.codegen.kernel_program import c_program
from uvms_ocp.codegen.kernels import bind_kernels, make_memory
from uvms_ocp.errors import InvalidInput
from uvms_ocp.estimation.filter_memory import filter_memory


def _numbers(memory: ctypes.Structure) -> list[float]:
    """All that it holds, one after the other."""
    numbers: list[float] = []
    for name, _ in memory._fields_:  # type: ignore[misc]
        _gather(getattr(memory, name), numbers)
    return numbers


def _gather(value: Any, numbers: list[float]) -> None:
    if isinstance(value, ctypes.Structure):
        numbers += _numbers(value)
    elif isinstance(value, ctypes.Array):
        for item in value:
            _gather(item, numbers)
    else:
        numbers.append(value)


@needs_compiler
@pytest.mark.parametrize("n", [2, 4])
def test_python_and_c_give_the_same_bits(n: int) -> None:
    """Over many ticks, with what they remember, whatever comes in."""
    structure = structure_of(Memory, n=n)
    (in_c,) = bind_kernels((tick,), (structure,))
    assert in_c is not tick
    mine = structure()
    memory = structure()
    draw = np.random.default_rng(n)
    for _ in range(500):
        x = float(draw.choice([0.0, 0.75, -0.75, *draw.normal(0.0, 3.0, 3)]))
        quiet = bool(draw.random() < 0.3)
        assert in_c(mine, x, quiet) == tick(memory, x, quiet)
    np.testing.assert_array_equal(_numbers(mine), _numbers(memory))
    assert mine.windows[0].count == 500


def _pendulum() -> ca.Function:
    x = ca.SX.sym("x", 2)
    push = ca.SX.sym("push")
    rate = ca.vertcat(x[1], push - ca.sin(x[0]))
    slope = ca.densify(ca.jacobian(rate, x))
    return ca.Function("pendulum", [x, push], [rate, slope, x[1] ** 2 / 2 - ca.cos(x[0])])


@needs_compiler
def test_kernels_call_smooth_functions() -> None:
    """In machine code from machine code, and in Python with the same numbers up to rounding."""
    structure = structure_of(Motion, dynamics=_pendulum())
    mine, (in_c,) = make_memory(structure, (advance,))
    python_memory, (in_python,) = make_memory(structure, (advance,), compiled=False)
    assert in_python is advance
    assert in_c is not advance
    for memory in (mine, python_memory):
        memory.x[0] = 1.0
    for push in (0.3, -2.0, 0.0):
        assert in_c(mine, push, 50) == pytest.approx(in_python(python_memory, push, 50), abs=1e-12)
    assert list(mine.slope) == pytest.approx(
        [0.0, -np.cos(mine.x[0] - 0.01 * mine.rate[0]), 1.0, 0.0], abs=1e-12
    )


def test_two_functions_of_one_form_are_not_mixed_up() -> None:
    """Which one a kernel calls is part of its memory, not of its code."""
    x = ca.SX.sym("x", 2)
    push = ca.SX.sym("push")
    for gain in (1.0, -2.0):
        function = ca.Function("linear", [x, push], [gain * x, ca.SX.ones(2, 2), ca.sumsqr(x)])
        memory, (in_c,) = make_memory(structure_of(Motion, dynamics=function), (advance,))
        memory.x[0] = 1.0
        in_c(memory, 0.0, 1)
        assert memory.x[0] == 1.0 + 0.01 * gain


@pytest.mark.parametrize("compiled", IN_C_AND_PYTHON)
def test_a_layout_of_nothing_but_numbers_is_a_vector_of_them(compiled: bool) -> None:
    memory, (roots,) = make_memory(
        structure_of(Roots, root=_ROOT), (take_roots,), compiled=compiled
    )
    memory.given.first[0] = 4.0
    memory.given.rest[:] = [9.0, 16.0, 25.0]
    roots(memory)
    assert (*memory.told.first, *memory.told.rest) == (2.0, 3.0, 4.0, 5.0)
    np.testing.assert_array_equal(column_view(memory.told), [2.0, 3.0, 4.0, 5.0])


@pytest.mark.parametrize("compiled", IN_C_AND_PYTHON)
def test_a_kernel_asks_python_which_answers_in_its_memory(compiled: bool) -> None:
    memory: Any
    memory, (ask_on,) = make_memory(structure_of(Curious), (inquire,), compiled=compiled)
    assert compiled == (ask_on is not inquire)

    def double() -> None:
        if memory.x > 20.0:
            raise OverflowError(f"{memory.x:g} is too much")
        memory.x *= 2.0

    answer = CallbackBinding(memory.ask, double)
    assert ask_on(memory, 4) == 22.0
    answer.check()
    assert ask_on(memory, 1) == 22.0
    with pytest.raises(OverflowError, match="22 is too much"):
        answer.check()
    answer.check()


def test_a_function_with_structural_zeros_is_refused() -> None:
    x = ca.SX.sym("x", 2)
    with pytest.raises(InvalidInput, match="sparse has sparse arguments; make them dense"):
        structure_of(Motion, dynamics=ca.Function("sparse", [x], [ca.diag(x)]))


def test_without_a_compiler_it_is_the_function_itself() -> None:
    assert bind_kernels((tick,), (structure_of(Memory, n=2),), compiled=False) == (tick,)


def test_sizes_of_a_layout_are_those_of_its_parts() -> None:
    memory = structure_of(Memory, n=5)()
    assert (len(memory.windows), len(memory.double[0]), len(memory.windows[4].values)) == (5, 3, 7)
    assert structure_of(Memory, n=5) is structure_of(Memory, n=5)
    with pytest.raises(
        InvalidInput, match=r"Memory\.windows needs 'n', which is not given; given: \[\]"
    ):
        structure_of(Memory)
    assert structure_of(Memory, SimpleNamespace(n=5, other=7)) is structure_of(Memory, n=5)
    with pytest.raises(InvalidInput, match=r"needs 'n', which is not given"):
        structure_of(Memory, SimpleNamespace(n=NOT_COUNTED))


def test_memories_of_any_age_have_one_type_of_a_part() -> None:
    old = structure_of(Memory, n=5)()
    for n in range(6, 200):  # more than are remembered
        structure_of(Memory, n=n)
    assert structure_of(Memory, n=5) is type(old)
    assert type(old.windows[0]) is type(structure_of(Memory, n=4)().windows[0])


def test_a_field_that_memory_cannot_hold_is_refused() -> None:
    with pytest.raises(InvalidInput, match=r"Wrong\.name is <class 'str'>; give float, int, bool"):
        structure_of(Wrong)


class Wrong(Layout):
    """Not numbers alone."""

    name: str


_X = ca.SX.sym("x", 4)
_ROOT = ca.Function("root", [_X], [ca.sqrt(_X)])


@pytest.mark.parametrize("kernel", refused_kernels.ALL, ids=lambda kernel: kernel.__name__)
def test_what_is_no_kernel_is_refused_with_its_line(kernel: Callable[..., Any]) -> None:
    """Each says in its docstring what the refusal has to tell."""
    with pytest.raises(InvalidInput, match=kernel.__doc__ or "-"):
        c_program((kernel,), (structure_of(refused_kernels.Small, root=_ROOT),))


@needs_compiler
def test_functions_that_give_nothing_are_connected_too() -> None:
    """A robot without joints has functions whose values are empty; one that was left out was called
    at the address 0.
    """
    memory = filter_memory(0)
    assert connect(memory)
    assert all(part.call for part in functions_in(memory) if part.function.n_out())
