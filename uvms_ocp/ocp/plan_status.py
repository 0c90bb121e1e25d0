"""What a plan is called, and what to do about it."""

from __future__ import annotations

from uvms_ocp.errors import AdvisedStatus


class OcpStatus(AdvisedStatus):
    """Verdict on a plan, by `uvms_ocp.ocp.verdict`; see the guide on optimal control for what each
    one promises.

    IMPROVABLE: it keeps everything and meets its goals, at more cost than need be. BROKEN: a limit,
    a constraint or a law of motion is left, at nodes or between them.
    MISSED: a goal is not met, and longer horizons were not tried. UNREACHABLE: they were, up to
    four times the time, and did not help. INFEASIBLE: the start is proven impossible, or the solver
    ended where no small change brings the constraints any nearer. UNFINISHED and INTERRUPTED prove
    nothing.
    """

    SOLVED = "solved", "nothing to do"
    IMPROVABLE = (
        "not optimal",
        "fly it as it is, or go on from it with guess=plan, more time and more iterations",
    )
    BROKEN = (
        "constraints broken",
        (
            "the reason says where: take more steps where it is between nodes, else give another"
            " guess, more time, or loosen what is broken"
        ),
    )
    MISSED = (
        "goal missed",
        (
            "why is not known: give it more time, move the goal, or loosen the constraints and"
            " levels above it"
        ),
    )
    TOO_SHORT = "horizon too short", "give the horizon more time, or loosen the limits"
    UNREACHABLE = (
        "unreachable",
        "more time would not help: move the goal, or loosen the constraints and levels above it",
    )
    INFEASIBLE = (
        "infeasible",
        (
            "no motion near the guess keeps the constraints: loosen limits, weaken the current, or"
            " start slower"
        ),
    )
    OBSTRUCTED = (
        "obstructed start",
        "the start breaks a constraint: move the start or the obstacle, or lower the margin",
    )
    INTERRUPTED = (
        "interrupted",
        "stopped by hand, at the best point so far: go on from it with guess=plan",
    )
    UNFINISHED = (
        "unfinished",
        (
            "the solver stopped early: raise time_limit or max_iterations, loosen limits, or"
            " improve the guess"
        ),
    )

    @property
    def usable(self) -> bool:
        """The trajectory keeps all constraints, at nodes and between; goals may be missed."""
        return self in (
            OcpStatus.SOLVED,
            OcpStatus.IMPROVABLE,
            OcpStatus.MISSED,
            OcpStatus.TOO_SHORT,
            OcpStatus.UNREACHABLE,
        )
