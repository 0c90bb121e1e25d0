"""Whether velocities are the rates of poses: axes, frames, units, clocks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from uvms_ocp.identification.recordings.doubts.agreement import (
    EXPLAINED,
    WAYS,
    explained,
    named,
    offset,
    told_factor,
    told_late,
)
from uvms_ocp.identification.recordings.doubts.samples import DEAD, MOVES, WINDOW
from uvms_ocp.identification.recordings.recording import Recording
from uvms_ocp.identification.recordings.sampling import GRID, angular_rate, rotations, smoothed

_INSIDE = slice(round(WINDOW / GRID), -round(WINDOW / GRID))
"""Of smoothed samples, where the window is whole."""
_PARTNER = {"linear_velocity": "position", "angular_velocity": "attitude"}


@dataclass(frozen=True, slots=True, eq=False)
class _Reference:
    """What a velocity should be, at uniform times."""

    t: np.ndarray
    body: np.ndarray
    """(m, 3)"""
    world: np.ndarray | None = None
    """(m, 3) the same in W."""
    R: np.ndarray | None = None
    """(m, 3, 3) from B to W."""


def of_rates(recording: Recording) -> Iterator[tuple[str, str]]:
    """Channels and what speaks against them."""
    for name, reference in _references(recording):
        yield from _against(recording, name, reference)


def _references(recording: Recording) -> Iterator[tuple[str, _Reference]]:
    channels = recording.channels
    if "attitude" not in channels:
        return
    if "angular_velocity" in channels:
        t, omega = angular_rate(channels["attitude"], WINDOW)
        yield "angular_velocity", _Reference(t[_INSIDE], omega[_INSIDE])
    if "linear_velocity" in channels and "position" in channels:
        t, rate = smoothed(channels["position"].known_t, channels["position"].values, WINDOW, derivative=1)
        t, rate = t[_INSIDE], rate[_INSIDE]
        R = rotations(channels["attitude"], t)
        yield "linear_velocity", _Reference(t, np.einsum("nji,nj->ni", R, rate), rate, R)


def _against(recording: Recording, name: str, reference: _Reference) -> Iterator[tuple[str, str]]:
    measured, partner = recording.channels[name], _PARTNER[name]
    if np.ptp(measured.values, axis=0).max() < DEAD or reference.body.std(axis=0).max() < MOVES[name]:
        return
    t, values = smoothed(measured.known_t, measured.values, WINDOW)
    late, steady = offset(reference.t, reference.body, t, values)
    seen = np.column_stack([np.interp(reference.t + late, t, column) for column in values.T])
    jump = "its clock and that of the {} differ at the end by another time than at the beginning: a jump?"
    told = [told_late(late) if steady else jump, told_factor(reference.body, seen)]
    yield from ((name, text.format(partner)) for text in told if text)
    factor = float(np.linalg.norm(seen) / np.linalg.norm(reference.body))
    yield from _axes(reference, seen / factor, name)


def _axes(reference: _Reference, seen: np.ndarray, name: str) -> Iterator[tuple[str, str]]:
    """Other axes that explain more of the motion than the axes as they are."""
    own, partner = explained(seen, reference.body), _PARTNER[name]
    ways = {
        (name, f"its axes fit the rate of the {partner} as {named(Q)}"): explained(seen @ Q.T, reference.body)
        for Q in WAYS
    }
    ways |= _in_world(reference, seen, name)
    best = max(ways, key=lambda way: ways[way])
    if ways[best] > own + EXPLAINED:
        yield best[0], f"{best[1]} ({100 * ways[best]:.0f} % of it, {100 * own:.0f} % as they are)"


def _in_world(reference: _Reference, seen: np.ndarray, name: str) -> Mapping[tuple[str, str], float]:
    """Ways that only a world frame tells; less likely than those of B, where both will do."""
    if reference.world is None or reference.R is None:
        return {}
    partner, world = _PARTNER[name], reference.world
    turned = np.einsum("nij,nj->ni", reference.R, seen)
    found = {
        (partner, f"its rate fits the velocity with axes {named(Q)}: NED against ENU?"): explained(turned, world @ Q.T)
        for Q in WAYS
    }
    found[name, f"its axes fit the rate of the {partner} in W"] = explained(seen, world)
    return {way: share - EXPLAINED / 2 for way, share in found.items()}
