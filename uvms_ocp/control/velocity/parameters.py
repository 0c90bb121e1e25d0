"""Parameters of tasks at one tick: their references, ending with the distances that some of them ask for.

A task on distances asks for `uvms_ocp.tasks.nearest_pairs.NearestPairs`; they are measured here, on the way to rest.
"""

from __future__ import annotations

import numpy as np

from uvms_ocp.control.velocity.stop import StopAhead
from uvms_ocp.mission.mission import Mission
from uvms_ocp.mission.phase import MissionState
from uvms_ocp.model.axis_reach import largest_change
from uvms_ocp.tasks.nearest_pairs import FAR, NearestPairs
from uvms_ocp.tasks.task import Task


def mission_parameters(
    mission: Mission, state: MissionState, t: float, *, gates: np.ndarray, q: np.ndarray, stop: StopAhead | None
) -> np.ndarray:
    """Parameters of all tasks at time t [s], one after the other.

    gates (n_tasks,) [-]: of now. Nothing is measured for tasks that are off, and stay off. q (n_q,) [m, rad]: as measured.
    stop: the stop from the present velocity, where it could come near a limit.
    """
    given = zip(mission.tasks_of(state.phase), mission.references(state, t), mission.idle(state, gates), strict=True)
    return np.concatenate(
        [reference if idle else parameters_of(task, reference, q, stop) for task, reference, idle in given]
    )


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
    now, n = pairs.model.values(q), pairs.n_rows
    chosen, gradient, closing = np.argsort(now)[:n], np.zeros((n, pairs.model.n_v)), np.full(n, FAR)
    lowest, worst = now[chosen], np.zeros(n, dtype=int)
    if stop is not None:
        chosen, lowest, worst = _nearest_on_the_way(pairs, now, stop)
    for place in set(worst.tolist()):
        rows = np.flatnonzero(worst == place)
        where = q if stop is None or place == 0 else stop.configurations[place - 1]
        gradient[rows] = pairs.model.distances(where, chosen[rows]).gradient
        if stop is not None and place:
            # The way to rest grows with the square of the speed.
            room = (lowest[rows] - pairs.threshold) / (2.0 * stop.durations[place - 1])
            closing[rows] = room - gradient[rows] @ stop.velocity
    return pairs.parameters(smallest=float(now.min()), distance=lowest, closing=closing, gradient=gradient)


def _nearest_on_the_way(
    pairs: NearestPairs, now: np.ndarray, stop: StopAhead
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pairs (n,) that come nearest, their smallest distance, and where that is: 0 now, k at the k-th place."""
    approach = float(largest_change(pairs.model.reach, np.abs(stop.velocity))) * stop.durations[-1]
    near = np.flatnonzero(now <= np.sort(now)[pairs.n_rows - 1] + approach)
    distances = np.array([now[near], *(pairs.model.values(place, near) for place in stop.configurations)])
    chosen = np.argsort(distances.min(axis=0))[: pairs.n_rows]
    return near[chosen], distances.min(axis=0)[chosen], distances.argmin(axis=0)[chosen]
