"""How far predictions are off."""

from __future__ import annotations

import numpy as np

from uvms_ocp.identification.answers.predictions import Predicted
from uvms_ocp.identification.parameters.vehicle_quantities import AXES

SCORED = (*AXES, "tilt")
"""[m/s, rad/s, deg] what errors are told of."""


def errors(predicted: Predicted) -> np.ndarray:
    """(7,) [m/s, rad/s, deg] root mean squares of `SCORED`: velocities, and the angle between verticals."""
    moving = [root_mean_square(predicted.rows[k] - predicted.seen[k]) for k in range(2)]
    return np.concatenate([*moving, root_mean_square(np.rad2deg(tilts(predicted))[:, None])])


def tilts(predicted: Predicted) -> np.ndarray:
    """(m,) [rad] angles between the vertical in B as predicted and as seen."""
    rows, seen = predicted.rows[2], predicted.seen[2]
    return np.arctan2(np.linalg.norm(np.cross(rows, seen), axis=1), (rows * seen).sum(axis=1))


def root_mean_square(values: np.ndarray) -> np.ndarray:
    """(k,) [as values] of each column of values (m, k) [any]."""
    return np.asarray(np.sqrt((values**2).mean(axis=0)))
