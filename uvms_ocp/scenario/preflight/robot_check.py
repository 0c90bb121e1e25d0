"""Check a robot's inertias, trim, thrusters, limits, frames and shapes, which a valid file can
still get wrong.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import yaml

from uvms_ocp.checks import checked
from uvms_ocp.errors import RobotDataError
from uvms_ocp.robot import (
    Robot,
    description,
    link_boxes,
    roles,
    static_balance,
    thruster_matrix,
    thrusters,
)
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.shapes.shape_pairs import links_without_shape
from uvms_ocp.robot.size import size, weight
from uvms_ocp.robot.unknowns import joints_without_inertia, unknowns
from uvms_ocp.robot.up_axis import TURN, signs_of_z_down
from uvms_ocp.scenario.preflight.mesh_sizes import mesh_axis_doubts, mesh_size_doubts, open_meshes

_TRIM_MOMENT = 0.01  # the same of the moment, with the robot's size as the lever
LARGEST_TILT = np.deg2rad(15.0)
"""Tilt [rad] beyond which a vehicle is no longer called level."""
_RANK_TOLERANCE = 1e-6  # relative to the largest singular value
_HULL_SHARE = 0.9  # of the hull, within which floats and ballast for trim are placed
_SMALLEST_REACH = 0.4  # sizes of the robot from the origin to a border of the hull
_SHOWN_MESHES = 4
_TRIANGLE_TOLERANCE = 1e-3  # relative; published inertias are rounded
_LIMITING = (
    "give vehicle_limits and joints in hydrodynamics.yaml, velocity and effort of joints in <limit>"
    " of the URDF"
)
_ALONE = (
    "the file has links alone: a variant belongs over a whole file; identify writes that beside it,"
    " hydrodynamics.yaml"
)


class RobotVerdict(Enum):
    """Weight of a finding."""

    GOOD = "ok"
    """Nothing is wrong."""
    WARNING = "warning"
    """Usable, but look at it."""
    ERROR = "error"
    """Results would be wrong."""


@dataclass(frozen=True, kw_only=True, slots=True)
class RobotFinding:
    """One thing that was checked."""

    subject: str
    """Subject of the check, such as ``trim``."""
    verdict: RobotVerdict
    """Weight of the finding."""
    text: str
    """Finding and cure, in one sentence."""


@dataclass(frozen=True, kw_only=True, slots=True)
class RobotReport:
    """Everything that was checked about one robot."""

    name: str
    findings: tuple[RobotFinding, ...]

    @property
    def usable(self) -> bool:
        """True where no finding would make results wrong."""
        return all(finding.verdict is not RobotVerdict.ERROR for finding in self.findings)

    @property
    def advice(self) -> str:
        """Advice for the next step."""
        errors = self._count(RobotVerdict.ERROR)
        if errors:
            return f"not usable: mend what is called error ({errors}), and check again"
        next_step = (
            "next: `uvms-ocp new-mission FILE.py --robot DIR` writes a mission of it, `uvms-ocp"
            " show` draws it"
        )
        warnings = self._count(RobotVerdict.WARNING)
        if not warnings:
            return f"usable; {next_step}"
        return (
            f"usable, with {warnings} to look at: what is called warning says how to mend it;"
            f" {next_step}"
        )

    def _count(self, verdict: RobotVerdict) -> int:
        return sum(finding.verdict is verdict for finding in self.findings)


@checked
def check_robot_files(
    path: Path | str, hydrodynamics: Path | str | None = None, **loading: Any
) -> RobotReport:
    """Load a URDF, or a folder with ``robot.urdf`` and ``hydrodynamics.yaml``, and check the robot.

    loading: further options of `load_robot`. Files that cannot be loaded give a report with all
    that is wrong with them; raises ``InvalidInput`` for options that do not exist.
    """
    try:
        robot = load_robot(Path(path), hydrodynamics=hydrodynamics, **loading)
    except RobotDataError as error:
        findings = tuple(_error("files", text) for text in error.lines)
        return RobotReport(name=Path(path).name, findings=findings)
    return check_robot(robot)


@checked
def check_robot(robot: Robot) -> RobotReport:
    """Check a loaded robot; its meshes were resolved by loading it."""
    findings = (
        *_inertias(robot),
        _mass_matrix(robot),
        *_limits(robot),
        *_frames(robot),
        *_shapes(robot),
        *geometry_doubts(robot),
        *_water(robot),
        *_unknowns(robot),
    )
    return RobotReport(name=robot.name, findings=findings)


def body_errors(robot: Robot) -> Iterator[RobotFinding]:
    """Yield what no mission may begin with: inertias of no body, and joints that move nothing."""
    for finding in (*_inertias(robot), _mass_matrix(robot)):
        if finding.verdict is RobotVerdict.ERROR:
            yield finding


def geometry_doubts(robot: Robot) -> Iterator[RobotFinding]:
    """Yield what makes a robot another one than its file means, though it flies: meshes of another
    size or with other axes, and z that points down.
    """
    for doubt in (*mesh_size_doubts(robot), *mesh_axis_doubts(robot)):
        yield _warning("shapes", doubt)
    if robot.n_vehicle and robot.hydrodynamics:
        yield from _axes(robot)


def _good(subject: str, text: str) -> RobotFinding:
    return RobotFinding(subject=subject, verdict=RobotVerdict.GOOD, text=text)


def _warning(subject: str, text: str) -> RobotFinding:
    return RobotFinding(subject=subject, verdict=RobotVerdict.WARNING, text=text)


def _error(subject: str, text: str) -> RobotFinding:
    return RobotFinding(subject=subject, verdict=RobotVerdict.ERROR, text=text)


def _inertias(robot: Robot) -> Iterator[RobotFinding]:
    """Check that every moving body has a mass, and principal moments that a body can have."""
    inertias = list(robot.model.inertias)
    moving = range(1, robot.model.njoints)
    massless = [_body(robot, joint) for joint in moving if inertias[joint].mass == 0.0]
    if massless:
        yield _warning(
            "inertias", f"no mass in link {', '.join(massless)}; give links there an <inertial>"
        )
    all_possible = True
    for joint in moving:
        moments = np.linalg.eigvalsh(inertias[joint].inertia)
        if _are_moments_possible(moments):
            continue
        all_possible = False
        moments_text = " ".join(f"{moment:.4g}" for moment in moments)
        yield _error(
            "inertias",
            f"link {_body(robot, joint)}: principal moments {moments_text} kg m2; allowed: none"
            " exceeds the sum of the others; mend <inertia>",
        )
    if all_possible and not massless:
        mass = sum(inertia.mass for inertia in inertias)
        yield _good("inertias", f"{robot.model.njoints - 1} moving bodies, {mass:.6g} kg")


def _are_moments_possible(moments: np.ndarray) -> bool:
    """Check the triangle inequality of principal moments (3,) [kg m2], in rising order."""
    smallest, middle, largest = moments
    bound = (smallest + middle) * (1.0 + _TRIANGLE_TOLERANCE) + 1e-12
    return bool(smallest >= -1e-12 and largest <= bound)


def _body(robot: Robot, joint: int) -> str:
    """Return the names of the links that a joint of the model carries, for a sentence."""
    names = []
    for frame in robot.model.frames:
        if frame.parentJoint == joint and frame.type == pin.FrameType.BODY:
            names.append(frame.name)
    if not names:
        return f"behind joint {robot.model.names[joint]!r}"
    if len(names) == 1:
        return repr(names[0])
    fixed = ", ".join(names[1:4])
    if len(names) > 4:
        fixed += ", ..."
    return f"{names[0]!r} and what is fixed to it ({fixed})"


def _mass_matrix(robot: Robot) -> RobotFinding:
    """Check that the mass matrix is positive definite, with the arm stowed."""
    q = np.array(robot.configuration())
    upper_M = pin.crba(robot.model, robot.model.createData(), q)
    M = np.triu(upper_M) + np.triu(upper_M, 1).T
    inertialess = list(joints_without_inertia(robot.model, M))
    if inertialess:
        return _error(
            "mass matrix",
            f"no inertia about its axis: {'; '.join(inertialess)}; give an <inertial>, or fix the"
            " joint: `lock: {JOINT: 0}` in loading of hydrodynamics.yaml, or --lock JOINT",
        )
    smallest = float(np.linalg.eigvalsh(M).min())
    text = f"smallest eigenvalue of the mass matrix {smallest:.3g}"
    if smallest > 0.0:
        return _good("mass matrix", text)
    return _error("mass matrix", f"{text}; give inertias to the links")


def _limits(robot: Robot) -> Iterator[RobotFinding]:
    limits = {
        "velocity": robot.limits.velocity,
        "acceleration": robot.limits.acceleration,
        "effort": robot.limits.effort,
    }
    unlimited = []
    for name, values in limits.items():
        n_unlimited = np.isinf(values).sum()
        if n_unlimited:
            unlimited.append(f"{n_unlimited} of {len(values)} {name}")
    if unlimited:
        yield _warning("limits", f"unlimited: {', '.join(unlimited)}; {_LIMITING}")
    else:
        yield _good("limits", "velocity, acceleration and effort are limited")


def _frames(robot: Robot) -> Iterator[RobotFinding]:
    for is_good, text in roles.role_notes(robot.model, robot.description):
        if is_good:
            yield _good("frames", text)
        else:
            yield _warning("frames", text)


def _shapes(robot: Robot) -> Iterator[RobotFinding]:
    for kind, shapes in (("visual", robot.visual_model), ("collision", robot.collision_model)):
        if not shapes.ngeoms:
            yield _warning("shapes", f"no {kind} shapes; give <{kind}>")
            continue
        paths = [shape.meshPath for shape in shapes.geometryObjects]
        n_meshes = sum(bool(path and Path(path).is_file()) for path in paths)
        yield _good(
            "shapes", f"{shapes.ngeoms} {kind} shapes, {n_meshes} of them meshes, all found"
        )
    holed = list(open_meshes(robot))
    if holed:
        shown = ", ".join(holed[:_SHOWN_MESHES])
        if len(holed) > _SHOWN_MESHES:
            shown += f" and {len(holed) - _SHOWN_MESHES} more"
        yield _warning(
            "shapes",
            f"mesh {shown}: not closed, a surface that has no inside; what is wholly within it does"
            " not touch it: close it, or give a box, cylinder or sphere for contact",
        )
    unshaped = links_without_shape(robot)
    if unshaped and robot.collision_model.ngeoms:
        text = f"{', '.join(unshaped)}: nothing is told of what they touch; give them <collision>"
        yield _warning("shapes", f"links with a mass, without a collision shape: {text}")


def _water(robot: Robot) -> Iterator[RobotFinding]:
    if not robot.n_vehicle:
        yield _good("vehicle", "fixed base: no trim and no thrusters to check")
        return
    if not robot.hydrodynamics:
        return
    yield _trim(robot)
    yield _thrusters(robot)
    yield from _tilts(robot)


def _unknowns(robot: Robot) -> Iterator[RobotFinding]:
    """Warn of numbers that the robot's file leaves open."""
    untrimmed = static_balance.without_trim(robot)
    for subject, text in unknowns(untrimmed.model, robot.description):
        yield _warning(subject, text)


