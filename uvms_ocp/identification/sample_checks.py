"""Check the quality of single channels: times, units, gravity, frozen values; and measures of how
well two series agree.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import permutations, product

import numpy as np

from uvms_ocp.checks import checked_dataclass
from uvms_ocp.identification.recording import (
    CHANNEL_KINDS,
    SECONDS,
    Channel,
    Recording,
    angular_rate,
    rotations,
    smoothed,
)

EXPLAINED = 0.15
"""Share of the motion, by which other axes must explain more."""
WAYS = tuple(
    np.diag(signs) @ np.eye(3)[[*axes]]
    for axes in permutations(range(3))
    for signs in product((1.0, -1.0), repeat=3)
)
"""(3, 3) each: all ways to swap and turn axes."""
_LATEST = 1.5  # [s] offsets of clocks that are looked for
_SHIFTS = 0.05 * np.arange(-30, 31)  # [s] up to these
_LEAST_SAMPLES = 20  # samples
_LATE = 0.175  # [s] offsets that are told
_JUMP = 0.3  # [s] between offsets of the two halves
# correlation from which on an offset is one, and by which it is better than others
_AGREES = 0.6
_BETTER = 0.01
_PARTED = 0.2  # of it, by which two halves must disagree
_SCALE = 1.9  # beyond which a factor is one of units: the least is that of knots
_UNITS = {
    180.0 / np.pi: ("deg/s", "deg"),
    1e3: ("mm/s", "mm"),
    1e2: ("cm/s", "cm"),
    1.0 / 0.514444: ("kn", ""),
}
"""Factors of units of a rate, and of a pose."""
_CLOSE = 1.25  # to the factor of a unit

WINDOW = 0.6
"""[s] over which rates are taken."""
DEAD = 1e-5
"""[unit] below which nothing that a sensor measures stays."""
MOVES = {"linear_velocity": 0.01, "angular_velocity": 0.01, "specific_force": 0.5}
"""[m/s, rad/s, m/s2] Less says nothing; of an acceleration, what tilt makes of gravity."""
# of the usual interval; of the mean one
_GAP = 8.0
_BURST = 0.5
_OFTEN = 0.02  # of all intervals, from which on gaps are what bursts leave
# [s] between samples, of any sensor
_SHORTEST = 1e-5
_LIKELY = 0.05
_LONGEST = 5.0
_AT_ONCE = 0.05  # of the usual interval
_FAR = 3.0  # widths of all others by which values are far off
_FARTHEST = {
    "position": 20.0,
    "linear_velocity": 5.0,
    "angular_velocity": 10.0,
    "specific_force": 100.0,
    "current": 5.0,
}
"""[unit] by which they are at least."""
_SATURATES = ("linear_velocity", "angular_velocity", "specific_force")
_SPIKE = 10.0  # usual steps that a jump is
_CLIPPED = 5  # samples at the end of a range, from which on it is the sensor's
_PULSES = (900.0, 2200.0)  # [us]
_NARROW = 0.1  # of the size of commands, in which all of them stay: no vehicle is driven so
_SELDOM = ("current", *(name for name, kind in CHANNEL_KINDS.items() if kind.command))
"""Channels that may be recorded only when they change."""
# [s] of a recording; of it over what its samples take up
_SHORTEST_RECORDING = 5.0
_SPARSEST = 100.0

_FOR_LONG = 90.0  # [%] of samples below a peak

G = 9.81  # [m/s2]
_LIKE_G = (0.8, 1.2)  # of it
_FREE = 0.3  # of it, below which gravity is not there
_PRESSURE = 700.0  # [mbar] of air, where people are, and no height of a vehicle in water
_UPRIGHT = 0.7  # of it, which stays along an axis that is z up

_LONG = 2.0  # [s] for which no sensor of what moves repeats itself
_DIFFER = 0.05  # [m/s, rad/s] root mean square by which a velocity and the rate of a pose then do
_DRIVEN = 0.05  # [m/s] standard deviation of a velocity that does not come to rest
_PAIRS = (("position", "linear_velocity"), ("attitude", "angular_velocity"))


# One doubt about a recording.


@checked_dataclass()
class QualityIssue:
    """One doubt about a recording: its channel, and the evidence against it."""

    channel: str
    problem: str

    def __str__(self) -> str:
        return f"{self.channel}: {self.problem}"


# How well two series agree: in time, in size and in their axes.


def explained(measured: np.ndarray, expected: np.ndarray) -> float:
    """Compute the share of the squares of expected (m, 3) [any] that measured (m, 3) [any] has."""
    return 1.0 - float(((measured - expected) ** 2).sum() / (expected**2).sum())


def named(Q: np.ndarray) -> str:
    """Name the axes as Q (3, 3) turns them, such as (y, -x, z)."""
    entries = [("-" if row.sum() < 0 else "") + "xyz"[int(np.argmax(np.abs(row)))] for row in Q]
    return f"({', '.join(entries)})"


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
    units = [text for size, names in _UNITS.items() for text in _of_unit(factor, size, *names)]
    return f"{factor:.2g} times the rate of the {{}}: {(units or ['its units?'])[0]}"


def _slopes(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Compute the slope of y upon x, and the slope that x upon y implies; 0 and infinity where the
    two have nothing in common.
    """
    common = float(x @ y)
    if correlation(x, y) < _AGREES:
        return 0.0, np.inf
    return common / float(x @ x), float(y @ y) / common


