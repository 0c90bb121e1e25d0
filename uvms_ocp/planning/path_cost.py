"""Soft-collision cost J = l1 Js + l2 Jc + l3 Jd of a path in planned axes, [Gao2022] eqs (76)-(82),
with its gradient and its block-tridiagonal Gauss-Newton matrix.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, NamedTuple, Protocol

import numpy as np

from uvms_ocp.checks import checked_dataclass
from uvms_ocp.planning.block_tridiagonal import BlockTridiagonal
from uvms_ocp.planning.distances import NearPairs
from uvms_ocp.planning.scene import CollisionScene
from uvms_ocp.trajectories.free_derivatives import Pieces, onto_nodes
from uvms_ocp.trajectories.hermite_pieces import basis, hermite_cost
from uvms_ocp.trajectories.segment_times import MotionLimits
from uvms_ocp.types import Array, AtLeastOne, Indices, Positive, Range

_LIGHT = 0.1  # factor of the weight of snap while collisions alone are taken away


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Penalty:
    """Value, first and second derivative of a penalty by what is penalised."""

    value: Array
    """(...) [-] value."""
    slope: Array
    """(...) [1/value] first derivative."""
    curvature: Array
    """(...) [1/value^2] second derivative."""


def penalty(y: Array) -> Penalty:
    """Evaluate y^3/6 for 0 < y < 1, y^2/2 - y/2 + 1/6 above, zero below; y (...)."""
    inside = np.clip(y, 0.0, 1.0)
    beyond = np.maximum(y - 1.0, 0.0)
    return Penalty(
        value=inside**3 / 6.0 + beyond * (0.5 + 0.5 * beyond),
        slope=0.5 * inside**2 + beyond,
        curvature=inside,
    )


def two_sided(value: Array, limit: Array, margin: float) -> Penalty:
    """Penalise |value| (..., n_axes) [value] near and beyond a limit (n_axes,) [value], which may be
    infinite.

    It begins at ``(1 - margin) * limit``; margin [-].
    """
    is_unlimited = np.isinf(limit)
    width = np.where(is_unlimited, 1.0, limit) * margin
    begin = np.where(is_unlimited, np.inf, limit - width)
    p = penalty((np.abs(value) - begin) / width)
    return Penalty(
        value=p.value, slope=np.sign(value) * p.slope / width, curvature=p.curvature / width**2
    )


def outside(value: Array, lower: Array, upper: Array, margin: float) -> Penalty:
    """Penalise a value (..., n_axes) [value] nearer than ``margin`` [value] to either end of its
    range.

    lower and upper (n_axes,) [value]: ends of the range.
    """
    low = penalty((lower + margin - value) / margin)
    high = penalty((value - upper + margin) / margin)
    return Penalty(
        value=low.value + high.value,
        slope=(high.slope - low.slope) / margin,
        curvature=(high.curvature + low.curvature) / margin**2,
    )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class LinkSpeeds:
    """Speeds of links near obstacles and their derivatives, one row per near pair."""

    speed: Array
    """(n,) [m/s] speed of the link."""
    by_position: Array
    """(n, n_axes) [m/s per m or rad] derivative by the position of the axes."""
    by_rate: Array
    """(n, n_axes) [m/s per m/s or rad/s] derivative by the rates of the axes."""


def link_speeds(
    scene: CollisionScene, near_pairs: NearPairs, rates: Array, floor: float
) -> LinkSpeeds:
    """Compute speeds of the second shape of each near pair, and their derivatives.

    rates (n, n_axes) [m/s, rad/s]: of the axes at each near pair's sample; floor [m/s]: speed of a
    shape at rest.
    """
    rates = rates @ scene.fold.T
    screws = near_pairs.screws * scene.carried[near_pairs.pair][:, None, :]
    gyration = scene.gyration[near_pairs.pair, None] ** 2
    twist = (screws @ rates[..., None])[..., 0]
    linear = twist[:, :3] + _cross(twist[:, 3:], near_pairs.centre)
    angular = twist[:, 3:]
    square = np.sum(linear**2, axis=1) + gyration[:, 0] * np.sum(angular**2, axis=1) + floor**2
    speed = np.sqrt(square)
    turn = screws[:, 3:]
    shift = screws[:, :3] + _cross(turn, near_pairs.centre[..., None])
    twist_slope = _twist_slopes(screws, rates, scene.follows)
    linear_slope = (
        twist_slope[:, :3]
        + _cross(twist_slope[:, 3:], near_pairs.centre[..., None])
        + _cross(angular[..., None], shift)
    )
    weighted = gyration * angular
    by_column_position = _dot(linear, linear_slope) + _dot(weighted, twist_slope[:, 3:])
    by_column_rate = _dot(linear, shift) + _dot(weighted, turn)
    return LinkSpeeds(
        speed=speed,
        by_position=by_column_position @ scene.fold / speed[:, None],
        by_rate=by_column_rate @ scene.fold / speed[:, None],
    )


def _twist_slopes(screws: Array, rates: Array, follows: Array) -> Array:
    """Compute slopes (n, 6, n_columns) of the twist by the columns: column j turns the screws of those
    it carries, d s_k = s_j x s_k.
    """
    carried = screws @ (rates[:, None, :] * follows).transpose(0, 2, 1)
    moved = _cross(screws[:, 3:], carried[:, :3]) + _cross(screws[:, :3], carried[:, 3:])
    return np.concatenate([moved, _cross(screws[:, 3:], carried[:, 3:])], axis=1)


def _cross(a: Array, b: Array) -> Array:
    """Compute the cross product along axis 1; ``numpy.cross`` costs several times more on small
    arrays.
    """
    return np.stack(
        [
            a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1],
            a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2],
            a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0],
        ],
        axis=1,
    )


def _dot(vector: Array, matrix: Array) -> Array:
    """Multiply vectors (n, k) by matrices (n, k, l) from the left."""
    return (vector[:, None, :] @ matrix)[:, 0]


class DistanceSource(Protocol):
    """Source of signed distances: coal, or closed forms."""

    @property
    def scene(self) -> CollisionScene:
        """The pairs, and the coordinates x."""
        ...

    def near(self, x: Array, thresholds: Array) -> NearPairs:
        """Return the pairs closer than their thresholds (n_pairs,) [m] at x (n, n_axes) [m, rad]."""
        ...


@checked_dataclass()
class CostWeights:
    """Weights l1, l2, l3 of the cost, and the shape of its penalties.

    Raises `InvalidInput` for a negative weight, and unless clearance, speed floor, margin and
    samples are positive.
    """

    smoothness: Annotated[float, Range(0.0)] = 1e-3
    """Weight of the snap, in units of one rest-to-rest move by 1 m or 1 rad over the same time."""
    collision: Annotated[float, Range(0.0)] = 100.0
    """[1/m] Weight of the penalty of clearance, per metre travelled."""
    limits: Annotated[float, Range(0.0)] = 1.0
    """[1/s] Weight of the penalties of positions, velocities and accelerations beyond limits, per
    second.
    """
    clearance: Positive = 0.06
    """[m] distance where the penalty of clearance begins."""
    link_clearance: Positive | None = None
    """[m] distance of two links where the penalty of clearance begins; left out: clearance."""
    speed_floor: Positive = 0.02
    """[m/s] speed at which a link at rest counts."""
    margin: Positive = 0.1
    """Fraction of a limit, and [m or rad] distance from a position limit, where its penalty
    begins.
    """
    samples: AtLeastOne = 15
    """Samples per piece."""


class CostParts(NamedTuple):
    """Weighted parts of the cost, Js, Jc and Jd."""

    smoothness: float
    collision: float
    limits: float

    @property
    def total(self) -> float:
        return self.smoothness + self.collision + self.limits


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class LocalModel:
    """Cost, exact gradient and positive semi-definite Hessian at one trajectory, by node."""

    parts: CostParts
    """The cost."""
    gradient: Array
    """(n_nodes, k n_axes) [1/m, 1/rad] gradient."""
    hessian: BlockTridiagonal
    """Gauss-Newton matrix in blocks (k n_axes, k n_axes) [1/m2, 1/rad2] of nodes."""
    n_axes: int


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _SampleSlopes:
    """A cost and its derivatives at every sample, (samples, pieces, n_axes) where no shape is given;
    for axes that turn read rad for m.
    """

    value: float
    position: Penalty
    """Slope [1/m], and curvature [1/m2], of shape (samples, pieces, n_axes, n_axes) where axes are
    coupled.
    """
    rate: Penalty
    """Slope [s/m] and curvature [s2/m2]."""
    acceleration: Penalty
    """Slope [s2/m] and curvature [s4/m2]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PathCost:
    """The cost of trajectories over fixed pieces; variables are scaled node derivatives (n_nodes, k
    n_axes).
    """

    distances: DistanceSource
    pieces: Pieces
    weights: CostWeights
    limits: MotionLimits

    @property
    def n_axes(self) -> int:
        return self.distances.scene.coordinates.n_axes

    def variables(self, values: Array) -> Array:
        """Return scaled variables (n_nodes, k n_axes) [m, rad] from node derivatives: values (k,
        n_nodes, n_axes) [m/s^d, rad/s^d].
        """
        return (values * self._node_scale).transpose(1, 0, 2).reshape(values.shape[1], -1)

    def values(self, variables: Array) -> Array:
        """Return node derivatives (k, n_nodes, n_axes) [m/s^d, rad/s^d] from scaled variables
        (n_nodes, k n_axes) [m, rad].
        """
        return self._by_derivative(variables) / self._node_scale

    def samples(self, variables: Array) -> tuple[Array, Array, Array]:
        """Return positions, rates and accelerations at the samples, each (samples per piece,
        n_pieces, n_axes), of variables (n_nodes, k n_axes) [m, rad].
        """
        nodes = self._by_derivative(variables)
        ends = np.concatenate([nodes[:, :-1], nodes[:, 1:]]) * self.pieces.scale
        columns = ends.reshape(len(ends), -1)
        x, v, a = [np.reshape(P @ columns, (-1, *ends.shape[1:])) for P in self._bases]
        return x, v / self._h, a / self._h**2

    def model(self, variables: Array, *, collision_only: bool = False) -> LocalModel:
        """Compute cost, gradient and Gauss-Newton Hessian at variables (n_nodes, k n_axes) [m, rad].

        ``collision_only`` leaves out limits and weighs snap lightly.
        """
        if collision_only:
            limit_weight = 0.0
            smoothness_factor = _LIGHT
        else:
            limit_weight = self.weights.limits
            smoothness_factor = 1.0
        x, v, a = self.samples(variables)
        collision = self._collision(x, v)
        limits = self._limits(x, v, a, limit_weight)
        smooth = self.smoothness_hessian.scaled(smoothness_factor)
        smooth_gradient = smooth.times(variables)
        smoothness = 0.5 * float(np.sum(smooth_gradient * variables))
        return LocalModel(
            parts=CostParts(smoothness, collision.value, limits.value),
            gradient=smooth_gradient + self._gradient(collision) + self._gradient(limits),
            hessian=smooth + self._hessian(collision, limits),
            n_axes=self.n_axes,
        )

    @cached_property
    def smoothness_hessian(self) -> BlockTridiagonal:
        """Hessian of l1 Js, constant."""
        k = self.pieces.k
        total = float(np.sum(self.pieces.durations))
        factor = 2.0 * self.weights.smoothness * total ** (2 * k - 1) / hermite_cost(k)[k, k]
        unit = hermite_cost(k)[None, :, :, None, None] * np.eye(self.n_axes)
        return self._assembled(factor * self.pieces.weight[:, :, None, None, None] * unit)

    @cached_property
    def _bases(self) -> tuple[Array, ...]:
        """(samples, 2 k) basis functions at the samples, by derivative."""
        u = (np.arange(self.weights.samples) + 0.5) / self.weights.samples
        return tuple(basis(u, derivative, self.pieces.k) for derivative in range(3))

    @cached_property
    def _outer(self) -> tuple[Array, ...]:
        """(4 k^2, samples) products of basis functions, by derivative."""
        products = []
        for values in self._bases:
            outer = values[:, :, None] * values[:, None, :]
            products.append(outer.reshape(len(values), -1).T)
        return tuple(products)

    @cached_property
    def _h(self) -> Array:
        """(n_pieces, 1) [s] durations of pieces."""
        return self.pieces.durations[:, None] * self.pieces.unit

    @cached_property
    def _node_scale(self) -> Array:
        """(k, n_nodes, 1) [s^d] by which node derivatives are multiplied."""
        times = self.pieces.node_times * self.pieces.unit
        orders = np.arange(self.pieces.k)
        return times[None, :, None] ** orders[:, None, None]

    @cached_property
    def _clearances(self) -> Array:
        """(n_pairs,) [m] where each pair's penalty begins: links close by design keep half their
        distance.
        """
        scene = self.distances.scene
        return np.minimum(
            scene.per_pair(self.weights.clearance, self.weights.link_clearance), scene.room
        )

    def _by_derivative(self, variables: Array) -> Array:
        """Return variables (n_nodes, k n_axes) as (k, n_nodes, n_axes)."""
        return variables.reshape(len(variables), self.pieces.k, -1).transpose(1, 0, 2)

    def _collision(self, x: Array, v: Array) -> _SampleSlopes:
        """Compute the penalty of clearance over the way of links, with its derivatives."""
        n_samples, n_pieces, n = x.shape
        scene = self.distances.scene
        near_pairs = self.distances.near(x.reshape(-1, n), self._clearances)
        sample = near_pairs.sample
        rates = v.reshape(-1, n)[sample]
        speeds = link_speeds(scene, near_pairs, rates, self.weights.speed_floor)
        width = self._clearances[near_pairs.pair]
        c = penalty(1.0 - near_pairs.distance / width)
        dt = (self._h[:, 0] / n_samples)[sample % n_pieces]
        weight = self.weights.collision * dt
        value = weight * c.value
        by_distance = -(weight * c.slope * speeds.speed / width)
        bend = np.sqrt(weight * c.curvature * speeds.speed / width**2)
        bends = near_pairs.gradient * bend[:, None]
        slope = by_distance[:, None] * near_pairs.gradient + value[:, None] * speeds.by_position
        by_position = _summed(sample, slope, x.shape)
        by_rate = _summed(sample, value[:, None] * speeds.by_rate, x.shape)
        curvature = _summed(sample, bends[:, :, None] * bends[:, None, :], (*x.shape, n))
        zero = np.zeros_like(x)
        return _SampleSlopes(
            value=float(np.sum(value * speeds.speed)),
            position=Penalty(value=zero, slope=by_position, curvature=curvature),
            rate=Penalty(value=zero, slope=by_rate, curvature=zero),
            acceleration=Penalty(value=zero, slope=zero, curvature=zero),
        )

    def _limits(self, x: Array, v: Array, a: Array, weight: float) -> _SampleSlopes:
        """Compute the penalty of positions, rates and accelerations, with its derivatives."""
        dt = weight * np.broadcast_to(self._h / len(x), x.shape[1:])
        lower, upper = self.distances.scene.coordinates.limits()
        largest_rate, largest_acceleration, *_ = self.limits.rows(x.shape[2])
        margin = self.weights.margin
        position = _weighted(outside(x, lower, upper, margin), dt)
        rate = _weighted(two_sided(v, largest_rate, margin), dt)
        acceleration = _weighted(two_sided(a, largest_acceleration, margin), dt)
        return _SampleSlopes(
            value=float(position.value.sum() + rate.value.sum() + acceleration.value.sum()),
            position=position,
            rate=rate,
            acceleration=acceleration,
        )

    def _gradient(self, slopes: _SampleSlopes) -> Array:
        """Return the gradient (n_nodes, k n_axes) by the variables."""
        by_position = slopes.position.slope
        by_rate = slopes.rate.slope / self._h
        by_acceleration = slopes.acceleration.slope / self._h**2
        n_samples, *shape = by_position.shape
        P, P_rate, P_acceleration = self._bases
        by_end = (
            P.T @ by_position.reshape(n_samples, -1)
            + P_rate.T @ by_rate.reshape(n_samples, -1)
            + P_acceleration.T @ by_acceleration.reshape(n_samples, -1)
        )
        ends = np.reshape(by_end, (2 * self.pieces.k, *shape)) * self.pieces.scale
        nodes = onto_nodes(ends, self.pieces.k)
        return nodes.transpose(1, 0, 2).reshape(nodes.shape[1], -1)

    def _hessian(self, collision: _SampleSlopes, limits: _SampleSlopes) -> BlockTridiagonal:
        """Return the Gauss-Newton matrix of both costs in blocks of nodes."""
        k2 = 2 * self.pieces.k
        n_samples, n_pieces, n = collision.position.slope.shape
        products, rate_products, acceleration_products = self._outer
        coupled = products @ collision.position.curvature.reshape(n_samples, -1)
        by_rate = limits.rate.curvature / self._h**2
        by_acceleration = limits.acceleration.curvature / self._h**4
        single = (
            products @ limits.position.curvature.reshape(n_samples, -1)
            + rate_products @ by_rate.reshape(n_samples, -1)
            + acceleration_products @ by_acceleration.reshape(n_samples, -1)
        )
        blocks = coupled.reshape(k2, k2, n_pieces, n, n).transpose(2, 0, 1, 3, 4)
        diagonals = single.reshape(k2, k2, n_pieces, n).transpose(2, 0, 1, 3)
        axes = np.arange(n)
        blocks[..., axes, axes] += diagonals
        return self._assembled(blocks)

    def _assembled(self, unit: Array) -> BlockTridiagonal:
        """Return node blocks from unit-interval piece blocks (n_pieces, 2k, 2k, n_axes, n_axes)."""
        k = self.pieces.k
        scale = self.pieces.scale[..., 0].T
        scales = scale[:, :, None] * scale[:, None, :]
        rows = (unit * scales[..., None, None]).transpose(0, 1, 3, 2, 4)
        n_pieces = unit.shape[0]
        size = k * unit.shape[3]
        first_node = rows[:, :k, :, :k].reshape(n_pieces, size, size)
        second_node = rows[:, k:, :, k:].reshape(n_pieces, size, size)
        below = rows[:, k:, :, :k].reshape(n_pieces, size, size)
        diagonal = np.zeros((n_pieces + 1, size, size))
        diagonal[:-1] += first_node
        diagonal[1:] += second_node
        return BlockTridiagonal(diagonal=diagonal, below=below)


def _weighted(p: Penalty, weight: Array) -> Penalty:
    return Penalty(value=p.value * weight, slope=p.slope * weight, curvature=p.curvature * weight)


def _summed(sample: Indices, rows: Array, shape: tuple[int, ...]) -> Array:
    """Add up rows by sample (in ascending order), and lay the sums out as (samples, pieces,
    ...).
    """
    result = np.zeros((shape[0] * shape[1], *rows.shape[1:]))
    if sample.size:
        first = np.flatnonzero(np.diff(sample, prepend=-1))
        result[sample[first]] = np.add.reduceat(rows, first, axis=0)
    return result.reshape(shape)
