"""Find and load robots: URDF and description are read, checked against each other and joined.

Robots are in ``robots/``, packed into the package or of an editable checkout.
"""

from __future__ import annotations

import importlib.metadata
import logging
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from operator import attrgetter
from pathlib import Path
from typing import Any, Literal
from weakref import WeakKeyDictionary, WeakSet, WeakValueDictionary

import numpy as np
import pinocchio as pin
from pydantic import ValidationError

from uvms_ocp.checks import checked
from uvms_ocp.errors import InvalidInput, RobotDataError, UvmsError, require_known
from uvms_ocp.model_errors import one_line
from uvms_ocp.record.meta_values import RobotFilesMeta
from uvms_ocp.record.untrusted import note_file_read
from uvms_ocp.robot import coefficients, description as descriptions
from uvms_ocp.robot.description import RobotDescription
from uvms_ocp.robot.limits import (
    ASSUMED_ACCELERATION,
    ASSUMED_VELOCITY,
    held_joints,
    home_of,
    joints_of,
    limits_of,
    open_joints,
)
from uvms_ocp.robot.robot import Robot, with_moved_frame
from uvms_ocp.robot.roles import ALTIMETER, BASE, DVL, TOOL, tools_of, with_roles
from uvms_ocp.robot.urdf import UrdfModels, UrdfReading, models_and_notes

# Where robots are found: ``robots/`` packed into the package, or the one of an editable checkout.

_PACKAGE = Path(__file__).resolve().parents[1]

_ROUNDING = 1e-9  # relative, of masses that are added and taken away again
_SINGULAR = 1e-13  # relative to the largest eigenvalue

_ASSUMED = (
    f"what is missing is {ASSUMED_VELOCITY:g} rad/s and {ASSUMED_ACCELERATION:g} rad/s2, those of"
    " the arm in [Gao2022], with motors that bear it"
)

_log = logging.getLogger(__name__)

_loaded = WeakSet[Robot]()
_read = WeakValueDictionary[str, Robot]()
_open = WeakKeyDictionary[
    Robot, tuple[list[Any], list[str]]
]()  # its meshes and models as read, and what files leave open

_models = attrgetter(
    "model", "visual_model", "collision_model"
)  # which whoever has the robot can change


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


# What the files of a robot leave open, and what comes of it: valid files whose gaps a user has to
# know of.


def unknowns(model: pin.Model, description: RobotDescription) -> Iterator[tuple[str, str]]:
    """Subject and one sentence for everything that stays unknown or is left out. model: without
    trim bodies.
    """
    dry = links_without_water(model, description)
    if description.links and dry:
        yield (
            "water",
            (
                f"no water acts on link {', '.join(dry)}: give each an entry in links,"
                " {coefficients: {}} if dry"
            ),
        )
    elif description.base == "free_flyer" and not description.links:
        yield "water", "no link is in water: give a hydrodynamics.yaml with links"
    floats = description.base == "free_flyer"
    joints = joints_of(model, free_flyer=floats)
    held = held_joints(model, joints)
    if held:
        yield (
            "joints",
            f"joint {', '.join(held)} has no range, lower = upper: it is held there; make it fixed",
        )
    if floats and (open_ones := open_joints(model, joints)):
        yield (
            "limits",
            (
                f"no limit of velocity or effort for joint {', '.join(open_ones)}: {_ASSUMED}; give"
                " <limit>"
            ),
        )
    unknown = [thruster.name for thruster in description.thrusters if thruster.power is None]
    if unknown:
        yield (
            "energy",
            (
                f"no power is given for thruster {', '.join(unknown)}: the energy of the thrusters"
                " is not known"
            ),
        )


def links_without_water(model: pin.Model, description: RobotDescription) -> tuple[str, ...]:
    """Names of the links with a mass that the description does not mention. model: without trim
    bodies.
    """
    return tuple(
        name
        for name, mass in link_masses(model).items()
        if mass > 0.0 and name not in description.links
    )


def link_masses(model: pin.Model) -> dict[str, float]:
    """Mass [kg] by link, as the URDF gives it.

    Pinocchio keeps the mass of a link behind a fixed joint with the frame of that joint, that of
    the root of a fixed base with the link's own frame, and of a moving link only the sum with all
    that is fixed to it.
    """
    on_frames = np.zeros(model.njoints)
    masses = {}
    for frame in model.frames:
        on_frames[frame.parentJoint] += frame.inertia.mass
    for frame in model.frames:
        if frame.type != pin.FrameType.BODY:
            continue
        above = model.frames[frame.parentFrame]
        if frame.inertia.mass or above.type == pin.FrameType.FIXED_JOINT:
            masses[frame.name] = frame.inertia.mass or above.inertia.mass
        else:
            total = model.inertias[frame.parentJoint].mass
            rest = total - on_frames[frame.parentJoint]
            masses[frame.name] = rest if rest > _ROUNDING * total else 0.0
    return masses


def joints_without_inertia(model: pin.Model, M: np.ndarray) -> Iterator[str]:
    """Say, for each joint that a mass matrix M (n_v, n_v) [kg, kg m2] gives nothing to move, which
    links are behind it.

    Forces then have no acceleration, and nothing can be simulated.
    """
    values, vectors = np.linalg.eigh(M)
    empty = (vectors[:, values <= _SINGULAR * values.max(initial=0.0)] ** 2).sum(axis=1) > 0.1
    for index in range(1, model.njoints):
        joint = model.joints[index]
        if empty[joint.idx_v : joint.idx_v + joint.nv].any():
            links = [
                frame.name
                for frame in model.frames
                if frame.type == pin.FrameType.BODY and frame.parentJoint == index
            ]
            yield f"link {', '.join(links)} behind joint {model.names[index]!r}"


