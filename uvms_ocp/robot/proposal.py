"""Propose a robot's hydrodynamics.yaml from its URDF alone: roles, what does not move, water by
shapes, trim, thrusters.

Every number and name that the URDF does not say is marked ``proposed`` in the file, with where it
comes from, and how far it may be off: such a robot swims at once, and says what to measure first.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.errors import InvalidInput, RobotDataError
from uvms_ocp.record.xml_file import read_xml
from uvms_ocp.robot.description import RobotDescription
from uvms_ocp.robot.dialects.robot_xml import ROBOT_SUFFIXES, read_robot_xml
from uvms_ocp.robot.joining import assemble
from uvms_ocp.robot.name_words import FIXED_ROOTS, NameWords
from uvms_ocp.robot.proposal_draft import ProposalDraft, ProposedThruster
from uvms_ocp.robot.proposal_text import (
    assumed_numbers,
    interval_of_buoyancy,
    intervals_of_water,
    proposal_lines,
)
from uvms_ocp.robot.proposed_thrusters import stated_thrusters, thrusters_by_structure
from uvms_ocp.robot.proposed_water import hull_of, proposed_links, trimmed
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.roles import find_roles
from uvms_ocp.robot.simulator_water import simulator_blocks
from uvms_ocp.robot.urdf import UrdfModels, UrdfReading, models_and_notes, read_urdf

_MIN_VEHICLE_SHARE = 0.5  # of the mass: a root with less carries an arm, and is no vehicle


@dataclass(frozen=True, kw_only=True, slots=True)
class RobotProposal:
    """Proposed files of a robot, and the questions that its URDF leaves open."""

    text: str
    """The hydrodynamics.yaml."""
    questions: tuple[str, ...]
    """Questions that the URDF leaves open, one line each, with how to answer."""
    reasons: tuple[str, ...]
    """Roles of the parts of the mechanism with their reasons, one line each."""
    robot: Robot
    """The robot that comes of both."""


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
    root = read_robot_xml(urdf, package_dirs).root
    lock = dict[str, float]()
    for joint in root.findall("joint"):
        if joint.get("type") in ("revolute", "prismatic") and joint.find("limit") is None:
            lock[joint.get("name", "")] = 0.0
    lock.update(settings.get("lock", {}))
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
    followers = [joint.get("name", "") for joint in root.findall("joint[mimic]")]
    leaders = [mimic_element.get("joint", "") for mimic_element in root.findall("joint/mimic")]
    fingers = [name for name in roles.fingers if name not in leaders or mimic != "coupled"]
    still = [*roles.propellers, *roles.sensors, *fingers, *roles.empty, *roles.held]
    still += [*roles.gimbals, *roles.spinners, *roles.ballast, *roles.heads, *roles.branches]
    moving = {*followers, *_joints_that_carry(models.model, tool)}
    still_at = {name: _nearest_to_zero(models.model, name) for name in still if name not in moving}
    reading = replace(reading, mimic=mimic, lock={**still_at, **lock})
    simulator = simulator_blocks(root)
    thrusters = list[ProposedThruster]()
    if floats:
        thrusters = list(stated_thrusters(models.model, simulator))
        if not thrusters:
            thrusters = thrusters_by_structure(models, roles)
    draft = ProposalDraft(
        models=read_urdf(urdf, free_flyer=floats, package_dirs=package_dirs, reading=reading),
        roles=roles,
        reading=reading,
        floats=floats,
        requested_tools=tuple(tool),
        requested_altimeter=altimeter,
        requested_dvl=dvl,
        thrusters=thrusters,
        simulator=simulator,
    )
    return _proposal_of(draft, urdf)


def _read(
    urdf: Path, reading: UrdfReading, package_dirs: Sequence[Path]
) -> tuple[UrdfModels, UrdfReading]:
    """Read a URDF with its meshes, or without them where some that matter are not there."""
    read = partial(models_and_notes, urdf, free_flyer=True, package_dirs=package_dirs)
    try:
        models, _ = read(reading=reading)
        return models, reading
    except RobotDataError as error:
        if not reading.meshes or not all("mesh" in problem for problem in error.problems):
            raise
    reading = replace(reading, meshes=False)
    models, _ = read(reading=reading)
    return models, reading


def _floats(model: pin.Model) -> bool:
    """Check whether a model on a free-flyer is a vehicle, and not an arm that stands on
    something.
    """
    words = NameWords(model)
    if any(words.is_called("propeller", frame.name) for frame in model.frames):
        return True
    root = next(frame.name for frame in model.frames if frame.type == pin.FrameType.BODY)
    _, _, plain_name = root.rpartition("/")
    total_mass = sum(inertia.mass for inertia in model.inertias)
    is_heavy = model.inertias[1].mass > _MIN_VEHICLE_SHARE * total_mass
    return plain_name.lower() not in FIXED_ROOTS and is_heavy


def _joints_that_carry(model: pin.Model, links: Sequence[str]) -> list[str]:
    """Return the names of the joints that move any of these links, which may be missing."""
    names = list[str]()
    for link in links:
        if model.existFrame(link):
            carrier = model.frames[model.getFrameId(link)].parentJoint
            names += [model.names[joint] for joint in model.supports[carrier]]
    return names


def _nearest_to_zero(model: pin.Model, name: str) -> float:
    """Return the position [rad or m] of a joint that is nearest to 0 within its limits."""
    joint = model.joints[model.getJointId(name)]
    if joint.nq != 1:
        return 0.0
    lower = model.lowerPositionLimit[joint.idx_q]
    upper = model.upperPositionLimit[joint.idx_q]
    return float(np.clip(0.0, lower, upper))


def _proposal_of(draft: ProposalDraft, urdf: Path) -> RobotProposal:
    """Write a draft down, with coefficients in water by shapes, and trimmed where it floats."""
    stated = draft.simulator.links
    links, sources = proposed_links(draft.models, stated, floats=draft.floats)
    hull = hull_of(draft.models.model, stated, floats=draft.floats)
    content = draft.content(links)
    if draft.floats and "volume" not in draft.stated_of(hull):
        untrimmed = assemble(draft.models, RobotDescription.model_validate(content), urdf)
        content["links"] = trimmed(untrimmed, links, hull)
    robot = assemble(draft.models, RobotDescription.model_validate(content), urdf)
    lines = proposal_lines(robot.description, draft, sources, hull)
    text = "".join(f"{line}\n" for line in lines)
    reasons = [*draft.reasons()]
    intervals = intervals_of_water(draft.stated_of(hull).keys())
    if hull and intervals:
        reasons.append(f"water of {hull}: {intervals}")
    if hull and "volume" not in draft.stated_of(hull):
        reasons.append(f"{hull} floats level: {interval_of_buoyancy()}")
    assumed = assumed_numbers(robot.description, draft)
    if assumed:
        reasons.append(f"assumed, as the file states none: {assumed}")
    return RobotProposal(
        text=text,
        questions=tuple(draft.questions()),
        reasons=tuple(reasons),
        robot=robot,
    )


def find_urdf(place: Path) -> Path:
    """Return the robot file that is meant by a file or a folder: its only URDF, or else its only
    file of another format. Raises `InvalidInput` for none or several.
    """
    if not place.is_dir():
        return place
    for suffix in ROBOT_SUFFIXES:
        files = sorted(path for path in place.rglob(f"*{suffix}") if _is_robot(path))
        if len(files) == 1:
            return files[0]
        if files:
            raise InvalidInput(
                f"{place}: holds {len(files)} files {suffix}; give one of"
                f" {', '.join(map(str, files[:30]))}"
            )
    raise InvalidInput(f"{place}: holds no robot file; allowed: {', '.join(ROBOT_SUFFIXES)}")


def _is_robot(path: Path) -> bool:
    """Check for a file that is a robot's by its root element, where its name does not say so."""
    if not path.is_file():
        return False
    if path.suffix != ".xml":
        return True
    try:
        return read_xml(path).tag == "mujoco"
    except (OSError, InvalidInput):
        return False
