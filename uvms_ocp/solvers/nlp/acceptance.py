"""Which share of a level's step is taken: the rule by which no level loses what it had for the sake of one below.

Judged by true residuals, not by the linear model of them. A share of 0 always keeps the rule.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from uvms_ocp.solvers.nlp.program import LevelRows

SHARES = (1.0, 1 / 2, 1 / 4, 1 / 8, 1 / 16)
"""[-] Tried one after the other."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Merit:
    """Of a point."""

    violation: float
    """[-] Largest, of scaled rows; infinite where one of them is no number."""
    residuals: np.ndarray
    """(n_levels,) [-] norm of the residual of each level."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Acceptance:
    """What the step of a level must keep."""

    violation: float
    """[-] Most that constraints may be broken."""
    residuals: np.ndarray
    """(n,) [-] largest norms of the levels above, and that of the level itself."""

    def allows(self, found: Merit) -> bool:
        """Never for a merit that is not a number."""
        kept = found.residuals[: len(self.residuals)] <= self.residuals
        return bool(found.violation <= self.violation and kept.all())


def acceptance(
    levels: Sequence[LevelRows], reached: Sequence[float], here: Merit, *, accuracy: float, tolerance: float
) -> Acceptance:
    """For the step of the level after those that have `reached` [-] their residuals, from a point with merit `here`.

    Constraints may be broken by `accuracy` [-], or as much as they are here; residuals may rise by `tolerance` [-], those of
    the levels above by no more than that from where their own turn left them, however many levels follow. The first level
    pays whatever a guess lacks that breaks constraints.
    """
    above = [level.kept(norm, tolerance) for level, norm in zip(levels, reached, strict=False)]
    mending = not above and here.violation > accuracy
    own = np.inf if mending else here.residuals[len(reached)] + tolerance
    return Acceptance(violation=max(accuracy, here.violation), residuals=np.array([*above, own]))
