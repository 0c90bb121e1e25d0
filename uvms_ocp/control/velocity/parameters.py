"""Parameters of tasks at one tick: their references, ending with the distances that some of them ask for.

A task on distances asks for `uvms_ocp.tasks.nearest_pairs.NearestPairs`; they are measured here, on the way to rest. Goals that
are still are in memory, for a kernel to take; those that move are asked at every tick.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Annotated, Any

import numpy as np

from uvms_ocp.control.velocity.climb import ClimbMemory
from uvms_ocp.control.velocity.stop import StopAhead
from uvms_ocp.control.velocity.tracks import Track, TracksMemory, follow_tracks, write_tracks
from uvms_ocp.functions.kernels.layout import Layout, Sized, Vector, view
from uvms_ocp.mission.mission import Mission, is_still
from uvms_ocp.mission.phase import MissionState
from uvms_ocp.mission.progress import MissionMemory
from uvms_ocp.model.shapes.collision_model import CollisionModel
from uvms_ocp.model.shapes.nearest_search import NearestSearch
from uvms_ocp.tasks.nearest_pairs import FAR, NearestPairs
from uvms_ocp.tasks.task import Task


class GoalsMemory(Layout):
    """Parameters of all tasks, one after the other, and those that they have in each phase while nothing moves or is near."""

    of_phase: Annotated[list[Vector], Sized("n_phases", "n_parameters")]
    """(n_phases, n_parameters) [their units]"""
    climb: int
    """Where the goal of the task that climbs begins among them."""
    tracks: TracksMemory
    """Of those that move and rest in the end."""
    values: Annotated[Vector, Sized("n_parameters")]
    """(n_parameters,) [their units] of now."""


def take_goals(g: GoalsMemory, m: MissionMemory, climb: ClimbMemory, t: float) -> None:
    """Those of the phase at t [s]; the abort phase climbs to where its beginning has aimed at. A kernel."""
    goals = g.of_phase[m.phase]
    for i in range(len(g.values)):
        g.values[i] = goals[i]
    follow_tracks(g.tracks, m.phase, m.since, t, g.values)
    if m.phase == m.abort_phase:
        for i in range(len(climb.goal)):
            g.values[g.climb + i] = climb.goal[i]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Asked:
    """A task that is asked at every tick of a phase."""

    index: int
    """In the hierarchy."""
    task: Task
    place: slice
    """Of its own among the parameters of all tasks."""
    reference: Callable[[float], np.ndarray]
    """Its goal at a time [s]."""
    moves: bool
    """Whether that changes with time."""
    of_phase: bool
    """Whether that time is the time since the start of the phase."""


class MissionParameters:
    """Those of all tasks in a `GoalsMemory`: what its kernel does not know is asked of the tasks, tick by tick."""

    def __init__(self, mission: Mission, memory: Any, tracks: Sequence[Track], dt: float) -> None:
        """memory: a `GoalsMemory`, which is set up. tracks: those of the mission, every dt [s]."""
        self._mission, self._values = mission, view(memory.values)
        found = [mission.references_of(phase) for phase in range(len(mission.all_phases))]
        starts = [[reference(0.0) for reference, _ in references] for references in found]
        ends = np.cumsum([0, *map(len, starts[0])]).tolist()
        self._places = [slice(start, end) for start, end in pairwise(ends)]
        for phase, values in enumerate(starts):
            view(memory.of_phase)[phase, : ends[-1]] = np.concatenate(values)
        if mission.abort is not None:
            climb = self._places[mission.hierarchy.index(mission.abort.climb)]
            memory.climb = climb.start
            view(memory.of_phase)[-1, climb] = 0.0
        write_tracks(memory.tracks, tracks, self._places, dt)
        self._tracked = {(track.phase, track.task) for track in tracks}
        self._asked = [self._asked_in(phase) for phase in range(len(mission.all_phases))]
        self.asks = [bool(asked) for asked in self._asked]
        """Of each phase, whether there is anything to ask."""
        self.measures = any(task.nearest_pairs is not None for task in mission.hierarchy.tasks)
        """Whether any task asks for distances."""

    @property
    def without_c_form(self) -> dict[str, str]:
        """Names of the tasks that are asked, and for what."""
        asked = [item for phase in self._asked for item in phase]
        return {a.task.name: "a goal that moves without telling its end" if a.moves else "distances" for a in asked}

    def ask(self, state: MissionState, t: float, *, gates: np.ndarray, q: np.ndarray, stop: StopAhead | None) -> None:
        """Complete what the kernel has taken for the tick at t [s].

        gates (n_tasks,) [-]: of now. Nothing is measured for tasks that are off, and stay off. q (n_q,) [m, rad]: as
        measured. stop: the stop from the present velocity, where it could come near a limit.
        """
        idle = self._mission.idle(state, gates)
        for asked in self._asked[state.phase]:
            if asked.moves:
                self._values[asked.place] = asked.reference(t - state.since if asked.of_phase else t)
            if not idle[asked.index]:
                now = self._values[asked.place]
                now[:] = parameters_of(asked.task, now, q, stop)

    def _asked_in(self, phase: int) -> tuple[_Asked, ...]:
        tasks, references = self._mission.tasks_of(phase), self._mission.references_of(phase)
        found = [
            _Asked(index=i, task=task, place=place, reference=reference, moves=not is_still(reference), of_phase=own)
            for i, (task, place, (reference, own)) in enumerate(zip(tasks, self._places, references, strict=True))
        ]
        return tuple(a for a in found if (a.moves or a.task.nearest_pairs) and not self._is_known(phase, a.index))

    def _is_known(self, phase: int, task: int) -> bool:
        return self._mission.climbs(phase, task) or (phase, task) in self._tracked


def mission_parameters(
    mission: Mission, state: MissionState, t: float, *, gates: np.ndarray, q: np.ndarray, stop: StopAhead | None
) -> np.ndarray:
    """Parameters (n_parameters,) [their units] of all tasks at t [s], in any state.

    gates (n_tasks,) [-], q (n_q,) [m, rad] and stop as in `MissionParameters.ask`.
    """
    found = zip(mission.tasks_of(state.phase), mission.references(state, t), mission.idle(state, gates), strict=True)
    return np.concatenate([goal if off else parameters_of(task, goal, q, stop) for task, goal, off in found])


def parameters_of(task: Task, reference: np.ndarray, q: np.ndarray, stop: StopAhead | None = None) -> np.ndarray:
    """A task's reference (n_parameters,) [its units], at its end the distances that it asks for at q (n_q,) [m, rad]."""
    pairs = task.nearest_pairs
    if pairs is None:
        return reference
    return np.concatenate([reference[: -pairs.n_parameters], measured(pairs, q, stop)])


def measured(pairs: NearestPairs, q: np.ndarray, stop: StopAhead | None = None) -> np.ndarray:
    """The smallest distance now, at q (n_q,) [m, rad]; of the nearest pairs distance, largest closing speed, and gradient.

    Distance and gradient are those of the place on the way to rest where the pair is nearest: on a curved path, or
    with a face that turns, that is nearer than the gradient of here and now tells. The speed is the one whose stop
    just leaves the threshold. As one vector (`NearestPairs.parameters`).
    """
    search = _search(pairs.model, pairs.n_rows, pairs.threshold)
    way = (np.zeros(pairs.model.n_v), (), ()) if stop is None else (stop.velocity, stop.durations, stop.configurations)
    found = search(q, *way)
    return pairs.parameters(
        smallest=found.smallest, distance=found.distance, closing=found.closing, gradient=found.gradient
    )


@lru_cache(maxsize=64)
def _search(model: CollisionModel, n: int, threshold: float) -> NearestSearch:
    return NearestSearch(model, n=n, threshold=threshold, far=FAR)
