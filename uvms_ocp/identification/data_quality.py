"""Check the quality of a recording by what must hold for any vehicle: velocity is the rate of pose,
motion follows commands.

Axes are searched among all 48 ways to swap and turn them; one is reported where it explains much
more than the axes as they are, so that axes in which nothing moved raise no issue.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from uvms_ocp.identification import recording as recordings, sample_checks as checks
from uvms_ocp.identification.recording import (
    CHANNEL_KINDS,
    Channel,
    Recording,
    ZeroOrderHold,
    angular_rate,
    rotations,
    smoothed,
)
from uvms_ocp.identification.sample_checks import QualityIssue as QualityIssue
from uvms_ocp.record.row_files import forget

# Whether velocities are the rates of poses: axes, frames, units, clocks.

_INSIDE = slice(round(checks.WINDOW / recordings.GRID), -round(checks.WINDOW / recordings.GRID))
"""Smoothed samples whose window is whole."""
# of the motion that a way to read axes must explain: at least, and as magnitudes agree
_HALF = 0.5
_MOST = 0.8
_EVEN = 0.03  # by which one way must explain more than another where little speaks for it
_LEVEL = 0.9  # cosine of tilt of a vehicle that is level, or nearly
_AS_LARGE = 0.7  # correlation of magnitudes from which on two things are the same
_PARTNER = {
    "linear_velocity": "position",
    "angular_velocity": "attitude",
    "specific_force": "attitude",
}
_READINGS = recordings.CHANNEL_TABLE["readings"]
"""Other ways to read an attitude: places and signs of its numbers."""

_MOVING_JOINT = 0.01  # [rad/s, m/s] standard deviation; less says nothing
_OTHER = 0.5  # correlation below which a joint may be another
_BETTER = 0.3  # by which that must fit better
_NAMES = ("joint_positions", "joint_velocities")

SHIFTS = np.arange(-2.0, 3.0 + 1e-9, recordings.GRID)
"""[s] by which motion comes after a command."""
MAY = (SHIFTS > -0.15) & (SHIFTS < 1.2)
"""Plausible ones of these: thrusters lag, and messages take their time."""
_MOVING_VEHICLE = 0.01  # [m/s, rad/s] standard deviation of what moves
_LEAST = 200  # samples
_STILL = 1e-6  # of a command's size, left of it beside drag and weight: nothing by itself

_COMMANDS = tuple(name for name, kind in CHANNEL_KINDS.items() if kind.command)
# of what drag leaves: by how much more another time must explain, and how much
_CLEARER = 0.1
_CLEAR = 0.3
_MORE = 0.3  # by which other axes of a wrench must explain more, of one axis
_PARTS = {"forces": slice(0, 3), "moments": slice(3, 6)}


@dataclass(frozen=True, slots=True, eq=False)
class _Reference:
    """Reference for a velocity, at uniform times."""

    t: np.ndarray
    body: np.ndarray
    """(m, 3)"""
    world: np.ndarray | None = None
    """(m, 3) the same in W."""
    R: np.ndarray | None = None
    """(m, 3, 3) from B to W."""


def of_rates(recording: Recording) -> Iterator[tuple[str, str]]:
    """Yield channels and doubts about them; of an attitude that is read wrong that doubt alone, as
    all others follow from it.
    """
    issues = list(_other_attitude(recording))
    yield from issues or (
        issue
        for name, reference in _references(recording)
        for issue in _rate_issues(recording, name, reference)
    )


def _other_attitude(recording: Recording) -> Iterator[tuple[str, str]]:
    """Yield another way to read the attitude, with which all that depends on it agrees better, and
    other axes alone would not.
    """
    present_agreement = _agreement(recording)
    channels = recording.channels
    attitude = channels.get("attitude")
    turned = {
        reading: replace(attitude, values=attitude.values[:, order] * signs)
        for reading, (order, signs) in _READINGS
        if attitude
    }
    if (
        attitude and not present_agreement and _level(attitude) < _HALF
    ):  # no vehicle is level for long by numbers in another order
        order = (
            reading
            for reading, channel in turned.items()
            if reading.startswith("format") and _level(channel) > _LEVEL
        )
        yield from (
            ("attitude", f"reads better with {reading}: it is level then, which it is not as it is")
            for reading in order
        )
    ways = {
        reading: _agreement(replace(recording, channels={**channels, "attitude": channel}))
        for reading, channel in turned.items()
        if present_agreement
    }
    for reading, agreement in sorted(
        ways.items(), key=lambda way: -sum(share for share, _ in way[1].values())
    ):
        gains = [
            agreement.get(name, (0.0, 0.0))[0] - share
            for name, (share, _) in present_agreement.items()
        ]
        smallest_share = min(agreement.get(name, (0.0, 0.0))[0] for name in present_agreement)
        better = sum(gain > checks.EXPLAINED for gain in gains)
        clearer = better and all(
            agreement[name][0] > best + _EVEN
            for name, (_, best) in present_agreement.items()
            if name in agreement
        )
        if smallest_share > _HALF and min(gains) > -_EVEN and (better > 1 or clearer):
            shares = ", ".join(
                f"{100 * share:.0f} % of {name}" for name, (share, _) in agreement.items()
            )
            before = ", ".join(f"{100 * share:.0f} %" for share, _ in present_agreement.values())
            yield (
                "attitude",
                f"reads better with {reading}: it agrees with {shares}, and as it is with {before}",
            )
            return


def _level(attitude: Channel) -> float:
    """Compute the mean cosine of the tilt."""
    return float(rotations(attitude, attitude.undelayed_t)[:, 2, 2].mean())


def _agreement(recording: Recording) -> dict[str, tuple[float, float]]:
    """Share of each channel's motion that its reference explains with the axes as they are, and
    with those that fit best.
    """
    agreements = {}
    for name, reference in _references(recording):
        aligned = _aligned(recording, name, reference)
        if aligned is not None:
            agreements[name] = (
                checks.explained(aligned[0], reference.body),
                max(_ways(reference, aligned[0], name).values()),
            )
    return agreements


def _references(recording: Recording) -> Iterator[tuple[str, _Reference]]:
    channels = recording.channels
    if "attitude" not in channels:
        return
    if "angular_velocity" in channels:
        t, omega = angular_rate(channels["attitude"], checks.WINDOW)
        t = t[_INSIDE]
        omega = omega[_INSIDE]
        R = rotations(channels["attitude"], t)
        yield "angular_velocity", _Reference(t, omega, np.einsum("nij,nj->ni", R, omega), R)
    if "specific_force" in channels:
        t, _ = smoothed(
            channels["attitude"].undelayed_t, channels["attitude"].values, checks.WINDOW
        )
        up = checks.G * rotations(channels["attitude"], t[_INSIDE])[:, 2]
        way = np.sign(
            up.mean(axis=0) @ channels["specific_force"].values.mean(axis=0)
        )  # where down is another matter
        yield "specific_force", _Reference(t[_INSIDE], way * (up - up.mean(axis=0)))
    if "linear_velocity" in channels and "position" in channels:
        t, rate = smoothed(
            channels["position"].undelayed_t,
            channels["position"].values,
            checks.WINDOW,
            derivative=1,
        )
        t = t[_INSIDE]
        rate = rate[_INSIDE]
        R = rotations(channels["attitude"], t)
        yield "linear_velocity", _Reference(t, np.einsum("nji,nj->ni", R, rate), rate, R)


def _aligned(
    recording: Recording, name: str, reference: _Reference
) -> tuple[np.ndarray, float, bool, float] | None:
    """Return a channel (m, 3) aligned to its reference, its delay [s], whether that is constant,
    and the factor by which it was larger; `None` for no motion.
    """
    measured = recording.channels[name]
    if (
        np.ptp(measured.values, axis=0).max() < checks.DEAD
        or reference.body.std(axis=0).max() < checks.MOVES[name]
    ):
        return None
    t, values = smoothed(measured.undelayed_t, measured.values, checks.WINDOW)
    if name == "specific_force":  # whose mean is gravity
        return recordings.interpolated(reference.t, t, values - values.mean(axis=0)), 0.0, True, 1.0
    delay, steady = checks.offset(reference.t, reference.body, t, values)
    measured_values = recordings.interpolated(reference.t + delay, t, values)
    factor = float(np.linalg.norm(measured_values) / np.linalg.norm(reference.body))
    return measured_values / factor, delay, steady, factor


def _rate_issues(
    recording: Recording, name: str, reference: _Reference
) -> Iterator[tuple[str, str]]:
    aligned = _aligned(recording, name, reference)
    if aligned is None:
        return
    (measured, delay, steady, factor) = aligned
    partner = _PARTNER[name]
    jump = (
        "its clock and that of the {} differ at the end by another time than at the beginning: a"
        " jump?"
    )
    texts = [
        checks.describe_delay(delay) if steady else jump,
        checks.describe_factor(reference.body, factor * measured),
    ]
    if name != "specific_force":
        yield from ((name, text.format(partner)) for text in texts if text)
    yield from _rate_axes(reference, measured, name)


def _rate_axes(reference: _Reference, measured: np.ndarray, name: str) -> Iterator[tuple[str, str]]:
    """Yield other axes that explain more of the motion than the axes as they are."""
    present_share = checks.explained(measured, reference.body)
    ways = _ways(reference, measured, name)
    best = max(ways, key=lambda way: ways[way])
    agreement = checks.correlation(*(np.linalg.norm(x, axis=1) for x in (measured, reference.body)))
    if ways[best] > max(present_share + checks.EXPLAINED, _HALF, _MOST * agreement):
        yield (
            best[0],
            f"{best[1]} ({100 * ways[best]:.0f} % of it, {100 * present_share:.0f} % as they are)",
        )
    elif (
        name == "linear_velocity"
        and agreement > _AS_LARGE
        and reference.R is not None
        and reference.world is not None
    ):
        turn, share = _turn(np.einsum("nij,nj->ni", reference.R, measured), reference.world)
        if present_share < max(
            _HALF * agreement, share - checks.EXPLAINED if share > _HALF else 0.0
        ):
            text = (
                "with it the velocity is as large as the rate of the position, and points elsewhere"
            )
            yield "attitude", f"{text}, by {np.rad2deg(turn):.0f} deg about z: format, axes, yaw?"


def _ways(reference: _Reference, measured: np.ndarray, name: str) -> dict[tuple[str, str], float]:
    """List ways to read axes, as a channel and a text, with the share of the motion that each
    explains.
    """
    fits = (
        f"its axes fit the {'tilt' if name == 'specific_force' else 'rate'} of the"
        f" {_PARTNER[name]} as"
    )
    ways = {
        (name, f"{fits} {checks.named(Q)}"): checks.explained(measured @ Q.T, reference.body)
        for Q in checks.WAYS
    }
    return ways | _in_world(reference, measured, name)


def _turn(measured: np.ndarray, expected: np.ndarray) -> tuple[float, float]:
    """Compute the angle about z [rad] from expected (m, 3) to measured (m, 3), and the share that
    is explained without it.
    """
    plane, reference = (x[:, 0] + 1j * x[:, 1] for x in (measured, expected))
    turn = float(np.angle(np.vdot(reference, plane)))
    plane = plane * np.exp(-1j * turn)
    return turn, checks.explained(
        np.column_stack([plane.real, plane.imag, measured[:, 2]]), expected
    )


def _in_world(
    reference: _Reference, measured: np.ndarray, name: str
) -> dict[tuple[str, str], float]:
    """List ways of which a world frame alone tells; less likely than those of B, where both will
    do.
    """
    if reference.world is None or reference.R is None:
        return {}
    partner = _PARTNER[name]
    world = reference.world
    shares = {
        (name, f"its axes fit the rate of the {partner} in W"): checks.explained(measured, world)
    }
    if name == "linear_velocity":
        turned = np.einsum("nij,nj->ni", reference.R, measured)
        fits = "its rate fits the velocity with axes {}: NED against ENU? give columns so"
        shares |= {
            (partner, fits.format(checks.named(Q))): checks.explained(turned, world @ Q.T)
            for Q in checks.WAYS
        }
    return {way: share - checks.EXPLAINED / 2 for way, share in shares.items()}


# Whether velocities of joints are the rates of their positions: order, sign, units, clocks, and
# what is dead in one alone.


def of_joints(recording: Recording) -> Iterator[tuple[str, str]]:
    """Yield channels and doubts about them."""
    if not set(_NAMES) <= recording.channels.keys():
        return
    positions, velocities = (recording.channels[name] for name in _NAMES)
    if positions.values.shape[1] != velocities.values.shape[1]:
        yield (
            _NAMES[1],
            f"{velocities.values.shape[1]} of them, and {positions.values.shape[1]} positions",
        )
        return
    t, rate = smoothed(positions.undelayed_t, positions.values, checks.WINDOW, derivative=1)
    t_seen, measured_rate = smoothed(velocities.undelayed_t, velocities.values, checks.WINDOW)
    yield from _dead(
        rate, measured_rate, np.ptp(positions.values, axis=0), np.ptp(velocities.values, axis=0)
    )
    if rate.std(axis=0).max() < _MOVING_JOINT or measured_rate.std(axis=0).max() < checks.DEAD:
        return
    late, _ = checks.offset(t, rate, t_seen, measured_rate)
    shifted = recordings.interpolated(t + late, t_seen, measured_rate)
    texts = [checks.describe_delay(late), checks.describe_factor(rate, shifted)]
    yield from ((_NAMES[1], text.format("positions")) for text in texts if text)
    yield from _columns(rate, shifted)


def _dead(
    rate: np.ndarray, measured_rate: np.ndarray, width: np.ndarray, speeds: np.ndarray
) -> Iterator[tuple[str, str]]:
    for k in range(len(width)):
        if width[k] < checks.DEAD and measured_rate[:, k].std() > _MOVING_JOINT:
            yield _NAMES[0], f"dead: {k} stays where it is, and its velocity does not"
        if speeds[k] < checks.DEAD and rate[:, k].std() > _MOVING_JOINT:
            yield _NAMES[1], f"dead: {k} stays as it is, and its position moves"


def _columns(rate: np.ndarray, measured_rate: np.ndarray) -> Iterator[tuple[str, str]]:
    moving = [
        k
        for k in range(rate.shape[1])
        if min(rate[:, k].std(), measured_rate[:, k].std()) > _MOVING_JOINT
    ]
    for k in moving:
        fits = {j: checks.correlation(measured_rate[:, k], rate[:, j]) for j in moving}
        best = max(fits, key=lambda j: abs(fits[j]))
        if fits[k] < _OTHER and abs(fits[best]) > fits[k] + _BETTER:
            yield (
                _NAMES[1],
                f"{k} fits {'minus ' if fits[best] < 0 else ''}the rate of position {best}",
            )


# What accelerates a vehicle beside drag, weight and the turning of its frame, and what of a command
# stands beside these.


@dataclass(frozen=True, slots=True, eq=False)
class ExplainedMotion:
    """At uniform times."""

    t: np.ndarray
    """(m,) [s]"""
    acceleration: np.ndarray
    """(m, 6) linear and angular in B, in units of their own spread, without what drag and weight
    explain.
    """
    beside: np.ndarray
    """(m, l) orthonormal: drag, weight and the turning of the frame."""
    R: np.ndarray
    """(m, 3, 3) from B to W."""

    def rest(self, values: np.ndarray) -> np.ndarray:
        """Return the part of values (m, k) [any] that these do not explain."""
        return values - self.beside @ (self.beside.T @ values)


def motion_of(recording: Recording) -> ExplainedMotion | None:
    """None where the attitude or all velocities are not known."""
    channels = recording.channels
    if "attitude" not in channels or "linear_velocity" not in channels:
        return None
    t, _ = smoothed(channels["attitude"].undelayed_t, channels["attitude"].values, checks.WINDOW)
    start, end = recording.span
    t = t[(t > start - SHIFTS[0]) & (t < end - SHIFTS[-1])]
    if len(t) < _LEAST:
        return None
    turning = channels.get("angular_velocity")
    if turning is None or np.ptp(turning.values) < 1e-3:
        when, omega = angular_rate(channels["attitude"], checks.WINDOW)
        turning = Channel(t=when, values=omega)
    parts = [_at(t, channel) for channel in (channels["linear_velocity"], turning)]
    v = np.hstack([values for values, _ in parts])
    a = np.hstack([rates for _, rates in parts])
    R = rotations(channels["attitude"], t)
    explained_basis, _ = np.linalg.qr(
        np.hstack([np.ones((len(t), 1)), v, v * np.abs(v), R[:, 2], np.cross(v[:, 3:], v[:, :3])])
    )
    unexplained = np.where(
        v.std(axis=0) > _MOVING_VEHICLE, a - explained_basis @ (explained_basis.T @ a), 0.0
    )
    return ExplainedMotion(
        t, unexplained / np.maximum(unexplained.std(axis=0), 1e-9), explained_basis, R
    )


def _at(t: np.ndarray, channel: Channel) -> tuple[np.ndarray, np.ndarray]:
    """Interpolate values and rates (m, k) at t (m,)."""
    grid, values = smoothed(channel.undelayed_t, channel.values, checks.WINDOW)
    _, rates = smoothed(channel.undelayed_t, channel.values, checks.WINDOW, derivative=1)
    return recordings.interpolated(t, grid, values), recordings.interpolated(t, grid, rates)


def commanded(
    held: ZeroOrderHold, motion: ExplainedMotion, shift: float, *, turned: bool = False
) -> np.ndarray:
    """Compute means (m, k) of a command over the window of the rates, without what drag and weight
    explain.

    shift: [s] before the rates. turned: from W, which a wrench would be in, to B.
    """
    edges = motion.t - shift
    values = (
        held.total(edges + checks.WINDOW / 2) - held.total(edges - checks.WINDOW / 2)
    ) / checks.WINDOW
    if turned:
        values = np.einsum("nji,nkj->nki", motion.R, values.reshape(-1, 2, 3)).reshape(-1, 6)
    rest = motion.rest(values)
    return np.where(rest.std(axis=0) > _STILL * np.abs(values).max(axis=0), rest, 0.0)


# Whether motion follows its commands: after them, soon, and along the axes of a wrench.
#
# An acceleration is explained by a command at an earlier time, beside drag, weight and the turning
# of the frame. Where one at a time that cannot be explains much more than all that can be, the
# clocks differ.


def of_commands(recording: Recording) -> Iterator[tuple[str, str]]:
    """Yield channels and doubts about them."""
    names = [name for name in _COMMANDS if name in recording.channels]
    if names and (motion := motion_of(recording)) is not None:
        for name in names:
            yield from (
                (name, text)
                for text in _command_issues(name, ZeroOrderHold(recording.channels[name]), motion)
            )


def _command_issues(name: str, held: ZeroOrderHold, motion: ExplainedMotion) -> Iterator[str]:
    signed = name == "wrench"
    shares = np.array([_shares(motion, commanded(held, motion, shift), signed) for shift in SHIFTS])
    moved = shares.max(axis=0) > _CLEAR
    if not moved.any():
        return
    share = shares[:, moved].mean(axis=1)
    late = float(SHIFTS[int(np.argmax(share))])
    if share.max() > share[MAY].max() + _CLEARER:
        if late > 0:
            when = f"{late:.2f} s after"
        else:
            when = f"{-late:.2f} s before"
        yield f"the vehicle accelerates {when} what it says: a clock of its own?"
    if signed:
        yield from _wrench_axes(held, motion, late)


def _wrench_axes(held: ZeroOrderHold, motion: ExplainedMotion, late: float) -> Iterator[str]:
    """Other axes of a wrench, along which the vehicle accelerates more than along those that it
    has.
    """
    inside, outside = (commanded(held, motion, late, turned=turned) for turned in (False, True))
    for part, rows in _PARTS.items():
        ways = {
            checks.named(Q): _along(motion.acceleration[:, rows], inside[:, rows], Q)
            for Q in checks.WAYS
        }
        ways["in W"] = _along(motion.acceleration[:, rows], outside[:, rows], np.eye(3)) - _MORE / 2
        best = max(ways, key=lambda way: ways[way])
        if ways[best] > max(ways[checks.named(np.eye(3))], 0.0) + _MORE:
            yield f"its {part} fit the acceleration as {best}"


def _along(acceleration: np.ndarray, forces: np.ndarray, Q: np.ndarray) -> float:
    """Shares that each axis of Q seen (m, 3) explains of its acceleration (m, 3), less where it
    points away; their sum.
    """
    along = np.diag(_correlations(acceleration, forces @ Q.T))
    return float((along * np.abs(along)).sum())


def _shares(motion: ExplainedMotion, forces: np.ndarray, signed: bool) -> np.ndarray:
    """Shares (6,) of all accelerations that a command explains; signed: of its own axis, and along
    it.
    """
    if signed:
        return np.maximum(np.diag(_correlations(motion.acceleration, forces)), 0.0) ** 2
    forces = forces / np.maximum(np.linalg.norm(forces, axis=0), 1e-300)
    common = forces.T @ motion.acceleration
    along = (
        common * (np.linalg.pinv(forces.T @ forces, rcond=1e-12, hermitian=True) @ common)
    ).sum(axis=0)
    return np.asarray(along / np.maximum((motion.acceleration**2).sum(axis=0), 1e-9))


def _correlations(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Correlations of columns (k, l)."""
    return np.asarray(
        x.T @ y / np.maximum(np.outer(np.linalg.norm(x, axis=0), np.linalg.norm(y, axis=0)), 1e-300)
    )


