"""Receding-horizon control: plan from the measured state again and again, and track the newest plan in between."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from uvms_ocp.control.dynamic import VelocityGains, observer_of
from uvms_ocp.control.plan_tracking import PlanTracker, TrackingGains
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.dynamics import robot_dynamics
from uvms_ocp.model.state import Command, Measurement, State
from uvms_ocp.planning.ocp import OcpProblem
from uvms_ocp.planning.planner import Planner
from uvms_ocp.planning.trajectory import Trajectory, hold, shifted
from uvms_ocp.solvers.lexicographic import LexicographicResult, NlpOptions

_SHARE = 0.6  # of the period after which no further iteration begins
_USABLE = 1e-3  # largest violation of scaled constraints with which an unfinished solve is still tracked
FAST = NlpOptions(max_iterations=2, convergence=1e-4, barrier=1e-3, anticipate=False)
"""Few iterations from a good start, instead of many to the last digit."""


@dataclass(frozen=True, kw_only=True, slots=True)
class NmpcStatistics:
    """Of all solves so far but the first, which may take its time."""

    solve_times: tuple[float, ...]  # [s]
    missed: int  # solves that took longer than the period
    rejected: int  # solves whose result was not fit for use, so that the last plan was tracked on

    @property
    def missed_share(self) -> float:
        return self.missed / max(len(self.solve_times), 1)


class Nmpc:
    """A callable ``(Measurement, t) -> Command``.

    Every `period` the problem is solved from the measured state, warm from the last solution moved on in time. A solve
    is stopped before the period is over; its last iterate is used if it keeps the constraints, otherwise the last plan
    goes on. Between solves the plan is tracked at the control rate, against disturbances that an observer measures.
    A problem with a Gauss-Newton Hessian takes the least time per iteration.
    """

    def __init__(
        self,
        problem: OcpProblem,
        *,
        dt: float = 1 / 200,
        period: float = 1 / 20,
        options: NlpOptions = FAST,
        gains: TrackingGains | None = None,
        observer: VelocityGains | None = None,
        time_limit: float | None = None,
        clock: Callable[[], float] = perf_counter,
    ) -> None:
        """problem: fixed durations; the measured state replaces its start. dt, period [s]: of control and planning.

        time_limit [s] of a solve, by default a share of the period; a simulation that waits for its plans may give more.
        """
        if not (np.isfinite([dt, period]).all() and 0 < dt <= period):
            raise InvalidInput(f"dt = {dt} s, period = {period} s; give 0 < dt <= period")
        if problem.free_time:
            raise InvalidInput("receding-horizon control needs fixed durations; give every phase one number")
        self._problem, self._period, self._clock = problem, period, clock
        self._planner = Planner(problem, replace(options, time_limit=time_limit or _SHARE * period))
        # The first solve has no plan to start from, and the robot waits for it.
        patient = replace(NlpOptions(), plugin=options.plugin, anticipate=options.anticipate)
        self._first = Planner(problem, patient, transcription=self._planner.transcription)
        robot, dynamics = problem.robot, robot_dynamics(problem.robot)
        self._observer = observer_of(robot, dynamics, observer or VelocityGains(), dt)
        self._tracker = PlanTracker(robot, dynamics, dt=dt, gains=gains)
        self._result: LexicographicResult | None = None
        self._trajectory: Trajectory | None = None
        self._planned_at = self._tried_at = -np.inf
        self._times: list[float] = []
        self._missed = self._rejected = 0

    @property
    def statistics(self) -> NmpcStatistics:
        return NmpcStatistics(solve_times=tuple(self._times), missed=self._missed, rejected=self._rejected)

    def __call__(self, measurement: Measurement, t: float) -> Command:
        """The command for the tick at time t [s]."""
        state = State(q=measurement.q, v=measurement.v)
        if t >= self._tried_at + self._period - 1e-9:
            self._tried_at = t
            self._replan(state, t)
        trajectory = self._trajectory or hold(self._problem, state)
        age = t - self._planned_at if self._trajectory is not None else 0.0
        disturbance = np.zeros(self._problem.robot.n_v)
        if self._observer is not None and self._tracker.applied is not None:
            disturbance = self._observer.update(state.q, state.v, self._tracker.applied)
        return self._tracker.command(trajectory, age, state, disturbance)

    def _replan(self, state: State, t: float) -> None:
        begin = self._clock()
        p = self._planner.transcription.parameters(t0=t, start=state)
        planner = self._first if self._result is None else self._planner
        result = planner.solve(p, self._start(state, t))
        if self._result is not None:
            self._times.append(self._clock() - begin)
            self._missed += self._times[-1] > self._period
        if result.violation > _USABLE:
            self._rejected += 1
            return
        trajectory = self._planner.transcription.unpack(result.x)
        self._result, self._trajectory, self._planned_at = result, trajectory, t

    def _start(self, state: State, t: float) -> Trajectory | LexicographicResult:
        if self._result is None or self._trajectory is None:
            return hold(self._problem, state)
        moved = shifted(self._problem, self._trajectory, t - self._planned_at, state)
        return self._planner.resumed(self._result, moved)
