"""Outcome of a nonlinear program, whichever solver produced it."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from typing import Any


class NlpStatus(Enum):
    """Outcome of one level; ``advice`` says what to do about it.

    INFEASIBLE: at a point from which no small step brings the constraints any nearer. Farther away others may keep them.
    """

    SOLVED = "solved"
    INEXACT = "inexact"
    STALLED = "stalled"
    INFEASIBLE = "infeasible"
    ITERATION_LIMIT = "iteration limit"
    TIME_LIMIT = "time limit"
    NOT_A_NUMBER = "not a number"
    SKIPPED = "skipped"

    @property
    def advice(self) -> str:
        """One sentence for the user."""
        return _ADVICE[self]

    @property
    def optimal(self) -> bool:
        """True where the level is at a minimum to working accuracy."""
        return self in (NlpStatus.SOLVED, NlpStatus.INEXACT)


_ADVICE = {
    NlpStatus.SOLVED: "nothing to do",
    NlpStatus.INEXACT: "the level is at a minimum to reduced accuracy only; scale its rows, or loosen the tolerance",
    NlpStatus.STALLED: "no further progress before the constraints were kept; give another guess, or loosen the limits",
    NlpStatus.INFEASIBLE: "no point keeps the constraints near the guess; loosen the limits, or give another guess",
    NlpStatus.ITERATION_LIMIT: "the level did not converge; raise max_iterations, or give a better guess",
    NlpStatus.TIME_LIMIT: "the time was over; raise time_limit, shorten the horizon, or start from the last solution",
    NlpStatus.NOT_A_NUMBER: "an expression is not finite at some point; look for divisions by zero, or move the guess",
    NlpStatus.SKIPPED: "a level above it failed; see that level",
}

_UNIFIED = {
    "SOLVER_RET_SUCCESS": NlpStatus.SOLVED,
    "SOLVER_RET_LIMITED": NlpStatus.ITERATION_LIMIT,
    "SOLVER_RET_INFEASIBLE": NlpStatus.INFEASIBLE,
    "SOLVER_RET_NAN": NlpStatus.NOT_A_NUMBER,
}
_IPOPT = {
    "Solved_To_Acceptable_Level": NlpStatus.INEXACT,
    "Search_Direction_Becomes_Too_Small": NlpStatus.INEXACT,
    "Infeasible_Problem_Detected": NlpStatus.INFEASIBLE,
    "Restoration_Failed": NlpStatus.STALLED,
    "User_Requested_Stop": NlpStatus.TIME_LIMIT,
    "Maximum_CpuTime_Exceeded": NlpStatus.TIME_LIMIT,
    "Maximum_WallTime_Exceeded": NlpStatus.TIME_LIMIT,
    "Invalid_Number_Detected": NlpStatus.NOT_A_NUMBER,
}


def status_of(stats: Mapping[str, Any]) -> NlpStatus:
    """Status of the last call of a CasADi ``nlpsol``, from its ``stats()``."""
    named = _IPOPT.get(str(stats.get("return_status")))
    return named or _UNIFIED.get(str(stats.get("unified_return_status")), NlpStatus.ITERATION_LIMIT)
