"""Random missions: does what pre-flight accepts complete, and does nothing collide on the way?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from recording.rows import column, known_values

from studies.study import Study, seeds_from
from uvms_ocp.campaign.jobs import Row
from uvms_ocp.checks import checked
from uvms_ocp.record.record import Record
from uvms_ocp.report.end_of_run import cause_of_end
from uvms_ocp.robot.shapes.collision_model import CollisionModel
from uvms_ocp.robot.shapes.obstacles import Obstacle, obstacle
from uvms_ocp.scenario.cases.case1 import case1
from uvms_ocp.scenario.options import activate, with_activations
from uvms_ocp.scenario.scenario import Scenario, pose_at
from uvms_ocp.sim.nearest_passage import closest_approach
from uvms_ocp.sim.rough_seafloor import HeightField
from uvms_ocp.sim.seafloor import FlatSeafloor, Seafloor
from uvms_ocp.tasks.clearance import Clearance
from uvms_ocp.tasks.hierarchy import Hierarchy
from uvms_ocp.types import Count, Period

_PLANE = -40.0  # [m]
_ABOVE_FLOOR = 0.114  # [m] height of the tool's goal, as in Case 1
_EVERY = 5  # ticks between two configurations whose clearance is measured
_WITH_BOULDER = 0.3  # share of the missions
_RUN_UP = 4.0  # [m] by which they start farther away, to leave room for the boulder


@checked
def random_missions(
    *, n: int = 200, seed: Count = 0, plant: str = "dynamic", dt: Period = 0.02, force: bool = False
) -> Study:
    """`n` missions drawn with the seeds `seed`, `seed` + 1, ...: Case 1 with everything about the
    place drawn.

    dt [s]: control period. force: run those too that pre-flight refuses, which tells the refusals
    that were false. Raises `InvalidInput` for no missions or a negative seed.
    """
    cases = [
        {"seed": drawn, "plant": plant, "dt": dt, "force": force} for drawn in seeds_from(seed, n)
    ]
    title = f"{n} random missions on the {plant} plant"
    return Study(
        name="random_missions", title=title, cases=cases, run_case=run_mission, summarize=totals
    )


def random_mission(*, seed: int, plant: str = "dynamic", dt: Period = 0.02) -> Scenario:
    """Case 1 with start, heading, target, way point, current, floor and, in a share of them, a
    boulder drawn from `seed`.

    The floor is flat or has protuberances of up to 0.1 m; the current is uniform and below 0.3 m/s;
    the way point is 1.2 to 1.8 m from the target, not always near enough. The boulder lies in the
    way of the hull, though not straight ahead, and the clearance task is on in all phases. dt [s]:
    control period.
    """
    rng = np.random.default_rng(seed)
    floor = _floor(rng)
    heading = rng.uniform(-np.pi, np.pi)
    R = pin.rpy.rpyToMatrix(0.0, 0.0, heading)
    target = np.array([*rng.uniform(-3.0, 3.0, 2), 0.0])
    target[2] = floor.height(target[0], target[1]) + _ABOVE_FLOOR
    way_point = target + R @ np.array(
        [-rng.uniform(1.2, 1.8), rng.uniform(-0.3, 0.3), rng.uniform(1.6, 2.4)]
    )
    start = way_point + R @ rng.uniform([-3.0, -2.0, 0.0], [0.5, 2.0, 3.0])
    angle = rng.uniform(-np.pi, np.pi)
    speed = rng.uniform(0.0, 0.3)
    tilt = rng.uniform(-0.05, 0.05, 2)
    turns = (rng.uniform(-1.0, 1.0), rng.uniform(-0.5, 0.5))
    has_boulder = bool(rng.random() < _WITH_BOULDER)
    if has_boulder:
        start = start + _RUN_UP * _towards(way_point, start)
    scenario = case1(
        start=pose_at(tuple(start), (*tilt, heading + turns[0])),
        way_point=pose_at(tuple(way_point), (0.0, 0.0, heading + turns[1])),
        target=tuple(target),
        tool_goal=pose_at(tuple(target), (np.pi, 0.0, heading)),
        seabed=_PLANE,
        current=(speed * np.cos(angle), speed * np.sin(angle), 0.0),
        plant=plant,
        seed=seed,
        dt=dt,
    )
    environment = replace(scenario.environment, seafloor=floor)
    scenario = replace(scenario, name=f"random{seed}", environment=environment, duration=150.0)
    if not has_boulder:
        return scenario
    return _past(scenario, _boulder(rng, start, way_point))


def run_mission(case: dict[str, Any]) -> Row:
    """Pre-flight, and where it accepts a run, or is told to, how it ended and how near it came to
    floor and boulder.
    """
    scenario = random_mission(seed=case["seed"], plant=case["plant"], dt=case["dt"])
    preflight = scenario.check()
    row = {**case, "boulder": bool(scenario.environment.obstacles), "accepted": preflight.accepted}
    row["refusal"] = preflight.errors[0].text if preflight.errors else ""
    if not (preflight.accepted or case["force"]):
        missing = dict.fromkeys(("clearance_m", "boulder_clearance_m", "duration_s"))
        return {**row, "completed": False, "cause": "refused", "text": row["refusal"], **missing}
    record = scenario.run()
    cause = cause_of_end(record)
    return {
        **row,
        "completed": record.run_meta.completed,
        "cause": cause["kind"],
        "text": cause["text"],
        "clearance_m": guarded_clearance(scenario, record),
        "boulder_clearance_m": boulder_clearance(scenario, record),
        "duration_s": float(record["t"][-1]),
    }


def guarded_clearance(scenario: Scenario, record: Record) -> float | None:
    """The smallest clearance [m] of the robot while the minimum altitude is fully on; `None` where
    it never is.
    """
    gate = record["activations"][:, scenario.mission.hierarchy.index("MAC")]
    rows = record["q"][gate == 1.0][::_EVERY]
    if not len(rows):
        return None
    return closest_approach(scenario.robot, scenario.environment, rows).distance


def boulder_clearance(scenario: Scenario, record: Record) -> float | None:
    """The smallest clearance [m] of the robot from the boulder over the whole run; `None` without
    one.
    """
    if not scenario.environment.obstacles:
        return None
    return closest_approach(
        scenario.robot, scenario.environment, record["q"][::_EVERY], floor=False
    ).distance


def totals(rows: Sequence[Row]) -> list[Row]:
    """One row: how many were accepted, completed and collided, why the others did not complete, and
    false refusals.
    """
    accepted = [row for row in rows if row["accepted"]]
    failed = [row for row in accepted if not row["completed"]]
    forced = [row for row in rows if not row["accepted"] and row["cause"] != "refused"]
    smallest = {}
    for name in _CLEARANCES:
        smallest[f"smallest_{name}"] = min(known_values(accepted, name), default=None)
    return [
        {
            "missions": len(rows),
            "accepted": len(accepted),
            "completed": len(accepted) - len(failed),
            "share": (len(accepted) - len(failed)) / max(len(accepted), 1),
            "collided": sum(_collides(row) for row in accepted),
            **smallest,
            "refused_and_forced": len(forced),
            "of_which_completed": sum(column(forced, "completed")),
            "causes": "; ".join(f"{row['seed']}: {row['cause']}, {row['text']}" for row in failed),
        }
    ]


def _collides(row: Row) -> bool:
    return any(row[name] is not None and row[name] <= 0 for name in _CLEARANCES)


_CLEARANCES = ("clearance_m", "boulder_clearance_m")


def _floor(rng: np.random.Generator) -> Seafloor:
    if rng.random() < 0.5:
        return FlatSeafloor(z=_PLANE)
    return HeightField.random("flat", z=_PLANE, extent=40.0, seed=int(rng.integers(1 << 30)))


def _towards(origin: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Horizontal unit vector (3,) from one point (3,) to another."""
    offset = (point - origin) * [1.0, 1.0, 0.0]
    return offset / np.linalg.norm(offset)


