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

import pinocchio as pin

from uvms_ocp.errors import RobotDataError
from uvms_ocp.robot.description import LinkDescription, RobotDescription
from uvms_ocp.robot.joint_kinds import HEAD_JOINTS, KINDS, kinds_of
from uvms_ocp.robot.link_tree import LinkTree
from uvms_ocp.robot.name_words import NameWords

BASE = "base_link"
TOOL = "tool"
ALTIMETER = "altimeter"
DVL = "dvl"
CHOOSE = "choose by `tool:` in hydrodynamics.yaml, or --tool LINK"
"""Advice where there are several candidates for the tool."""


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
    """Joints without range, as none above or below them has, such as sensors and brackets of some
    exporters, or below which an arm moves.
    """
    gimbals: tuple[str, ...]
    """Joints that carry nothing but propellers."""
    spinners: tuple[str, ...]
    """Joints that spin a tool at the end of an arm, such as a cutter."""
    ballast: tuple[str, ...]
    """Joints that slide a mass along an axis of the vehicle."""
    heads: tuple[str, ...]
    """Joints that pan and tilt sensors fixed to the last of them."""
    branches: tuple[str, ...]
    """Last joints beside the longer part of an arm, such as those of its pistons."""
    short_arms: tuple[str, ...]
    """Joints of arms of the vehicle that may be none: of one joint or two, which end in nothing that
    is called a tool or a finger.
    """
    likely_heads: tuple[str, ...]
    """Joints of arms of three joints that may be a head: all links of it, or all that its last joint
    carries, are called sensors.
    """
    endless_ends: tuple[str, ...]
    """Last joints of arms that turn without end, and carry one link that nothing says to be a hand:
    wrists, or spinning tools.
    """
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
    tree = LinkTree(model, free_flyer)
    kinds = dict(kinds_of(tree))
    names_by_kind: dict[str, tuple[str, ...]] = dict.fromkeys(KINDS, ())
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
    short_arms = tuple(model.names[joint] for joint in _short_arms(tree, arm, ends))
    endless_ends = list[str]()
    for joint in ends:
        is_single = len(tree.bodies[joint]) == 1 and not tree.ends_in_tool(joint)
        if tree.above(joint) and tree.is_endless(joint) and is_single:
            endless_ends.append(model.names[joint])
    return Roles(
        base=_base(tree),
        tools=tuple(tools),
        short_arms=short_arms,
        likely_heads=tuple(model.names[joint] for joint in _likely_heads(tree, ends)),
        endless_ends=tuple(endless_ends),
        **names_by_kind,
    )


def _likely_heads(tree: LinkTree, ends: Sequence[int]) -> Iterator[int]:
    """Yield the joints of arms with one joint more than a head has, which may turn sensors about three
    axes. ends: the last joint of each arm.
    """
    if tree.carrier == 0:
        return
    for end in ends:
        chain = [*reversed(tree.above(end)), end]
        if len(chain) != HEAD_JOINTS + 1 or tree.ends_in_tool(chain[0]):
            continue
        links = [i for joint in chain for i in tree.bodies[joint]]
        are_sensors = all(_is_called_sensor(tree, i) for i in links)
        carried = tree.bodies[end][1:]
        carries_sensors = bool(carried) and all(_is_called_sensor(tree, i) for i in carried)
        if are_sensors or carries_sensors:
            yield from chain


def _is_called_sensor(tree: LinkTree, frame: int) -> bool:
    """Check whether a link is called a sensor, itself or by the prefix of its arm."""
    name = tree.name(frame)
    is_called = tree.words.is_called("sensor", name)
    return is_called or tree.words.is_on_arm_called("sensor", name)


def _short_arms(tree: LinkTree, arm: Sequence[int], ends: Sequence[int]) -> Iterator[int]:
    """Yield the joints of arms that may be a fin, a hatch, a winch or a head.

    arm: joints that are part of an arm; ends: the last of each.
    """
    if tree.carrier == 0:
        return
    for end in ends:
        chain = [*reversed(tree.above(end)), end]
        is_short = len(chain) <= HEAD_JOINTS
        is_fork = any(len(set(arm) & set(tree.children(joint))) > 1 for joint in chain)
        holds_nothing = not tree.children(end) and not tree.ends_in_tool(end)
        if is_short and holds_nothing and not is_fork:
            yield from chain


def _base(tree: LinkTree) -> str:
    """Return the link that stands for the vehicle; empty where nothing is fixed to the root."""
    links = [tree.name(i) for i in tree.bodies[tree.carrier]]
    if BASE in links:
        return BASE
    return next(iter(links), "")


def _tips(tree: LinkTree, joint: int) -> tuple[str, ...]:
    """Return candidates for the tool at the last joint of a chain: the link that it moves where all
    that it carries are called sensors or fingers.
    """
    ends = list[str]()
    for i in tree.bodies[joint]:
        if not tree.is_no_tool(i) and tree.is_end(i):
            ends.append(tree.name(i))
    called_tips = [tree.name(i) for i in tree.bodies[joint] if tree.is_tip(i)]
    called_tips = [name for name in called_tips if name in ends]
    if len(called_tips) == 1:
        return tuple(called_tips)
    if not ends:
        return tuple(tree.name(i) for i in tree.bodies[joint][:1])
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
