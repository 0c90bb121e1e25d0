"""Random missions: does what pre-flight accepts complete, and does nothing collide on the way?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.campaign.study import Row, Study
from uvms_ocp.record import Record
from uvms_ocp.report import cause_of_end
from uvms_ocp.scenario import Scenario, pose_at
from uvms_ocp.scenarios.case1 import case1
from uvms_ocp.sim import FlatSeafloor, HeightField, Seafloor, closest_approach

_PLANE = -40.0  # [m]
_ABOVE_FLOOR = 0.114  # [m] height of the tool's goal, as in Case 1
_EVERY = 20  # ticks between two configurations whose clearance is measured


def random_missions(*, n: int = 200, seed: int = 0, plant: str = "dynamic", dt: float = 0.02) -> Study:
    """`n` missions drawn with the seeds `seed`, `seed` + 1, ...: Case 1 with everything about the place drawn."""
    cases = [{"seed": seed + k, "plant": plant, "dt": dt} for k in range(n)]
    title = f"{n} random missions on the {plant} plant"
    return Study(name="random_missions", title=title, cases=cases, run_case=run_mission, summarize=totals)


def random_mission(*, seed: int, plant: str = "dynamic", dt: float = 0.02) -> Scenario:
    """Case 1 with start, heading, target, way point, current and floor drawn from `seed`.

    The floor is flat or has protuberances of up to 0.1 m; the current is uniform and below 0.3 m/s; the way point is
    1.2 to 1.8 m from the target, not always near enough.
    """
    rng = np.random.default_rng(seed)
    floor = _floor(rng)
    heading = rng.uniform(-np.pi, np.pi)
    R = pin.rpy.rpyToMatrix(0.0, 0.0, heading)
    target = np.array([*rng.uniform(-3.0, 3.0, 2), 0.0])
    target[2] = floor.height(target[0], target[1]) + _ABOVE_FLOOR
    way_point = target + R @ np.array([-rng.uniform(1.2, 1.8), rng.uniform(-0.3, 0.3), rng.uniform(1.6, 2.4)])
    start = way_point + R @ rng.uniform([-3.0, -2.0, 0.0], [0.5, 2.0, 3.0])
    angle, speed = rng.uniform(-np.pi, np.pi), rng.uniform(0.0, 0.3)
    scenario = case1(
        start=pose_at(tuple(start), (*rng.uniform(-0.05, 0.05, 2), heading + rng.uniform(-1.0, 1.0))),
        way_point=pose_at(tuple(way_point), (0.0, 0.0, heading + rng.uniform(-0.5, 0.5))),
        target=tuple(target),
        tool_goal=pose_at(tuple(target), (np.pi, 0.0, heading)),
        seabed=_PLANE,
        current=(speed * np.cos(angle), speed * np.sin(angle), 0.0),
        plant=plant,
        seed=seed,
        dt=dt,
    )
    return replace(
        scenario, name=f"random{seed}", environment=replace(scenario.environment, seafloor=floor), duration=150.0
    )


def run_mission(case: dict[str, Any]) -> Row:
    """Pre-flight, and where it accepts a run, how it ended and how near it came to the floor."""
    scenario = random_mission(**case)
    preflight = scenario.check()
    row = {**case, "accepted": preflight.accepted}
    if not preflight.accepted:
        refused = {"completed": False, "cause": "refused", "text": preflight.errors[0].text}
        return {**row, **refused, "clearance_m": None, "duration_s": None}
    record = scenario.run()
    cause = cause_of_end(record)
    return {
        **row,
        "completed": bool(record.meta["completed"]),
        "cause": cause["kind"],
        "text": cause["text"],
        "clearance_m": guarded_clearance(scenario, record),
        "duration_s": float(record["t"][-1]),
    }


def guarded_clearance(scenario: Scenario, record: Record) -> float | None:
    """The smallest clearance [m] of the robot while the minimum altitude is fully on; `None` where it never is."""
    gate = record["gates"][:, scenario.mission.hierarchy.index("MAC")]
    rows = record["q"][gate == 1.0][::_EVERY]
    if not len(rows):
        return None
    return closest_approach(scenario.robot, scenario.environment, rows).distance


def totals(rows: Sequence[Row]) -> list[Row]:
    """One row: how many were accepted, completed and collided, and why the others did not complete."""
    accepted = [row for row in rows if row["accepted"]]
    failed = [row for row in accepted if not row["completed"]]
    clearances = [row["clearance_m"] for row in accepted if row["clearance_m"] is not None]
    return [
        {
            "missions": len(rows),
            "accepted": len(accepted),
            "completed": len(accepted) - len(failed),
            "share": (len(accepted) - len(failed)) / max(len(accepted), 1),
            "collided": sum(clearance <= 0 for clearance in clearances),
            "smallest_clearance_m": min(clearances, default=None),
            "causes": "; ".join(f"{row['seed']}: {row['cause']}, {row['text']}" for row in failed),
        }
    ]


def _floor(rng: np.random.Generator) -> Seafloor:
    if rng.random() < 0.5:
        return FlatSeafloor(z=_PLANE)
    return HeightField.random("flat", z=_PLANE, extent=40.0, seed=int(rng.integers(1 << 30)))
