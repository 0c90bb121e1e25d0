"""Decide whether a program that was built for one problem solves another one with other parameters.

Start, current, durations, weights, bounds, and what terms give as references (goals, obstacles) may differ. All else must
be the same: the fields of problems, phases and levels one by one, and of every term the very expression of its rows, so
that no field of a term can be forgotten.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, is_dataclass

import casadi as ca
import numpy as np

from uvms_ocp.errors import InvalidInput
from uvms_ocp.ocp.problem import OcpLevel, OcpPhase, OcpProblem
from uvms_ocp.ocp.terms import Term
from uvms_ocp.ocp.transcription import term_rows
from uvms_ocp.ocp.transcription.stage import StageModel
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
    numbers: tuple[term_rows.TermNumbers, ...]
    """Numbers of each block."""


def fit_problem(model: StageModel, blocks: Sequence[term_rows.TermBlock], given: OcpProblem) -> ReusedProblem:
    """The numbers of a problem for the program of `blocks`; raises `InvalidInput` for a problem of another shape."""
    built = model.problem
    if given is built:
        return ReusedProblem(problem=built, numbers=tuple(block.rows.own for block in blocks))
    _require_same_fields("the problem", built, given)
    _require_same_parts(built, given)
    return ReusedProblem(problem=given, numbers=tuple(_numbers(model, block.rows, given) for block in blocks))


def _require_same_parts(built: OcpProblem, given: OcpProblem) -> None:
    _require_as_many("the problem", "phases", built.phases, given.phases)
    for phase, other in zip(built.phases, given.phases, strict=True):
        _require_same_fields(f"phase {other.name!r}", phase, other)
    _require_equal("the problem", "free durations", built.free_time, given.free_time)
    _require_equal("the problem", "a limited total", built.limits_total, given.limits_total)
    _require_as_many("the problem", "constraints", built.constraints, given.constraints)
    _require_as_many("the problem", "levels", built.levels, given.levels)
    for level, another in zip(built.levels, given.levels, strict=True):
        place = f"level {another.name!r}"
        _require_same_fields(place, level, another)
        _require_as_many(place, "terms", level.terms, another.terms)
        if (level.relax is None) != (another.relax is None):
            _require_equal(place, "relax", level.relax, another.relax)


def _require_same_fields(place: str, built: object, given: object) -> None:
    for field in fields(built):  # type: ignore[arg-type]
        if field.name not in _VARYING[type(built)]:
            _require_equal(place, field.name, getattr(built, field.name), getattr(given, field.name))


def _require_equal(place: str, name: str, built: object, given: object) -> None:
    if is_dataclass(built) and not _same(built, given):
        found = ", ".join(_differences(built, given, name))
        raise InvalidInput(f"{place} differs in {found} from the planner's: build a new Planner")
    if not _same(built, given):
        raise InvalidInput(f"{place} has {name} = {given}, the planner was built for {built}: build a new Planner")


def _require_as_many(place: str, name: str, built: Sequence[object], given: Sequence[object]) -> None:
    if len(built) != len(given):
        was, now = len(built), len(given)
        raise InvalidInput(f"{place} has {now} {name}, the planner was built for {was}: build a new Planner")


def _numbers(model: StageModel, rows: term_rows.TermRows, given: OcpProblem) -> term_rows.TermNumbers:
    terms = [given.terms[member.place] for member in rows.members]
    if all(term is member.term for member, term in zip(rows.members, terms, strict=True)):
        return rows.own
    residuals = [_residual(model, member, term) for member, term in zip(rows.members, terms, strict=True)]
    return term_rows.term_numbers(terms, residuals)


def _residual(model: StageModel, member: term_rows.TermEntry, term: Term) -> Residual:
    """Return the residual of a term in the place of another one."""
    built = member.residual
    if term is member.term or not any(_differences(member.term, term)):
        return built
    if _role(model, member.term) != _role(model, term):
        raise _other(model, member, term)
    given = term_rows.residual_of(model, term, member.goals)
    same_kinds = row_kinds(built.lower, built.upper).same(row_kinds(given.lower, given.upper))
    if not (same_kinds and _same_expression(built.value, given.value, model.z, model.water, member.goals)):
        raise _other(model, member, term)
    return given


def _role(model: StageModel, term: Term) -> tuple[object, ...]:
    """Return the key that decides where the rows of a term are, and their names."""
    return term.name, term.at, term.phase, term.state_only, term.is_goal, term.n_parameters(model.robot)


def _same_expression(one: ca.SX, other: ca.SX, *symbols: ca.SX) -> bool:
    if one.shape != other.shape:
        return False
    texts = [ca.Function("rows", list(symbols), [value]).serialize() for value in (one, other)]
    return bool(texts[0] == texts[1])


def _other(model: StageModel, member: term_rows.TermEntry, given: Term) -> InvalidInput:
    place = (
        "constraints" if member.level == term_rows.CONSTRAINT else f"level {model.problem.levels[member.level].name!r}"
    )
    found = ", ".join(_differences(member.term, given))
    return InvalidInput(f"{place}: term {given.name!r} differs in {found} from the planner's: build a new Planner")


def _differences(built: object, given: object, path: str = "") -> Iterator[str]:
    """Names of what differs: fields, those of fields in their fields too, and whatever else an instance carries."""
    if type(built) is not type(given):
        yield f"{path or 'kind'} ({type(given).__name__}, not {type(built).__name__})"
        return
    for attribute in {**_attributes(built), **_attributes(given)}:
        one, other = getattr(built, attribute, None), getattr(given, attribute, None)
        name = f"{path}.{attribute}" if path else attribute
        if is_dataclass(one) and one is not other:
            yield from _differences(one, other, name)
        elif not _same(one, other):
            yield name


def _attributes(value: object) -> dict[str, None]:
    """Names of all that an instance carries: a user's class need not be a dataclass all the way down."""
    slots = (name for kind in type(value).__mro__ for name in _slots(kind))
    own = [*(field.name for field in fields(value)), *slots, *getattr(value, "__dict__", ())]  # type: ignore[arg-type]
    return dict.fromkeys(name for name in own if hasattr(value, name))


def _slots(kind: type) -> tuple[str, ...]:
    slots = kind.__dict__.get("__slots__", ())
    names = (slots,) if isinstance(slots, str) else tuple(slots)
    return tuple(name for name in names if not name.startswith("__"))


def _same(one: object, other: object) -> bool:
    if one is other:
        return True
    if isinstance(one, (tuple, list)) and isinstance(other, (tuple, list)):
        return len(one) == len(other) and all(_same(a, b) for a, b in zip(one, other, strict=True))
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        return bool(np.array_equal(one, other))  # type: ignore[arg-type]
    if is_dataclass(one):
        return type(one) is type(other) and not any(_differences(one, other))
    return bool(one == other)
