"""Clearance of a robot's shapes from obstacles, as rows of an optimal control problem."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
import pinocchio as pin

from uvms_ocp.collision.capsules import (
    capsule_of,
    cover,
    segment_distance,
    symbolic_segment_distance,
)
from uvms_ocp.collision.collision_scene import CollisionScene
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.robot import Robot
from uvms_ocp.ocp.terms import At, StageSymbols, Term
from uvms_ocp.tasks.task import Residual, bounded_residual

_N_CAPSULE = 3 + 3 + 1  # ends, radius
_MOST_PAIRS = 600  # beyond it the functions of a step take longer to build than a plan to find


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PlacedCapsule:
    """A segment with a radius around it, fixed to a joint."""

    joint: int
    """0 for the world."""
    p0: np.ndarray
    """(3,) [m] one end, in the frame of the joint."""
    p1: np.ndarray
    """(3,) [m] the other end."""
    radius: float
    """[m]"""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class CapsuleClearance(Term):
    """Pairs of capsules stay `margin` apart: one row per pair, signed distance [m] >= 0. See `capsule_clearance`."""

    at: At = At.PATH
    pairs: tuple[tuple[PlacedCapsule, PlacedCapsule], ...]
    names: tuple[str, ...]
    """Of the two shapes that each pair covers, as in `CollisionScene.pairs`."""
    margin: float
    """[m]"""

    @property
    def name(self) -> str:
        return "clearance"

    def residual(self, stage: StageSymbols, parameters: ca.SX) -> Residual:
        places = dict(zip(map(id, self._in_world), ca.vertsplit(parameters[:-1], _N_CAPSULE), strict=True))
        poses, gaps = stage.tick.kinematics.joint_poses, []
        for pair in self.pairs:
            ends, radii = [], []
            for item in pair:
                place = places.get(id(item), ca.DM([*item.p0, *item.p1, item.radius]))
                pose = poses[item.joint]
                ends += [pose.p + pose.R @ place[:3], pose.p + pose.R @ place[3:6]]
                radii.append(place[6])
            gaps.append(symbolic_segment_distance(*ends) - radii[0] - radii[1] - parameters[-1])
        return bounded_residual(ca.vertcat(ca.SX(0, 1), *gaps), lower=0.0)

    @property
    def _in_world(self) -> tuple[PlacedCapsule, ...]:
        """Each once, in the order of the pairs."""
        return tuple({id(item): item for pair in self.pairs for item in pair if item.joint == 0}.values())

    def n_parameters(self, robot: Robot) -> int:
        return _N_CAPSULE * len(self._in_world) + 1

    def reference(self, t: float) -> np.ndarray:
        """Ends and radius of every capsule in the world, and the margin [m]; the same at all times t [s]."""
        return np.concatenate([*((*item.p0, *item.p1, item.radius) for item in self._in_world), [self.margin]])


def capsule_clearance(scene: CollisionScene, *, margin: float) -> CapsuleClearance:
    """All pairs of a link and an obstacle of a scene, with shapes covered by capsules: they stay `margin` [m] apart.

    Pairs of links are left out: their capsules, wider than the links, overlap in many postures. Raises `InvalidInput` for
    a margin that is negative or not finite, obstacles that are not spheres, capsules, cylinders or boxes, and too many pairs.
    """
    if not (np.isfinite(margin) and margin >= 0):
        raise InvalidInput(f"clearance is {margin} m; give a finite number >= 0")
    covers = [_covered(item) for item in scene.geometry.geometryObjects]
    named = [
        ((link, other), pair.name)
        for pair in scene.pairs
        if scene.is_obstacle(pair.first)
        for other in covers[pair.first]
        for link in covers[pair.second]
    ]
    pairs, names = tuple(pair for pair, _ in named), tuple(name for _, name in named)
    if len(pairs) > _MOST_PAIRS:
        most = max(range(len(covers)), key=lambda i: len(covers[i]))
        raise InvalidInput(
            f"{len(pairs)} pairs of capsules, {len(covers[most])} of which cover "
            f"{scene.geometry.geometryObjects[most].name!r}, are more than {_MOST_PAIRS}; give fewer or less flat obstacles"
        )
    return CapsuleClearance(pairs=pairs, names=names, margin=margin)


def nearest_capsules(clearance: CapsuleClearance, robot: Robot, q: np.ndarray) -> tuple[float, str]:
    """Signed distance [m] and shapes of the pair of capsules that are nearest at q (n_q,) [m, rad]; there must be a pair."""
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, q)
    ends = [
        np.array(
            [data.oMi[pair[side].joint].act(p) for pair in clearance.pairs for p in (pair[side].p0, pair[side].p1)]
        )
        for side in (0, 1)
    ]
    (a0, a1), (b0, b1) = ((points[::2], points[1::2]) for points in ends)
    radii = np.array([first.radius + second.radius for first, second in clearance.pairs])
    gaps = segment_distance(a0, a1, b0, b1).distance - radii
    nearest = int(np.argmin(gaps))
    return float(gaps[nearest]), clearance.names[nearest]


def _covered(item: pin.GeometryObject) -> list[PlacedCapsule]:
    try:
        return [_placed(item.parentJoint, item.placement * X, shape) for X, shape in cover(item.geometry)]
    except InvalidInput:
        kind = type(item.geometry).__name__
        raise InvalidInput(
            f"{item.name!r} is a {kind}; optimal control keeps clear of spheres, capsules, cylinders and boxes only"
        ) from None


def _placed(joint: int, X: pin.SE3, shape: object) -> PlacedCapsule:
    capsule = capsule_of(shape)
    p0, p1 = (X.act(np.array([0.0, 0.0, side * capsule.half_length])) for side in (-1, 1))
    return PlacedCapsule(joint=joint, p0=p0, p1=p1, radius=capsule.radius)
