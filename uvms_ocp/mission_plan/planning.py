"""From a scenario to a plan of its whole mission."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from uvms_ocp.arguments import Positive, checked
from uvms_ocp.collision.collision_scene import Nearest
from uvms_ocp.control.receding.plan_guide import PlannedPhase
from uvms_ocp.mission_plan.identity import digests
from uvms_ocp.mission_plan.kept_tasks import active
from uvms_ocp.mission_plan.margins import Margins
from uvms_ocp.mission_plan.mission_plan import MissionPlan
from uvms_ocp.mission_plan.mission_problem import MissionProblem, mission_problem
from uvms_ocp.mission_plan.shapes_and_floor import is_apart, nearest_along
from uvms_ocp.mission_plan.stretches import Stretch, end_of_goals
from uvms_ocp.mission_plan.translation import Weights
from uvms_ocp.ocp.plan import OcpStatus, Plan
from uvms_ocp.ocp.planner import Planner
from uvms_ocp.ocp.trajectory import Trajectory
from uvms_ocp.scenario import Scenario
from uvms_ocp.solvers.nlp.nlp_options import NlpOptions

_FIRST = Weights(energy=1e-3, effort=1.0)
"""Convex in forces: what costs the least energy is near."""
_PRICES = (1e-6, 1.0)  # [kW] of time, cheapest and dearest
_NEAR, _AIM = 0.95, 0.975  # shares of the time allowed: from which on it counts as used, and what is looked for
_SLOPE, _FLATTEST = (
    -0.17,
    -0.02,
)  # [-] of duration over price, in logarithms: in still water, and the least that is believed
_TRIALS = 7
_PATIENCE = 60.0  # [s] with a plan that keeps the robot from itself
OPTIONS = NlpOptions(max_iterations=400, convergence=1e-5, time_limit=120.0, barrier=1e-5)
"""Of the solver, by default: a barrier as small as what energy costs."""


@checked
def plan_mission(
    scenario: Scenario,
    *,
    duration: Positive | None = None,
    margins: Margins | None = None,
    step: Positive = 0.8,
    options: NlpOptions | None = None,
) -> MissionPlan:
    """The whole mission of a scenario as one problem with free durations: goals first, then the least energy.

    duration [s]: at most, by default that of the greedy mission without forces. margins: by which the plan is stricter
    than the mission. step [s]: of the horizon. options: of the solver.

    Raises `InvalidInput`, in one line, for tasks and conditions that no residual states, by name, a floor that is not level,
    and a mission that no transition completes.
    """
    begin = perf_counter()
    posed = mission_problem(scenario, margins=margins or Margins(), step=step)
    longest = duration or posed.greedy_duration
    plan, iterations = _best(posed, longest, options or OPTIONS)
    nearest = nearest_along(posed.shapes, plan.trajectory)
    status, reason = _verdict(plan, nearest, longest)
    phases = _phases(scenario, posed.stretches, plan.trajectory.t[posed.problem.starts_of_phases()])
    return MissionPlan(
        scenario=scenario.name,
        trajectory=plan.trajectory,
        phases=phases,
        names=tuple(scenario.mission.phases[part.phase].name for part in phases),
        status=status,
        reason=reason,
        energy=plan.energy,
        clearance=None if nearest is None else nearest.distance,
        greedy_duration=posed.greedy_duration,
        iterations=iterations,
        solve_time=perf_counter() - begin,
        identity=digests(scenario),
    )


def _verdict(plan: Plan, nearest: Nearest | None, longest: float) -> tuple[OcpStatus, str]:
    """That of the plan, unless it takes longer than `longest` [s], or shapes overlap on it: then it is none to be flown."""
    if not plan.status.usable:
        return plan.status, plan.reason
    if nearest is None or nearest.distance > 0:
        if plan.duration <= longest:
            return plan.status, plan.reason
        return (
            OcpStatus.TOO_SHORT,
            f"{longest:g} s are allowed, the quickest plan that was found takes {plan.duration:.4g} s",
        )
    text = f"{nearest.pair} overlap by {-nearest.distance:.3g} m at {nearest.time:.3g} s"
    return OcpStatus.INFEASIBLE, f"no motion was found that keeps links and obstacles apart: {text}"


def _best(posed: MissionProblem, longest: float, options: NlpOptions) -> tuple[Plan, int]:
    """The plan of least energy that takes `longest` [s] at most, and all iterations.

    Where the water changes meanwhile, one that is through before is taken if there is one: how much later water costs
    depends on the durations by what no derivative tells.
    """
    planner, spent = Planner(posed.at(_FIRST, posed.guess, longest), options), 0
    for limit in sorted({min(longest, posed.steady_until), longest}):
        search = _Search(posed=posed, planner=planner, longest=limit, spent=spent)
        plan, price = search.begun()
        spent = search.spent
        if plan.status.usable and plan.duration <= limit:
            break
    if not plan.status.usable or posed.is_apart or is_apart(posed.shapes, plan.trajectory):
        return plan, spent
    return _apart(posed.apart, plan, price, limit, options, spent)


def _apart(
    posed: MissionProblem, plan: Plan, price: float, longest: float, options: NlpOptions, spent: int
) -> tuple[Plan, int]:
    """The plan that keeps the robot from itself too, near one that does not, and all iterations."""
    patience = replace(options, time_limit=min(options.time_limit, _PATIENCE))
    planner = Planner(posed.at(Weights(price=price), plan.trajectory, longest), patience)
    search = _Search(posed=posed, planner=planner, longest=longest, spent=spent)
    found, _ = search.within(plan.trajectory, price)
    return (found if found.status.usable else plan), search.spent


@dataclass(kw_only=True, slots=True, eq=False)
class _Search:
    """For the price of time that makes a plan as long as it may be."""

    posed: MissionProblem
    planner: Planner
    longest: float
    """[s]"""
    spent: int
    """Iterations until now."""

    def begun(self) -> tuple[Plan, float]:
        """From the greedy way: a plan, and its price [kW]."""
        plan = self._plan(_FIRST, self.posed.guess)
        return self.within(plan.trajectory) if plan.status.usable else (plan, _FIRST.price)

    def within(self, way: Trajectory, price: float = Weights().price) -> tuple[Plan, float]:
        """Dearer time where it takes longer, cheaper where less; from a way, and a price [kW] for the first trial."""
        best, prices = None, _Prices(self.longest, price)
        for _ in range(_TRIALS):
            trial, price = self._plan(Weights(price=prices.now), way), prices.now
            way = trial.trajectory if trial.status.usable else way
            in_time = trial.status.usable and trial.duration <= self.longest
            best = (trial, price) if in_time and (best is None or trial.duration > best[0].duration) else best
            enough = best is not None and best[0].duration >= _NEAR * self.longest
            lost = self.posed.is_apart and not trial.status.usable
            if prices.settled(trial.duration, in_time) or enough or lost:
                break
        return best or (trial, price)

    def _plan(self, weights: Weights, way: Trajectory) -> Plan:
        plan = self.planner.plan(self.posed.at(weights, way, self.longest), guess=way, diagnose=False)
        self.spent += plan.iterations
        return plan


class _Prices:
    """Of time [kW], by the power law between price and duration that the trials show, within what brackets the answer."""

    def __init__(self, longest: float, first: float) -> None:
        self._low, self._high = (math.log(price) for price in _PRICES)
        self._aim, self._tried = math.log(_AIM * longest), list[tuple[float, float]]()
        self.now = first
        """[kW] to try next."""

    def settled(self, duration: float, in_time: bool) -> bool:
        """Go on from the duration [s] that this price led to; True where nothing cheaper is left to try."""
        if in_time and self.now <= _PRICES[0]:
            return True
        price = math.log(self.now)
        self._low, self._high = (self._low, price) if in_time else (price, self._high)
        self._tried.append((price, math.log(duration)))
        self.now = math.exp(self._next())
        return False

    def _next(self) -> float:
        """Logarithm of a price between the brackets; the cheapest of all where the law leads below it."""
        price, duration = self._tried[-1]
        guessed = price + (self._aim - duration) / self._slope()
        if self._low < guessed < self._high:
            return guessed
        return self._low if guessed <= self._low == math.log(_PRICES[0]) else (self._low + self._high) / 2

    def _slope(self) -> float:
        """[-] Of the logarithm of the duration over that of the price; negative."""
        if len(self._tried) < 2:
            return _SLOPE
        (p, d), (q, e) = self._tried[-2:]
        return _SLOPE if p == q else min((d - e) / (p - q), _FLATTEST)


def _phases(scenario: Scenario, stretches: Sequence[Stretch], times: np.ndarray) -> tuple[PlannedPhase, ...]:
    """Of the mission, in the times (n + 1,) [s] at which the stretches begin and end."""
    found: list[PlannedPhase] = []
    for stretch, begin, end in zip(stretches, times[:-1].tolist(), times[1:].tolist(), strict=True):
        if found and found[-1].phase == stretch.phase:
            found[-1] = replace(found[-1], end=end)
            continue
        phase = scenario.mission.phases[stretch.phase]
        moves = end_of_goals(phase, active(phase, scenario.mission.tasks_of(stretch.phase))) > 0
        found.append(PlannedPhase(phase=stretch.phase, begin=begin, end=end, moves=moves))
    return tuple(found)
