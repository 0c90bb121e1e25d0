"""Options of every plan: where it starts, where it goes, and what stands in the way."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from uvms_ocp.cli.option_group import defaults_of
from uvms_ocp.cli.options import given
from uvms_ocp.collision.obstacle_file import obstacle_from_words, read_obstacles
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.loading import load_robot
from uvms_ocp.model.robot import Robot
from uvms_ocp.obstacle_data import ObstacleData
from uvms_ocp.planning.goals import Goal, PostureGoal, ToolGoal, Triple
from uvms_ocp.planning.request import PlanRequest

_Clearance = Annotated[float, typer.Option(metavar="M", help="Distance wanted from everything [m].")]


@dataclass(frozen=True, kw_only=True, slots=True)
class MotionOptions:
    """As they stand on the command line."""

    tool: Annotated[Triple | None, typer.Option(metavar="X Y Z", help="Goal of the tool in W [m].")] = None
    tool_rpy: Annotated[Triple | None, typer.Option(metavar="R P Y", help="Its orientation; default: any.")] = None
    joint: Annotated[list[str] | None, typer.Option(metavar="NAME=Q", help="Goal of a joint; repeatable.")] = None
    to: Annotated[Triple | None, typer.Option(metavar="X Y Z", help="Goal of the vehicle [m].")] = None
    to_rpy: Annotated[Triple | None, typer.Option(metavar="R P Y", help="Goal of its attitude [rad].")] = None
    position: Annotated[Triple | None, typer.Option(metavar="X Y Z", help="Start of the vehicle [m].")] = None
    rpy: Annotated[Triple | None, typer.Option(metavar="R P Y", help="Attitude at the start [rad].")] = None
    sphere: Annotated[list[str] | None, typer.Option(metavar="X,Y,Z,R", help="Obstacle; repeatable.")] = None
    box: Annotated[list[str] | None, typer.Option(metavar="X,Y,Z,LX,LY,LZ", help="Obstacle; repeatable.")] = None
    obstacles: Annotated[Path | None, typer.Option(metavar="YAML", help="File of obstacles.")] = None
    robot: Annotated[str, typer.Option(help="Robot, see `uvms-ocp list`.")] = "girona_maris7_full"
    clearance: _Clearance = defaults_of(PlanRequest)["clearance"]

    def asked(self) -> dict[str, Any]:
        """The fields that requests of all methods have.

        Raises `InvalidInput` for goals that are none, several or not the robot's, a start that is not valid and obstacles
        that cannot be read, and `NameNotFound` for an unknown robot.
        """
        robot = load_robot(self.robot)
        self._check_vehicle(robot)
        return {
            "robot": robot,
            "start": robot.configuration(position=self.position, rpy=self.rpy),
            "goal": self._goal(),
            "obstacles": self._obstacles(),
            "clearance": self.clearance,
        }

    def _check_vehicle(self, robot: Robot) -> None:
        poses = {"to": self.to, "to-rpy": self.to_rpy, "position": self.position, "rpy": self.rpy}
        for name in given(**poses):
            if not robot.n_vehicle:
                raise InvalidInput(
                    f"--{name}: {robot.name} has no free vehicle pose; give --joint NAME=Q with any of "
                    f"{', '.join(robot.joint_names)}, or --tool"
                )

    def _goal(self) -> Goal:
        """The one goal that was given."""
        has_posture = bool(self.joint or self.to or self.to_rpy)
        if (self.tool is None) != has_posture or (self.tool is None and self.tool_rpy is not None):
            raise InvalidInput(
                "give one goal: --tool, with or without --tool-rpy, or any of --to, --to-rpy and --joint"
            )
        if self.tool is not None:
            return ToolGoal(position=self.tool, rpy=self.tool_rpy)
        joints = dict(_joint_goal(word) for word in self.joint or ())
        return PostureGoal(position=self.to, rpy=self.to_rpy, joints=joints)

    def _obstacles(self) -> tuple[ObstacleData, ...]:
        return (
            *(read_obstacles(self.obstacles) if self.obstacles else ()),
            *(obstacle_from_words("sphere", words, f"sphere{i}") for i, words in enumerate(self.sphere or (), 1)),
            *(obstacle_from_words("box", words, f"box{i}") for i, words in enumerate(self.box or (), 1)),
        )


def _joint_goal(words: str) -> tuple[str, float]:
    name, _, value = words.partition("=")
    try:
        return name, float(value)
    except ValueError:
        raise InvalidInput(f"--joint {words!r}: give NAME=VALUE, such as joint2=0.5") from None
