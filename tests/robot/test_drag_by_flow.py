"""Quadratic drag by the direction of the flow: the published numbers on the axes, and no way that
is cheaper between them.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from six_thrusters import six_thrusters
from tiny_robots import TINY, robot_of

from uvms_ocp.campaign.machine_parameters import _scaled
from uvms_ocp.errors import InvalidInput
from uvms_ocp.ocp import OcpRequest, OcpStatus, solve_ocp
from uvms_ocp.planning import PostureGoal
from uvms_ocp.robot.coefficients import links_in_water
from uvms_ocp.robot.description import (
    LinkCoefficients,
    LinkDescription,
    RobotDescription,
    checked_copy,
)
from uvms_ocp.robot.dynamics import robot_dynamics
from uvms_ocp.robot.hydrodynamics import LinkHydrodynamics, damping_matrix, drag_wrench
from uvms_ocp.robot.loading import load_robot

NONE = np.zeros((6, 6))
Q = np.diag([30.0, 45.0, 60.0, 2.0, 3.0, 4.0])
RNG = np.random.default_rng(3)


@pytest.mark.parametrize("axis", range(6))
@pytest.mark.parametrize("speed", [-0.7, 1.3])
def test_on_an_axis_it_is_that_of_the_axis(axis: int, speed: float) -> None:
    nu = speed * np.eye(6)[axis]
    assert drag_wrench(NONE, Q, nu, True) == pytest.approx(drag_wrench(NONE, Q, nu), abs=1e-6)
    assert damping_matrix(NONE, Q, nu, True) @ nu == pytest.approx(
        drag_wrench(NONE, Q, nu, True), abs=1e-9
    )


def test_a_body_with_the_same_drag_on_all_axes_has_it_in_all_directions() -> None:
    for R in [pin.Quaternion(RNG.normal(size=4)).normalized().matrix() for _ in range(20)]:
        u = R @ np.array([0.8, 0.0, 0.0])
        wrench = drag_wrench(
            NONE, np.diag([30.0] * 3 + [1.0] * 3), np.concatenate([u, np.zeros(3)]), True
        )
        assert wrench[:3] == pytest.approx(30.0 * 0.8 * u, abs=1e-6)


def test_rotation_is_dragged_by_axes_either_way() -> None:
    """What is published of a turn about an axis holds while the body turns about others, and
    however fast it swims.
    """
    for nu in RNG.normal(size=(20, 6)):
        assert drag_wrench(NONE, Q, nu, True)[3:] == pytest.approx(
            drag_wrench(NONE, Q, nu)[3:], abs=1e-12
        )


def test_it_takes_power_always_and_never_less_than_by_axes() -> None:
    for nu in RNG.normal(size=(200, 6)):
        power = nu @ drag_wrench(NONE, Q, nu, True)
        assert power >= nu @ drag_wrench(NONE, Q, nu) > 0.0


def test_it_has_a_slope_at_rest() -> None:
    nu = ca.SX.sym("nu", 6)
    slope = ca.Function(
        "slope", [nu], [ca.jacobian(drag_wrench(ca.DM(NONE), ca.DM(Q), nu, True), nu)]
    )(0)
    assert np.array(slope) == pytest.approx(0.0, abs=1e-3)


def test_couplings_are_refused() -> None:
    coupled = Q + 0.1 * np.eye(6, k=1)
    with pytest.raises(InvalidInput, match="by the flow has couplings; allowed: a diagonal"):
        LinkHydrodynamics(frame="hull", quadratic_drag=coupled, by_flow=True)
    rows = tuple(map(tuple, coupled.tolist()))
    with pytest.raises(ValueError, match="by the flow has couplings"):
        LinkCoefficients(quadratic_drag=rows, drag_by="flow")
    assert LinkCoefficients(quadratic_drag=rows).drag_by == "axes"


@pytest.mark.parametrize(
    "shape",
    [
        {"box": {"size": (0.8, 0.5, 0.3)}},
        {"cylinder": {"radius": 0.1, "length": 1.0}},
        {"sphere": {"radius": 0.2}},
    ],
)
def test_shapes_have_it_too_and_a_sphere_is_then_dragged_alike_in_all_directions(
    shape: dict[str, dict[str, Any]],
) -> None:
    ((name, sizes),) = shape.items()
    by_axes, by_flow = (
        links_in_water(RobotDescription(links={"hull": LinkDescription(**{name: sizes | extra})}))[
            0
        ]
        for extra in ({}, {"drag_by": "flow"})
    )
    assert (by_axes.by_flow, by_flow.by_flow) == (False, True)
    np.testing.assert_array_equal(by_axes.quadratic_drag, by_flow.quadratic_drag)
    ahead = np.array([0.6, 0.0, 0.0, 0.0, 0.0, 0.0])
    askew = np.array([0.36, 0.48, 0.0, 0.0, 0.0, 0.0])
    power_ahead = ahead @ drag_wrench(NONE, by_flow.quadratic_drag, ahead, True)
    power_askew = askew @ drag_wrench(NONE, by_flow.quadratic_drag, askew, True)
    assert name != "sphere" or power_askew == pytest.approx(power_ahead)


def test_across_a_long_thin_body_each_way_errs_between_other_axes() -> None:
    """Against the law of cross-flow, ``|v across| v across``; arms of `new-robot` have the smaller error."""
    hull, *arm = six_thrusters().hydrodynamics
    assert hull.by_flow
    assert len(arm) == 3
    for link in arm:
        assert not link.by_flow
        across = link.quadratic_drag[0, 0]
        for way, by_axes, by_flow in (
            ([1, 0, 1], 1.0, np.sqrt(2.0)),
            ([1, 1, 0], np.sqrt(0.5), 1.0),
        ):
            nu = np.array([*way, 0, 0, 0]) * 0.4
            law = across * np.linalg.norm(nu[:2]) * nu[:2]
            assert drag_wrench(NONE, link.quadratic_drag, nu)[:2] == pytest.approx(by_axes * law)
            assert drag_wrench(NONE, link.quadratic_drag, nu, True)[:2] == pytest.approx(
                by_flow * law, rel=1e-4
            )


def test_a_robot_of_a_file_has_it_and_keeps_it_where_its_drag_is_varied() -> None:
    robot = robot_of(TINY["no joints"])
    (name, hull), *_ = robot.description.links.items()
    assert hull.coefficients is not None
    flow = {
        name: hull.model_copy(
            update={"coefficients": hull.coefficients.model_copy(update={"drag_by": "flow"})}
        )
    }
    description = checked_copy(robot.description, links=flow)
    by_flow = replace(robot, description=description, hydrodynamics=links_in_water(description))
    thicker = _scaled("water.drag", ("linear_drag", "quadratic_drag"), by_flow, 2.0)
    q = robot.configuration()
    acceleration = np.zeros(robot.n_v)
    v = np.array([0.5, 0.4, -0.3, 0.0, 0.0, 0.0])
    plain, new, twice = (
        robot_dynamics(any_robot).inverse_dynamics(q, v, acceleration)[:3]
        for any_robot in (robot, by_flow, thicker)
    )
    (link,) = robot.hydrodynamics
    expected = [
        drag_wrench(link.linear_drag, link.quadratic_drag, v, flow)[:3] for flow in (False, True)
    ]
    assert new - plain == pytest.approx(expected[1] - expected[0], abs=1e-6)
    assert twice - new == pytest.approx(expected[1], abs=1e-6)


@pytest.mark.slow
def test_a_plan_swims_straight_where_nothing_is_gained_askew() -> None:
    """3 m ahead in 6 s: by axes it is cheaper as a corkscrew."""
    robot = load_robot("bluerov2_alpha5")
    hull = robot.description.links["base_link"]
    assert hull.coefficients is not None
    by_axes = {
        "base_link": hull.model_copy(
            update={"coefficients": hull.coefficients.model_copy(update={"drag_by": "axes"})}
        )
    }
    description = checked_copy(robot.description, links=robot.description.links | by_axes)
    turns = []
    for any_robot in (
        replace(robot, description=description, hydrodynamics=links_in_water(description)),
        robot,
    ):
        goal = PostureGoal(position=(3.0, 0.0, -5.0))
        plan = solve_ocp(
            OcpRequest(
                robot=any_robot,
                start=any_robot.configuration(position=(0.0, 0.0, -5.0)),
                goal=goal,
                duration=6.0,
            )
        ).plan
        assert plan.status is OcpStatus.SOLVED
        turns.append(
            max(
                np.linalg.norm(pin.log3(pin.Quaternion(q[3:7]).matrix())) for q in plan.trajectory.q
            )
        )
    assert turns[0] > 0.5
    assert turns[1] < 0.06
