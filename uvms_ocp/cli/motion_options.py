"""Options that ``plan curve`` and ``plan ocp`` share: start, goal, obstacles and robot."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from uvms_ocp.cli.option_groups import defaults_of
from uvms_ocp.cli.options import RobotFiles
from uvms_ocp.errors import InvalidInput
from uvms_ocp.planning.request import Goal, PlanRequest, PostureGoal, ToolGoal, Triple
from uvms_ocp.robot import Robot, loading
from uvms_ocp.robot.shapes.obstacles import Obstacle, parse_obstacle, read_obstacles


@dataclass(frozen=True, kw_only=True, slots=True)
class MotionOptions:
    """Options of ``plan curve`` and ``plan ocp`` that say what is planned: from where, to where,
    among which obstacles.
    """

    tool: Annotated[
        Triple | None, typer.Option(metavar="X Y Z", help="Goal of the tool in W [m].")
    ] = None
    tool_rpy: Annotated[
        Triple | None, typer.Option(metavar="R P Y", help="Its orientation; default: any.")
    ] = None
    joint: Annotated[
        list[str] | None, typer.Option(metavar="NAME=Q", help="Goal of a joint; repeatable.")
    ] = None
    to: Annotated[Triple | None, typer.Option(metavar="X Y Z", help="Goal of the vehicle [m].")] = (
        None
    )
    to_rpy: Annotated[
        Triple | None, typer.Option(metavar="R P Y", help="Goal of its attitude [rad].")
    ] = None
    position: Annotated[
        Triple | None, typer.Option(metavar="X Y Z", help="Start of the vehicle [m].")
    ] = None
    rpy: Annotated[
        Triple | None, typer.Option(metavar="R P Y", help="Attitude at the start [rad].")
    ] = None
    sphere: Annotated[
        list[str] | None, typer.Option(metavar="X,Y,Z,R", help="Obstacle; repeatable.")
    ] = None
    box: Annotated[
        list[str] | None, typer.Option(metavar="X,Y,Z,LX,LY,LZ", help="Obstacle; repeatable.")
    ] = None
    obstacles: Annotated[Path | None, typer.Option(metavar="YAML", help="File of obstacles.")] = (
        None
    )
    robot: Annotated[str, typer.Option(help="Robot, see `uvms-ocp list`, a URDF or a folder.")] = (
        "girona_maris7_full"
    )
    clearance: Annotated[
        float,
        typer.Option(metavar="M", help="Distance wanted from obstacles, and between links [m]."),
    ] = defaults_of(PlanRequest)["clearance"]
    link_clearance: Annotated[
        float | None, typer.Option(metavar="M", help="Between links [m]; default: the same.")
    ] = None

    def request_fields(self, files: RobotFiles) -> dict[str, Any]:
        """Return the fields that requests of all methods have.

        Raises `InvalidInput` for no goal, for several, or one that the robot cannot have, for a
        start that is not valid and for obstacles that cannot be read, and `NameNotFound` for an
        unknown robot.
        """
        robot = loading.robot_called(self.robot, files.hydrodynamics, files.loading)
        if not robot.n_vehicle:
            self._require_no_vehicle_pose(robot)
        return {
            "robot": robot,
            "start": robot.configuration(position=self.position, rpy=self.rpy),
            "goal": self._goal(),
            "obstacles": self._obstacles(),
            "clearance": self.clearance,
            "link_clearance": self.link_clearance,
        }

    def _require_no_vehicle_pose(self, robot: Robot) -> None:
        """Raise `InvalidInput` for options that place the vehicle, which this robot has not."""
        poses = {"to": self.to, "to-rpy": self.to_rpy, "position": self.position, "rpy": self.rpy}
        for name, pose in poses.items():
            if pose is not None:
                raise InvalidInput(
                    f"--{name}: {robot.name} has no free vehicle pose; give --joint NAME=Q with any"
                    f" of {', '.join(robot.joint_names)}, or --tool"
                )

    def _goal(self) -> Goal:
        """Return the one goal, of the tool or of a posture, that the options give."""
        has_tool = self.tool is not None
        has_posture = bool(self.joint or self.to or self.to_rpy)
        if has_tool == has_posture or (self.tool_rpy is not None and not has_tool):
            raise InvalidInput(
                "give one goal: --tool, with or without --tool-rpy, or any of --to, --to-rpy and"
                " --joint"
            )
        if self.tool is not None:
            return ToolGoal(position=self.tool, rpy=self.tool_rpy)
        joints = dict(_joint_goal(words) for words in self.joint or ())
        return PostureGoal(position=self.to, rpy=self.to_rpy, joints=joints)

    def _obstacles(self) -> tuple[Obstacle, ...]:
        """Return the obstacles of the file, then the spheres and the boxes of the options."""
        obstacles = list[Obstacle]()
        if self.obstacles:
            obstacles += read_obstacles(self.obstacles)
        for shape, texts in (("sphere", self.sphere), ("box", self.box)):
            for number, words in enumerate(texts or (), 1):
                obstacles.append(parse_obstacle(shape, words, f"{shape}{number}"))
        return tuple(obstacles)


def _joint_goal(words: str) -> tuple[str, float]:
    """Return name and position of a joint from ``NAME=VALUE``."""
    name, _, value = words.partition("=")
    try:
        return name, float(value)
    except ValueError:
        raise InvalidInput(f"--joint {words!r}: give NAME=VALUE, such as joint2=0.5") from None
