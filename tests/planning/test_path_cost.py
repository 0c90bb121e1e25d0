"""Laws of collision costs: penalties, speeds of links, gradients and Hessians."""

from __future__ import annotations

import numpy as np
import pytest
from curves.closed_forms import ClosedFormDistances, collision_density, density_hessian
from planned_scenes import N, differences, random_x

from uvms_ocp.planning.block_tridiagonal import BlockTridiagonal
from uvms_ocp.planning.distances import CoalDistances
from uvms_ocp.planning.path_cost import (
    CostWeights,
    DistanceSource,
    PathCost,
    link_speeds,
    outside,
    penalty,
    two_sided,
)
from uvms_ocp.planning.scene import CollisionScene
from uvms_ocp.trajectories.free_derivatives import pieces_of
from uvms_ocp.trajectories.segment_times import MotionLimits


def test_the_penalty_is_twice_differentiable_and_convex() -> None:
    y = np.linspace(-0.5, 3.0, 701)
    h = 1e-6
    up = penalty(y + h)
    here = penalty(y)
    down = penalty(y - h)
    np.testing.assert_allclose(here.slope, (up.value - down.value) / (2 * h), atol=1e-8)
    np.testing.assert_allclose(here.curvature, (up.slope - down.slope) / (2 * h), atol=1e-6)
    assert (here.curvature >= 0.0).all()


def test_limit_penalties_match_their_differences_on_both_sides() -> None:
    v = np.linspace(-2.0, 2.0, 401)
    h = 1e-6
    for f in (
        lambda z: two_sided(z, np.array(1.0), 0.2),
        lambda z: outside(z, np.array(-1.0), np.array(0.5), 0.1),
    ):
        np.testing.assert_allclose(
            f(v).slope, (f(v + h).value - f(v - h).value) / (2 * h), atol=1e-6
        )
        np.testing.assert_allclose(
            f(v).curvature, (f(v + h).slope - f(v - h).slope) / (2 * h), atol=1e-3
        )
    assert two_sided(np.array([1e9]), np.array([np.inf]), 0.1).value == 0.0


def test_speeds_of_links_match_differences(scene: CollisionScene) -> None:
    distances = CoalDistances(scene)
    thresholds = np.full(scene.n_pairs, 10.0)
    x = random_x(scene.coordinates, 1)[0]
    v = 0.3 * np.random.default_rng(1).normal(size=N)

    def speeds(z: np.ndarray, rates: np.ndarray) -> np.ndarray:
        near = distances.near(z[None], thresholds)
        return link_speeds(scene, near, np.tile(rates, (near.sample.size, 1)), 0.02).speed

    near = distances.near(x[None], thresholds)
    found = link_speeds(scene, near, np.tile(v, (near.sample.size, 1)), 0.02)
    np.testing.assert_allclose(
        found.by_position, differences(lambda z: speeds(z, v), x, 1e-6).T, atol=1e-7
    )
    np.testing.assert_allclose(
        found.by_rate, differences(lambda z: speeds(x, z), v, 1e-6).T, atol=1e-7
    )


def cost_of(distances: DistanceSource, weights: CostWeights) -> tuple[PathCost, np.ndarray]:
    rng = np.random.default_rng(3)
    n_pieces = 4
    pieces = pieces_of(rng.uniform(1.0, 2.0, n_pieces), 4)
    limits = MotionLimits(velocity=0.3, acceleration=0.5)
    cost = PathCost(distances=distances, pieces=pieces, weights=weights, limits=limits)
    values = 0.1 * rng.normal(size=(4, n_pieces + 1, N))
    values[0] += (
        random_x(distances.scene.coordinates, 1)[0] + np.linspace(0, 0.5, n_pieces + 1)[:, None]
    )
    return cost, cost.variables(values)