def _of_unit(factor: float, size: float, of_rate: str, of_pose: str) -> Iterator[str]:
    if 1 / _CLOSE < factor / size < _CLOSE:
        yield f"in {of_rate}?"
    if of_pose and 1 / _CLOSE < factor * size < _CLOSE:
        yield f"is the other in {of_pose}?"


def describe_delay(late: float) -> str:
    """Describe an offset late [s] in words; empty where it is small."""
    if abs(late) > _LATE:
        return f"{abs(late):.2f} s {'late' if late > 0 else 'early'} against the rate of the {{}}"
    return ""


def offset(
    t: np.ndarray, expected: np.ndarray, t_measured: np.ndarray, measured: np.ndarray
) -> tuple[float, bool]:
    """Find by how much [s] measured comes after expected, 0 where they do not agree, and whether
    both halves of the time have that offset.

    Of expected (m, k) [any] at t (m,) [s] and measured (n, k) [any] at t_seen (n,) [s], from
    magnitudes, which have no axes.
    """
    size = np.linalg.norm(expected, axis=1)
    magnitude = np.linalg.norm(measured, axis=1)
    inside = np.flatnonzero((t > t_measured[0] + _LATEST) & (t < t_measured[-1] - _LATEST))
    if len(inside) < 2 * _LEAST_SAMPLES:
        return 0.0, True

    def agreement(part: np.ndarray) -> np.ndarray:
        """Correlate a part of the samples at each shift in `_SHIFTS`."""
        shifted = [np.interp(t[part] + shift, t_measured, magnitude) for shift in _SHIFTS]
        return np.array([correlation(size[part], values) for values in shifted])

    first_half, second_half = np.array_split(inside, 2)
    consistent = not _differ(agreement(first_half), agreement(second_half))
    return float(_SHIFTS[_best(agreement(inside))]), consistent


def _best(agreement: np.ndarray) -> int:
    """Find the index of the best agreement; the nearest of those that swings repeat a period later,
    and no offset where that is as good.
    """
    middle = len(_SHIFTS) // 2
    if agreement.max() < max(_AGREES, agreement[middle] + _BETTER):
        return middle
    peaks = np.flatnonzero(
        (agreement >= np.roll(agreement, 1)) & (agreement >= np.roll(agreement, -1))
    )
    good = peaks[agreement[peaks] > agreement.max() - _BETTER]
    return int(good[np.argmin(np.abs(_SHIFTS[good]))])


def _differ(first: np.ndarray, second: np.ndarray) -> bool:
    """Check whether either agreement is good at an offset at which the other is not."""
    a = _best(first)
    b = _best(second)
    parted = min(first[a] - first[b], second[b] - second[a]) > _PARTED
    return bool(parted and abs(_SHIFTS[a] - _SHIFTS[b]) > _JUMP)


def correlation(x: np.ndarray, y: np.ndarray) -> float:
    """Correlate two series x (m,) [any] and y (m,) [any], from -1 to 1; 0 where either is
    constant.
    """
    x = x - x.mean()
    y = y - y.mean()
    return float(x @ y / max(np.linalg.norm(x) * np.linalg.norm(y), 1e-300))


# What speaks against a channel by itself: its times, and values that no sensor and no vehicle has.

