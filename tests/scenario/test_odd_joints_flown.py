"""A joint without end, in a plane or without range changes nothing else: what is checked, flown and
planned is the twin's.
"""

from __future__ import annotations

from typing import Any

import coal
import numpy as np
import pytest
from odd_robots import ODD, Pair, pair_of, places, reach_of, start_of

from uvms_ocp.cli.options import SOLVERS
from uvms_ocp.errors import InvalidInput
from uvms_ocp.ocp.plan import OcpStatus
from uvms_ocp.ocp.request import OcpRequest, solve_ocp
from uvms_ocp.planning.request import PlanRequest, PostureGoal, ToolGoal, plan_path
from uvms_ocp.report.planned_motion import motion_record
from uvms_ocp.robot.shapes.obstacles import obstacle
from uvms_ocp.robot.signals import IDEAL_SENSORS, SensorSpecs

BALL = obstacle("ball", coal.Sphere(0.1), (0.6, -0.5, -5.0))


def flown_alike(pair: Pair, allowed: float, **options: Any) -> None:
    """Within [m], and to the same end."""
    odd, twin = (reach_of(robot, **options).run() for robot in (pair.odd, pair.twin))
    assert odd.run_meta.completed
    assert twin.run_meta.completed
    n = min(len(odd), len(twin))
    assert max(len(odd), len(twin)) < 1.02 * n
    assert np.abs(places(pair.odd, odd["q"][:n]) - places(pair.twin, twin["q"][:n])).max() < allowed


@pytest.mark.sampled
@pytest.mark.parametrize("kind", ODD)
def test_pre_flight_finds_the_same_of_both(kind: str) -> None:
    pair = pair_of(kind)
    odd, twin = (reach_of(robot, sensors=SensorSpecs()).check() for robot in (pair.odd, pair.twin))
    assert odd.accepted
    assert twin.accepted
    expected_checks = {"continuous": (), "planar": ("limits",), "zero range": ("joints", "forces")}[
        kind
    ]  # no speed; no range, a motor
    told = [
        [
            (finding.check, finding.phase, finding.text)
            for finding in report.findings
            if finding.check not in expected_checks
        ]
        for report in (odd, twin)
    ]
    assert told[0] == told[1]


@pytest.mark.slow
@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("kind", ODD)
def test_each_solver_moves_both_alike(kind: str, solver: str) -> None:
    flown_alike(
        pair_of(kind), 2e-3, plant="kinematic", sensors=IDEAL_SENSORS, solver=SOLVERS[solver]()
    )


@pytest.mark.slow
@pytest.mark.parametrize("kind", ODD)
def test_in_water_and_noise_both_are_flown_alike(kind: str) -> None:
    """Estimator, health, controller and plant together; of another number of encoders the noise is
    another.
    """
    flown_alike(pair_of(kind), 0.02, plant="dynamic", sensors=SensorSpecs())


GOALS = {
    "a posture": lambda tool: PostureGoal(
        position=(1.0, 0.3, -5.0), rpy=(0.0, 0.0, 0.6), joints={"turn2": 0.4}
    ),
    "a tool": lambda tool: ToolGoal(position=tuple(tool + np.array([0.5, 0.3, -0.1]))),
}


@pytest.mark.parametrize("goal", GOALS)
@pytest.mark.parametrize("kind", ["continuous", "zero range"])
def test_a_curve_is_planned_alike(kind: str, goal: str) -> None:
    reached = []
    for robot in (pair_of(kind).odd, pair_of(kind).twin):
        start = start_of(robot)
        goal_place = GOALS[goal](places(robot, start)[0, 3:])
        result = plan_path(
            PlanRequest(robot=robot, start=start, goal=goal_place, obstacles=(BALL,))
        )
        assert result.plan is not None
        assert result.collision_free
        reached.append(places(robot, motion_record(result, result.plan)["q"]))
    np.testing.assert_allclose(reached[0], reached[1], atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["continuous", "zero range"])
def test_optimal_control_plans_alike(kind: str) -> None:
    """Motors that hold a joint without range take what a weld does not."""
    costs = []
    for robot in (pair_of(kind).odd, pair_of(kind).twin):
        goal = GOALS["a posture"](None)
        plan = solve_ocp(
            OcpRequest(robot=robot, start=start_of(robot), goal=goal, obstacles=(BALL,), n_steps=15)
        ).plan
        assert plan.status is OcpStatus.SOLVED
        costs.append(plan.levels[-1].residual)
    assert (
        costs[0] == pytest.approx(costs[1], rel=2e-3)
        if kind == "continuous"
        else costs[0] > costs[1]
    )


@pytest.mark.parametrize("planned", [plan_path, solve_ocp])
def test_what_plans_one_number_a_joint_refuses_a_joint_of_three_with_the_way_out(
    planned: Any,
) -> None:
    robot = pair_of("planar").odd
    request = {plan_path: PlanRequest, solve_ocp: OcpRequest}[planned]
    with pytest.raises(
        InvalidInput,
        match=r"joint 'turn1' has 3 axes; planning needs joints of one; --lock fixes it",
    ):
        planned(
            request(robot=robot, start=start_of(robot), goal=PostureGoal(joints={"turn0": 0.4}))
        )
