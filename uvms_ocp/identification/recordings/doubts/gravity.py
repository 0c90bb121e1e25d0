"""Which way is down: what an accelerometer feels at rest, how a vehicle lies, and on which side of the surface it is."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from uvms_ocp.identification.recordings.recording import Channel, Recording
from uvms_ocp.identification.recordings.sampling import rotations

_G = 9.81  # [m/s2]
_LIKE_G = (0.8, 1.2)  # [-] of it
_FREE = 0.3  # [-] of it, below which gravity is not there
_UPRIGHT = 0.7  # [-] of it, which stays along an axis that is z up


def of_gravity(recording: Recording) -> Iterator[tuple[str, str]]:
    """Channels and what speaks against them."""
    channels = recording.channels
    if "specific_force" in channels:
        yield from (("specific_force", text) for text in _felt(channels["specific_force"].values.mean(axis=0)))
    proven = False
    if "attitude" in channels:
        yield from (("attitude", text) for text in _lies(channels["attitude"]))
        if "specific_force" in channels:
            up = _in_world(channels["attitude"], channels["specific_force"])
            proven = up[2] > _UPRIGHT * np.linalg.norm(up)
            yield from (("attitude", text) for text in _turned(up) if not proven)
    if "position" in channels and not proven:
        yield from (("position", text) for text in _above(channels["position"].values[:, 2]))


def _felt(mean: np.ndarray) -> Iterator[str]:
    """Of a mean (3,) [m/s2]."""
    size = float(np.linalg.norm(mean)) / _G
    if _LIKE_G[0] < size * _G < _LIKE_G[1]:
        yield "about 1 on average: in g, not in m/s2?"
    elif size < _FREE:
        yield f"{size * _G:.2g} m/s2 on average, and at rest it is {_G:g}: gravity taken out?"
    elif not _LIKE_G[0] < size < _LIKE_G[1]:
        yield f"{size * _G:.3g} m/s2 on average, and at rest it is {_G:g}: its units?"
    if mean[2] < -_UPRIGHT * size * _G:
        yield "points down on average, and at rest it is up: z down (FRD), or its sign?"
    elif mean[2] < _UPRIGHT * size * _G and size > _FREE:
        yield f"{np.array2string(mean, precision=1)} on average, and at rest it is along z: axes swapped?"


def _lies(attitude: Channel) -> Iterator[str]:
    if rotations(attitude, attitude.known_t)[:, 2, 2].mean() < 0.0:
        yield "the vehicle lies on its back: z down in one of its frames (NED, FRD)?"


def _in_world(attitude: Channel, force: Channel) -> np.ndarray:
    """Mean (3,) [m/s2] of what is felt, in W."""
    R = rotations(attitude, force.known_t)
    return np.asarray(np.einsum("nij,nj->ni", R, force.values).mean(axis=0))


def _turned(up: np.ndarray) -> Iterator[str]:
    if up[2] < -_UPRIGHT * np.linalg.norm(up):
        yield "with it the vehicle is held up against gravity downwards: z down in W (NED)?"
    else:
        yield f"with it what holds the vehicle up is {np.array2string(up, precision=1)} m/s2 in W: axes or format?"


def _above(z: np.ndarray) -> Iterator[str]:
    if z.min() > 0.0:
        yield f"z is {z.min():.3g} to {z.max():.3g} m, above a surface at 0: z down (NED)?"
