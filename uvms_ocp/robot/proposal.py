"""Propose a robot's hydrodynamics.yaml from its URDF alone: roles, what does not move, water by
shapes, trim, thrusters.

Every number and name that the URDF does not say is marked ``proposed`` in the file, with where it
comes from, and how far it may be off: such a robot swims at once, and says what to measure first.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import yaml

from uvms_ocp.errors import InvalidInput, RobotDataError
from uvms_ocp.robot import assembly, hydrodynamics, limits
from uvms_ocp.robot.coefficients import links_in_water
from uvms_ocp.robot.description import Box, LinkDescription, Pose, RobotDescription, checked_copy
from uvms_ocp.robot.loading import assemble, link_masses
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.roles import CHOOSE, Roles, find_roles, is_called
from uvms_ocp.robot.urdf import UrdfModels, UrdfReading, models_and_notes, read_urdf, read_urdf_xml

_WATER = 1025.0  # [kg/m3] the sea
_WORLDS = ("world", "map", "odom", "ground")  # names of roots that do not move
_VEHICLE = 0.5  # of the mass: a root with less carries an arm, and is no vehicle
_LIFT = 0.03  # [m] of buoyancy above the mass
_TOO_LARGE = 20.0  # times the mass of a link in water: its shapes are no hull, or in millimetres
# [N] per root of a kilogram of vehicle, as those of 10 to 160 kg have per thruster, or per kilogram
_THRUST = (12.0, 0.95)
# [s] mechanical time constants of small motors are 5 to 20 ms of the torque that stalls them, above
# the limit
_SPIN_UP = 0.03
_FINGERS = (
    "fingers that mimic none, held still; <mimic> in the URDF makes them one joint, without `lock`"
    " each is its own"
)
_EMPTY = (
    "moves nothing that has a mass, and is held still; give its links <inertial>, and take it out"
    " of `lock`"
)
_DOWN = 0.9  # cosine to straight down, of a range sensor's -z

_HEAD = """# What the URDF does not say: water, thrusters, limits. SI units; vectors in the frame of their link, forward-left-up.
# Everything here is proposed, from the URDF alone: look at each line, and replace what you know.
# `uvms-ocp schema` prints all that may stand here."""


@dataclass(frozen=True, kw_only=True, slots=True)
class RobotProposal:
    """Proposed files of a robot, and the questions that its URDF leaves open."""

    text: str
    """The hydrodynamics.yaml."""
    questions: tuple[str, ...]
    """Questions that the URDF leaves open, one line each, with how to answer."""
    robot: Robot
    """The robot that comes of both."""


def find_urdf(place: Path) -> Path:
    """The URDF that is meant by a file or a folder. Raises `InvalidInput` for none or several."""
    if not place.is_dir():
        return place
    urdfs = sorted(path for path in place.rglob("*.urdf") if path.is_file())
    if len(urdfs) == 1:
        return urdfs[0]
    if not urdfs:
        raise InvalidInput(
            f"{place}: holds no .urdf; of a .xacro file give what `xacro FILE.xacro > robot.urdf`"
            " writes"
        )
    raise InvalidInput(
        f"{place}: holds {len(urdfs)} URDFs; give one of {', '.join(map(str, urdfs[:30]))}"
    )


