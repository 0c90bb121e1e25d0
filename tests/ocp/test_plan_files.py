"""Laws of a plan that is kept: every number comes back, what is no plan is refused in one line."""

from __future__ import annotations

import io
import json
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from reaches import reach

from uvms_ocp.errors import InvalidInput, OutputError
from uvms_ocp.ocp.ball_clearance import Ball, BallClearance
from uvms_ocp.ocp.plan import OcpStatus, Plan
from uvms_ocp.ocp.planner import Planner
from uvms_ocp.ocp.problem import OcpLevel, single_phase
from uvms_ocp.ocp.stagewise.levels import StagewisePoint
from uvms_ocp.ocp.terms import Effort
from uvms_ocp.planning.conservative_advancement import ClearanceReport
from uvms_ocp.planning.scene import NearestPair
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import State
from uvms_ocp.solvers.nlp.level_solver import NlpPoint

SUFFIXES = ("npz", "json")


@pytest.fixture(scope="module")
def plan(planner: Planner) -> Plan:
    return planner.plan()


@pytest.fixture(scope="module")
def small() -> Plan:
    arm = load_robot("planar5")
    start = State(q=arm.configuration(), v=np.zeros(arm.n_v))
    levels = [OcpLevel(name="effort", terms=(Effort(),))]
    problem = single_phase(
        robot=arm, start=start, duration=1.0, n_steps=2, levels=levels, water=False
    )
    return Planner(problem).plan()


def assert_same(one: Any, other: Any) -> None:
    """Down to the last bit; of a point that was found stage by stage but for its last QP."""
    if isinstance(one, StagewisePoint):
        one = NlpPoint(
            x=one.x, x_multipliers=one.x_multipliers, row_multipliers=one.row_multipliers
        )
    assert type(one) is type(other)
    if isinstance(one, np.ndarray):
        np.testing.assert_array_equal(one, other, strict=True)
    elif isinstance(one, tuple):
        assert len(one) == len(other)
        for first, second in zip(one, other, strict=True):
            assert_same(first, second)
    elif hasattr(one, "__dataclass_fields__") and not isinstance(one, Robot):
        for item in fields(one):
            assert_same(getattr(one, item.name), getattr(other, item.name))
    elif not isinstance(one, Robot):
        assert one == other


@pytest.mark.sampled
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_plan_comes_back_exactly(
    plan: Plan, planner: Planner, suffix: str, tmp_path: Path
) -> None:
    loaded = Plan.load(plan.save(tmp_path / f"plan.{suffix}"))
    assert_same(plan, loaded)
    assert loaded.robot.name == plan.robot.name
    assert planner.plan(guess=loaded).iterations <= 1, "multipliers too"


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("distance", [0.25, np.inf])
def test_what_a_plan_is_proven_to_keep_clear_of_comes_back(
    small: Plan, suffix: str, distance: float, tmp_path: Path
) -> None:
    nearest = NearestPair(distance=distance, time=0.5, pair="link_1 - ball")
    report = ClearanceReport(
        collision_free=True, undecided=False, nearest=nearest, n_samples=9, unshaped=("arm",)
    )
    plan = replace(small, clearance=report)
    assert_same(plan, Plan.load(plan.save(tmp_path / f"plan.{suffix}")))


@pytest.mark.slow
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_plan_that_failed_comes_back_too(
    planner: Planner, robot: Robot, suffix: str, tmp_path: Path
) -> None:
    fast = np.zeros(robot.n_v)
    fast[4] = 5.0
    impossible = planner.plan(
        replace(planner.problem, start=State(q=planner.problem.start.q, v=fast))
    )
    missed = planner.plan(reach(robot, duration=1.2), diagnose=False)
    for plan in (impossible, missed):
        assert_same(plan, Plan.load(plan.save(tmp_path / f"plan.{suffix}")))


def test_a_plan_knows_what_is_around_it(robot: Robot, tmp_path: Path) -> None:
    ball = Ball(centre=(9.0, 0.0, -5.0), radius=0.5)
    clear = BallClearance(robot_balls=(Ball(frame="base_link", radius=0.5),), obstacles=(ball,))
    problem = reach(robot, constraints=(clear,), floor=-30.0, current=np.array([0.1, 0.0, 0.0]))
    fast = np.zeros(robot.n_v)
    fast[4] = 5.0
    plan = Planner(replace(problem, start=State(q=problem.start.q, v=fast))).plan()
    assert plan.status is OcpStatus.INFEASIBLE
    around = Plan.load(plan.save(tmp_path / "plan.npz")).surroundings
    assert [(item.name, item.position, item.size) for item in around.obstacles] == [
        ("obstacle 1", ball.centre, (ball.radius,))
    ]
    assert [frame.name for frame in around.frames] == ["goal of T"]
    assert around.floor_z == -30.0
    assert plan.current == pytest.approx((0.1, 0.0, 0.0))


