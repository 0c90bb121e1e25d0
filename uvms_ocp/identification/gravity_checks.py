"""Check which way is down: by the specific force at rest, how a vehicle lies, and on which side of the
surface it is.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from uvms_ocp.identification.column_scale_checks import height_scale
from uvms_ocp.identification.pressure_units import PRESSURE, likely_unit, read_in, unit_by_size
from uvms_ocp.identification.recording import Channel, Recording
from uvms_ocp.identification.resampling import rotations

G = 9.81
"""[m/s2] specific force at rest."""
_NEAR_G = (0.8, 1.2)  # shares of G that are gravity; in units of g also sizes
_WITHOUT_GRAVITY = 0.3  # share of G below which gravity has been taken out
_HIGHEST = 50.0  # [m] above the zero of a world, which is somewhere in the water or at its bottom
_VERTICAL = 0.7  # share of the mean force from which on an axis is called vertical


def of_gravity(recording: Recording) -> Iterator[tuple[str, str]]:
    """Yield channels and doubts about their vertical."""
    force = recording.channels.get("specific_force")
    attitude = recording.channels.get("attitude")
    position = recording.channels.get("position")
    is_proven = False
    if force is not None:
        for text in _of_force(force.values):
            yield "specific_force", text
    if attitude is not None:
        for text in _of_attitude(attitude):
            yield "attitude", text
    if attitude is not None and force is not None:
        up = _mean_in_world(attitude, force)
        size = float(np.linalg.norm(up))  # [m/s2]
        is_proven = bool(up[2] > _VERTICAL * size)
        has_gravity = size > _WITHOUT_GRAVITY * G or _is_in_g(force.values)
        if not is_proven and has_gravity:
            yield "attitude", _turned(up)
    if position is not None:
        z = position.values[:, 2]
        if z.min() > PRESSURE:
            yield "position", _pressure(z)
        elif z.min() > 0.0 and unit_by_size(z) == "kPa" and height_scale(recording) is None:
            reading = read_in("kPa", z)
            yield (
                "position",
                (
                    f"z is {z.min():.4g} to {z.max():.4g}, and begins as large as air in kPa: a"
                    f" pressure, or m of depth? As a pressure it has {reading.keys()}, as a depth"
                    " world: NED"
                ),
            )
        elif z.min() > 0.0 and not is_proven:
            yield "position", _above_surface(z)
        elif z.min() > _HIGHEST:
            yield (
                "position",
                f"z is {z.min():.4g} to {z.max():.4g} m above 0: from where, or in which unit?",
            )


def _of_force(force: np.ndarray) -> Iterator[str]:
    """Check the unit and the vertical axis of an accelerometer, by its samples (n, 3) [m/s2]: on
    average, whichever way a vehicle tilts.
    """
    mean = force.mean(axis=0)
    size = float(np.median(np.linalg.norm(force, axis=1)))  # [m/s2]
    share = size / G
    up = float(mean[2] / max(np.linalg.norm(mean), 1e-9))
    if _is_in_g(force):
        yield "about 1 on average: in g, not in m/s2?"
    elif share < _WITHOUT_GRAVITY:
        yield f"{share * G:.2g} m/s2 on average, and at rest it is {G:g}: gravity taken out?"
    elif not _NEAR_G[0] < share < _NEAR_G[1]:
        yield f"{share * G:.3g} m/s2 on average, and at rest it is {G:g}: its units?"
    if up < -_VERTICAL:
        yield "points down on average, and at rest it is up: z down (FRD), or its sign?"
    elif up < _VERTICAL and share > _WITHOUT_GRAVITY:
        yield (
            f"{np.array2string(mean, precision=1)} on average, and at rest it is along z: axes"
            " swapped?"
        )


def _is_in_g(force: np.ndarray) -> bool:
    """Check whether an accelerometer's samples (n, 3) [any] are as large as gravity is in g."""
    return _NEAR_G[0] < float(np.median(np.linalg.norm(force, axis=1))) < _NEAR_G[1]


def _of_attitude(attitude: Channel) -> Iterator[str]:
    up = rotations(attitude, attitude.undelayed_t)[:, 2, 2]
    begins_upside_down = np.median(up[:3]) < 0.0  # not where it rolls over later
    if up.mean() < 0.0 and begins_upside_down:
        yield "the vehicle lies on its back: z down in one of its frames (NED, FRD)?"


def _mean_in_world(attitude: Channel, force: Channel) -> np.ndarray:
    """Compute the mean specific force (3,) [m/s2] in W."""
    R = rotations(attitude, force.undelayed_t)
    return np.asarray(np.einsum("nij,nj->ni", R, force.values).mean(axis=0))


def _turned(up: np.ndarray) -> str:
    """Describe a mean specific force (3,) [m/s2] in W that is not up."""
    if up[2] < -_VERTICAL * np.linalg.norm(up):
        return "with it the vehicle is held up against gravity downwards: z down in W (NED)?"
    return (
        f"with it what holds the vehicle up is {np.array2string(up, precision=1)} m/s2 in W: axes or"
        " format?"
    )


def _pressure(z: np.ndarray) -> str:
    """Describe heights (n,) [m] that are larger than any of a vehicle in water."""
    unit = likely_unit(z)
    reading = read_in(unit, z)
    return (
        f"z is {z.min():.4g} to {z.max():.4g}: a pressure in {unit}, {reading.evidence}? give"
        f" {reading.keys()}"
    )


def _above_surface(z: np.ndarray) -> str:
    """Describe heights (n,) [m] of a vehicle in water that are above a surface at 0."""
    return (
        f"z is {z.min():.3g} to {z.max():.3g} m, above a surface at 0: z down (NED)? give world: NED,"
        " or -NAME for z"
    )