def propose(
    urdf: Path,
    *,
    base: str | None = None,
    package_dirs: Sequence[Path] = (),
    loading: Mapping[str, Any] | None = None,
    tool: Sequence[str] = (),
    altimeter: str | None = None,
    dvl: str | None = None,
) -> RobotProposal:
    """Read any URDF and propose what it does not say; what is given is taken as it is.

    loading: entries of ``loading`` in hydrodynamics.yaml. Raises ``RobotDataError`` with all that
    is wrong with the file.
    """
    settings = dict(loading or {})
    root = read_urdf_xml(urdf)
    followers = [joint.get("name", "") for joint in root.findall("joint[mimic]")]
    endless = [
        j
        for j in root.findall("joint")
        if j.get("type") in ("revolute", "prismatic") and j.find("limit") is None
    ]
    lock = {**{joint.get("name", ""): 0.0 for joint in endless}, **settings.get("lock", {})}
    reading = UrdfReading(
        mimic="free",
        lock=lock,
        drop=tuple(settings.get("drop", ())),
        meshes=settings.get("meshes") != "no",
    )
    models, reading = _read(urdf, reading, package_dirs)
    floats = base == "free_flyer" or (base is None and _floats(models.model))
    if not floats:
        models, _ = models_and_notes(
            urdf, free_flyer=False, package_dirs=package_dirs, reading=reading
        )
    roles = find_roles(models.model, free_flyer=floats)
    mimic: Any = settings.get("mimic", "coupled")
    led = [mimic.get("joint", "") for mimic in root.findall("joint/mimic")]
    fingers = [name for name in roles.fingers if name not in led or mimic != "coupled"]
    still = (*roles.propellers, *roles.sensors, *fingers, *roles.empty, *roles.held, *roles.gimbals)
    lock = {
        **{name: _nearest_to_zero(models.model, name) for name in still if name not in followers},
        **lock,
    }
    reading = replace(reading, mimic=mimic, lock=lock)
    return _Draft(
        models=read_urdf(urdf, free_flyer=floats, package_dirs=package_dirs, reading=reading),
        roles=roles,
        reading=reading,
        floats=floats,
        tool=tuple(tool),
        altimeter=altimeter,
        dvl=dvl,
        pushers=list(_thrusters(models, roles)) if floats else [],
    ).proposal(urdf)


def _read(
    urdf: Path, reading: UrdfReading, package_dirs: Sequence[Path]
) -> tuple[UrdfModels, UrdfReading]:
    """With meshes, or without those where some that matter are not there."""
    read = partial(models_and_notes, urdf, free_flyer=True, package_dirs=package_dirs)
    try:
        return read(reading=reading)[0], reading
    except RobotDataError as error:
        if not reading.meshes or not all("mesh" in problem for problem in error.problems):
            raise
    reading = replace(reading, meshes=False)
    return read(reading=reading)[0], reading


def _floats(model: pin.Model) -> bool:
    """Check whether a model on a free-flyer is a vehicle, and not an arm that stands on
    something.
    """
    root = next(frame.name for frame in model.frames if frame.type == pin.FrameType.BODY)
    if any(is_called("propeller", frame.name) for frame in model.frames):
        return True
    total = sum(inertia.mass for inertia in model.inertias)
    return (
        root.rpartition("/")[2].lower() not in _WORLDS and model.inertias[1].mass > _VEHICLE * total
    )


def _nearest_to_zero(model: pin.Model, name: str) -> float:
    joint = model.joints[model.getJointId(name)]
    if joint.nq != 1:
        return 0.0
    return float(
        np.clip(0.0, model.lowerPositionLimit[joint.idx_q], model.upperPositionLimit[joint.idx_q])
    )


def _thrusters(models: UrdfModels, roles: Roles) -> Iterator[tuple[str, pin.SE3, np.ndarray, str]]:
    """Name, pose in B, direction in B and its source: of each propeller's joint, or else of each
    link of such a name.
    """
    model = models.model
    data = model.createData()
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    pushing = [name for name in roles.propellers if not is_called("fin", name)]
    for name in pushing:
        index = model.getJointId(name)
        X = data.oMi[index]
        S = np.array(model.joints[index].createData().S)
        yield name, X, X.rotation @ S.ravel()[3:], "axis of the joint"
    if pushing:
        return
    for i, frame in enumerate(model.frames):
        is_link = (
            frame.type == pin.FrameType.BODY
            and is_called("propeller", frame.name)
            and not is_called("fin", frame.name)
        )
        if is_link and frame.parentJoint <= 1 and not _has_propeller_above(model, i):
            shapes = [shape for shape in models.visual.geometryObjects if shape.parentFrame == i]
            cylinders = [shape for shape in shapes if isinstance(shape.geometry, coal.Cylinder)]
            if cylinders:
                yield (
                    frame.name,
                    data.oMf[i],
                    cylinders[0].placement.rotation[:, 2],
                    "axis of its cylinder",
                )
            else:
                yield frame.name, data.oMf[i], data.oMf[i].rotation[:, 0], "x axis of the link"


