"""Decide whether a program that was built for one problem solves another one, with new
parameters.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, is_dataclass

import casadi as ca
import numpy as np

from uvms_ocp.errors import InvalidInput
from uvms_ocp.ocp.problem import OcpLevel, OcpPhase, OcpProblem
from uvms_ocp.ocp.terms import Term
from uvms_ocp.ocp.transcription.stage import StageModel
from uvms_ocp.ocp.transcription.term_rows import (
    CONSTRAINT,
    TermBlock,
    TermEntry,
    TermNumbers,
    TermRows,
    residual_of,
    term_numbers,
)
from uvms_ocp.solvers.nlp.program import row_kinds
from uvms_ocp.tasks.task import Residual

_VARYING = {
    OcpProblem: ("start", "current", "phases", "levels", "constraints", "longest"),
    OcpPhase: ("duration",),
    OcpLevel: ("terms", "relax"),
}
"""Fields that may differ, or whose parts are looked at one by one."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ReusedProblem:
    """A problem, and what a kept program takes from its terms."""

    problem: OcpProblem
    numbers: tuple[TermNumbers, ...]
    """Numbers of each block."""


def fit_problem(
    model: StageModel, blocks: Sequence[TermBlock], problem: OcpProblem
) -> ReusedProblem:
    """Return the numbers of a problem for the program of `blocks`; raises `InvalidInput` for a
    problem of another shape.
    """
    built = model.problem
    if problem is built:
        return ReusedProblem(problem=built, numbers=tuple(block.rows.numbers for block in blocks))
    _require_same_fields("the problem", built, problem)
    _require_same_parts(built, problem)
    numbers = tuple(_numbers(model, block.rows, problem) for block in blocks)
    return ReusedProblem(problem=problem, numbers=numbers)


def _require_same_parts(built: OcpProblem, problem: OcpProblem) -> None:
    _require_as_many("the problem", "phases", built.phases, problem.phases)
    for built_phase, phase in zip(built.phases, problem.phases, strict=True):
        _require_same_fields(f"phase {phase.name!r}", built_phase, phase)
    _require_equal("the problem", "free durations", built.free_time, problem.free_time)
    _require_equal("the problem", "a limited total", built.limits_total, problem.limits_total)
    _require_as_many("the problem", "constraints", built.constraints, problem.constraints)
    _require_as_many("the problem", "levels", built.levels, problem.levels)
    for built_level, level in zip(built.levels, problem.levels, strict=True):
        place = f"level {level.name!r}"
        _require_same_fields(place, built_level, level)
        _require_as_many(place, "terms", built_level.terms, level.terms)
        if (built_level.relax is None) != (level.relax is None):
            _require_equal(place, "relax", built_level.relax, level.relax)


def _require_same_fields(place: str, built: object, requested: object) -> None:
    for field in fields(built):  # type: ignore[arg-type]
        name = field.name
        if name not in _VARYING[type(built)]:
            _require_equal(place, name, getattr(built, name), getattr(requested, name))


def _require_equal(place: str, name: str, built: object, requested: object) -> None:
    if _is_same(built, requested):
        return
    if is_dataclass(built):
        differences = ", ".join(_differences(built, requested, name))
        raise InvalidInput(
            f"{place} differs in {differences} from the planner's: build a new Planner"
        )
    raise InvalidInput(
        f"{place} has {name} = {requested}, the planner was built for {built}: build a new Planner"
    )


def _require_as_many(
    place: str, name: str, built: Sequence[object], requested: Sequence[object]
) -> None:
    if len(built) != len(requested):
        raise InvalidInput(
            f"{place} has {len(requested)} {name}, the planner was built for {len(built)}: build a"
            " new Planner"
        )


