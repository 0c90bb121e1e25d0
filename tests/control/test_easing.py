"""Accelerations rise and fall: phase changes are as smooth as with weights, and safety is not
eased.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hierarchy_solvers.daqp_hierarchy import Daqp

from uvms_ocp.control.velocity.kinematic import HierarchySolver
from uvms_ocp.control.velocity.levels import JERK_LIMIT, LevelsProblem, build_levels
from uvms_ocp.report.comparison import transition_table
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.scenario.cases.case1 import case1, priority_swap
from uvms_ocp.scenario.cases.case2 import case2
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.solvers.hierarchy.active_set import LexicographicActiveSet
from uvms_ocp.solvers.hierarchy.cascade import LexicographicQp
from uvms_ocp.solvers.hierarchy.icat import Icat
from uvms_ocp.solvers.hierarchy.level import row_slices
from uvms_ocp.tasks.hierarchy import Hierarchy

DT = 0.02
RISE = 0.07  # [s] from rest to the acceleration limit
MISSIONS: list[tuple[Callable[..., Scenario], list[HierarchySolver]]] = [
    (case1, [LexicographicActiveSet(), LexicographicQp(), Daqp(certified=False)]),
    (case2, [LexicographicActiveSet()]),
    (priority_swap, [LexicographicActiveSet()]),
]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mission", "solvers"), MISSIONS, ids=[mission.__name__ for mission, _ in MISSIONS]
)
def test_phase_changes_are_no_rougher_than_with_weights_break_no_acceleration_limit_and_take_nothing_from_safety(
    mission: Callable[..., Scenario], solvers: list[HierarchySolver]
) -> None:
    records = {
        str(k): mission(solver=s, plant="kinematic", dt=DT).run()
        for k, s in enumerate([Icat(), *solvers])
    }
    assert all(record.meta.completed for record in records.values())
    rows = [row for row in transition_table(records) if row["change"] != "all"]
    weighted = max(row["jerk"] for row in rows if row["run"] == "0")
    for row in rows:
        if row["run"] != "0":
            assert row["jerk"] <= weighted, row
            assert row["step"] <= 1.0 + 1e-4, row  # DAQP's tolerance
            assert row["lost"] <= 1e-5 or mission is priority_swap, (
                row
            )  # which puts an action above safety


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("girona_maris7_full")


@pytest.fixture(scope="module")
def problem(robot: Robot) -> LevelsProblem:
    return build_levels(robot, Hierarchy([]), DT)


def easing(
    problem: LevelsProblem, robot: Robot, previous: np.ndarray, change: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of the level that eases."""
    outputs = problem.function(
        robot.configuration(),
        previous,
        np.zeros(4),
        previous,
        change,
        5.0,
        np.zeros(0),
        np.zeros(0),
    )
    rows = list(row_slices(problem.sizes))[problem.names.index(JERK_LIMIT)]
    return np.array(outputs[1]).ravel()[rows], np.array(outputs[2]).ravel()[rows]


def test_an_axis_goes_on_as_it_went_give_or_take_its_jerk(
    problem: LevelsProblem, robot: Robot
) -> None:
    jerk = robot.limits.acceleration / RISE
    rng = np.random.default_rng(1)
    for _ in range(20):
        change = rng.uniform(-1.0, 1.0, robot.n_v) * robot.limits.acceleration * DT
        previous = np.sign(change) * rng.uniform(0.1, 0.5, robot.n_v)
        lower, upper = easing(problem, robot, previous, change)
        np.testing.assert_allclose(lower, previous + change - jerk * DT**2)
        np.testing.assert_allclose(upper, previous + change + jerk * DT**2)


def test_what_is_left_of_a_braking_pushes_no_axis_backwards(
    problem: LevelsProblem, robot: Robot
) -> None:
    """However hard it was braked, and from whatever is left of its speed, an axis can come to rest
    and stay there.
    """
    step = robot.limits.acceleration * DT
    for share in (0.0, 1e-3, 0.1, 0.5, 1.0, 3.0):
        v = share * step
        change = -step
        for _ in range(60):
            lower, upper = easing(problem, robot, v, change)
            assert (upper >= 0.0).all()
            following = np.clip(0.0, lower, upper)
            change = following - v
            v = following
            assert (v >= -1e-12).all()
        np.testing.assert_allclose(v, 0.0, atol=1e-9)


def _problem(mission: Callable[..., Scenario]) -> tuple[Scenario, LevelsProblem]:
    scenario = mission(plant="kinematic")
    return scenario, scenario.kinematic_controller().problem


def test_easing_is_below_what_keeps_the_robot_safe_and_above_what_is_wanted() -> None:
    scenario, problem = _problem(case1)
    assert problem.names[:6] == ("limits", "NR", "JL", "MAC", "HA", JERK_LIMIT)
    assert problem.names[6:] == (*scenario.mission.hierarchy.names[4:], "rest")


def test_where_an_order_puts_an_action_above_safety_easing_is_above_that_action(
    problem: LevelsProblem,
) -> None:
    _, swapped = _problem(priority_swap)
    assert swapped.names.index(JERK_LIMIT) < min(
        swapped.names.index("PC"), swapped.names.index("HA")
    )
    assert problem.names == ("limits", JERK_LIMIT, "rest")
