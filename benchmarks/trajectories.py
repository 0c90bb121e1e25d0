"""Trajectories in one run: ``python benchmarks/trajectories.py [--quick] [--peer PYTHON]``.

Writes ``results/trajectories.csv``, one row per measurement: problem, solver, quantity, value, target, versions and
machine; and beside it the same as a report, ``trajectories.md``. ``--peer`` is a Python that has
``minsnap_trajectories``, timed in its own process.
"""

from __future__ import annotations

import argparse
import csv
import os
import platform
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import astuple, dataclass, fields
from importlib.metadata import version
from pathlib import Path
from time import perf_counter, process_time

import numpy as np
from closed_forms import ClosedFormDistances, collision_density, density_hessian
from trajectory_scenes import N_SCENES, Problem, problem

from uvms_ocp.arrays import Array
from uvms_ocp.collision.capsules import capsule_robot
from uvms_ocp.collision.coal_distances import CoalDistances
from uvms_ocp.model.loading import load_robot
from uvms_ocp.planning.path_cost import CostWeights, PathCost
from uvms_ocp.planning.soft_collision import CollisionPlan, plan_soft_collision
from uvms_ocp.trajectories.free_derivatives import pieces_of
from uvms_ocp.trajectories.min_snap import MinSnap, min_snap
from uvms_ocp.trajectories.qp_form import min_snap_qp
from uvms_ocp.trajectories.segment_times import MotionLimits
from uvms_ocp.trajectories.specification import CurveSpecification

PEER = """
import numpy as np, time, minsnap_trajectories as ms
rng = np.random.default_rng(0)
W = rng.normal(size=(101, 3)); T = np.concatenate([[0.0], np.cumsum(rng.uniform(1.0, 3.0, 100))])
points = [ms.Waypoint(time=t, position=w) for t, w in zip(T, W)]
zero = np.zeros(3)
for i in (0, -1):
    points[i] = ms.Waypoint(time=T[i], position=W[i], velocity=zero, acceleration=zero, jerk=zero)
best = 1e9
for _ in range(5):
    t = time.perf_counter()
    ms.generate_trajectory(points, degree=7, idx_minimized_orders=4, num_continuous_orders=4)
    best = min(best, time.perf_counter() - t)
print(best)
"""


@dataclass(frozen=True, kw_only=True, slots=True)
class Row:
    """One measurement."""

    problem: str
    solver: str
    quantity: str
    value: float
    target: str = ""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="five scenes instead of fifty")
    parser.add_argument("--peer", help="Python that has minsnap_trajectories")
    parser.add_argument("--output", type=Path, default=Path(__file__).parent / "results" / "trajectories.csv")
    arguments = parser.parse_args()
    rows = [
        *min_snap_rows(),
        *peer_rows(arguments.peer),
        *gradient_rows(),
        *plan_rows(5 if arguments.quick else N_SCENES, closed_forms=False),
        *plan_rows(5 if arguments.quick else N_SCENES, closed_forms=True),
    ]
    write(rows, arguments.output)


def min_snap_rows() -> Iterator[Row]:
    long = []
    for n, repeats in ((1, 100), (10, 100), (100, 300), (1_000, 50), (10_000, 10), (100_000, 10)):
        waypoints, times = random_problem(n)
        seconds = best_of(lambda w=waypoints, t=times: min_snap(w, t), repeats)
        name, found = f"min snap {n} x 3", min_snap(waypoints, times)
        target = "300" if n == 100_000 else ""
        yield Row(problem=name, solver="banded", quantity="time [ms]", value=1e3 * seconds, target=target)
        yield Row(problem=name, solver="banded", quantity="time per piece [us]", value=1e6 * seconds / n)
        met = np.abs(found.trajectory.evaluate(times) - waypoints).max()
        yield Row(problem=name, solver="banded", quantity="way point error", value=float(met), target="1e-10")
        if n > 1:
            yield Row(problem=name, solver="banded", quantity="largest jump", value=largest_jump(found), target="1e-8")
        if n == 100_000:
            busy = best_of(lambda w=waypoints, t=times: min_snap(w, t), repeats, process_time)
            yield Row(problem=name, solver="banded", quantity="processor time [ms]", value=1e3 * busy)
        long += [seconds / n] if n >= 1_000 else []
    ratio, name = max(long) / min(long), "min snap 1,000 to 100,000 x 3"
    yield Row(problem=name, solver="banded", quantity="largest by least time per piece", value=ratio, target="2")
    for unit in (1e-3, 1.0, 1e3):
        waypoints, _ = random_problem(100)
        jump = largest_jump(min_snap(waypoints, unit * np.arange(101)))
        yield Row(problem=f"uniform {unit:g} s", solver="banded", quantity="largest jump", value=jump, target="1e-8")
    yield closed_form_row()
    yield qp_row()


def closed_form_row() -> Row:
    found = min_snap([0.0, 1.0], [0.0, 1.0]).trajectory.coefficients[:, 0, 0]
    error = float(np.abs(found - [0, 0, 0, 0, 35, -84, 70, -20]).max())
    return Row(problem="rest to rest", solver="banded", quantity="coefficient error", value=error, target="1e-12")


