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
_OPTIONS = NlpOptions(max_iterations=400, convergence=1e-5, time_limit=120.0, barrier=1e-5)


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
    plan, iterations = _within(posed, duration or posed.greedy_duration, options or _OPTIONS)
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


def _within(posed: MissionProblem, duration: float, options: NlpOptions) -> tuple[Plan, int]:
    """The plan of least energy that takes `duration` [s] at most, found by the price of time, and all iterations."""
    planner = Planner(posed.at(_FIRST, posed.guess), options)
    plan = planner.plan(guess=posed.guess, diagnose=False)
    iterations, best, (low, high) = plan.iterations, None, np.log(_PRICES)
    price = math.log(Weights().price)
    for _ in range(_TRIALS * plan.status.usable):
        trial = planner.plan(posed.at(Weights(price=math.exp(price)), plan.trajectory), guess=plan.trajectory, diagnose=False)
        iterations += trial.iterations
        if trial.status.usable:
            plan = trial
        in_time = trial.status.usable and trial.duration <= duration
        best = trial if in_time and (best is None or trial.duration > best.duration) else best
        if best is not None and best.duration >= _NEAR * duration:
            break
        low, high = (low, price) if in_time else (price, high)
        price = (low + high) / 2
    return best or plan, iterations


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
