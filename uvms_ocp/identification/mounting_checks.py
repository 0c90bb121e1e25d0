"""Estimate how the sensor of velocity is mounted: its scale, the turn of its axes, its place and its
delay, from what position and attitude say of the way.

Over two seconds, the way of the body by its position is what the sensor has measured, scaled,
turned by its mounting and by the heading, less what its place sweeps as the vehicle turns. All of
these are linear where they are small: least squares tell them jointly, and parts of the recording,
one after the other left out, how sure they are. What lies outside of what is tolerated by three
standard errors is said, with its cure. A turn about z is of the sensor or of the heading: only a
tilted vehicle tells these apart.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from uvms_ocp.identification.recording import Recording
from uvms_ocp.identification.resampling import (
    GRID,
    interpolated,
    rotations,
    smoothed,
)
from uvms_ocp.identification.series_agreement import WINDOW, explained

_PERIOD = 2.0  # [s] of each way
_STRIDE = 0.25  # [s] between the beginnings of two
_PARTS = 10  # of a recording, one of which is left out at a time
_LEAST_WAYS = 100
_EXPLAINED = 0.8  # share of the way that must be explained, or other things are wrong
_SURE = (
    3.0  # standard errors: ten numbers are looked at, and parts of a recording are not independent
)
_ROUNDS = 3  # of least squares: turns are not small
_MOST_DELAY = 0.3  # [s] that is a small one
_LEAST_FACTOR = 0.2
# What is tolerated: so much changes no number of a robot by more than its interval.
_SCALE = 0.015
_TURN = np.deg2rad(1.5)
_PLACE = 0.03  # [m]
_REACH = 3.0  # [m] farthest place of a sensor on a vehicle
# What is so uncertain that it says nothing.
_UNSURE_SCALE = 0.05
_UNSURE_TURN = np.deg2rad(5.0)
_UNSURE_PLACE = 0.15  # [m]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Mounting:
    """How a sensor of velocity is mounted, by position and attitude."""

    scale: float
    """[-] by which it reads too much."""
    scale_sigma: float
    turn: np.ndarray
    """(3,) [rad] of its axes against B."""
    turn_sigma: np.ndarray
    place: np.ndarray
    """(3,) [m] in B, from what the position is of."""
    place_sigma: np.ndarray
    share: float
    """[-] of the way that is explained so."""


def of_mounting(recording: Recording) -> Iterator[tuple[str, str]]:
    """Yield doubts about the scale, the axes and the place of the sensor of velocity."""
    needed = {"position", "attitude", "linear_velocity"}
    if not needed <= recording.channels.keys():
        return
    if recording.channels["linear_velocity"].constants or recording.channels["position"].constants:
        return
    mounting = estimated_mounting(recording)
    if mounting is None or mounting.share < _EXPLAINED:
        return
    # Noise of what is read makes the scale larger than it is, by no more than what is unexplained.
    tolerated = _SCALE + (1.0 - mounting.share)
    surplus_scale = abs(mounting.scale - 1.0) - _SURE * mounting.scale_sigma
    if surplus_scale > tolerated and mounting.scale_sigma < _UNSURE_SCALE:
        yield (
            "linear_velocity",
            (
                f"{mounting.scale:.3f} +- {mounting.scale_sigma:.3f} times the way that the position"
                f" goes: give it scale: {1.0 / mounting.scale:.4g}, unless it is the position's"
            ),
        )
    yield from _turns(mounting)
    surplus = np.abs(mounting.place) - _SURE * mounting.place_sigma
    is_known = mounting.place_sigma < _UNSURE_PLACE
    if ((surplus > _PLACE) & is_known).any() and np.abs(mounting.place[is_known]).max() < _REACH:
        places = []
        for axis, place, sigma in zip("xyz", mounting.place, mounting.place_sigma, strict=True):
            places.append(f"{axis} {place:.2f} +- {sigma:.2f}")
        yield (
            "linear_velocity",
            (
                f"measured elsewhere than the position, by {', '.join(places)} m: its lever arm; have"
                " velocity_point learnt from there, or give the sensor's place in the robot's file"
            ),
        )


def _turns(mounting: Mounting) -> Iterator[tuple[str, str]]:
    """Yield doubts about turns of its axes."""
    surplus = np.abs(mounting.turn) - _SURE * mounting.turn_sigma
    is_sure = (surplus > _TURN) & (mounting.turn_sigma < _UNSURE_TURN)
    if is_sure[:2].any():
        angles = np.rad2deg(mounting.turn)
        sigmas = np.rad2deg(mounting.turn_sigma)
        yield (
            "linear_velocity",
            (
                f"its axes are turned against those of the body by {angles[0]:.1f} +- {sigmas[0]:.1f}"
                f" deg about x, {angles[1]:.1f} +- {sigmas[1]:.1f} about y,"
                f" {angles[2]:.1f} +- {sigmas[2]:.1f} about z: how is it mounted?"
            ),
        )
    elif is_sure[2]:
        yield (
            "attitude",
            (
                f"with it the velocity points beside the way of the position, by"
                f" {-np.rad2deg(mounting.turn[2]):.1f} +- {np.rad2deg(mounting.turn_sigma[2]):.1f} deg"
                " about z: the heading, or how the sensor of velocity is mounted?"
            ),
        )


def estimated_mounting(recording: Recording) -> Mounting | None:
    """Estimate how the sensor of velocity is mounted; `None` where too little is recorded."""
    ways = _Ways.of(recording)
    if ways is None:
        return None
    factor = 1.0  # of what is read, to what is so
    turn = np.eye(3)
    for _ in range(_ROUNDS):
        A = ways.equations(factor, turn)
        solution = _least_squares(A, ways.by_position)
        factor *= solution[0]
        if not _LEAST_FACTOR < factor < 1.0 / _LEAST_FACTOR or abs(solution[7]) > _MOST_DELAY:
            return None
        turn = pin.exp3(solution[1:4] / solution[0]) @ turn
    A = ways.equations(factor, turn)
    b = ways.by_position
    solution = _least_squares(A, b)
    without = []
    for part in np.array_split(np.arange(len(b)), _PARTS):
        is_kept = np.ones(len(b), dtype=bool)
        is_kept[part] = False
        without.append(_least_squares(A[is_kept], b[is_kept]))
    deviations = np.array(without) - np.mean(without, axis=0)
    sigma = np.sqrt((_PARTS - 1) / _PARTS * (deviations**2).sum(axis=0))
    return Mounting(
        scale=1.0 / factor,
        scale_sigma=sigma[0] / factor,
        turn=np.asarray(pin.log3(turn)),
        turn_sigma=sigma[1:4],
        place=solution[4:7],
        place_sigma=sigma[4:7],
        share=explained(np.einsum("nik,k->ni", A, solution), b),
    )


def _least_squares(A: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Solve for unknowns (k,) of equations (n, 3, k) and (n, 3), by their least norm where some are
    open.
    """
    return np.asarray(np.linalg.lstsq(A.reshape(-1, A.shape[-1]), b.ravel(), rcond=1e-8)[0])


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Ways:
    """Ways by the position, and what the sensor of velocity read on them."""

    by_position: np.ndarray
    """(n, 3) [m] in W, each over `_PERIOD`."""
    v: np.ndarray
    """(m, 3) [m/s] as it was read, at uniform times."""
    R: np.ndarray
    """(m, 3, 3) attitudes at these."""
    first: np.ndarray
    """(n,) sample with which each way begins."""
    last: np.ndarray
    """(n,) sample with which each way ends."""

    @classmethod
    def of(cls, recording: Recording) -> _Ways | None:
        """Cut a recording into ways; `None` where there are too few."""
        position = recording.channels["position"]
        velocity = recording.channels["linear_velocity"]
        attitude = recording.channels["attitude"]
        t, places = smoothed(position.undelayed_t, position.values, WINDOW)
        begin = max(t[0], velocity.undelayed_t[0], attitude.undelayed_t[0]) + WINDOW
        end = min(t[-1], velocity.undelayed_t[-1], attitude.undelayed_t[-1]) - WINDOW
        inside = (t >= begin) & (t <= end)
        t = t[inside]
        places = places[inside]
        length = round(_PERIOD / GRID)
        first = np.arange(0, len(t) - length, round(_STRIDE / GRID))
        if len(first) < _LEAST_WAYS:
            return None
        last = first + length
        t_velocity, smooth = smoothed(velocity.undelayed_t, velocity.values, WINDOW)
        return cls(
            by_position=places[last] - places[first],
            v=interpolated(t, t_velocity, smooth),
            R=rotations(attitude, t),
            first=first,
            last=last,
        )

    def equations(self, factor: float, turn: np.ndarray) -> np.ndarray:
        """Build equations of the ways (n, 3, 11): scale, turn (3), place (3), delay and a steady
        current (3), all of what is left after a factor and a turn (3, 3).
        """
        v = factor * self.v @ turn.T
        in_world = np.einsum("nij,nj->ni", self.R, v)
        columns = [self._way(in_world)]
        for axis in np.eye(3):
            columns.append(self._way(np.einsum("nij,nj->ni", self.R, np.cross(axis, v))))
        for k in range(3):  # what its place sweeps
            columns.append(self.R[self.first, :, k] - self.R[self.last, :, k])
        columns.append(in_world[self.last] - in_world[self.first])  # it is late
        for axis in np.eye(3):
            columns.append(np.broadcast_to(_PERIOD * axis, self.by_position.shape))
        return np.stack(columns, axis=-1)

    def _way(self, rates: np.ndarray) -> np.ndarray:
        """Integrate rates (m, 3) over each way."""
        steps = GRID * (rates[1:] + rates[:-1]) / 2
        total = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])
        return np.asarray(total[self.last] - total[self.first])
