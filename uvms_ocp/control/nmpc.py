"""Receding-horizon control: plan from the estimated state again and again, and track the newest
plan in between.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np
import pinocchio as pin

from uvms_ocp.checks import checked_constructor
from uvms_ocp.control import replanning, solve_workers
from uvms_ocp.control.force.computed_torque import ComputedTorque, TrackingGains
from uvms_ocp.control.force.dynamic import VelocityGains, observer_of
from uvms_ocp.control.planning_watch import PlanningWatch
from uvms_ocp.errors import InvalidInput
from uvms_ocp.estimation.fallbacks import LastValidEstimate
from uvms_ocp.ocp import HessianKind, OcpProblem, hold_guess
from uvms_ocp.record.display import SmallTable, TableDisplay, rows_of
from uvms_ocp.robot import Command, State, StateEstimate, Water, robot_dynamics, signals
from uvms_ocp.solvers.nlp.options import SqpOptions

_ROUNDING = 1e-9
"""[s] rounding error in sums of control periods."""
_LATE_STEP = 0.5
"""Share of the acceleration limits by which tracking may answer the step to a plan that takes over
late.
"""


@dataclass(frozen=True, kw_only=True, slots=True)
class NmpcStatistics:
    """Times of the solves so far but the first, which may take its time, and plans that came late
    or to nothing.
    """

    solve_times: tuple[float, ...]
    """[s] by the controller's clock."""
    processor_times: tuple[float, ...]
    """[s] processor time of the solves themselves, without other processes."""
    missed: int
    """Solves that took longer than the period."""
    rejected: int
    """Solves without a plan that may be flown, or whose plan came too late for it, so that the last
    plan went on.
    """


class PlanningTimes:
    """Times at which plans are asked for: the first tick at or after each multiple of the period,
    so that the mean period is the one that was asked for, whatever the ticks are.
    """

    def __init__(self, dt: float, period: float) -> None:
        """dt, period [s]: of control and planning."""
        self.dt = dt
        """[s] control period."""
        self._period = period
        self._origin = 0.0

    def begin(self, t: float) -> None:
        """Count multiples from t [s]."""
        self._origin = t

    def multiple_after(self, t: float) -> float:
        """Return the first multiple [s] after t [s]."""
        periods = np.floor((t - self._origin + _ROUNDING) / self._period) + 1
        return float(self._origin + self._period * periods)

    def tick_after(self, t: float) -> float:
        """Return when the tick [s] is that begins the next period after that at t [s]."""
        ticks = np.ceil((self.multiple_after(t) - t - _ROUNDING) / self.dt)
        return float(t + self.dt * ticks)

    def next_at(self, asked: float, ready: float) -> float:
        """Return the multiple [s] for which the next plan is asked for, after one that was asked
        for at `asked` [s] and takes over at the first tick at or after `ready` [s].
        """
        return max(self.multiple_after(asked), self.multiple_after(ready - self.dt))