def _has_propeller_above(model: pin.Model, index: int) -> bool:
    above = model.frames[model.frames[index].parentFrame].parentFrame
    return above > 0 and is_called("propeller", model.frames[above].name)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Draft:
    """Description of a robot before its hydrodynamics are proposed."""

    models: UrdfModels
    roles: Roles
    reading: UrdfReading
    floats: bool
    tool: tuple[str, ...]
    altimeter: str | None
    dvl: str | None
    pushers: list[tuple[str, pin.SE3, np.ndarray, str]]

    def proposal(self, urdf: Path) -> RobotProposal:
        """The whole of it."""
        links, sources = self._links()
        content = self._content(links)
        dry = assemble(self.models, RobotDescription.model_validate(content), urdf)
        if self.floats:
            content["links"] = self._trimmed(dry, content["links"])
        robot = assemble(self.models, RobotDescription.model_validate(content), urdf)
        text = "".join(f"{line}\n" for line in _lines(robot.description, sources, self))
        return RobotProposal(text=text, questions=tuple(self.questions()), robot=robot)

    @property
    def tools(self) -> tuple[str, ...]:
        """Tools, one for each arm, where that leaves no doubt."""
        if self.tool:
            return self.tool
        frames = [frame.name for frame in self.models.model.frames]
        sure = [chain[0] for chain in self.roles.tools if len(chain) == 1]
        if "tool" in frames and len(self.roles.tools) < 2:
            return ("tool",)
        if len(sure) == len(self.roles.tools):
            return tuple(sure)
        return ()

    @property
    def range_sensor(self) -> str | None:
        """A link that is called an altimeter and looks down."""
        if self.altimeter or not self.floats:
            return self.altimeter
        model = self.models.model
        data = model.createData()
        pin.framesForwardKinematics(model, data, pin.neutral(model))
        down = [
            link.name
            for i, link in self._links_called("altimeter")
            if data.oMf[i].rotation[2, 2] > _DOWN
        ]
        if len(down) == 1:
            return str(down[0])
        return None

    @property
    def velocity_sensor(self) -> str | None:
        """The only link of the vehicle that is called a DVL."""
        return self.dvl or (self.logs[0] if self.floats and len(self.logs) == 1 else None)

    @property
    def logs(self) -> list[str]:
        """Links of the vehicle that are called a DVL."""
        return [link.name for _, link in self._links_called("dvl") if link.parentJoint <= 1]

    def _links_called(self, kind: str) -> list[tuple[int, pin.Frame]]:
        """Links whose name is of a kind, with their indices."""
        frames = enumerate(self.models.model.frames)
        return [
            (i, frame)
            for i, frame in frames
            if frame.type == pin.FrameType.BODY and is_called(kind, frame.name)
        ]

    def questions(self) -> Iterator[str]:
        """Give the questions that are left open."""
        if not self.pushers:
            kind = (
                "a vehicle, as its root is the heaviest part"
                if self.floats
                else "an arm that stands on something"
            )
            yield (
                f"base: taken for {kind}; --base {'fixed' if self.floats else 'free_flyer'} if it"
                " is not"
            )
        if not self.tools and self.roles.candidates:
            yield f"tool: any of {', '.join(self.roles.candidates)}; {CHOOSE}"
        if self.floats and not self.range_sensor:
            yield (
                "altimeter: no link is called one and looks down along its -z; --altimeter LINK, or"
                " none: no altitude tasks"
            )
        if self.floats and not self.velocity_sensor:
            if self.logs:
                which = f"any of {', '.join(self.logs)}"
            else:
                which = "no link of the vehicle is called one"
            yield f"dvl: {which}; --dvl LINK, or `sensors: {{linear_velocity: null}}` for none"
        for names, why in ((self.roles.fingers, _FINGERS), (self.roles.empty, _EMPTY)):
            still = [name for name in names if name in self.reading.lock]
            if still:
                yield f"joint {', '.join(still)}: {why}"
        steers = [
            *self.roles.gimbals,
            *(name for name in self.roles.propellers if is_called("fin", name)),
        ]
        if self.floats and steers:
            yield (
                f"joint {', '.join(steers)}: turns thrusters or the flow, which is not modelled; it"
                " is held still"
            )
        propellers = (
            link for _, link in self._links_called("propeller") if not is_called("fin", link.name)
        )
        moving = [link.name for link in propellers if link.parentJoint > 1]
        if self.floats and moving:
            yield (
                f"link {', '.join(moving)}: a thruster on a link that moves is not modelled; it is"
                " left out"
            )
        if self.floats and not self.pushers:
            yield (
                "thrusters: no link or joint is called one; write them into the file, or fly with"
                " --plant kinematic"
            )

    def _content(self, links: dict[str, Any]) -> dict[str, Any]:
        model = self.models.model
        joints = {
            joint.name: _motor(model, joint)
            for joint in limits.joints_of(model, free_flyer=self.floats)
        }
        content: dict[str, Any] = {
            "base": "free_flyer" if self.floats else "fixed",
            "water_density": _WATER,
        }
        content |= (
            {"base_link": self.roles.base} if self.floats and self.roles.base != "base_link" else {}
        )
        if len(self.tools) == 1:
            content["tool"] = self.tools[0]
        elif self.tools:
            content["tool"] = self.tools
        content |= {"altimeter": self.range_sensor} if self.range_sensor else {}
        content |= {"dvl": self.velocity_sensor} if self.velocity_sensor else {}
        loading = {
            "mimic": None if self.reading.mimic == "coupled" else self.reading.mimic,
            "lock": dict(self.reading.lock),
            "drop": self.reading.drop,
            "meshes": "yes" if self.reading.meshes else "no",
        }
        content["loading"] = {
            key: value for key, value in loading.items() if value not in (None, {}, (), "yes")
        }
        if self.floats:
            content["vehicle_limits"] = {
                "velocity": [0.5, 0.4, 0.4, 0.4, 0.4, 0.5],
                "acceleration": [0.3] * 3 + [0.4] * 3,
            }
        content |= {"joints": joints, "links": links}
        return content | ({"thrusters": self._pushing()} if self.pushers else {})

    def _pushing(self) -> list[dict[str, Any]]:
        model = self.models.model
        mass = sum(inertia.mass for inertia in model.inertias)
        limit = float(f"{max(_THRUST[0] * np.sqrt(mass), _THRUST[1] * mass):.2g}")
        X_FB = model.frames[model.getFrameId(self.roles.base)].placement.inverse()
        return [
            {
                "name": name,
                "link": self.roles.base,
                "position": _rounded(X_FB.act(X.translation)),
                "direction": _rounded(X_FB.rotation @ direction),
                "minimum": -limit,
                "maximum": limit,
                "time_constant": 0.15,
            }
            for name, X, direction, _ in self.pushers
        ]

    def _links(self) -> tuple[dict[str, Any], dict[str, str]]:
        """Coefficients by link, and where they come from: of the vehicle those of a box around all
        that is fixed to it.
        """
        wet = dict[str, Any]()
        sources = dict[str, str]()
        hull = self.hull
        for name, mass in link_masses(self.models.model).items():
            on_vehicle = self._carrier(name) <= (1 if self.floats else 0)
            if mass > 0.0 and on_vehicle and name != hull:
                wet[name] = {"coefficients": {}}
                sources[name] = f"in the box around {hull}" if hull else "does not move"
            elif mass > 0.0:
                wet[name], sources[name] = self._by_shape(name, mass, whole=name == hull)
        return wet, sources

    @property
    def hull(self) -> str:
        """The link of the vehicle that has the coefficients: the heaviest; "" for none."""
        on_vehicle = {
            name: m
            for name, m in link_masses(self.models.model).items()
            if self._carrier(name) == 1 and m > 0.0
        }
        if self.floats and on_vehicle:
            return max(on_vehicle, key=lambda name: on_vehicle[name])
        return ""

    def _carrier(self, name: str) -> int:
        model = self.models.model
        return int(model.frames[model.getFrameId(name)].parentJoint)

    def _by_shape(self, name: str, mass: float, *, whole: bool) -> tuple[dict[str, Any], str]:
        """Coefficients of one link, of the box or cylinder around its shapes, or of a body with its
        inertia.
        """
        model = self.models.model
        if whole:
            joint = self._carrier(name)
        else:
            joint = None
        corners = assembly.box_around(model, self.models.collision, name, joint=joint)
        if np.isnan(corners).any():
            corners = assembly.box_around(model, self.models.visual, name, joint=joint)
        source = f"{'box' if whole else 'cylinder'} around its shapes"
        if np.isnan(corners).any() or np.prod(np.ptp(corners, axis=0)) * _WATER > _TOO_LARGE * max(
            mass, 1.0
        ):
            corners = _as_its_inertia(model, name, mass)
            source = "box with its mass and inertia, as it has no fitting shapes"
        size = np.ptp(corners, axis=0)
        centre = corners.mean(axis=0)
        if whole:
            cylinder = None
        else:
            cylinder = assembly.cylinder_in(corners)
        box = Box(
            size=tuple(np.maximum(size, 1e-3).tolist()),
            pose=Pose(position=tuple(centre.tolist())),
            drag_by="flow",
        )
        if cylinder is None:
            way = LinkDescription(box=box)
        else:
            way = LinkDescription(cylinder=cylinder)
        (water,) = links_in_water(RobotDescription(links={name: way}, water_density=_WATER))
        sides = " x ".join(f"{side:.3g}" for side in size)
        return {"coefficients": _coefficients(water, mass)}, f"{source}, {sides} m"

    def _trimmed(self, robot: Robot, links: dict[str, Any]) -> dict[str, Any]:
        """The links with so much volume of the hull, and there, that the vehicle floats level with
        its arm stowed.
        """
        hull = self.hull
        if not hull:
            return links
        unballasted = {
            key: value
            for key, value in links[hull]["coefficients"].items()
            if key not in ("volume", "centre_of_buoyancy")
        }
        trimmed_links = {**links, hull: {"coefficients": unballasted}}
        bare = checked_copy(robot.description, links=trimmed_links)
        arms, lift = assembly.lifts(
            replace(robot, description=bare, hydrodynamics=links_in_water(bare)),
            robot.configuration(),
        )
        total = -float(lift.sum())
        if total <= 0.0:
            return links
        at = -(arms.T @ lift) / total
        gravity = float(np.linalg.norm(robot.model.gravity.linear))
        at[2] = robot.model.inertias[1].lever[2] + _LIFT
        X_BF = robot.model.frames[robot.frame_id(hull)].placement
        trimmed_links[hull]["coefficients"] |= {
            "volume": float(f"{total / (gravity * _WATER):.6g}"),
            "centre_of_buoyancy": [float(f"{value:.6g}") for value in X_BF.actInv(at)],
        }
        return trimmed_links


