"""Find and load robots: URDF and description are read, checked against each other and joined.

Robots are in ``robots/``, packed into the package or of an editable checkout.
"""

from __future__ import annotations

import importlib.metadata
import logging
import os
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from operator import attrgetter
from pathlib import Path
from typing import Any, Literal
from weakref import WeakKeyDictionary, WeakSet, WeakValueDictionary

from uvms_ocp.checks import checked
from uvms_ocp.errors import InvalidInput, RobotDataError, UvmsError, require_known
from uvms_ocp.record.untrusted import note_file_read
from uvms_ocp.robot import coefficients, description as descriptions
from uvms_ocp.robot.description import RobotDescription
from uvms_ocp.robot.joining import assemble
from uvms_ocp.robot.robot import Robot, with_moved_frame
from uvms_ocp.robot.unknowns import unknowns
from uvms_ocp.robot.urdf import UrdfReading, models_and_notes

_PACKAGE = Path(__file__).resolve().parents[1]

_log = logging.getLogger(__name__)

_loaded = WeakSet[Robot]()
_read = WeakValueDictionary[str, Robot]()
_open = WeakKeyDictionary[
    Robot, tuple[list[Any], list[str]]
]()  # its meshes and models as read, and what files leave open

_models = attrgetter(
    "model", "visual_model", "collision_model"
)  # which whoever has the robot can change


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
    """Load a robot by name, or from a URDF file and, if there is one, its hydrodynamics file, or
    what stands in it.

    In place of the name, a folder with robot.urdf, or a URDF: with the hydrodynamics.yaml beside it
    where there is one. ``variant`` is another published data set of a named robot, see
    ``list_variants``. The others take the place of what the hydrodynamics file says, which is what
    they are by default: ``base`` is ``free_flyer`` or ``fixed``; ``package_dirs`` are searched for
    ``package://`` meshes, besides those of the file; ``meshes=False`` leaves out shapes that are
    meshes. Joints that ``<mimic>`` another one are ``"coupled"``, one joint with it;
    ``mimic="free"`` makes them joints of their own, with the limits the URDF gives them,
    ``"fixed"`` keeps them where their leader's lock, or its home, puts them. ``lock`` fixes joints
    at a position [rad or m], ``drop`` leaves out links with all that hangs on them; what the
    hydrodynamics file says of what is left out counts for nothing. ``tool``, of several arms one
    each, ``altimeter`` and ``dvl`` are frames.

    Raises ``InvalidInput`` for neither or both of name and URDF, another ``mimic``, or a variant
    without a name, ``NameNotFound`` for an unknown robot or variant, and ``RobotDataError``, with
    all that is wrong at once, for files that are missing, broken, do not fit each other, or hold
    numbers that the model built from them has not.

    What the files leave open, such as links without water and thrusters without power data, is a
    warning of this module's logger.
    """
    given_description, file = (
        (hydrodynamics, None)
        if isinstance(hydrodynamics, RobotDescription)
        else (None, hydrodynamics)
    )
    if name is not None and _is_file(name):
        if urdf is not None:
            raise InvalidInput(f"load_robot: {name} and urdf={urdf}; give one of them")
        name, urdf, file = None, *files_of(Path(name), file).values()
    if name is None:
        name = None
    else:
        name = str(name)
    urdf_path, yaml_path = _paths(name, urdf, file)
    place = urdf_path.parent.resolve() / urdf_path.name  # which packages are seen from, a link too
    others: dict[str, Any] = {"base": base, "tool": tool, "altimeter": altimeter, "dvl": dvl}
    files = [
        urdf_path,
        *filter(None, [yaml_path]),
        *([variant_file(name, variant)] if name and variant else []),
    ]
    folders = [*map(os.path.abspath, package_dirs)]
    read_key = repr(
        (
            name,
            given_description,
            variant,
            others,
            folders,
            meshes,
            mimic,
            lock,
            drop,
            _stamps(files),
        )
    )
    read = _read.get(read_key)
    if read is not None and _open[read][0] == [_stamps(_mesh_files(read)), *_models(read)]:
        return _given_again(read, files)
    faults: list[RobotDataError] = []
    try:
        description = given_description or _description(name, yaml_path, variant)
    except RobotDataError as error:
        faults.append(error)  # what is wrong with the URDF is told with it
        description = RobotDescription()
    loading: dict[str, Any] = {"mimic": mimic, "lock": lock, "drop": tuple(drop) or None}
    if meshes is not None:
        loading["meshes"] = "yes" if meshes else "no"
    if package_dirs or (yaml_path is not None and yaml_path.parent != urdf_path.parent):
        described_folders = (
            (yaml_path or urdf_path).parent / folder for folder in description.loading.packages
        )
        resolved = (folder.resolve() for folder in (*map(Path, folders), *described_folders))
        loading["packages"] = (
            tuple(os.path.relpath(folder, place.parent) for folder in resolved) or None
        )
    if tool is None or isinstance(tool, str):
        others["tool"] = tool
    else:
        others["tool"] = tuple(tool)
    changes = {key: value for key, value in others.items() if value is not None}
    settings = description.loading.model_copy(
        update={key: value for key, value in loading.items() if value is not None}
    )
    if settings != description.loading:
        changes["loading"] = settings
    if changes:
        description = descriptions.checked_copy(description, **changes)
    try:
        models, notes = models_and_notes(
            urdf_path,
            free_flyer=description.base == "free_flyer",
            package_dirs=[urdf_path.parent / folder for folder in settings.packages],
            reading=UrdfReading(
                mimic=settings.mimic,
                lock=settings.lock,
                drop=settings.drop,
                meshes=settings.meshes == "yes",
                home={
                    name: joint.home
                    for name, joint in description.joints.items()
                    if joint.home is not None
                },
            ),
        )
    except RobotDataError as error:
        faults.append(error)
    if faults:
        folder = faults[0].path.parent  # whose files need no more than their names
        named = (
            (error.path.name if error.path.parent == folder else error.path, error)
            for error in faults[1:]
        )
        also = (f"{name}: {text}" for name, error in named for text in error.problems)
        raise RobotDataError(faults[0].path, *faults[0].problems, *also)
    robot = assemble(models, description, yaml_path or urdf_path, name)
    for moved in settings.frames:
        try:
            robot = with_moved_frame(robot, moved.frame, coefficients.placement_of(moved))
        except UvmsError as error:
            raise RobotDataError(yaml_path or urdf_path, f"loading.frames: {error}") from None
    by_default = name and not changes and hydrodynamics is None and variant is None
    robot = _known(robot if by_default else replace(robot, urdf=place))
    unknown_notes = [
        f"{yaml_path or urdf_path}: {text}" for _, text in unknowns(models.model, description)
    ]
    as_read = [
        _stamps(_mesh_files(robot)),
        robot.model.copy(),
        *(shapes.clone() for shapes in _models(robot)[1:]),
    ]
    _open[robot] = as_read, [*(f"{urdf_path}: {note}" for note in notes), *unknown_notes]
    if not notes:  # such as of a mesh that is missing, and may be there the next time
        _read[read_key] = robot
    return _warned(robot)


