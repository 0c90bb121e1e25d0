"""Check that channels are of the same motion at all: what one says of it must explain some of what its
partner says, over short and long periods, with the clocks as they are.

A channel of another run, of another vehicle or of a clock that nothing ties to the others agrees by
chance alone. Noise of either channel is estimated from its own samples: what does not move beyond it
is not judged.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from uvms_ocp.identification.recording import Channel, Recording
from uvms_ocp.identification.resampling import (
    GRID,
    angular_rate,
    interpolated,
    rotations,
    smoothed,
)
from uvms_ocp.identification.series_agreement import WINDOW, explained

_PERIODS = (1.0, 4.0)  # [s] over which motions are compared
_STRIDE = 0.25  # [s] between the beginnings of two periods
_MIN_PERIODS = 10  # one after the other, from which on agreement is no chance
_FOREIGN = 0.25
"""Share of a motion below which another one explains no more of it than chance does."""
_OF_SAMPLES = 5  # whose median stands for a position
_OUTLIER = 4.0  # median motions beyond which one does not count
_MIN_USUAL = 0.9  # share of motions that are no outliers, below which nothing is judged
_BEYOND_NOISE = 5.0  # standard deviations of noise that a motion must be beyond
_OF_MEDIAN = 1.2  # standard deviation by the root of the median square, of three normal numbers
_MIN_DISTANCE = 0.05  # [m] standard deviation of displacements that are compared
_MIN_ANGLE = 0.05  # [rad] standard deviation of turns that are compared
_MIN_TILT = 1.0  # [m/s2] standard deviation of gravity in B that is compared
_G = 9.81  # [m/s2]


def of_shared_motion(recording: Recording) -> Iterator[tuple[str, str]]:
    """Yield channels that do not move as their partners do."""
    channels = recording.channels
    attitude = channels.get("attitude")
    if attitude is None:
        return
    if "angular_velocity" in channels:
        share = _of_turning(attitude, channels["angular_velocity"])
        if share is not None and share < _FOREIGN:
            yield "angular_velocity", _text("turn as the attitude does", share)
    if "linear_velocity" in channels and "position" in channels:
        share = _of_travel(recording)
        if share is not None and share < _FOREIGN:
            yield "linear_velocity", _text("move as the position does", share)
    if "specific_force" in channels:
        share = _of_tilt(attitude, channels["specific_force"])
        if share is not None and share < _FOREIGN:
            yield "specific_force", _text("tilt as the attitude does", share)


def _text(motion: str, share: float) -> str:
    return (
        f"does not {motion}: at best {100 * max(share, 0.0):.0f} % of one is explained by the other;"
        " of another run, vehicle or clock?"
    )


def _of_turning(attitude: Channel, gyro: Channel) -> float | None:
    """Compute the share of the turns of an attitude that a gyro explains; `None` where it cannot be
    judged.
    """
    t, by_attitude = angular_rate(attitude, WINDOW)
    t_gyro, rates = smoothed(gyro.undelayed_t, gyro.values, WINDOW)
    inside = (t > t_gyro[0] + WINDOW) & (t < t_gyro[-1] - WINDOW)
    if not inside.any():
        return None
    noise = 2.0 * _noise(attitude.values)  # a quaternion changes by half an angle
    return _best_share(
        by_attitude[inside],
        interpolated(t[inside], t_gyro, rates),
        max(_MIN_ANGLE, _BEYOND_NOISE * np.sqrt(2.0) * noise),
        _BEYOND_NOISE * _noise(gyro.values) * np.sqrt(1.0 / gyro.rate),
    )


def _of_travel(recording: Recording) -> float | None:
    """Compute the share of the displacements of a position that a velocity explains; `None` where it
    cannot be judged.
    """
    position = recording.channels["position"]
    velocity = recording.channels["linear_velocity"]
    attitude = recording.channels["attitude"]
    places = _without_outliers(position.values)
    t, rate = smoothed(position.undelayed_t, places, WINDOW, derivative=1)
    t_velocity, values = smoothed(velocity.undelayed_t, velocity.values, WINDOW)
    begin = max(t_velocity[0], attitude.undelayed_t[0]) + WINDOW
    end = min(t_velocity[-1], attitude.undelayed_t[-1]) - WINDOW
    inside = (t > begin) & (t < end)
    if not inside.any():
        return None
    t = t[inside]
    in_body = interpolated(t, t_velocity, values)
    in_world = np.einsum("nij,nj->ni", rotations(attitude, t), in_body)
    return _best_share(
        rate[inside],
        in_world,
        max(_MIN_DISTANCE, _BEYOND_NOISE * np.sqrt(2.0) * _noise(position.values)),
        _BEYOND_NOISE * _noise(velocity.values) * np.sqrt(1.0 / velocity.rate),
    )


def _of_tilt(attitude: Channel, force: Channel) -> float | None:
    """Compute the share of gravity in B, by an attitude, that an accelerometer explains; `None` where
    it cannot be judged.

    In swell it feels accelerations too. They change the size of what it feels: tilts are compared
    where gravity in B moves by more than the accelerations that this size leaves room for.
    """
    t, felt = smoothed(force.undelayed_t, force.values, WINDOW)
    inside = (t > attitude.undelayed_t[0]) & (t < attitude.undelayed_t[-1])
    if not inside.any():
        return None
    up = _G * rotations(attitude, t[inside])[:, 2]
    min_tilt = max(_MIN_TILT, _largest_acceleration(felt[inside]))
    shares = []
    for period in _PERIODS:
        expected = _means(up, period)
        measured = _means(felt[inside], period)
        if expected is None or measured is None:
            continue
        expected = expected - expected.mean(axis=0)
        measured = measured - measured.mean(axis=0)
        moves_expected = np.sqrt((expected**2).sum(axis=1).mean())
        moves_measured = np.sqrt((measured**2).sum(axis=1).mean())
        if moves_expected > min_tilt and moves_measured > _MIN_TILT:
            shares.append(_share(measured, expected))
    return max(shares, default=None)


def _largest_acceleration(felt: np.ndarray) -> float:
    """Bound the root mean square of accelerations [m/s2] by specific forces (n, 3) [m/s2]: one across
    gravity changes their size least, by its square over twice gravity.
    """
    deviations = np.linalg.norm(felt, axis=1) - _G
    return float(np.sqrt(2.0 * _G * np.sqrt((deviations**2).mean())))


def _best_share(
    expected: np.ndarray, measured: np.ndarray, min_motion: float, noise_density: float
) -> float | None:
    """Compute the largest share of the motion by expected (m, 3) [any/s] that measured (m, 3) [any/s]
    explains over periods; `None` where neither moves enough.

    min_motion: [any] standard deviation of the motion over a period from which on it is judged;
    noise_density: [any/sqrt(s)] noise of the integral of measured, times its margin.
    """
    shares = []
    for period in _PERIODS:
        means = (_means(expected, period), _means(measured, period))
        if means[0] is None or means[1] is None:
            continue
        by_expected = period * (means[0] - means[0].mean(axis=0))
        by_measured = period * (means[1] - means[1].mean(axis=0))
        is_usual = _are_usual(by_expected) & _are_usual(by_measured)
        if is_usual.mean() < _MIN_USUAL:
            continue
        by_expected = by_expected[is_usual]
        by_measured = by_measured[is_usual]
        moves_expected = np.sqrt((by_expected**2).sum(axis=1).mean())
        moves_measured = np.sqrt((by_measured**2).sum(axis=1).mean())
        min_measured = max(min_motion, noise_density * np.sqrt(period))
        if moves_expected > min_motion and moves_measured > min_measured:
            shares.append(_share(by_measured, by_expected))
    return max(shares, default=None)


def _means(rates: np.ndarray, period: float) -> np.ndarray | None:
    """Compute means (n, 3) of uniform samples (m, 3) over periods [s]; `None` where there are few."""
    length = round(period / GRID)
    if len(rates) < _MIN_PERIODS * length:
        return None
    total = np.vstack([np.zeros(rates.shape[1]), np.cumsum(rates, axis=0)])
    first = np.arange(0, len(rates) - length, round(_STRIDE / GRID))
    return np.asarray((total[first + length] - total[first]) / length)


def _without_outliers(values: np.ndarray) -> np.ndarray:
    """Take medians of five samples of each column (n, k)."""
    from scipy.signal import medfilt

    return np.column_stack([medfilt(column, _OF_SAMPLES) for column in values.T])


def _are_usual(motions: np.ndarray) -> np.ndarray:
    """Choose motions (n, 3) that are no outliers."""
    sizes = np.linalg.norm(motions, axis=1)
    return np.asarray(sizes <= _OUTLIER * np.median(sizes))


def _share(measured: np.ndarray, expected: np.ndarray) -> float:
    """Compute the share of expected (n, 3) that measured (n, 3), at its best scale, explains."""
    factor = float((measured * expected).sum() / (measured**2).sum())
    return explained(factor * measured, expected)


def _noise(values: np.ndarray) -> float:
    """Estimate the noise of samples (n, k) from the median of second differences, which single jumps
    do not change: too large where motion is fast.
    """
    curvature = values[2:] - 2.0 * values[1:-1] + values[:-2]
    return float(np.sqrt(np.median((curvature**2).sum(axis=1)) / 6.0)) * _OF_MEDIAN
