"""Minimum snap with minsnap_trajectories: ``python peer_minsnap.py WAYPOINTS.npz RESULT.json
--repeats N``.

Run in an environment of its own.
"""

from __future__ import annotations

import argparse
import json
from importlib.metadata import version
from pathlib import Path

import minsnap_trajectories as ms
import numpy as np
from recording.timing import timed


def main() -> None:
    """Write the least time [s]."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("waypoints", type=Path)
    parser.add_argument("result", type=Path)
    parser.add_argument("--repeats", type=int, required=True)
    arguments = parser.parse_args()
    problem = np.load(arguments.waypoints)
    times = problem["times"]
    positions = problem["positions"]
    zero = np.zeros(positions.shape[1])
    points = [ms.Waypoint(time=t, position=p) for t, p in zip(times, positions, strict=True)]
    for i in (0, -1):
        points[i] = ms.Waypoint(
            time=times[i], position=positions[i], velocity=zero, acceleration=zero, jerk=zero
        )

    def generate() -> object:
        return ms.generate_trajectory(
            points, degree=7, idx_minimized_orders=4, num_continuous_orders=4
        )

    wall = timed(generate, arguments.repeats).wall
    outcome = {"wall": wall, "version": version("minsnap_trajectories")}
    arguments.result.write_text(json.dumps(outcome))


if __name__ == "__main__":
    main()
