"""Rows that keep a point beyond a plane.

A joint that moves both bodies alike does not change their distance: it is left out of their poses,
and so of the derivatives.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from uvms_ocp.ocp.separating_planes import Planes
from uvms_ocp.robot.symbolic_bodies import SymbolicPose
from uvms_ocp.tasks.task import TickSymbols
from uvms_ocp.types import Array, Indices, Mask

_PLANE = 3 + 3 + 1  # normal, point, offset
_NOTHING_NEAR = -1.0  # [m] offset of a row without a plane


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PlaneRowGroup:
    """Rows of one node that serve the same pairs, whichever of them are nearest."""

    pairs: Mask
    """(n_pairs,) True for the pairs that it serves."""
    n: int
    """Number of rows."""
    first: tuple[int, ...]
    """Joints in ascending order of which any may carry the plane; 0 is the world."""
    second: tuple[int, ...]
    """Joints in ascending order of which any may carry the point."""

    @property
    def size(self) -> int:
        """Parameters of a row: the shares of the joints where there are several, then the plane and
        the point.
        """
        return _n_shares(self.second) + _n_shares(self.first) + _PLANE

    @property
    def n_parameters(self) -> int:
        """Parameters of all rows."""
        return self.n * self.size

    def rows(self, symbols: TickSymbols, parameters: ca.SX) -> list[ca.SX]:
        """Return the heights of the points over their planes [m], less offsets, for parameters
        (n_parameters,).
        """
        bodies = self._bodies(symbols)
        first = _columns(bodies, self.first)
        second = _columns(bodies, self.second)
        n = self.size
        heights = []
        for i in range(self.n):
            row = parameters[n * i : n * (i + 1)]
            heights.append(self._height(first, second, row))
        return heights

    def _height(self, first: ca.SX, second: ca.SX, row: ca.SX) -> ca.SX:
        """Return the height of one row, with the poses of joints as columns."""
        n = _n_shares(self.second)
        normal, centre, offset = ca.vertsplit(row[-_PLANE:], [0, 3, 6, 7])
        plane = _mixed(first, row[n : n + _n_shares(self.first)])
        point = _mixed(second, row[:n])
        return ca.dot(plane.R @ normal, point.p - plane.p + point.R @ centre) - offset

    def _bodies(self, symbols: TickSymbols) -> Sequence[SymbolicPose]:
        """Return the poses of all joints, relative to the last one that carries all of the
        group.
        """
        tree = symbols.kinematics.model
        joints = (*self.first, *self.second)
        shared = set.intersection(*(set(tree.model.supports[joint]) for joint in joints)) - {0}
        if not shared:
            return symbols.kinematics.joint_poses
        local_poses = list(tree.local_poses(symbols.q))
        for joint in shared:
            local_poses[joint] = SymbolicPose.identity()
        return tree.joint_poses(local_poses)

    def write(self, parameters: Array, planes: Planes, offset: Array) -> None:
        """Write planes into parameters of nothing near.

        parameters (n_samples, n_parameters) [unit of the parameter], offset (n,) [m].
        """
        k = planes.sample
        column = self.size * ranks(planes.sample)
        for side, joints in ((1, self.second), (0, self.first)):
            if _n_shares(joints):
                share = np.searchsorted(joints, planes.joints[:, side])
                parameters[k, column + share] = 1.0
            column = column + _n_shares(joints)
        values = np.column_stack([planes.normal, planes.centre, offset])
        parameters[k[:, None], column[:, None] + np.arange(_PLANE)] = values

    def nothing(self) -> Array:
        """Return the parameters (n_parameters,) of rows that are wide of their bounds."""
        return np.tile(np.r_[np.zeros(self.size - 1), _NOTHING_NEAR], self.n)


def ranks(sample: Indices) -> Indices:
    """Return how many rows of its sample are before each (n,); the samples are in their order."""
    return np.arange(len(sample)) - np.searchsorted(sample, sample)


def _n_shares(joints: Sequence[int]) -> int:
    """Return the number of shares that choose one of these joints."""
    if len(joints) > 1:
        return len(joints)
    return 0


def _columns(bodies: Sequence[SymbolicPose], joints: Sequence[int]) -> ca.SX:
    """Return rotation and place of each of the joints (12, n) [-, m]."""
    return ca.horzcat(*(ca.vertcat(ca.vec(bodies[joint].R), bodies[joint].p) for joint in joints))


def _mixed(columns: ca.SX, shares: ca.SX) -> SymbolicPose:
    """Return the pose whose share is 1, of poses as columns (12, n)."""
    column = columns @ shares if shares.numel() else columns
    return SymbolicPose(R=ca.reshape(column[:9], 3, 3), p=column[9:])
