"""What is doubtful about a recording, found by what must hold whatever the vehicle: velocity is the rate of position.

Axes are looked for among all 48 ways to swap and turn them. A way is told where it explains much more than the axes as they
are, so that axes in which nothing moved raise no doubt.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

from uvms_ocp.identification.recordings.recording import KINDS, Channel, Recording
from uvms_ocp.identification.recordings.sampling import angular_rate, rotations, smoothed

WINDOW = 0.6
"""[s] over which rates are taken."""
_DEAD = 1e-5  # [unit] below which nothing that a sensor measures stays
_MOVES = {"linear_velocity": 0.01, "angular_velocity": 0.01}  # [m/s, rad/s] less says nothing
_LATEST = 1.5  # [s] offsets of clocks that are looked for
_LATE = 0.1  # [s] offsets that are told
_EXPLAINED = 0.15  # [-] of the motion, by which other axes must explain more
_SCALE = 1.3  # [-] beyond which a factor is one of units
_GAP, _BURST = 8.0, 0.5  # [-] of the usual interval; of the mean one
_DEGREES = 180.0 / np.pi


@dataclass(frozen=True, kw_only=True, slots=True)
class Doubt:
    """One."""

    channel: str
    problem: str

    def __str__(self) -> str:
        return f"{self.channel}: {self.problem}"


def doubts(recording: Recording) -> tuple[Doubt, ...]:
    """Everything that is doubtful about a recording."""
    found = [
        Doubt(channel=name, problem=text) for name, one in recording.channels.items() for text in _alone(name, one)
    ]
    for name, reference in _references(recording):
        found += [Doubt(channel=name, problem=text) for text in _against(recording, name, reference)]
    found += [Doubt(channel=name, problem=text) for name, text in _upright(recording)]
    return tuple(found)


def _alone(name: str, channel: Channel) -> Iterator[str]:
    steps = np.diff(channel.t)
    usual = float(np.median(steps))
    if usual < _BURST * steps.mean():
        yield f"arrives in bursts, half of the intervals below {usual:.3g} s at a mean of {steps.mean():.3g} s: sent_every?"
    elif steps.max() > _GAP * usual:
        at = channel.t[int(np.argmax(steps))]
        yield f"{int((steps > _GAP * usual).sum())} gaps, the longest {steps.max():.3g} s at {at:.3g} s"
    kind = KINDS[name]
    if kind.command or name == "current":
        return
    labels = kind.columns or tuple(str(k) for k in range(channel.values.shape[1]))
    dead = [label for label, spread in zip(labels, np.ptp(channel.values, axis=0), strict=True) if spread < _DEAD]
    if dead:
        yield f"dead: {', '.join(dead)} stay within {_DEAD:g} {kind.unit}"
    lost = int((channel.values == 0.0).all(axis=1).sum())
    if 0 < lost < len(channel.t) / 2 and name in _MOVES and np.abs(channel.values).max() > 10 * _MOVES[name]:
        yield f"{lost} of {len(channel.t)} samples are exactly zero: lost ones?"


@dataclass(frozen=True, slots=True, eq=False)
class _Reference:
    """What a velocity should be, at uniform times."""

    t: np.ndarray
    body: np.ndarray
    """(m, 3)"""
    world: np.ndarray | None = None
    """(m, 3) the same in W."""


def _references(recording: Recording) -> Iterator[tuple[str, _Reference]]:
    channels = recording.channels
    if "attitude" not in channels:
        return
    if "angular_velocity" in channels:
        yield "angular_velocity", _Reference(*angular_rate(channels["attitude"], WINDOW))
    if "linear_velocity" in channels and "position" in channels:
        t, rate = smoothed(channels["position"].known_t, channels["position"].values, WINDOW, derivative=1)
        body = np.einsum("nji,nj->ni", rotations(channels["attitude"], t), rate)
        yield "linear_velocity", _Reference(t, body, rate)


def _against(recording: Recording, name: str, reference: _Reference) -> Iterator[str]:
    measured = recording.channels[name]
    if np.ptp(measured.values, axis=0).max() < _DEAD or reference.body.std(axis=0).max() < _MOVES[name]:
        return
    t, values = smoothed(measured.known_t, measured.values, WINDOW)
    late = _offset(reference, t, values)
    if abs(late) > _LATE:
        yield f"{abs(late):.2f} s {'late' if late > 0 else 'early'} against the rate of the {_PARTNER[name]}"
    seen = np.column_stack([np.interp(reference.t + late, t, column) for column in values.T])
    factor = float(np.linalg.norm(seen) / np.linalg.norm(reference.body))
    if not 1 / _SCALE < factor < _SCALE:
        yield f"{factor:.2g} times the rate of the {_PARTNER[name]}{_unit_of(factor)}"
    yield from _axes(reference, seen / factor, _PARTNER[name])


_PARTNER = {"linear_velocity": "position", "angular_velocity": "attitude"}


def _unit_of(factor: float) -> str:
    return ": in degrees?" if 0.8 < factor / _DEGREES < 1.25 else ""


def _offset(reference: _Reference, t: np.ndarray, values: np.ndarray) -> float:
    """By how much [s] the values come after the reference, from magnitudes, which have no axes."""
    shifts = np.arange(-_LATEST, _LATEST + 1e-9, 0.05)
    inside = (reference.t > t[0] + _LATEST) & (reference.t < t[-1] - _LATEST)
    if inside.sum() < 20:
        return 0.0
    size, magnitude = np.linalg.norm(reference.body, axis=1)[inside], np.linalg.norm(values, axis=1)
    agreement = [_correlation(size, np.interp(reference.t[inside] + shift, t, magnitude)) for shift in shifts]
    return float(shifts[int(np.argmax(agreement))])


def _correlation(x: np.ndarray, y: np.ndarray) -> float:
    x, y = x - x.mean(), y - y.mean()
    return float(x @ y / max(np.linalg.norm(x) * np.linalg.norm(y), 1e-300))


def _axes(reference: _Reference, seen: np.ndarray, partner: str) -> Iterator[str]:
    """Other axes that explain more of the motion than the axes as they are."""
    own = _explained(seen, reference.body)
    ways = {f"as {_told(Q)}": _explained(seen @ Q.T, reference.body) for Q in _WAYS}
    if reference.world is not None:
        ways["in W"] = _explained(seen, reference.world) - _EXPLAINED / 2  # B, where both will do
    best = max(ways, key=lambda way: ways[way])
    if ways[best] > own + _EXPLAINED:
        yield f"its axes fit the rate of the {partner} {best} ({100 * ways[best]:.0f} % of it, {100 * own:.0f} % as they are)"


_WAYS = tuple(
    np.diag(signs) @ np.eye(3)[list(order)]
    for order in permutations(range(3))
    for signs in product((1.0, -1.0), repeat=3)
)


def _told(Q: np.ndarray) -> str:
    entries = [("-" if row.sum() < 0 else "") + "xyz"[int(np.argmax(np.abs(row)))] for row in Q]
    return f"({', '.join(entries)})"


def _explained(seen: np.ndarray, wanted: np.ndarray) -> float:
    """Share [-] of the squares that is explained."""
    return 1.0 - float(((seen - wanted) ** 2).sum() / (wanted**2).sum())


def _upright(recording: Recording) -> Iterator[tuple[str, str]]:
    channels = recording.channels
    if "attitude" in channels:
        up = float(rotations(channels["attitude"], channels["attitude"].known_t)[:, 2, 2].mean())
        if up < 0.0:
            yield "attitude", "the vehicle lies on its back: z down in one of its frames (NED, FRD)?"
    if "specific_force" in channels and channels["specific_force"].values[:, 2].mean() < 0.0:
        yield "specific_force", "points down on average, and at rest it is up: z down (FRD), or its sign?"
    if "position" in channels and channels["position"].values[:, 2].min() > 0.0:
        low, high = channels["position"].values[:, 2].min(), channels["position"].values[:, 2].max()
        yield "position", f"z is {low:.3g} to {high:.3g} m, above a surface at 0: z down (NED)?"
