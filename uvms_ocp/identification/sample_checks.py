"""Check the samples of single channels: their times, and values that no sensor and no vehicle has."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from uvms_ocp.identification.interleaved_series import series_keys
from uvms_ocp.identification.pressure_units import PRESSURE
from uvms_ocp.identification.recording import (
    CHANNEL_KINDS,
    SECONDS,
    Channel,
    Recording,
)
from uvms_ocp.identification.resampling import angular_rate, smoothed
from uvms_ocp.identification.series_agreement import DEAD, MOVES, WINDOW

_SHORTEST_RECORDING = 5.0  # [s] shortest time that all channels must have in common
_SPARSEST = 100.0  # largest mean interval of a channel, in its usual intervals

# Intervals between samples.
_SHORTEST = 1e-5  # [s] shortest interval of any sensor
_LIKELY = 0.05  # [s] interval of a usual sensor
_LONGEST = 5.0  # [s] longest interval of any sensor
_GAP = 8.0  # usual intervals that a gap is longer than
_BURST = 0.5  # share of the mean interval below which the usual one tells of messages held up
_OFTEN = 0.02  # share of all intervals from which on gaps, or pairs of samples, are no accident
_AT_ONCE = 0.05  # share of the usual interval within which a sample follows another at once
_REPORTED_REPEATS = 10  # one sample in so many with the time of another is reported
_SELDOM = ("current", *(name for name, kind in CHANNEL_KINDS.items() if kind.command))
"""Channels that may be recorded only when they change."""

# Values.
_FOR_LONG = 90.0  # [%] share of samples below a peak
_FAR = 3.0  # widths of the range of all others by which values are far off
_FARTHEST = {
    "position": 20.0,
    "linear_velocity": 5.0,
    "angular_velocity": 10.0,
    "specific_force": 100.0,
    "current": 5.0,
}
"""[unit of the channel] least distance of values that are far off."""
_RETURNS = 20  # times that a channel comes back to a value that stands for nothing, from which on it is one
_SPIKE = 10.0  # usual steps from which on a step is a jump
_AROUND = 5  # samples before and after a jump that tell whether it lasts
_RESET = 1.0  # [m] least jump that is said to be set anew: acoustic fixes wander by less
_RESET_STEPS = 20.0  # usual steps that such a jump is longer than
_AWAY_FROM_ZERO = {**MOVES, "position": _RESET}
"""[unit of the channel] usual size from which on a sample of zeros between others is a lost one."""
_MOST_RESETS = 20  # jumps; more of them are of another kind
_CLIPPED = 5  # samples at the end of a range, from which on it is the sensor's
_SATURATES = ("linear_velocity", "angular_velocity", "specific_force")
"""Channels of sensors with a range."""
_MIN_LEVELS = 20  # distinct values of a channel whose range is judged
_FASTEST_SWIM = 10.0  # [m/s]
_FASTEST_TURN = 4 * np.pi  # [rad/s]
_FASTEST = {
    "linear_velocity": (_FASTEST_SWIM, "mm/s, or cm/s"),
    "current": (_FASTEST_SWIM, "mm/s, or cm/s"),
    "angular_velocity": (_FASTEST_TURN, "deg/s"),
    "joint_velocities": (_FASTEST_TURN, "deg/s"),
    "joint_positions": (4 * np.pi, "deg"),
}
"""By channel: size [unit of the channel] that it does not have for long, and the unit that it would be
in.
"""

_COUNTED = "deg"
"""Unit of angles that encoders count instead."""
_PLAUSIBLE = 0.15  # share of the fastest below which the columns beside a fast one are sound
_DEGREE = np.pi / 180.0
_FACTORS = {"mm/s, or cm/s": 1e-3, "mm, or cm": 1e-3, "deg/s": _DEGREE, "deg": _DEGREE}
"""Factors from the first unit that each text names to m, m/s, rad or rad/s."""

# Commands.
_PULSES = (900.0, 2200.0)  # [us] widths
_NARROW = 0.1  # share of the size of commands within which no vehicle is driven throughout
_NARROW_OF_MANY = 0.5  # the same share for more than two thrusters, which do not all push one way
_BEYOND_ONE = 0.05  # by which a share of the largest command may exceed 1


def of_samples(recording: Recording) -> Iterator[tuple[str, str]]:
    """Yield channels and doubts about their samples."""
    begin, end = recording.span
    if end - begin < _SHORTEST_RECORDING:
        if end > begin:
            text = f"{end - begin:.3g} s are in all channels, which are too few to look at"
        else:
            text = "no time is in all channels"
        first_channel = next(iter(recording.channels))
        yield first_channel, f"{text}: other clocks, or other units of times, such as min?"
    checks = (_times, _dead, _lost, _far_off, _spikes, _saturated, _units, _no_force)
    for name, channel in recording.channels.items():
        for check in checks:
            for text in check(name, channel):
                yield name, text


def has_times(channel: Channel) -> bool:
    """Check whether the times of a channel are such that rates can be taken."""
    usual_interval = float(np.median(np.diff(channel.t)))
    span = channel.t[-1] - channel.t[0]
    longest_span = _SPARSEST * usual_interval * len(channel.t)
    return bool(_SHORTEST < usual_interval < _LONGEST and _SHORTEST_RECORDING < span < longest_span)


def of_poses(recording: Recording) -> Iterator[tuple[str, str]]:
    """Yield poses and doubts about their rates."""
    position = recording.channels.get("position")
    attitude = recording.channels.get("attitude")
    if position is not None and not any(_far_off("position", position)):
        is_pressure_in_z = position.values[:, 2].min() > PRESSURE
        places = position.values
        labels = CHANNEL_KINDS["position"].columns
        if is_pressure_in_z:
            places = places[:, :2]
            labels = ()
        _, rate = smoothed(position.undelayed_t, places, WINDOW, derivative=1)
        for text in (
            *_too_fast(rate, _FASTEST_SWIM, "m/s", "mm, or cm", labels),
            *_resets(position.undelayed_t, places),
        ):
            yield "position", text
    if attitude is not None:
        _, omega = angular_rate(attitude, WINDOW)
        for text in _too_fast(omega, _FASTEST_TURN, "rad/s", "deg, or of another format"):
            yield "attitude", text


def _resets(t: np.ndarray, places: np.ndarray) -> Iterator[str]:
    """Check for jumps of a position (n, k) [m] at t (n,) [s], after which it goes on where it has come
    to: an estimate that was set anew.

    A fix that is held over rows is one fix, with the time of its first row.
    """
    is_new = np.r_[True, (np.diff(places, axis=0) != 0.0).any(axis=1)]
    t = t[is_new]
    places = places[is_new]
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    if len(steps) < 2 * _AROUND:
        return
    usual = float(np.percentile(steps, _FOR_LONG))
    is_jump = (steps > max(_RESET, _RESET_STEPS * usual)) & (steps > _FASTEST_SWIM * np.diff(t))
    jumps = np.flatnonzero(is_jump)
    lasting = []
    for k in jumps:
        before = places[max(0, k + 1 - _AROUND) : k + 1]
        after = places[k + 1 : k + 1 + _AROUND]
        if min(len(before), len(after)) < _AROUND:
            continue
        if np.linalg.norm(np.median(after, axis=0) - np.median(before, axis=0)) > steps[k] / 2:
            lasting.append(k)
    if 0 < len(lasting) <= _MOST_RESETS:
        first = lasting[0]
        yield (
            f"jumps by {steps[first]:.3g} m at {t[first + 1]:.4g} s and goes on from there,"
            f" {len(lasting)} times in all: set anew? give recordings before and after"
        )


def _times(name: str, channel: Channel) -> Iterator[str]:
    """Check the clock of a channel, and the intervals between its samples."""
    if channel.back > 0.0:
        yield f"times go back by up to {channel.back:.3g} s in the file: a clock that was set?"
    if channel.repeated > len(channel.t) / _REPORTED_REPEATS:
        yield (
            f"{channel.repeated} samples had the time of another and are left out: times with too"
            " few digits?"
        )
    steps = np.diff(channel.t)
    usual_interval = float(np.median(steps))
    gaps = steps > max(_GAP * usual_interval, WINDOW / 2)
    share_of_pairs = _pairs(channel)
    is_regular = name not in _SELDOM
    if share_of_pairs > _OFTEN:
        choice = series_keys(channel.values)
        cure = f"give rows: {{NAME: VALUE}}, or {choice}" if choice else "give rows: {NAME: VALUE}"
        yield (
            f"{100 * share_of_pairs:.0f} % of its samples follow another at once and differ: two sensors?"
            f" {cure}"
        )
    elif is_regular and not _SHORTEST < usual_interval < _LONGEST:
        unit = min(SECONDS, key=lambda unit: abs(np.log(usual_interval * SECONDS[unit] / _LIKELY)))
        cure = f" give time_unit: {unit}" if unit != "s" else ""
        yield f"{usual_interval:.3g} s between samples: the unit of its times?{cure}"
    elif usual_interval < _BURST * steps.mean() and gaps.mean() > _OFTEN:
        yield (
            f"arrives in bursts, half of the intervals below {usual_interval:.3g} s: give sent_every:"
            f" {steps.mean():.3g}, their mean"
        )
    elif gaps.any() and (is_regular or np.percentile(steps, _FOR_LONG) < 2 * usual_interval):
        gap_time = channel.t[int(np.argmax(steps))]
        yield (
            f"{gaps.sum()} gaps, the longest {steps.max():.3g} s at {gap_time:.3g} s: lost, or a clock"
            " that was set?"
        )


def _pairs(channel: Channel) -> float:
    """Compute the share of samples that follow another at once, inside the usual interval, and
    differ from it as much as it does from the sample before.

    In bursts of messages that were held up, samples that follow at once come after a longer silence.
    """
    steps = np.diff(channel.t)
    values = channel.values
    usual_interval = float(np.percentile(steps, 75))
    second = np.flatnonzero(steps < _AT_ONCE * usual_interval)
    second = second[(second > 0) & (second < len(steps) - 1)]
    both_intervals = steps[second - 1] + steps[second]
    second = second[np.abs(both_intervals / usual_interval - 1.0) < 0.5]
    if not len(second):
        return 0.0
    deviations = np.abs(values[second + 1] - values[second]).max(axis=1)
    moved = np.abs(values[second] - values[second - 1]).max(axis=1)
    if np.median(deviations) < np.median(moved) / 2:
        return 0.0
    return float((deviations > 0.0).mean() * len(second) / len(steps))


def _dead(name: str, channel: Channel) -> Iterator[str]:
    """Check for columns that never change; a joint may rest, and a current be steady."""
    kind = CHANNEL_KINDS[name]
    ranges = np.ptp(channel.values, axis=0)
    if kind.command:
        if ranges.max() == 0.0 and channel.values.any():
            yield "dead: nothing in it ever changes"
        return
    if not kind.columns or name == "current":
        return
    dead = []
    for k, label in enumerate(kind.columns):
        if ranges[k] < DEAD and k not in channel.constants:
            dead.append(label)
    # Numbers of an attitude have no sensor each.
    has_sensor_for_each = name != "attitude"
    if dead and (has_sensor_for_each or len(dead) == len(kind.columns)):
        yield f"dead: {', '.join(dead)} stay within {DEAD:g} {kind.unit}"


def _lost(name: str, channel: Channel) -> Iterator[str]:
    """Check for zeros between samples that move."""
    size = np.linalg.norm(channel.values, axis=1)
    is_zero = size == 0.0
    if name not in _AWAY_FROM_ZERO or not is_zero.any() or is_zero.all():
        return
    moved = channel.t[~is_zero]
    zeros = channel.t[is_zero]
    # Before and after all others it may have been at rest.
    zeros = zeros[(zeros > moved[0]) & (zeros < moved[-1])]
    expected_size = np.interp(zeros, moved, size[~is_zero])
    n_lost = int((expected_size > _AWAY_FROM_ZERO[name]).sum())
    if n_lost:
        yield f"{n_lost} of {len(channel.t)} samples are exactly zero: lost ones?"


def _far_off(name: str, channel: Channel) -> Iterator[str]:
    """Check for values far outside all others: sentinels, or mistyped ones."""
    if CHANNEL_KINDS[name].command or name == "attitude":
        return
    for label, values in zip(CHANNEL_KINDS[name].columns, channel.values.T, strict=False):
        for extreme in (float(values.min()), float(values.max())):
            remaining = values[values != extreme]
            if len(remaining):
                low, high = np.percentile(remaining, [0.1, 99.9])
            else:
                low = extreme
                high = extreme
            n_extreme = len(values) - len(remaining)
            is_extreme = values == extreme
            n_returns = int((is_extreme[1:] & ~is_extreme[:-1]).sum())
            is_exception = n_extreme < _FOR_LONG / 100 * len(values) or n_returns > _RETURNS
            gap = max(low - extreme, extreme - high)
            is_far = gap > max(_FAR * (high - low), _FARTHEST.get(name, 0.0))
            if is_far and is_exception:
                cure = f"give missing: [{extreme:.10g}] where it stands for nothing"
                if n_extreme == 1:
                    cure = f"mistyped? {cure}"
                yield (
                    f"{label} is {extreme:.6g} in {n_extreme} of {len(values)} samples, all others"
                    f" {low:.3g} to {high:.3g}: {cure}"
                )


def _spikes(name: str, channel: Channel) -> Iterator[str]:
    """Check for one value to which a channel jumps for a sample again and again, and from which it
    jumps back.
    """
    if name == "attitude":
        return
    for label, values in zip(CHANNEL_KINDS[name].columns, channel.values.T, strict=False):
        steps = np.diff(values)
        sizes = np.abs(steps)
        width = np.ptp(np.percentile(values, [5.0, 95.0]))
        smallest_step = sizes[sizes > 0.0].min(initial=np.inf)
        threshold = max(
            _SPIKE * np.percentile(sizes, 80.0),
            width / 4,
            _FAR * smallest_step,
        )
        jumps = sizes > threshold
        turns_back = steps[:-1] * steps[1:] < 0.0
        extremes = values[1:-1][jumps[:-1] & jumps[1:] & turns_back]
        peaks, counts = np.unique(extremes, return_counts=True)
        is_same_value = counts.max(initial=0) >= max(_CLIPPED, 0.8 * len(extremes))
        if is_same_value and not any(_far_off(name, channel)):
            value = f"{peaks[np.argmax(counts)]:.10g}"
            yield (
                f"{label} jumps to {value} and back {counts.max()} times: give missing: [{value}]"
                " where it stands for nothing"
            )


def _saturated(name: str, channel: Channel) -> Iterator[str]:
    """Check for ends of a range that are met exactly, again and again, and far more often than the
    values next to them.
    """
    if name not in _SATURATES or any(_far_off(name, channel)):
        return
    kind = CHANNEL_KINDS[name]
    for label, values in zip(kind.columns, channel.values.T, strict=False):
        for sign in (1.0, -1.0):
            levels, counts = np.unique(sign * values, return_counts=True)
            is_at_end = sign * values == levels[-1]
            n_visits = int((~is_at_end[:-1] & is_at_end[1:]).sum())
            n = int(counts[-1])
            is_judged = len(levels) > _MIN_LEVELS and levels[-1] > 0.0 and n_visits > 1
            if is_judged and n >= max(_CLIPPED, 3 * counts[-2]):
                end = f"{sign * levels[-1]:.10g}"
                yield (
                    f"{label} is never beyond {end} {kind.unit}, and there in {n} samples:"
                    f" saturated? give missing: [{end}]"
                )


def _units(name: str, channel: Channel) -> Iterator[str]:
    """Check the unit of a channel by its size, unless single values are in no unit at all."""
    if name in _FASTEST and not any(_far_off(name, channel)):
        fastest, likely_unit = _FASTEST[name]
        kind = CHANNEL_KINDS[name]
        yield from _too_fast(channel.values, fastest, kind.unit, likely_unit, kind.columns)


def _too_fast(
    values: np.ndarray, fastest: float, unit: str, likely_unit: str, labels: Sequence[str] = ()
) -> Iterator[str]:
    """Yield a doubt about values (n, k) [unit] that are larger than `fastest` for long; labels: names of
    the columns, to say which of them alone is.
    """
    usual_size = float(np.percentile(np.abs(values).max(axis=1), _FOR_LONG))
    if usual_size <= fastest:
        return
    if likely_unit == _COUNTED and (values == np.round(values)).all():
        yield (
            f"up to {usual_size:.3g} {unit} for a tenth of the time: is it in counts of an encoder, or"
            " in deg? All are whole numbers: give its unit, or its offset and scale"
        )
        return
    by_column = np.percentile(np.abs(values), _FOR_LONG, axis=0)
    is_fast = by_column > fastest
    is_slow = by_column < _PLAUSIBLE * fastest
    if labels and is_fast.any() and is_slow.any() and (is_fast | is_slow).all():
        names = " and ".join(np.array(labels)[is_fast])
        factor = _FACTORS[likely_unit]
        scales = ", ".join(f"{factor:.10g}" if fast else "1" for fast in is_fast)
        yield (
            f"{names} alone up to {usual_size:.3g} {unit} for a tenth of the time: {likely_unit}? give"
            f" scale: [{scales}]"
        )
        return
    yield f"up to {usual_size:.3g} {unit} for a tenth of the time: is it in {likely_unit}?"


def _no_force(name: str, channel: Channel) -> Iterator[str]:
    """Check for commands that look like pulses or shares. Zeros do not count: motors that are off
    get them.
    """
    if name == "propeller_commands":
        yield from _no_share(np.abs(channel.values))
    values = channel.values[channel.values != 0.0]
    if name not in ("thrust", "propeller_commands") or not len(values):
        return
    low, high = np.percentile(values, [1.0, 99.0])
    if channel.values.shape[1] > 2:
        narrow = _NARROW_OF_MANY
    else:
        narrow = 1.0 / (1.0 + _NARROW)
    has_offset = low * high > 0.0 and min(abs(low), abs(high)) > narrow * max(abs(low), abs(high))
    if name == "propeller_commands":
        if has_offset and np.abs(values).max() <= 1.0:
            yield f"{low:.4g} to {high:.4g}, and never near 0: its offset, its scale?"
        return
    if _PULSES[0] < low and high < _PULSES[1]:
        yield (
            f"{low:.0f} to {high:.0f}: pulse widths in us? give offset: -1500, scale: 0.0025, as"
            " propeller_commands"
        )
    elif max(-low, high) <= 1.0 and np.abs(values).max() <= 1.0:
        yield (
            f"{low:.3g} to {high:.3g}: shares of the largest command? give them as"
            " propeller_commands"
        )
    elif has_offset:
        yield f"{low:.4g} to {high:.4g} N, and never near 0: its offset, its unit?"


def _no_share(sizes: np.ndarray) -> Iterator[str]:
    """Check for a single value beyond 1, or more of them, among sizes (n, k) of shares of the
    largest command.
    """
    beyond = sizes[sizes > 1.0 + _BEYOND_ONE]
    if not len(beyond):
        return
    if len(beyond) < sizes.size and np.ptp(beyond) == 0.0:
        text = (
            "pulses of 0, which are none, or of what is no thruster? give missing: [0], or leave"
            " columns out"
        )
        yield (
            f"{beyond[0]:.3g} in {100.0 * len(beyond) / sizes.size:.2g} % of its numbers, all others"
            f" within 1: {text}"
        )
    else:
        yield (
            f"up to {beyond.max():.3g}: shares of the largest command are at most 1: their offset"
            " and scale?"
        )
