"""Values of everything that a search moves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uvms_ocp.identification.methods.rollout import Start
from uvms_ocp.model.spatial import quaternion_conjugate, quaternion_log, quaternion_multiply


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Point:
    """Unknowns and starts."""

    shared: np.ndarray
    """(n,) [as `Unknowns.start`]"""
    own: tuple[np.ndarray, ...]
    """(m,) [as `Unknowns.start`] of each recording."""
    starts: tuple[tuple[Start, ...], ...]
    """Of the stretches of each recording."""


def difference(of: Start, to: Start) -> np.ndarray:
    """(9,) [m/s, rad/s, rad] that moves one start to another."""
    turn = quaternion_log(quaternion_multiply(quaternion_conjugate(of.q[3:]), to.q[3:]))
    return np.concatenate([to.v - of.v, np.asarray(turn).ravel()])
