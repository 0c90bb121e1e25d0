"""From a scenario to a plan of its whole mission."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from time import perf_counter

import numpy as np

from uvms_ocp.arguments import Positive, checked
from uvms_ocp.control.receding.plan_guide import PlannedPhase
from uvms_ocp.mission_plan.identity import digests
from uvms_ocp.mission_plan.kept_tasks import active
from uvms_ocp.mission_plan.margins import Margins
from uvms_ocp.mission_plan.mission_plan import MissionPlan
from uvms_ocp.mission_plan.mission_problem import MissionProblem, mission_problem
from uvms_ocp.mission_plan.stretches import Stretch, end_of_goals
from uvms_ocp.mission_plan.translation import Weights
from uvms_ocp.ocp.plan import Plan
from uvms_ocp.ocp.planner import Planner
from uvms_ocp.scenario import Scenario
from uvms_ocp.solvers.nlp.nlp_options import NlpOptions

_FIRST = Weights(energy=1e-3, effort=1.0)
"""Convex in forces: what costs the least energy is near."""
_PRICES = (1e-6, 1.0)  # [kW] of time, cheapest and dearest
_NEAR = 0.97  # share of the time allowed from which on it counts as used
_TRIALS = 7
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
    plan, iterations = _best(posed, duration or posed.greedy_duration, options or OPTIONS)
    phases = _phases(scenario, posed.stretches, plan.trajectory.t[posed.problem.starts_of_phases()])
    return MissionPlan(
        scenario=scenario.name,
        trajectory=plan.trajectory,
        phases=phases,
        names=tuple(scenario.mission.phases[part.phase].name for part in phases),
        status=plan.status,
        reason=plan.reason,
        energy=plan.energy,
        greedy_duration=posed.greedy_duration,
        iterations=iterations,
        solve_time=perf_counter() - begin,
        identity=digests(scenario),
    )


def _best(posed: MissionProblem, longest: float, options: NlpOptions) -> tuple[Plan, int]:
    """The plan of least energy that takes `longest` [s] at most, and all iterations.

    Where the water changes meanwhile, one that is through before is taken if there is one: how much later water costs
    depends on the durations by what no derivative tells.
    """
    planner, iterations = Planner(posed.at(_FIRST, posed.guess, longest), options), 0
    for limit in sorted({min(longest, posed.steady_until), longest}):
        plan, spent = _within(posed, planner, limit)
        iterations += spent
        if plan.status.usable and plan.duration <= limit:
            break
    return plan, iterations


def _within(posed: MissionProblem, planner: Planner, longest: float) -> tuple[Plan, int]:
    """By the price of time that makes a plan so long; dearer time where it takes longer, cheaper where less."""
    plan = planner.plan(posed.at(_FIRST, posed.guess, longest), guess=posed.guess, diagnose=False)
    iterations, best, prices = plan.iterations, None, _Prices()
    for _ in range(_TRIALS * plan.status.usable):
        trial = planner.plan(
            posed.at(Weights(price=prices.now), plan.trajectory, longest), guess=plan.trajectory, diagnose=False
        )
        iterations += trial.iterations
        plan = trial if trial.status.usable else plan
        in_time = trial.status.usable and trial.duration <= longest
        best = trial if in_time and (best is None or trial.duration > best.duration) else best
        if prices.settled(in_time) or (best is not None and best.duration >= _NEAR * longest):
            break
    return best or plan, iterations


class _Prices:
    """Of time [kW], halved in their logarithms between what is too cheap and what is dear enough."""

    def __init__(self) -> None:
        self._low, self._high = (math.log(price) for price in _PRICES)
        self.now = Weights().price
        """[kW] to try next."""

    def settled(self, in_time: bool) -> bool:
        """Go on from what this price led to; True where nothing cheaper is left to try."""
        if in_time and self.now <= _PRICES[0]:
            return True
        self._low, self._high = (self._low, math.log(self.now)) if in_time else (math.log(self.now), self._high)
        untried = in_time and self._low == math.log(_PRICES[0])
        self.now = _PRICES[0] if untried else math.exp((self._low + self._high) / 2)
        return False


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
