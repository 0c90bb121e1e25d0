"""What a hierarchy solver returns; `[rate]` is the unit of a row, `[velocity]` that of an entry of v."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from uvms_ocp.arguments import late
from uvms_ocp.arrays import Array
from uvms_ocp.solvers.hierarchy.certificate import certificate
from uvms_ocp.solvers.hierarchy.gated_rows import residual
from uvms_ocp.solvers.hierarchy.level import Level
from uvms_ocp.status import AdvisedStatus


class Status(AdvisedStatus):
    """Outcome of a solve."""

    SOLVED = "solved", "nothing to do"
    COLD_STARTED = (
        "solved from a cold start",
        "nothing to do; the active set of the previous call was of no use",
    )
    CASCADED = (
        "solved through the cascade",
        "nothing to do, unless it is frequent: then look for nearly dependent rows",
    )
    INEXACT = (
        "inexact",
        (
            "a level was left at the best velocity found for the levels above it; look for nearly dependent rows "
            "or rows of very different scale, or choose another solver"
        ),
    )
    INVALID_INPUT = (
        "invalid input",
        (
            "the levels contain NaN, an infinite Jacobian or lower > upper, so v is zero; check the measurements "
            "and references of this tick"
        ),
    )

    @property
    def exact(self) -> bool:
        """True if every level is at its lexicographic optimum."""
        return self in (Status.SOLVED, Status.COLD_STARTED, Status.CASCADED)

    @property
    def usable(self) -> bool:
        """True if v keeps the priorities: no level was given up for a lower one."""
        return self is not Status.INVALID_INPUT


@late
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Solution:
    """Velocity that solves a hierarchy of levels."""

    v: Array
    """(n,) [velocity] always finite."""
    status: Status
    """How far v can be relied on."""
    residuals: tuple[Array, ...]
    """(m,) [rate] per level: signed distance of J v to [lower, upper]; 0 where the gate is 0."""
    solve_time: float
    """[s]"""

    @property
    def level_residuals(self) -> Array:
        """(levels,) [rate] Euclidean norm of each level's residual."""
        return np.array([np.linalg.norm(residual) for residual in self.residuals])

    def certificate(self, levels: Sequence[Level]) -> float:
        """Violation [-] of the optimality conditions of any level at v; see ``certificate.certificate``."""
        return certificate(levels, self.v)


def row_residuals(levels: Sequence[Level], v: Array) -> tuple[Array, ...]:
    """Signed distance of ``J v`` to [lower, upper] at v (n,) [velocity], (m,) [rate] per level; 0 where the gate is 0."""
    return tuple(read_only(residual(level.jacobian, v, level.lower, level.upper, level.gate)) for level in levels)


def read_only(array: Array) -> Array:
    """The same array (...) [any], locked."""
    array.flags.writeable = False
    return array
