"""Tasks with rows that ask for nothing new, which are to change nothing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace

import casadi as ca

from uvms_ocp.tasks.task import Rows, Task, TickSymbols


def as_it_is(task: Task) -> Task:
    return task


def extended(task: Task, more: Callable[[Rows, Task], Rows]) -> Task:
    """The task with more rows."""
    kind = type(task)

    def rows(self: Task, symbols: TickSymbols, parameters: ca.SX) -> Rows:
        return more(kind.rows(self, symbols, parameters), self)

    wide = object.__new__(type(kind.__name__, (kind,), {"rows": rows}))
    for one in fields(task):  # type: ignore[arg-type]
        object.__setattr__(wide, one.name, getattr(task, one.name))
    return wide


_ROWS = ("jacobian", "rate", "lower", "upper", "activation")


def with_a_row_of_zeros(own: Rows, task: Task) -> Rows:
    """Which no motion changes, and which asks for nothing."""
    zero = {name: ca.SX(1, getattr(own, name).shape[1]) for name in _ROWS}
    zero |= {"activation": ca.SX.ones(1)} if task.equality else {"upper": ca.SX.inf(1)}
    return replace(
        own, **{name: ca.vertcat(getattr(own, name), added) for name, added in zero.items()}
    )


def with_its_last_row_twice(own: Rows, task: Task) -> Rows:
    return replace(
        own, **{name: ca.vertcat(getattr(own, name), getattr(own, name)[-1, :]) for name in _ROWS}
    )
