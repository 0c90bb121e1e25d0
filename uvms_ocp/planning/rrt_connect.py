"""Sample way points around obstacles by RRT-Connect [Kuffner2000], for paths that no bending
frees.
"""

from __future__ import annotations

from threading import RLock
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from uvms_ocp.checks import checked, checked_dataclass
from uvms_ocp.planning.conservative_advancement import (
    PairDistances,
)
from uvms_ocp.robot.kinematics import largest_change
from uvms_ocp.types import (
    Array,
    Count,
    Positive,
    Range,
    Shape,
)

_SHORTCUTS = 60  # attempts at cutting corners of the path found
_SMALLEST_ADVANCE = 1e-3  # share of an edge; where less is certain, the edge counts as blocked
ONE_THREAD = RLock()
"""Held while linear algebra is on one thread: that limit is of the whole process, and each who sets
it restores what it found.
"""

Place = Annotated[ArrayLike, Shape("distances.scene.coordinates.n_axes"), Range(open=True)]


@checked_dataclass()
class SamplingOptions:
    """Settings of ``sampled_waypoints``. Raises `InvalidInput` for a step or room that is not
    positive.
    """

    max_samples: int = 3000
    step: Positive = 0.5
    """[m, rad] Length of one extension of a tree, over all axes together."""
    clearance: float = 0.005
    """[m] Distance that edges keep."""
    room: Positive = 1.0
    """[m or rad] Distance beyond start and goal within which unlimited axes are sampled."""
    seed: Count = 0


@checked
def sampled_waypoints(
    distances: PairDistances, start: Place, goal: Place, options: SamplingOptions | None = None
) -> Array | None:
    """Find way points (n, n_axes) [m, rad] whose straight legs are free of collision, or None where
    none were found in time.

    start and goal (n_axes,) [m, rad].
    """
    settings = options or SamplingOptions()
    a = np.asarray(start, dtype=float)
    b = np.asarray(goal, dtype=float)
    rng = np.random.default_rng(settings.seed)
    lower, upper = _sampled_box(distances, a, b, settings.room)
    path = _connected(distances, a, b, lower, upper, rng, settings)
    if path is None:
        return None
    return _shortened(distances, path, rng, settings)


def edge_reach(distances: PairDistances, a: Array, b: Array, clearance: float) -> float:
    """Return the fraction of the straight edge from a to b (n_axes,) [m, rad] that certainly keeps
    the clearance [m]; 1 is all of it.

    Advances by the distance at hand over the fastest approach any pair can make, so nothing is
    skipped.
    """
    pace = np.maximum(largest_change(distances.scene.reach, np.abs(b - a)), 1e-12)
    done = 0.0
    while done < 1.0:
        d = distances.distances((a + done * (b - a))[None])[0]
        slack = float(np.min((d - clearance) / pace, initial=np.inf))
        if slack <= _SMALLEST_ADVANCE:
            return done
        done = done + slack
    return 1.0


class _SearchTree:
    """Points, each with the index of the one it grew from."""

    def __init__(self, root: Array, capacity: int) -> None:
        self.points = np.empty((capacity, root.size))
        self.points[0] = root
        self.parents = [-1]

    def nearest(self, x: Array) -> int:
        return int(np.argmin(np.sum((self.points[: len(self.parents)] - x) ** 2, axis=1)))

    def add(self, x: Array, parent: int) -> int:
        if len(self.parents) == len(self.points):
            self.points = np.concatenate([self.points, np.empty_like(self.points)])
        self.points[len(self.parents)] = x
        self.parents.append(parent)
        return len(self.parents) - 1

    def to_root(self, index: int) -> list[Array]:
        path = []
        while index >= 0:
            path.append(self.points[index].copy())
            index = self.parents[index]
        return path


def _connected(
    distances: PairDistances,
    a: Array,
    b: Array,
    lower: Array,
    upper: Array,
    rng: np.random.Generator,
    options: SamplingOptions,
) -> Array | None:
    """Grow a tree from either end by turns until they meet (RRT-Connect); None where they do
    not.
    """
    growing = _SearchTree(a, 256)
    meeting = _SearchTree(b, 256)
    for turn in range(options.max_samples):
        if turn == 0:
            target = meeting.points[0].copy()
        else:
            target = rng.uniform(lower, upper)
        grown = _extended(distances, growing, target, options, once=turn > 0)
        met = _extended(distances, meeting, growing.points[grown], options, once=False)
        if np.array_equal(meeting.points[met], growing.points[grown]):
            path = [*growing.to_root(grown)[::-1], *meeting.to_root(met)[1:]]
            if not np.array_equal(path[0], a):
                path.reverse()
            return np.array(path)
        growing, meeting = meeting, growing
    return None


def _extended(
    distances: PairDistances,
    tree: _SearchTree,
    target: Array,
    options: SamplingOptions,
    *,
    once: bool,
) -> int:
    """Grow a tree towards the target by one step, or until it is reached or blocked; return the
    index of the last point.
    """
    index = tree.nearest(target)
    while True:
        nearest_point = tree.points[index]
        gap = float(np.linalg.norm(target - nearest_point))
        if gap == 0.0:
            return index
        if gap <= options.step:
            next_point = target
        else:
            next_point = nearest_point + (target - nearest_point) * (options.step / gap)
        if edge_reach(distances, nearest_point, next_point, options.clearance) < 1.0:
            return index
        index = tree.add(next_point, index)
        if once:
            return index


def _shortened(
    distances: PairDistances, path: Array, rng: np.random.Generator, options: SamplingOptions
) -> Array:
    """Cut straight between random points of a path where that is free, then leave out each vertex
    that can be left out.
    """
    for _ in range(_SHORTCUTS):
        if len(path) < 3:
            break
        i, j = np.sort(rng.choice(len(path) - 1, size=2, replace=False))
        p = path[i] + rng.uniform() * (path[i + 1] - path[i])
        q = path[j] + rng.uniform() * (path[j + 1] - path[j])
        if edge_reach(distances, p, q, options.clearance) >= 1.0:
            path = np.concatenate([path[: i + 1], p[None], q[None], path[j + 1 :]])
    return _pruned(distances, path, options.clearance)


def _pruned(distances: PairDistances, path: Array, clearance: float) -> Array:
    """Leave out vertices of a path where the straight edge past them keeps the clearance."""
    vertices = [path[0]]
    i = 0
    while i < len(path) - 1:
        j = len(path) - 1
        while j > i + 1 and edge_reach(distances, path[i], path[j], clearance) < 1.0:
            j -= 1
        vertices.append(path[j])
        i = j
    return np.array(vertices)


def _sampled_box(distances: PairDistances, a: Array, b: Array, room: float) -> tuple[Array, Array]:
    lower, upper = distances.scene.coordinates.limits()
    return np.maximum(lower, np.minimum(a, b) - room), np.minimum(upper, np.maximum(a, b) + room)
