"""Check whether velocities of joints are the rates of their positions."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from uvms_ocp.identification.recording import Recording
from uvms_ocp.identification.resampling import interpolated, smoothed
from uvms_ocp.identification.series_agreement import (
    DEAD,
    WINDOW,
    correlation,
    describe_delay,
    describe_factor,
    offset,
)

_MOVING_JOINT = 0.01  # [rad/s, m/s] standard deviation of rates from which on a joint moves
_DOUBTFUL = 0.5  # correlation below which a velocity may be that of another joint
_BETTER = 0.3  # by which the correlation with that joint must be higher


def of_joints(recording: Recording) -> Iterator[tuple[str, str]]:
    """Yield doubts about positions and velocities of joints: their order, signs, units and clocks,
    and joints of which one of the two never changes.
    """
    if not {"joint_positions", "joint_velocities"} <= recording.channels.keys():
        return
    positions = recording.channels["joint_positions"]
    velocities = recording.channels["joint_velocities"]
    if positions.values.shape[1] != velocities.values.shape[1]:
        yield (
            "joint_velocities",
            f"{velocities.values.shape[1]} of them, and {positions.values.shape[1]} positions",
        )
        return
    t, rate = smoothed(positions.undelayed_t, positions.values, WINDOW, derivative=1)
    t_measured, measured_rate = smoothed(velocities.undelayed_t, velocities.values, WINDOW)
    position_ranges = np.ptp(positions.values, axis=0)
    velocity_ranges = np.ptp(velocities.values, axis=0)
    yield from _dead(rate, measured_rate, position_ranges, velocity_ranges)
    if rate.std(axis=0).max() < _MOVING_JOINT or measured_rate.std(axis=0).max() < DEAD:
        return
    found = offset(t, rate, t_measured, measured_rate)
    shifted = interpolated(t + found.delay, t_measured, measured_rate)
    for text in (describe_delay(found), describe_factor(rate, shifted)):
        if text:
            yield "joint_velocities", text.format("positions")
    yield from _columns(rate, shifted)


def _dead(
    rate: np.ndarray,
    measured_rate: np.ndarray,
    position_ranges: np.ndarray,
    velocity_ranges: np.ndarray,
) -> Iterator[tuple[str, str]]:
    """Yield joints whose position or velocity stays while the other one moves."""
    for k in range(len(position_ranges)):
        if position_ranges[k] < DEAD and measured_rate[:, k].std() > _MOVING_JOINT:
            yield "joint_positions", f"dead: {k} stays where it is, and its velocity does not"
        if velocity_ranges[k] < DEAD and rate[:, k].std() > _MOVING_JOINT:
            yield "joint_velocities", f"dead: {k} stays as it is, and its position moves"


def _columns(rate: np.ndarray, measured_rate: np.ndarray) -> Iterator[tuple[str, str]]:
    """Yield velocities that fit the position of another joint, or the opposite of one."""
    is_moving = np.minimum(rate.std(axis=0), measured_rate.std(axis=0)) > _MOVING_JOINT
    moving = np.flatnonzero(is_moving).tolist()
    for k in moving:
        fits = {j: correlation(measured_rate[:, k], rate[:, j]) for j in moving}
        best = max(fits, key=lambda j: abs(fits[j]))
        if fits[k] < _DOUBTFUL and abs(fits[best]) > fits[k] + _BETTER:
            sign = "minus " if fits[best] < 0 else ""
            yield "joint_velocities", f"{k} fits {sign}the rate of position {best}"
