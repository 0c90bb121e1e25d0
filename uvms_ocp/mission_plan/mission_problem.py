"""A mission as an optimal control problem over its whole length, and where the search begins."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from uvms_ocp.arrays import Mask
from uvms_ocp.mission_plan.greedy_way import GreedyWay, foretold_way, greedy_way
from uvms_ocp.mission_plan.margins import Margins
from uvms_ocp.mission_plan.shapes_and_floor import clearance, floor_along, floor_terms, of_links, of_obstacles
from uvms_ocp.mission_plan.stretches import Stretch, stretches_of
from uvms_ocp.mission_plan.translation import Terms, Weights, levels_of, terms_of
from uvms_ocp.model.state import State
from uvms_ocp.ocp.clearance.shape_clearance import ShapeClearance
from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.ocp.trajectory import Trajectory, through
from uvms_ocp.scenario import Scenario
from uvms_ocp.sim.currents import Current, water_at

_AHEAD, _LOOK = 600.0, 0.5  # [s] how far and how often the water is looked at
_SAME = 0.05  # [m/s] by which it may differ


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class MissionProblem:
    """A mission, as optimal control has it."""

    problem: OcpProblem
    stretches: tuple[Stretch, ...]
    """The phases of the problem."""
    terms: Terms
    shapes: ShapeClearance | None
    """That are to stay apart, obstacles and links; `None` where nothing can meet. Constraints of the problem keep those
    with obstacles."""
    guess: Trajectory
    """The greedy way, over the nominal durations."""
    greedy_duration: float
    """[s] of that way."""

    current: Current
    """Of the water."""

    @property
    def steady_until(self) -> float:
        """[s] until when the water at the start is as it is at first; infinite where nothing is found."""
        p, times = self.problem.start.q[None, :3], np.arange(0.0, _AHEAD, _LOOK)
        u = np.array([self.current.velocity(p, float(t))[0] for t in times])
        changed = np.linalg.norm(u - u[0], axis=1) > _SAME
        return float(times[np.argmax(changed) - 1]) if changed.any() else np.inf

    def keeping(self, links: Mask) -> MissionProblem:
        """With a constraint on pairs of links (n_pairs,) too."""
        assert self.shapes is not None
        constraints = (*self.problem.constraints, of_links(self.shapes, links))
        return replace(self, problem=replace(self.problem, constraints=constraints))

    def at(self, weights: Weights, way: Trajectory, longest: float) -> OcpProblem:
        """The problem with other weights in its last level, and the water as it is along a way.

        longest [s]: after which no plan goes on, so that the water of later does not matter.
        """
        levels = levels_of(self.problem.robot, self.terms, weights)
        current = _currents(self.current, way, longest)
        return replace(self.problem, levels=levels, current=current, longest=longest)


def mission_problem(scenario: Scenario, *, margins: Margins, step: float) -> MissionProblem:
    """step [s] of the horizon. Raises `InvalidInput` as `plan_mission` does."""
    _stated(scenario, foretold_way(scenario), margins, step)  # or it is refused before anything is compiled
    way = greedy_way(scenario)
    stretches, terms, problem = _stated(scenario, way, margins, step)
    shapes = clearance(scenario, margins)
    if shapes is not None and scenario.environment.obstacles:
        problem = replace(problem, constraints=(*problem.constraints, of_obstacles(shapes)))
    return MissionProblem(
        problem=problem,
        stretches=tuple(stretches),
        terms=terms,
        shapes=shapes,
        guess=_guess(problem, way, stretches),
        greedy_duration=float(way.begins[-1]),
        current=scenario.environment.current,
    )


def _stated(
    scenario: Scenario, way: GreedyWay, margins: Margins, step: float
) -> tuple[list[Stretch], Terms, OcpProblem]:
    """By a way of the mission, without obstacles."""
    stretches = stretches_of(scenario.mission, way, margins, step=step)
    terms = terms_of(scenario.robot, scenario.mission, way.phases, stretches, margins)
    return stretches, terms, _problem(scenario, way, stretches, terms, margins)


def _problem(
    scenario: Scenario, way: GreedyWay, stretches: Sequence[Stretch], terms: Terms, margins: Margins
) -> OcpProblem:
    robot, floor = scenario.robot, floor_along(scenario, way)
    above = floor_terms(scenario, stretches, floor, margins)
    return OcpProblem(
        robot=robot,
        start=State(q=np.array(scenario.start), v=np.zeros(robot.n_v)),
        phases=tuple(stretch.ocp for stretch in stretches),
        levels=levels_of(robot, terms, Weights()),
        constraints=(*terms.constraints, *above),
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


def _currents(current: Current, way: Trajectory, longest: float) -> np.ndarray:
    """Velocities (n_steps, 3) [m/s] of the water around the vehicle at the middle of each step."""
    t, p = np.minimum((way.t[:-1] + way.t[1:]) / 2, longest), (way.q[:-1, :3] + way.q[1:, :3]) / 2
    return np.array([water_at(current, p[k : k + 1], float(t[k])).velocity[0] for k in range(len(t))])
