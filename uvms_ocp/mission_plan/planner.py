"""Plan a whole mission as one optimal control problem with free durations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from time import perf_counter

import numpy as np

from uvms_ocp.checks import checked
from uvms_ocp.control.plan_following import PlannedPhase
from uvms_ocp.interrupts import Interrupted
from uvms_ocp.mission_plan.clearances import (
    certify_along,
    floor_height,
    floor_terms,
    link_pairs,
    near_links,
    obstacle_pairs,
    shape_clearance,
    violated_links,
)
from uvms_ocp.mission_plan.mission_digests import mission_digests
from uvms_ocp.mission_plan.mission_plan import MissionPlan
from uvms_ocp.mission_plan.segments import (
    GreedyRollout,
    HorizonSegment,
    Margins,
    PlanMargins,
    active_tasks,
    foretold_rollout,
    goals_end_time,
    greedy_rollout,
    horizon_segments,
)
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
from uvms_ocp.solvers.nlp.options import NlpOptions
from uvms_ocp.types import DAY, Mask, Positive

_WATER_HORIZON = 600.0
"""[s] Time from the start for which the water is sampled."""
_WATER_PERIOD = 0.5
"""[s] Time between two samples of the water."""
_WATER_TOLERANCE = 0.05
"""[m/s] By which the water may differ from that at the start: currents are those of the sea, whatever the
robot.
"""
_CONVEX_WEIGHTS = MissionWeights(energy=1e-3, effort=1.0)
"""Convex in forces: what costs the least energy is near."""
_QUICKEST_WEIGHTS = MissionWeights(price=1.0)
"""Time costs as much as energy at 1 kW."""
_DURATION_SHARE = 0.975
"""Share of the time allowed that a plan uses: the flight takes a little longer, or shorter."""
_ROUNDS = 3
"""Times that a plan is made anew, for links that come near on it or for the water along it."""
_CURRENT_TOLERANCE = 0.02
"""[m/s] By which the water may differ from what a plan was made for."""
_HASTY_ITERATIONS = 150
"""Iterations from the greedy rollout, before the easier problem is tried."""
OPTIONS = NlpOptions(max_iterations=400, convergence=1e-6, barrier=1e-5)
"""Default solver options: a barrier as small as what energy costs. Iterations end it, however busy
the machine is.
"""


@checked
def plan_mission(
    scenario: Scenario,
    *,
    duration: Positive | None = None,
    margins: Margins | None = None,
    step: Positive = 1.0,
    options: NlpOptions | None = None,
) -> MissionPlan:
    """Plan the whole mission of a scenario as one problem with free durations: goals first, then
    the least energy.

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
    proof = None
    clearance = None
    if posed.shapes is not None:
        proof = certify_along(posed.shapes, plan.trajectory)
        clearance = proof.nearest.distance
    status, reason = _verdict(plan, proof, longest)
    phases = _phases(scenario, posed.segments, plan.trajectory.t[posed.problem.starts_of_phases()])
    mission_plan = MissionPlan(
        scenario=scenario.name,
        trajectory=plan.trajectory,
        phases=phases,
        names=tuple(scenario.mission.phases[planned.phase].name for planned in phases),
        status=status,
        reason=reason,
        energy=plan.energy,
        clearance=clearance,
        greedy_duration=posed.greedy_duration,
        iterations=search.n_iterations,
        solve_time=perf_counter() - begin,
        identity=mission_digests(scenario),
    )
    if stop is not None:
        stop.result = mission_plan
        raise stop
    return mission_plan


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
        times: list[float] = np.arange(0.0, _WATER_HORIZON, _WATER_PERIOD).tolist()
        first_velocity = self.current.velocity(p, times[0])[0]
        for previous, t in pairwise(times):
            change = self.current.velocity(p, t)[0] - first_velocity
            if np.linalg.norm(change) > _WATER_TOLERANCE:
                return previous
        return np.inf

    def keeping(self, links: Mask) -> MissionProblem:
        """Return the problem with a constraint on pairs of links (n_pairs,) too."""
        assert self.shapes is not None
        constraints = (*self.problem.constraints, link_pairs(self.shapes, links))
        return replace(self, problem=replace(self.problem, constraints=constraints))

    def at(self, weights: MissionWeights, trajectory: Trajectory, longest: float) -> OcpProblem:
        """Return the problem with other weights in its last level, and the water as it is along a
        trajectory.

        longest [s]: after which no plan goes on, so that the water of later does not matter.
        """
        levels = mission_levels(self.problem.robot, self.terms, weights)
        middle_times = np.minimum((trajectory.t[:-1] + trajectory.t[1:]) / 2, longest)
        middle_points = (trajectory.q[:-1, :3] + trajectory.q[1:, :3]) / 2
        currents = []
        for t, point in zip(middle_times.tolist(), middle_points, strict=True):
            currents.append(water_at(self.current, point[None], t).velocity[0])
        return replace(self.problem, levels=levels, current=np.array(currents), longest=longest)


def mission_problem(scenario: Scenario, *, margins: Margins, step: float) -> MissionProblem:
    """State a mission as a problem of optimal control; step [s]: of the horizon. Raises
    `InvalidInput` as `plan_mission` does.
    """
    kept = margins.of(scenario.robot)
    # What cannot be stated is refused before anything is compiled.
    _stated(scenario, foretold_rollout(scenario), kept, step)
    rollout = greedy_rollout(scenario)
    segments, terms, problem = _stated(scenario, rollout, kept, step)
    shapes = shape_clearance(scenario, kept)
    if shapes is not None and scenario.environment.obstacles:
        problem = replace(problem, constraints=(*problem.constraints, obstacle_pairs(shapes)))
    return MissionProblem(
        problem=problem,
        segments=tuple(segments),
        terms=terms,
        shapes=shapes,
        guess=_greedy_guess(problem, segments, rollout),
        greedy_duration=float(rollout.begins[-1]),
        current=scenario.environment.current,
    )


