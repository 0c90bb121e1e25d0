"""Find and load robots: URDF and description are read, checked against each other and joined.

Robots are in ``robots/``, packed into the package or of an editable checkout.
"""

from __future__ import annotations

import importlib.metadata
import logging
import os
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from operator import attrgetter
from pathlib import Path
from typing import Any, Literal
from weakref import WeakKeyDictionary, WeakSet, WeakValueDictionary

import pinocchio as pin

from uvms_ocp.checks import checked
from uvms_ocp.errors import InvalidInput, RobotDataError, UvmsError, require_known
from uvms_ocp.record.untrusted import note_file_read
from uvms_ocp.robot import coefficients, description as descriptions
from uvms_ocp.robot.description import RobotDescription
from uvms_ocp.robot.dialects.robot_xml import robot_file_in
from uvms_ocp.robot.joining import assemble
from uvms_ocp.robot.robot import Robot, with_moved_frame
from uvms_ocp.robot.unknowns import unknowns
from uvms_ocp.robot.urdf import UrdfModels, UrdfReading, models_and_notes

_PACKAGE = Path(__file__).resolve().parents[1]

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _AsRead:
    """A robot as its files were read."""

    content: list[Any]
    """Stamps of its mesh files, model, visual and collision shapes, copied."""
    warnings: tuple[str, ...]
    """Sentences on what its files leave open."""


_loaded = WeakSet[Robot]()
_read = WeakValueDictionary[str, Robot]()
"""Robots by their files and options."""
_as_read = WeakKeyDictionary[Robot, _AsRead]()


