"""A robot among a ball and a pipe, with its own shapes and covered by capsules."""

from __future__ import annotations

import pytest
from curves.capsules import capsule_robot
from planned_scenes import PIPE, SPHERE

from uvms_ocp.planning.planned_axes import Coordinates, coordinates
from uvms_ocp.planning.scene import CollisionScene, collision_scene
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot


@pytest.fixture(scope="session")
def robot() -> Robot:
    return load_robot("girona_maris7")


@pytest.fixture(scope="session")
def planned(robot: Robot) -> Coordinates:
    return coordinates(robot)


@pytest.fixture(scope="session")
def scene(planned: Coordinates) -> CollisionScene:
    return collision_scene(planned, [SPHERE, PIPE])


@pytest.fixture(scope="session")
def capsule_scene(robot: Robot) -> CollisionScene:
    return collision_scene(coordinates(capsule_robot(robot)), [SPHERE, PIPE])
