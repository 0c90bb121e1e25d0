"""Functions that are no kernels; each with what its refusal says."""

from __future__ import annotations

import math
from typing import Annotated, Any

from uvms_ocp.codegen.kernel_layout import FunctionField, Layout, Sized, Vector, zeros


class Small(Layout):
    """What they work on."""

    n: int
    x: float
    values: Annotated[Vector, Sized(3)]
    pair: Annotated[Vector, Sized(2)]
    root: FunctionField


def of_a_layout_that_is_no_vector(m: Small) -> None:
    """m is no vector of 4 numbers"""
    m.root(m, m.values)


def to_a_power(m: Small) -> float:
    """line \\d+: m.x \\*\\* 3 is nothing that a kernel can do"""
    return m.x**3


def of_a_text(m: Small) -> None:
    """'far' is no number"""
    m.x = "far"  # type: ignore[assignment]


def of_a_field_that_is_not_there(m: Small) -> float:
    """Small has no field 'y'; it has n, x, values, pair, root"""
    return m.y  # type: ignore[attr-defined, no-any-return]


def of_a_changing_type(m: Small) -> float:
    """k is int at first and double here"""
    k = 0
    k = m.x  # type: ignore[assignment]
    return k + 1


def of_a_whole_number_that_is_none(m: Small) -> None:
    """is a whole number; make the value one by int"""
    m.n = m.x  # type: ignore[assignment]


def over_a_list(m: Small) -> float:
    """has to go over a range"""
    total = 0.0
    for x in m.values:
        total += x
    return total


def of_unknown_length(m: Small, x: Vector) -> int:
    """is not known here; give the number to the kernel"""
    return len(x) + m.n


def of_a_size_that_changes(m: Small) -> None:
    """needs a size that is known"""
    x = zeros(m.n)
    m.x = x[0]


def copying_from_within(m: Small) -> None:
    """has to become the first numbers of another array, as many"""
    m.values[1:3] = m.values[:3]


def copying_as_many_as_there_may_be(m: Small, x: Vector) -> None:
    """has to become the first numbers of another array, as many"""
    m.values[: m.n] = x


def copying_more_than_there_are(m: Small) -> None:
    """m.values\\[:\\] has to become the first numbers of another array, as many"""
    m.values[:] = m.pair


def copying_to_an_unknown_length(m: Small, x: Vector) -> None:
    """line \\d+: x\\[:\\] is not known here; give the number to the kernel"""
    x[:] = m.values


def of_swapped_names(m: Small) -> float:
    """has to give values that depend on nothing that it changes"""
    a = m.x
    b = 2.0
    a, b = b, a
    return a - b


def of_swapped_fields(m: Small) -> None:
    """has to give values that depend on nothing that it changes"""
    m.x, m.values[0] = 2.0, m.x


def of_swapped_entries(m: Small) -> None:
    """has to give values that depend on nothing that it changes"""
    x = m.values
    x[0], x[1] = 2.0, m.values[0]


def of_a_field_that_a_call_may_read(m: Small) -> None:
    """has to give values that depend on nothing that it changes"""
    m.x, m.n = 2.0, of_unknown_length(m, m.values)


def of_too_few_values(m: Small) -> None:
    """has to give as many values"""
    m.x, m.n = m.values  # type: ignore[assignment, misc]


def calling_what_is_no_kernel(m: Small) -> None:
    """gamma is no function written in Python"""
    m.x = math.gamma(m.x)


def calling_a_builtin(m: Small) -> None:
    """has to call a kernel with arguments by place"""
    print(m.x)


def calling_with_too_few(m: Small) -> float:
    """has to give 2 arguments"""
    return _sum(m.x)  # type: ignore[call-arg]


def _sum(a: float, b: float) -> float:
    return a + b


def calling_a_function_with_too_few(m: Small) -> None:
    """has to give 1 vectors to read and 1 to fill"""
    m.root(m.values)


def calling_a_function_with_a_short_vector(m: Small) -> None:
    """m.values is no vector of 4 numbers"""
    m.root(m.values, m.values)


def without_annotation(m: Any) -> float:
    """without_annotation: m is annotated with .*; give float, int, bool, Vector or a layout of \\['Small'\\]"""
    return float(m.x)


def that_is_nested(m: Small) -> float:
    """is nothing that a kernel can do"""

    def inner() -> float:
        return m.x

    return inner()


ALL = (
    of_a_layout_that_is_no_vector,
    to_a_power,
    of_a_text,
    of_a_field_that_is_not_there,
    of_a_changing_type,
    of_a_whole_number_that_is_none,
    over_a_list,
    of_unknown_length,
    of_a_size_that_changes,
    copying_from_within,
    copying_as_many_as_there_may_be,
    copying_more_than_there_are,
    copying_to_an_unknown_length,
    of_swapped_names,
    of_swapped_fields,
    of_swapped_entries,
    of_a_field_that_a_call_may_read,
    of_too_few_values,
    calling_what_is_no_kernel,
    calling_a_builtin,
    calling_with_too_few,
    calling_a_function_with_too_few,
    calling_a_function_with_a_short_vector,
    without_annotation,
    that_is_nested,
)
