"""Which runs succeeded: those that the mission counts, or those that finished within limits of
their figures.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from uvms_ocp.campaign import jobs, run_metrics
from uvms_ocp.errors import InvalidInput, NameNotFound


@dataclass(frozen=True, kw_only=True, slots=True)
class MetricBound:
    """A figure of merit that must stay on one side of a number."""

    merit: str
    """Name of the figure of merit."""
    sign: str
    """``<`` for a figure that must stay below the limit, ``>`` for one above."""
    limit: float
    """[unit of the merit] number that it must not pass."""

    def kept(self, table: Any) -> np.ndarray:
        """Tell (n,) whether each run of a table keeps it; one without the figure does not."""
        values = run_metrics.metric_values(table, self.merit)
        if self.sign == "<":
            return values < self.limit
        return values > self.limit

    def __str__(self) -> str:
        return f"{self.merit} {self.sign} {self.limit:g}"


def parse_bounds(texts: Sequence[str]) -> tuple[MetricBound, ...]:
    """Parse texts such as ``tool_position_error_m<0.01``. Raises `InvalidInput` or, for an unknown
    figure, `NameNotFound`.
    """
    return tuple(map(_parse, texts))


def _parse(text: str) -> MetricBound:
    match = re.fullmatch(r"\s*(\w+(?:\[[^\]]*\])?)\s*([<>])\s*([-+.\deE]+)\s*", text)
    try:
        if match:
            name, sign, limit = match.groups()
        else:
            name = ""
            sign = ""
            limit = ""
        value = float(limit)
    except ValueError:
        raise InvalidInput(
            f"success {text!r}; give a figure, < or > and a number: tool_position_error_m<0.01"
        ) from None
    if run_metrics.kind_of(name) not in run_metrics.METRICS:
        raise NameNotFound("figure of merit", name, run_metrics.METRICS)
    return MetricBound(merit=name, sign=sign, limit=value)


def judged(table: Any, bounds: Sequence[MetricBound]) -> Any:
    """Add `success` to a table of runs by these bounds, and `outcome` of what finished without it;
    return it unchanged without bounds.

    Raises `NameNotFound` for a bound on what the campaign does not measure.
    """
    if not bounds:
        return table
    unknown = next(
        (bound.merit for bound in bounds if bound.merit not in run_metrics.metrics_among(table)),
        None,
    )
    if unknown:
        raise NameNotFound("figure of merit", unknown, run_metrics.metrics_among(table))
    is_within = np.array([bound.kept(table) for bound in bounds])
    finished = table["finished"].fillna(False).to_numpy(dtype=bool)
    success = finished & is_within.all(axis=0)
    outcome = np.where(success, jobs.COMPLETED, table["outcome"].to_numpy(dtype=object))
    missed = finished & ~success
    outcome[missed] = [_missed(bounds, column) for column in is_within[:, missed].T]
    return table.assign(
        success=success, outcome=outcome, cause=np.where(missed, outcome, table["cause"])
    )


def _missed(bounds: Sequence[MetricBound], is_within: np.ndarray) -> str:
    return "not " + ", not ".join(
        str(bound) for bound, is_kept in zip(bounds, is_within, strict=True) if not is_kept
    )
