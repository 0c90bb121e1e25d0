"""Missions as one problem, against greedy ones: ``python benchmarks/ocp_missions.py``.

Both are flown on the physical plant with noise, and judged by its true state. Writes
ocp_missions.csv and ocp_missions.md.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from horizon.drag_bound import quasi_static_energy
from recording.processes import hide_compiler
from recording.report import Report, Row, Table, begin, parser_of
from recording.timing import once

from uvms_ocp.mission_plan import MissionPlan, plan_mission
from uvms_ocp.mission_plan.planner import OPTIONS
from uvms_ocp.record.record import Record, quantity
from uvms_ocp.report.phase_resources import resources
from uvms_ocp.scenario import cases as scenarios
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.sim.nearest_passage import closest_approach

STEADY = (0.3, -0.2, 0.05)  # [m/s]
MISSIONS: dict[str, Callable[..., Scenario]] = {
    "case1": scenarios.case1,
    "case1 in a current": lambda **more: scenarios.case1(current=STEADY, **more),
    "case2": scenarios.case2,
    "two_targets": scenarios.two_targets,
    "current_drift": scenarios.current_drift,
    "bluerov_inspection": scenarios.bluerov_inspection,
    "obstacle_field": scenarios.obstacle_field,
}
FORMATS = {
    "mission": "",
    "flown": "",
    "completed": "",
    "duration [s]": ".1f",
    "energy [J]": ".0f",
    "of thrusters [J]": ".0f",
    "over greedy [-]": ".2f",
    "over drag [-]": ".2f",
    "over drag and inertia [-]": ".2f",
    "water [m/s]": ".2f",
    "peak thrust [N]": ".1f",
    "tilt [rad]": ".3f",
    "threshold used [-]": ".3f",
    "estimated [-]": ".3f",
    "clear of obstacles [mm]": ".0f",
    "links apart [mm]": ".0f",
    "left": "",
}
PLANS = {
    "mission": "",
    "status": "",
    "iterations": "",
    "CPU [s]": ".1f",
    "planned [s]": ".1f",
    "planned [J]": ".0f",
    "clear [mm]": ".0f",
}
_EVERY = 20  # rows of the record between two that are looked at
PROSE = """
Greedy: the mission as `uvms-ocp run` flies it, phase after phase, by the velocity hierarchy above
the dynamic layer. As one problem: `uo.plan_mission`, within the time that the greedy mission took,
flown by `uvms-ocp run --follow`: the same dynamic layer, the same mission that goes from phase to
phase by what it measures, and the hierarchy in reserve. Sensors have the noise, rates and delays of
the robot's file.

Energy is electrical, of thrusters and joints; over drag: that of the thrusters over what a
quasi-static flight of the same way takes at least, in the same water; with inertia, what it takes
with the accelerations that were flown. The bound of drag says what a mission has to pay where the
water, whose mean speed along the way stands beside it, moves; in water at rest it goes to nothing
as the way gets slower, and what is above it are accelerations and the noise that control answers.