_FASTEST = dict.fromkeys(("linear_velocity", "current"), (10.0, "mm/s, or cm/s"))
_FASTEST |= dict.fromkeys(("angular_velocity", "joint_velocities"), (4 * np.pi, "deg/s"))
_FASTEST["joint_positions"] = (4 * np.pi, "deg")
"""[unit] that no channel has for long, and the unit which it would be in."""


def of_samples(recording: Recording) -> Iterator[tuple[str, str]]:
    """Yield channels and doubts about their samples."""
    begin, end = recording.span
    if end - begin < _SHORTEST_RECORDING:
        seconds_text = f"{end - begin:.3g} s are in all channels, which are too few to look at"
        text = seconds_text if end > begin else "no time is in all channels"
        yield (
            next(iter(recording.channels)),
            f"{text}: other clocks, or other units of times, such as min?",
        )
    for name, channel in recording.channels.items():
        checks = (_times, _dead, _lost, _far_off, _spikes, _saturated, _units, _no_force)
        yield from ((name, text) for check in checks for text in check(name, channel))


def has_times(channel: Channel) -> bool:
    """Check whether its times are such that rates can be taken."""
    usual = float(np.median(np.diff(channel.t)))
    span = channel.t[-1] - channel.t[0]
    return bool(
        _SHORTEST < usual < _LONGEST
        and _SHORTEST_RECORDING < span < _SPARSEST * usual * len(channel.t)
    )


def of_poses(recording: Recording) -> Iterator[tuple[str, str]]:
    """Yield poses and doubts about their rates."""
    if "position" in recording.channels and not any(
        _far_off("position", recording.channels["position"])
    ):
        position = recording.channels["position"]
        is_pressure = position.values[:, 2].min() > _PRESSURE
        moved = position.values[:, :2] if is_pressure else position.values[:, :3]
        _, rate = smoothed(position.undelayed_t, moved, WINDOW, derivative=1)
        yield from (("position", text) for text in _too_fast(rate, 10.0, "m/s", "mm, or cm"))
    if "attitude" in recording.channels:
        _, omega = angular_rate(recording.channels["attitude"], WINDOW)
        yield from (
            ("attitude", text)
            for text in _too_fast(omega, 4 * np.pi, "rad/s", "deg, or of another format")
        )


def _times(name: str, channel: Channel) -> Iterator[str]:
    if channel.back > 0.0:
        yield f"times go back by up to {channel.back:.3g} s in the file: a clock that was set?"
    if channel.repeated > len(channel.t) / 10:
        yield (
            f"{channel.repeated} samples had the time of another and are left out: times with too"
            " few digits?"
        )
    steps = np.diff(channel.t)
    usual = float(np.median(steps))
    gaps = steps > max(_GAP * usual, WINDOW / 2)
    pairs = _pairs(channel)
    if pairs > _OFTEN:
        yield (
            f"{100 * pairs:.0f} % of its samples follow another at once and differ: two sensors?"
            " give rows: {NAME: VALUE}"
        )
    elif name not in _SELDOM and not _SHORTEST < usual < _LONGEST:
        unit = min(SECONDS, key=lambda unit: abs(np.log(usual * SECONDS[unit] / _LIKELY)))
        yield (
            f"{usual:.3g} s between samples: the unit of its"
            f" times?{f' give time_unit: {unit}' if unit != 's' else ''}"
        )
    elif usual < _BURST * steps.mean() and gaps.mean() > _OFTEN:
        yield (
            f"arrives in bursts, half of the intervals below {usual:.3g} s: give sent_every:"
            f" {steps.mean():.3g}, their mean"
        )
    elif gaps.any() and (name not in _SELDOM or np.percentile(steps, _FOR_LONG) < 2 * usual):
        at = channel.t[int(np.argmax(steps))]
        n = int(gaps.sum())
        yield (
            f"{n} gaps, the longest {steps.max():.3g} s at {at:.3g} s: lost, or a clock that was"
            " set?"
        )


def _dead(name: str, channel: Channel) -> Iterator[str]:
    kind = CHANNEL_KINDS[name]
    spread = np.ptp(channel.values, axis=0)
    if kind.command:
        if spread.max() == 0.0 and channel.values.any():
            yield "dead: nothing in it ever changes"
        return
    if not kind.columns or name == "current":  # a joint may rest, and a current be steady
        return
    named = enumerate(zip(kind.columns, spread, strict=True))
    dead = [label for k, (label, width) in named if width < DEAD and k not in channel.constants]
    if dead and (
        name != "attitude" or len(dead) == len(kind.columns)
    ):  # whose numbers have no sensor each
        yield f"dead: {', '.join(dead)} stay within {DEAD:g} {kind.unit}"