@pytest.mark.slow
@pytest.mark.parametrize(
    "weights",
    [
        CostWeights(smoothness=1e-6, collision=0.0, limits=0.0),
        CostWeights(smoothness=0.0, collision=100.0, limits=0.0, clearance=0.3),
        CostWeights(smoothness=0.0, collision=0.0, limits=1.0),
    ],
    ids=["smoothness", "collision", "limits"],
)
def test_each_part_of_the_gradient_matches_differences(
    capsule_scene: CollisionScene, weights: CostWeights
) -> None:
    cost, y = cost_of(ClosedFormDistances(capsule_scene), weights)
    found = cost.model(y)
    assert found.parts.total > 0.0
    slopes = differences(lambda z: cost.model(z).parts.total, y, 1e-6).reshape(y.shape)
    np.testing.assert_allclose(found.gradient, slopes, atol=1e-6 * np.abs(slopes).max())


def test_the_gradient_with_coal_matches_differences(scene: CollisionScene) -> None:
    cost, y = cost_of(CoalDistances(scene), CostWeights(clearance=0.3, smoothness=1e-6))
    found = cost.model(y)
    rng = np.random.default_rng(0)
    for _ in range(20):
        step = 1e-5 * rng.normal(size=y.shape)
        slope = cost.model(y + step).parts.total - cost.model(y - step).parts.total
        assert slope == pytest.approx(
            2.0 * np.sum(found.gradient * step), rel=1e-4, abs=1e-7 * np.abs(found.gradient).max()
        )


def test_the_hessian_of_the_optimiser_is_positive_semi_definite(
    capsule_scene: CollisionScene,
) -> None:
    cost, y = cost_of(ClosedFormDistances(capsule_scene), CostWeights(clearance=0.3))
    eigenvalues = np.linalg.eigvalsh(cost.model(y).hessian.dense())
    assert eigenvalues[0] > -1e-10 * eigenvalues[-1]


@pytest.mark.slow
def test_the_exact_hessian_of_the_collision_cost_matches_differences(
    capsule_scene: CollisionScene,
) -> None:
    weights = CostWeights(clearance=0.3)
    hessian = density_hessian(collision_density(capsule_scene, weights))
    x = random_x(capsule_scene.coordinates, 3)
    v = 0.3 * np.random.default_rng(1).normal(size=x.shape)
    for z in np.concatenate([x, v], axis=1):
        blocks, slope = hessian(z)
        found = np.asarray(blocks)
        slopes = differences(lambda y: np.asarray(hessian(y)[1]).ravel(), z, 1e-6)
        assert np.abs(found).max() > 0.0
        np.testing.assert_allclose(found, slopes, atol=1e-6 * np.abs(found).max())
        assert slope.shape == (2 * N, 1)


def test_the_collision_cost_equals_its_closed_form(capsule_scene: CollisionScene) -> None:
    weights = CostWeights(clearance=0.3, smoothness=0.0, limits=0.0)
    cost, y = cost_of(ClosedFormDistances(capsule_scene), weights)
    x, v, _ = cost.samples(y)
    density = collision_density(capsule_scene, weights)
    h = cost.pieces.durations * cost.pieces.unit / weights.samples
    total = sum(
        h[j] * float(density(x[i, j], v[i, j]))
        for i in range(weights.samples)
        for j in range(len(h))
    )
    assert cost.model(y).parts.collision == pytest.approx(total, rel=1e-9)


def test_a_block_tridiagonal_solve_is_the_dense_one() -> None:
    rng = np.random.default_rng(0)
    A = rng.normal(size=(6, 4, 4))
    matrix = BlockTridiagonal(
        diagonal=A @ A.transpose(0, 2, 1) + 20 * np.eye(4), below=rng.normal(size=(5, 4, 4))
    )
    right = rng.normal(size=(6, 4))
    factor = matrix.cholesky()
    assert factor is not None
    np.testing.assert_allclose(
        factor.solve(right).ravel(), np.linalg.solve(matrix.dense(), right.ravel()), rtol=1e-10
    )
    np.testing.assert_allclose(
        matrix.times(right).ravel(), matrix.dense() @ right.ravel(), rtol=1e-12
    )
    indefinite = BlockTridiagonal(diagonal=-np.ones((2, 1, 1)), below=np.zeros((1, 1, 1)))
    assert indefinite.cholesky() is None
