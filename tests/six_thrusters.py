"""The vehicle that most people own: two vertical thrusters abeam, so that nobody drives pitch."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import uvms_ocp as uo
from uvms_ocp.robot.description import checked_copy
from uvms_ocp.robot.robot import Robot

_TEMPLATES = Path(str(uo.__file__)).parent / "scenario" / "templates"


def six_thrusters() -> Robot:
    """The robot that `new-robot` writes, its four lift thrusters merged into two abeam of twice the thrust."""
    robot = uo.load_robot(urdf=_TEMPLATES / "robot.urdf", hydrodynamics=_TEMPLATES / "hydrodynamics.yaml")
    level, lift = robot.description.thrusters[:4], robot.description.thrusters[4]
    abeam = tuple(
        lift.model_copy(
            update={
                "name": name,
                "position": (0.0, y, 0.0),
                "minimum": 2 * lift.minimum,
                "maximum": 2 * lift.maximum,
                "power": None,
            }
        )
        for name, y in (("lift_left", 0.2), ("lift_right", -0.2))
    )
    return replace(robot, description=checked_copy(robot.description, thrusters=(*level, *abeam)))