def _lost(name: str, channel: Channel) -> Iterator[str]:
    """Zeros between samples that move."""
    size = np.linalg.norm(channel.values, axis=1)
    zero = size == 0.0
    if name not in MOVES or not zero.any() or zero.all():
        return
    moved = channel.t[~zero]
    at = channel.t[zero]
    at = at[(at > moved[0]) & (at < moved[-1])]  # before and after it may have been at rest
    lost = int((np.interp(at, moved, size[~zero]) > MOVES[name]).sum())
    if lost:
        yield f"{lost} of {len(channel.t)} samples are exactly zero: lost ones?"


def _pairs(channel: Channel) -> float:
    """Compute the share of samples that follow another at once, within its own interval, and differ
    from it as much as that from the last.

    In bursts, of messages that were held up, what follows at once comes after a longer silence.
    """
    steps = np.diff(channel.t)
    values = channel.values
    usual = float(np.percentile(steps, 75))
    close = np.flatnonzero(steps < _AT_ONCE * usual)
    close = close[(close > 0) & (close < len(steps) - 1)]
    close = close[np.abs((steps[close - 1] + steps[close]) / usual - 1.0) < 0.5]
    if not len(close):
        return 0.0
    deviations = np.abs(values[close + 1] - values[close]).max(axis=1)
    moved = np.abs(values[close] - values[close - 1]).max(axis=1)
    if np.median(deviations) >= np.median(moved) / 2:
        return float((deviations > 0.0).mean() * len(close) / len(steps))
    return 0.0


def _far_off(name: str, channel: Channel) -> Iterator[str]:
    """Find values far outside all others: sentinels, or mistyped ones."""
    if CHANNEL_KINDS[name].command or name == "attitude":
        return
    for label, values in zip(CHANNEL_KINDS[name].columns, channel.values.T, strict=False):
        for extreme in (float(values.min()), float(values.max())):
            other_values = values[values != extreme]
            if len(other_values):
                low, high = np.percentile(other_values, [0.1, 99.9])
            else:
                low = extreme
                high = extreme
            gap = max(low - extreme, extreme - high)
            n = len(values) - len(other_values)
            if gap > max(
                _FAR * (high - low), _FARTHEST.get(name, 0.0)
            ) and n < _FOR_LONG / 100 * len(values):
                cure = f"give missing: [{extreme:.10g}] where it stands for nothing"
                if n == 1:
                    cure = f"mistyped? {cure}"
                yield (
                    f"{label} is {extreme:.6g} in {n} of {len(values)} samples, all others"
                    f" {low:.3g} to {high:.3g}: {cure}"
                )


def _spikes(name: str, channel: Channel) -> Iterator[str]:
    """Find one value to which a channel jumps for a sample again and again, and from which it jumps
    back.
    """
    for label, values in zip(
        () if name == "attitude" else CHANNEL_KINDS[name].columns, channel.values.T, strict=False
    ):
        steps = np.diff(values)
        sizes = np.abs(np.diff(values))
        width = np.ptp(np.percentile(values, [5.0, 95.0]))
        threshold = max(
            _SPIKE * np.percentile(sizes, 80.0),
            width / 4,
            _FAR * sizes[sizes > 0.0].min(initial=np.inf),
        )
        extremes = values[1:-1][
            (sizes[:-1] > threshold) & (sizes[1:] > threshold) & (steps[:-1] * steps[1:] < 0.0)
        ]
        peaks, counts = np.unique(extremes, return_counts=True)
        if counts.max(initial=0) >= max(_CLIPPED, 0.8 * len(extremes)) and not any(
            _far_off(name, channel)
        ):
            value = f"{peaks[np.argmax(counts)]:.10g}"
            yield (
                f"{label} jumps to {value} and back {counts.max()} times: give missing: [{value}]"
                " where it stands for nothing"
            )


