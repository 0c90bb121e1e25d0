"""Time per Python call of dynamics in water and of thrust allocation: ``python benchmarks/calls.py``.

Writes calls.csv and calls.md, one row per robot and call.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from functools import partial

import numpy as np
import pinocchio as pin
from recording.report import Report, Row, Table, begin, parser_of

from uvms_ocp.control.force.allocation import Allocation, allocation_of
from uvms_ocp.robot.dynamics import Dynamics, robot_dynamics
from uvms_ocp.robot.hydrodynamics import Water
from uvms_ocp.robot.loading import list_robots, load_robot

SIZES = {"gentle": 0.02, "beyond the limits": 1.0}
"""share of the wrench of all thrusters together, one sigma per axis."""
PROSE = """
Dynamics: means over batches of {calls} calls at a random state, in water that moves differently at
every link; of {batches} batches. Allocation: the shortest of {repeats} calls for each of {wrenches}
random wrenches; gentle ones have one sigma of {gentle:g} of the wrench of all thrusters together on
every axis, those beyond the limits of {beyond:g}.
"""
FORMATS = {"robot": "", "call": "", "p50_us": ".2f", "p99_us": ".2f", "max_us": ".2f"}


@dataclass(frozen=True, kw_only=True, slots=True)
class Counts:
    """How often things are called."""

    batches: int = 20
    calls: int = 1000
    wrenches: int = 500
    repeats: int = 20


def dynamics_calls(dynamics: Dynamics) -> dict[str, Callable[[], object]]:
    """One call of each kind, at a random state in water that moves differently at every link."""
    rng = np.random.default_rng(0)
    model = dynamics.symbolic.model
    q = pin.integrate(model, pin.neutral(model), rng.normal(size=model.nv))
    v, a = rng.normal(size=(2, model.nv))
    u, Du_Dt = rng.normal(size=(2, len(dynamics.symbolic.links), 3))
    water = Water(velocity=u, acceleration=Du_Dt)
    return {
        "inverse dynamics": lambda: dynamics.inverse_dynamics(q, v, a, water),
        "forward dynamics": lambda: dynamics.forward_dynamics(q, v, a, water),
        "bias force": lambda: dynamics.bias_force(q, v, water),
        "mass matrix": lambda: dynamics.mass_matrix(q),
        "damping matrix": lambda: dynamics.damping_matrix(q, v, water),
    }


def batch_us(call: Callable[[], object], calls: int) -> float:
    """Mean time [us] of so many calls."""
    start = time.perf_counter()
    for _ in range(calls):
        call()
    return (time.perf_counter() - start) / calls * 1e6


def wrench_us(allocation: Allocation, share: float, counts: Counts) -> list[float]:
    """Shortest time [us] of each of the random wrenches of a share of the largest."""
    largest = np.linalg.norm(allocation.matrix * allocation.upper, axis=1)
    drawn = np.random.default_rng(0).normal(size=(counts.wrenches, 6)) * share * largest
    shortest = []
    for wrench in drawn:
        call = partial(allocation.allocate, wrench)
        shortest.append(min(batch_us(call, 1) for _ in range(counts.repeats)))
    return shortest


def rows(counts: Counts) -> Iterator[Row]:
    """Dynamics of every robot, then allocation of those with thrusters."""
    robots = {name: load_robot(name) for name in list_robots()}
    for name, robot in robots.items():
        for label, call in dynamics_calls(robot_dynamics(robot)).items():
            yield _row(name, label, [batch_us(call, counts.calls) for _ in range(counts.batches)])
    for name, robot in robots.items():
        allocation = allocation_of(robot)
        if allocation.matrix.size:
            for size, share in SIZES.items():
                yield _row(name, f"allocation, {size}", wrench_us(allocation, share, counts))


def _row(robot: str, call: str, times_us: list[float]) -> Row:
    p50, p99, largest = np.percentile(times_us, [50, 99, 100]).tolist()
    return {"robot": robot, "call": call, "p50_us": p50, "p99_us": p99, "max_us": largest}


def main() -> None:
    """Time all calls."""
    _, run = begin(parser_of(__doc__))
    counts = Counts(batches=2, calls=10, wrenches=5, repeats=2) if run.quick else Counts()
    gentle, beyond = SIZES.values()
    prose = PROSE.format(**asdict(counts), gentle=gentle, beyond=beyond)
    table = Table(rows=list(rows(counts)), columns=FORMATS)
    run.write(Report(name="calls", title="Time per Python call", prose=prose, tables=[table]))


if __name__ == "__main__":
    main()
