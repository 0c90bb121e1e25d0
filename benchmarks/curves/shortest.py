"""Minimum snap: times over the number of pieces, errors against what is known, and a peer."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from recording.processes import run_script
from recording.report import Row
from recording.timing import Timed, timed

from curves.figure import figure
from uvms_ocp.trajectories.coefficient_qp import min_snap_qp
from uvms_ocp.trajectories.min_snap import MinSnap, min_snap
from uvms_ocp.types import Array

OURS = "banded"
SIZES = (1, 10, 100, 1_000, 10_000, 100_000)
LONG = 1_000
"""Pieces from which the time per piece should stay the same."""
WITH_PEER = 100
"""Pieces of the problem that the peer gets too."""


def random_problem(n: int) -> tuple[Array, Array]:
    """Way points (n + 1, 3) [m] and their times (n + 1,) [s]."""
    rng = np.random.default_rng(0)
    waypoints = rng.normal(size=(n + 1, 3))
    durations = rng.uniform(1.0, 3.0, n)
    return waypoints, np.concatenate([[0.0], np.cumsum(durations)])


def solved(n: int, repeats: int) -> Timed[MinSnap]:
    """Minimum snap through a random problem of n pieces."""
    waypoints, times = random_problem(n)
    return timed(lambda: min_snap(waypoints, times), repeats)


def min_snap_rows(repeats: int, longest: int) -> Iterator[Row]:
    """Over the number of pieces up to the longest problem."""
    per_piece = []
    for n in SIZES:
        if n > longest:
            break
        solution = solved(n, repeats)
        yield from _rows_of(n, solution)
        if n >= LONG:
            per_piece.append(solution.wall / n)
    name = f"min snap {LONG:,} to {longest:,} x 3"
    ratio = max(per_piece) / min(per_piece)
    yield figure(name, OURS, "largest by least time per piece", ratio, "2")
    for unit in (1e-3, 1.0, 1e3):
        jump = largest_jump(min_snap(random_problem(100)[0], unit * np.arange(101)))
        yield figure(f"uniform {unit:g} s", OURS, "largest jump", jump, "1e-8")
    yield _closed_form_row()
    yield _qp_row()


def _rows_of(n: int, solution: Timed[MinSnap]) -> Iterator[Row]:
    name = f"min snap {n} x 3"
    waypoints, times = random_problem(n)
    yield figure(name, OURS, "time [ms]", 1e3 * solution.wall, "300" if n == SIZES[-1] else "")
    yield figure(name, OURS, "processor time [ms]", 1e3 * solution.cpu)
    yield figure(name, OURS, "time per piece [us]", 1e6 * solution.wall / n)
    met = np.abs(solution.value.trajectory.evaluate(times) - waypoints).max()
    yield figure(name, OURS, "way point error", met, "1e-10")
    if n > 1:
        yield figure(name, OURS, "largest jump", largest_jump(solution.value), "1e-8")


def _closed_form_row() -> Row:
    curve = min_snap([0.0, 1.0], [0.0, 1.0]).trajectory
    error = np.abs(curve.coefficients[:, 0, 0] - [0, 0, 0, 0, 35, -84, 70, -20]).max()
    return figure("rest to rest", OURS, "coefficient error", error, "1e-12")


def _qp_row() -> Row:
    waypoints, times = random_problem(30)
    a = min_snap(waypoints, times).node_derivatives
    b = min_snap_qp(waypoints, times).node_derivatives
    difference = np.abs(a - b).max() / np.abs(a).max()
    return figure("min snap 30 x 3", "qrqp", "difference from banded", difference, "1e-8")


def largest_jump(solution: MinSnap) -> float:
    """Compute the largest jump of any derivative below the last at any node, relative to the peak
    of that derivative.
    """
    curve = solution.trajectory
    return max(float(np.abs(curve.jumps(d)).max() / curve.peak(d).max()) for d in range(7))


def peer_rows(python: Path, repeats: int) -> tuple[list[Row], str]:
    """The peer, called as often as we are, and its version."""
    waypoints, times = random_problem(WITH_PEER)
    with tempfile.TemporaryDirectory() as folder:
        problem = Path(folder) / "waypoints.npz"
        result = Path(folder) / "result.json"
        np.savez(problem, positions=waypoints, times=times)
        script = Path(__file__).parent / "peer_minsnap.py"
        run_script(python, script, problem, result, "--repeats", repeats)
        peer = json.loads(result.read_text())
    our_wall = solved(WITH_PEER, repeats).wall
    name = f"min snap {WITH_PEER} x 3"
    rows = [
        figure(name, "minsnap_trajectories", "time [ms]", 1e3 * peer["wall"]),
        figure(name, OURS, "times faster than peer", peer["wall"] / our_wall, "300"),
    ]
    return rows, peer["version"]
