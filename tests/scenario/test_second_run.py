"""A second run of a robot and mission makes no expression anew, and gives the record that it gives
alone.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from uvms_ocp.control.velocity import levels
from uvms_ocp.robot import load_robot
from uvms_ocp.scenario.cases.case1 import case1
from uvms_ocp.scenario.scenario import pose_at
from uvms_ocp.tasks.hierarchy import Hierarchy
from uvms_ocp.tasks.pose import VehiclePose
from uvms_ocp.tasks.task import Rows

DT = 1 / 200
SPEED = "vehicle.speed"
CLOCKS = {"solve_time", "controller_time", "tick_time"}


def noisy_case1(seed: int = 0, **more: Any) -> Any:
    return case1(noise=True, seed=seed, duration=11 * DT, dt=DT, **more)


def test_a_second_run_makes_no_casadi_function(monkeypatch: pytest.MonkeyPatch) -> None:
    noisy_case1().run()
    built_parts = list[Any]()
    real = ca.Function.__init__

    def counted(self: ca.Function, *given: Any) -> None:
        built_parts.extend(given[:1])
        real(self, *given)

    monkeypatch.setattr(ca.Function, "__init__", counted)
    noisy_case1(seed=1, target=(12.0, 37.0, -39.5)).run()
    assert [name for name in built_parts if isinstance(name, str)] == []


def test_what_is_kept_changes_no_bit_of_a_record() -> None:
    noisy_case1(seed=2).run()
    again = noisy_case1(seed=3).run()
    levels._known_levels.cache_clear()
    alone = noisy_case1(seed=3).run()
    assert again.series.keys() == alone.series.keys()
    for name in again.series.keys() - CLOCKS:
        np.testing.assert_array_equal(again[name], alone[name], err_msg=name)


class OwnPose(VehiclePose):
    """Of a user, who may change what its rows read."""

    def rows(self, symbols: Any, parameters: ca.SX) -> Rows:
        return VehiclePose.rows(self, symbols, parameters)


def test_levels_are_shared_by_goals_and_by_nothing_else() -> None:
    robot = load_robot("bluerov2")
    goal = pose_at((0.0, 0.0, -3.0))
    task = VehiclePose(goal=goal)

    def of(*tasks: Any, dt: float = DT, beside: tuple[str, ...] = ()) -> levels.LevelsProblem:
        return levels.build_levels(robot, Hierarchy(tasks), dt, beside)

    first = of(task)
    assert of(replace(task, goal=pose_at((1.0, 0.0, -3.0)))) is first
    second_task = replace(task, name="PC2")
    differing = [
        of(replace(task, gain_linear=0.3)),
        of(second_task),
        of(task, second_task),
        of(task, dt=0.01),
        of(task, beside=(SPEED,)),
    ]
    assert first not in differing
    own_task = OwnPose(goal=goal)
    assert of(own_task) is not of(own_task)