def _trim(robot: Robot) -> RobotFinding:
    force, moment = static_balance.static_residual(robot, robot.configuration())
    moment_norm = np.linalg.norm(moment)
    text = (
        f"{force:+.3g} N upwards and {moment_norm:.3g} N m with the arm stowed in water of"
        f" {robot.description.water_density:g} kg/m3"
    )
    is_balanced = abs(force) < static_balance.TRIM_TOLERANCE * weight(robot.model)
    is_level = moment_norm < _TRIM_MOMENT * weight(robot.model) * size(robot.model)
    if is_balanced and is_level:
        return _good("trim", text)
    return _warning("trim", f"{text}; {_trim_advice(robot, force, moment)}")


def _tilts(robot: Robot) -> Iterator[RobotFinding]:
    """Warn of a vehicle that lies far from level, at rest or while thrust pushes it."""
    R_WB = static_balance.rotation_at_rest(robot, np.array(robot.configuration()))
    at_rest = float(np.arccos(np.clip(R_WB[2, 2], -1.0, 1.0)))
    if at_rest > LARGEST_TILT:
        text = f"it will rest at {np.rad2deg(at_rest):.0f} deg, as no thruster drives roll or pitch"
        yield _warning("attitude", f"{text}; what `trim` says brings it level")
    tilt = static_balance.tilt_when_driven(robot)
    if tilt is not None and tilt.angle > LARGEST_TILT:
        yield _warning("attitude", tilt_text(tilt))


