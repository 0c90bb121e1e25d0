"""Drawn robots that are described otherwise are the same robots, to pre-flight and in runs: thrusters in
another order and from their other side, links, joints and arms in another order, and the base frame turned.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import yaml
from studies.drawn_conditions import drawn_conditions
from studies.drawn_robots import (
    DrawnMission,
    drawn_body,
    drawn_mission,
    scenario_of,
    write_robot,
)
from turned_robots import configuration, turn, turn_files, twist_turn

from uvms_ocp.record.record import Record
from uvms_ocp.robot.description import Thruster, checked_copy
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.thrusters import largest_force, undriven_axes
from uvms_ocp.robot.unasked_acceleration import unasked_acceleration
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.tasks import Alignment, JointTracking, ToolPose, ToolPosition, VehiclePose
from uvms_ocp.tasks.task import Task

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")

BARE = (273, 388)
WITH_ARMS = (912, 1404, 1519, 1551)
"""Seeds of vehicles without and with an arm that pre-flight accepts."""
FIRST_ARM = "arm0"
LAST_ARM = "zarm"
"""Names of the same arm, as drawn and so that it comes after all others."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Described:
    """A robot and its mission in the words of a file, and what leads there from those that were drawn."""

    robot: Robot
    mission: DrawnMission
    quarters: int = 0
    """Right angles by which the base frame is turned."""
    joints: np.ndarray
    """(n_joints,) index among the drawn joints of each."""
    thrusters: np.ndarray
    """(n_thrusters,) index among the drawn thrusters of each."""
    sides: np.ndarray
    """(n_thrusters,) -1 for those that are described from their other side."""


Description = Callable[[Robot, DrawnMission, Path], Described]


def as_drawn(robot: Robot, mission: DrawnMission, folder: Path) -> Described:
    """Describe the robot by the words of its file."""
    del folder
    n = len(robot.description.thrusters)
    return Described(
        robot=robot,
        mission=mission,
        joints=np.arange(robot.n_joints),
        thrusters=np.arange(n),
        sides=np.ones(n),
    )


def _from_behind(thruster: Thruster) -> Thruster:
    direction = tuple(-component for component in thruster.direction)
    limits = {"minimum": -thruster.maximum, "maximum": -thruster.minimum}
    return Thruster.model_validate(dict(thruster) | limits | {"direction": direction})


def thrusters_otherwise(robot: Robot, mission: DrawnMission, folder: Path) -> Described:
    """List the thrusters in the other order, every other one from its other side."""
    as_is = as_drawn(robot, mission, folder)
    thrusters = list(robot.description.thrusters)
    thrusters[::2] = [_from_behind(thruster) for thruster in thrusters[::2]]
    description = checked_copy(robot.description, thrusters=tuple(reversed(thrusters)))
    sides = np.ones(len(thrusters))
    sides[::2] = -1.0
    return replace(
        as_is,
        robot=replace(robot, description=description),
        thrusters=as_is.thrusters[::-1],
        sides=sides[::-1],
    )


def _edited(folder: Path, edit: Callable[[ET.Element, dict[str, Any]], None]) -> Robot:
    """Load the robot of a folder from files that are changed by `edit`, beside its own."""
    tree = ET.parse(folder / "robot.urdf")
    data = yaml.safe_load((folder / "hydrodynamics.yaml").read_text(encoding="utf-8"))
    edit(tree.getroot(), data)
    tree.write(folder / "other.urdf")
    file = folder / "other.yaml"
    file.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
    return load_robot(urdf=folder / "other.urdf", hydrodynamics=file)


def turned(quarters: int) -> Description:
    """Turn the base frame by so many right angles."""

    def describe(robot: Robot, mission: DrawnMission, folder: Path) -> Described:
        same = _edited(folder, lambda root, data: turn_files(root, data, "hull", quarters))
        X_BN = pin.SE3(turn(quarters).T, np.zeros(3))
        tasks = []
        for task in mission.tasks:
            tasks.append(
                task.with_goal(task.goal * X_BN) if isinstance(task, VehiclePose) else task
            )
        turned_mission = replace(mission, start=mission.start * X_BN, tasks=tuple(tasks))
        as_is = as_drawn(same, turned_mission, folder)
        return replace(as_is, quarters=quarters)

    return describe


def _list_backwards(root: ET.Element, data: dict[str, Any]) -> None:
    root[:] = list(reversed(root))
    for element in root.iter():
        for name in ("name", "link", "joint"):
            if name in element.attrib:
                element.attrib[name] = element.attrib[name].replace(FIRST_ARM, LAST_ARM)
    renamed = _renamed(data)
    data.clear()
    data.update(renamed)
    data["thrusters"].reverse()
    for section in ("links", "joints"):
        data[section] = dict(reversed(data.get(section, {}).items()))