def _coefficients(water: hydrodynamics.LinkHydrodynamics, mass: float) -> dict[str, Any]:
    """Return coefficients in the words of a file. No link floats by itself: what its shape holds of
    air or water is not known.
    """
    return {
        "pose": {
            "position": _rounded(water.X_FL.translation),
            "rpy": _rounded(pin.rpy.matrixToRpy(water.X_FL.rotation), 7),
        },
        "added_mass": _rounded(np.diag(water.added_mass)),
        "linear_drag": _rounded(np.diag(water.linear_drag)),
        "quadratic_drag": _rounded(np.diag(water.quadratic_drag)),
        "drag_by": "flow" if water.by_flow else "axes",
        "volume": float(f"{min(water.volume, mass / _WATER):.4g}"),
        "centre_of_buoyancy": _rounded(water.centre_of_buoyancy),
    }


def _rounded(values: np.ndarray, digits: int = 4) -> list[float]:
    return [
        float(f"{value:.{digits}g}") if abs(value) > 1e-9 else 0.0
        for value in np.asarray(values, dtype=float)
    ]


def _as_its_inertia(model: pin.Model, name: str, mass: float) -> np.ndarray:
    """Corners (2, 3) [m] of a box that has the moments of a link, or of one as heavy as water where
    it has none.
    """
    index = model.getFrameId(name)
    inertia = model.frames[index].placement.actInv(model.inertias[model.frames[index].parentJoint])
    a, b, c = np.diag(inertia.inertia)
    squares = 6.0 / max(inertia.mass, 1e-9) * np.array([b + c - a, c + a - b, a + b - c])
    cube = (mass / _WATER) ** (1 / 3)
    if (squares > 0.0).all():
        size = np.sqrt(squares)
    else:
        size = np.full(3, cube)
    if np.prod(size) * _WATER > _TOO_LARGE * max(mass, 1.0):
        size = np.full(3, cube)
    return np.array([inertia.lever - size / 2, inertia.lever + size / 2])


