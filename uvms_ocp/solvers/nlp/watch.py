"""Who looks on while a program is solved, and may stop it: a callback, and Ctrl-C."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType
from typing import TypeAlias

import numpy as np

from uvms_ocp.solvers.nlp.row_bounds import RowBounds


@dataclass(frozen=True, kw_only=True, slots=True)
class Moment:
    """After one iteration."""

    level: str
    """That is being solved; the last one while all levels above are required in full."""
    iteration: int
    residual: float
    """[-] of the level, as a norm."""
    violation: float
    """[-] Largest of constraints, bounds and levels above."""


Progress: TypeAlias = Callable[[Moment], object]
"""Told every iteration; a `KeyboardInterrupt` from it stops the solve at the best point so far."""


class Watch:
    """Over all NLPs of a solve."""

    def __init__(self) -> None:
        self.stopped = False
        self._error: BaseException | None = None
        self._progress: Progress | None = None

    @contextmanager
    def over(self, progress: Progress | None) -> Iterator[None]:
        """One solve: Ctrl-C stops it, a second one breaks it off. Raises what `progress` raised, once the solver is out."""
        self.stopped, self._error, self._progress = False, None, progress
        with self._interrupts():
            yield
        if self._error is not None:
            raise self._error

    @property
    def ends(self) -> bool:
        """True where no further iteration is wanted."""
        return self.stopped or self._error is not None

    def tell(self, moment: Moment) -> None:
        """Nothing is raised here: solvers in other languages call it."""
        try:
            if self._progress is not None:
                self._progress(moment)
        except KeyboardInterrupt:
            self.stopped = True
        except BaseException as error:
            self._error = error

    @contextmanager
    def _interrupts(self) -> Iterator[None]:
        """Python's own answer to Ctrl-C comes in the midst of the solver's callback, where nobody catches it."""
        here = threading.current_thread() is threading.main_thread()
        if not here or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
            yield
            return
        signal.signal(signal.SIGINT, self._stop)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, signal.default_int_handler)

    def _stop(self, number: int, frame: FrameType | None) -> None:
        self.stopped = True
        signal.signal(signal.SIGINT, signal.default_int_handler)


class Best:
    """The best iterate of one NLP: one that keeps the bounds and has the least cost, else the one that breaks them least."""

    def __init__(self, bounds: RowBounds, rows: np.ndarray, feasibility: float) -> None:
        """Of rows numbered `rows` (m,) [-]; feasibility [-]: violation with which the bounds count as kept."""
        self._bounds, self._rows, self._feasibility = bounds, rows, feasibility
        self._key = (np.inf, np.inf)
        self.x: np.ndarray | None = None
        self.cost = self.violation = np.inf
        self.iterations = 0

    def look(self, x: np.ndarray, cost: float, g: np.ndarray) -> float:
        """Violation [-] at x (n_x,) [unit of x], with this cost [-] and rows g (m,) [unit of the row]."""
        violation = self._bounds.violation(x, g, self._rows)
        kept = violation <= self._feasibility
        key = (0.0, cost) if kept else (1.0, violation)
        self.iterations += 1
        if key < self._key and np.isfinite(x).all():
            self._key, self.x, self.cost, self.violation = key, x, cost, violation
        return violation