def qp_row() -> Row:
    waypoints, times = random_problem(30)
    a, b = min_snap(waypoints, times).node_derivatives, min_snap_qp(waypoints, times).node_derivatives
    error = float(np.abs(a - b).max() / np.abs(a).max())
    return Row(problem="min snap 30 x 3", solver="qrqp", quantity="difference from banded", value=error, target="1e-8")


def peer_rows(python: str | None) -> Iterator[Row]:
    if python is None:
        return
    run = subprocess.run([python, "-c", PEER], capture_output=True, text=True, check=True)
    theirs = float(run.stdout)
    waypoints, times = random_problem(100)
    mine = best_of(lambda: min_snap(waypoints, times), 300)
    name = "min snap 100 x 3"
    yield Row(problem=name, solver="minsnap_trajectories", quantity="time [ms]", value=1e3 * theirs)
    yield Row(problem=name, solver="banded", quantity="times faster than peer", value=theirs / mine, target="300")


def gradient_rows() -> Iterator[Row]:
    """Largest error of every gradient and Hessian block against central differences, relative to its largest entry."""
    for k in (2, 3, 4):
        for name, error in min_snap_gradient_errors(k).items():
            yield Row(problem=f"k = {k}", solver="envelope", quantity=f"gradient error: {name}", value=error)
    scene = problem(0, robot=capsule_robot(load_robot("girona_maris7"))).scene
    parts = {
        "smoothness": CostWeights(smoothness=1e-6, collision=0.0, limits=0.0),
        "collision": CostWeights(smoothness=0.0, limits=0.0, clearance=0.3),
        "limits": CostWeights(smoothness=0.0, collision=0.0),
    }
    for name, weights in parts.items():
        for solver in (ClosedFormDistances(scene), CoalDistances(scene)):
            cost, y = random_cost(solver, weights)
            steps = np.random.default_rng(0).normal(size=(40, *y.shape))
            slopes = [directional(lambda z, c=cost: c.model(z).parts.total, y, s) for s in steps]
            found = np.tensordot(steps, cost.model(y).gradient, axes=2)
            error = relative_error(found, np.array(slopes))
            yield Row(problem=name, solver=type(solver).__name__, quantity="gradient error", value=error)
        eigenvalues = np.linalg.eigvalsh(cost.model(y).hessian.dense())
        least = float(eigenvalues[0] / eigenvalues[-1])
        yield Row(
            problem=name, solver="Gauss-Newton", quantity="least eigenvalue, relative", value=least, target="-1e-10"
        )
    yield Row(problem="collision", solver="exact", quantity="Hessian error", value=exact_hessian_error(scene))


def plan_rows(n_scenes: int, *, closed_forms: bool) -> Iterator[Row]:
    robot = load_robot("girona_maris7")
    solver = "closed forms" if closed_forms else "coal"
    problems = [problem(seed, robot=capsule_robot(robot) if closed_forms else robot) for seed in range(n_scenes)]
    plans, busy = [], []
    for item in problems:
        began = process_time()
        plans.append(planned(item, closed_forms))
        busy.append(process_time() - began)
    seconds = np.array([plan.solve_time for plan in plans])
    name = f"{n_scenes} scenes, 13 axes, 10 pieces"
    targets = ("0.15", "") if closed_forms else ("0.3", "0.6")
    pairs = float(np.median([item.scene.n_pairs for item in problems]))
    false = sum(collides(item, plan) for item, plan in zip(problems, plans, strict=True) if plan.collision_free)
    yield Row(problem=name, solver=solver, quantity="median pairs", value=pairs, target="30")
    yield Row(
        problem=name, solver=solver, quantity="median time [s]", value=float(np.median(seconds)), target=targets[0]
    )
    yield Row(problem=name, solver=solver, quantity="largest time [s]", value=float(seconds.max()), target=targets[1])
    yield Row(problem=name, solver=solver, quantity="median processor time [s]", value=float(np.median(busy)))
    yield Row(problem=name, solver=solver, quantity="largest processor time [s]", value=max(busy))
    free = float(np.mean([plan.collision_free for plan in plans]))
    yield Row(problem=name, solver=solver, quantity="success", value=free, target="0.95")
    yield Row(problem=name, solver=solver, quantity="falsely free", value=float(false), target="0")
    tries = float(np.mean([plan.attempts == 1 for plan in plans]))
    yield Row(problem=name, solver=solver, quantity="success at first attempt", value=tries)


def planned(item: Problem, closed_forms: bool) -> CollisionPlan:
    robot = item.scene.coordinates.robot
    limits = MotionLimits(velocity=robot.limits.velocity, acceleration=robot.limits.acceleration)
    distances = ClosedFormDistances(item.scene) if closed_forms else None
    return plan_soft_collision(item.scene, item.ends, limits=limits, distances=distances)