def _motor(model: pin.Model, joint: limits.Joint) -> dict[str, float]:
    """Half a second to full speed, and the rotor that full effort brings there in `_SPIN_UP`,
    whatever the gear.
    """
    speed, effort = (
        float(limit[joint.idx_v]) for limit in (model.upperVelocityLimit, model.upperEffortLimit)
    )
    if not 0.0 < speed < 10.0:
        return {"acceleration": 1.0}
    if 0.0 < effort < 1e4:
        rotor = {"rotor_inertia": float(f"{_SPIN_UP * effort / speed:.3g}")}
    else:
        rotor = {}
    return {"acceleration": float(f"{2.0 * speed:.3g}"), **rotor}


def _lines(
    description: RobotDescription, sources: Mapping[str, str], draft: _Draft
) -> Iterator[str]:
    values = description.model_dump(mode="json", exclude_unset=True)
    yield _HEAD
    yield (
        f"base: {values['base']} # proposed:"
        f" {'what floats' if draft.floats else 'an arm that stands on something'}"
    )
    yield f"water_density: {description.water_density} # proposed: the sea; fresh water has 998"
    if description.base_link:
        yield (
            f"base_link: {_flow(description.base_link)} # proposed: the root, which stands for the"
            " vehicle"
        )
    if draft.tools:
        source = (
            "as you said" if draft.tool else "the end of each chain; the first is `tool` of tasks"
        )
        yield f"tool: {_flow(values['tool'])} # {'' if draft.tool else 'proposed: '}{source}"
    for question in draft.questions():
        yield f"# {question}"
    if description.altimeter:
        source = (
            "as you said"
            if draft.altimeter
            else "proposed: by its name, as it looks down along its -z"
        )
        yield f"altimeter: {_flow(description.altimeter)} # {source}"
    if description.dvl:
        yield (
            f"dvl: {_flow(description.dvl)} #"
            f" {'as you said' if draft.dvl else 'proposed: by its name'}"
        )
    yield from _loading_lines(values.get("loading", {}))
    if description.vehicle_limits:
        yield "vehicle_limits: # proposed: of a slow vehicle; surge, sway, heave, roll, pitch, yaw"
        yield from (f"  {key}: {_flow(row)}" for key, row in values["vehicle_limits"].items())
    if description.joints:
        rotors = f"rotors that full effort alone brings there in {_SPIN_UP:g} s"
        yield (
            "joints: # proposed: half a second to full speed, or 1 where the URDF has no limit of"
            f" it; {rotors}"
        )
        yield from (f"  {_flow(name)}: {_flow(entry)}" for name, entry in values["joints"].items())
    yield (
        "links: # proposed by shapes: added mass may be 0.5 to 1.5 times as large, drag 0.5 to 2"
        " times"
    )
    for name, link in values["links"].items():
        yield f"  {_flow(name)}: # {sources.get(name, '')}"
        coefficients = link["coefficients"]
        yield f"    coefficients:{'' if coefficients else ' {}'}"
        for key, value in coefficients.items():
            if key == "volume" and name == draft.hull:
                source = " # proposed: so that it floats level"
            else:
                source = ""
            yield f"      {key}: {_flow(value)}{source}"
    if description.thrusters:
        yield (
            "thrusters: # proposed: places and directions of the URDF; limits as vehicles of this"
            " mass have them"
        )
        for entry, (_, _, _, source) in zip(values["thrusters"], draft.pushers, strict=True):
            yield f"  - {_flow(entry)} # {source}"


def _loading_lines(loading: Mapping[str, Any]) -> Iterator[str]:
    source = {
        "mimic": "as you said",
        "lock": (
            "propellers, sensors, fingers that mimic none, what has no mass or no <limit>: these do"
            " not move here"
        ),
        "meshes": "some that matter for contact cannot be read",
        "drop": "as you said",
    }
    if loading:
        yield "loading: # proposed: how the URDF is read"
        yield from (f"  {key}: {_flow(value)} # {source[key]}" for key, value in loading.items())


def _flow(value: Any) -> str:
    """A value on one line of YAML."""
    text = yaml.safe_dump(
        value, default_flow_style=True, width=100_000, sort_keys=False, allow_unicode=True
    )
    return text.removesuffix("\n").removesuffix("\n...").strip()
