"""A CasADi function with its numbers as data, so that functions that differ in numbers alone share machine code."""

from __future__ import annotations

import casadi as ca
import numpy as np

from uvms_ocp.arguments import checked
from uvms_ocp.functions.compile import compile_function

_EXACT = frozenset((0.0, 1.0, -1.0, 2.0, 0.5))  # of the form of an expression rather than of its values


@checked
def compile_shared(function: ca.Function) -> ca.Function:
    """``function`` of SX in machine code that is compiled once for all of the same form, whatever numbers stand in them.

    The results are those of `compile_function` to the last bit; where nothing can be compiled it is the function itself.
    """
    form, numbers = numbers_apart(function)
    compiled = compile_function(form)
    if compiled is form:
        return function
    inputs = [ca.MX.sym(function.name_in(k), function.sparsity_in(k)) for k in range(function.n_in())]
    results = compiled.call([*inputs, ca.DM(numbers)], False, True)
    return ca.Function(function.name(), inputs, results, function.name_in(), function.name_out())


@checked
def numbers_apart(function: ca.Function) -> tuple[ca.Function, np.ndarray]:
    """The form of ``function`` of SX, which takes as a last input the numbers (n,) [-] that are returned with it."""
    inputs = [ca.SX.sym(function.name_in(k), function.sparsity_in(k)) for k in range(function.n_in())]
    known: dict[float, ca.SX] = {}
    results = _walked(function, inputs, known)
    column = ca.vertcat(*known.values()) if known else ca.SX(0, 1)
    names_in, names_out = [*function.name_in(), "numbers"], function.name_out()
    form = ca.Function(f"{function.name()}_form", [*inputs, column], results, names_in, names_out)
    return form, np.array(list(known))


def _walked(function: ca.Function, inputs: list[ca.SX], known: dict[float, ca.SX]) -> list[ca.SX]:
    """Every instruction once more, with a symbol in the place of each number that is not one of the form."""
    work: list[ca.SX] = [ca.SX()] * function.sz_w()
    given = [column.nonzeros() for column in inputs]
    found = [[ca.SX()] * function.nnz_out(k) for k in range(function.n_out())]
    for k in range(function.n_instructions()):
        kind, into, of = function.instruction_id(k), function.instruction_output(k), function.instruction_input(k)
        if kind == ca.OP_CONST:
            work[into[0]] = _symbol(function.instruction_constant(k), known)
        elif kind == ca.OP_INPUT:
            work[into[0]] = given[of[0]][of[1]]
        elif kind == ca.OP_OUTPUT:
            found[into[0]][into[1]] = work[of[0]]
        elif len(of) == 2:
            work[into[0]] = ca.SX.binary(kind, work[of[0]], work[of[1]])
        else:
            work[into[0]] = ca.SX.unary(kind, work[of[0]])
    return [ca.SX(function.sparsity_out(k), ca.vertcat(*values)) for k, values in enumerate(found)]


def _symbol(value: float, known: dict[float, ca.SX]) -> ca.SX:
    if value in _EXACT or not np.isfinite(value):
        return ca.SX(value)
    if value not in known:
        known[value] = ca.SX.sym(f"n{len(known)}")
    return known[value]
