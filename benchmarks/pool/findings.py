"""Why a prediction departs from the measurement: what can be read from recordings and vehicle
themselves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from pool.recordings import SAMPLE_TIME, Recording
from pool.replay import at_times, quaternion_of, righting, static_balance
from pool.scores import OFFSET_TIME
from pool.vehicle import PoolVehicle

JUMP = 0.5
"""[deg] between two samples of the motion capture: no vehicle turns that fast."""
_REST = 0.05  # [rad/s] below which the arm stands still
_LONG_ENOUGH = 5.0  # [s] of rest in which a swing can be seen
EXPLAINED = 0.9
"""share of what is no drift that a damped swing must explain to be one."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Swing:
    """A free oscillation."""

    period: float
    """[s]"""
    damping: float
    """ratio to critical damping."""


def offset_deg(recording: Recording, predicted: np.ndarray) -> np.ndarray:
    """(2,) [deg] by which the measured roll and pitch differ from the predicted (n, 2) [rad] where
    offsets are removed.
    """
    first = recording.t <= recording.t[0] + OFFSET_TIME
    difference = recording.attitude - at_times(recording.t, recording.joint_t, predicted)
    offset: np.ndarray = np.degrees(difference[first].mean(axis=0))
    return offset


def restoring_ratio(vehicle: PoolVehicle, recording: Recording, shift: np.ndarray) -> float:
    """mean righting moment of a shift (3,) [m] of the centre of buoyancy, over that without one."""
    fitted = np.linalg.norm(righting(vehicle, recording, shift), axis=1)
    unshifted = np.linalg.norm(righting(vehicle, recording, np.zeros(3)), axis=1)
    return float(fitted.mean() / unshifted.mean())


def jumps(recording: Recording) -> int:
    """Number of samples of the motion capture that jump in roll or pitch."""
    steps = np.degrees(np.abs(np.diff(recording.attitude, axis=0)))
    return int((steps > JUMP).any(axis=1).sum())


def spread_deg(recording: Recording, seconds: float | None = None) -> np.ndarray:
    """(2,) [deg] peak to peak of the measured roll and pitch, in the first so many seconds [s] or
    in all.
    """
    until = np.inf if seconds is None else recording.t[0] + seconds
    spread: np.ndarray = np.degrees(np.ptp(recording.attitude[recording.t <= until], axis=0))
    return spread


def rest_begins(recording: Recording) -> float:
    """[s] after which the arm stands still."""
    moving = np.flatnonzero(np.abs(recording.joint_v).max(axis=1) > _REST)
    if not moving.size:
        return float(recording.joint_t[0])
    return float(recording.joint_t[moving[-1]])


def free_swings(vehicle: PoolVehicle, recording: Recording) -> tuple[Swing, Swing]:
    """Compute the free swings of roll and pitch of the simulated vehicle, linearised at rest with
    the arm as at the end of the recording.
    """
    attitude = static_balance(vehicle, recording, np.zeros(3))[-1]
    joints = np.concatenate([recording.joint_q[-1], np.zeros(8)])
    windows = np.tile(joints[:, None], 3)
    start = np.concatenate([quaternion_of(attitude), np.zeros(6)])

    def stepped(turn_and_nu: np.ndarray) -> np.ndarray:
        x = np.concatenate([_turned(start[:4], turn_and_nu[:3]), turn_and_nu[3:]])
        after = np.asarray(vehicle.step(x, windows, np.zeros(3), SAMPLE_TIME)).ravel()
        return np.concatenate([_turn_between(start[:4], after[:4]), after[4:]])

    transition = np.column_stack([(stepped(d) - stepped(-d)) / 2e-6 for d in 1e-6 * np.eye(9)])
    values, vectors = np.linalg.eig(transition)
    return _slowest(values, vectors, axis=0), _slowest(values, vectors, axis=1)


def _slowest(values: np.ndarray, vectors: np.ndarray, axis: int) -> Swing:
    """The oscillation that turns the vehicle most about an axis of roll (0) or pitch (1)."""
    pairs = [i for i, value in enumerate(values) if value.imag > 1e-6]
    share = [abs(vectors[axis, i]) / np.linalg.norm(vectors[:3, i]) for i in pairs]
    rate = np.log(values[pairs[int(np.argmax(share))]]) / SAMPLE_TIME
    return Swing(period=float(2 * np.pi / abs(rate.imag)), damping=float(-rate.real / abs(rate)))


def _turned(quaternion: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Quaternion xyzw (4,) turned by a small turn (3,) [rad] in B."""
    x, y, z, w = quaternion
    a, b, c = turn / 2
    product = [
        w * a + y * c - z * b,
        w * b + z * a - x * c,
        w * c + x * b - y * a,
        -x * a - y * b - z * c,
    ]
    turned: np.ndarray = quaternion + np.array(product)
    return turned / np.linalg.norm(turned)


def _turn_between(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Small turn (3,) [rad] in B from one quaternion xyzw (4,) to another."""
    x, y, z, w = first
    a, b, c, d = second
    turn: np.ndarray = 2.0 * np.array(
        [
            w * a - x * d - y * c + z * b,
            w * b - y * d - z * a + x * c,
            w * c - z * d - x * b + y * a,
        ]
    )
    return turn


def measured_swing(recording: Recording, angle: int) -> Swing | None:
    """Fit the free swing of roll (0) or pitch (1) after the arm has stopped; None where there is
    none to see.
    """
    resting = recording.t >= rest_begins(recording)
    t = recording.t[resting]
    x = np.degrees(recording.attitude[resting, angle])
    if not t.size or np.ptp(t) < _LONG_ENOUGH:
        return None
    return swing_in(t - t[0], x)


def swing_in(t: np.ndarray, x: np.ndarray) -> Swing | None:
    """The damped swing that an angle (n,) [deg] at t (n,) [s] from 0 is, but for a drift; None
    where it is none.
    """
    fits = [_damped_fit(t, x, period) for period in np.arange(1.0, 5.0, 0.25)]
    cost, swing = min(fits, key=lambda fit: fit[0])
    drift = np.polyval(np.polyfit(t, x, 1), t)
    if cost >= (1.0 - EXPLAINED) * float(np.sum((x - drift) ** 2)):
        return None
    return swing


def _damped_fit(t: np.ndarray, x: np.ndarray, period: float) -> tuple[float, Swing]:
    """Sum of squares left, and the oscillation, from a first guess of its period [s]."""

    def missed(p: np.ndarray) -> np.ndarray:
        omega, zeta = p
        phase = omega * np.sqrt(max(1.0 - zeta**2, 1e-6)) * t
        decay = np.exp(-zeta * omega * t)
        basis = np.column_stack([decay * np.cos(phase), decay * np.sin(phase), np.ones_like(t), t])
        residual: np.ndarray = x - basis @ np.linalg.lstsq(basis, x, rcond=None)[0]
        return residual

    fit = least_squares(missed, [2 * np.pi / period, 0.05], bounds=([0.5, 0.0], [10.0, 0.9]))
    omega, zeta = fit.x
    return 2.0 * float(fit.cost), Swing(period=float(2 * np.pi / omega), damping=float(zeta))