def test_a_plan_of_another_robot_or_of_nobody_is_refused(
    small: Plan, robot: Robot, tmp_path: Path
) -> None:
    path = small.save(tmp_path / "plan.npz")
    with pytest.raises(InvalidInput, match="a plan of robot 'planar5', not of 'girona"):
        Plan.load(path, robot)
    own = replace(small, robot=replace(small.robot, name="mine"))
    path = own.save(tmp_path / "own.npz")
    with pytest.raises(
        InvalidInput,
        match=r"'mine' is not in the library; give it: --robot DIR, or Plan\.load\(path, robot\)",
    ):
        Plan.load(path)
    assert Plan.load(path, own.robot).robot is own.robot


def arrays_and_text(path: Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    with np.load(path) as file:
        arrays = dict(file)
    return arrays, json.loads(str(arrays.pop("summary")))


DAMAGES: dict[str, tuple[Any, str]] = {
    "no trajectory": (lambda arrays, text: arrays.pop("q"), "array 'q' has shape None"),
    "another shape": (
        lambda arrays, text: arrays.update(v=arrays["v"][:, 1:]),
        "array 'v' has shape",
    ),
    "times that fall": (
        lambda arrays, text: arrays.update(t=arrays["t"][::-1].copy()),
        "times t do not rise from 0",
    ),
    "a number that is none": (
        lambda arrays, text: arrays.update(a=np.nan * arrays["a"]),
        "allowed: finite float64",
    ),
    "another type": (
        lambda arrays, text: arrays.update(t=arrays["t"].astype(np.float32)),
        "allowed: finite float64",
    ),
    "another version": (lambda arrays, text: text.update(version="9"), "version"),
    "an unknown key": (lambda arrays, text: text.update(more=1), "more|lists that are"),
    "an unknown array": (lambda arrays, text: arrays.update(more=np.zeros(2)), "'more'"),
    "an unknown status": (lambda arrays, text: text.update(status="good"), "good"),
    "a result without points": (
        lambda arrays, text: arrays.pop("point_0"),
        "solver's result lacks",
    ),
    "a result of two sizes": (
        lambda arrays, text: arrays.update(x=arrays["x"][1:]),
        "arrays of the solver's result do not fit",
    ),
    "a robot that is a path": (
        lambda arrays, text: text.update(robot="../../etc"),
        "is not in the library",
    ),
}


@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_file_that_is_no_plan_is_refused_in_one_line(
    small: Plan, damage: str, suffix: str, tmp_path: Path
) -> None:
    change, message = DAMAGES[damage]
    arrays, text = arrays_and_text(small.save(tmp_path / "plan.npz"))
    change(arrays, text)
    path = tmp_path / f"bad.{suffix}"
    if suffix == "npz":
        np.savez(path, summary=np.array(json.dumps(text)), **arrays)  # type: ignore[arg-type]
    else:
        path.write_text(json.dumps(text | {name: array.tolist() for name, array in arrays.items()}))
    if (suffix, damage) == ("json", "another type"):
        assert_same(small, Plan.load(path))  # a text does not tell 1 from 1.0
        return
    with pytest.raises(InvalidInput, match=message) as caught:
        Plan.load(path)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(str(path))


def test_what_is_no_file_of_ours_at_all_is_refused_in_one_line(small: Plan, tmp_path: Path) -> None:
    whole = small.save(tmp_path / "plan.npz").read_bytes()
    pickled = io.BytesIO()
    np.savez(pickled, q=np.array([object()]), allow_pickle=True)
    contents = (b"", b"{}", b"[1, 2]", b"[" * 100_000, whole[: len(whole) // 2], pickled.getvalue())
    for suffix in SUFFIXES:
        for content in contents:
            path = tmp_path / f"bad.{suffix}"
            path.write_bytes(content)
            with pytest.raises(InvalidInput, match="not a plan") as caught:
                Plan.load(path)
            assert "\n" not in str(caught.value)
    with pytest.raises(InvalidInput, match="No such file"):
        Plan.load(tmp_path / "nowhere.json")
    with pytest.raises(OutputError, match="choose another place"):
        small.save(tmp_path / "no" / "folder" / "plan.json")
