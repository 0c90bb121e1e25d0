"""Laws of every task: its Jacobian, its bounds and its behaviour at singular points."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from task_registry import GOAL, REGISTRY, TARGET
from task_values import OUTPUTS, evaluate, random_configuration, task_function

from uvms_ocp.control.velocity.levels import tick_symbols
from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.tasks.activation import SmoothActivation
from uvms_ocp.tasks.altitude import MinimumAltitude
from uvms_ocp.tasks.attitude import Alignment, FieldOfView, HorizontalAttitude
from uvms_ocp.tasks.joints import JointLimits, JointTracking, Manipulability
from uvms_ocp.tasks.pose import ToolPose, VehiclePose
from uvms_ocp.tasks.task import Task
from uvms_ocp.tasks.vehicle_velocity import NullVelocity

STEP = 1e-6


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("girona_maris7_full")


@pytest.mark.sampled
@pytest.mark.parametrize("name", REGISTRY)
def test_jacobian_equals_finite_differences_at_random_states(name: str, robot: Robot) -> None:
    entry = REGISTRY[name]
    rng = np.random.default_rng(7)
    function = task_function(robot, entry.task)
    for _ in range(100):
        q = random_configuration(robot, rng)
        J = np.array(function(q, np.zeros(robot.n_v), 2.0, entry.task.reference(0.0))[0])
        difference = np.empty_like(J)
        for i in range(robot.n_v):
            step = np.zeros(robot.n_v)
            step[i] = STEP
            ahead, behind = (
                pin.integrate(robot.model, q, step),
                pin.integrate(robot.model, q, -step),
            )
            difference[:, i] = entry.displacement(robot, behind, ahead) / (2 * STEP)
        np.testing.assert_allclose(J, difference, atol=1e-6 * max(1.0, np.abs(J).max()), rtol=0)


@pytest.mark.parametrize("name", REGISTRY)
def test_rows_are_finite_and_consistent(name: str, robot: Robot) -> None:
    entry = REGISTRY[name]
    rng = np.random.default_rng(3)
    for _ in range(5):
        values = evaluate(robot, entry.task, random_configuration(robot, rng))
        assert np.isfinite(values["jacobian"]).all()
        assert np.isfinite(values["rate"]).all()
        assert (values["lower"] <= values["upper"]).all()
        assert ((values["activation"] >= 0) & (values["activation"] <= 1)).all()
        if entry.task.equality:
            np.testing.assert_array_equal(values["lower"], values["rate"])
            np.testing.assert_array_equal(values["upper"], values["rate"])


RANGES: dict[str, Task] = {
    "JL": JointLimits(),
    "JL with a guard": JointLimits(guard=0.15),
    "MAC": MinimumAltitude(),
    "HA": HorizontalAttitude(aim=0.8),
    "AT": Alignment(goal=TARGET, aim=1.5),
    "FV": FieldOfView(goal=TARGET, frame="tool", axis=(0.0, 0.0, 1.0), aim=1.5),
    "MU": Manipulability(),
}


def test_every_range_of_the_registry_is_listed() -> None:
    ranges = {name for name, entry in REGISTRY.items() if not entry.task.equality}
    assert ranges <= set(RANGES)


@pytest.mark.parametrize("name", RANGES)
def test_a_range_is_the_same_over_a_horizon_as_in_the_hierarchy(name: str, robot: Robot) -> None:
    """At rest the rows of a tick allow to stay exactly where the residual is in its range."""
    task = RANGES[name]
    rng = np.random.default_rng(5)
    stays = []
    rows_at = task_function(robot, task)
    residual_at = residual_function(robot, task)
    for _ in range(60):
        q = random_configuration(robot, rng)
        reach = float(rng.uniform(0.2, 3.0))
        q[robot.joint_q] *= rng.uniform(0.0, 1.3)
        rows = rows_at.call([q, np.zeros(robot.n_v), reach, task.reference(0.0)])
        _, _, low, high, _ = (np.array(part).ravel() for part in rows[: len(OUTPUTS)])
        value, lower, upper = (
            np.array(part).ravel() for part in residual_at(q, reach, task.reference(0.0))
        )
        inside = (lower <= value) & (value <= upper)
        np.testing.assert_array_equal((low <= 0) & (high >= 0), inside)
        stays += inside.tolist()
    assert {True, False} == set(stays)


def residual_function(robot: Robot, task: Task) -> ca.Function:
    symbols = tick_symbols(robot, 0.005)
    goals = ca.SX.sym("goals", task.n_parameters(robot))
    residual = task.residual(symbols, goals)
    inputs = [symbols.q, symbols.altimeter_range, goals]
    return ca.Function(
        "residual", inputs, [residual.value, ca.DM(residual.lower), ca.DM(residual.upper)]
    )


def test_rpy_of_the_start_is_the_tilt(robot: Robot) -> None:
    q = robot.configuration(rpy=[0.0, -0.06, 0.5])
    assert evaluate(robot, HorizontalAttitude(), q)["tilt"].item() == pytest.approx(0.06, abs=1e-12)


@pytest.mark.parametrize(("roll", "tilt"), [(0.0, 0.0), (np.pi, np.pi)])
def test_horizontal_attitude_survives_upright_and_upside_down(
    roll: float, tilt: float, robot: Robot
) -> None:
    values = evaluate(robot, HorizontalAttitude(), robot.configuration(rpy=[roll, 0.0, 0.0]))
    assert values["tilt"].item() == pytest.approx(tilt, abs=1e-6)
    assert np.linalg.norm(values["jacobian"]) == pytest.approx(1.0)


def test_alignment_survives_facing_away_from_the_target(robot: Robot) -> None:
    task = Alignment(goal=np.array([-5.0, 0.0, -2.0]))
    values = evaluate(robot, task, robot.configuration())
    assert values["misalignment"].item() == pytest.approx(np.pi)
    assert abs(values["jacobian"][0, 5]) == pytest.approx(1.0)
    assert values["upper"].item() < 0


def test_alignment_reports_a_target_straight_below_instead_of_dividing_by_zero(
    robot: Robot,
) -> None:
    values = evaluate(robot, Alignment(goal=np.array([0.0, 0.0, -2.0])), robot.configuration())
    assert values["overhead"].item() == 1
    assert not values["jacobian"].any()
    assert values["misalignment"].item() == 0


def test_a_target_that_moves_sideways_turns_the_line_of_sight(robot: Robot) -> None:
    """The strict bound leaves room for the target's own motion: at rest the misalignment changes by
    its part.
    """
    speed = 0.3
    distance = 2.0

    def moving(t: float) -> tuple[np.ndarray, np.ndarray]:
        return np.array([distance, 0.1 + speed * t, 0.0]), np.array([0.0, speed, 0.0])

    task = Alignment(goal=moving)
    q = robot.configuration()
    still, ahead = (
        evaluate(robot, Alignment(goal=moving(t)[0]), q)["misalignment"].item() for t in (0.0, 1e-6)
    )
    drift = (ahead - still) / 1e-6
    fixed = evaluate(robot, Alignment(goal=moving(0.0)[0]), q)["upper"].item()
    assert evaluate(robot, task, q)["upper"].item() == pytest.approx(fixed - drift, rel=1e-5)


def test_altitude_is_the_vertical_part_of_the_range(robot: Robot) -> None:
    q = robot.configuration(rpy=[0.3, 0.2, 1.0])
    values = evaluate(robot, MinimumAltitude(), q, altimeter_range=3.0)
    assert values["altitude"].item() == pytest.approx(3.0 * np.cos(0.3) * np.cos(0.2))


@pytest.mark.parametrize("turn", [1e-9, 1e-4, 1.0, np.pi - 1e-9])
def test_pose_error_is_the_rotation_vector_at_any_angle(turn: float, robot: Robot) -> None:
    task = VehiclePose(goal=pin.SE3(pin.exp3(np.array([0.0, turn, 0.0])), np.zeros(3)))
    values = evaluate(robot, task, robot.configuration())
    assert values["orientation_error"].item() == pytest.approx(turn, abs=1e-8)
    expected = min(task.gain_angular * turn, task.saturation_angular)
    assert abs(values["rate"][4, 0]) == pytest.approx(expected, abs=1e-8)


def test_pose_references_saturate_with_their_direction_kept(robot: Robot) -> None:
    goal = pin.SE3(np.eye(3), np.array([30.0, 40.0, 0.0]))
    rate = evaluate(robot, VehiclePose(goal=goal), robot.configuration())["rate"][:3, 0]
    np.testing.assert_allclose(rate, 0.5 * np.array([0.6, 0.8, 0.0]), atol=1e-12)


def test_joint_limits_lead_back_from_the_margin_and_bound_the_approach(robot: Robot) -> None:
    joints = robot.home.copy()
    joints[1] = robot.limits.position_upper[1] - 0.01
    values = evaluate(robot, JointLimits(), robot.configuration(joints=joints))
    assert values["activation"][1, 0] > 0.9
    assert values["rate"][1, 0] < 0
    assert 0 < values["upper"][1, 0] <= 0.2 * 0.01 + 1e-12


def test_a_joint_beyond_its_limit_is_asked_to_come_back(robot: Robot) -> None:
    q = robot.configuration()
    q = np.array(q)
    q[7] = robot.limits.position_lower[0] - 0.05
    lower, rate = (evaluate(robot, JointLimits(), q)[key][0, 0] for key in ("lower", "rate"))
    assert lower > 0
    assert rate > 0


def test_a_goal_can_be_a_function_of_time(robot: Robot) -> None:
    task = JointTracking(joints=("joint5",), goal=lambda t: (np.array([2 * t]), np.array([2.0])))
    np.testing.assert_allclose(task.reference(0.25), [0.5, 2.0])
    assert evaluate(robot, task, robot.configuration())["rate"].item() == pytest.approx(
        2.0 - 0.5 * 0.0137
    )


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (
            lambda: VehiclePose(goal=GOAL, gain_linear=-1.0),
            "VehiclePose: gain_linear = -1.0; give a number > 0",
        ),
        (lambda: ToolPose(goal=np.eye(4)), "ToolPose: goal = array.*; give a pinocchio.SE3"),
        (lambda: Alignment(goal=np.zeros(2)), r"AT: goal of shape \(2,\)"),
        (
            lambda: JointTracking(joints=("joint1",), goal=np.array([np.nan])),
            "MP: goal .*nan.* give finite",
        ),
        (lambda: JointLimits(margin=0.6), "JL: margin = 0.6"),
        (
            lambda: JointLimits(margin=0.3, guard=0.2),
            "guard = 0.2; give shares of the range, together below 0.5",
        ),
        (lambda: JointLimits(guard=-0.1), "guard = -0.1"),
        (lambda: NullVelocity(axes=(7,)), r"NR: axes \(7,\)"),
        (lambda: SmoothActivation(0.2, 0.1), r"SmoothActivation\(0.2, 0.1\)"),
        (lambda: Manipulability().with_goal(1), "MU: Manipulability has no goal"),
    ],
)
def test_mistakes_in_tasks_are_named(build: object, message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        build()  # type: ignore[operator]


def test_a_misspelled_field_raises() -> None:
    with pytest.raises(TypeError, match="gian"):
        VehiclePose(goal=GOAL, gian=1.0)  # type: ignore[call-arg]