def _greedy_guess(
    problem: OcpProblem, segments: Sequence[HorizonSegment], rollout: GreedyRollout
) -> Trajectory:
    """Return the greedy rollout in the nominal times of the problem."""
    nominal_marks = [0.0]
    greedy_marks = []
    for segment in segments:
        nominal_marks.append(nominal_marks[-1] + segment.ocp.nominal)
        greedy_marks.append(segment.greedy[0])
    greedy_marks.append(segments[-1].greedy[1])
    t = problem.nominal_times()
    rows = np.searchsorted(rollout.t, np.interp(t, nominal_marks, greedy_marks))
    last_row = len(rollout.t) - 1
    return guess_through(problem, t, rollout.q[np.clip(rows, 0, last_row)])


def _stated(
    scenario: Scenario, rollout: GreedyRollout, margins: PlanMargins, step: float
) -> tuple[list[HorizonSegment], MissionTerms, OcpProblem]:
    """State the problem along a rollout of the mission, without obstacles."""
    segments = horizon_segments(scenario.mission, rollout, margins, step=step)
    terms = mission_terms(scenario.robot, scenario.mission, rollout.phases, segments, margins)
    return segments, terms, _problem(scenario, rollout, segments, terms, margins)


def _problem(
    scenario: Scenario,
    rollout: GreedyRollout,
    segments: Sequence[HorizonSegment],
    terms: MissionTerms,
    margins: PlanMargins,
) -> OcpProblem:
    """Return the problem of these segments and terms, with the floor below the rollout."""
    robot = scenario.robot
    floor = floor_height(scenario, rollout)
    return OcpProblem(
        robot=robot,
        start=State(q=np.array(scenario.start), v=np.zeros(robot.n_v)),
        phases=tuple(segment.ocp for segment in segments),
        levels=mission_levels(robot, terms, MissionWeights()),
        constraints=(
            *terms.constraints,
            *floor_terms(scenario, segments, floor, margins),
        ),
        floor=floor,
        altimeter_frame=scenario.altimeter_frame or robot.description.altimeter or "altimeter",
    )


def _verdict(plan: Plan, proof: ClearanceReport | None, longest: float) -> tuple[OcpStatus, str]:
    """Return the status of the plan and its reason: its own, unless shapes may touch on it, or it
    takes longer than `longest` [s].
    """
    if not plan.status.usable:
        return plan.status, plan.reason
    if proof is not None and not proof.collision_free:
        reason = f"no motion was found that keeps links and obstacles apart: {_contact(proof)}"
        return OcpStatus.INFEASIBLE, reason
    if plan.duration > longest:
        reason = (
            f"{longest:g} s are allowed, the quickest plan that was found takes"
            f" {plan.duration:.4g} s"
        )
        return OcpStatus.TOO_SHORT, reason
    return plan.status, plan.reason


def _contact(proof: ClearanceReport) -> str:
    """Describe where shapes touch, or may touch."""
    nearest = proof.nearest
    if proof.undecided:
        return (
            f"{nearest.pair}, {nearest.distance:.3g} m apart at {nearest.time:.3g} s, may touch"
            " between nodes"
        )
    return f"{nearest.pair} overlap by {-nearest.distance:.3g} m at {nearest.time:.3g} s"


class _Search:
    """Search for the plan of least energy of one mission."""

    def __init__(self, posed: MissionProblem, options: NlpOptions) -> None:
        self._posed = posed
        self._options = options
        hasty_options = replace(
            options, max_iterations=min(options.max_iterations, _HASTY_ITERATIONS)
        )
        self._hasty_planner = Planner(
            posed.at(MissionWeights(), posed.guess, DAY), hasty_options, wait_for_compiler=True
        )
        self.n_iterations = 0
        """Iterations of all plans until now."""

    def least_energy_plan(self, longest: float) -> Plan:
        """Find a plan that takes `longest` [s] at most, or where there is none the quickest.

        Where the water changes meanwhile, a plan that ends before it changes is preferred: the
        problem has no derivative of the water with respect to durations.
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
            violated_pairs = violated_links(shapes, plan.trajectory)
            if not (violated_pairs & ~constrained_pairs).any():
                break
            constrained_pairs |= near_links(shapes, plan.trajectory)
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
        guess: Trajectory,
        limit: float,
    ) -> Plan:
        """Plan from a guess, in the water along it, then along the result, until the water stays
        the same.
        """
        problem = posed.at(weights, guess, _DURATION_SHARE * limit)
        best = None
        for _ in range(_ROUNDS):
            try:
                plan = planner.plan(problem, guess=guess, diagnose=False)
            except Interrupted as stop:
                stop.result = best or stop.result
                raise
            self.n_iterations += plan.iterations
            if not plan.status.usable:
                break
            best = plan
            guess = plan.trajectory
            previous_currents = problem.currents
            problem = posed.at(weights, guess, _DURATION_SHARE * limit)
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
        on = active_tasks(phase, scenario.mission.tasks_of(segment.phase))
        moves = goals_end_time(phase, on) > 0
        phases.append(PlannedPhase(phase=segment.phase, begin=begin, end=end, moves=moves))
    return tuple(phases)