@checked
def load_robot(
    name: str | Path | None = None,
    *,
    urdf: Path | str | None = None,
    hydrodynamics: Path | str | RobotDescription | None = None,
    variant: str | None = None,
    base: str | None = None,
    package_dirs: Sequence[Path | str] = (),
    meshes: bool | None = None,
    mimic: Literal["coupled", "free", "fixed"] | None = None,
    lock: Mapping[str, float] | None = None,
    drop: Sequence[str] = (),
    tool: str | Sequence[str] | None = None,
    altimeter: str | None = None,
    dvl: str | None = None,
) -> Robot:
    """Load a robot by name, or from a robot file and, if there is one, its hydrodynamics file or a
    `RobotDescription`.

    Robot files are URDF, SDF, MJCF, and xacro with the extra ``xacro``; content of SDF and MJCF that
    has no place in a URDF is a warning. The name may also be a robot file, or a folder that holds
    one, ``robot.urdf`` before others; a hydrodynamics.yaml beside the file is read with it.

    ``variant`` is another published data set of a named robot, see ``list_variants``. The arguments
    after it replace what the hydrodynamics file says, which is their default: ``base`` is
    ``free_flyer`` or ``fixed``; ``package_dirs`` are searched for ``package://`` meshes, besides
    those of the file; ``meshes=False`` leaves out shapes that are meshes. Joints that ``<mimic>``
    another one are ``"coupled"``, one joint with it;
    ``mimic="free"`` makes them joints of their own, with the limits the URDF gives them,
    ``"fixed"`` keeps them where their leader's lock, or its home, puts them. ``lock`` fixes joints
    at a position [rad or m], ``drop`` leaves out links with all that hangs on them; the
    hydrodynamics file may still speak of joints and links that are left out. ``tool``, one for each
    arm, ``altimeter`` and ``dvl`` are names of frames.

    Raises ``InvalidInput`` for neither or both of name and URDF, another ``mimic``, or a variant
    without a name, ``NameNotFound`` for an unknown robot or variant, and ``RobotDataError``, with
    all problems at once, for files that are missing, broken, do not fit each other, or hold numbers
    that differ from those of the model built from them.

    What the files leave open, such as links without water and thrusters without power data, is a
    warning of this module's logger.
    """
    files = _requested_files(name, urdf, hydrodynamics, variant)
    roles: dict[str, Any] = {"base": base, "tool": tool, "altimeter": altimeter, "dvl": dvl}
    folders = [os.path.abspath(folder) for folder in package_dirs]
    options = (roles, folders, meshes, mimic, lock, drop)
    read_key = repr((files.name, files.description, variant, *options, _stamps(files.paths())))
    read = _read.get(read_key)
    if read is not None and _as_read[read].content == _content_of(read):
        _note_files_read(read, files.paths())
        return _warned(read)

    faults: list[RobotDataError] = []
    try:
        described = _read_description(files)
    except RobotDataError as error:
        faults.append(error)  # raised below, together with the problems of the URDF
        described = RobotDescription()
    requested_reading: dict[str, Any] = {"mimic": mimic, "lock": lock, "drop": tuple(drop) or None}
    if meshes is not None:
        requested_reading["meshes"] = "yes" if meshes else "no"
    requested_reading["packages"] = _package_folders(files, described, folders)
    settings = described.loading.model_copy(update=_without_none(requested_reading))
    if tool is not None and not isinstance(tool, str):
        roles["tool"] = tuple(tool)
    changes = _without_none(roles)
    if settings != described.loading:
        changes["loading"] = settings
    description = descriptions.checked_copy(described, **changes) if changes else described
    try:
        models, notes = _read_urdf(files.urdf, description)
    except RobotDataError as error:
        faults.append(error)
    if faults:
        raise _joined_errors(faults)

    robot = _joined_robot(models, description, files)
    is_as_published = files.name and not changes and hydrodynamics is None and variant is None
    if not is_as_published:
        robot = replace(robot, urdf=files.place)
    robot = _known(robot)
    warnings = [f"{files.urdf}: {note}" for note in notes]
    for _, text in unknowns(models.model, description):
        warnings.append(f"{files.describing}: {text}")
    _as_read[robot] = _AsRead(content=_copied_content_of(robot), warnings=tuple(warnings))
    is_alone = files.urdf.suffix == ".urdf"  # files of other formats may include others
    if is_alone and not notes:  # such as of a mesh that is missing, and may be there the next time
        _read[read_key] = robot
    return _warned(robot)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _RobotFiles:
    """The files that a robot is loaded from."""

    name: str | None
    """Name of a robot of the library; `None` for one of the user's."""
    urdf: Path
    yaml: Path | None
    """File of the description; `None` for none, or where `description` was given in its place."""
    variant: str | None
    description: RobotDescription | None
    """Description that was given in place of a file."""

    @property
    def place(self) -> Path:
        """URDF in its own folder, behind a link too, from where its packages are looked for."""
        return self.urdf.parent.resolve() / self.urdf.name

    @property
    def describing(self) -> Path:
        """File that is named where the description is wrong."""
        return self.yaml or self.urdf

    def paths(self) -> list[Path]:
        """Return all files, including that of the variant."""
        paths = [self.urdf]
        if self.yaml is not None:
            paths.append(self.yaml)
        if self.name and self.variant:
            paths.append(variant_file(self.name, self.variant))
        return paths


def _requested_files(
    name: str | Path | None,
    urdf: Path | str | None,
    hydrodynamics: Path | str | RobotDescription | None,
    variant: str | None,
) -> _RobotFiles:
    """Find the files of a robot. Raises `InvalidInput` for neither or both of name and URDF, and
    `NameNotFound`.
    """
    yaml: Path | str | None = None
    description: RobotDescription | None = None
    if isinstance(hydrodynamics, RobotDescription):
        description = hydrodynamics
    else:
        yaml = hydrodynamics
    if name is not None and _is_file(name):
        if urdf is not None:
            raise InvalidInput(f"load_robot: {name} and urdf={urdf}; give one of them")
        arguments = files_of(Path(name), yaml)
        name = None
        urdf = arguments["urdf"]
        yaml = arguments["hydrodynamics"]
    library_name = None if name is None else str(name)
    urdf_path, yaml_path = _paths(library_name, urdf, yaml)
    return _RobotFiles(
        name=library_name,
        urdf=urdf_path,
        yaml=yaml_path,
        variant=variant,
        description=description,
    )


def _package_folders(
    files: _RobotFiles, description: RobotDescription, folders: Sequence[str]
) -> tuple[str, ...] | None:
    """Return the folders and those of the description, relative to the URDF; `None` where those of
    the description are all and are relative to it already.
    """
    is_beside = files.yaml is None or files.yaml.parent == files.urdf.parent
    if not folders and is_beside:
        return None
    all_folders = [Path(folder) for folder in folders]
    all_folders += [files.describing.parent / folder for folder in description.loading.packages]
    relative = [os.path.relpath(folder.resolve(), files.place.parent) for folder in all_folders]
    return tuple(relative) or None


