"""Which runs succeeded: those that the mission counts, or those that finished within limits of one's own."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from uvms_ocp.campaign.findings.spread import merit_values
from uvms_ocp.campaign.runs.merits import MERITS
from uvms_ocp.campaign.runs.work import COMPLETED
from uvms_ocp.exceptions import InvalidInput, NameNotFound


@dataclass(frozen=True, kw_only=True, slots=True)
class Bound:
    """A figure of merit that must stay on one side of a number."""

    merit: str
    sign: str
    """< or >."""
    limit: float
    """[unit of the merit]"""

    def kept(self, table: Any) -> np.ndarray:
        """(n,) whether each run of a table keeps it; one without the figure does not."""
        values = merit_values(table, self.merit)
        return np.asarray(values < self.limit if self.sign == "<" else values > self.limit)

    def __str__(self) -> str:
        return f"{self.merit} {self.sign} {self.limit:g}"


def parse_bounds(texts: Sequence[str]) -> tuple[Bound, ...]:
    """Of texts such as ``tool_position_error_m<0.01``. Raises `InvalidInput` for others, `NameNotFound` for an unknown figure."""
    return tuple(map(_parse, texts))


def _parse(text: str) -> Bound:
    found = re.fullmatch(r"\s*(\w+)\s*([<>])\s*([-+.\deE]+)\s*", text)
    try:
        name, sign, limit = found.groups() if found else ("", "", "")
        value = float(limit)
    except ValueError:
        raise InvalidInput(
            f"success {text!r}; give a figure, < or > and a number: tool_position_error_m<0.01"
        ) from None
    if name not in MERITS:
        raise NameNotFound("figure of merit", name, MERITS)
    return Bound(merit=name, sign=sign, limit=value)


def judged(table: Any, bounds: Sequence[Bound]) -> Any:
    """The table with `success`, and `outcome` of what finished without it, by these bounds; as it is without any."""
    if not bounds:
        return table
    kept = np.array([bound.kept(table) for bound in bounds])
    finished = table["finished"].fillna(False).to_numpy(dtype=bool)
    success = finished & kept.all(axis=0)
    outcome = np.where(success, COMPLETED, table["outcome"].to_numpy(dtype=object))
    missed = finished & ~success
    outcome[missed] = [_missed(bounds, column) for column in kept[:, missed].T]
    return table.assign(success=success, outcome=outcome, cause=np.where(missed, outcome, table["cause"]))


def _missed(bounds: Sequence[Bound], kept: np.ndarray) -> str:
    return "not " + ", not ".join(str(bound) for bound, good in zip(bounds, kept, strict=True) if not good)