def _saturated(name: str, channel: Channel) -> Iterator[str]:
    """Find ends of a range that are met exactly, again and again, and far more often than the
    values next to them.
    """
    kind = CHANNEL_KINDS[name]
    if name in _SATURATES and not any(_far_off(name, channel)):
        looked_at = kind.columns
    else:
        looked_at = ()
    for label, values in zip(looked_at, channel.values.T, strict=False):
        for way in (1.0, -1.0):
            ends, counts = np.unique(way * values, return_counts=True)
            at_end = way * values == ends[-1]
            visits = int((~at_end[:-1] & at_end[1:]).sum())
            n = int(counts[-1])
            if (
                len(ends) > _LEAST_SAMPLES
                and ends[-1] > 0.0
                and visits > 1
                and n >= max(_CLIPPED, 3 * counts[-2])
            ):
                end = f"{way * ends[-1]:.10g}"
                yield (
                    f"{label} is never beyond {end} {kind.unit}, and there in {n} samples:"
                    f" saturated? give missing: [{end}]"
                )


def _no_force(name: str, channel: Channel) -> Iterator[str]:
    """Find commands that look like pulses or shares; 0 is left out: motors that are off get it."""
    if name == "propeller_commands":
        yield from _no_pulse(np.abs(channel.values))
    values = channel.values[channel.values != 0.0]
    if name != "thrust" or not len(values):
        return
    low, high = np.percentile(values, [1.0, 99.0])
    narrow = (
        0.5 if channel.values.shape[1] > 2 else 1.0 / (1.0 + _NARROW)
    )  # more thrusters do not all push one way
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
    elif low * high > 0.0 and min(abs(low), abs(high)) > narrow * max(abs(low), abs(high)):
        yield f"{low:.4g} to {high:.4g} N, and never near 0: its offset, its unit?"


def _no_pulse(size: np.ndarray) -> Iterator[str]:
    """Find a single value beyond 1 among shares (n, k), or more of them."""
    beyond = size[size > 1.0 + _AT_ONCE]
    if 0 < len(beyond) < size.size and np.ptp(beyond) == 0.0:
        text = (
            "pulses of 0, which are none, or of what is no thruster? give missing: [0], or leave"
            " columns out"
        )
        yield (
            f"{beyond[0]:.3g} in {100.0 * len(beyond) / size.size:.2g} % of its numbers, all others"
            f" within 1: {text}"
        )
    elif len(beyond):
        yield (
            f"up to {beyond.max():.3g}: shares of the largest command are at most 1: their offset"
            " and scale?"
        )


def _units(name: str, channel: Channel) -> Iterator[str]:
    if name in _FASTEST and not any(_far_off(name, channel)):  # which would be in no unit
        fastest, other_unit = _FASTEST[name]
        yield from _too_fast(channel.values, fastest, CHANNEL_KINDS[name].unit, other_unit)


def _too_fast(values: np.ndarray, fastest: float, unit: str, other_unit: str) -> Iterator[str]:
    usual = float(np.percentile(np.abs(values).max(axis=1), _FOR_LONG))
    if usual > fastest:
        yield f"up to {usual:.3g} {unit} for a tenth of the time: is it in {other_unit}?"


# Which way is down: what an accelerometer feels at rest, how a vehicle lies, and on which side of
# the surface it is.


def of_gravity(recording: Recording) -> Iterator[tuple[str, str]]:
    """Yield channels and doubts about their vertical."""
    channels = recording.channels
    if "specific_force" in channels:
        yield from (("specific_force", text) for text in _felt(channels["specific_force"].values))
    proven = False
    if "attitude" in channels:
        yield from (("attitude", text) for text in _lies(channels["attitude"]))
        if "specific_force" in channels:
            up = _in_world(channels["attitude"], channels["specific_force"])
            proven = up[2] > _UPRIGHT * np.linalg.norm(up)
            yield from (("attitude", text) for text in _turned(up) if not proven)
    if "position" in channels and not proven:
        yield from (("position", text) for text in _above(channels["position"].values[:, 2]))


def _felt(force: np.ndarray) -> Iterator[str]:
    """Check the unit and the vertical axis of an accelerometer, by its samples (n, 3) [m/s2]."""
    # whichever way a vehicle tilts
    mean = force.mean(axis=0)
    size = float(np.median(np.linalg.norm(force, axis=1))) / G
    up = float(mean[2] / max(np.linalg.norm(mean), 1e-9))
    if _LIKE_G[0] < size * G < _LIKE_G[1]:
        yield "about 1 on average: in g, not in m/s2?"
    elif size < _FREE:
        yield f"{size * G:.2g} m/s2 on average, and at rest it is {G:g}: gravity taken out?"
    elif not _LIKE_G[0] < size < _LIKE_G[1]:
        yield f"{size * G:.3g} m/s2 on average, and at rest it is {G:g}: its units?"
    if up < -_UPRIGHT:
        yield "points down on average, and at rest it is up: z down (FRD), or its sign?"
    elif up < _UPRIGHT and size > _FREE:
        yield (
            f"{np.array2string(mean, precision=1)} on average, and at rest it is along z: axes"
            " swapped?"
        )


