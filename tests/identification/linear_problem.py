"""A problem in which all is linear and noise is Gaussian: what sensors show is a fixed matrix times the unknowns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from driven import known, vehicle_of

from uvms_ocp.identification.answers.fitted import Fitted
from uvms_ocp.identification.methods.output_error import Noise, OutputError
from uvms_ocp.identification.methods.rollout import N_START, Rollout, Seen, Start
from uvms_ocp.identification.methods.search import Search
from uvms_ocp.identification.methods.stretch import Stretch
from uvms_ocp.identification.models.stage import Vehicle
from uvms_ocp.identification.parameters.status import Prior
from uvms_ocp.identification.recordings.recording import Channel
from uvms_ocp.identification.recordings.sampling import Held

NOISE = Noise(velocity=0.1, rate=0.1, vertical=0.1, outliers=1e6)


class LinearRollout(Rollout):
    """Shows ``G p``, whatever the start."""

    def __init__(self, G: tuple[np.ndarray, ...]) -> None:
        self.G = G

    def seen(self, stretches: Sequence[Stretch], starts: Sequence[Start], p: np.ndarray, *, slopes: bool) -> list[Seen]:
        still = [np.zeros((*g.shape[:2], N_START)) for g in self.G]
        slope = tuple(np.concatenate(pair, axis=2) for pair in zip(self.G, still, strict=True))
        return [Seen(rows=tuple(g @ row for g in self.G), end=np.zeros(0), slopes=slope) for row in p]


def vehicle() -> Vehicle:
    """Whose unknowns are their own coordinates."""
    return vehicle_of(known().learning(bias=Prior(sigma=2.0, only=("surge", "sway", "heave"))))


@dataclass(frozen=True, kw_only=True)
class _One:
    """In the place of a prepared recording."""

    stretch: Stretch

    def stretches(self, step: float, duration: float | None = None) -> tuple[Stretch, ...]:
        return (self.stretch,)


def problem(seed: int = 0, n: int = 40) -> Fitted:
    """Solved, with unknowns that weigh differently and together."""
    rng, one = np.random.default_rng(seed), vehicle()
    mixed = np.array([[1.0, 0.9, 0.0], [0.0, 0.4, 0.3], [0.0, 0.0, 0.2]])
    G = tuple(rng.normal(size=(n, 3, 3)) @ mixed for _ in range(3))
    seen = tuple(g @ [0.3, -0.5, 0.4] + 0.1 * rng.normal(size=(n, 3)) for g in G)
    error = OutputError(one, [_stretch(seen)], NOISE, LinearRollout(G))
    estimate = error.solve(error.start(), tolerance=1e-13, damping=1e-12)
    given = {"prepared": (_One(stretch=_stretch(seen)),), "estimate": estimate}
    return Fitted(vehicle=one, rollout=LinearRollout(G), noise=NOISE, search=Search(), **given)  # type: ignore[arg-type]


def _stretch(seen: tuple[np.ndarray, ...]) -> Stretch:
    n = len(seen[0])
    times = 0.1 * np.arange(n)
    commands = Held(Channel(t=times, values=np.zeros((n, 6))))
    still = {"q": np.array([0, 0, 0, 0, 0, 0, 1.0]), "v": np.zeros(6), "joints": np.zeros((0, n - 1))}
    return Stretch(recording="made", edges=times, commands=commands, t=(times,) * 3, seen=seen, **still)
