"""Speed of a link near an obstacle, and its exact derivatives.

[Gao2022] eq. (77) weighs the penalty by the speed of a body point. The witness point itself jumps on the link (flat
faces, coal gives no derivative of it), so the speed used here is the root mean square over the ball around the link,
``sqrt(|v_c|^2 + rho^2 |omega|^2 + eps^2)``: smooth at rest, independent of the witness, exactly differentiable.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from uvms_ocp.arrays import Array
from uvms_ocp.collision.coal_distances import NearPairs
from uvms_ocp.collision.collision_scene import CollisionScene


class LinkSpeeds(NamedTuple):
    """One row per near pair."""

    speed: Array
    """(n,) [m/s]"""
    by_position: Array
    """(n, n_axes) [m/s per m or rad]"""
    by_rate: Array
    """(n, n_axes) [m/s per m/s or rad/s]"""


def link_speeds(scene: CollisionScene, near: NearPairs, rates: Array, floor: float) -> LinkSpeeds:
    """Speeds of the second shape of each near pair.

    rates (n, n_axes) [m/s, rad/s]: of the axes at each near pair's sample; floor [m/s]: eps.
    """
    screws = near.screws * scene.carried[near.pair][:, None, :]
    gyration = scene.gyration[near.pair, None] ** 2
    twist = (screws @ rates[..., None])[..., 0]
    linear = twist[:, :3] + _cross(twist[:, 3:], near.centre)
    angular = twist[:, 3:]
    speed = np.sqrt(np.sum(linear**2, axis=1) + gyration[:, 0] * np.sum(angular**2, axis=1) + floor**2)
    turn = screws[:, 3:]
    shift = screws[:, :3] + _cross(turn, near.centre[..., None])
    twist_slope = _twist_slopes(screws, rates, scene.follows)
    linear_slope = (
        twist_slope[:, :3] + _cross(twist_slope[:, 3:], near.centre[..., None]) + _cross(angular[..., None], shift)
    )
    weighted = gyration * angular
    return LinkSpeeds(
        speed=speed,
        by_position=(_dot(linear, linear_slope) + _dot(weighted, twist_slope[:, 3:])) / speed[:, None],
        by_rate=(_dot(linear, shift) + _dot(weighted, turn)) / speed[:, None],
    )


def _twist_slopes(screws: Array, rates: Array, follows: Array) -> Array:
    """(n, 6, n_axes) of the twist by the axes: axis j turns the screws of the axes it carries, d s_k = s_j x s_k."""
    carried = screws @ (rates[:, None, :] * follows).transpose(0, 2, 1)
    return np.concatenate(
        [
            _cross(screws[:, 3:], carried[:, :3]) + _cross(screws[:, :3], carried[:, 3:]),
            _cross(screws[:, 3:], carried[:, 3:]),
        ],
        axis=1,
    )


def _cross(a: Array, b: Array) -> Array:
    """Cross product along axis 1; ``numpy.cross`` costs several times more on small arrays."""
    return np.stack(
        [
            a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1],
            a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2],
            a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0],
        ],
        axis=1,
    )


def _dot(vector: Array, matrix: Array) -> Array:
    return (vector[:, None, :] @ matrix)[:, 0]
