"""Measure how well two series of a recording agree: in time, in size and in their axes.

Rates of poses and measured velocities are such series. Axes are compared by the share of one series
that the other explains; clocks and units by magnitudes, which have no axes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

WINDOW = 0.6
"""[s] over which rates are taken."""
DEAD = 1e-5
"""[unit of the channel] range within which a sensor that measures anything does not stay."""
MOVES = {"linear_velocity": 0.01, "angular_velocity": 0.01, "specific_force": 0.5}
"""[m/s, rad/s, m/s2] standard deviation from which on a channel moves; of an acceleration, by
gravity in a tilting frame.
"""
_SIGNS = tuple(product((1.0, -1.0), repeat=3))


def _ways() -> Iterator[np.ndarray]:
    """Yield all signed permutation matrices (3, 3)."""
    for axes, signs in product(permutations(range(3)), _SIGNS):
        yield np.diag(signs) @ np.eye(3)[[*axes]]


WAYS = tuple(_ways())
"""(3, 3) each: all 48 ways to swap axes and turn their signs."""

_SHIFTS = 0.05 * np.arange(-30, 31)  # [s] offsets of clocks that are tried
_LARGEST_SHIFT = 1.5  # [s] largest of `_SHIFTS`
_MIN_SAMPLES = 20  # least samples in each half of a series that tell an offset
_NOTABLE_DELAY = 0.175  # [s] least offset that is reported
_JUMP = 0.3  # [s] least difference between the offsets of both halves that is a jump of a clock
_AGREES = 0.6  # least correlation of two magnitudes that agree
_FAR_AGREES = 0.85  # least correlation at an offset that is far from any usual one
_FAR_BETTER = 0.15  # such a correlation must be higher than any at a usual offset by this
_BETTER = 0.01  # correlation by which an offset must be better than another
_LIKE_REPEATED = 0.1  # by sizes over all samples, below the best, of offsets that are looked at
_MOST_PEAKS = 20  # such offsets, the smallest
_MOST_NAMED = 2  # other offsets that are named
_PARTED = 0.2  # correlation by which two halves must disagree
_SCALE = 1.9  # factor from which on it is one of units: the smallest of these is that of knots
_CLOSE = 1.25  # factor by which an observed one may differ from that of a unit
_UNITS = {
    180.0 / np.pi: ("deg/s", "deg"),
    1e3: ("mm/s", "mm"),
    1e2: ("cm/s", "cm"),
    1.0 / 0.514444: ("kn", ""),
}
"""Units of a rate and of a pose, by the factor by which they make numbers larger."""


def explained(measured: np.ndarray, expected: np.ndarray) -> float:
    """Compute the share of the squares of expected (m, 3) [any] that measured (m, 3) [any] has."""
    return 1.0 - float(((measured - expected) ** 2).sum() / (expected**2).sum())


def correlation(x: np.ndarray, y: np.ndarray) -> float:
    """Correlate two series x (m,) [any] and y (m,) [any], from -1 to 1; 0 where either is
    constant.
    """
    x = x - x.mean()
    y = y - y.mean()
    return float(x @ y / max(np.linalg.norm(x) * np.linalg.norm(y), 1e-300))


def named(Q: np.ndarray) -> str:
    """Name the axes as Q (3, 3) of `WAYS` turns them, such as (y, -x, z)."""
    names = []
    for row in Q:
        sign = "-" if row.sum() < 0 else ""
        names.append(sign + "xyz"[int(np.argmax(np.abs(row)))])
    return f"({', '.join(names)})"


def describe_factor(expected: np.ndarray, measured: np.ndarray) -> str:
    """Describe how much larger measured (m, k) [any] is than expected (m, k) [any], and the unit
    that would explain it; empty where they may be equal.

    Whatever part of either is noise, the factor lies between the slopes of their magnitudes upon
    each other.
    """
    x = np.linalg.norm(expected, axis=1)
    y = np.linalg.norm(measured, axis=1)
    low, high = _slopes(x - x.mean(), y - y.mean())
    if low < _SCALE and high > 1 / _SCALE:
        return ""
    factor = float(np.sqrt(low * high))
    cause = next(_units_of(factor), "its units?")
    return f"{factor:.2g} times the rate of the {{}}: {cause}"


def _slopes(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Compute the slope of y upon x, and the slope that x upon y implies; 0 and infinity where the
    two have nothing in common.
    """
    if correlation(x, y) < _AGREES:
        return 0.0, np.inf
    common = float(x @ y)
    return common / float(x @ x), float(y @ y) / common


def _units_of(factor: float) -> Iterator[str]:
    """Yield the units that would explain a factor, of the rate or of the pose."""
    for unit_factor, (rate_unit, pose_unit) in _UNITS.items():
        if 1 / _CLOSE < factor / unit_factor < _CLOSE:
            yield f"in {rate_unit}?"
        if pose_unit and 1 / _CLOSE < factor * unit_factor < _CLOSE:
            yield f"is the other in {pose_unit}?"


