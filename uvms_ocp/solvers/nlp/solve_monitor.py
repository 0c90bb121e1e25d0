"""Monitor of a solve over all its NLPs: reports of iterations, the caller's callback, Ctrl-C, and
the best iterate.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from types import FrameType
from typing import TypeAlias

import numpy as np

from uvms_ocp.interrupts import on_interrupt
from uvms_ocp.solvers.nlp.program import RowBounds

_ALL_ROWS = slice(None)


@dataclass(frozen=True, kw_only=True, slots=True)
class IterationReport:
    """Progress of a solve after one iteration."""

    level: str
    """Level being solved; the last one while all levels above are required in full."""
    iteration: int
    residual: float
    """Residual of the level: the root of twice its cost."""
    violation: float
    """Largest violation of constraints, bounds and levels above."""

    def __str__(self) -> str:
        return (
            f"level {self.level!r}, iteration {self.iteration}, residual {self.residual:.3g},"
            f" constraints broken by {self.violation:.1e}"
        )


Progress: TypeAlias = Callable[[IterationReport], object]
"""Callback after every iteration; a `KeyboardInterrupt` from it stops the solve at the best point
so far.
"""


class SolveMonitor:
    """Callback and Ctrl-C handler of a solve, shared by all of its NLPs."""

    def __init__(self) -> None:
        self.stopped = False
        self._error: BaseException | None = None
        self._progress: Progress | None = None

    @contextmanager
    def running(self, progress: Progress | None) -> Iterator[None]:
        """Guard one solve: Ctrl-C stops it, a second one breaks it off. Raises what `progress`
        raised, once the solver is out.
        """
        self.stopped = False
        self._error = None
        self._progress = progress
        with on_interrupt(self._stop):
            yield
        if self._error is not None:
            raise self._error

    @property
    def should_stop(self) -> bool:
        """True where no further iteration is wanted."""
        return self.stopped or self._error is not None

    def report(self, moment: IterationReport) -> None:
        """Report an iteration; nothing is raised here: solvers in other languages call it."""
        try:
            if self._progress is not None:
                self._progress(moment)
        except KeyboardInterrupt:
            self.stopped = True
        except BaseException as error:
            self._error = error

    def _stop(self, _: FrameType | None) -> None:
        """Note Ctrl-C for the next iteration: Python's own answer would be raised in the midst of the
        solver's callback, where nobody catches it.
        """
        self.stopped = True


class BestIterate:
    """The best iterate of one NLP: one that keeps the bounds and has the least cost, else the one
    that breaks them least.
    """

    def __init__(self, bounds: RowBounds, rows: np.ndarray, feasibility: float) -> None:
        """Track rows numbered `rows` (m,); feasibility: violation up to which the bounds count as
        kept.
        """
        # The rows are chosen once, as their bounds are needed at every iteration.
        self._bounds = replace(bounds, lower=bounds.lower[rows], upper=bounds.upper[rows])
        self._feasibility = feasibility
        self._key = (np.inf, np.inf)
        self.x: np.ndarray | None = None
        self.cost = np.inf
        self.violation = np.inf
        self.iterations = 0

    def update(self, x: np.ndarray, cost: float, g: np.ndarray) -> float:
        """Compare an iterate x (n_x,) [unit of x], of this cost and rows g (m,) [unit of the row], with
        the best one; return its violation.
        """
        violation = self._bounds.violation(x, g, _ALL_ROWS)
        key = (0.0, cost) if violation <= self._feasibility else (1.0, violation)
        self.iterations += 1
        if key < self._key and np.isfinite(x).all():
            self._key = key
            self.x = x
            self.cost = cost
            self.violation = violation
        return violation