def _numbers(model: StageModel, rows: TermRows, problem: OcpProblem) -> TermNumbers:
    """Return the numbers of a problem's terms in the place of those that rows were built for."""
    terms = [problem.terms[member.place] for member in rows.members]
    pairs = list(zip(rows.members, terms, strict=True))
    if all(term is member.term for member, term in pairs):
        return rows.numbers
    return term_numbers(terms, [_residual(model, member, term) for member, term in pairs])


def _residual(model: StageModel, member: TermEntry, term: Term) -> Residual:
    """Return the residual of a term in the place of another one."""
    built = member.residual
    if term is member.term or not any(_differences(member.term, term)):
        return built
    if _role(model, member.term) != _role(model, term):
        raise _differs(model, member, term)
    residual = residual_of(model, term, member.goals)
    built_kinds = row_kinds(built.lower, built.upper)
    kinds = row_kinds(residual.lower, residual.upper)
    if not built_kinds.same(kinds):
        raise _differs(model, member, term)
    symbols = (model.z, model.water, member.goals)
    if not _is_same_expression(built.value, residual.value, *symbols):
        raise _differs(model, member, term)
    return residual


def _role(model: StageModel, term: Term) -> tuple[object, ...]:
    """Return the key that decides where the rows of a term are, and their names."""
    return (
        term.name,
        term.at,
        term.phase,
        term.state_only,
        term.is_goal,
        term.n_parameters(model.robot),
    )


def _is_same_expression(first: ca.SX, second: ca.SX, *symbols: ca.SX) -> bool:
    if first.shape != second.shape:
        return False
    first_text = ca.Function("rows", list(symbols), [first]).serialize()
    second_text = ca.Function("rows", list(symbols), [second]).serialize()
    return bool(first_text == second_text)


def _differs(model: StageModel, member: TermEntry, term: Term) -> InvalidInput:
    """Return the error of a term that cannot take the place of the built one."""
    if member.level == CONSTRAINT:
        place = "constraints"
    else:
        place = f"level {model.problem.levels[member.level].name!r}"
    differences = ", ".join(_differences(member.term, term))
    return InvalidInput(
        f"{place}: term {term.name!r} differs in {differences} from the planner's: build a new"
        " Planner"
    )


def _differences(built: object, requested: object, path: str = "") -> Iterator[str]:
    """Yield the names of what differs: fields, those of fields in their fields too, and whatever
    else an instance carries.
    """
    if type(built) is not type(requested):
        yield f"{path or 'kind'} ({type(requested).__name__}, not {type(built).__name__})"
        return
    for attribute in {**_attributes(built), **_attributes(requested)}:
        built_value = getattr(built, attribute, None)
        value = getattr(requested, attribute, None)
        name = f"{path}.{attribute}" if path else attribute
        if is_dataclass(built_value) and built_value is not value:
            yield from _differences(built_value, value, name)
        elif not _is_same(built_value, value):
            yield name


def _attributes(value: object) -> dict[str, None]:
    """Return the names of all that an instance carries: a user's class need not be a dataclass all
    the way down.
    """
    names = [field.name for field in fields(value)]  # type: ignore[arg-type]
    for kind in type(value).__mro__:
        names += _slots(kind)
    names += getattr(value, "__dict__", ())
    return dict.fromkeys(name for name in names if hasattr(value, name))


def _slots(kind: type) -> list[str]:
    slots = kind.__dict__.get("__slots__", ())
    if isinstance(slots, str):
        slots = (slots,)
    return [name for name in slots if not name.startswith("__")]


def _is_same(first: object, second: object) -> bool:
    if first is second:
        return True
    if isinstance(first, (tuple, list)) and isinstance(second, (tuple, list)):
        if len(first) != len(second):
            return False
        return all(_is_same(a, b) for a, b in zip(first, second, strict=True))
    if isinstance(first, np.ndarray) or isinstance(second, np.ndarray):
        return bool(np.array_equal(first, second))  # type: ignore[arg-type]
    if is_dataclass(first):
        return type(first) is type(second) and not any(_differences(first, second))
    return bool(first == second)
