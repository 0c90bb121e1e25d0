"""What tasks ask for: errors that decay, at rates that saturate."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from task_registry import REGISTRY
from task_values import random_configuration, task_function

from uvms_ocp.control.velocity.goals import task_parameters
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.tasks.attitude import Alignment, FieldOfView
from uvms_ocp.tasks.task import Task

STEP = 1e-6


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("girona_maris7_full")


def gains_of(task: Task) -> list[float]:
    """[1/s] of the rows, or of their linear and their angular half; empty where there is no error
    to decay.
    """
    return [
        getattr(task, name)
        for name in ("gain", "gain_linear", "gain_angular")
        if hasattr(task, name)
    ]


def saturations_of(task: Task) -> list[float]:
    """Of the same rows."""
    names = ("saturation", "saturation_linear", "saturation_angular")
    return [getattr(task, name) for name in names if hasattr(task, name)] or [np.inf]


def unsaturated(task: Task) -> Task:
    names = ("saturation", "saturation_linear", "saturation_angular")
    return replace(task, **{name: 1e6 for name in names if hasattr(task, name)})


FLOOR = -6.0
"""[m] z of a floor below the altimeter."""
WITH_GAIN = [name for name, entry in REGISTRY.items() if gains_of(entry.task)]


def asked(
    robot: Robot, function: ca.Function, task: Task, q: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Jacobian and rate of the rows above a level floor."""
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    beam = data.oMf[robot.frame_id("altimeter")]
    echo = (beam.translation[2] - FLOOR) / beam.rotation[2, 2]
    J, rate = function(q, np.zeros(robot.n_v), echo, task_parameters(task, task.reference(0.0), q))[
        :2
    ]
    return np.array(J), np.array(rate)[:, 0]


@pytest.mark.parametrize("name", WITH_GAIN)
def test_an_error_decays_with_the_gain_of_its_task(name: str, robot: Robot) -> None:
    """``d rate / dt = -gain rate`` along the motion that is asked for, where nothing saturates."""
    task = unsaturated(REGISTRY[name].task)
    rng = np.random.default_rng(11)
    function = task_function(robot, task)
    moved = 0
    for _ in range(20):
        q = random_configuration(robot, rng)
        J, rate = asked(robot, function, task, q)
        v = np.linalg.lstsq(J, rate, rcond=None)[0]
        if np.linalg.norm(J @ v - rate) > 1e-9 or not np.linalg.norm(rate) > 1e-6:
            continue
        moved += 1
        ahead, behind = (
            asked(robot, function, task, pin.integrate(robot.model, q, dt * v))[1]
            for dt in (STEP, -STEP)
        )
        gains = np.repeat(gains_of(task), len(rate) // len(gains_of(task)))
        np.testing.assert_allclose(
            (ahead - behind) / (2 * STEP), -gains * rate, atol=1e-5 * max(1.0, np.abs(v).max())
        )
    assert moved >= 2


@pytest.mark.parametrize("name", WITH_GAIN)
def test_a_rate_saturates_with_its_direction_kept(name: str, robot: Robot) -> None:
    task = REGISTRY[name].task
    rng = np.random.default_rng(13)
    limited = task_function(robot, task)
    free = task_function(robot, unsaturated(task))
    bounds = saturations_of(task)
    for _ in range(20):
        q = random_configuration(robot, rng)
        free_rows, limited_rows = (
            asked(robot, function, task, q)[1] for function in (free, limited)
        )
        for bound, before, after in zip(
            bounds,
            *(np.split(rate, len(bounds)) for rate in (free_rows, limited_rows)),
            strict=True,
        ):
            share = min(1.0, bound / max(np.linalg.norm(before), 1e-12))
            np.testing.assert_allclose(after, share * before, atol=1e-9)


@pytest.mark.parametrize("kind", [FieldOfView, Alignment])
def test_a_target_that_one_is_at_or_below_asks_for_nothing_however_it_moves(
    kind: type[Task], robot: Robot
) -> None:
    data = robot.model.createData()
    q = robot.configuration()
    pin.framesForwardKinematics(robot.model, data, q)
    frame = "tool" if kind is FieldOfView else "base_link"
    place = data.oMf[robot.frame_id(frame)].translation - (
        0.0 if kind is FieldOfView else np.array([0.0, 0.0, 2.0])
    )
    options = {"frame": frame, "axis": (0.0, 0.0, 1.0)} if kind is FieldOfView else {}
    task = kind(goal=lambda t: (place, np.array([0.3, -0.2, 0.1])), **options)
    J, rate = asked(robot, task_function(robot, task), task, q)
    np.testing.assert_array_equal(J, 0.0)
    np.testing.assert_array_equal(rate, 0.0)
