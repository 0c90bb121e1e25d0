"""Process model and measurement models of the vehicle, in NumPy: the twin of motion.c and sights.c."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from uvms_ocp.estimation.filter_memory import CONSTANTS, MAIN, ROWS, ChannelIndex, FilterMemory, Part, ProcessNoise
from uvms_ocp.types import Array, Mask

# The motion of the vehicle in NumPy: what motion.c does; keep both in step.

_FORGOTTEN = slice(Part.SPEED, Part.GYRO_BIAS)  # parts that are zero where nothing is known of them


def part(m: FilterMemory, which: Part) -> Array:
    """(3,) of the estimate, a view."""
    return m.x[which - Part.PLACE : which - Part.PLACE + 3]


def rotation(m: FilterMemory) -> Array:
    """R_WB (3, 3)."""
    return np.asarray(pin.Quaternion(m.turn).toRotationMatrix())


def turned(quaternion: Array, by: Array) -> Array:
    """Quaternion (4,) times the rotation by the vector `by` (3,) [rad]."""
    squared = float(by @ by)
    angle = math.sqrt(squared)
    share = math.sin(angle / 2) / angle if angle > 1e-4 else 0.5 - squared / 48
    x, y, z = (share * by).tolist()
    result = (pin.Quaternion(quaternion) * pin.Quaternion(math.cos(angle / 2), x, y, z)).coeffs()
    return np.asarray(result / np.linalg.norm(result))


def active(m: FilterMemory) -> int:
    """Rows of the covariance that are in use."""
    used = np.flatnonzero(m.owner >= 0)
    return MAIN + 3 * (int(used[-1]) + 1 if len(used) else 0)


def predict(m: FilterMemory) -> None:
    """Advance by the time of the tick."""
    if m.has_command[0]:
        _follow(m)
    if m.dt[0] <= 0.0:
        return
    step = min(m.dt[0], CONSTANTS.longest_step)
    spin, spin_up = part(m, Part.SPIN), part(m, Part.SPIN_UP)
    angle = step * spin + step * step / 2 * spin_up
    _predict_covariance(m, step, angle)
    _forget_unknown(m)
    m.turn[:] = turned(m.turn, angle)
    speed, acceleration = part(m, Part.SPEED), part(m, Part.ACCELERATION)
    part(m, Part.PLACE)[:] += step * speed + step * step / 2 * acceleration
    speed += step * acceleration
    spin += step * spin_up


def _follow(m: FilterMemory) -> None:
    commanded_W = rotation(m) @ m.commanded[:3]
    if m.guided[0]:
        _change(m, Part.SPEED, commanded_W - m.commanded_W)
    _change(m, Part.SPIN, m.commanded[3:6] - m.commanded_spin)
    m.commanded_W[:], m.commanded_spin[:] = commanded_W, m.commanded[3:6]


def _change(m: FilterMemory, which: Part, by: Array) -> None:
    part(m, which)[:] += by
    axes = range(which, which + 3)
    m.P[axes, axes] += response_variance(m, by)


def response_variance(m: FilterMemory, change: Array) -> Array:
    """Variances after a tick in which the asked velocities made a change (n,) [m/s, rad/s]: the faster, the less they follow.

    That of an error with the time constant of the response and a standard deviation in proportion to the asked acceleration:
    a share of a step, however it is divided into ticks.
    """
    return np.asarray((m.drive[ProcessNoise.REPLY] * change) ** 2 / m.dt[0]) if m.dt[0] > 0.0 else np.zeros(len(change))


def _predict_covariance(m: FilterMemory, step: float, angle: Array) -> None:
    n, F, J = active(m), np.eye(MAIN), np.asarray(pin.Jexp3(angle))
    turn, place, speed, acceleration, spin, spin_up = (slice(i, i + 3) for i in range(0, 18, 3))
    F[turn, turn], F[turn, spin], F[turn, spin_up] = pin.exp3(-angle), step * J, step * step / 2 * J
    F[place, speed], F[place, acceleration] = step * np.eye(3), step * step / 2 * np.eye(3)
    F[speed, acceleration] = F[spin, spin_up] = step * np.eye(3)
    P = m.P[:n, :n]
    P[:MAIN, MAIN:] = F @ P[:MAIN, MAIN:]
    P[MAIN:, :MAIN] = P[:MAIN, MAIN:].T
    main = F @ P[:MAIN, :MAIN] @ F.T + _diffusion(m, J)
    P[:MAIN, :MAIN] = (main + main.T) / 2


def _diffusion(m: FilterMemory, J: Array) -> Array:
    """Covariance (MAIN, MAIN) that the driving noise adds in a tick; J (3, 3) turns it with the vehicle."""
    dt, Q = float(m.dt[0]), np.zeros((MAIN, MAIN))
    third = _thrice_integrated(dt)
    jerk, spin = m.drive[ProcessNoise.JERK] ** 2, m.drive[ProcessNoise.ANGULAR_JERK] ** 2
    Q[3:12, 3:12] = jerk * np.kron(third, np.eye(3))
    turns = (slice(0, 3), slice(12, 15), slice(15, 18))
    maps = (J, np.eye(3), np.eye(3))
    for i, (rows, left) in enumerate(zip(turns, maps, strict=True)):
        for j, (columns, right) in enumerate(zip(turns, maps, strict=True)):
            Q[rows, columns] = spin * third[i, j] * left @ right.T
    for first, noise in (
        (Part.GYRO_BIAS, ProcessNoise.GYRO),
        (Part.DVL_BIAS, ProcessNoise.DVL),
        (Part.FORCE_BIAS, ProcessNoise.FORCE),
    ):
        Q[range(first, first + 3), range(first, first + 3)] = dt * m.drive[noise] ** 2
    Q[Part.FLOOR, Part.FLOOR] = dt * _relief(m)
    return Q


def _thrice_integrated(dt: float) -> Array:
    """Covariance (3, 3) of a value and its two derivatives after dt [s] of white noise of the third."""
    dt2 = dt * dt
    off = dt2 * dt / 6
    return np.array(
        [
            [dt2 * dt2 * dt / 20, dt2 * dt2 / 8, off],
            [dt2 * dt2 / 8, dt2 * dt / 3, dt2 / 2],
            [off, dt2 / 2, dt],
        ]
    )


def _relief(m: FilterMemory) -> float:
    """Variance [m2/s] of the floor that passes below the altimeter."""
    velocity = part(m, Part.SPEED) + rotation(m) @ np.cross(part(m, Part.SPIN), m.beam_at)
    roughness = m.drive[ProcessNoise.ROUGHNESS] ** 2 * (velocity[0] ** 2 + velocity[1] ** 2)
    return float(m.drive[ProcessNoise.SETTLING] ** 2 + roughness)


def _forget_unknown(m: FilterMemory) -> None:
    """Bound variances by `limit`: no growth beyond it, and no correlation if a reading can set the part."""
    n, no_turn = active(m), not np.isfinite(m.turn).all()
    lost = np.concatenate([np.full(3, no_turn), ~np.isfinite(m.x)])
    for i in np.flatnonzero(lost | ~are_determined(np.diag(m.P)[:MAIN], m.limit**2)):
        carried = Part.SPEED <= i < Part.FLOOR and not lost[i] and 0.0 < m.P[i, i] < math.inf
        (_limit_to if carried else clear)(m, int(i), n, float(m.limit[i]) ** 2)
        if i >= Part.PLACE and (lost[i] or _FORGOTTEN.start <= i < _FORGOTTEN.stop):
            m.x[i - Part.PLACE] = 0.0
    if no_turn:
        m.turn[:] = 0.0, 0.0, 0.0, 1.0


def are_determined(variance: Array, most: Array | float) -> Mask:
    """Return whether each variance (n,) [square of a unit] is within `most` (n,) or () [the same]; below zero it is rounding."""
    return np.asarray((variance >= 0.0) & (variance <= most))


def _limit_to(m: FilterMemory, i: int, n: int, variance: float) -> None:
    """Less doubt and no less correlation: clones whose readings are on their way still tell of entry i."""
    share = math.sqrt(variance / float(m.P[i, i]))
    m.P[i, :n] *= share
    m.P[:n, i] *= share
    m.P[i, i] = variance


def clear(m: FilterMemory, i: int, n: int, variance: float) -> None:
    """Take entry i out of all correlations among the first n and give it a variance [square of its unit]."""
    m.P[i, :n] = 0.0
    m.P[:n, i] = 0.0
    m.P[i, i] = variance


def is_unknown(m: FilterMemory, first: int, n: int) -> bool:
    """Return whether any of n entries of the error state is."""
    entries = slice(first, first + n)
    return bool((np.diag(m.P)[entries] > CONSTANTS.unknown * m.limit[entries] ** 2).any())


def inflate_velocity_variance(m: FilterMemory, *, rests: bool) -> None:
    """Linear velocity and acceleration may be anything that vehicles do. Rare, and so in NumPy for both cores.

    rests: they are taken for zero from here on, as what was carried on without readings leads ever farther astray.
    """
    m.owner[:] = -1.0
    if rests:
        part(m, Part.SPEED)[:] = part(m, Part.ACCELERATION)[:] = 0.0
    for first in (Part.SPEED, Part.ACCELERATION):
        axes = np.arange(first, first + 3)
        m.P[axes, axes] += CONSTANTS.exposed**2


# What each channel of the vehicle sees of the estimate, in NumPy: what sights.c does; keep both in step.


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PredictedMeasurement:
    """Predicted measurement of a channel, now or at the time of a clone."""

    h: Array
    """(4,) [unit of the channel]; of the altimeter altitude and cosine of the tilt."""
    rate: Array
    """(3,) its rate [per s]."""
    rate_variance: float
    """[square of its unit] variance of the rate."""
    HP: Array
    """(rows, n) [SI] covariance with all errors."""
    S: Array
    """(rows, rows) [SI] its own."""

    def factor(self, more: float) -> Array:
        """(rows, rows) lower factor of S with `more` [square of its unit] on the diagonal: no pivot is less but by rounding."""
        L = np.zeros(self.S.shape)
        for j in range(len(L)):
            column = self.S[j:, j] - L[j:, :j] @ L[j, :j]
            pivot = column[0] + more
            L[j, j] = math.sqrt(more if pivot < more else pivot)
            L[j + 1 :, j] = column[1:] / L[j, j]
        return L


def predict_measurement(m: FilterMemory, c: ChannelIndex) -> PredictedMeasurement:
    """Predict the measurement of channel c now."""
    h, H, rate, rate_variance = _MODELS[c](m)
    HP = H @ m.P[:MAIN, : active(m)]
    return PredictedMeasurement(
        h=np.resize(h, 4), rate=np.resize(rate, 3), rate_variance=rate_variance, HP=HP, S=HP[:, :MAIN] @ H.T
    )


_View = tuple[Array, Array, Array, float]


def _rows(n: int, *blocks: tuple[int, Array]) -> Array:
    H = np.zeros((n, MAIN))
    for at, block in blocks:
        H[:, at : at + block.shape[1]] = block
    return H


def mean_variance(m: FilterMemory, first: int) -> float:
    """Mean variance of three entries of the error state."""
    return float((m.P[first, first] + m.P[first + 1, first + 1] + m.P[first + 2, first + 2]) / 3)


def _predict_attitude(m: FilterMemory) -> _View:
    return m.turn.copy(), _rows(3, (Part.TURN, np.eye(3))), part(m, Part.SPIN).copy(), mean_variance(m, Part.SPIN)


def _predict_angular_velocity(m: FilterMemory) -> _View:
    h = part(m, Part.SPIN) + part(m, Part.GYRO_BIAS)
    H = _rows(3, (Part.SPIN, np.eye(3)), (Part.GYRO_BIAS, np.eye(3)))
    return h, H, part(m, Part.SPIN_UP).copy(), mean_variance(m, Part.SPIN_UP)


def _predict_position(m: FilterMemory) -> _View:
    H = _rows(3, (Part.PLACE, np.eye(3)))
    return part(m, Part.PLACE).copy(), H, part(m, Part.SPEED).copy(), mean_variance(m, Part.SPEED)


def _predict_depth(m: FilterMemory) -> _View:
    H, z = _rows(1, (Part.PLACE + 2, np.eye(1))), Part.SPEED + 2
    return part(m, Part.PLACE)[2:].copy(), H, part(m, Part.SPEED)[2:].copy(), float(m.P[z, z])


def _predict_velocity(m: FilterMemory) -> _View:
    R, spin = rotation(m), part(m, Part.SPIN)
    v_B = R.T @ part(m, Part.SPEED)
    rate = R.T @ part(m, Part.ACCELERATION) - np.cross(spin, v_B)
    H = _rows(3, (Part.TURN, pin.skew(v_B)), (Part.SPEED, R.T), (Part.DVL_BIAS, np.eye(3)))
    return v_B + part(m, Part.DVL_BIAS), H, rate, mean_variance(m, Part.ACCELERATION)


def _predict_specific_force(m: FilterMemory) -> _View:
    R, spin = rotation(m), part(m, Part.SPIN)
    force = R.T @ (part(m, Part.ACCELERATION) - m.gravity)
    H = _rows(3, (Part.TURN, pin.skew(force)), (Part.ACCELERATION, R.T), (Part.FORCE_BIAS, np.eye(3)))
    return (
        force + part(m, Part.FORCE_BIAS),
        H,
        -np.cross(spin, force),
        mean_variance(m, Part.SPIN) * float(force @ force),
    )


def _predict_altitude(m: FilterMemory) -> _View:
    down = rotation(m)[2]
    cosine = down @ m.beam_up
    altitude = part(m, Part.PLACE)[2] + down @ m.beam_at - m.x[Part.FLOOR - Part.PLACE]
    tilt = altitude / cosine * np.cross(m.beam_up, down) if abs(cosine) > CONSTANTS.steep else np.zeros(3)
    by_turn = np.cross(m.beam_at, down) - tilt
    H = _rows(1, (Part.TURN, by_turn[None]), (Part.PLACE + 2, np.eye(1)), (Part.FLOOR, -np.eye(1)))
    z = Part.SPEED + 2
    return np.array([altitude, cosine]), H, part(m, Part.SPEED)[2:].copy(), float(m.P[z, z])


_MODELS = {
    ChannelIndex.ATTITUDE: _predict_attitude,
    ChannelIndex.ANGULAR_VELOCITY: _predict_angular_velocity,
    ChannelIndex.POSITION: _predict_position,
    ChannelIndex.DEPTH: _predict_depth,
    ChannelIndex.LINEAR_VELOCITY: _predict_velocity,
    ChannelIndex.SPECIFIC_FORCE: _predict_specific_force,
    ChannelIndex.ALTIMETER_RANGE: _predict_altitude,
}


def second_derivative(m: FilterMemory, c: ChannelIndex) -> Array:
    """(3,) second derivative of what a channel that sets a part sees; its first entry alone for one row."""
    if c == ChannelIndex.ATTITUDE:
        return part(m, Part.SPIN_UP).copy()
    acceleration = part(m, Part.ACCELERATION)
    return acceleration.copy() if ROWS[c] == 3 else np.repeat(acceleration[2], 3)


def process_variance(m: FilterMemory, c: ChannelIndex, sight: PredictedMeasurement, age: float) -> float:
    """Variance of the way since a reading of that age [s]."""
    turns = c == ChannelIndex.ATTITUDE
    drive = m.drive[ProcessNoise.ANGULAR_JERK if turns else ProcessNoise.JERK]
    second = mean_variance(m, Part.SPIN_UP if turns else Part.ACCELERATION)
    squared = age * age
    return float(
        squared * sight.rate_variance + squared * squared / 4 * second + drive * drive * squared * squared * age / 20
    )
