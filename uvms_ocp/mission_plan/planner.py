"""Plan a whole mission as one optimal control problem with free durations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from time import perf_counter

import numpy as np

from uvms_ocp.checks import checked
from uvms_ocp.control.plan_following import PlannedPhase
from uvms_ocp.interrupts import Interrupted
from uvms_ocp.mission_plan import segments as mission_segments, terms as surroundings
from uvms_ocp.mission_plan.mission_digests import mission_digests
from uvms_ocp.mission_plan.mission_plan import MissionPlan
from uvms_ocp.mission_plan.segments import HorizonSegment, Margins
from uvms_ocp.mission_plan.terms import MissionTerms, MissionWeights, mission_levels, mission_terms
from uvms_ocp.ocp import (
    OcpProblem,
    OcpStatus,
    Plan,
    Planner,
    ShapeClearance,
    Trajectory,
    guess_through,
)
from uvms_ocp.ocp.transcription.transcription import Transcription
from uvms_ocp.planning.conservative_advancement import ClearanceReport
from uvms_ocp.robot import State
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.sim.currents import Current, water_at
from uvms_ocp.solvers.nlp.level_solver import NlpOptions
from uvms_ocp.types import DAY, Mask, Positive

# [s] how far and how often the water is looked at
_WATER_HORIZON = 600.0
_WATER_PERIOD = 0.5
_WATER_TOLERANCE = 0.05  # [m/s] by which the water may differ from that at the start

_CONVEX_WEIGHTS = MissionWeights(energy=1e-3, effort=1.0)
"""Convex in forces: what costs the least energy is near."""
_QUICKEST_WEIGHTS = MissionWeights(price=1.0)
# share of the time allowed that a plan uses: the flight takes a little longer, or shorter
_DURATION_SHARE = 0.975
# rounds in which links that come near are looked for, and in which the water is where the plan is
_ROUNDS = 3
_CURRENT_TOLERANCE = 0.02  # [m/s] by which the water may differ from what a plan was made for
_HASTY_ITERATIONS = 150  # iterations from the greedy rollout, before the easier problem is tried
OPTIONS = NlpOptions(max_iterations=400, convergence=1e-6, barrier=1e-5)
"""Default solver options: a barrier as small as what energy costs. Iterations end it, however busy
the machine is.
"""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class MissionProblem:
    """A mission as a problem of optimal control."""

    problem: OcpProblem
    segments: tuple[HorizonSegment, ...]
    """Phases of the problem, in their order."""
    terms: MissionTerms
    shapes: ShapeClearance | None
    """Shapes that stay apart, obstacles and links; `None` where nothing can meet. Constraints of
    the problem keep those with obstacles.
    """
    guess: Trajectory
    """Greedy rollout, over the nominal durations of the phases."""
    greedy_duration: float
    """[s] duration of the greedy rollout."""
    current: Current
    """Current of the water."""

    @property
    def steady_until(self) -> float:
        """[s] Time until which the water at the start stays as it is at first; infinite where it
        does not change.
        """
        p = self.problem.start.q[None, :3]
        times = np.arange(0.0, _WATER_HORIZON, _WATER_PERIOD)
        u = np.array([self.current.velocity(p, float(t))[0] for t in times])
        changed = np.linalg.norm(u - u[0], axis=1) > _WATER_TOLERANCE
        if changed.any():
            return float(times[np.argmax(changed) - 1])
        return np.inf

    def keeping(self, links: Mask) -> MissionProblem:
        """Return the problem with a constraint on pairs of links (n_pairs,) too."""
        assert self.shapes is not None
        constraints = (*self.problem.constraints, surroundings.link_pairs(self.shapes, links))
        return replace(self, problem=replace(self.problem, constraints=constraints))

    def at(self, weights: MissionWeights, way: Trajectory, longest: float) -> OcpProblem:
        """Return the problem with other weights in its last level, and the water as it is along a
        way.

        longest [s]: after which no plan goes on, so that the water of later does not matter.
        """
        levels = mission_levels(self.problem.robot, self.terms, weights)
        t = np.minimum((way.t[:-1] + way.t[1:]) / 2, longest)
        p = (way.q[:-1, :3] + way.q[1:, :3]) / 2
        current = np.array(
            [water_at(self.current, p[k : k + 1], float(t[k])).velocity[0] for k in range(len(t))]
        )
        return replace(self.problem, levels=levels, current=current, longest=longest)


def mission_problem(scenario: Scenario, *, margins: Margins, step: float) -> MissionProblem:
    """State a mission as a problem of optimal control; step [s]: of the horizon. Raises
    `InvalidInput` as `plan_mission` does.
    """
    # What cannot be stated is refused before anything is compiled.
    _stated(scenario, mission_segments.foretold_way(scenario), margins, step)
    way = mission_segments.greedy_rollout(scenario)
    segments, terms, problem = _stated(scenario, way, margins, step)
    shapes = surroundings.clearance(scenario, margins)
    if shapes is not None and scenario.environment.obstacles:
        problem = replace(
            problem, constraints=(*problem.constraints, surroundings.obstacle_pairs(shapes))
        )
    # The greedy way in the nominal times of the problem.
    marks = np.cumsum([0.0, *(segment.ocp.nominal for segment in segments)])
    greedy = np.array([segment.greedy[0] for segment in segments] + [segments[-1].greedy[1]])
    t = problem.nominal_times()
    rows = np.searchsorted(way.t, np.interp(t, marks, greedy))
    return MissionProblem(
        problem=problem,
        segments=tuple(segments),
        terms=terms,
        shapes=shapes,
        guess=guess_through(problem, t, way.q[np.clip(rows, 0, len(way.t) - 1)]),
        greedy_duration=float(way.begins[-1]),
        current=scenario.environment.current,
    )


def _stated(
    scenario: Scenario, way: mission_segments.GreedyRollout, margins: Margins, step: float
) -> tuple[list[HorizonSegment], MissionTerms, OcpProblem]:
    """State the problem along a rollout of the mission, without obstacles."""
    segments = mission_segments.horizon_segments(scenario.mission, way, margins, step=step)
    terms = mission_terms(scenario.robot, scenario.mission, way.phases, segments, margins)
    return segments, terms, _problem(scenario, way, segments, terms, margins)


def _problem(
    scenario: Scenario,
    way: mission_segments.GreedyRollout,
    segments: Sequence[HorizonSegment],
    terms: MissionTerms,
    margins: Margins,
) -> OcpProblem:
    robot = scenario.robot
    floor = surroundings.floor_along(scenario, way)
    return OcpProblem(
        robot=robot,
        start=State(q=np.array(scenario.start), v=np.zeros(robot.n_v)),
        phases=tuple(segment.ocp for segment in segments),
        levels=mission_levels(robot, terms, MissionWeights()),
        constraints=(
            *terms.constraints,
            *surroundings.floor_terms(scenario, segments, floor, margins),
        ),
        floor=floor,
        altimeter_frame=scenario.altimeter_frame or robot.description.altimeter or "altimeter",
    )


@checked
def plan_mission(
    scenario: Scenario,
    *,
    duration: Positive | None = None,
    margins: Margins | None = None,
    step: Positive = 1.0,
    options: NlpOptions | None = None,
) -> MissionPlan:
    """The whole mission of a scenario as one problem with free durations: goals first, then the
    least energy.

    duration [s]: at most, by default that of the greedy mission without forces. margins: by which
    the plan is stricter than the mission. step [s]: of the horizon. options: of the solver.

    Ctrl-C raises `Interrupted`, whose `result` is the best so far.

    Raises `InvalidInput`, in one line, for tasks and conditions that no residual states, by name, a
    floor that is not level, and a mission that no transition completes.
    """
    begin = perf_counter()
    posed = mission_problem(scenario, margins=margins or Margins(), step=step)
    longest = duration or posed.greedy_duration
    search = _Search(posed, options or OPTIONS)
    stop: Interrupted | None = None
    try:
        plan = search.least_energy_plan(longest)
    except Interrupted as interrupted:
        stop = interrupted
        plan = interrupted.result
    if posed.shapes is None:
        proof = None
    else:
        proof = surroundings.certify_along(posed.shapes, plan.trajectory)
    status, reason = _verdict(plan, proof, longest)
    phases = _phases(scenario, posed.segments, plan.trajectory.t[posed.problem.starts_of_phases()])
    mission_plan = MissionPlan(
        scenario=scenario.name,
        trajectory=plan.trajectory,
        phases=phases,
        names=tuple(scenario.mission.phases[part.phase].name for part in phases),
        status=status,
        reason=reason,
        energy=plan.energy,
        clearance=None if proof is None else proof.nearest.distance,
        greedy_duration=posed.greedy_duration,
        iterations=search.spent,
        solve_time=perf_counter() - begin,
        identity=mission_digests(scenario),
    )
    if stop is not None:
        stop.result = mission_plan
        raise stop
    return mission_plan


def _verdict(plan: Plan, proof: ClearanceReport | None, longest: float) -> tuple[OcpStatus, str]:
    """Return the verdict of the plan, or of its rejection: it takes longer than `longest` [s], or
    shapes may touch on it.
    """
    if not plan.status.usable:
        return plan.status, plan.reason
    if proof is None or proof.collision_free:
        if plan.duration <= longest:
            return plan.status, plan.reason
        return (
            OcpStatus.TOO_SHORT,
            (
                f"{longest:g} s are allowed, the quickest plan that was found takes"
                f" {plan.duration:.4g} s"
            ),
        )
    nearest = proof.nearest
    text = f"{nearest.pair} overlap by {-nearest.distance:.3g} m at {nearest.time:.3g} s"
    if proof.undecided:
        text = (
            f"{nearest.pair}, {nearest.distance:.3g} m apart at {nearest.time:.3g} s, may touch"
            " between nodes"
        )
    return OcpStatus.INFEASIBLE, f"no motion was found that keeps links and obstacles apart: {text}"


class _Search:
    """For the plan of least energy of one mission."""

    def __init__(self, posed: MissionProblem, options: NlpOptions) -> None:
        self._posed = posed
        self._options = options
        hasty_options = replace(
            options, max_iterations=min(options.max_iterations, _HASTY_ITERATIONS)
        )
        self._hasty_planner = Planner(
            posed.at(MissionWeights(), posed.guess, DAY), hasty_options, wait_for_compiler=True
        )
        self.spent = 0
        """Iterations until now."""

    def least_energy_plan(self, longest: float) -> Plan:
        """Find a plan that takes `longest` [s] at most, or where there is none the quickest.

        Where the water changes meanwhile, one that is through before is taken if there is one: how
        much later water costs depends on the durations by what no derivative tells.
        """
        for limit in sorted({min(longest, self._posed.steady_until), longest}):
            plan = self._plan_within(limit)
            if plan.status.usable:
                return self._plan_apart(plan, limit)
        quickest = self._plan(
            self._patient_planner, self._posed, _QUICKEST_WEIGHTS, self._posed.guess, DAY
        )
        if quickest.status.usable:
            return quickest
        return plan

    @cached_property
    def _patient_planner(self) -> Planner:
        return Planner(
            self._hasty_planner.problem,
            self._options,
            transcription=self._hasty_planner.transcription,
        )

    def _plan_within(self, limit: float) -> Plan:
        """Plan from the greedy rollout; where that fails, by way of a problem that is easier."""
        posed = self._posed
        guess = self._posed.guess
        plan = self._plan(self._hasty_planner, posed, MissionWeights(), guess, limit)
        if plan.status is OcpStatus.SOLVED:
            return plan
        easier = self._plan(self._patient_planner, posed, _CONVEX_WEIGHTS, guess, limit)
        if not easier.status.usable:
            return plan
        refined = self._plan(
            self._patient_planner, posed, MissionWeights(), easier.trajectory, limit
        )
        if refined.status.usable:
            return refined
        return plan

    def _plan_apart(self, plan: Plan, limit: float) -> Plan:
        """Find a plan near this one that keeps links apart, with rows for those alone that come
        near; else return the last that was found.
        """
        shapes = self._posed.shapes
        if shapes is None:
            return plan
        constrained_pairs: Mask = np.zeros(shapes.scene.n_pairs, dtype=bool)
        for _ in range(_ROUNDS):
            if not (
                surroundings.violated_links(shapes, plan.trajectory) & ~constrained_pairs
            ).any():
                break
            constrained_pairs |= surroundings.near_links(shapes, plan.trajectory)
            posed = self._posed.keeping(constrained_pairs)
            problem = posed.at(MissionWeights(), plan.trajectory, limit)
            shared = Transcription(
                problem,
                plugin=self._hasty_planner.transcription.plugin,
                like=self._hasty_planner.transcription,
            )
            planner = Planner(problem, self._options, transcription=shared, wait_for_compiler=True)
            candidate = self._plan(planner, posed, MissionWeights(), plan.trajectory, limit)
            if not candidate.status.usable:
                break
            plan = candidate
        return plan

    def _plan(
        self,
        planner: Planner,
        posed: MissionProblem,
        weights: MissionWeights,
        way: Trajectory,
        limit: float,
    ) -> Plan:
        """Plan from a trajectory, in the water along it, then along the result, until it stays the
        same.
        """
        problem = posed.at(weights, way, _DURATION_SHARE * limit)
        best = None
        for _ in range(_ROUNDS):
            try:
                plan = planner.plan(problem, guess=way, diagnose=False)
            except Interrupted as stop:
                stop.result = best or stop.result
                raise
            self.spent += plan.iterations
            if not plan.status.usable:
                break
            best = plan
            way = plan.trajectory
            previous_currents = problem.currents
            problem = posed.at(weights, way, _DURATION_SHARE * limit)
            if np.abs(problem.currents - previous_currents).max() <= _CURRENT_TOLERANCE:
                break
        return best or plan


def _phases(
    scenario: Scenario, segments: Sequence[HorizonSegment], times: np.ndarray
) -> tuple[PlannedPhase, ...]:
    """Return the phases of the mission, in the times (n + 1,) [s] at which the segments begin and
    end.
    """
    phases: list[PlannedPhase] = []
    for segment, begin, end in zip(segments, times[:-1].tolist(), times[1:].tolist(), strict=True):
        if phases and phases[-1].phase == segment.phase:
            phases[-1] = replace(phases[-1], end=end)
            continue
        phase = scenario.mission.phases[segment.phase]
        tasks = scenario.mission.tasks_of(segment.phase)
        moves = (
            mission_segments.goals_end_time(phase, mission_segments.active_tasks(phase, tasks)) > 0
        )
        phases.append(PlannedPhase(phase=segment.phase, begin=begin, end=end, moves=moves))
    return tuple(phases)