def _axes(robot: Robot) -> Iterator[RobotFinding]:
    """Warn of a vehicle whose z axis seems to point down."""
    volume = 0.0
    moment = np.zeros(3)
    for link in robot.hydrodynamics:
        frame = robot.model.frames[robot.frame_id(link.frame)]
        if frame.parentJoint == 1:
            volume += link.volume
            moment += link.volume * frame.placement.act(link.centre_of_buoyancy)
    buoyancy = moment / volume if volume > 0.0 else None
    shapes = robot.collision_model if robot.collision_model.ngeoms else robot.visual_model
    signs = list(signs_of_z_down(robot.model, shapes, buoyancy))
    if signs:
        yield _warning("axes", f"does z point down? {'; '.join(signs)}; it flies with z up; {TURN}")


def tilt_text(tilt: static_balance.DrivenTilt) -> str:
    """Describe a tilt under thrust, and what keeps the vehicle nearly level."""
    if tilt.moment < tilt.righting:
        consequence = f"tilts it by {np.rad2deg(tilt.angle):.0f} deg"
    else:
        consequence = "tips it over"
    share = tilt.righting * np.sin(LARGEST_TILT) / tilt.moment
    return (
        f"thrust along {thrusters.AXES[tilt.push]} at the limits of speed and acceleration"
        f" {consequence}, since no thruster drives {thrusters.AXES[tilt.turn]}; with"
        f" {1.0 / max(share, 1e-3):.2g} times as much height of buoyancy above mass, or {share:.2g}"
        f" times the force (vehicle_limits), it is {np.rad2deg(LARGEST_TILT):.0f} deg"
    )