# In: a recording. Out: what is doubtful about it, found by what must hold whatever the vehicle.
#
# Velocity is the rate of position, what is at rest is held up against gravity, and motion follows
# its command. Axes are looked for among all 48 ways to swap and turn them; a way is told where it
# explains much more than the axes as they are, so that axes in which nothing moved raise no doubt.


def check_data_quality(recording: Recording) -> tuple[QualityIssue, ...]:
    """Check a recording for inconsistent clocks, frames, units and thrusters; returns one issue for
    each.
    """
    wrong = {
        name for name, text in recording.issues_in_file if "rad: in deg?" in text
    }  # all else would follow from it
    sound = {
        name: channel
        for name, channel in recording.channels.items()
        if CHANNEL_KINDS[name].command or checks.has_times(channel)
    }
    others = replace(
        recording, channels={name: channel for name, channel in sound.items() if name not in wrong}
    )
    issues = [*recording.issues_in_file, *checks.of_samples(recording)]
    for kind in (
        checks.of_poses,
        of_rates,
        of_joints,
        checks.of_gravity,
        checks.of_stuck,
        of_commands,
    ):
        turned = kind is of_commands and any(
            name in _PARTNER and "its axes fit" in text for name, text in issues
        )
        issues += () if turned else kind(others)  # by such axes no vehicle follows its commands
        forget(channel.values for channel in others.channels.values())
    return tuple(QualityIssue(channel=name, problem=text) for name, text in issues)
