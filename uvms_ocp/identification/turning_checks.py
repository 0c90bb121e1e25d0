"""Estimate how a gyro is mounted: its scale, the turn of its axes and its bias, from turns of the
attitude.

Over a second, the attitude turns by what the gyro has measured, scaled, turned by its mounting, less
its bias and at another time. Least squares estimate these jointly, by Gauss-Newton over turns that
are put together from the readings; the jackknife over parts of the recording gives standard errors.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from uvms_ocp.identification.recording import Recording
from uvms_ocp.identification.resampling import GRID, interpolated, rotations

_PERIOD = 1.0  # [s] of each turn
_LONGEST_INTERVAL = 0.21  # [s] between samples, beyond which lines between them are no motion
_STRIDE = 0.25  # [s] between the beginnings of two turns
_PIECE_TURNS = 4800  # that are put together at once: 20 minutes
_ROUNDS = 5  # of Gauss-Newton
_OUTLIER = 5.0  # median residuals beyond which a turn does not count
_MAX_DELAY = 0.3  # [s] up to which the equations are linear
_MIN_FACTOR = 0.2  # of a scale that is an error of mounting and not another unit
_PARTS = 10  # of a recording, of which the jackknife leaves one out at a time
_MIN_TURNS = 80
_MIN_EXPLAINED = 0.8  # share of the turns; where less is explained, other things are wrong
_SURE = 3.0  # [standard errors] from which on a doubt is raised

# Turns that one of the two has lost.
_USUAL_RESIDUAL = 0.03  # [rad] median of what is left of turns, beyond which neither is good
_LOST_TURN = 0.2  # [rad] least of what is left of a turn that was lost
_BEYOND_USUAL = 15.0  # medians that this is, too

# Tolerances: so much changes no number of a robot by more than its interval.
_SCALE_TOLERANCE = 0.02
_TURN_TOLERANCE = np.deg2rad(2.5)
_BIAS_TOLERANCE = 0.01  # [rad/s]

# Standard errors from which on an estimate says nothing.
_UNSURE_SCALE = 0.05
_UNSURE_TURN = np.deg2rad(5.0)
_UNSURE_BIAS = 0.02  # [rad/s]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class GyroMounting:
    """Estimated mounting of a gyro, by the attitude."""

    scale: float
    """[-] factor of its readings to the rate of the attitude."""
    scale_sigma: float
    """[-] standard error of the scale."""
    turn: np.ndarray
    """(3,) [rad] small rotation vector of its axes against those of the attitude."""
    turn_sigma: np.ndarray
    """(3,) [rad] standard errors of the turn."""
    bias: np.ndarray
    """(3,) [rad/s] bias of its readings."""
    bias_sigma: np.ndarray
    """(3,) [rad/s] standard errors of the bias."""
    delay: float
    """[s] by which its readings are late against the attitude."""
    delay_sigma: float
    """[s] standard error of the delay."""
    share: float
    """[-] share of the turns that the mounting explains."""
    t: np.ndarray
    """(n,) [s] middle of each turn."""
    residuals: np.ndarray
    """(n,) [rad] what the mounting leaves of each turn."""


def of_turning(recording: Recording) -> Iterator[tuple[str, str]]:
    """Yield doubts about the scale, the axes and the bias of a gyro."""
    if not {"attitude", "angular_velocity"} <= recording.channels.keys():
        return
    if recording.channels["angular_velocity"].constants:
        return
    mounting = estimated_gyro_mounting(recording)
    if mounting is None or mounting.share < _MIN_EXPLAINED:
        return
    # Noise of readings makes the scale larger than it is, by no more than what is unexplained.
    tolerance = _SCALE_TOLERANCE + (1.0 - mounting.share)
    surplus_scale = abs(mounting.scale - 1.0) - _SURE * mounting.scale_sigma
    if surplus_scale > tolerance and mounting.scale_sigma < _UNSURE_SCALE:
        yield (
            "angular_velocity",
            (
                f"{mounting.scale:.3f} +- {mounting.scale_sigma:.3f} times the rate at which the"
                f" attitude turns: give it scale: {1.0 / mounting.scale:.4g}"
            ),
        )
    surplus_turn = np.abs(mounting.turn) - _SURE * mounting.turn_sigma
    is_turned = (surplus_turn > _TURN_TOLERANCE) & (mounting.turn_sigma < _UNSURE_TURN)
    if is_turned.any():
        angles = np.rad2deg(mounting.turn)
        sigmas = np.rad2deg(mounting.turn_sigma)
        parts = []
        for axis, angle, sigma in zip("xyz", angles, sigmas, strict=True):
            parts.append(f"{angle:.1f} +- {sigma:.1f} about {axis}")
        yield (
            "angular_velocity",
            (
                f"its axes are not those of the attitude, but turned by {', '.join(parts)} deg: how"
                " are the two mounted?"
            ),
        )
    surplus_bias = np.abs(mounting.bias) - _SURE * mounting.bias_sigma
    is_biased = (surplus_bias > _BIAS_TOLERANCE) & (mounting.bias_sigma < _UNSURE_BIAS)
    if is_biased.any():
        offsets = np.where(is_biased, -mounting.bias, 0.0)
        numbers = ", ".join(f"{offset:.3g}" for offset in offsets)
        axes = " and ".join(np.array(["x", "y", "z"])[is_biased])
        yield (
            "angular_velocity",
            (
                f"a bias of {axes}, while the attitude stands for what is right: have rate_bias learnt,"
                f" or give offset: [{numbers}]"
            ),
        )


def of_foreign_turns(recording: Recording) -> Iterator[tuple[str, str]]:
    """Yield turns of the attitude that a gyro does not have, which fits it well at most other times: by
    such an attitude all that depends on it points elsewhere.
    """
    if not {"attitude", "angular_velocity"} <= recording.channels.keys():
        return
    if recording.channels["angular_velocity"].constants:
        return
    mounting = estimated_gyro_mounting(recording)
    if mounting is None:
        return
    usual = float(np.median(mounting.residuals))
    if usual > _USUAL_RESIDUAL:
        return
    is_lost = mounting.residuals > max(_LOST_TURN, _BEYOND_USUAL * usual)
    if not is_lost.any():
        return
    first = mounting.t[int(np.argmax(is_lost))]
    n_times = int((~is_lost[:-1] & is_lost[1:]).sum() + is_lost[0])
    moments = "1 moment" if n_times == 1 else f"{n_times} moments"
    yield (
        "attitude",
        (
            f"turns otherwise than the angular_velocity at {moments}, first at {first:.4g} s, by up to"
            f" {np.rad2deg(mounting.residuals.max()):.0f} deg in a second, and agrees with it at all other"
            " times: lost, or set anew?"
        ),
    )


def estimated_gyro_mounting(recording: Recording) -> GyroMounting | None:
    """Estimate how the gyro is mounted; `None` where too little is recorded, or nothing turns."""
    turns = _Turns.of(recording)
    if turns is None:
        return None
    turned = float(np.square(turns.by_attitude - turns.by_attitude.mean(axis=0)).sum())
    if turned == 0.0:
        return None
    factor = 1.0  # of readings to rates
    turn = np.eye(3)
    bias = np.zeros(3)  # [rad/s]
    delay = 0.0  # [s]
    for _ in range(_ROUNDS):
        A, residuals = turns.equations(factor, turn, bias, delay)
        is_usual = _are_usual(residuals)
        solution = _solved(A[is_usual], residuals[is_usual])
        turn = pin.exp3(solution[1:4]) @ turn
        factor *= 1.0 + solution[0]
        delay += solution[4]
        bias = bias - solution[5:8]
        if not _MIN_FACTOR < factor < 1.0 / _MIN_FACTOR or abs(delay) > _MAX_DELAY:
            return None
    A, residuals = turns.equations(factor, turn, bias, delay)
    is_usual = _are_usual(residuals)
    solutions = []
    for part in np.array_split(np.arange(len(residuals)), _PARTS):
        is_kept = is_usual.copy()
        is_kept[part] = False
        solutions.append(_solved(A[is_kept], residuals[is_kept]))
    deviations = np.array(solutions) - np.mean(solutions, axis=0)
    sigma = np.sqrt((_PARTS - 1) / _PARTS * (deviations**2).sum(axis=0))
    return GyroMounting(
        scale=1.0 / factor,
        scale_sigma=float(sigma[0]) / factor,
        turn=np.asarray(pin.log3(turn)),
        turn_sigma=sigma[1:4],
        bias=turn.T @ bias / factor,
        bias_sigma=sigma[5:8] / factor,
        delay=float(delay),
        delay_sigma=float(sigma[4]),
        t=turns.t,
        residuals=np.linalg.norm(residuals, axis=1),
        share=1.0 - float((residuals**2).sum()) / turned,
    )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Turns:
    """Turns by the attitude, and the readings of the gyro during them."""

    by_attitude: np.ndarray
    """(n, 3) [rad] rotation vectors, each over a period."""
    rates: np.ndarray
    """(m, 3) [rad/s] mean readings between uniform times."""
    slopes: np.ndarray
    """(m, 3) [rad/s2] rates of change of the readings."""
    first: np.ndarray
    """(n,) index of the interval with which each turn begins."""
    last: np.ndarray
    """(n,) index of the interval after each turn."""
    t: np.ndarray
    """(n,) [s] middle of each turn."""

    @classmethod
    def of(cls, recording: Recording) -> _Turns | None:
        """Cut a recording into turns; `None` where there are too few."""
        attitude = recording.channels["attitude"]
        gyro = recording.channels["angular_velocity"]
        t_gyro = gyro.undelayed_t
        begin = max(t_gyro[0], attitude.undelayed_t[0])
        end = min(t_gyro[-1], attitude.undelayed_t[-1])
        intervals = [float(np.median(np.diff(channel.t))) for channel in (attitude, gyro)]  # [s]
        if max(intervals) > _LONGEST_INTERVAL:
            return None
        length = round(_PERIOD / GRID)
        t = np.arange(begin, end, GRID)
        first = np.arange(0, len(t) - length, round(_STRIDE / GRID))
        if len(first) < _MIN_TURNS:
            return None
        steps = np.diff(t_gyro)[:, None] * (gyro.values[1:] + gyro.values[:-1]) / 2
        totals = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])
        rates = np.diff(interpolated(t, t_gyro, totals), axis=0) / GRID
        slopes = np.gradient(rates, GRID, axis=0)
        R = rotations(attitude, t)
        last = first + length
        relative = np.einsum("nji,njk->nik", R[first], R[last])
        return cls(
            by_attitude=_rotation_vectors(relative),
            rates=rates,
            slopes=slopes,
            first=first,
            last=last,
            t=(t[first] + t[last]) / 2,
        )

    def equations(
        self, factor: float, turn: np.ndarray, bias: np.ndarray, delay: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Build the equations (n, 3, 8) of what is left of the turns (n, 3) [rad] after those by the
        gyro: in scale, turn (3), delay and bias (3), of readings at these.
        """
        pieces = []
        for begin in range(0, len(self.first), _PIECE_TURNS):
            piece = self._piece(begin, begin + _PIECE_TURNS)
            pieces.append(piece._equations_at_once(factor, turn, bias, delay))
        return (
            np.concatenate([A for A, _ in pieces]),
            np.concatenate([residuals for _, residuals in pieces]),
        )

    def _piece(self, begin: int, end: int) -> _Turns:
        """Return the turns from one index to before another, with the readings during them alone."""
        chosen = slice(begin, end)
        first = self.first[chosen]
        last = self.last[chosen]
        during = slice(first[0], last[-1])
        return _Turns(
            by_attitude=self.by_attitude[chosen],
            rates=self.rates[during],
            slopes=self.slopes[during],
            first=first - first[0],
            last=last - first[0],
            t=self.t[chosen],
        )

    def _equations_at_once(
        self, factor: float, turn: np.ndarray, bias: np.ndarray, delay: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Build the equations of `equations` from the product of all turns between readings."""
        omega = factor * (self.rates + delay * self.slopes) @ turn.T - bias
        attitudes = _cumulative_products(_rotation_matrices(GRID * omega))  # by the gyro alone
        R_end = attitudes[self.last]
        by_gyro = np.einsum("nji,njk->nik", attitudes[self.first], R_end)
        measured = _rotation_matrices(self.by_attitude)
        residuals = _rotation_vectors(np.einsum("nji,njk->nik", by_gyro, measured))
        changes = [omega]
        for axis in np.eye(3):
            changes.append(np.cross(axis, omega))
        changes.append(factor * self.slopes @ turn.T)
        for axis in np.eye(3):
            changes.append(np.broadcast_to(axis, omega.shape))
        columns = []
        for change in changes:
            in_common_frame = np.einsum("nij,nj->ni", attitudes[:-1], change)
            total = np.vstack([np.zeros(3), GRID * np.cumsum(in_common_frame, axis=0)])
            columns.append(np.einsum("nji,nj->ni", R_end, total[self.last] - total[self.first]))
        return np.stack(columns, axis=-1), residuals


def _are_usual(residuals: np.ndarray) -> np.ndarray:
    """Choose equations whose residuals (n, 3) are no outliers."""
    sizes = np.linalg.norm(residuals, axis=1)
    return np.asarray(sizes <= _OUTLIER * np.median(sizes))


def _cumulative_products(steps: np.ndarray) -> np.ndarray:
    """Multiply matrices (m, 3, 3) one after the other; returns all products (m + 1, 3, 3), of none
    first, by doubling how many each holds.
    """
    products = np.concatenate([np.eye(3)[None], steps])
    shift = 1
    while shift < len(products):
        products[shift:] = products[:-shift] @ products[shift:]
        shift *= 2
    return products


def _rotation_vectors(R: np.ndarray) -> np.ndarray:
    """Convert matrices (n, 3, 3) to rotation vectors (n, 3) [rad]."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(R).as_rotvec())


def _rotation_matrices(vectors: np.ndarray) -> np.ndarray:
    """Convert rotation vectors (n, 3) [rad] to matrices (n, 3, 3)."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_rotvec(vectors).as_matrix())


def _solved(A: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Solve equations (n, 3, k) and (n, 3) for unknowns (k,), by their least norm where some are
    open.
    """
    return np.asarray(np.linalg.lstsq(A.reshape(-1, A.shape[-1]), b.ravel(), rcond=1e-8)[0])