def _trim_advice(robot: Robot, force: float, moment: np.ndarray) -> str:
    """Describe floats and ballast that would trim the robot, and the entry of its file for them."""
    link = next(frame.name for frame in robot.model.frames if frame.type == pin.FrameType.BODY)
    present_trim = robot.description.trim
    parts = []
    bodies = [*present_trim]
    for body, lift in trim_bodies(robot, force, moment):
        kind = body.name.partition("_")[0]
        x, y, _ = body.position
        parts.append(f"a {kind} of {abs(lift):.3g} N at x = {x:.3g} m, y = {y:.3g} m")
        bodies.append(body.model_copy(update={"link": link}))
    entries = []
    for body in bodies:
        entries.append({key: _rounded(value) for key, value in body.model_dump().items()})
    text = yaml.safe_dump(
        entries, default_flow_style=True, width=math.inf, sort_keys=False, allow_unicode=True
    ).strip()
    replacement = " in place of what stands there" if present_trim else ""
    return f"{' and '.join(parts)} of {link} would trim it{replacement}; trim: {text}"


def _rounded(value: Any) -> Any:
    """Return a value of an entry with numbers of five digits."""
    if isinstance(value, tuple):
        return [_rounded(part) for part in value]
    if isinstance(value, float):
        return float(f"{value:.5g}")
    return value