@dataclass(frozen=True, kw_only=True, slots=True)
class Offset:
    """Offset of one series against another."""

    delay: float = 0.0
    """[s] by which it comes after the other; 0 where they do not agree."""
    is_constant: bool = True
    """True if both halves of the time have that offset."""
    others: tuple[float, ...] = ()
    """[s] offsets that are as good, of a motion that repeats, the smallest first."""


def describe_delay(found: Offset) -> str:
    """Describe by how much a channel is late, against the rate of another; empty where it is little."""
    if abs(found.delay) <= _NOTABLE_DELAY:
        return ""
    text = f"{_named_delay(found.delay)} against the rate of the {{}}"
    if not found.others:
        return text
    others = [_named_delay(delay) for delay in found.others[:_MOST_NAMED]]
    n_hidden = len(found.others) - len(others)
    if n_hidden:
        others.append(f"{n_hidden} others")
    return f"{text}, or {' or '.join(others)}: the motion repeats"


def _named_delay(delay: float) -> str:
    """Write a delay [s] as late or early."""
    return f"{abs(delay):.2f} s {'late' if delay > 0 else 'early'}"


def offset(
    t: np.ndarray, expected: np.ndarray, t_measured: np.ndarray, measured: np.ndarray
) -> Offset:
    """Find by how much [s] measured comes after expected, and offsets that are as good.

    expected: (m, k) [any] at t (m,) [s]. measured: (n, k) [any] at t_measured (n,) [s]. Magnitudes are
    compared, which have no axes; an offset that is far from any usual one also by components, whose
    axes may be the right ones: magnitudes of swings repeat. Components that agree in other axes at a usual
    offset are no far ones: a mirrored swing is one of half a period later.
    """
    after_begin = t > t_measured[0] + _LARGEST_SHIFT
    before_end = t < t_measured[-1] - _LARGEST_SHIFT
    inside = np.flatnonzero(after_begin & before_end)
    if len(inside) < 2 * _MIN_SAMPLES:
        return Offset()
    expected_size = np.linalg.norm(expected, axis=1)[:, None]
    measured_size = np.linalg.norm(measured, axis=1)[:, None]
    for x, y in ((expected, measured), (expected_size, measured_size)):
        near = _agreements(t[inside], x[inside], t_measured, y)
        rises_outwards = near.argmax() in (0, len(_SHIFTS) - 1)
        surplus = _BETTER if rises_outwards else _FAR_BETTER
        min_agreement = max(_FAR_AGREES, near.max() + surplus)
        far = _far_offset(t, x, _interpolated(t, t_measured, y), min_agreement)
        if far is not None:
            return Offset(delay=far)
    # The last of these are the magnitudes.
    halves = []
    for half in np.array_split(inside, 2):
        halves.append(_agreements(t[half], expected_size[half], t_measured, measured_size))
    delay = float(_SHIFTS[_best(near)])
    if _differ(*halves):
        return Offset(delay=delay, is_constant=False)
    if abs(delay) <= _NOTABLE_DELAY:
        return Offset(delay=delay)
    measured_at_t = _interpolated(t, t_measured, measured)
    delays = _repeated_offsets(t, expected, measured_at_t, delay)
    return Offset(delay=delays[0], others=tuple(delays[1:]))


def _repeated_offsets(
    t: np.ndarray, expected: np.ndarray, measured: np.ndarray, delay: float
) -> list[float]:
    """List the offsets [s] at which the magnitudes of measured (n, k) [any] and expected (n, k) [any], at
    uniform t (n,) [s], agree as well as at a delay [s], as far as half of the time is in common, the
    smallest first; of these only such as components agree at in their axes, if there are any.
    """
    expected_size = np.linalg.norm(expected, axis=1)[:, None]
    measured_size = np.linalg.norm(measured, axis=1)[:, None]
    step = float(t[1] - t[0])
    lags, shares = _shares_of_lags(expected_size, measured_size)
    order = np.argsort(lags)
    lags = lags[order]
    shares = shares[order]
    is_peak = np.r_[False, (shares[1:-1] >= shares[:-2]) & (shares[1:-1] > shares[2:]), False]
    good_enough = float(shares[np.abs(lags * step - delay) < 2.0 * step].max()) - _LIKE_REPEATED
    peaks = lags[is_peak & (shares > good_enough)]
    nearest = peaks[np.argsort(np.abs(peaks))][:_MOST_PEAKS]
    found = round(delay / step)
    least = _agreement_at_lag(expected_size, measured_size, found) - _BETTER
    repeated = [found]
    for lag in nearest.tolist():
        is_other = abs(lag - found) * step > _NOTABLE_DELAY
        if is_other and _agreement_at_lag(expected_size, measured_size, lag) > least:
            repeated.append(lag)
    agreements = np.array([_agreement_at_lag(expected, measured, lag) for lag in repeated])
    if agreements.max() > _AGREES:
        in_their_axes = agreements > agreements.max() - _BETTER
        repeated = [lag for lag, is_good in zip(repeated, in_their_axes, strict=True) if is_good]
    return sorted((lag * step for lag in repeated), key=abs)


