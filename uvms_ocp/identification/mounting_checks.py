"""Estimate how the sensor of velocity is mounted: its scale, the turn of its axes, its place and its
delay, from displacements by position and attitude.

Over two seconds, the displacement of the body is what the sensor has measured, scaled, turned by its
mounting and by the heading, less what its place sweeps as the vehicle turns. All of these are linear
where they are small, and least squares estimate them jointly; the jackknife over parts of the
recording gives standard errors. What is beyond its tolerance by three of these is doubted, with a
cure. A turn about z is of the sensor or of the heading: only a tilted vehicle tells these apart.
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

_PERIOD = 2.0  # [s] duration of each displacement
_STRIDE = 0.25  # [s] between the beginnings of two displacements
_PARTS = 10  # parts of a recording, of which the jackknife leaves one out at a time
_MIN_DISPLACEMENTS = 100
_MIN_EXPLAINED = 0.8  # share of the displacements; where less is explained, other things are wrong
_SURE = 3.0
"""[standard errors] from which on a doubt is raised: ten numbers are looked at, and parts of a
recording are not independent.
"""
_ROUNDS = 3  # rounds of least squares, as turns are not small
_MAX_DELAY = 0.3  # [s] up to which the equations are linear
_MIN_FACTOR = 0.2  # of a scale that is an error of mounting and not another unit

# Tolerances: so much changes no number of a robot by more than its interval.
_SCALE_TOLERANCE = 0.015
_TURN_TOLERANCE = np.deg2rad(1.5)
_PLACE_TOLERANCE = 0.03  # [m]
_REACH = 3.0  # [m] farthest place of a sensor on a vehicle

# Standard errors from which on an estimate says nothing.
_UNSURE_SCALE = 0.05
_UNSURE_TURN = np.deg2rad(5.0)
_UNSURE_PLACE = 0.15  # [m]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Mounting:
    """Estimated mounting of a sensor of velocity, by position and attitude."""

    scale: float
    """[-] factor of its readings to the velocity."""
    scale_sigma: float
    """[-] standard error of the scale."""
    turn: np.ndarray
    """(3,) [rad] rotation vector of its axes against B."""
    turn_sigma: np.ndarray
    """(3,) [rad] standard errors of the turn."""
    place: np.ndarray
    """(3,) [m] in B, from the point of the vehicle that the position is of."""
    place_sigma: np.ndarray
    """(3,) [m] standard errors of the place."""
    share: float
    """[-] share of the displacements that the mounting explains."""


def of_mounting(recording: Recording) -> Iterator[tuple[str, str]]:
    """Yield doubts about the scale, the axes and the place of the sensor of velocity."""
    needed = {"position", "attitude", "linear_velocity"}
    if not needed <= recording.channels.keys():
        return
    if recording.channels["linear_velocity"].constants or recording.channels["position"].constants:
        return
    mounting = estimated_mounting(recording)
    if mounting is None or mounting.share < _MIN_EXPLAINED:
        return
    # Noise of readings makes the scale larger than it is, by no more than what is unexplained.
    tolerance = _SCALE_TOLERANCE + (1.0 - mounting.share)
    surplus_scale = abs(mounting.scale - 1.0) - _SURE * mounting.scale_sigma
    if surplus_scale > tolerance and mounting.scale_sigma < _UNSURE_SCALE:
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
    if ((surplus > _PLACE_TOLERANCE) & is_known).any() and np.abs(
        mounting.place[is_known]
    ).max() < _REACH:
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
    """Yield doubts about turns of the axes of the sensor, or of the heading."""
    surplus = np.abs(mounting.turn) - _SURE * mounting.turn_sigma
    is_sure = (surplus > _TURN_TOLERANCE) & (mounting.turn_sigma < _UNSURE_TURN)
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
    displacements = _Displacements.of(recording)
    if displacements is None:
        return None
    factor = 1.0  # of readings to velocities
    turn = np.eye(3)
    for _ in range(_ROUNDS):
        A = displacements.equations(factor, turn)
        solution = _solved(A, displacements.by_position)
        factor *= solution[0]
        if not _MIN_FACTOR < factor < 1.0 / _MIN_FACTOR or abs(solution[7]) > _MAX_DELAY:
            return None
        turn = pin.exp3(solution[1:4] / solution[0]) @ turn
    A = displacements.equations(factor, turn)
    b = displacements.by_position
    solution = _solved(A, b)
    solutions = []
    for part in np.array_split(np.arange(len(b)), _PARTS):
        is_kept = np.ones(len(b), dtype=bool)
        is_kept[part] = False
        solutions.append(_solved(A[is_kept], b[is_kept]))
    deviations = np.array(solutions) - np.mean(solutions, axis=0)
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


def _solved(A: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Solve for unknowns (k,) of equations (n, 3, k) and (n, 3), by their least norm where some are
    open.
    """
    return np.asarray(np.linalg.lstsq(A.reshape(-1, A.shape[-1]), b.ravel(), rcond=1e-8)[0])


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Displacements:
    """Displacements by the position, and the readings of the sensor of velocity during them."""

    by_position: np.ndarray
    """(n, 3) [m] displacements in W, each over `_PERIOD`."""
    v: np.ndarray
    """(m, 3) [m/s] readings at uniform times."""
    R: np.ndarray
    """(m, 3, 3) attitudes R_WB at these times."""
    first: np.ndarray
    """(n,) index of the sample with which each displacement begins."""
    last: np.ndarray
    """(n,) index of the sample with which each displacement ends."""

    @classmethod
    def of(cls, recording: Recording) -> _Displacements | None:
        """Cut a recording into displacements; `None` where there are too few."""
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
        if len(first) < _MIN_DISPLACEMENTS:
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
        """Build the equations (n, 3, 11) of the displacements: in scale, turn (3), place (3), delay and
        steady current (3), of readings multiplied by a factor and turned by a matrix (3, 3).
        """
        v = factor * self.v @ turn.T
        in_world = np.einsum("nij,nj->ni", self.R, v)
        columns = [self._integrals(in_world)]
        for axis in np.eye(3):
            columns.append(self._integrals(np.einsum("nij,nj->ni", self.R, np.cross(axis, v))))
        for k in range(3):  # what its place sweeps
            columns.append(self.R[self.first, :, k] - self.R[self.last, :, k])
        columns.append(in_world[self.last] - in_world[self.first])  # it is late
        for axis in np.eye(3):
            columns.append(np.broadcast_to(_PERIOD * axis, self.by_position.shape))
        return np.stack(columns, axis=-1)

    def _integrals(self, rates: np.ndarray) -> np.ndarray:
        """Integrate rates (m, 3) over each displacement."""
        steps = GRID * (rates[1:] + rates[:-1]) / 2
        total = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])
        return np.asarray(total[self.last] - total[self.first])