def _without_none(values: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in values.items() if value is not None}


def _read_urdf(urdf: Path, description: RobotDescription) -> tuple[UrdfModels, list[str]]:
    """Read a URDF as its description says. Raises `RobotDataError`."""
    settings = description.loading
    home = {name: joint.home for name, joint in description.joints.items()}
    reading = UrdfReading(
        mimic=settings.mimic,
        lock=settings.lock,
        drop=settings.drop,
        meshes=settings.meshes == "yes",
        home=_without_none(home),
    )
    return models_and_notes(
        urdf,
        free_flyer=description.base == "free_flyer",
        package_dirs=[urdf.parent / folder for folder in settings.packages],
        reading=reading,
    )


def _joined_robot(models: UrdfModels, description: RobotDescription, files: _RobotFiles) -> Robot:
    """Join mechanism and description, with the frames that the description moves."""
    robot = assemble(models, description, files.describing, files.name)
    for moved in description.loading.frames:
        try:
            robot = with_moved_frame(robot, moved.frame, coefficients.placement_of(moved))
        except UvmsError as error:
            raise RobotDataError(files.describing, f"loading.frames: {error}") from None
    return robot


def _joined_errors(errors: Sequence[RobotDataError]) -> RobotDataError:
    """Return an error of the first file with all problems, those of other files by their name."""
    first = errors[0]
    problems = [*first.problems]
    for error in errors[1:]:
        # A file in the same folder needs no more than its name.
        is_beside = error.path.parent == first.path.parent
        file = error.path.name if is_beside else error.path
        problems += [f"{file}: {problem}" for problem in error.problems]
    return RobotDataError(first.path, *problems)


def _stamps(files: Iterable[Path | str]) -> list[Any]:
    """Return paths, inodes, sizes and times of the files: another list once one of them changed."""
    stamps = dict[str, Any]()
    for file in sorted(files):
        if os.path.isfile(file):
            status = os.stat(file)
            path = os.path.abspath(file)
            stamps[path] = (
                path,
                status.st_ino,
                status.st_size,
                status.st_mtime_ns,
                status.st_ctime_ns,
            )
    return [*stamps.values()]


def _shapes_of(robot: Robot) -> list[pin.GeometryObject]:
    return [*robot.visual_model.geometryObjects, *robot.collision_model.geometryObjects]


def _mesh_files(robot: Robot) -> set[str]:
    return {shape.meshPath for shape in _shapes_of(robot)}


def _content_of(robot: Robot) -> list[Any]:
    """Return the parts of a robot that its holder can change, with the stamps of its mesh files."""
    return [
        _stamps(_mesh_files(robot)),
        robot.model,
        robot.visual_model,
        robot.collision_model,
    ]


def _copied_content_of(robot: Robot) -> list[Any]:
    """Return a copy of `_content_of` as it is now."""
    return [
        _stamps(_mesh_files(robot)),
        robot.model.copy(),
        robot.visual_model.clone(),
        robot.collision_model.clone(),
    ]


def _note_files_read(robot: Robot, files: Iterable[Path]) -> None:
    """Note the files of a robot that is taken from memory, as if they had been read again: results
    depend on them.
    """
    for file in files:
        note_file_read(file)
    for mesh_path in _mesh_files(robot):
        mesh_file = Path(mesh_path)
        if mesh_file.is_file():  # a box has none
            note_file_read(mesh_file)


def _warned(robot: Robot) -> Robot:
    """Log the warnings on the files of a robot, and return it."""
    for text in _as_read[robot].warnings:
        _log.warning("%s", text)
    return robot


def _known(robot: Robot) -> Robot:
    """Return an equal robot that was loaded before, with all that was derived and compiled for it;
    else this one.
    """
    for shape in _shapes_of(robot):
        shape.geometry.computeLocalAABB()  # as the first use does, which would make it unequal
    content = attrgetter(
        "name", "urdf", "model", "visual_model", "collision_model", "description"
    )  # all else follows
    for loaded in tuple(_loaded):
        if content(loaded) == content(robot):
            return loaded
    _loaded.add(robot)
    return robot