# From robot files to a `Robot`: URDF and description are read, checked against each other and
# joined.


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
        shared_description = descriptions.checked_copy(
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


def assemble(
    models: UrdfModels, description: RobotDescription, path: Path, name: str | None = None
) -> Robot:
    """Join the mechanism and its description.

    Raises ``RobotDataError``, which blames the file ``path``, for names, thrusters and a home that
    do not fit.
    """
    description = _of_what_is_there(descriptions.forward_left_up(description), models)
    model, description = with_roles(models.model, description, path)
    _check_names(model, description, path)
    robot = robot_of(
        replace(models, model=with_bodies(model, description.trim)),
        description,
        name or models.name,
    )
    try:
        robot.configuration()
    except InvalidInput as error:
        raise RobotDataError(path, f"home: {error}") from None
    return robot


def _of_what_is_there(description: RobotDescription, models: UrdfModels) -> RobotDescription:
    """Without what is said of links and joints of the file that are left out."""
    gone = models.no_links
    tools = tools_of(description)
    entries: dict[str, Any] = {
        key: tuple(p for p in getattr(description, key) if p.link not in gone)
        for key in ("trim", "thrusters")
    }
    entries |= {key: None for key in (BASE, ALTIMETER, DVL) if getattr(description, key) in gone}
    entries |= (
        {TOOL: tuple(tool for tool in tools if tool not in gone) or None}
        if gone & set(tools)
        else {}
    )
    for key, out in (("links", gone), ("joints", models.no_joints)):
        entries[key] = {
            name: entry for name, entry in getattr(description, key).items() if name not in out
        }
    return description.model_copy(
        update={key: value for key, value in entries.items() if value != getattr(description, key)}
    )


def robot_of(models: UrdfModels, description: RobotDescription, name: str) -> Robot:
    """Return the robot of a mechanism that already carries its trim bodies."""
    joints = joints_of(models.model, free_flyer=description.base == "free_flyer")
    limits = limits_of(models.model, description, joints)
    model = models.model.copy()
    rotors = np.zeros(models.model.nv)
    for joint in joints:
        rotors[joint.v] = description.joints.get(
            joint.name, descriptions.JointDescription()
        ).rotor_inertia
    model.armature = rotors
    return Robot(
        name=name,
        model=model,
        visual_model=models.visual,
        collision_model=models.collision,
        description=description,
        joints=joints,
        limits=limits,
        home=home_of(models.model, description, joints, limits),
        hydrodynamics=coefficients.links_in_water(description),
    )


def _check_names(model: pin.Model, description: RobotDescription, path: Path) -> None:
    known_frames = tuple(frame.name for frame in model.frames[1:])
    named = [
        *(("links", link) for link in description.links),
        *((f"trim {body.name!r} link", body.link) for body in description.trim),
        *(
            (f"thruster {thruster.name!r} link", thruster.link)
            for thruster in description.thrusters
        ),
        *((key, name) for key in (ALTIMETER, DVL) if (name := getattr(description, key))),
    ]
    moving = [joint.name for joint in joints_of(model, free_flyer=description.base == "free_flyer")]
    rule = f"is not in the URDF; allowed: {', '.join(known_frames)}"
    faults = [f"{key}: {name!r} {rule}" for key, name in named if name not in known_frames]
    allowed = f"is no joint of the URDF that moves; allowed: {', '.join(moving) or 'none'}"
    faults += [f"joints: {name!r} {allowed}" for name in description.joints if name not in moving]
    faults += _moving_thrusters(model, description)
    if faults:
        raise RobotDataError(path, *faults)


def _moving_thrusters(model: pin.Model, description: RobotDescription) -> list[str]:
    carrier = 1 if description.base == "free_flyer" else 0
    allowed = "allowed: links fixed to the vehicle, as gimballed thrusters are not modelled"
    dvl = description.dvl
    moves = (
        dvl is not None
        and model.existFrame(dvl)
        and model.frames[model.getFrameId(dvl)].parentJoint != carrier
    )
    return [f"{DVL}: given {dvl!r}; allowed: links fixed to the vehicle"] * moves + [
        f"thruster {thruster.name!r} link: given {thruster.link!r}; {allowed}"
        for thruster in description.thrusters
        if model.existFrame(thruster.link)
        and model.frames[model.getFrameId(thruster.link)].parentJoint != carrier
    ]


def with_bodies(model: pin.Model, bodies: Sequence[descriptions.TrimBody]) -> pin.Model:
    """Return a copy of the model that carries these floats and weights too."""
    model = model.copy()
    for body in bodies:
        joint, inertia = trim_inertia(model, body)
        model.inertias[joint] += inertia
    return model


def trim_inertia(model: pin.Model, body: descriptions.TrimBody) -> tuple[int, pin.Inertia]:
    """Return the joint that carries a float or ballast, and its point mass in the frame of that
    joint.
    """
    frame = model.frames[model.getFrameId(body.link)]
    return frame.parentJoint, frame.placement.act(
        pin.Inertia(body.mass, np.array(body.position), np.zeros((3, 3)))
    )
