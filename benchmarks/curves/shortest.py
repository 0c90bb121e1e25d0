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
    return rng.normal(size=(n + 1, 3)), np.concatenate([[0.0], np.cumsum(rng.uniform(1.0, 3.0, n))])


def solved(n: int, repeats: int) -> Timed[MinSnap]:
    """Minimum snap through a random problem of n pieces."""
    waypoints, times = random_problem(n)
    return timed(lambda: min_snap(waypoints, times), repeats)


def min_snap_rows(repeats: int, longest: int) -> Iterator[Row]:
    """Over the number of pieces up to the longest problem."""
    long = []
    for n in (n for n in SIZES if n <= longest):
        found = solved(n, repeats)
        yield from _rows_of(n, found)
        long += [found.wall / n] if n >= LONG else []
    name = f"min snap {LONG:,} to {longest:,} x 3"
    yield figure(name, OURS, "largest by least time per piece", max(long) / min(long), "2")
    for unit in (1e-3, 1.0, 1e3):
        jump = largest_jump(min_snap(random_problem(100)[0], unit * np.arange(101)))
        yield figure(f"uniform {unit:g} s", OURS, "largest jump", jump, "1e-8")
    yield _closed_form_row()
    yield _qp_row()


def _rows_of(n: int, found: Timed[MinSnap]) -> Iterator[Row]:
    name, (waypoints, times) = f"min snap {n} x 3", random_problem(n)
    yield figure(name, OURS, "time [ms]", 1e3 * found.wall, "300" if n == SIZES[-1] else "")
    yield figure(name, OURS, "processor time [ms]", 1e3 * found.cpu)
    yield figure(name, OURS, "time per piece [us]", 1e6 * found.wall / n)
    met = np.abs(found.value.trajectory.evaluate(times) - waypoints).max()
    yield figure(name, OURS, "way point error", met, "1e-10")
    if n > 1:
        yield figure(name, OURS, "largest jump", largest_jump(found.value), "1e-8")


def _closed_form_row() -> Row:
    found = min_snap([0.0, 1.0], [0.0, 1.0]).trajectory.coefficients[:, 0, 0]
    error = np.abs(found - [0, 0, 0, 0, 35, -84, 70, -20]).max()
    return figure("rest to rest", OURS, "coefficient error", error, "1e-12")


def _qp_row() -> Row:
    waypoints, times = random_problem(30)
    a = min_snap(waypoints, times).node_derivatives
    b = min_snap_qp(waypoints, times).node_derivatives
    return figure(
        "min snap 30 x 3",
        "qrqp",
        "difference from banded",
        np.abs(a - b).max() / np.abs(a).max(),
        "1e-8",
    )


def largest_jump(found: MinSnap) -> float:
    """Of any derivative below the last at any node, relative to the peak of that derivative."""
    curve = found.trajectory
    return max(float(np.abs(curve.jumps(d)).max() / curve.peak(d).max()) for d in range(7))


def peer_rows(python: Path, repeats: int) -> tuple[list[Row], str]:
    """The peer, called as often as we are, and its version."""
    waypoints, times = random_problem(WITH_PEER)
    with tempfile.TemporaryDirectory() as folder:
        given = Path(folder) / "waypoints.npz"
        result = Path(folder) / "result.json"
        np.savez(given, positions=waypoints, times=times)
        run_script(
            python, Path(__file__).parent / "peer_minsnap.py", given, result, "--repeats", repeats
        )
        found = json.loads(result.read_text())
    mine = solved(WITH_PEER, repeats).wall
    name = f"min snap {WITH_PEER} x 3"
    rows = [
        figure(name, "minsnap_trajectories", "time [ms]", 1e3 * found["wall"]),
        figure(name, OURS, "times faster than peer", found["wall"] / mine, "300"),
    ]
    return rows, found["version"]
