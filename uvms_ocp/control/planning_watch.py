"""Tell when receding-horizon control has no plan to fly, or plans come late."""

from __future__ import annotations

from uvms_ocp.control.solve_workers import WorkerStatus

_IN_A_ROW = 3
"""Plans in a row without use, or that take longer than their period, after which an alarm is
logged.
"""
_ROUNDING = 1e-9
"""[s] rounding error in sums of a clock's ticks."""
_OVERDUE = 3.0
"""Periods that a plan may be overdue before an alarm is logged."""


class PlanningWatch:
    """Counts plans that may not be flown and plans that are late, and logs what is to be known of
    them. Build one per run.
    """

    def __init__(self, period: float) -> None:
        """period [s] of planning."""
        self._period = period
        self.alarms: list[tuple[float, str]] = []
        """Time [s] and text of each alarm."""
        self.given_up = ""
        """Reason why there is nothing to fly; empty while there is."""
        self.missed = 0
        """Solves that took longer than the period."""
        self.rejected = 0
        """Plans that may not be flown, or came too late for it."""
        self._unusable = 0
        """Plans that may not be flown, in a row."""
        self._late = 0
        """Solves that took longer than the period, in a row."""
        self._told_overdue = False

    def on_plan(self) -> None:
        """Take note of a plan that may be flown."""
        self._unusable = 0
        self.given_up = ""

    def on_rejection(self, t: float, reason: str) -> None:
        """Take note, at t [s], of a plan that may not be flown, and of the reason."""
        self.rejected += 1
        self._unusable += 1
        if self._unusable == _IN_A_ROW:
            self._give_up(t, f"no plan to fly, {_IN_A_ROW} in a row: {reason}")

    def on_answer(self, t: float, solve_time: float) -> None:
        """Take note, at t [s], of a solve that took `solve_time` [s]; the first is not counted."""
        self._told_overdue = False
        if solve_time <= self._period + _ROUNDING:
            self._late = 0
            return
        self.missed += 1
        self._late += 1
        if self._late == _IN_A_ROW:
            took = f"{_IN_A_ROW} in a row took longer than the period of {self._period:g} s"
            flown = f"the last {solve_time:.3g} s; each is flown from when it is ready"
            self.alarms.append((t, f"plans are late: {took}, {flown}"))

    def on_wait(self, t: float, due: float, status: WorkerStatus) -> None:
        """Take note, at t [s], that a plan due at `due` [s] is not there; status: of the worker
        that makes it.
        """
        if status is not WorkerStatus.WORKING:
            if not self.given_up:
                self._give_up(t, f"plans are no longer made: {status.value}; {status.advice}")
            return
        if t > due + _OVERDUE * self._period and not self._told_overdue:
            self._told_overdue = True
            self.alarms.append((t, f"the plan that was due at {due:.2f} s has not come yet"))

    def _give_up(self, t: float, why: str) -> None:
        self.given_up = why
        self.alarms.append((t, why))
