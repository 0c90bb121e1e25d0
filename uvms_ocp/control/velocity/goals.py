"""Parameters of all tasks at one tick: goals of the phase, moving goals as samples, and the
distances that tasks ask for.

A task on distances asks for `uvms_ocp.tasks.nearest_pairs.NearestPairs`; they are measured here, on
the way to rest. Goals that are still are in memory, for a kernel to take; those that move are asked
at every tick.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from typing import Annotated

import casadi as ca
import numpy as np

from uvms_ocp.codegen.kernel_layout import (
    CallbackBinding,
    Layout,
    Sized,
    Vector,
    doubles,
    structure_of,
    view,
)
from uvms_ocp.control.velocity.ascent import AscentMemory
from uvms_ocp.control.velocity.distances import NearestMemory, measure_pairs, place_along_stop
from uvms_ocp.control.velocity.goal_tracks import Track, TracksMemory, follow_tracks, write_tracks
from uvms_ocp.mission.mission import Mission, is_constant
from uvms_ocp.mission.phase import MissionState
from uvms_ocp.mission.progress import MissionMemory
from uvms_ocp.robot import Robot, SymbolicModel
from uvms_ocp.robot.dimensions import Dimensions
from uvms_ocp.robot.shapes.collision_model import any_places, in_c, with_any_distances
from uvms_ocp.tasks.approach_speed import ENDLESS
from uvms_ocp.tasks.nearest_pairs import NearestPairs
from uvms_ocp.tasks.task import Task


class GoalsMemory(Layout):
    """Parameters of all tasks, one after the other, and those that they have in each phase while
    nothing moves or is near.
    """

    of_phase: Annotated[list[Vector], Sized("n_phases", "n_parameters")]
    """(n_phases, n_parameters) [their units] parameters in each phase."""
    ascent_start: int
    """Index of the first parameter of the goal of the task that climbs in the abort phase."""
    tracks: TracksMemory
    """Tables of goals that move and rest in the end."""
    values: Annotated[Vector, Sized("n_parameters")]
    """(n_parameters,) [their units] parameters now."""


def load_goals(
    goals_memory: GoalsMemory, mission: MissionMemory, ascent: AscentMemory, t: float
) -> None:
    """Load the goals of the phase at t [s]; the abort phase ascends to where its beginning aimed. A
    kernel.
    """
    goals = goals_memory.of_phase[mission.phase]
    goals_memory.values[:] = goals
    follow_tracks(
        goals_memory.tracks,
        mission.phase,
        t - mission.since,
        t - mission.began,
        goals_memory.values,
    )
    if mission.phase == mission.abort_phase:
        for i in range(len(ascent.goal)):
            goals_memory.values[goals_memory.ascent_start + i] = ascent.goal[i]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Asked:
    """A task whose goal is asked for at every tick of a phase."""

    name: str
    """Name of the task."""
    place: slice
    """Slice of its goal among the parameters of all tasks."""
    reference: Callable[[float], np.ndarray]
    """Function of time [s] that gives the goal, with room for measured distances at its end."""
    of_phase: bool
    """True where the time is that since the start of the phase, and not of the mission."""


class MissionParameters:
    """Goals of all tasks in a `GoalsMemory`: those that its kernel cannot evaluate are asked of the
    tasks, tick by tick.
    """

    def __init__(
        self, mission: Mission, memory: GoalsMemory, tracks: Sequence[Track], dt: float
    ) -> None:
        """memory: a `GoalsMemory`, which is set up. tracks: those of the mission, every dt [s]."""
        self._mission = mission
        self._values = view(memory.values)
        self._places = places_of(mission)
        for phase in range(len(mission.all_phases)):
            goals = [reference(0.0) for reference, _ in mission.references_of(phase)]
            view(memory.of_phase)[phase, : self._places[-1].stop] = np.concatenate(goals)
        if mission.abort is not None:
            ascent = self._places[mission.hierarchy.index(mission.abort.ascent_task)]
            memory.ascent_start = ascent.start
            view(memory.of_phase)[-1, ascent] = 0.0
        write_tracks(memory.tracks, tracks, self._places, dt)
        self.asked = asked_in_phases(mission, tracks)
        """Goals asked of the tasks, by phase."""

    def ask(self, state: MissionState, t: float) -> None:
        """Ask the tasks for the moving goals that the kernel cannot evaluate, for the tick at t
        [s].
        """
        for goal_slot in self.asked[state.phase]:
            begin = state.since if goal_slot.of_phase else state.began
            goal = goal_slot.reference(t - begin)
            n = goal_slot.place.stop - goal_slot.place.start
            self._values[goal_slot.place] = goal[:n]


def asked_in_phases(mission: Mission, tracks: Sequence[Track]) -> list[tuple[_Asked, ...]]:
    """List by phase the goals that are neither still nor of the ascent nor on a track."""
    tracked = {(track.phase, track.task) for track in tracks}
    places = places_of(mission)
    return [_asked_in(mission, phase, tracked, places) for phase in range(len(mission.all_phases))]


def _asked_in(
    mission: Mission, phase: int, tracked: Collection[tuple[int, int]], places: Sequence[slice]
) -> tuple[_Asked, ...]:
    slots = []
    tasks = mission.tasks_of(phase)
    for i, (reference, from_phase_start) in enumerate(mission.references_of(phase)):
        if is_constant(reference) or mission.has_ascent_goal(phase, i) or (phase, i) in tracked:
            continue
        pairs = tasks[i].nearest_pairs
        end = places[i].stop
        if pairs is not None:
            end -= pairs.n_parameters
        slot = _Asked(
            name=tasks[i].name,
            place=slice(places[i].start, end),
            reference=reference,
            of_phase=from_phase_start,
        )
        slots.append(slot)
    return tuple(slots)


def distance_tasks(mission: Mission) -> list[tuple[int, int, NearestPairs]]:
    """List the tasks that ask for distances: index, where its parameters end among those of all,
    its pairs.
    """
    places = places_of(mission)
    asking = list[tuple[int, int, NearestPairs]]()
    for i, task in enumerate(mission.hierarchy.tasks):
        if task.nearest_pairs is not None:
            asking.append((i, places[i].stop, task.nearest_pairs))
    return asking


def places_of(mission: Mission) -> list[slice]:
    """Return the place of each task's parameters, highest priority first, among those of all."""
    sizes = [len(reference(0.0)) for reference, _ in mission.references_of(0)]
    ends = np.cumsum([0, *sizes]).tolist()
    return [slice(start, end) for start, end in pairwise(ends)]


