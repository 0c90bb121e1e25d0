"""Solve optimal control problems: transcribe once, solve, refine terms that follow the guess, and
diagnose failures.

What their rows keep at the nodes they may miss between them: there they are tightened.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import takewhile
from time import perf_counter
from typing import Annotated, Any, TypeAlias

import coal
import numpy as np
import pinocchio as pin
from numpy.lib.stride_tricks import sliding_window_view

from uvms_ocp.checks import checked, replace_unchecked, unchecked_constructor, unchecked_method
from uvms_ocp.codegen.compile import compiling_beside
from uvms_ocp.errors import InvalidInput
from uvms_ocp.interrupts import Interrupted, Stopped, on_interrupt, raised_outside_casadi
from uvms_ocp.ocp.clearance import ShapeClearance, certificate, shortfall
from uvms_ocp.ocp.diagnosis import Diagnosis, SolveVerdict, level_prices
from uvms_ocp.ocp.plan import LevelReport, OcpStatus, Plan
from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.ocp.stagewise.program import program_for, stagewise_or
from uvms_ocp.ocp.terms import TaskTerm, Term
from uvms_ocp.ocp.trajectory import (
    COARSE_STEPS,
    Trajectory,
    admissible,
    coarse_guesses,
    coarse_problem,
    hold_guess,
    shift_guess,
)
from uvms_ocp.ocp.transcription.transcription import Transcription
from uvms_ocp.planning import CoalDistances, CollisionScene
from uvms_ocp.planning.request import Goal, PostureGoal, ToolGoal
from uvms_ocp.record.meta_values import FrameMeta, SurroundingsMeta
from uvms_ocp.robot.robot import Robot
from uvms_ocp.solvers import LexicographicNlp, LexicographicResult, NlpOptions, NlpStatus
from uvms_ocp.solvers.nlp.level_solver import AUTO, IPOPT, STAGEWISE, IterationReport, Progress
from uvms_ocp.tasks.goals import evaluate_pose
from uvms_ocp.tasks.pose import PoseTask, ToolPosition
from uvms_ocp.types import DAY, Bound, Finite, Shape

# Which shapes are nearer at the start than a constraint allows, in words.


def describe_crowded_start(problem: OcpProblem, constraint: str) -> str:
    """The pair that a constraint of that name finds nearest for its margin, as a bracket; empty for
    one without shapes.
    """
    terms = [
        term
        for term in problem.constraints
        if isinstance(term, ShapeClearance) and term.name == constraint
    ]
    return max((_lack(term, problem) for term in terms), default=(0.0, ""))[1]


def _lack(term: ShapeClearance, problem: OcpProblem) -> tuple[float, str]:
    distances = term.distances([0.0], problem.start.q[None])[0]
    lack = term.margins - distances
    k = int(lack.argmax())
    return float(
        lack[k]
    ), f" ({term.scene.pairs[k].name}: {distances[k]:.4g} m apart, margin {term.margins[k]:.4g} m)"


# What no input can bring within the limits in the first step: a proof, before any NLP, that a start
# is impossible.

_ROUNDING = 1e-9


def impossible_start(problem: OcpProblem) -> str | None:
    """An axis whose limits the second node cannot keep, in words; None where every axis can.

    Velocity changes by at most the acceleration limit times the step, and a joint goes on
    meanwhile. These are limits of single axes: where they can be kept, forces, constraints or goals
    may still be out of reach. A free duration counts as impossible only if every step in its range
    is.
    """
    if not (problem.limited and problem.fixed_start):
        return None
    phase = problem.phases[0]
    shortest, longest = (duration / phase.n_steps for duration in phase.range)
    return _too_fast(problem, longest) or _too_near(problem, shortest, longest)


def _too_fast(problem: OcpProblem, h: float) -> str | None:
    """After the longest step, which leaves the most time to slow down."""
    limits = problem.robot.limits
    v = problem.start.v
    excess = np.abs(v) - limits.acceleration * h - limits.velocity
    i = int(np.argmax(excess))
    if excess[i] <= _ROUNDING:
        return None
    return (
        f"{_axes(problem)[i]} starts at {v[i]:.4g} and must not exceed {limits.velocity[i]:.4g}"
        f" after the first step: in {h:.3g} s it changes by {limits.acceleration[i] * h:.4g} at"
        " most"
    )


def _too_near(problem: OcpProblem, shortest: float, longest: float) -> str | None:
    """After the best step: a short one does not get to the limit, a long one may have turned
    back.
    """
    robot = problem.robot
    limits = problem.robot.limits
    lower, upper = robot.configuration_bounds
    for joint in robot.joints:
        for i in range(joint.n_v):
            q = float(problem.start.q[joint.q][i])
            v = float(problem.start.v[joint.idx_v + i])
            a = limits.acceleration[joint.idx_v + i]
            speed = limits.velocity[joint.idx_v + i]
            least = q + _least_way(v, a, speed, shortest, longest)
            most = q - _least_way(-v, a, speed, shortest, longest)
            low = lower[joint.q][i]
            high = upper[joint.q][i]
            if least > high + _ROUNDING or most < low - _ROUNDING:
                span = (
                    f"{longest:.3g}" if shortest == longest else f"{shortest:.3g} to {longest:.3g}"
                )
                return (
                    f"joint {joint.name!r} starts at {q:.4g} with {v:.4g} per second and cannot"
                    f" stay between {low:.4g} and {high:.4g} in the first step of {span} s"
                )
    return None


def _least_way(v: float, a: float, speed: float, shortest: float, longest: float) -> float:
    """Smallest displacement after any step in the range; concave in the step but for where the
    speed limit is met.
    """
    kink = (v + speed) / a if np.isfinite(a) else 0.0
    return min(
        h * (v + max(v - a * h, -speed)) / 2
        for h in (shortest, longest, min(max(kink, shortest), longest))
    )


def _axes(problem: OcpProblem) -> list[str]:
    vehicle = ("surge", "sway", "heave", "roll rate", "pitch rate", "yaw rate")[
        : problem.robot.n_vehicle
    ]
    return [*vehicle, *(f"rate of {name!r}" for name in problem.robot.joint_names)]


# A goal that only a robot inside something could reach is said so before anything is solved.


def check_goal(scene: CollisionScene, goal: Goal, start: np.ndarray) -> None:
    """Raise `InvalidInput` where shapes that a goal leaves no choice would touch; start (n_q,) [m,
    rad].

    It names the shapes and their depth: of a posture those of the vehicle and the joints that it
    says; of a tool in a pose those on its link; of a tool at a place the point itself.
    """
    if isinstance(goal, ToolGoal):
        _check_tool(scene, goal)
    scene.check_no_overlap(goal_distances(scene, goal, start), "the goal")


def start_distances(scene: CollisionScene, start: np.ndarray) -> np.ndarray:
    """(n_pairs,) [m] at the start (n_q,) [m, rad]."""
    return CoalDistances(scene).distances_at(start[None])[0]


def goal_distances(scene: CollisionScene, goal: Goal, start: np.ndarray) -> np.ndarray:
    """(n_pairs,) [m] of the pairs whose places a posture decides, infinite for others; start (n_q,)
    [m, rad].
    """
    if isinstance(goal, ToolGoal):
        return np.full(scene.n_pairs, np.inf)
    robot = scene.coordinates.robot
    q = robot.configuration(position=goal.position, rpy=goal.rpy, joints=dict(goal.joints)).copy()
    if robot.n_vehicle:
        q[:3] = start[:3] if goal.position is None else q[:3]
        q[3:7] = start[3:7] if goal.rpy is None else q[3:7]
    known = _determined_joints(robot, goal)
    return np.where(
        [{pair.first_joint, pair.second_joint} <= known for pair in scene.pairs],
        start_distances(scene, q),
        np.inf,
    )


def _determined_joints(robot: Robot, goal: PostureGoal) -> set[int]:
    """Joints whose places the goal decides, the world among them: those behind joints that it all
    names.
    """
    known = {0}
    model = robot.model
    for joint in range(1, model.njoints):
        vehicle = model.joints[joint].nv == 6
        named = (
            goal.position is not None or goal.rpy is not None
            if vehicle
            else model.names[joint] in goal.joints
        )
        if named and model.parents[joint] in known:
            known.add(joint)
    return known


def _check_tool(scene: CollisionScene, goal: ToolGoal) -> None:
    robot = scene.coordinates.robot
    shapes = list(scene.geometry.geometryObjects)
    links, obstacles = (
        shapes[: robot.collision_model.ngeoms],
        shapes[robot.collision_model.ngeoms :],
    )
    frame = robot.model.frames[robot.frame_id(goal.frame)]
    placed: list[tuple[str, coal.CollisionGeometry, pin.SE3]] = []
    if isinstance(goal.target, pin.SE3):
        X_WJ = goal.target * frame.placement.inverse()
        own = [shape for shape in links if shape.parentJoint == frame.parentJoint]
        placed = [(shape.name, shape.geometry, X_WJ * shape.placement) for shape in own]
    else:
        placed = [(goal.frame, coal.Sphere(_POINT), pin.SE3(np.eye(3), goal.target))]
    for obstacle in obstacles:
        for name, geometry, X in placed:
            depth = -_distance(obstacle.geometry, obstacle.placement, geometry, X)
            if depth >= 0.0:
                text = (
                    f"the goal is in collision: {obstacle.name} - {name} overlap by {depth:.3g} m"
                )
                raise InvalidInput(f"{text}; move it or the obstacle")


_POINT = 1e-6  # [m] radius of a ball that stands for a point


def _distance(
    first: coal.CollisionGeometry,
    X_first: pin.SE3,
    second: coal.CollisionGeometry,
    X_second: pin.SE3,
) -> float:
    places = [coal.Transform3s(X.rotation, X.translation) for X in (X_first, X_second)]
    return float(
        coal.distance(
            first, places[0], second, places[1], coal.DistanceRequest(), coal.DistanceResult()
        )
    )


# What there is around the robot of a problem, as records keep it: goals of poses, obstacles, a
# floor.


def surroundings(problem: OcpProblem, t0: float) -> SurroundingsMeta:
    """Describe the surroundings at the end of the horizon, for goals and obstacles that move; t0
    [s] is the time of the first node.
    """
    end = t0 + float(problem.nominal_times()[-1])
    poses = [
        term
        for term in problem.terms
        if isinstance(term, TaskTerm) and isinstance(term.task, (PoseTask, ToolPosition))
    ]
    obstacles = [item for term in problem.terms for item in term.scenery(end)]
    seen: Counter[str] = Counter()
    named = []
    for item in obstacles:
        seen[item.name] += 1
        again = f" ({seen[item.name]})" if seen[item.name] > 1 else ""
        named.append(item.model_copy(update={"name": item.name + again}))
    return SurroundingsMeta(
        frames=tuple(_goal(term, end) for term in poses),
        obstacles=tuple(named),
        floor_z=float(problem.floor) if np.isfinite(problem.floor) else None,
    )


def _goal(term: TaskTerm, t: float) -> FrameMeta:
    assert isinstance(term.task, (PoseTask, ToolPosition))
    pose = evaluate_pose(term.name, term.task.goal, t)[0]
    return FrameMeta(name=f"goal of {term.name}", pose=tuple(pin.SE3ToXYZQUAT(pose).tolist()))


# Terms that follow the guess are written anew at the motion that was found, until it is the one
# they were written at.

_MOST_ROUNDS = 14
_AGREES = 8e-4  # [m] between rows that decide and distances
# [m] of these, from which on what is missing is missing between nodes, not because rows are
# elsewhere
_NEAR = 5e-3
_GAIN = 1e-3  # share of a residual that is not worth another round
_ZERO = 1e-4  # residual of a level that is met
_USABLE = 1e-5  # violation of a point that counts
_KEPT = 2e-4  # [m] of a margin that may be missed between nodes
_BESIDE = 2  # nodes
_MORE = 1.2  # share of what is missing between nodes by which these are tightened


MotionGuess: TypeAlias = Trajectory | Plan
Guess: TypeAlias = MotionGuess | LexicographicResult


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RefinedResult:
    """A result, and the parameters of its program."""

    result: LexicographicResult
    p: np.ndarray
    """(n_p,) [unit of the parameter]"""
    near: np.ndarray
    """(n_nodes, n_q) [m, rad] where terms were written."""
    tightened: Mapping[Term, np.ndarray]
    """(n_nodes, n_pairs) [m] for what is missing between nodes."""

    def after(self, before: LexicographicResult) -> RefinedResult:
        """With the iterations of an earlier result as well."""
        spent = tuple(a + b for a, b in zip(before.iterations, self.result.iterations, strict=True))
        return replace(self, result=replace(self.result, iterations=spent))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Refinement:
    """One problem, solved until its terms are written where its motion is, or the deadline [s] is
    over.
    """

    planner: Planner
    given: OcpProblem
    t0: float
    """[s] of the first node."""
    deadline: float
    """[s] by the clock on the wall."""
    progress: Progress | None = None
    """Told every iteration."""

    def solved(self, guess: MotionGuess) -> RefinedResult:
        """The last that is no worse, or usable."""
        q = (guess.trajectory if isinstance(guess, Plan) else guess).q
        if len(q) != self.given.n_steps + 1:
            q = np.tile(
                self.given.start.q, (self.given.n_steps + 1, 1)
            )  # a guess that `solve` refuses
        best = self._solved(guess, q, {})
        gained = np.inf
        for _ in range(_MOST_ROUNDS if self._terms else 0):
            times: list[float] = (self.t0 + self.given.nominal_times()).tolist()
            path = admissible(
                self.planner.transcription.unpack(best.result.x, self.given), self.given.robot
            )
            off = max(term.mismatch(times, best.near, path.q) for term in self._terms)
            settled = best.result.status.optimal and (off <= _AGREES or gained <= _GAIN)
            missing = self._missing(best, path) if settled or off <= _NEAR else {}
            tightened = {**best.tightened, **missing}
            stopped = NlpStatus.INTERRUPTED in best.result.level_status or self._left <= 0
            if stopped or (settled and not missing):
                break
            found = self._solved(best.result, path.q, tightened).after(best.result)
            if found.result.violation > max(best.result.violation, _USABLE):
                break
            best, gained = found, _gain(best.result, found.result)
        return best

    @property
    def _left(self) -> float:
        return self.deadline - perf_counter()

    @property
    def _terms(self) -> list[ShapeClearance]:
        return [term for term in self.given.terms if isinstance(term, ShapeClearance)]

    def _solved(
        self, guess: Guess, q: np.ndarray, tightened: Mapping[Term, np.ndarray]
    ) -> RefinedResult:
        """Written at configurations q (n_nodes, n_q)."""
        p = self.planner.transcription.parameters(
            self.given, t0=self.t0, near=q, tightened=tightened
        )
        solve = unchecked_method(self.planner.solve)
        left = max(self._left, 0.0)
        result = solve(p, guess, problem=self.given, time_limit=left, progress=self.progress)
        return RefinedResult(result=result, p=p, near=q, tightened=tightened)

    def _missing(self, best: RefinedResult, path: Trajectory) -> dict[Term, np.ndarray]:
        """Add the shortfall between nodes to the margins so far; nothing at the last node, whose
        place is the goal's.
        """
        result: dict[Term, np.ndarray] = {}
        for term in _held_apart(self.given):
            padded = np.pad(shortfall(term, path, self.t0), ((_BESIDE, _BESIDE), (0, 0)))
            missing = np.asarray(sliding_window_view(padded, 2 * _BESIDE + 1, axis=0).max(axis=-1))
            missing[[0, -1]] = 0.0
            if missing.max(initial=0.0) > _KEPT:
                result[term] = best.tightened.get(term, 0.0) + _MORE * missing
        return result


def _gain(before: LexicographicResult, after: LexicographicResult) -> float:
    """Share of its residual by which the first level that changed has changed."""
    old = before.level_residuals
    new = after.level_residuals
    share = (old - new) / np.maximum(old, _ZERO)
    changed = np.flatnonzero((np.abs(share) > _GAIN) & (np.maximum(old, new) > _ZERO))
    return float(abs(share[changed[0]])) if len(changed) else 0.0


def _held_apart(given: OcpProblem) -> list[ShapeClearance]:
    """Constraints on shapes, which are to be kept between nodes too."""
    return [term for term in given.constraints if isinstance(term, ShapeClearance)]


# From problem to plan: transcribe once, solve, and find out why where a goal is missed.

_COARSE: dict[str, Any] = {"convergence": 1e-2, "max_iterations": 20}
_SHARE = 0.2  # of a time limit, for the guess
# iterations, after which motions of so many times the least residual are given up
_EARLY = 3
_COSTLY = 1.08
_TRIED = 2  # motions that all fail, as where shapes are in the way, after which no other is tried
# share within which residuals are one; up to which, and how many, meet over all steps
_SAME = 5e-4
_CLOSE = 1.05
_COMPARED = 3
_FEW_STEPS = 100  # through which the virtual machine takes no longer than a compiler


@checked
class Planner:
    """Solves problems of one shape, built once with its NLPs; see
    `uvms_ocp.ocp.transcription.term_rows`.

    Threads that share one, or its transcription, take turns: their functions keep memory. Give each
    a planner, and none waits.
    """

    def __init__(
        self,
        problem: OcpProblem,
        options: NlpOptions | None = None,
        *,
        transcription: Transcription | None = None,
        wait_for_compiler: bool = False,
    ) -> None:
        """transcription: of the same problem for the same plugin, to share it between planners of
        different options. wait_for_compiler: before the first search, which else begins in CasADi's
        virtual machine, at a twentieth of the speed, and comes to the same plan: stage by stage it
        goes on in machine code as soon as that is there, with IPOPT the next planner does. It is
        waited for always where there is a time limit, and with IPOPT where steps are many.
        """
        given = options or NlpOptions()
        plugin = transcription.plugin if transcription is not None else stagewise_or(IPOPT, problem)
        self.options = replace(given, plugin=plugin) if given.plugin == AUTO else given
        """With the solver that was chosen."""
        many = problem.n_steps > _FEW_STEPS and self.options.plugin != STAGEWISE
        self.problem = problem
        self._wait = wait_for_compiler or given.time_limit < DAY or many
        self._tries_ipopt = given.plugin == AUTO and plugin == STAGEWISE
        with compiling_beside(not self._wait), raised_outside_casadi():
            self.transcription = transcription or Transcription(problem, plugin=self.options.plugin)
            self._nlp = LexicographicNlp(
                program_for(self.options.plugin, self.transcription), self.options
            )

    def plan(
        self,
        problem: OcpProblem | None = None,
        *,
        guess: Trajectory | Plan | None = None,
        t0: Finite = 0.0,
        diagnose: bool = True,
        progress: Progress | None = None,
    ) -> Plan:
        """Plan for `problem`, by default the one this planner was built from.

        problem: of the same shape. Start, current, goals, places and sizes of obstacles, weights,
        bounds and durations may differ; anything else raises `InvalidInput`, which says what.
        guess: a trajectory, or an earlier plan to start from, warm; by default the robot holds its
        start, or, stage by stage with fixed durations, takes the best motion over a few steps
        towards several postures. t0 [s]: time of the first node, for goals that move. diagnose:
        where a goal is missed, try longer horizons to say why, and where constraints are, look for
        what would have to give way, within the time limit of the options. progress: called every
        iteration; a `KeyboardInterrupt` from it ends the search with the best plan so far, whose
        status says so. Ctrl-C does too, and raises `Interrupted`, whose `result` is that plan.
        """
        presses: list[object] = []

        def report(moment: IterationReport) -> None:
            if presses:  # between two solves
                raise KeyboardInterrupt
            if progress is not None:
                progress(moment)

        with on_interrupt(presses.append), self.transcription.turn:
            plan = self._planned(
                problem or self.problem,
                guess,
                t0,
                perf_counter() + self.options.time_limit,
                diagnose,
                report,
            )
        if presses:
            raise Interrupted(plan.reason, plan)
        return plan

    @cached_property
    def _coarse(self) -> Planner:
        return Planner(
            coarse_problem(self.problem),
            replace(self.options, **_COARSE),
            wait_for_compiler=self._wait,
        )

    def _first_guess(self, given: OcpProblem, t0: float, ends: float) -> Trajectory:
        """Guess the best motion over a few steps that meets all levels above the last: stage by
        stage it takes little.

        Those that cost least there are compared over all steps, as far as one iteration brings
        them.
        """
        seen = list[IterationReport]()
        presses = list[object]()
        most = np.inf
        few = coarse_problem(given)
        hold = hold_guess(given)
        begin = perf_counter()
        if self.options.plugin != STAGEWISE or given.free_time or given.n_steps < 2 * COARSE_STEPS:
            return hold
        kept = dict[float, Trajectory]()
        compared = dict[float, Trajectory]()
        best = list[Trajectory]()

        def look(now: IterationReport) -> None:
            seen.extend([now] if now.level == given.levels[-1].name else [])
            costly = now.iteration >= _EARLY and now.residual > _COSTLY * min(kept, default=np.inf)
            if now.level != given.levels[-1].name or costly or now.iteration >= most:
                raise KeyboardInterrupt

        with (
            on_interrupt(presses.append),
            suppress(Stopped),
        ):  # which ends the search that begins here
            short = Refinement(
                planner=self._coarse,
                given=few,
                t0=t0,
                deadline=begin + _SHARE * (ends - begin),
                progress=look,
            )
            for k, guess in enumerate(
                takewhile(lambda _: short._left > 0.0 and not presses, coarse_guesses(few))
            ):
                if k == _TRIED and not kept:
                    break
                end = short._solved(guess, guess.q, {}).result
                if (
                    end.status.optimal
                    and not np.isclose(list(kept), seen[-1].residual, rtol=_SAME).any()
                ):
                    kept[seen[-1].residual] = shift_guess(
                        given, self._coarse.transcription.unpack(end.x, few), 0.0, given.start
                    )
            long = replace(short, planner=self, given=given)
            most = 1
            best = [
                kept[residual]
                for residual in sorted(kept)[:_COMPARED]
                if residual <= _CLOSE * min(kept)
            ]
            for guess in takewhile(
                lambda _: len(best) > 1 and short._left > 0.0 and not presses, best
            ):
                compared[seen[-1].residual] = self.transcription.unpack(
                    long._solved(guess, guess.q, {}).result.x, given
                )
        motions = compared if compared and len(compared) == len(best) else kept
        return motions[min(motions)] if motions else hold

    @cached_property
    def _by_ipopt(self) -> Planner:
        return Planner(
            self.problem, replace(self.options, plugin=IPOPT), wait_for_compiler=self._wait
        )

    def _planned(
        self,
        given: OcpProblem,
        guess: MotionGuess | None,
        t0: float,
        ends: float,
        diagnose: bool,
        progress: Progress,
    ) -> Plan:
        begin = perf_counter()
        obstruction = self.transcription.obstruction(given)
        if obstruction is not None:
            name, depth = obstruction
            text = (
                f"{name} is broken by {depth:.4g} at the start{describe_crowded_start(given, name)}"
            )
            return _made(
                given,
                0.0,
                begin,
                hold_guess(given),
                status=OcpStatus.OBSTRUCTED,
                reason=text,
                levels=(),
            )
        impossible = impossible_start(given)
        if impossible is not None:
            return _made(
                given,
                0.0,
                begin,
                hold_guess(given),
                status=OcpStatus.INFEASIBLE,
                reason=impossible,
                levels=(),
            )
        refinement = Refinement(planner=self, given=given, t0=t0, deadline=ends, progress=progress)
        start = self._first_guess(given, t0, ends) if guess is None else guess
        found = refinement.solved(start)
        finder = self
        note = ""
        status = found.result.status
        if self._tries_ipopt and not (
            status.optimal or self._nlp.watch.should_stop or perf_counter() > ends
        ):
            second = None
            with suppress(Stopped):  # while it is built
                second = replace(refinement, planner=self._by_ipopt).solved(start)
            if second is not None and second.result.violation <= max(
                found.result.violation, _USABLE
            ):
                found = second
                finder = self._by_ipopt
                note = f"; by ipopt: {STAGEWISE} ended {status.value!r}"
            elif (
                second is None or NlpStatus.INTERRUPTED in second.result.level_status
            ):  # nothing else is begun
                ended = tuple(
                    one if one.optimal else NlpStatus.INTERRUPTED
                    for one in found.result.level_status
                )
                found = replace(
                    found,
                    result=replace(found.result, level_status=ended, status=NlpStatus.INTERRUPTED),
                )
        plan = finder._plan(
            given,
            finder._court(given, found, t0, ends if diagnose else None).verdict(found.result),
            t0,
            begin,
        )
        for term in _held_apart(given) if plan.status.usable else ():
            missed = float(shortfall(term, plan.trajectory, t0).max(initial=0.0))
            if missed > _AGREES:
                note += (
                    f"; between nodes {term.name} misses its margin by {missed:.2g} m: take more"
                    " steps"
                )
        return replace_unchecked(plan, reason=plan.reason + note)

    def solve(
        self,
        p: Annotated[np.ndarray, Shape("self.transcription.parameter_layout.n")],
        guess: Trajectory | Plan | LexicographicResult,
        *,
        problem: OcpProblem | None = None,
        time_limit: Bound | None = None,
        progress: Progress | None = None,
    ) -> LexicographicResult:
        """The lexicographic solution for parameters p (n_p,) [unit of the parameter] of
        `Transcription.parameters`.

        problem: that of p, by default the one this planner was built from. time_limit [s]: where it
        is to be shorter than that of the options. progress: as `plan` takes it.
        """
        with self.transcription.turn:
            lower, upper = self.transcription.bounds(problem)
            ranges = self.transcription.ranges(problem)
            return unchecked_method(self._nlp.solve)(
                self._start(guess),
                p=p,
                x_lower=lower,
                x_upper=upper,
                ranges=ranges,
                time_limit=time_limit,
                progress=progress,
            )

    def _start(self, guess: Guess) -> np.ndarray | LexicographicResult:
        if isinstance(guess, Plan):
            guess = guess.trajectory if guess.result is None else guess.result
        return guess if isinstance(guess, LexicographicResult) else self.transcription.pack(guess)

    def _court(
        self, given: OcpProblem, found: RefinedResult, t0: float, deadline: float | None
    ) -> Diagnosis:
        def solve(other: OcpProblem, x: np.ndarray | None, limit: float) -> LexicographicResult:
            numbers = self.transcription.parameters(
                other, t0=t0, near=found.near, tightened=found.tightened
            )
            guess = hold_guess(other) if x is None else self.transcription.unpack(x, other)
            return self.solve(numbers, guess, problem=other, time_limit=limit)

        feasibility = self.options.feasibility
        return Diagnosis(
            transcription=self.transcription,
            problem=given,
            p=found.p,
            feasibility=feasibility,
            solve=solve,
            deadline=deadline,
        )

    def _plan(self, given: OcpProblem, verdict: SolveVerdict, t0: float, begin: float) -> Plan:
        trajectory = admissible(self.transcription.unpack(verdict.result.x, given), given.robot)
        reports = (
            [certificate(term, trajectory) for term in _held_apart(given)]
            if verdict.status.usable
            else []
        )
        clearance = min(
            reports,
            key=lambda report: (report.collision_free, report.nearest.distance),
            default=None,
        )
        found = {"clearance": clearance, "result": verdict.result, "plugin": self.options.plugin}
        levels = tuple(self._reports(verdict.result))
        return _made(
            given,
            t0,
            begin,
            trajectory,
            status=verdict.status,
            reason=verdict.reason,
            levels=levels,
            **found,
        )

    def _reports(self, result: LexicographicResult) -> list[LevelReport]:
        statuses = result.level_status
        residuals = result.level_residuals.tolist()
        return [
            LevelReport(
                name=level.name,
                status=statuses[i].value,
                advice=statuses[i].advice,
                residual=residuals[i],
                iterations=result.iterations[i],
                prices=level_prices(self.transcription, result, i),
            )
            for i, level in enumerate(self.problem.levels)
        ]


_unchecked = unchecked_constructor(Plan)


def _made(given: OcpProblem, t0: float, begin: float, trajectory: Trajectory, **found: Any) -> Plan:
    """Plan begun at the moment `begin` [s], with what it has of its problem."""
    around = surroundings(given, t0)
    current = tuple(given.mean_current.tolist())
    spent = perf_counter() - begin
    return _unchecked(
        robot=given.robot,
        trajectory=trajectory,
        surroundings=around,
        current=current,
        solve_time=spent,
        **found,
    )


@checked
def plan(
    problem: OcpProblem, options: NlpOptions | None = None, guess: Trajectory | None = None
) -> Plan:
    """Plan once; build a `Planner` to plan again and again."""
    return Planner(problem, options).plan(guess=guess)
