"""What a hierarchy solver returns; `[rate]` is the unit of a row, `[velocity]` that of an entry of v."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from uvms_ocp.arguments import Shape, checked
from uvms_ocp.arrays import Array
from uvms_ocp.shown.fielded import Fielded
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
        "solved level by level",
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
            "the levels contain NaN, an entry of a Jacobian of 1e15 and more, or lower > upper, so v is zero; check the "
            "measurements and references of this tick"
        ),
    )
    REGULARISED = (
        "regularised",
        (
            "nothing to do, if a compromise will do: the velocity is smooth and near the optimum of the levels, never at it; "
            "for the optimum choose another solver"
        ),
    )

    @property
    def exact(self) -> bool:
        """True if every level is at its lexicographic optimum: `certificate.normal_certificate` has proven it to 1e-7.

        That is of rows as doubles know them: what rounding leaves open of nearly dependent ones is in the proof from 1e-3 on
        (`Tolerances.resolved`). Rows below 1e-13 of the largest one of all levels count as nothing (`Tolerances.vanished`):
        nothing is exact where one of them could be
        nearer to its bounds by more than 1e-12 (`Tolerances.unnoticed`).
        """
        return self in (Status.SOLVED, Status.COLD_STARTED, Status.CASCADED)

    @property
    def usable(self) -> bool:
        """True if v keeps the priorities: no level was given up for a lower one."""
        return self is not Status.INVALID_INPUT


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False, repr=False)
class Solution(Fielded):
    """Velocity that solves a hierarchy of levels."""

    v: Annotated[Array, Shape("n")]
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
        # Unlike a sum of squares it overflows only where the norm does.
        return np.array([math.hypot(*residual) for residual in self.residuals])

    def certificate(self, levels: Sequence[Level], radius: ArrayLike | None = None) -> float:
        """By how much [rate] any level is above its least at most, proven; see ``certificate.level_excesses``.

        radius () or (n,) [velocity]: how far the least is looked for, by default in the velocity limits of the first level.
        Raises `InvalidInput` for a radius that is not positive.
        """
        return certificate(levels, self.v, radius)


def row_residuals(levels: Sequence[Level], v: Array) -> tuple[Array, ...]:
    """Signed distance of ``J v`` to [lower, upper] at v (n,) [velocity], (m,) [rate] per level; 0 where the gate is 0."""
    return tuple(read_only(residual(level.jacobian, v, level.lower, level.upper, level.gate)) for level in levels)


def read_only(array: Array) -> Array:
    """The same array (...) [any], locked."""
    array.flags.writeable = False
    return array
