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
"""[kg]"""
BUOYANT = (0.0, 0.5)
"""Shares of the weight that buoyancy bears."""
CURRENT = 0.3
"""[m/s] Speed of the current."""
GUSTS = 0.03
"""[m/s] Standard deviation of the gusts."""
NEAR = 0.1
"""Share of a weight within which an estimate is near it."""
WATERS: dict[str, dict[str, Any]] = {
    "still, ideal sensors": {"noise": False, "current": 0.0, "gusts": 0.0},
    "current, noise": {"current": CURRENT, "gusts": GUSTS},
    "the same, drag a fifth more": {"current": CURRENT, "gusts": GUSTS, "wrong": (1.0, 1.2)},
}
STAYS = 30.0
"""[s] Time for which the robot keeps station."""
SOON = (5.0, 10.0, 30.0)
"""[s] Times after which errors are reported."""
CERTAIN = 1.96
"""Standard errors on either side of an estimate, for 95 % of all truths."""
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
    arguments, bench = begin(parser)
    if bench.quick:
        seeds = 1
        duration = 8.0
        robots: tuple[str, ...] = ROBOTS[1:]
        masses: tuple[float, ...] = (0.0, 2.0)
    else:
        seeds = arguments.seeds
        duration = 60.0
        robots = ROBOTS
        masses = MASSES
    hover = Hover(load=LoadLearning(), duration=duration, stays=min(STAYS, duration / 2))
    rows = []
    for robot, water, mass, share in product(robots, WATERS, masses, BUOYANT):
        if mass or not share:
            rows.append(row_of(replace(hover, robot=robot), water, mass, share, seeds))
    columns = {name: _format(name) for name in rows[0]}
    prose = PROSE.format(
        duration=duration,
        seeds=seeds,
        stays=STAYS,
        certain=CERTAIN,
        current=CURRENT,
        gusts=GUSTS,
        near=100 * NEAR,
    )
    bench.write(
        Report(
            name="payloads",
            title="What the tool carries, learnt on line",
            prose=prose,
            tables=[Table(rows=rows, columns=columns)],
        )
    )


def _format(column: str) -> str:
    """Return the format of a column, by its name."""
    if "error" in column or "inside" in column or "weight [N]" in column:
        return ".2f"
    if "[" in column:
        return "g"
    return ""


def row_of(hover: Hover, water: str, mass: float, share: float, seeds: int) -> Row:
    """Figures of all runs with one payload, whose buoyancy bears a share of its weight [kg, -]."""
    volume = share * mass / load_robot(hover.robot).description.water_density
    carrying = replace(hover, payload=(mass, volume), **WATERS[water])
    runs = [run(replace(carrying, seed=seed)).learnt for seed in range(seeds)]
    weight = (1.0 - share) * mass * G
    row: dict[str, object] = {
        "robot": hover.robot,
        "water": water,
        "mass [kg]": mass,
        "volume [l]": 1000.0 * volume,
        "weight [N]": weight,
    }
    for t in SOON:
        if t < hover.duration:
            row[f"error {t:g} s"] = _error_at(runs, weight, t)
    row["near"] = None
    if mass:
        row["near"] = _from_when_on([_is_near(estimates, weight) for estimates in runs])
    row["mass known"] = _from_when_on(list(map(_knows_mass, runs)))
    row["mass error"] = _largest_mass_error(runs, mass)
    return row | _inside(runs, weight, mass)


def _error_at(runs: Sequence[Sequence[LoadEstimate]], weight: float, t: float) -> float:
    """Return the largest error [N] of a weight at t [s]."""
    tick = round(t / DT)
    return max(abs(estimates[tick].weight - weight) for estimates in runs)


def _largest_mass_error(runs: Sequence[Sequence[LoadEstimate]], mass: float) -> float | None:
    """Return the largest error [kg] at the end; `None` where no run determines the mass."""
    errors = []
    for estimates in runs:
        estimated_mass = estimates[-1].mass
        if not np.isnan(estimated_mass):
            errors.append(abs(estimated_mass - mass))
    return max(errors, default=None)


def _is_near(estimates: Sequence[LoadEstimate], weight: float) -> np.ndarray:
    return np.array([abs(load.weight - weight) <= NEAR * weight for load in estimates])


def _knows_mass(estimates: Sequence[LoadEstimate]) -> np.ndarray:
    return ~np.isnan([load.mass for load in estimates])


def _from_when_on(runs: Sequence[np.ndarray]) -> float | None:
    """The latest time [s] at which any run begins to hold for good; `None` where one never does."""
    begins = []
    for holds in runs:
        failures = np.flatnonzero(~holds)
        begins.append(int(failures[-1]) + 1 if len(failures) else 0)
    if any(begin == len(runs[0]) for begin in begins):
        return None
    return round(max(begins) * DT, 1)


def _inside(
    runs: Sequence[Sequence[LoadEstimate]], weight: float, mass: float
) -> dict[str, object]:
    """Shares of seconds; of the mass `None` where it is never determined."""
    first = round(SOON[0] / DT)
    stride = round(1.0 / DT)
    weights = []
    masses = []
    for estimates in runs:
        for load in estimates[first::stride]:
            weights.append(abs(load.weight - weight) <= CERTAIN * load.weight_error)
            if not np.isnan(load.mass):
                masses.append(abs(load.mass - mass) <= CERTAIN * load.mass_error)
    mass_share = None
    if masses:
        mass_share = np.mean(masses)
    return {"weight inside": np.mean(weights), "mass inside": mass_share}


if __name__ == "__main__":
    main()