def _agreements(
    t: np.ndarray, expected: np.ndarray, t_measured: np.ndarray, measured: np.ndarray
) -> np.ndarray:
    """Correlate expected (m, k) at t (m,) [s] with measured (n, k) at t_measured (n,) [s], at each shift
    in `_SHIFTS`, in the axes in which they agree best; of one column, as they are.
    """
    by_shift = np.empty(len(_SHIFTS))
    for k, shift in enumerate(_SHIFTS):
        shifted = _interpolated(t + shift, t_measured, measured)
        if expected.shape[1] == 1:
            by_shift[k] = _column_correlation(expected, shifted)
        else:
            by_shift[k] = _turned_correlation(expected, shifted)
    return by_shift


def _interpolated(t: np.ndarray, t_measured: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """Interpolate measured (n, k) at t_measured (n,) [s] to t (m,) [s]."""
    return np.column_stack([np.interp(t, t_measured, column) for column in measured.T])


def _column_correlation(x: np.ndarray, y: np.ndarray) -> float:
    """Correlate all columns of x (m, k) and y (m, k) together, each about its mean, from -1 to 1."""
    x = x - x.mean(axis=0)
    y = y - y.mean(axis=0)
    return float((x * y).sum() / max(np.linalg.norm(x) * np.linalg.norm(y), 1e-300))


def _turned_correlation(x: np.ndarray, y: np.ndarray) -> float:
    """Correlate x (m, k) and y (m, k), each about its mean, in the axes of y, turned or mirrored, in which
    they agree best (orthogonal Procrustes), from 0 to 1.
    """
    x = x - x.mean(axis=0)
    y = y - y.mean(axis=0)
    singular_values = np.linalg.svd(x.T @ y, compute_uv=False)
    return float(singular_values.sum() / max(np.linalg.norm(x) * np.linalg.norm(y), 1e-300))


def _far_offset(
    t: np.ndarray, expected: np.ndarray, measured: np.ndarray, min_agreement: float
) -> float | None:
    """Find by how much [s] measured (m, k) [any] comes after expected (m, k) [any], at uniform t (m,)
    [s], as far as half of the time is in common; `None` unless one offset alone agrees, by a
    correlation of `min_agreement` at least.
    """
    lags, shares = _shares_of_lags(expected, measured)
    step = float(t[1] - t[0])
    best = int(lags[np.argmax(shares)])
    is_elsewhere = np.abs(lags - best) * step > 2.0 * _LARGEST_SHIFT
    if not is_elsewhere.any():
        return None
    agreement = _agreement_at_lag(expected, measured, best)
    is_alone = shares[is_elsewhere].max() < agreement - _FAR_BETTER
    if agreement < min_agreement or not is_alone or abs(best) * step <= _LARGEST_SHIFT:
        return None
    return best * step


def _shares_of_lags(expected: np.ndarray, measured: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Correlate uniform samples of expected (n, k) with those of measured (n, k) that many samples later,
    as far as half of them are in common: lags (n,) and correlations (n,) by sizes over all samples.
    """
    n = len(expected)
    x = expected - expected.mean(axis=0)
    y = measured - measured.mean(axis=0)
    size = 1 << (2 * n - 1).bit_length()
    spectra = np.fft.rfft(y, size, axis=0) * np.fft.rfft(x, size, axis=0).conj()
    products = np.fft.irfft(spectra.sum(axis=1), size)
    lags = np.r_[0 : n // 2, -(n // 2) : 0]
    in_common = n - np.abs(lags)
    scale = n / max(float(np.linalg.norm(x) * np.linalg.norm(y)), 1e-300)
    return lags, products[lags] / in_common * scale


def _agreement_at_lag(expected: np.ndarray, measured: np.ndarray, lag: int) -> float:
    """Correlate uniform samples of expected (n, k) with those of measured (n, k) a lag of samples later."""
    n = len(expected)
    first = slice(max(0, -lag), n - max(0, lag))
    second = slice(max(0, lag), n - max(0, -lag))
    return _column_correlation(expected[first], measured[second])


def _best(agreement: np.ndarray) -> int:
    """Find the index of the best agreement; the nearest of those that swings repeat a period later,
    and no offset where that is as good.
    """
    middle = len(_SHIFTS) // 2
    if agreement.max() < max(_AGREES, agreement[middle] + _BETTER):
        return middle
    is_peak = (agreement >= np.roll(agreement, 1)) & (agreement >= np.roll(agreement, -1))
    peaks = np.flatnonzero(is_peak)
    good = peaks[agreement[peaks] > agreement.max() - _BETTER]
    return int(good[np.argmin(np.abs(_SHIFTS[good]))])


def _differ(first: np.ndarray, second: np.ndarray) -> bool:
    """Check whether either agreement is good at an offset at which the other is not."""
    best_of_first = _best(first)
    best_of_second = _best(second)
    loss_of_first = first[best_of_first] - first[best_of_second]
    loss_of_second = second[best_of_second] - second[best_of_first]
    jump = abs(_SHIFTS[best_of_first] - _SHIFTS[best_of_second])
    return bool(min(loss_of_first, loss_of_second) > _PARTED and jump > _JUMP)