def _boulder(rng: np.random.Generator, start: np.ndarray, way_point: np.ndarray) -> Obstacle:
    """A ball beside the straight way, near enough to be hit by the hull and not straight ahead."""
    radius = rng.uniform(0.3, 0.6)
    share = rng.uniform(0.45, 0.55)
    ahead = _towards(start, way_point)
    side = np.array([-ahead[1], ahead[0], 0.0]) * rng.choice([-1.0, 1.0])
    place = start + share * (way_point - start) + side * (radius + rng.uniform(0.1, 0.6))
    return obstacle(
        "boulder", coal.Sphere(radius), place + np.array([0.0, 0.0, rng.uniform(-0.2, 0.2)])
    )


def _past(scenario: Scenario, boulder: Obstacle) -> Scenario:
    """The scenario with the boulder, and a clearance task that keeps away from it in all phases."""
    clearance = Clearance(
        model=CollisionModel(scenario.robot, [boulder], self_collision=False), threshold=0.15
    )
    wider = replace(
        scenario.mission, hierarchy=Hierarchy([*scenario.mission.hierarchy.tasks, clearance])
    )
    mission = with_activations(wider, activate(clearance.name))
    environment = replace(scenario.environment, obstacles=(boulder,))
    return replace(scenario, mission=mission, environment=environment)
