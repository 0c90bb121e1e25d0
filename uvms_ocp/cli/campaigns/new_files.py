"""``new-robot`` and ``new-mission``: files to begin with, which run as they are."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import pinocchio as pin
import typer

from uvms_ocp import scenarios
from uvms_ocp.cli.options import folder
from uvms_ocp.cli.printing import console_of, print_paths
from uvms_ocp.exceptions import InvalidInput, OutputError
from uvms_ocp.model.robot import Robot
from uvms_ocp.scenarios.chosen import robot_of

_TEMPLATES = Path(scenarios.__file__).parent / "templates"
_BESIDE = 'uo.load_robot(urdf=ROBOT / "robot.urdf", hydrodynamics=ROBOT / "hydrodynamics.yaml")'


def new_robot(
    out: Annotated[
        Path, typer.Argument(metavar="DIR", parser=folder, help="Folder for robot.urdf and hydrodynamics.yaml.")
    ],
) -> None:
    """Write a robot to begin with: a box of a vehicle with an arm of three joints, with comments.

    \f
    Raises `InvalidInput` for files that are there, `OutputError` where they cannot be written.
    """
    names = ("robot.urdf", "hydrodynamics.yaml")
    _write({out / name: (_TEMPLATES / name).read_text(encoding="utf-8") for name in names})


def new_mission(
    file: Annotated[Path, typer.Argument(metavar="FILE.py", help="The file; what varies goes beside it.")],
    robot: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder of your robot; default: bluerov2_alpha5 of the package.")
    ] = None,
) -> None:
    """Write a mission to begin with, and what is uncertain about it, with comments.

    \f
    Raises `InvalidInput` for files that are there or another name, `RobotDataError` for a robot that cannot be loaded,
    whose frames the tasks name, `OutputError` where they cannot be written.
    """
    if file.suffix != ".py":
        raise InvalidInput(f"{file}: give the name of a Python file, such as my_mission.py")
    vary = file.with_name(f"{file.stem}_variations.py")
    text = (_TEMPLATES / "mission.py.txt").read_text(encoding="utf-8")
    place, load = ('"bluerov2_alpha5"', "return uo.load_robot(ROBOT)")
    frames = _frames(None)
    if robot is not None:
        way = os.path.relpath(robot.resolve(), file.resolve().parent).replace(os.sep, "/")
        place, load = f'HERE / "{way}"', f"return {_BESIDE}"
        frames = _frames(robot_of(str(robot)))
    filled = text.format(file=file.name, vary=vary.name, robot=place, load=load, **frames)
    _write({file: filled, vary: (_TEMPLATES / "variations.py.txt").read_text(encoding="utf-8")})


def _frames(robot: Robot | None) -> dict[str, str]:
    """Arguments of the tasks that name frames of the robot, where these are not those that tasks take by themselves."""
    if robot is None:
        return {"vehicle": "", "pose": "", "tool": ""}
    links = [frame.name for frame in robot.model.frames if frame.type == pin.FrameType.BODY]
    vehicle = "" if robot.has_frame("base_link") else f'frame="{links[0]}"'
    tool = "" if robot.has_frame("tool") else f'frame="{links[-1]}", '
    return {"vehicle": vehicle, "pose": vehicle and f"{vehicle}, ", "tool": tool}


def _write(files: dict[Path, str]) -> None:
    """All of them, or none where one is there already."""
    for path in files:
        if path.exists():
            raise InvalidInput(f"{path}: is there already; choose another name, or move it away")
    try:
        for path, text in files.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise OutputError(f"{path}: cannot write there ({error.strerror}); choose another place") from error
    print_paths(console_of(), list(files))
