"""Tell series apart that alternate in one channel, by their samples: files that name no sender, as bags
of ROS 2, mix what is sent under one topic.

A sample belongs to the series whose last sample is nearest. Series that come so near to each other
that this is in doubt are not told apart.
"""

from __future__ import annotations

import numpy as np

_BEFORE = 6  # samples, or runs, back, among which is one of the same series
_MIN_JUMP = 4.0  # usual steps of one series from which on a step may lead to another
_MIN_DISTANCE = (
    6.0  # usual steps of one series from which on series are two: noise goes as far as 5
)
_USUAL = 90.0  # [%] of the samples that have a smaller step from one of the samples before
_RETURN = 0.25  # share of a jump within which it leads back to where a run before has ended
_MIN_SHARE_OF_RETURNS = 0.8  # of all jumps
_MIN_JUMPS = 10
_MIN_SHARE_OF_JUMPS = 0.02  # of all steps
_MIN_SAMPLES = 50
_NEW_SERIES = 0.5  # share of the distance of two series beyond which a sample begins another one
_MOST_SERIES = 8
_AMBIGUOUS = 0.5  # share of the distance to the second nearest series beyond which none is nearest
_MAX_AMBIGUOUS = 0.01  # share of the samples of which no series is nearest


def distance_of_series(values: np.ndarray) -> float | None:
    """Return the median distance [unit of the values] of the series between which samples (n, k) jump;
    `None` where they go on as one.

    A step is a jump where it is many times longer than usual ones. Samples from one jump to the next
    are a run; where series alternate, nearly every run begins near the end of one that was before.
    """
    if len(values) < _MIN_SAMPLES:
        return None
    distances = _distances_before(values, values)
    moved = distances[distances > 0.0]
    if not len(moved):
        return None
    usual = max(float(np.percentile(distances.min(axis=0), _USUAL)), float(moved.min()))
    steps = np.linalg.norm(np.diff(values, axis=0), axis=1)
    begins = np.flatnonzero(steps > _MIN_JUMP * usual) + 1
    if len(begins) < max(_MIN_JUMPS, _MIN_SHARE_OF_JUMPS * len(steps)):
        return None
    jumps = steps[begins - 1][_BEFORE:]
    nearest_ends = _distances_before(values[begins], values[begins - 1]).min(axis=0)
    returns = nearest_ends < _RETURN * jumps
    if returns.mean() < _MIN_SHARE_OF_RETURNS:
        return None
    distance = float(np.median(jumps[returns]))
    if distance < _MIN_DISTANCE * usual:
        return None
    return distance


def _distances_before(values: np.ndarray, earlier: np.ndarray) -> np.ndarray:
    """Compute the distances (`_BEFORE`, n - `_BEFORE`) of each of the values (n, k) but the first ones
    from those of the earlier values (n, k) that stand before it: the one before, the next one back,
    and so on.
    """
    n = len(values)
    distances = np.empty((_BEFORE, n - _BEFORE))
    for back in range(1, _BEFORE + 1):
        shifted = earlier[_BEFORE - back : n - back]
        distances[back - 1] = np.linalg.norm(values[_BEFORE:] - shifted, axis=1)
    return distances


def numbers_of_series(values: np.ndarray) -> np.ndarray | None:
    """Return the number (n,) of the series of each sample (n, k) [any], from 1, that of the first
    sample, in the order in which they begin.

    `None` where samples go on as one series, or where series are too near to each other, or too
    many, to be told apart.
    """
    distance = distance_of_series(values)
    if distance is None:
        return None
    last_samples = [values[0]]
    numbers = np.ones(len(values), dtype=np.int64)
    n_ambiguous = 0
    for place in range(1, len(values)):
        distances = np.linalg.norm(np.array(last_samples) - values[place], axis=1)
        nearest = int(np.argmin(distances))
        if distances[nearest] > _NEW_SERIES * distance:
            nearest = len(last_samples)
            last_samples.append(values[place])
            if len(last_samples) > _MOST_SERIES:
                return None
        elif len(last_samples) > 1:
            second_nearest = float(np.partition(distances, 1)[1])
            n_ambiguous += distances[nearest] > _AMBIGUOUS * second_nearest
        last_samples[nearest] = values[place]
        numbers[place] = nearest + 1
    if n_ambiguous > _MAX_AMBIGUOUS * len(values):
        return None
    return numbers


def series_keys(values: np.ndarray) -> str:
    """Write the keys of a mapping that choose one of the series of samples (n, k) [any], such as
    ``series: 1 or series: 2``; empty where they are not told apart.
    """
    numbers = numbers_of_series(values)
    if numbers is None:
        return ""
    return " or ".join(f"series: {k}" for k in range(1, int(numbers.max()) + 1))