class DistanceProvider:
    """Distances in a `NearestMemory` for the tasks that ask, by `CollisionModel` where kernels
    cannot measure.
    """

    def __init__(
        self,
        memory: NearestMemory,
        asking: Sequence[tuple[int, int, NearestPairs]],
        robot: Robot | None,
    ) -> None:
        """memory: with room for what is asked, which is set up. asking: index of each task, where its
        parameters end, its pairs.

        robot: whose pairs kernels measure, where they can.
        """
        self._memory = memory
        self._places = view(memory.place)
        self._models = [pairs.model for _, _, pairs in asking]
        memory.n_asking = len(asking)
        self.answer = CallbackBinding(memory.ask, self._look)
        for p, (task, end, pairs) in zip(memory.pairs, asking, strict=False):
            p.task = task
            p.first = end - pairs.n_parameters
            p.n = pairs.n_rows
            p.n_pairs = pairs.model.n_pairs
            p.threshold = pairs.threshold
            p.in_c = in_c(pairs.model, robot)
            if p.in_c:
                pairs.model.write(p.distances)
            view(p.reach)[:] = np.where(np.isfinite(pairs.model.reach), pairs.model.reach, np.inf)

    def _look(self) -> None:
        memory = self._memory
        pair = memory.pairs[memory.asked]
        model = self._models[memory.asked]
        where = self._places[memory.at]
        if memory.of_gradients:
            chosen = view(pair.chosen)[: pair.n]
            rows = np.flatnonzero(view(pair.worst)[chosen] == memory.at)
            view(pair.gradient)[rows] = model.distances(where, chosen[rows]).gradient
        else:
            rows = np.flatnonzero(view(pair.counts)[: pair.n_pairs])
            requested = rows if memory.at else None
            view(pair.value)[rows] = model.values(where, requested)


