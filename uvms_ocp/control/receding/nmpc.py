"""Receding-horizon control: plan from the measured state again and again, and track the newest plan in between."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from time import perf_counter, process_time

import numpy as np
import pinocchio as pin

from uvms_ocp.arguments import checked, late, trusted
from uvms_ocp.control.force.computed_torque import ComputedTorque, TrackingGains
from uvms_ocp.control.force.dynamic import VelocityGains, observer_of
from uvms_ocp.control.navigation.last_known import LastSound
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.dynamics import robot_dynamics
from uvms_ocp.model.state import Command, Measurement, State
from uvms_ocp.ocp.problem import HessianKind, OcpProblem
from uvms_ocp.ocp.trajectory import Trajectory, hold, shifted
from uvms_ocp.ocp.transcription.transcription import Transcription
from uvms_ocp.solvers.nlp.nlp_status import NlpStatus
from uvms_ocp.solvers.nlp.real_time_sqp import RealTimeSqp, SqpResult
from uvms_ocp.solvers.nlp.sqp_options import SqpOptions

_state = trusted(State)
_FIRST_SOLVES = 10
"""[-] for the first plan, whose guess is to stay where the robot is."""


@dataclass(frozen=True, kw_only=True, slots=True)
class NmpcStatistics:
    """Of all solves so far but the first, which may take its time."""

    solve_times: tuple[float, ...]
    """[s] by the controller's clock."""
    processor_times: tuple[float, ...]
    """[s] the same without what other processes took."""
    missed: int
    """[-] solves that took longer than the period."""
    rejected: int
    """[-] solves without a plan that keeps the constraints, so that the last plan went on."""

    @property
    def missed_share(self) -> float:
        return self.missed / max(len(self.solve_times), 1)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Planned:
    """A plan, and when it begins."""

    trajectory: Trajectory
    """With times from its first node."""
    begin: float
    """[s] of its first node."""


@checked
class Nmpc:
    """A callable ``(Measurement, t) -> Command``.

    Once per `period` a plan is made for the period to come: from the state in which the present plan will leave the
    measured one, and from the solution of the last problem moved on in time, by real-time SQP. The plan takes over when
    that period begins; if it comes later, when the next one begins, and until then the last plan goes on. So it does if
    the best point found breaks constraints; the next solve starts from that point all the same, because a second step
    mends what one step left. Between plans the newest is tracked at the control rate, against disturbances that an
    observer measures.

    The solve runs within the call that begins a period, so that simulations are reproducible. A robot whose control
    rate cannot wait for it has to run it beside.
    """

    def __init__(
        self,
        problem: OcpProblem,
        *,
        dt: float = 1 / 200,
        period: float = 1 / 20,
        options: SqpOptions | None = None,
        gains: TrackingGains | None = None,
        observer: VelocityGains | None = None,
        clock: Callable[[], float] = perf_counter,
    ) -> None:
        """problem: fixed durations; the measured state replaces its start, its Hessian is that of Gauss and Newton.

        dt, period [s]: of control and planning. clock [s]: by which deadlines are judged. Raises `InvalidInput` unless
        0 < dt <= period, and for a problem with free durations.
        """
        if not (np.isfinite([dt, period]).all() and 0 < dt <= period):
            raise InvalidInput(f"dt = {dt} s, period = {period} s; give 0 < dt <= period")
        if problem.free_time:
            raise InvalidInput("receding-horizon control needs fixed durations; give every phase one number")
        self._problem = replace(problem, hessian=HessianKind.GAUSS_NEWTON)
        self.period, self._clock = period, clock
        self._transcription = Transcription(self._problem)
        self._bounds = self._transcription.bounds()
        self._sqp = RealTimeSqp(self._transcription.program, options)
        robot, dynamics = problem.robot, robot_dynamics(problem.robot)
        self._observer = observer_of(robot, dynamics, observer or VelocityGains(), dt)
        self._sound = LastSound(robot)
        self._law = ComputedTorque(robot, dynamics, dt=dt, gains=gains)
        self._now: _Planned | None = None
        self._coming: _Planned | None = None
        self._newest: _Planned | None = None
        """Fit for use or not."""
        self._next = -np.inf
        self._times: list[tuple[float, float]] = []
        self._missed = self._rejected = 0

    @property
    def statistics(self) -> NmpcStatistics:
        return NmpcStatistics(
            solve_times=tuple(wall for wall, _ in self._times),
            processor_times=tuple(processor for _, processor in self._times),
            missed=self._missed,
            rejected=self._rejected,
        )

    @late
    def __call__(self, measurement: Measurement, t: float) -> Command:
        """The command for the tick at time t [s]."""
        measurement = self._sound(measurement, t)
        state = _state(q=measurement.q, v=measurement.v)
        acted, now = self._now is not None, self._now or self._first(state, t)
        if t >= self._next - 1e-9:
            now = self._coming or now
            self._coming = self._replanned(now, state, t)
            # A late plan keeps its time stamps, so that it is still of use; planning is slower meanwhile.
            self._next = t + self.period * max(1, int(np.ceil(self._times[-1][0] / self.period)))
        self._now = now
        disturbance = np.zeros(self._problem.robot.n_v)
        if self._observer is not None and acted:
            disturbance = self._observer.update(state.q, state.v, self._law.force)
        q, v, a = now.trajectory.state_at(self._problem.robot.model, t - now.begin)
        return self._law.command(state, q=q, v=v, a=a, disturbance=disturbance)

    def _first(self, state: State, t: float) -> _Planned:
        """As good as a few solves make it: there is no plan to start from, and the robot waits for it."""
        best = last = hold(self._problem, state)
        for _ in range(_FIRST_SOLVES):
            result = self._solved(last, state, t, np.inf)
            last = self._transcription.unpack(result.x)
            best = last if result.status is NlpStatus.SOLVED else best
        return _Planned(trajectory=best, begin=t)

    def _solved(self, guess: Trajectory, start: State, t0: float, time_limit: float) -> SqpResult:
        return self._sqp.solve(
            self._transcription.pack(guess),
            p=self._transcription.parameters(t0=t0, start=start, near=guess.q),
            x_lower=self._bounds[0],
            x_upper=self._bounds[1],
            time_limit=time_limit,
            clock=self._clock,
        )

    def _replanned(self, now: _Planned, state: State, t: float) -> _Planned | None:
        """The plan for the next period, if it is fit for use."""
        wall, processor = self._clock(), process_time()
        begin = t + self.period
        start = self._expected(now, state, t)
        last = self._newest or now
        guess = shifted(self._problem, last.trajectory, begin - last.begin, start)
        result = self._solved(guess, start, begin, self.period)
        self._times.append((self._clock() - wall, process_time() - processor))
        unfit = result.status is not NlpStatus.SOLVED
        self._missed += self._times[-1][0] > self.period
        self._rejected += unfit
        found = _Planned(trajectory=self._transcription.unpack(result.x), begin=begin)
        # From a point of no use whatever, the present plan is the better guess.
        self._newest = found if np.isfinite(result.violation) else now
        return None if unfit else found

    def _expected(self, now: _Planned, state: State, t: float) -> State:
        """The state in which the next period will begin: the measured one, moved as planned."""
        model, age = self._problem.robot.model, t - now.begin
        q, v, _ = now.trajectory.state_at(model, age)
        q_next, v_next, _ = now.trajectory.state_at(model, age + self.period)
        return _state(q=pin.integrate(model, state.q, pin.difference(model, q, q_next)), v=state.v + v_next - v)
