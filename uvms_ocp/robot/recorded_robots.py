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
    """Return fields of a record's metadata that say whose it is; of a robot of one's own also how
    to load it again.
    """
    files = None
    is_moved = robot.description.loading.frames and robot.name in list_robots()
    if robot.urdf is not None or is_moved:
        files = _files_meta(robot)
    return {
        "robot": robot.name,
        "robot_files": files,
        "joints": robot.joint_names,
        "tools": robot.tools,
        "endless": robot.endless_joints,
        "sliding": tuple(joint.name for joint in robot.joints if joint.slides),
    }


def _files_meta(robot: Robot) -> RobotFilesMeta:
    """Return the path of the URDF relative to the working directory, and the description with
    those of packages relative to the URDF; none leads into the home folder.
    """
    library_urdf = (robots_folder() / robot.name).resolve() / "robot.urdf"
    folder = (robot.urdf or library_urdf).parent
    loading = robot.description.loading
    packages = [_shared_path((folder / package).resolve(), folder) for package in loading.packages]
    description = checked_copy(
        robot.description, loading=loading.model_dump() | {"packages": packages}
    )
    urdf = None
    if robot.urdf is not None and robot.urdf != library_urdf:
        urdf = _shared_path(robot.urdf, Path.cwd())
    return RobotFilesMeta(urdf=urdf, description=description.model_dump_json(exclude_defaults=True))


def _shared_path(path: Path, folder: Path) -> str:
    """Return the path as seen from a folder, or its last two names where the way there would name
    the home folder.
    """
    home = Path(os.path.expanduser("~")).resolve()
    if path.is_relative_to(home) and not folder.is_relative_to(home):
        return Path(*path.relative_to(home).parts[-2:]).as_posix()
    return Path(os.path.relpath(path, folder)).as_posix()


def recorded_robot(name: str, files: RobotFilesMeta, folder: Path) -> Robot | None:
    """Return the robot that a record in `folder` keeps, of folders above it or the working
    directory; `None` where it is not there.

    Raises `InvalidInput` in one line for a description that is none of this version, and where
    another robot is there.
    """
    urdf = None
    if files.urdf is not None:
        urdf = _find_urdf(Path(files.urdf), Path(os.path.abspath(folder)))
        if urdf is None:
            return None
    try:
        description = RobotDescription.model_validate_json(files.description)
    except ValidationError as error:
        problem = one_line(error, RobotDescription)
        raise InvalidInput(
            f"a record whose description of {name} is not read ({problem}); give it: --robot DIR"
        ) from None
    library_name = name if urdf is None else None
    robot = load_robot(library_name, urdf=urdf, hydrodynamics=description)
    if robot.name != name:
        raise InvalidInput(
            f"a record of {name}, but {urdf} is {robot.name}; give it: --robot DIR, or"
            " show(record, robot)"
        )
    return robot


def _find_urdf(urdf: Path, folder: Path) -> Path | None:
    """Return the first file of that path, or of its last two names, below a folder, the folders
    above it and the working directory.
    """
    short_path = Path(*urdf.parts[-2:])
    for root in (folder, *folder.parents, Path.cwd()):
        for path in (root / urdf, root / short_path):
            if os.path.isfile(path):  # False for a path that is too long
                return path
    return None