def _renamed(value: Any) -> Any:
    if isinstance(value, dict):
        return {_renamed(key): _renamed(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_renamed(entry) for entry in value]
    return value.replace(FIRST_ARM, LAST_ARM) if isinstance(value, str) else value


def listed_backwards(robot: Robot, mission: DrawnMission, folder: Path) -> Described:
    """List links, joints and thrusters in the other order, and the first arm after all others."""
    same = _edited(folder, _list_backwards)
    tasks: list[Task] = []
    for task in mission.tasks:
        if isinstance(task, ToolPose | ToolPosition):
            task = replace(task, frame=_renamed(task.frame))
        elif isinstance(task, JointTracking):
            task = replace(task, joints=same.joint_names, goal=same.home)
        tasks.append(task)
    payload = mission.options["payload"]
    if payload is not None:
        payload = payload.model_copy(update={"link": _renamed(payload.link)})
    names = [_renamed(name) for name in robot.joint_names]
    as_is = as_drawn(same, mission, folder)
    return replace(
        as_is,
        mission=replace(
            mission, tasks=tuple(tasks), options=mission.options | {"payload": payload}
        ),
        joints=np.array([names.index(name) for name in same.joint_names], dtype=int),
        thrusters=as_is.thrusters[::-1],
    )


DESCRIPTIONS: dict[str, Description] = {
    "thrusters otherwise": thrusters_otherwise,
    "listed backwards": listed_backwards,
    "turned by a quarter": turned(1),
    "turned by a half": turned(2),
}


def drawn(seed: int, folder: Path, description: Description) -> Described:
    """Draw the robot and the mission of a seed, without sensors' noise, which is that of axes, and without a
    task that turns the bow, which is another one of a frame that is turned.
    """
    rng = np.random.default_rng(seed)
    body = drawn_body(rng)
    robot = write_robot(body, rng, folder)
    mission = drawn_mission(robot, body, rng)
    tasks = tuple(task for task in mission.tasks if not isinstance(task, Alignment))
    quiet = replace(mission, tasks=tasks, options=mission.options | {"noise": False})
    return description(robot, quiet, folder)


def scenario(described: Described, seed: int) -> Scenario:
    return scenario_of(described.robot, described.mission, drawn_conditions(seed))


@pytest.mark.sampled
@pytest.mark.parametrize("name", DESCRIPTIONS)
@pytest.mark.parametrize("seed", [*BARE, *WITH_ARMS])
def test_what_thrusters_do_is_the_same(seed: int, name: str, tmp_path: Path) -> None:
    robot = drawn(seed, tmp_path, as_drawn).robot
    described = drawn(seed, tmp_path, DESCRIPTIONS[name])
    same = described.robot
    T = np.abs(twist_turn(described.quarters, 6))
    is_undriven = np.zeros(6)
    is_undriven[list(undriven_axes(robot))] = 1.0
    found = np.zeros(6)
    found[list(undriven_axes(same))] = 1.0
    np.testing.assert_array_equal(found, T @ is_undriven)
    np.testing.assert_allclose(largest_force(same)[:6], T @ largest_force(robot)[:6], rtol=1e-9)
    np.testing.assert_allclose(
        unasked_acceleration(same)[:6], T @ unasked_acceleration(robot)[:6], rtol=1e-9
    )


@pytest.mark.sampled
@pytest.mark.parametrize("name", DESCRIPTIONS)
@pytest.mark.parametrize(
    "seed",
    [BARE[0], *(pytest.param(seed, marks=pytest.mark.slow) for seed in (*BARE[1:], *WITH_ARMS))],
)
def test_pre_flight_judges_alike(
    seed: int, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("UVMS_OCP_CFLAGS", "-O0")  # what is compiled runs once
    judged = []
    for description in (as_drawn, DESCRIPTIONS[name]):
        findings = scenario(drawn(seed, tmp_path, description), seed).check().findings
        judged.append([(finding.severity, finding.check, finding.phase) for finding in findings])
    assert judged[1] == judged[0]


def require_same(record: Record, expected: Record, described: Described) -> None:
    """Require the record of a robot that is described otherwise to be the expected one."""
    assert [event.t for event in record.run_meta.events] == [
        event.t for event in expected.run_meta.events
    ]
    q = configuration(expected["q"], described.quarters)[:, :7]
    q[:, 3:] *= np.sign(np.sum(q[:, 3:] * record["q"][:, 3:7], axis=1))[:, None]
    np.testing.assert_allclose(record["q"][:, :7], q, atol=1e-6)
    order = np.concatenate([np.arange(6), 6 + described.joints])
    v = expected["v"][:, order]
    np.testing.assert_allclose(
        record["v"], v @ twist_turn(described.quarters, v.shape[1]).T, atol=1e-5
    )
    thrust = expected["thrust"][:, described.thrusters] * described.sides
    scale = np.abs(thrust).max()
    np.testing.assert_allclose(record["thrust"], thrust, atol=1e-5 * scale)


@pytest.mark.slow
@pytest.mark.parametrize("name", DESCRIPTIONS)
@pytest.mark.parametrize("seed", [*BARE, *WITH_ARMS])
def test_the_run_is_the_same(
    seed: int, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("UVMS_OCP_CFLAGS", "-O0")  # what is compiled runs once
    as_is = drawn(seed, tmp_path, as_drawn)
    same = drawn(seed, tmp_path, DESCRIPTIONS[name])
    expected, record = (
        replace(scenario(described, seed), duration=4.0).run() for described in (as_is, same)
    )
    require_same(record, expected, same)
