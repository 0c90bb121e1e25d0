"""Drawn robots whose thrusters are listed in the other order, and every other one described from its
other side, are the same robots: to pre-flight and in runs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from studies.drawn_conditions import drawn_conditions
from studies.drawn_robots import drawn_body, drawn_scenario, write_robot

from uvms_ocp.robot.description import Thruster, checked_copy
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.thrusters import largest_force, undriven_axes
from uvms_ocp.robot.unasked_acceleration import unasked_acceleration
from uvms_ocp.scenario.scenario import Scenario

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")

BARE = (273, 388)
WITH_ARMS = (912, 1404, 1519, 1551)
"""Seeds of vehicles without and with an arm that pre-flight accepts."""


def _from_behind(thruster: Thruster) -> Thruster:
    direction = tuple(-component for component in thruster.direction)
    limits = {"minimum": -thruster.maximum, "maximum": -thruster.minimum}
    return Thruster.model_validate(dict(thruster) | limits | {"direction": direction})


def as_drawn(robot: Robot) -> Robot:
    """Describe the robot by the words of its file."""
    return robot


def otherwise(robot: Robot) -> Robot:
    """Describe the robot by other words."""
    thrusters = list(robot.description.thrusters)
    thrusters[::2] = [_from_behind(thruster) for thruster in thrusters[::2]]
    description = checked_copy(robot.description, thrusters=tuple(reversed(thrusters)))
    return replace(robot, description=description)


def scenario_of(seed: int, folder: Path, described: Callable[[Robot], Robot]) -> Scenario:
    """Make the drawn mission of a seed for the robot as it is described."""
    rng = np.random.default_rng(seed)
    body = drawn_body(rng)
    robot = described(write_robot(body, rng, folder))
    return drawn_scenario(robot, body, rng, drawn_conditions(seed))


@pytest.mark.parametrize("seed", [*BARE, *WITH_ARMS])
def test_what_thrusters_do_is_the_same(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    robot = write_robot(drawn_body(rng), rng, tmp_path)
    same = otherwise(robot)
    assert undriven_axes(same) == undriven_axes(robot)
    np.testing.assert_allclose(largest_force(same), largest_force(robot), rtol=1e-9)
    np.testing.assert_allclose(unasked_acceleration(same), unasked_acceleration(robot), rtol=1e-9)


@pytest.mark.parametrize(
    "seed",
    [BARE[0], *(pytest.param(seed, marks=pytest.mark.slow) for seed in (*BARE[1:], *WITH_ARMS))],
)
def test_pre_flight_judges_alike(
    seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("UVMS_OCP_CFLAGS", "-O0")  # what is compiled runs once
    judged = []
    for described in (as_drawn, otherwise):
        findings = scenario_of(seed, tmp_path, described).check().findings
        judged.append([(finding.severity, finding.check, finding.phase) for finding in findings])
    assert judged[1] == judged[0]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [*BARE, *WITH_ARMS])
def test_the_run_is_the_same(seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("UVMS_OCP_CFLAGS", "-O0")  # what is compiled runs once
    as_is, same = (
        replace(scenario_of(seed, tmp_path, described), duration=4.0).run()
        for described in (as_drawn, otherwise)
    )
    assert [event.t for event in same.run_meta.events] == [e.t for e in as_is.run_meta.events]
    np.testing.assert_allclose(same["q"], as_is["q"], atol=1e-6)
    thrust = same["thrust"][:, ::-1].copy()
    thrust[:, ::2] *= -1.0
    scale = np.abs(as_is["thrust"]).max()
    np.testing.assert_allclose(thrust, as_is["thrust"], atol=1e-5 * scale)
