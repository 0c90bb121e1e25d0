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
    for field in fields(task):  # type: ignore[arg-type]
        object.__setattr__(wide, field.name, getattr(task, field.name))
    return wide


_ROWS = ("jacobian", "rate", "lower", "upper", "activation")


def with_a_row_of_zeros(rows: Rows, task: Task) -> Rows:
    """Which no motion changes, and which asks for nothing."""
    added = {name: ca.SX(1, getattr(rows, name).shape[1]) for name in _ROWS}
    if task.equality:
        added["activation"] = ca.SX.ones(1)
    else:
        added["upper"] = ca.SX.inf(1)
    return _with_rows(rows, added)


def with_its_last_row_twice(rows: Rows, task: Task) -> Rows:
    return _with_rows(rows, {name: getattr(rows, name)[-1, :] for name in _ROWS})


def _with_rows(rows: Rows, added: dict[str, ca.SX]) -> Rows:
    longer = {name: ca.vertcat(getattr(rows, name), row) for name, row in added.items()}
    return replace(rows, **longer)
