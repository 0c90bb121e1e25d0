"""Measure how far predictions are off, channel by channel."""

from __future__ import annotations

import numpy as np

from uvms_ocp.identification import parameters
from uvms_ocp.identification.predictor import Predicted

SCORED = (*parameters.AXES, "tilt")
"""[m/s, rad/s, deg] channels whose errors are reported."""


def errors(predicted: Predicted) -> np.ndarray:
    """Compute (7,) [m/s, rad/s, deg] root mean squares of `SCORED`: velocities, and the angle
    between verticals.
    """
    linear = root_mean_square(predicted.rows[0] - predicted.measured[0])
    angular = root_mean_square(predicted.rows[1] - predicted.measured[1])
    tilt = root_mean_square(np.rad2deg(tilts(predicted))[:, None])
    return np.concatenate([linear, angular, tilt])


def tilts(predicted: Predicted) -> np.ndarray:
    """Compute angles (m,) [rad] between the vertical in B as predicted and as measured."""
    rows = predicted.rows[2]
    measured = predicted.measured[2]
    return np.arctan2(
        np.linalg.norm(np.cross(rows, measured), axis=1), (rows * measured).sum(axis=1)
    )


def root_mean_square(values: np.ndarray) -> np.ndarray:
    """Compute root mean squares (k,) [as values] of each column of values (m, k) [any]."""
    return np.asarray(np.sqrt((values**2).mean(axis=0)))
