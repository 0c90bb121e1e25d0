"""What the tool carries, learnt on line: ``python benchmarks/payloads.py [--seeds N]``.

Writes payloads.csv, one row per robot, payload and water, and payloads.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
from actuators.hovering import DT, Hover, run
from recording.report import Report, Row, Table, begin, parser_of

from uvms_ocp.control import LoadLearning
from uvms_ocp.control.payload import LoadEstimate
from uvms_ocp.robot.loading import load_robot

ROBOTS = ("girona_maris7_full", "bluerov2_alpha5")
MASSES = (0.0, 0.5, 1.0, 2.0, 4.0)
BUOYANT = (0.0, 0.5)
"""share of the weight that buoyancy bears."""
CURRENT = 0.3
GUSTS = 0.03
"""[m/s]"""
NEAR = 0.1
"""of a weight."""
WATERS: dict[str, dict[str, Any]] = {
    "still, ideal sensors": {"noise": False, "current": 0.0, "gusts": 0.0},
    "current, noise": {"current": CURRENT, "gusts": GUSTS},
    "the same, drag a fifth more": {"current": CURRENT, "gusts": GUSTS, "wrong": (1.0, 1.2)},
}
STAYS = 30.0
SOON = (5.0, 10.0, 30.0)
CERTAIN = 1.96  # standard errors
PROSE = """
A robot carries a payload from the start, of which its controller is told nothing. It keeps station
for {stays:g} s and then goes to small way points and moves its arm, {duration:g} s in all; {seeds}
runs a row, with other ways and other noise. Current and gusts have {current:g} and {gusts:g} m/s.

- *error*: of the net weight [N] after so many seconds, the largest of the runs; *near*: the time
  [s] from which on it stays within {near:.0f} % in all runs.
- *mass known*: the time [s] from which on the mass is determined in all runs; *mass error* [kg]:
  the largest at the end of those in which it is.
- *weight inside*, *mass inside*: share of all seconds at which the truth lies within {certain:g}
  standard errors; of the mass, of those at which it is determined.
"""
G = 9.81  # [m/s2]


def main() -> None:
    """Run every payload in every water."""
    parser = parser_of(__doc__)
    parser.add_argument("--seeds", type=int, default=3, help="runs of each row")
    given, bench = begin(parser)
    seeds, duration = (1, 8.0) if bench.quick else (given.seeds, 60.0)
    hover = Hover(load=LoadLearning(), duration=duration, stays=min(STAYS, duration / 2))
    robots, masses = (ROBOTS[1:], (0.0, 2.0)) if bench.quick else (ROBOTS, MASSES)
    cases = [case for case in product(robots, WATERS, masses, BUOYANT) if case[2] or not case[3]]
    rows = [
        row_of(replace(hover, robot=robot), water, mass, share, seeds)
        for robot, water, mass, share in cases
    ]
    told = {
        "stays": STAYS,
        "certain": CERTAIN,
        "current": CURRENT,
        "gusts": GUSTS,
        "near": 100 * NEAR,
    }
    prose = PROSE.format(duration=duration, seeds=seeds, **told)
    formats = {
        name: ".2f"
        for name in rows[0]
        if "error" in name or "inside" in name or "weight [N]" in name
    }
    table = Table(
        rows=rows, columns={name: formats.get(name, "g" if "[" in name else "") for name in rows[0]}
    )
    bench.write(
        Report(
            name="payloads",
            title="What the tool carries, learnt on line",
            prose=prose,
            tables=[table],
        )
    )


def row_of(hover: Hover, water: str, mass: float, share: float, seeds: int) -> Row:
    """Figures of all runs with one payload, whose buoyancy bears a share of its weight [kg, -]."""
    volume = share * mass / load_robot(hover.robot).description.water_density
    carrying = replace(hover, payload=(mass, volume), **WATERS[water])
    runs = [run(replace(carrying, seed=seed)).learnt for seed in range(seeds)]
    weight = (1.0 - share) * mass * G
    return {
        "robot": hover.robot,
        "water": water,
        "mass [kg]": mass,
        "volume [l]": 1000.0 * volume,
        "weight [N]": weight,
        **{f"error {t:g} s": _error_at(runs, weight, t) for t in SOON if t < hover.duration},
        "near": _from_when_on([_near(found, weight) for found in runs]) if mass else None,
        "mass known": _from_when_on([_knows(found) for found in runs]),
        "mass error": max(
            (abs(found[-1].mass - mass) for found in runs if not np.isnan(found[-1].mass)),
            default=None,
        ),
        **_inside(runs, weight, mass),
    }


def _error_at(runs: Sequence[Sequence[LoadEstimate]], weight: float, t: float) -> float:
    return max(abs(found[round(t / DT)].weight - weight) for found in runs)


def _near(found: Sequence[LoadEstimate], weight: float) -> np.ndarray:
    return np.array([abs(load.weight - weight) <= NEAR * weight for load in found])


def _knows(found: Sequence[LoadEstimate]) -> np.ndarray:
    return ~np.isnan([load.mass for load in found])


def _from_when_on(runs: Sequence[np.ndarray]) -> float | None:
    """The latest time [s] at which any run begins to hold for good; `None` where one never does."""
    lasts = [int(np.flatnonzero(~held)[-1]) + 1 if not held.all() else 0 for held in runs]
    return None if any(last == len(runs[0]) for last in lasts) else round(max(lasts) * DT, 1)


def _inside(runs: Sequence[Sequence[LoadEstimate]], weight: float, mass: float) -> Row:
    """Shares of seconds; of the mass `None` where it is never determined."""
    seconds = [load for found in runs for load in found[round(SOON[0] / DT) :: round(1.0 / DT)]]
    weights = [abs(load.weight - weight) <= CERTAIN * load.weight_error for load in seconds]
    masses = [
        abs(load.mass - mass) <= CERTAIN * load.mass_error
        for load in seconds
        if not np.isnan(load.mass)
    ]
    return {"weight inside": np.mean(weights), "mass inside": np.mean(masses) if masses else None}


if __name__ == "__main__":
    main()