def collides(item: Problem, plan: CollisionPlan) -> bool:
    """Ten times denser than the samples of the optimisation."""
    t = np.linspace(plan.trajectory.start, plan.trajectory.end, 1501)
    return bool(CoalDistances(item.scene).distances(plan.trajectory.evaluate(t)).min() <= 0.0)


def random_problem(n: int) -> tuple[Array, Array]:
    rng = np.random.default_rng(0)
    return rng.normal(size=(n + 1, 3)), np.concatenate([[0.0], np.cumsum(rng.uniform(1.0, 3.0, n))])


def largest_jump(found: MinSnap) -> float:
    curve = found.trajectory
    return max(float(np.abs(curve.jumps(d)).max() / curve.peak(d).max()) for d in range(7))


def min_snap_gradient_errors(k: int) -> dict[str, float]:
    waypoints, times = random_problem(8)
    specification = CurveSpecification(derivative=k)
    gradients = min_snap(waypoints, times, specification).gradients()
    steps = np.random.default_rng(0).normal(size=(20, *waypoints.shape))
    by_point = [directional(lambda w: min_snap(w, times, specification).cost, waypoints, s) for s in steps]
    by_time = [directional(lambda t: min_snap(waypoints, t, specification).cost, times, s[:, 0]) for s in steps]
    return {
        "way points": relative_error(np.tensordot(steps, gradients.waypoints, axes=2), np.array(by_point)),
        "times": relative_error(steps[:, :, 0] @ gradients.times, np.array(by_time)),
    }


def random_cost(distances: CoalDistances | ClosedFormDistances, weights: CostWeights) -> tuple[PathCost, Array]:
    rng, planned_axes = np.random.default_rng(3), distances.scene.coordinates
    pieces = pieces_of(rng.uniform(1.0, 2.0, 4), 4)
    limits = MotionLimits(velocity=0.3, acceleration=0.5)
    cost = PathCost(distances=distances, pieces=pieces, weights=weights, limits=limits)
    values = 0.1 * rng.normal(size=(4, 5, planned_axes.n_axes))
    values[0] += planned_axes.x(planned_axes.robot.configuration()) + np.linspace(0.0, 0.5, 5)[:, None]
    return cost, cost.variables(values)


def exact_hessian_error(scene: object) -> float:
    hessian = density_hessian(collision_density(scene, CostWeights(clearance=0.3)))
    rng = np.random.default_rng(0)
    home = scene.coordinates.x(scene.coordinates.robot.configuration())
    worst = 0.0
    for _ in range(5):
        z = np.concatenate([home + 0.1 * rng.normal(size=home.size), 0.3 * rng.normal(size=home.size)])
        slopes = [directional(lambda y: np.asarray(hessian(y)[1]).ravel(), z, s, 1e-6) for s in np.eye(z.size)]
        worst = max(worst, relative_error(np.asarray(hessian(z)[0]), np.array(slopes)))
    return worst


def directional(f: Callable[[Array], Array | float], x: Array, step: Array, h: float = 1e-5) -> Array:
    return (np.asarray(f(x + h * step)) - np.asarray(f(x - h * step))) / (2.0 * h)


def relative_error(found: Array, expected: Array) -> float:
    return float(np.abs(found - expected).max() / np.abs(expected).max())


def best_of(call: Callable[[], object], repeats: int, clock: Callable[[], float] = perf_counter) -> float:
    seconds = []
    for _ in range(repeats):
        began = clock()
        call()
        seconds.append(clock() - began)
    return min(seconds)


def write(rows: list[Row], path: Path) -> None:
    packages = " ".join(f"{name} {version(name)}" for name in ("numpy", "scipy", "casadi", "pin", "coal"))
    machine = f"{platform.machine()} {platform.system()} Python {platform.python_version()} {packages}"
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow([*(field.name for field in fields(Row)), "machine"])
        table.writerows([*astuple(row), machine] for row in rows)
    path.with_suffix(".md").write_text(report(rows, machine))
    for row in rows:
        sys.stdout.write(f"{row.problem:32} {row.solver:22} {row.quantity:32} {row.value:12.4g}  {row.target}\n")


def report(rows: list[Row], machine: str) -> str:
    load, cores = os.getloadavg()[0], os.cpu_count() or 1
    facts = (
        f"`python benchmarks/trajectories.py`; {machine}, {cores} cores, load average {load:.1f} at the end of the run. "
        "Times are the best of several for minimum snap, and of one run per scene for plans, wall clock unless named "
        "otherwise. Errors of gradients and Hessians are the largest differences from central differences, relative "
        "to the largest entry."
    )
    if load > cores:
        facts += (
            " The machine was overloaded: wall times and their ratios, the one to the peer too, say little about the "
            "targets; processor times and errors hold."
        )
    lines = [
        *("# Trajectories", "", facts, ""),
        "| problem | solver | quantity | value | target |",
        "|---|---|---|---|---|",
        *(f"| {row.problem} | {row.solver} | {row.quantity} | {row.value:.3g} | {row.target} |" for row in rows),
    ]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
