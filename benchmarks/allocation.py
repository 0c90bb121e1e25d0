"""Time per Python call of thrust allocation, as a JSON table on stdout."""

from __future__ import annotations

import json
import sys
import time

import numpy as np

from uvms_ocp.control.force.allocation import Allocation, allocation_of
from uvms_ocp.model.files.library import list_robots
from uvms_ocp.model.loading import load_robot

N_WRENCHES, N_CALLS = 500, 20
GENTLE, BEYOND_THE_LIMITS = 0.02, 1.0  # share of the wrench of all thrusters together, 1 sigma per axis


def microseconds(allocation: Allocation, size: float) -> np.ndarray:
    """Shortest time [us] of each of the random wrenches."""
    largest = np.linalg.norm(allocation.matrix * allocation.upper, axis=1)
    wrenches = np.random.default_rng(0).normal(size=(N_WRENCHES, 6)) * size * largest
    return np.array([_shortest(allocation, wrench) for wrench in wrenches])


def _shortest(allocation: Allocation, wrench: np.ndarray) -> float:
    times = []
    for _ in range(N_CALLS):
        start = time.perf_counter()
        allocation.allocate(wrench)
        times.append(time.perf_counter() - start)
    return min(times) * 1e6


def rows() -> list[dict[str, object]]:
    """One row per robot with thrusters and size of the wrench."""
    allocations = {name: allocation_of(load_robot(name)) for name in list_robots()}
    return [
        {"robot": name, "wrench": what, **_percentiles(microseconds(allocation, size))}
        for name, allocation in allocations.items()
        if allocation.matrix.size
        for what, size in (("gentle", GENTLE), ("beyond the limits", BEYOND_THE_LIMITS))
    ]


def _percentiles(times: np.ndarray) -> dict[str, float]:
    p50, p99 = np.percentile(times, [50, 99])
    return {"p50_us": round(float(p50), 1), "p99_us": round(float(p99), 1), "max_us": round(float(times.max()), 1)}


if __name__ == "__main__":
    json.dump(rows(), sys.stdout, indent=1)