@checked_constructor
class Nmpc(TableDisplay):
    """A callable ``(StateEstimate, t) -> Command``.

    Once per `period`, at the first tick at or after each multiple of it, a plan is made: from the
    state in which the present plan will leave the measured one by the time that the new one is
    ready, and from the solution of the last problem moved on in time, by real-time SQP. Until then
    the last plan goes on. Between plans the newest is tracked at the control rate, against
    disturbances that an observer measures; no rate is asked to pass its limit.

    Whether a plan is flown is judged by the motion that the robot makes of it
    (`uvms_ocp.control.plan_check`). Where none may be, other guesses are tried, and the last plan
    goes on. A plan that comes late takes over with its own time stamps, unless the step to it is
    too large to be tracked: then the next solve begins from it. After three plans in a row without
    use, or where the worker has ended, `given_up` says why, and a mission that watches the
    controller is aborted; it hears in `alarms` of plans that are late or overdue too.

    By default the solve runs within the call that begins a period, and its plan takes over when the
    next one begins, or, where solves take longer, as soon as it would have been ready: simulations
    are reproducible. With ``worker=ProcessWorker()`` it runs in a process of its own: no call waits
    for it, the plan takes over as soon as solves of late would have been ready, or when it comes,
    and the robot stays where it is until there is a first plan. If that process fails the last plan
    goes on, and its end is held; see `worker_status`. Close the controller, or use it as a context
    manager, to end the process.
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
        worker: solve_workers.SynchronousWorker | solve_workers.ProcessWorker | None = None,
    ) -> None:
        """problem: fixed durations; the measured state replaces its start, its Hessian is that of
        Gauss and Newton.

        dt, period [s]: of control and planning; the period need be no multiple of dt. clock [s]: by
        which deadlines in line are judged. worker: where solves run, by default
        `SynchronousWorker`. Raises `InvalidInput` unless 0 < dt <= period, for a problem with free
        durations, a current per step or an end that is as its start, and for one that cannot be
        sent to a worker process; `UvmsError` where that does not start.
        """
        if not (np.isfinite([dt, period]).all() and 0 < dt <= period):
            raise InvalidInput(f"dt = {dt} s, period = {period} s; give 0 < dt <= period")
        if problem.free_time:
            raise InvalidInput(
                "receding-horizon control needs fixed durations; give every phase one number"
            )
        if problem.periodic:
            raise InvalidInput(
                "receding-horizon control has no end to be as its start: leave periodic out"
            )
        if np.ndim(problem.current) != 1:
            raise InvalidInput(
                "receding-horizon control needs one current; give three numbers [m/s], not some per"
                " step"
            )
        self._robot = problem.robot
        self.period = period
        self._problem = replace(problem, hessian=HessianKind.GAUSS_NEWTON)
        self._worker = solve_workers.start_worker(
            worker or solve_workers.SynchronousWorker(),
            solve_workers.ReplanningJob(
                problem=self._problem, period=period, options=options, gains=gains, clock=clock
            ),
        )
        robot = problem.robot
        dynamics = robot_dynamics(problem.robot)
        self._observer = observer_of(
            robot, dynamics, observer or VelocityGains(), dt, problem.current
        )
        self._sound = LastValidEstimate(robot)
        self._law = ComputedTorque(
            robot,
            dynamics,
            dt=dt,
            gains=gains,
            water=Water(velocity=problem.current),
            rate_limit=robot.limits.velocity if problem.limited else None,
        )
        self._now: replanning.TimedPlan | None = None
        self._coming: replanning.TimedPlan | None = None
        self._takes_over = np.inf
        """[s] time at which the coming plan takes over."""
        self._asked: float | None = None
        """[s] beginning of the solve that is not answered yet."""
        self._due = np.inf
        """[s] time at which its plan is to begin."""
        self._planning = PlanningTimes(dt, period)
        self._next = -np.inf
        """[s] time from which on the next solve begins, at the first tick."""
        self._times: list[tuple[float, float]] = []
        self._watch = PlanningWatch(period)

    def _table(self) -> SmallTable:
        horizon = float(self._problem.nominal_times()[-1])
        values: dict[str, object] = {
            "robot": self._robot.name,
            "levels": ", ".join(level.name for level in self._problem.levels),
        }
        values |= {
            "horizon [s]": horizon,
            "period of planning [s]": self.period,
            "plans": self.given_up or self.worker_status.value,
        }
        watch = self._watch
        values |= {"solved": len(self._times), "missed": watch.missed, "rejected": watch.rejected}
        return SmallTable(title=type(self).__name__, rows=rows_of(values))

    @property
    def statistics(self) -> NmpcStatistics:
        return NmpcStatistics(
            solve_times=tuple(wall for wall, _ in self._times),
            processor_times=tuple(processor for _, processor in self._times),
            missed=self._watch.missed,
            rejected=self._watch.rejected,
        )

    @property
    def prediction(self) -> replanning.TimedPlan | None:
        """Plan that is flown now: states (q, v), forces and thrust over its horizon, and when it
        begins; `None` before the first tick.

        ``prediction.trajectory.state_at(robot.model, t - prediction.begin)`` is what the robot is
        expected to do at time t [s].
        """
        return self._now

    @property
    def worker_status(self) -> solve_workers.WorkerStatus:
        """State of the worker that makes the plans."""
        return self._worker.status

    @property
    def alarms(self) -> tuple[tuple[float, str], ...]:
        """Time [s] and text of each alarm about plans that are late, overdue or may not be flown."""
        return tuple(self._watch.alarms)

    @property
    def given_up(self) -> str:
        """Reason why there is no plan to fly but the last one; empty while there is."""
        return self._watch.given_up

    def close(self) -> None:
        """Make no more plans: the last one goes on, and its end is held."""
        self._worker.close()

    def __enter__(self) -> Nmpc:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def __call__(self, estimate: StateEstimate, t: float) -> Command:
        """Return the command for the tick at time t [s]."""
        estimate = self._sound(estimate, t)
        state = signals.unchecked_state(q=estimate.q, v=estimate.v)
        has_acted = self._now is not None
        plan = self._followed(state, t)
        disturbance = np.zeros(self._robot.n_v)
        if self._observer is not None and has_acted:
            disturbance = self._observer.update(state.q, state.v, self._law.force)
        q, v, a = plan.trajectory.state_at(self._robot.model, t - plan.begin)
        if t - plan.begin > plan.trajectory.t[-1]:
            v = np.zeros_like(v)
        command = self._law.command(state, q=q, v=v, a=a, disturbance=disturbance)
        # Last: a process that wakes up beside takes what this tick has in the cache.
        self._plan_ahead(state, t, plan.begin)
        return command

    def _followed(self, state: State, t: float) -> replanning.TimedPlan:
        """Return the plan for this tick."""
        if self._now is None:
            self._now = replanning.TimedPlan(
                number=replanning.HOLD, trajectory=hold_guess(self._problem, state), begin=t
            )
            self._planning.begin(t)
            self._plan_ahead(state, t, t + self._worker.lead)
        self._collect(t)
        if self._coming is not None and t >= self._takes_over - _ROUNDING:
            self._take_over(self._coming, state, t)
            self._coming = None
        if self._asked is not None:
            self._watch.on_wait(t, self._due, self._worker.status)
        return self._now

    def _take_over(self, plan: replanning.TimedPlan, state: State, t: float) -> None:
        """Fly a plan from now on, unless it is late and the step to it too large to be tracked."""
        model = self._robot.model
        q, v, _ = plan.trajectory.state_at(model, t - plan.begin)
        late = t - plan.begin > self._planning.dt + _ROUNDING
        step = np.abs(self._law.correction(pin.difference(model, state.q, q), v - state.v))
        axis = int(np.argmax(step / self._robot.limits.acceleration))
        limit = self._robot.limits.acceleration[axis]
        if late and step[axis] > _LATE_STEP * limit:
            reason = (
                f"it came {t - plan.begin:.3g} s late, too far from where the robot was by then"
            )
            self._watch.on_rejection(t, reason)
            return
        self._now = plan
        self._watch.on_plan()

    def _plan_ahead(self, state: State, t: float, begin: float) -> None:
        """Ask for the next plan, at the beginning of a period; begin [s]: of the present one."""
        waits = self._asked is not None or self._coming is not None
        if self._now is None or waits or t < self._next - _ROUNDING:
            return
        self._asked = t
        delay = self._worker.delay(self._planning.tick_after(t) - t)
        self._due = max(begin, t + delay)
        self._worker.ask(
            replanning.ReplanningRequest(
                state=state, t=t, in_use=self._now.number, begin=begin, delay=delay
            )
        )
        self._collect(t)

    def _collect(self, t: float) -> None:
        """Take the answer to the last solve, if there is one."""
        if self._asked is None:
            return
        answer = self._worker.answer()
        if answer is None:
            return
        request_time = self._asked
        self._asked = None
        if answer.first and answer.planned is not None:
            # The robot stays until then, wherever it is to begin.
            begin = max(answer.planned.begin, t)
            self._next = begin
            self._takes_over = begin
            self._coming = replace(answer.planned, begin=begin)
            self._planning.begin(begin)
            return
        # A solve in line is as late as if it had been made beside.
        ready = max(t, request_time + answer.solve_time)
        self._times.append((answer.solve_time, answer.processor_time))
        self._watch.on_answer(ready, answer.solve_time)
        if answer.planned is None:
            self._watch.on_rejection(ready, answer.reason)
            self._next = self._planning.next_at(request_time, ready)
            return
        # One that is late keeps its time stamps, so that it is still of use.
        self._coming = answer.planned
        self._takes_over = max(answer.planned.begin, ready)
        self._next = self._planning.next_at(request_time, self._takes_over)
