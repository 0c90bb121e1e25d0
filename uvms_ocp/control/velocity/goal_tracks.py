"""Goals that move and come to rest, as samples: what a kernel can follow without the function that
they came from.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from uvms_ocp.codegen.kernel_layout import (
    Layout,
    Sized,
    Vector,
    view,
)
from uvms_ocp.mission.mission import Mission
from uvms_ocp.robot.dimensions import Dimensions
from uvms_ocp.tasks.goals import EndingReference
from uvms_ocp.tasks.task import Task

_MOST = 20_000  # samples: 100 s at 200 Hz; a longer goal is asked at every tick


class TracksMemory(Layout):
    """Parameters of tasks at multiples of the control period, of one goal after the other."""

    dt: float
    """[s] between samples."""
    n_tracks: int
    phase: Annotated[list[int], Sized("n_tracks")]
    """(n_tracks,) phase in which each track counts."""
    of_phase: Annotated[list[int], Sized("n_tracks")]
    """(n_tracks,) which tracks begin with their phase, and not at time 0."""
    place: Annotated[list[int], Sized("n_tracks")]
    """(n_tracks,) index of the first parameter of each track, among those of all tasks."""
    width: Annotated[list[int], Sized("n_tracks")]
    """(n_tracks,) number of parameters of each track."""
    first: Annotated[list[int], Sized("n_tracks")]
    """(n_tracks,) index of the first number of each track in `table`."""
    last: Annotated[list[int], Sized("n_tracks")]
    """(n_tracks,) index of the last sample of each track, where its goal rests."""
    table: Annotated[Vector, Sized("n_table")]
    """(n_table,) [their units] parameters of all samples, one sample after the other."""


def follow_tracks(
    tracks: TracksMemory, phase: int, of_phase: float, elapsed: float, values: Vector
) -> None:
    """Write the parameters [their units] of all tasks whose goal moves in a phase. A kernel.

    of_phase, elapsed: [s] since the start of the phase, and of the mission.
    """
    for k in range(tracks.n_tracks):
        if tracks.phase[k] == phase:
            _sample(tracks, k, of_phase if tracks.of_phase[k] != 0 else elapsed, values)


def _sample(tracks: TracksMemory, k: int, t: float, values: Vector) -> None:
    """Interpolate linearly between two samples."""
    ticks = min(max(0.0, t / tracks.dt), float(tracks.last[k]))
    before = min(int(ticks), tracks.last[k] - 1)
    share = ticks - before
    at = tracks.first[k] + before * tracks.width[k]
    for i in range(tracks.width[k]):
        sample = tracks.table[at + i]
        then = tracks.table[at + tracks.width[k] + i]
        values[tracks.place[k] + i] = sample + share * (then - sample)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Track:
    """Samples of the goal of one task in one phase."""

    phase: int
    """Index among all phases."""
    task: int
    """Index in the hierarchy."""
    of_phase: bool
    """The track begins with the phase, not at time 0."""
    samples: np.ndarray
    """(n, n_parameters) [their units] parameters at multiples of the control period."""


def tracks_of(mission: Mission, dt: float) -> tuple[Track, ...]:
    """Sample all goals that move and rest in the end, every dt [s]."""
    tracks = []
    for phase in range(len(mission.all_phases)):
        tasks = mission.tasks_of(phase)
        for index, (reference, from_phase_start) in enumerate(mission.references_of(phase)):
            n = _length(tasks[index], dt)
            if n == 0 or mission.has_ascent_goal(phase, index):
                continue
            samples = np.array([reference(k * dt) for k in range(n + 1)])
            track = Track(phase=phase, task=index, of_phase=from_phase_start, samples=samples)
            tracks.append(track)
    return tuple(tracks)


def _length(task: Task, dt: float) -> int:
    """Return the first sample at which the goal of a task surely rests; 0 where its goal is no
    track.
    """
    goal = getattr(task, "goal", None)
    if not isinstance(goal, EndingReference) or not isinstance(goal.end, float):
        return 0
    if not task.follows_goal_alone or task.nearest_pairs is not None:
        return 0
    ticks = goal.end / dt
    if ticks < _MOST:
        return math.ceil(max(0.0, ticks)) + 1
    return 0


def with_tracks(dimensions: Dimensions, tracks: Sequence[Track]) -> Dimensions:
    """Return the dimensions with those of tracks. Tables of nearly one size have the same, so that
    few are compiled.
    """
    n = sum(track.samples.size for track in tracks)
    n_table = 0
    if n > 0:
        n_table = 1 << (n - 1).bit_length()
    return replace(dimensions, n_tracks=len(tracks), n_table=n_table)


def write_tracks(
    memory: TracksMemory, tracks: Sequence[Track], places: Sequence[slice], dt: float
) -> None:
    """Write tracks into a `TracksMemory`. places: of the tasks among the parameters of all; dt [s]:
    between samples.
    """
    memory.dt = dt
    memory.n_tracks = len(tracks)
    table = view(memory.table)
    first = 0
    for k, track in enumerate(tracks):
        end = first + track.samples.size
        memory.phase[k] = track.phase
        memory.of_phase[k] = track.of_phase
        memory.place[k] = places[track.task].start
        memory.last[k] = len(track.samples) - 1
        memory.width[k] = track.samples.shape[1]
        memory.first[k] = first
        table[first:end] = track.samples.ravel()
        first = end
