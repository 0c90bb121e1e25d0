"""A mission as an optimal control problem over its whole length, and where the search begins."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from uvms_ocp.mission_plan.greedy_way import GreedyWay, greedy_way
from uvms_ocp.mission_plan.margins import Margins
from uvms_ocp.mission_plan.stretches import Stretch, stretches_of
from uvms_ocp.mission_plan.surroundings import clearance_terms, floor_along, floor_terms
from uvms_ocp.mission_plan.translation import Terms, Weights, levels_of, terms_of
from uvms_ocp.model.state import State
from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.ocp.trajectory import Trajectory, through
from uvms_ocp.scenario import Scenario
from uvms_ocp.sim.currents import water_at


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class MissionProblem:
    """A mission, as optimal control has it."""

    problem: OcpProblem
    stretches: tuple[Stretch, ...]
    """The phases of the problem."""
    terms: Terms
    guess: Trajectory
    """The greedy way, over the nominal durations."""
    greedy_duration: float
    """[s] of that way."""

    def at(self, weights: Weights) -> OcpProblem:
        """The problem with other weights in its last level."""
        return replace(self.problem, levels=levels_of(self.problem.robot, self.terms.goals, weights))


def mission_problem(scenario: Scenario, *, margins: Margins, step: float) -> MissionProblem:
    """step [s] of the horizon. Raises `InvalidInput` as `plan_mission` does."""
    way = greedy_way(scenario)
    stretches = stretches_of(scenario.mission, way, margins, step=step)
    terms = terms_of(scenario.robot, scenario.mission, way.phases, stretches, margins)
    problem = _problem(scenario, way, stretches, terms, margins)
    return MissionProblem(
        problem=problem,
        stretches=tuple(stretches),
        terms=terms,
        guess=_guess(problem, way, stretches),
        greedy_duration=float(way.begins[-1]),
    )


def _problem(
    scenario: Scenario, way: GreedyWay, stretches: Sequence[Stretch], terms: Terms, margins: Margins
) -> OcpProblem:
    robot, floor = scenario.robot, floor_along(scenario, way)
    shapes = (*floor_terms(scenario, stretches, floor, margins), *clearance_terms(scenario, margins))
    return OcpProblem(
        robot=robot,
        start=State(q=np.array(scenario.start), v=np.zeros(robot.n_v)),
        phases=tuple(stretch.ocp for stretch in stretches),
        levels=levels_of(robot, terms.goals, Weights()),
        constraints=(*terms.constraints, *shapes),
        current=water_at(scenario.environment.current, np.array(scenario.start[None, :3]), 0.0).velocity[0],
        floor=floor,
        altimeter_frame=scenario.altimeter_frame or robot.description.altimeter or "altimeter",
    )


def _guess(problem: OcpProblem, way: GreedyWay, stretches: Sequence[Stretch]) -> Trajectory:
    """The greedy way in the nominal times of the problem."""
    marks = np.cumsum([0.0, *(stretch.ocp.nominal for stretch in stretches)])
    greedy = np.array([stretch.greedy[0] for stretch in stretches] + [stretches[-1].greedy[1]])
    t = problem.nominal_times()
    rows = np.searchsorted(way.t, np.interp(t, marks, greedy))
    return through(problem, t, way.q[np.clip(rows, 0, len(way.t) - 1)])
