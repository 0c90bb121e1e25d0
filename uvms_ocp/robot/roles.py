"""Find the roles of links, the vehicle's base, tools, altimeter, DVL, propellers and sensors: by
structure first, then by name.

Tasks, payloads and figures name roles, ``base_link``, ``tool``, ``altimeter`` and ``dvl``; files
name links as they like. A robot has a frame for each of its roles, fixed to the link that
hydrodynamics.yaml names, or to what is found here.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.errors import RobotDataError
from uvms_ocp.robot.description import LinkDescription, RobotDescription
from uvms_ocp.robot.name_words import NameWords

BASE = "base_link"
TOOL = "tool"
ALTIMETER = "altimeter"
DVL = "dvl"
CHOOSE = "choose by `tool:` in hydrodynamics.yaml, or --tool LINK"
"""Advice where there are several candidates for the tool."""
_BALANCED = 0.1
"""Distance of a propeller's centre of mass from its axis, at most, over that from its joint."""
_SHORT = 0.1
"""[m] Distance of a centre of mass from the joint that is counted at least."""
_GIMBAL_JOINTS = 2  # between the vehicle and a thruster that they point, at most
_ALONG = 0.99  # cosine to an axis of the vehicle, of what slides along it
_SLIDING = ("JointModelPX", "JointModelPY", "JointModelPZ", "JointModelPrismaticUnaligned")

