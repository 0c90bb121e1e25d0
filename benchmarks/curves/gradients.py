"""Gradients and Hessians against central differences, relative to the largest entry."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from recording.report import Row

from curves.capsules import capsule_robot
from curves.closed_forms import ClosedFormDistances, collision_density, density_hessian
from curves.figure import figure
from curves.scenes import problem
from curves.shortest import random_problem
from uvms_ocp.planning.distances import CoalDistances
from uvms_ocp.planning.path_cost import CostWeights, PathCost
from uvms_ocp.planning.scene import CollisionScene
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.trajectories.curve_conditions import CurveSpecification
from uvms_ocp.trajectories.free_derivatives import pieces_of
from uvms_ocp.trajectories.min_snap import min_snap
from uvms_ocp.trajectories.segment_times import MotionLimits
from uvms_ocp.types import Array

Distances = CoalDistances | ClosedFormDistances
PARTS = {
    "smoothness": CostWeights(smoothness=1e-6, collision=0.0, limits=0.0),
    "collision": CostWeights(smoothness=0.0, limits=0.0, clearance=0.3),
    "limits": CostWeights(smoothness=0.0, collision=0.0),
}


def gradient_rows() -> Iterator[Row]:
    """Every gradient and every block of a Hessian."""
    for k in (2, 3, 4):
        for name, error in _min_snap_errors(k).items():
            yield figure(f"k = {k}", "envelope", f"gradient error: {name}", error)
    scene = problem(0, robot=capsule_robot(load_robot("girona_maris7"))).scene
    for name, weights in PARTS.items():
        yield from _cost_rows(name, scene, weights)
    yield figure("collision", "exact", "Hessian error", _exact_hessian_error(scene))


def _cost_rows(name: str, scene: CollisionScene, weights: CostWeights) -> Iterator[Row]:
    solvers: tuple[Distances, ...] = (ClosedFormDistances(scene), CoalDistances(scene))
    for solver in solvers:
        cost, y = _random_cost(solver, weights)
        yield figure(name, type(solver).__name__, "gradient error", _cost_error(cost, y))
    eigenvalues = np.linalg.eigvalsh(cost.model(y).hessian.dense())
    ratio = eigenvalues[0] / eigenvalues[-1]
    yield figure(name, "Gauss-Newton", "least eigenvalue, relative", ratio, "-1e-10")


def _cost_error(cost: PathCost, y: Array) -> float:
    steps = np.random.default_rng(0).normal(size=(40, *y.shape))
    slopes = [_directional(lambda z: cost.model(z).parts.total, y, s) for s in steps]
    return _relative_error(np.tensordot(steps, cost.model(y).gradient, axes=2), np.array(slopes))


def _min_snap_errors(k: int) -> dict[str, float]:
    waypoints, times = random_problem(8)
    specification = CurveSpecification(derivative=k)
    gradients = min_snap(waypoints, times, specification).gradients()
    steps = np.random.default_rng(0).normal(size=(20, *waypoints.shape))

    def cost_of_points(points: Array) -> float:
        return min_snap(points, times, specification).cost

    def cost_of_times(node_times: Array) -> float:
        return min_snap(waypoints, node_times, specification).cost

    point_slopes = [_directional(cost_of_points, waypoints, step) for step in steps]
    time_slopes = [_directional(cost_of_times, times, step[:, 0]) for step in steps]
    by_points = np.tensordot(steps, gradients.waypoints, axes=2)
    by_times = steps[:, :, 0] @ gradients.times
    return {
        "way points": _relative_error(by_points, np.array(point_slopes)),
        "times": _relative_error(by_times, np.array(time_slopes)),
    }


def _random_cost(distances: Distances, weights: CostWeights) -> tuple[PathCost, Array]:
    rng = np.random.default_rng(3)
    axes = distances.scene.coordinates
    pieces = pieces_of(rng.uniform(1.0, 2.0, 4), 4)
    limits = MotionLimits(velocity=0.3, acceleration=0.5)
    cost = PathCost(distances=distances, pieces=pieces, weights=weights, limits=limits)
    values = 0.1 * rng.normal(size=(4, 5, axes.n_axes))
    values[0] += axes.x(axes.robot.configuration()) + np.linspace(0.0, 0.5, 5)[:, None]
    return cost, cost.variables(values)


def _exact_hessian_error(scene: CollisionScene) -> float:
    hessian = density_hessian(collision_density(scene, CostWeights(clearance=0.3)))
    rng = np.random.default_rng(0)
    home = scene.coordinates.x(scene.coordinates.robot.configuration())

    def gradient(z: Array) -> Array:
        return np.asarray(hessian(z)[1]).ravel()

    worst = 0.0
    for _ in range(5):
        x = home + 0.1 * rng.normal(size=home.size)
        v = 0.3 * rng.normal(size=home.size)
        z = np.concatenate([x, v])
        slopes = [_directional(gradient, z, direction, 1e-6) for direction in np.eye(z.size)]
        worst = max(worst, _relative_error(np.asarray(hessian(z)[0]), np.array(slopes)))
    return worst


def _directional(
    f: Callable[[Array], Array | float], x: Array, step: Array, h: float = 1e-5
) -> Array:
    difference: Array = (np.asarray(f(x + h * step)) - np.asarray(f(x - h * step))) / (2.0 * h)
    return difference


def _relative_error(computed: Array, expected: Array) -> float:
    return float(np.abs(computed - expected).max() / np.abs(expected).max())