Threshold used: the largest true value of a condition as its phase ended, over the limit that it had
to be below; estimated: the same value as the controller knew it. Where the true one alone is over
the limit, the error is the estimate's, which no plan can take away. Clear: the least distance on a
plan between links, and to obstacles. Left: when and why the hierarchy took over. The current of
`case1 in a current` is {current} m/s.
"""


@dataclass(frozen=True, kw_only=True, slots=True)
class _Flown:
    """A run, and what it was made by."""

    mission: str
    how: str
    scenario: Scenario
    record: Record

    def row(self, greedy_energy: float | None) -> dict[str, Any]:
        """greedy_energy [J]"""
        record = self.record
        meta = self.record.run_meta
        *_, total = resources(record)
        over_greedy = None
        if greedy_energy is not None:
            over_greedy = total["energy_j"] / greedy_energy
        tilt = quantity(record, "HA.tilt")
        largest_tilt = None if tilt is None else float(np.nanmax(tilt))
        clear = None
        if self.scenario.environment.obstacles:
            clear = _clear(self.scenario, record)
        takeovers = [alarm for alarm in meta.alarms if alarm.text.startswith("plan left")]
        return {
            "mission": self.mission,
            "flown": self.how,
            "completed": meta.completed,
            "duration [s]": float(record["t"][-1]),
            "energy [J]": total["energy_j"],
            "of thrusters [J]": total["thruster_energy_j"],
            "over greedy [-]": over_greedy,
            "over drag [-]": total["thruster_energy_j"] / self._bound(),
            "over drag and inertia [-]": total["thruster_energy_j"] / self._bound(inertia=True),
            "water [m/s]": self._water(),
            "peak thrust [N]": total["peak_thrust_n"],
            "tilt [rad]": largest_tilt,
            "threshold used [-]": _used(record),
            "estimated [-]": _used(record, estimated=True),
            "clear of obstacles [mm]": clear,
            "links apart [mm]": _apart(self.scenario, record),
            "left": f"{takeovers[0].t:.1f} s: {takeovers[0].text}" if takeovers else "",
        }

    def _bound(self, *, inertia: bool = False) -> float:
        """[J]"""
        record = self.record
        current = self.scenario.environment.current
        motion = (record["t"], record["q"], record["v"])
        energy = quasi_static_energy(
            self.scenario.robot, current, *motion, every=_EVERY, inertia=inertia
        )
        return max(energy, 1e-9)

    def _water(self) -> float:
        """Mean speed [m/s] of the current around the vehicle."""
        current = self.scenario.environment.current
        rows = slice(None, None, _EVERY)
        places = self.record["q"][rows, :3]
        times = self.record["t"][rows].tolist()
        speeds = []
        for place, t in zip(places, times, strict=True):
            velocity = current.velocity(place[None], t)[0]
            speeds.append(np.linalg.norm(velocity))
        return float(np.mean(speeds))


def _used(record: Record, *, estimated: bool = False) -> float | None:
    """The largest share of the limit of a condition at the end of its phase, true or as it was
    estimated.
    """
    shares = []
    for event in record.run_meta.events:
        for condition in event.conditions:
            if condition.sign != "<" or condition.quantity not in event.truth:
                continue
            value = condition.estimated if estimated else event.truth[condition.quantity]
            shares.append(value / condition.limit)
    return max(shares, default=None)


def _clear(scenario: Scenario, record: Record) -> float:
    """Least [mm] to obstacles."""
    configurations = record["q"][::_EVERY]
    passage = closest_approach(scenario.robot, scenario.environment, configurations, floor=False)
    return 1e3 * passage.distance


def _apart(scenario: Scenario, record: Record) -> float:
    """Least [mm] between links."""
    no_obstacles = replace(scenario.environment, obstacles=())
    configurations = record["q"][::_EVERY]
    passage = closest_approach(
        scenario.robot, no_obstacles, configurations, floor=False, self_collision=True
    )
    return 1e3 * passage.distance


def measured(
    name: str, scenario: Scenario, plan_of: Callable[..., MissionPlan]
) -> tuple[list[Row], Row]:
    """Rows of both flights, and of the plan."""
    greedy = _Flown(mission=name, how="greedy", scenario=scenario, record=scenario.run())
    first = greedy.row(None)
    planning = once(lambda: plan_of(scenario, duration=first["duration [s]"]))
    plan = planning.value
    rows: list[Row] = [first]
    if plan.status.usable:
        flown = _Flown(
            mission=name, how="one problem", scenario=scenario, record=plan.fly(scenario)
        )
        rows.append(flown.row(first["energy [J]"]))
    row_of_plan = {
        "mission": name,
        "status": plan.status.value,
        "iterations": plan.iterations,
        "CPU [s]": planning.cpu,
        "planned [s]": plan.duration,
        "planned [J]": plan.energy,
        "clear [mm]": None if plan.clearance is None else 1e3 * plan.clearance,
    }
    return rows, row_of_plan


def quick_plan(scenario: Scenario, **more: Any) -> MissionPlan:
    """Plan with one iteration and few steps."""
    return plan_mission(scenario, step=60.0, options=replace(OPTIONS, max_iterations=1), **more)


def main() -> None:
    """Plan, fly, compare."""
    parser = parser_of(__doc__)
    parser.add_argument("--only", choices=MISSIONS, help="this mission alone")
    arguments, run = begin(parser)
    chosen = MISSIONS
    plan_of: Callable[..., MissionPlan] = plan_mission
    if arguments.only:
        chosen = {arguments.only: MISSIONS[arguments.only]}
    if run.quick:
        hide_compiler()
        chosen = {"reach": lambda **more: scenarios.reach(duration=0.2)}
        plan_of = quick_plan
    flights = list[Row]()
    plans = list[Row]()
    for name, make in chosen.items():
        rows, row_of_plan = measured(name, make(noise=True), plan_of)
        flights += rows
        plans.append(row_of_plan)
    run.write(
        Report(
            name="ocp_missions",
            title="Missions as one problem",
            prose=PROSE.format(current=STEADY),
            tables=[Table(rows=flights, columns=FORMATS), Table(rows=plans, columns=PLANS)],
        )
    )


if __name__ == "__main__":
    main()