_KINDS = (
    "propellers",
    "sensors",
    "fingers",
    "empty",
    "held",
    "gimbals",
    "spinners",
    "ballast",
)
"""Fields of `Roles` that say of what kind joints are."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Roles:
    """Roles of the links of a mechanism, as far as the mechanism tells."""

    base: str
    """The link that stands for the vehicle: ``base_link`` where one is fixed to the root, or else
    the root itself.
    """
    propellers: tuple[str, ...]
    """Joints that turn propellers or fins."""
    sensors: tuple[str, ...]
    """Joints that move nothing but sensors."""
    fingers: tuple[str, ...]
    """Joints that close grippers."""
    empty: tuple[str, ...]
    """Joints that move nothing with a mass."""
    held: tuple[str, ...]
    """Joints without range, as none above or below them has: sensors and brackets of some
    exporters, and no arm.
    """
    gimbals: tuple[str, ...]
    """Joints that carry nothing but propellers."""
    spinners: tuple[str, ...]
    """Joints that spin a tool at the end of an arm, such as a cutter."""
    ballast: tuple[str, ...]
    """Joints that slide a mass along an axis of the vehicle."""
    tools: tuple[tuple[str, ...], ...]
    """Candidates for the tool, by chain of joints, the longest first; one where a chain leaves no
    doubt.
    """

    @property
    def only_tool(self) -> str | None:
        """The tool where there is no doubt about it."""
        if len(self.tools) == 1 and len(self.tools[0]) == 1:
            return self.tools[0][0]
        return None

    @property
    def candidates(self) -> tuple[str, ...]:
        """All candidates for the tool."""
        return tuple(chain.from_iterable(self.tools))


def find_roles(model: pin.Model, *, free_flyer: bool) -> Roles:
    """Return the roles of the links of a model."""
    tree = _LinkTree(model, free_flyer)
    kinds = dict(_kinds(tree))
    names_by_kind: dict[str, tuple[str, ...]] = dict.fromkeys(_KINDS, ())
    arm = list[int]()
    for joint in tree.moving:
        if joint in kinds:
            names_by_kind[kinds[joint]] += (model.names[joint],)
        else:
            arm.append(joint)
    tools = list[tuple[str, ...]]()
    ends = [joint for joint in arm if not set(arm) & set(tree.children(joint))]
    ends.sort(key=lambda joint: -len(tree.above(joint)))
    for joint in ends:
        tips = _tips(tree, joint)
        if tips:
            tools.append(tips)
    return Roles(base=_base(tree), tools=tuple(tools), **names_by_kind)


def _base(tree: _LinkTree) -> str:
    """Return the link that stands for the vehicle; empty where nothing is fixed to the root."""
    links = [tree.name(i) for i in tree.bodies[tree.carrier]]
    if BASE in links:
        return BASE
    return next(iter(links), "")


class _LinkTree:
    """Tree of links and joints: links of a model by the joint that carries them."""

    def __init__(self, model: pin.Model, free_flyer: bool) -> None:
        self.model = model
        self.words = NameWords(model)
        self.carrier = 1 if free_flyer else 0
        """Joint that carries the vehicle, or 0, the world."""
        self.moving = range(self.carrier + 1, model.njoints)
        """Joints that move against the vehicle."""
        self.bodies: dict[int, list[int]] = {joint: [] for joint in range(model.njoints)}
        """Frames of the links that each joint carries."""
        self.inner = set[int]()
        """Frames of links on which another link hangs."""
        for i, frame in enumerate(model.frames):
            if frame.type == pin.FrameType.BODY:
                self.bodies[frame.parentJoint].append(i)
                self.inner.add(self._frame_above(i))

    def _frame_above(self, frame: int) -> int:
        """Return the frame of the link on which a link hangs."""
        joint_frame = self.model.frames[frame].parentFrame
        return int(self.model.frames[joint_frame].parentFrame)

    def name(self, frame: int) -> str:
        """Return the name of a link by its frame."""
        return str(self.model.frames[frame].name)

    def names(self, joint: int) -> list[str]:
        """Return the names of a joint and of the link that it moves."""
        link_names = [self.name(i) for i in self.bodies[joint][:1]]
        return [str(self.model.names[joint]), *link_names]

    def children(self, joint: int) -> list[int]:
        """Return the joints that hang on a joint, without those that hang on them."""
        return [child for child in self.moving if self.model.parents[child] == joint]

    def below(self, joint: int) -> list[int]:
        """Return the joint and all that hang on it."""
        joints = [joint]
        for child in self.children(joint):
            joints += self.below(child)
        return joints

    def above(self, joint: int) -> list[int]:
        """Return the joints between the vehicle and this one."""
        parent = self.model.parents[joint]
        if parent <= self.carrier:
            return []
        return [parent, *self.above(parent)]

    def has_range(self, joint: int) -> bool:
        """Check whether a joint can move at all."""
        moving = self.model.joints[joint]
        if moving.nq != moving.nv:
            return True
        n_q = max(moving.nq, 1)  # of one that mimics, those of its leader
        q = slice(moving.idx_q, moving.idx_q + n_q)
        lower = self.model.lowerPositionLimit[q]
        upper = self.model.upperPositionLimit[q]
        return bool((lower < upper).any())

    def is_no_tool(self, frame: int) -> bool:
        """Check whether a link is a sensor or a finger; the palm that carries fingers is
        neither.
        """
        name = self.name(frame)
        if self.words.is_called("sensor", name):
            return True
        if frame in self.inner or self.words.is_called("tip", name):
            return False
        return self.words.is_called("finger", name)

    def is_end(self, frame: int) -> bool:
        """Check that no other link is fixed to the link further out, but sensors and fingers."""
        for i in self.bodies[self.model.frames[frame].parentJoint]:
            if not self.is_no_tool(i) and self._frame_above(i) == frame:
                return False
        return True


def _kinds(tree: _LinkTree) -> Iterator[tuple[int, str]]:
    """Yield joints that are no part of an arm, with what they do."""
    for joint in tree.moving:
        below = tree.below(joint)
        if _carries_propellers_alone(tree, joint):
            yield joint, "gimbals" if tree.children(joint) else "propellers"
        elif not any(tree.model.inertias[k].mass for k in below):
            yield joint, "empty"
        elif _carries_sensors_alone(tree, joint):
            yield joint, "sensors"
        elif _whirls(tree, joint):
            yield joint, "propellers"
        elif _spins_a_tool(tree, joint):
            yield joint, "spinners"
        elif _is_finger(tree, joint):
            for finger_joint in below:
                yield finger_joint, "fingers"
        elif _slides_ballast(tree, joint):
            yield joint, "ballast"
        elif not any(tree.has_range(k) for k in (*tree.above(joint), *below)):
            yield joint, "held"


def _carries_propellers_alone(tree: _LinkTree, joint: int) -> bool:
    """Check whether a joint turns a propeller of the vehicle, or points some of them: what ends in
    one after more joints, or holds a tool beside it, is an arm.
    """
    below = tree.below(joint)
    for k in below:
        links = [tree.name(i) for i in tree.bodies[k]]
        if tree.words.is_called("tip", *links) or tree.words.is_called("finger", *links):
            return False
        if tree.children(k):
            continue
        if not tree.words.is_called("propeller", *tree.names(k)):
            return False
        if len(tree.above(k)) > _GIMBAL_JOINTS:
            return False
    return True


def _spins_a_tool(tree: _LinkTree, joint: int) -> bool:
    """Check whether a joint without end is the last of an arm, and is called a blade or alike."""
    turns_without_end = tree.model.joints[joint].nq != tree.model.joints[joint].nv
    is_last = not tree.children(joint)
    if not (turns_without_end and is_last and tree.above(joint)):
        return False
    names = tree.names(joint)
    return tree.words.is_called("spinner", *names) or tree.words.is_called("propeller", *names)


def _is_finger(tree: _LinkTree, joint: int) -> bool:
    """Check whether a joint closes a gripper: by its name, beside another last joint on an arm's
    link, or below a frame of that link which is called the tool.
    """
    if tree.words.is_called("finger", *tree.names(joint)):
        return True
    palm = int(tree.model.parents[joint])
    if palm <= tree.carrier or tree.children(joint):
        return False
    last_joints = list[int]()
    for sibling in tree.children(palm):
        is_other = _carries_sensors_alone(tree, sibling) or _spins_a_tool(tree, sibling)
        if not tree.children(sibling) and not is_other:
            last_joints.append(sibling)
    holds_tool = False
    for i in tree.bodies[palm]:
        if i not in tree.inner and tree.words.is_called("tip", tree.name(i)):
            holds_tool = True
    return len(last_joints) > 1 or holds_tool


def _slides_ballast(tree: _LinkTree, joint: int) -> bool:
    """Check whether a joint slides a mass along an axis of the vehicle: called so, or one of
    several, or beside an arm.
    """
    if not _is_slider(tree, joint):
        return False
    if tree.words.is_called("ballast", *tree.names(joint)):
        return True
    others = [k for k in tree.moving if k != joint and tree.model.parents[k] == tree.carrier]
    return any(_is_slider(tree, k) or len(tree.below(k)) > 1 for k in others)


def _is_slider(tree: _LinkTree, joint: int) -> bool:
    """Check whether a joint of the vehicle slides one link, which is no tool, along one of its
    axes.
    """
    if tree.carrier == 0 or tree.model.parents[joint] != tree.carrier or tree.children(joint):
        return False
    moving = tree.model.joints[joint]
    if moving.shortname() not in _SLIDING:
        return False
    links = [tree.name(i) for i in tree.bodies[joint]]
    if tree.words.is_called("tip", *links) or tree.words.is_called("finger", *links):
        return False
    direction = np.array(moving.createData().S).ravel()[:3]
    along = tree.model.jointPlacements[joint].rotation @ direction
    return bool(np.abs(along).max() > _ALONG)


def _carries_sensors_alone(tree: _LinkTree, joint: int) -> bool:
    """Check whether all links that a joint moves are sensors."""
    links = list[int]()
    for k in tree.below(joint):
        links += tree.bodies[k]
    return bool(links) and all(tree.words.is_called("sensor", tree.name(i)) for i in links)


def _whirls(tree: _LinkTree, index: int) -> bool:
    """Check whether a joint of the vehicle turns one balanced link without end, as a propeller
    does.
    """
    if tree.carrier == 0 or tree.model.parents[index] != tree.carrier:
        return False
    if len(tree.below(index)) > 1 or len(tree.bodies[index]) > 1:
        return False
    joint = tree.model.joints[index]
    if joint.nv != 1 or joint.nq != 2:
        return False
    axis = np.array(joint.createData().S).ravel()[3:]
    lever = np.asarray(tree.model.inertias[index].lever)  # [m]
    from_joint = float(np.linalg.norm(lever))  # [m]
    off_axis = float(np.linalg.norm(lever - axis * (axis @ lever)))  # [m]
    return off_axis <= _BALANCED * max(from_joint, _SHORT)


def _tips(tree: _LinkTree, joint: int) -> tuple[str, ...]:
    """Return candidates for the tool at the last joint of a chain."""
    ends = list[str]()
    for i in tree.bodies[joint]:
        if not tree.is_no_tool(i) and tree.is_end(i):
            ends.append(tree.name(i))
    called_tips = [name for name in ends if tree.words.is_called("tip", name)]
    if len(called_tips) == 1:
        return tuple(called_tips)
    return tuple(ends)


def with_roles(
    model: pin.Model, description: RobotDescription, path: object
) -> tuple[pin.Model, RobotDescription]:
    """Return the model with a frame for each role, and the description with the names of its
    frames.

    Raises ``RobotDataError``, which blames the file `path`, for roles of links that are not there.
    """
    free_flyer = description.base == "free_flyer"
    roles = find_roles(model, free_flyer=free_flyer)
    frames = {frame.name for frame in model.frames[1:]}
    faults = []
    base = description.base_link
    if base is not None and base not in frames:
        faults.append(f"{BASE}: {base!r} is not in the URDF; the root is {roles.base}")
    for tool in tools_of(description):
        if tool not in frames:
            candidates = ", ".join(roles.candidates) or "none"
            faults.append(f"{TOOL}: {tool!r} is not in the URDF; candidates: {candidates}")
    if faults:
        raise RobotDataError(str(path), *faults)
    stated = {
        BASE: base,
        TOOL: next(iter(tools_of(description)), None),
        ALTIMETER: description.altimeter,
        DVL: description.dvl,
    }
    if free_flyer and not description.base_link and BASE not in frames:
        stated[BASE] = roles.base
    if not description.tool and not _is_on_arm(model, TOOL, free_flyer=free_flyer):
        stated[TOOL] = roles.only_tool
    model = model.copy()
    for role, name in stated.items():
        if name and name != role and name in frames:
            description = _placed(model, description, role, name)
    return model, description


def _is_on_arm(model: pin.Model, frame: str, *, free_flyer: bool) -> bool:
    """Check whether a frame is there and is moved by a joint: a rack for tools on the hull is
    none.
    """
    if not model.existFrame(frame):
        return False
    carrier = 1 if free_flyer else 0
    return bool(model.frames[model.getFrameId(frame)].parentJoint > carrier)


def tools_of(description: RobotDescription) -> tuple[str, ...]:
    """Return the tools that a description names."""
    tool = description.tool
    if tool is None:
        return ()
    if isinstance(tool, str):
        return (tool,)
    return tool


def _placed(
    model: pin.Model, description: RobotDescription, role: str, name: str
) -> RobotDescription:
    """Add a frame for a role to the model; a link of the URDF that has its name gets another
    one.
    """
    if model.existFrame(role):
        displaced = f"{role}_of_urdf"
        model.frames[model.getFrameId(role)].name = displaced
        description = _with_renamed_link(description, role, displaced)
    add_frame(model, role, name, pin.FrameType.OP_FRAME)
    return description


def _with_renamed_link(
    description: RobotDescription, role: str, displaced: str
) -> RobotDescription:
    """Return the description with all that it says of the URDF's link `role` under another name.

    What hangs on ``base_link`` by default hangs on the vehicle, whichever link that is.
    """
    links = dict[str, LinkDescription]()
    for name, link in description.links.items():
        links[displaced if name == role else name] = link
    renamed: dict[str, Any] = {"links": links}
    if role != BASE:
        for key in ("trim", "thrusters"):
            bodies = []
            for body in getattr(description, key):
                if body.link == role:
                    body = body.model_copy(update={"link": displaced})
                bodies.append(body)
            renamed[key] = tuple(bodies)
    return description.model_copy(update=renamed)


def add_frame(model: pin.Model, name: str, at: str, kind: pin.FrameType) -> None:
    """Add a frame of that name where another one is, fixed to it."""
    parent = model.getFrameId(at)
    carrier = model.frames[parent]
    model.addFrame(pin.Frame(name, carrier.parentJoint, parent, carrier.placement, kind))


def role_notes(model: pin.Model, description: RobotDescription) -> Iterator[tuple[bool, str]]:
    """Yield for each role whether all is well, and one sentence. model: with its frames for
    roles.
    """
    free_flyer = description.base == "free_flyer"
    frames: Sequence[str] = [frame.name for frame in model.frames[1:]]
    roles = find_roles(model, free_flyer=free_flyer)
    if free_flyer:
        yield True, f"base_link: {description.base_link or roles.base}"
    is_added = TOOL in frames and (
        model.frames[model.getFrameId(TOOL)].type == pin.FrameType.OP_FRAME
    )
    is_held = is_added or _is_on_arm(model, TOOL, free_flyer=free_flyer)
    if is_held or (TOOL in frames and not roles.candidates):
        tool = ", ".join(tools_of(description))
        if not tool and is_added:
            tool = roles.only_tool or ""
        yield True, f"tool: {tool or TOOL}"
    elif roles.candidates:
        yield False, f"tool: any of {', '.join(roles.candidates)}; {CHOOSE}"
    else:
        yield True, "tool: none, no chain of joints ends in one; tasks of a tool are left out"
    if free_flyer and description.altimeter:
        yield True, f"altimeter: {description.altimeter}"
    elif free_flyer:
        words = NameWords(model)
        candidates = [name for name in frames if words.is_called("altimeter", name)]
        if candidates:
            hint = f"`altimeter: {candidates[0]}` takes that link"
        else:
            hint = "`altimeter: LINK` names the link of one"
        consequence = "so that tasks of the altitude are left out"
        yield False, f"altimeter: none, {consequence}; {hint}, if it looks along its -z"
    if free_flyer and description.dvl:
        yield True, f"dvl: {description.dvl}"