def _lies(attitude: Channel) -> Iterator[str]:
    up = rotations(attitude, attitude.undelayed_t)[:, 2, 2]
    if up.mean() < 0.0 and np.median(up[:3]) < 0.0:  # one that has rolled over began upright
        yield "the vehicle lies on its back: z down in one of its frames (NED, FRD)?"


def _in_world(attitude: Channel, force: Channel) -> np.ndarray:
    """Compute the mean specific force (3,) [m/s2] in W."""
    return np.asarray(
        np.einsum("nij,nj->ni", rotations(attitude, force.undelayed_t), force.values).mean(axis=0)
    )


def _turned(up: np.ndarray) -> Iterator[str]:
    if up[2] < -_UPRIGHT * np.linalg.norm(up):
        yield "with it the vehicle is held up against gravity downwards: z down in W (NED)?"
    else:
        yield (
            f"with it what holds the vehicle up is {np.array2string(up, precision=1)} m/s2 in W:"
            " axes or format?"
        )


def _above(z: np.ndarray) -> Iterator[str]:
    if z.min() > _PRESSURE:
        yield (
            f"z is {z.min():.4g} to {z.max():.4g}: a pressure in mbar? give offset: [0, 0, -1013],"
            " scale: [1, 1, -0.0102]"
        )
    elif z.min() > 0.0:
        yield (
            f"z is {z.min():.3g} to {z.max():.3g} m, above a surface at 0: z down (NED)? give"
            " world: NED, or -NAME for z"
        )


# What stays as it is while the vehicle moves: a sensor that has stopped, and commands that were not
# recorded.


def of_stuck(recording: Recording) -> Iterator[tuple[str, str]]:
    """Yield channels and doubts about values that do not change."""
    for pose, velocity in _PAIRS:
        if {pose, velocity} <= recording.channels.keys():
            yield from _frozen(recording, pose, velocity)
    yield from _unrecorded(recording)


def _frozen(recording: Recording, pose: str, velocity: str) -> Iterator[tuple[str, str]]:
    """Find the longest time in which pose or velocity stays as it is while the other moves, by
    magnitudes, which have no axes.
    """
    pose_channel = recording.channels[pose]
    velocity_channel = recording.channels[velocity]
    if pose == "position":
        t, rate = smoothed(pose_channel.undelayed_t, pose_channel.values, WINDOW, derivative=1)
    else:
        t, rate = angular_rate(pose_channel, WINDOW)
    speed = np.interp(
        t, velocity_channel.undelayed_t, np.linalg.norm(velocity_channel.values, axis=1)
    )
    excess = np.linalg.norm(rate, axis=1) - speed
    for name, mate, channel in ((pose, velocity, pose_channel), (velocity, pose, velocity_channel)):
        # [s] from when to when its samples are the same for longest.
        new = np.flatnonzero((np.diff(channel.values, axis=0) != 0.0).any(axis=1)) + 1
        first = np.r_[0, new]
        last = np.r_[new - 1, len(channel.t) - 1]
        k = int(np.argmax(channel.undelayed_t[last] - channel.undelayed_t[first]))
        begin = float(channel.undelayed_t[first[k]])
        end = float(channel.undelayed_t[last[k]])
        inside = (t > begin + WINDOW) & (t < end - WINDOW)
        if end - begin > _LONG and np.sqrt((excess[inside] ** 2).mean()) > _DIFFER:
            yield (
                name,
                (
                    f"stays exactly as it is from {begin:.1f} to {end:.1f} s, and the {mate} says"
                    " otherwise: stopped?"
                ),
            )


def _unrecorded(recording: Recording) -> Iterator[tuple[str, str]]:
    """Yield commands that are all zero of a vehicle that never comes to rest."""
    zero = [
        n
        for n, channel in recording.channels.items()
        if CHANNEL_KINDS[n].command and not channel.values.any()
    ]
    if not zero or "linear_velocity" not in recording.channels:
        return
    values = recording.channels["linear_velocity"].values
    if np.linalg.norm(values[len(values) // 2 :].std(axis=0)) > _DRIVEN:
        yield from (
            (name, "zero throughout, and the vehicle moves to the end: what drove it?")
            for name in zero
        )
