"""Table 2 of the paper: which minimum altitude is safe over which floor."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Any

from recording.rows import column, rows_where

from studies.study import Study
from uvms_ocp.campaign.jobs import Row
from uvms_ocp.checks import checked
from uvms_ocp.scenario.cases.transit import Length, transit
from uvms_ocp.sim.nearest_passage import closest_approach
from uvms_ocp.types import Count

THRESHOLDS = (1.0, 5.0, 10.0)  # [m]
FLOORS = {"flat": "almost flat", "small": "small protuberances", "large": "large protuberances"}
PAPER = {
    ("flat", 1.0): "safe",
    ("flat", 5.0): "safe",
    ("flat", 10.0): "safe",
    ("small", 1.0): "not completely safe",
    ("small", 5.0): "safe",
    ("small", 10.0): "safe",
    ("large", 1.0): "not safe",
    ("large", 5.0): "not always safe",
    ("large", 10.0): "safe",
}
"""[Gao2022] Table 2, by floor and threshold."""
MARGIN = 0.5  # [m] clearance of the whole robot that counts as safe: half its height
_DT = 1 / 50  # [s] control period
_EVERY = 5  # ticks between two configurations whose clearance is measured


@checked
def table2(
    *, seeds: int = 5, seed: Count = 0, length: Length = 30.0, plant: str = "kinematic"
) -> Study:
    """Three floors by three thresholds by `seeds` floors each, the first drawn with `seed`; length
    [m]: of a transit.

    The kinematic plant is a tenth of the work; so slow a transit keeps the same clearances on the
    dynamic one.
    """
    common = {"length_m": length, "plant": plant}
    cases = []
    for floor in FLOORS:
        for threshold in THRESHOLDS:
            for k in range(seeds):
                place = {"floor": floor, "threshold_m": threshold, "seed": seed + k}
                cases.append(place | common)
    title = "Table 2: smallest clearance of the whole robot by floor and minimum altitude"
    return Study(name="table2", title=title, cases=cases, run_case=run_transit, summarize=cells)


def run_transit(case: dict[str, Any]) -> Row:
    """One transit and its smallest clearance [m]."""
    chosen = {
        "relief": case["floor"],
        "min_altitude": case["threshold_m"],
        "length": case["length_m"],
    }
    scenario = transit(**chosen, seed=case["seed"], plant=case["plant"], dt=_DT)
    record = scenario.run()
    closest = closest_approach(scenario.robot, scenario.environment, record["q"][::_EVERY])
    return {
        **case,
        "completed": record.run_meta.completed,
        "duration_s": float(record["t"][-1]),
        "clearance_m": closest.distance,
        "closest_pair": closest.pair,
    }


def cells(rows: Sequence[Row]) -> list[Row]:
    """One row per cell: clearance over the seeds, our verdict and the paper's."""
    return [_cell(floor, threshold, rows) for floor, threshold in product(FLOORS, THRESHOLDS)]


def _cell(floor: str, threshold: float, rows: Sequence[Row]) -> Row:
    runs = rows_where(rows_where(rows, "floor", floor), "threshold_m", threshold)
    clearances = column(runs, "clearance_m")
    paper = PAPER[floor, threshold]
    return {
        "floor": FLOORS[floor],
        "threshold_m": threshold,
        "runs": len(clearances),
        "smallest_clearance_m": min(clearances),
        "largest_m": max(clearances),
        "verdict": verdict(clearances),
        "paper": paper,
        "agrees": verdict(clearances) == paper,
    }


def verdict(clearances: Sequence[float]) -> str:
    """The paper's words for the clearances [m] of one cell: contact in any run is not safe.

    Without contact: safe where every run keeps `MARGIN`, not completely safe where none does, else
    not always safe.
    """
    if min(clearances) <= 0.0:
        return "not safe"
    is_safe = [clearance >= MARGIN for clearance in clearances]
    if all(is_safe):
        return "safe"
    if any(is_safe):
        return "not always safe"
    return "not completely safe"
