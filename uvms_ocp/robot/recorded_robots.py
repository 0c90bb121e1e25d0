"""The robot of a record: metadata that say whose a record is, and the robot that is loaded from
them again.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from uvms_ocp.errors import InvalidInput
from uvms_ocp.model_errors import one_line
from uvms_ocp.record.meta_values import RobotFilesMeta
from uvms_ocp.robot.description import RobotDescription, checked_copy
from uvms_ocp.robot.loading import list_robots, load_robot, robots_folder
from uvms_ocp.robot.robot import Robot


def robot_meta(robot: Robot) -> dict[str, Any]:
    """Fields of a record's metadata that say whose it is; of a robot of one's own also how to load
    it again.

    The path of the URDF is relative to the working directory, those of packages to the URDF; none
    leads into the home folder.
    """
    files = None
    urdf = robot.urdf
    loading = robot.description.loading
    if urdf is not None or (loading.frames and robot.name in list_robots()):
        library = (robots_folder() / robot.name).resolve() / "robot.urdf"
        folder_of_urdf = (urdf or library).parent
        packages = [
            _shared((folder_of_urdf / folder).resolve(), folder_of_urdf)
            for folder in loading.packages
        ]
        shared_description = checked_copy(
            robot.description, loading=loading.model_dump() | {"packages": packages}
        )
        if urdf is None or urdf == library:
            place = None
        else:
            place = _shared(urdf, Path.cwd())
        files = RobotFilesMeta(
            urdf=place, description=shared_description.model_dump_json(exclude_defaults=True)
        )
    kinds = {
        "endless": robot.endless_joints,
        "sliding": tuple(joint.name for joint in robot.joints if joint.slides),
    }
    return {
        "robot": robot.name,
        "robot_files": files,
        "joints": robot.joint_names,
        "tools": robot.tools,
        **kinds,
    }


def _shared(path: Path, folder: Path) -> str:
    """The path as seen from a folder, or its last two names where the way there would name the home
    folder.
    """
    home = Path(os.path.expanduser("~")).resolve()
    if path.is_relative_to(home) and not folder.is_relative_to(home):
        return Path(*path.relative_to(home).parts[-2:]).as_posix()
    return Path(os.path.relpath(path, folder)).as_posix()


def recorded_robot(name: str, files: RobotFilesMeta, folder: Path) -> Robot | None:
    """The robot that a record in `folder` keeps, of folders above it or the working directory;
    `None` where it is not there.

    Raises `InvalidInput` in one line for a description that is none of this version, and where
    another robot is there.
    """
    urdf_place = None
    above = Path(os.path.abspath(folder))
    if files.urdf is not None:
        urdf = Path(files.urdf)
        roots = (above, *above.parents, Path.cwd())
        places = (root / tail for root in roots for tail in (urdf, Path(*urdf.parts[-2:])))
        urdf_place = next(
            (place for place in places if os.path.isfile(place)), None
        )  # also where a path is too long
        if urdf_place is None:
            return None
    try:
        water = RobotDescription.model_validate_json(files.description)
    except ValidationError as error:
        wrong = one_line(error, RobotDescription)
        raise InvalidInput(
            f"a record whose description of {name} is not read ({wrong}); give it: --robot DIR"
        ) from None
    robot = load_robot(name if urdf_place is None else None, urdf=urdf_place, hydrodynamics=water)
    if robot.name != name:
        raise InvalidInput(
            f"a record of {name}, but {urdf_place} is {robot.name}; give it: --robot DIR, or"
            " show(record, robot)"
        )
    return robot