def with_nearest(dimensions: Dimensions, asking: Sequence[NearestPairs]) -> Dimensions:
    """Return the dimensions with those of a `NearestMemory`, but for its distances."""
    return replace(
        dimensions,
        n_asking=len(asking),
        n_asked_pairs=max((pairs.n_rows for pairs in asking), default=0),
    )


def motion_function(
    robot: Robot | None, asking: Sequence[NearestPairs], dimensions: Dimensions
) -> ca.Function:
    """Return the function `integrate` of a `NearestMemory`: without a robot, or where nothing is
    asked, nothing moves.
    """
    if robot is not None and asking:
        return _integrate(robot)
    return _stay(dimensions.n_q, dimensions.n_v)


@lru_cache(maxsize=8)
def _stay(n_q: int, n_v: int) -> ca.Function:
    q = ca.SX.sym("q", n_q)
    return ca.Function("stay", [q, ca.SX.sym("way", n_v)], [q])


@lru_cache(maxsize=8)
def _integrate(robot: Robot) -> ca.Function:
    q = ca.SX.sym("q", robot.n_q)
    way = ca.SX.sym("way", robot.n_v)
    displaced = ca.densify(SymbolicModel(robot.model).integrate(q, way))
    return ca.Function("displaced", [q, way], [displaced], {"cse": True})


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class StoppingMotion:
    """Motion of a robot from which it is to stop."""

    robot: Robot
    v: np.ndarray
    """(n_v,) [m/s, rad/s] before it stops."""
    dt: float
    """[s] control period."""


def mission_parameters(
    mission: Mission,
    state: MissionState,
    t: float,
    *,
    gates: np.ndarray,
    q: np.ndarray,
    motion: StoppingMotion | None,
) -> np.ndarray:
    """Return the parameters (n_parameters,) [their units] of all tasks at t [s], in any state.

    gates (n_tasks,): of then. Nothing is measured for tasks that are off, and stay off. q (n_q,)
    [m, rad]: as measured. motion: where it could come near a limit.
    """
    tasks = zip(
        mission.tasks_of(state.phase),
        mission.references(state, t),
        mission.idle(state, gates),
        strict=True,
    )
    parameters = list[np.ndarray]()
    for task, goal, is_off in tasks:
        if is_off:
            parameters.append(goal)
        else:
            parameters.append(task_parameters(task, goal, q, motion))
    return np.concatenate(parameters)


def task_parameters(
    task: Task, reference: np.ndarray, q: np.ndarray, motion: StoppingMotion | None = None
) -> np.ndarray:
    """Return a task's reference (n_parameters,) [its units], at its end the distances that it asks
    for at q (n_q,) [m, rad].
    """
    pairs = task.nearest_pairs
    if pairs is None:
        return reference
    goal = reference[: -pairs.n_parameters]
    return np.concatenate([goal, measured_distances(pairs, q, motion)])


def measured_distances(
    pairs: NearestPairs, q: np.ndarray, motion: StoppingMotion | None = None
) -> np.ndarray:
    """Measure at q (n_q,) [m, rad] and on the way to rest, as one vector
    (`NearestPairs.parameters`).
    """
    robot = None if motion is None else motion.robot
    n_v = pairs.model.n_v
    dimensions = with_nearest(Dimensions(n_q=len(q), n_v=n_v), [pairs])
    memory = structure_of(
        NearestMemory,
        with_any_distances(dimensions, [pairs.model], None),
        integrate=motion_function(robot, [pairs], dimensions),
        places=any_places([pairs.model], None),
    )()
    measuring = DistanceProvider(memory, [(0, pairs.n_parameters, pairs)], None)
    values = doubles(np.zeros(pairs.n_parameters))
    v = np.zeros(n_v)
    acceleration = np.ones(n_v)
    dt = np.inf
    if motion is not None:
        v = motion.v
        acceleration = np.minimum(motion.robot.limits.acceleration, ENDLESS)
        dt = motion.dt
    place_along_stop(memory, doubles(q), doubles(v), doubles(acceleration), dt)
    measure_pairs(memory, 0, values)
    measuring.answer.check()
    return np.array(values)