def robot_called(
    words: str, hydrodynamics: Path | str | None = None, loading: Mapping[str, Any] | None = None
) -> Robot:
    """Load the robot of a URDF, a folder with robot.urdf and hydrodynamics.yaml, or a name; with
    other hydrodynamics if given.

    loading: other arguments of `load_robot`.
    """
    path = Path(words)
    name = path if path.exists() else words
    return load_robot(name, hydrodynamics=hydrodynamics, **(loading or {}))


def files_of(path: Path, hydrodynamics: Path | str | None = None) -> dict[str, Any]:
    """Return arguments of `load_robot` for a robot file or a folder with one, and
    hydrodynamics.yaml beside it if it is there.
    """
    urdf = robot_file_in(path) if path.is_dir() else path
    beside = urdf.with_name("hydrodynamics.yaml")
    if not hydrodynamics:
        hydrodynamics = beside if beside.is_file() else None
    return {"urdf": urdf, "hydrodynamics": hydrodynamics}


def _is_file(name: str | Path) -> bool:
    """Check whether a name means a file or folder: no robot of the library, and there or spelt as a
    path.
    """
    if isinstance(name, Path):
        return True
    if name in list_robots():
        return False
    path = Path(name)
    return path.exists() or name != path.name or path.suffix != ""


def _paths(
    name: str | None, urdf: Path | str | None, hydrodynamics: Path | str | None
) -> tuple[Path, Path | None]:
    """Return the paths of URDF and hydrodynamics file. Raises `InvalidInput` for neither or both of
    name and URDF.
    """
    if (name is None) == (urdf is None):
        raise InvalidInput(
            "load_robot needs either a name or urdf=PATH; list_robots() gives the names"
        )
    yaml_path = None if hydrodynamics is None else Path(hydrodynamics)
    if name is None:
        return Path(str(urdf)), yaml_path
    folder = robot_folder(name)
    return folder / "robot.urdf", yaml_path or folder / "hydrodynamics.yaml"


def _read_description(files: _RobotFiles) -> RobotDescription:
    """Read the description of a robot, with its variant; an empty one where there is no file.
    Raises `InvalidInput` for a variant without a name.
    """
    if files.description:
        return files.description
    if files.yaml is None:
        return RobotDescription()
    if files.variant is None:
        return descriptions.read_description(files.yaml)
    if files.name is None:
        raise InvalidInput(
            f"variant {files.variant!r} without a robot's name; variants belong to named robots"
        )
    return descriptions.read_description(files.yaml, variant_file(files.name, files.variant))


def robots_folder() -> Path:
    """Return the folder that holds one folder per robot."""
    packed = _PACKAGE / "robots"
    if packed.is_dir():
        return packed
    return _PACKAGE.parent / "robots"


def list_robots() -> tuple[str, ...]:
    """Return the names that ``load_robot`` knows, sorted."""
    return tuple(sorted(path.parent.name for path in robots_folder().glob("*/robot.urdf")))


@checked
def robot_folder(name: str) -> Path:
    """Return the folder of a robot. Raises ``NameNotFound`` with the alternatives."""
    require_known("robot", name, list_robots())
    return robots_folder() / name


def list_variants(name: str) -> tuple[str, ...]:
    """Return the names of the other published data sets of a robot, sorted; ``load_robot(name,
    variant=...)``.
    """
    return tuple(sorted(path.stem for path in (robot_folder(name) / "variants").glob("*.yaml")))


def variant_file(name: str, variant: str) -> Path:
    """Return the file of a variant. Raises ``NameNotFound`` with the alternatives."""
    require_known(f"variant of {name}", variant, list_variants(name))
    return robot_folder(name) / "variants" / f"{variant}.yaml"


def example_robot_data() -> Path:
    """Return the folder of the package example-robot-data, which holds
    ``robots/<maker>_description``.

    Raises ``InvalidInput`` telling how to install it.
    """
    with suppress(importlib.metadata.PackageNotFoundError):
        for file in importlib.metadata.files("example-robot-data") or ():
            path = Path(str(file.locate())).resolve()
            if path.name == "package.xml" and path.parent.name == "example-robot-data":
                return path.parent
    raise InvalidInput('example-robot-data is not installed; run: pip install "uvms-ocp[robots]"')