def trim_bodies(
    robot: Robot, force: float, moment: np.ndarray
) -> list[tuple[description.TrimBody, float]]:
    """Return floats and ballast that cancel a force [N] upwards and a moment (3,) [N m] in W, and
    what each lifts [N].

    One where that lies within the hull, else two at its ends in the direction of the moment.
    """
    lift = -force
    lever = np.array([moment[1], -moment[0]])  # [N m] lift times place
    low, high = _hull(robot)
    if abs(lift) >= static_balance.TRIM_TOLERANCE * weight(robot.model):
        place = lever / lift
        if ((low <= place) & (place <= high)).all():
            return [_trim_body(robot, "", place, lift)]
    direction = lever / np.linalg.norm(lever)
    smallest = _SMALLEST_REACH * size(robot.model)
    reach = max(_reach(direction, low, high), smallest)
    opposite_reach = max(_reach(-direction, low, high), smallest)
    first_lift = (float(np.linalg.norm(lever)) + lift * opposite_reach) / (reach + opposite_reach)
    pair = (
        _trim_body(robot, "_1", reach * direction, first_lift),
        _trim_body(robot, "_2", -opposite_reach * direction, lift - first_lift),
    )
    return [(body, body_lift) for body, body_lift in pair if abs(body_lift) > 0.0]


def _trim_body(
    robot: Robot, suffix: str, place: np.ndarray, lift: float
) -> tuple[description.TrimBody, float]:
    """Return a float or ballast of a lift [N] at a place (2,) [m] in B, and the lift."""
    used_names = [body.name for body in robot.description.trim]
    kind = "float" if lift > 0.0 else "ballast"
    free_name = f"{kind}{suffix}"
    number = 0
    while free_name in used_names:
        number += 1
        free_name = f"{kind}{suffix}_{number}"
    x, y = place + 0.0  # no zero with a sign
    return static_balance.trim_body(free_name, float(x), float(y), lift, robot), lift


def _hull(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """Return the lower and the upper corner (2,) [m] of a box around the vehicle's collision shapes
    and thrusters, x and y in B, with the origin between them.
    """
    model = robot.collision_model
    points = [np.zeros(3)]
    for shape in model.geometryObjects:
        if shape.parentJoint == 1:
            corners = link_boxes.box_corners(shape.geometry)
            points += [shape.placement.act(corner) for corner in corners]
    points += [np.array(thruster.position) for thruster in robot.description.thrusters]
    return _HULL_SHARE * np.min(points, axis=0)[:2], _HULL_SHARE * np.max(points, axis=0)[:2]


def _reach(direction: np.ndarray, low: np.ndarray, high: np.ndarray) -> float:
    """Return the distance [m] from the origin of B to the border of the hull in a direction (2,);
    low, high: corners of the hull (2,) [m].
    """
    borders = np.where(direction > 0.0, high, low)
    is_along = np.abs(direction) > _RANK_TOLERANCE
    distances = borders[is_along] / direction[is_along]
    return float(distances.min())


def _thrusters(robot: Robot) -> RobotFinding:
    matrix = thruster_matrix(robot)
    if not matrix.shape[1]:
        text = "none: the vehicle cannot be driven on the dynamic plant"
        has_links_alone = robot.description.model_fields_set <= {"links"}  # as variants do
        return _warning("thrusters", f"{text}; {_ALONE}" if has_links_alone else text)
    U, singular_values, _ = np.linalg.svd(matrix)
    rank = int((singular_values > _RANK_TOLERANCE * singular_values[0]).sum())
    values_text = " ".join(f"{value:.3g}" for value in singular_values)
    text = f"{matrix.shape[1]} thrusters, rank {rank}, singular values {values_text}"
    if rank == 6:
        return _good("thrusters", text)
    lost = []
    for column in U.T[rank:]:
        lost.append(thrusters.AXES[int(np.argmax(np.abs(column)))])
    return _warning("thrusters", f"{text}; under-actuated mainly in {', '.join(lost)}")