def _stamps(files: Iterable[Path | str]) -> list[Any]:
    """Return what changes where one of the files does."""
    stats = {os.path.abspath(file): os.stat(file) for file in sorted(files) if os.path.isfile(file)}
    return [
        (file, stat.st_ino, stat.st_size, stat.st_mtime_ns, stat.st_ctime_ns)
        for file, stat in stats.items()
    ]


def _mesh_files(robot: Robot) -> set[str]:
    return {
        shape.meshPath
        for shape in (*robot.visual_model.geometryObjects, *robot.collision_model.geometryObjects)
    }


def _given_again(robot: Robot, files: Iterable[Path]) -> Robot:
    meshes = filter(Path.is_file, map(Path, _mesh_files(robot)))  # a box has none
    for each in [*files, *meshes]:  # results depend on them as if they had been read
        note_file_read(each)
    return _warned(robot)


def _warned(robot: Robot) -> Robot:
    for text in _open[robot][1]:
        _log.warning("%s", text)
    return robot


def _known(robot: Robot) -> Robot:
    """Return the robot that was loaded before from files that say the same: what was derived and
    compiled of it is found again.
    """
    for shape in (*robot.visual_model.geometryObjects, *robot.collision_model.geometryObjects):
        shape.geometry.computeLocalAABB()  # else the first use does, and they differ
    content = attrgetter(
        "name", "urdf", "model", "visual_model", "collision_model", "description"
    )  # all else follows
    robot_in_use = next(
        (loaded for loaded in tuple(_loaded) if content(loaded) == content(robot)), robot
    )
    _loaded.add(robot_in_use)
    return robot_in_use


def robot_called(
    words: str, hydrodynamics: Path | str | None = None, loading: Mapping[str, Any] | None = None
) -> Robot:
    """The robot of a URDF, a folder with robot.urdf and hydrodynamics.yaml, or a name; with other
    hydrodynamics if given.

    loading: other arguments of `load_robot`.
    """
    path = Path(words)
    return load_robot(
        path if path.exists() else words, hydrodynamics=hydrodynamics, **(loading or {})
    )


def files_of(path: Path, hydrodynamics: Path | str | None = None) -> dict[str, Any]:
    """Arguments of `load_robot` for a URDF or a folder with robot.urdf, and hydrodynamics.yaml
    beside it if it is there.
    """
    urdf = path / "robot.urdf" if path.is_dir() else path
    default_file = urdf.with_name("hydrodynamics.yaml")
    return {
        "urdf": urdf,
        "hydrodynamics": hydrodynamics or (default_file if default_file.is_file() else None),
    }


def _is_file(name: str | Path) -> bool:
    path = Path(name)
    return isinstance(name, Path) or (
        name not in list_robots() and (path.exists() or name != path.name or path.suffix != "")
    )


def _paths(
    name: str | None, urdf: Path | str | None, hydrodynamics: Path | str | None
) -> tuple[Path, Path | None]:
    if (name is None) == (urdf is None):
        raise InvalidInput(
            "load_robot needs either a name or urdf=PATH; list_robots() gives the names"
        )
    if hydrodynamics is None:
        description_path = None
    else:
        description_path = Path(hydrodynamics)
    if name is None:
        return Path(str(urdf)), description_path
    folder = robot_folder(name)
    return folder / "robot.urdf", description_path or folder / "hydrodynamics.yaml"


def _description(name: str | None, path: Path | None, variant: str | None) -> RobotDescription:
    if path is None:
        return RobotDescription()
    if variant is None:
        return descriptions.read_description(path)
    if name is None:
        raise InvalidInput(
            f"variant {variant!r} without a robot's name; variants belong to named robots"
        )
    return descriptions.read_description(path, variant_file(name, variant))


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
