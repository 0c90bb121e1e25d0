"""Whether velocities of joints are the rates of their positions: order, sign, units, clocks, and what is dead in one alone."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from uvms_ocp.identification.recordings.doubts.agreement import correlation, offset, told_factor, told_late
from uvms_ocp.identification.recordings.doubts.samples import DEAD, WINDOW
from uvms_ocp.identification.recordings.recording import Recording
from uvms_ocp.identification.recordings.sampling import smoothed

_MOVES = 0.01  # [rad/s, m/s] standard deviation; less says nothing
_OTHER = 0.5  # [-] correlation below which a joint may be another
_BETTER = 0.3  # [-] by which that must fit better
_NAMES = ("joint_positions", "joint_velocities")


def of_joints(recording: Recording) -> Iterator[tuple[str, str]]:
    """Channels and what speaks against them."""
    if not set(_NAMES) <= recording.channels.keys():
        return
    positions, velocities = (recording.channels[name] for name in _NAMES)
    if positions.values.shape[1] != velocities.values.shape[1]:
        yield _NAMES[1], f"{velocities.values.shape[1]} of them, and {positions.values.shape[1]} positions"
        return
    t, rate = smoothed(positions.known_t, positions.values, WINDOW, derivative=1)
    t_seen, seen = smoothed(velocities.known_t, velocities.values, WINDOW)
    yield from _dead(rate, seen, np.ptp(positions.values, axis=0), np.ptp(velocities.values, axis=0))
    if rate.std(axis=0).max() < _MOVES or seen.std(axis=0).max() < DEAD:
        return
    late, _ = offset(t, rate, t_seen, seen)
    shifted = np.column_stack([np.interp(t + late, t_seen, column) for column in seen.T])
    told = [told_late(late), told_factor(rate, shifted)]
    yield from ((_NAMES[1], text.format("positions")) for text in told if text)
    yield from _columns(rate, shifted)


def _dead(rate: np.ndarray, seen: np.ndarray, width: np.ndarray, speeds: np.ndarray) -> Iterator[tuple[str, str]]:
    for k in range(len(width)):
        if width[k] < DEAD and seen[:, k].std() > _MOVES:
            yield _NAMES[0], f"dead: {k} stays where it is, and its velocity does not"
        if speeds[k] < DEAD and rate[:, k].std() > _MOVES:
            yield _NAMES[1], f"dead: {k} stays as it is, and its position moves"


def _columns(rate: np.ndarray, seen: np.ndarray) -> Iterator[tuple[str, str]]:
    moving = [k for k in range(rate.shape[1]) if min(rate[:, k].std(), seen[:, k].std()) > _MOVES]
    for k in moving:
        fits = {j: correlation(seen[:, k], rate[:, j]) for j in moving}
        best = max(fits, key=lambda j: abs(fits[j]))
        if fits[k] < _OTHER and abs(fits[best]) > fits[k] + _BETTER:
            sign = "minus " if fits[best] < 0 else ""
            yield _NAMES[1], f"{k} fits {sign}the rate of position {best}"
