"""Parameters of tasks at one tick: their references, ending with the distances that some of them ask for.

A task on distances asks for `uvms_ocp.tasks.nearest_pairs.NearestPairs`; they are measured here, on the way to rest.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from uvms_ocp.control.velocity.stop import StopAhead
from uvms_ocp.mission.mission import Mission, is_still
from uvms_ocp.mission.phase import GoalFunctions, MissionState
from uvms_ocp.model.shapes.collision_model import CollisionModel
from uvms_ocp.model.shapes.nearest_search import NearestSearch
from uvms_ocp.tasks.nearest_pairs import FAR, NearestPairs
from uvms_ocp.tasks.task import Task


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Asked:
    """A task that is asked at every tick."""

    index: int
    """In the hierarchy."""
    task: Task
    place: slice
    """Of its own among the parameters of all tasks."""
    reference: Callable[[float], np.ndarray]
    """Its goal at a time [s]."""
    of_phase: bool
    """Whether that is the time since the start of the phase."""


class MissionParameters:
    """Parameters of all tasks, one after the other, tick by tick. Goals that are still are asked for once in a phase."""

    def __init__(self, mission: Mission, n: int | None = None) -> None:
        """n [-]: how many there are, if that is known: then they are always in the same array `values`."""
        self._mission = mission
        self._of: tuple[int, GoalFunctions | None] = (-1, None)
        self.values = np.zeros(n or 0)
        """(n,) [their units] as last asked for."""
        self._asked = list[_Asked]()
        asking = [task.nearest_pairs for task in mission.hierarchy.tasks if task.nearest_pairs is not None]
        for pairs in asking:
            _search(pairs.model, pairs.n_rows, pairs.threshold)  # now, not in the first tick
        self.measures = bool(asking)
        """Whether any task asks for distances."""

    def at(
        self, state: MissionState, t: float, *, gates: np.ndarray, q: np.ndarray, stop: StopAhead | None
    ) -> np.ndarray:
        """Those of time t [s], valid until the next call.

        gates (n_tasks,) [-]: of now. Nothing is measured for tasks that are off, and stay off. q (n_q,) [m, rad]: as
        measured. stop: the stop from the present velocity, where it could come near a limit.
        """
        if self._of[0] != state.phase or self._of[1] is not state.goals:
            self._begin(state, t)
        if self._asked:
            idle = self._mission.idle(state, gates)
            for asked in self._asked:
                reference = asked.reference(t - state.since if asked.of_phase else t)
                off = idle[asked.index]
                self.values[asked.place] = reference if off else parameters_of(asked.task, reference, q, stop)
        return self.values

    def _begin(self, state: MissionState, t: float) -> None:
        """Another phase, or other goals."""
        goals = self._mission.goals(state)
        found = self._mission.references(state, t)
        ends = np.cumsum([0, *map(len, found)])
        if len(self.values) != ends[-1]:
            self.values = np.zeros(ends[-1])
        self.values[:] = np.concatenate(found)
        self._asked = [
            _Asked(
                index=i,
                task=task,
                place=slice(int(ends[i]), int(ends[i + 1])),
                reference=_always(found[i]) if is_still(reference) else reference,
                of_phase=of_phase,
            )
            for i, (task, (reference, of_phase)) in enumerate(
                zip(self._mission.tasks_of(state.phase), goals, strict=True)
            )
            if task.nearest_pairs is not None or not is_still(reference)
        ]
        self._of = state.phase, state.goals


def _always(value: np.ndarray) -> Callable[[float], np.ndarray]:
    return lambda t: value


def mission_parameters(
    mission: Mission, state: MissionState, t: float, *, gates: np.ndarray, q: np.ndarray, stop: StopAhead | None
) -> np.ndarray:
    """As `MissionParameters.at`, of one tick alone: t [s], gates (n_tasks,) [-], q (n_q,) [m, rad]."""
    return MissionParameters(mission).at(state, t, gates=gates, q=q, stop=stop)


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
