"""Outcome of a nonlinear program, whichever solver produced it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from uvms_ocp.status import AdvisedStatus


class NlpStatus(AdvisedStatus):
    """Outcome of one level.

    INFEASIBLE: at a point from which no small step brings the constraints any nearer. Farther away others may keep them.
    """

    SOLVED = "solved", "nothing to do"
    INEXACT = (
        "inexact",
        "the level is at a minimum to reduced accuracy only; scale its rows, or loosen the tolerance",
    )
    STALLED = (
        "stalled",
        "no further progress before the constraints were kept; give another guess, or loosen the limits",
    )
    INFEASIBLE = (
        "infeasible",
        "no point keeps the constraints near the guess; loosen the limits, or give another guess",
    )
    ITERATION_LIMIT = "iteration limit", "the level did not converge; raise max_iterations, or give a better guess"
    TIME_LIMIT = (
        "time limit",
        "the time was over; raise time_limit, shorten the horizon, or start from the last solution",
    )
    NOT_A_NUMBER = (
        "not a number",
        "an expression is not finite at some point; look for divisions by zero, or move the guess",
    )
    INTERRUPTED = "interrupted", "stopped by hand at the best point so far; go on from there"
    SKIPPED = "skipped", "a level above it failed; see that level"

    @property
    def optimal(self) -> bool:
        """True where the level is at a minimum to working accuracy."""
        return self in (NlpStatus.SOLVED, NlpStatus.INEXACT)


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
