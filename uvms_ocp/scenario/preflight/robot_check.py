"""Check a robot's inertias, trim, thrusters, limits, frames and shapes, which a valid file can
still get wrong.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from functools import partial
from itertools import chain, count
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
from uvms_ocp.robot.shapes.collision_model import links_without_shape
from uvms_ocp.robot.unknowns import joints_without_inertia, unknowns

FORCE_TOLERANCE = 0.5  # [N] residual of a trimmed robot with its arm stowed
MOMENT_TOLERANCE = 0.5  # [N m]
_RANK_TOLERANCE = 1e-6  # relative to the largest singular value
_WITHIN = 0.9  # of the hull, for trim
_HAND = 0.1  # [m]
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
    verdict: RobotVerdict
    text: str


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
        counts = {
            verdict: sum(finding.verdict is verdict for finding in self.findings)
            for verdict in RobotVerdict
        }
        errors = counts[RobotVerdict.ERROR]
        if errors:
            return f"not usable: mend what is called error ({errors}), and check again"
        next_step = (
            "next: `uvms-ocp new-mission FILE.py --robot DIR` writes a mission of it, `uvms-ocp"
            " show` draws it"
        )
        warnings = counts[RobotVerdict.WARNING]
        if warnings:
            warning_advice = (
                f", with {warnings} to look at: what is called warning says how to mend it"
            )
        else:
            warning_advice = ""
        return f"usable{warning_advice}; {next_step}"


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
        return RobotReport(
            name=Path(path).name, findings=tuple(_error("files", text) for text in error.lines)
        )
    return check_robot(robot)


@checked
def check_robot(robot: Robot) -> RobotReport:
    """Check a loaded robot; its meshes were resolved by loading it."""
    findings = (
        *_inertias(robot),
        _mass_matrix(robot),
        *_limits(robot),
        *(
            (_good if is_good else _warning)("frames", text)
            for is_good, text in roles.role_notes(robot.model, robot.description)
        ),
        *_shapes(robot),
        *_water(robot),
        *(
            _warning(*gap)
            for gap in unknowns(static_balance.without_trim(robot).model, robot.description)
        ),
    )
    return RobotReport(name=robot.name, findings=findings)


def _finding(verdict: RobotVerdict, subject: str, text: str) -> RobotFinding:
    return RobotFinding(subject=subject, verdict=verdict, text=text)


_good, _warning, _error = (
    partial(_finding, one) for one in (RobotVerdict.GOOD, RobotVerdict.WARNING, RobotVerdict.ERROR)
)


def _inertias(robot: Robot) -> Iterator[RobotFinding]:
    inertias = list(robot.model.inertias)
    moving = range(1, robot.model.njoints)
    massless = [_body(robot, i) for i in moving if inertias[i].mass == 0.0]
    principal = {i: np.linalg.eigvalsh(inertias[i].inertia) for i in moving}
    factor = 1.0 + _TRIANGLE_TOLERANCE
    impossible = [
        i
        for i, (a, b, c) in principal.items()
        if not (a >= -1e-12 and c <= (a + b) * factor + 1e-12)
    ]
    if massless:
        yield _warning(
            "inertias", f"no mass in link {', '.join(massless)}; give links there an <inertial>"
        )
    for i in impossible:
        moments = " ".join(f"{moment:.4g}" for moment in principal[i])
        allowed = "none exceeds the sum of the others; mend <inertia>"
        yield _error(
            "inertias",
            f"link {_body(robot, i)}: principal moments {moments} kg m2; allowed: {allowed}",
        )
    if not massless and not impossible:
        yield _good(
            "inertias",
            f"{robot.model.njoints - 1} moving bodies, {sum(i.mass for i in inertias):.6g} kg",
        )


def _body(robot: Robot, joint: int) -> str:
    """Names of the links that a joint of the model carries."""
    names = [
        frame.name
        for frame in robot.model.frames
        if frame.parentJoint == joint and frame.type == pin.FrameType.BODY
    ]
    if names[1:]:
        fixed_parts = (
            f" and what is fixed to it ({', '.join(names[1:4])}{', ...' if len(names) > 4 else ''})"
        )
    else:
        fixed_parts = ""
    if names:
        return f"{names[0]!r}{fixed_parts}"
    return f"behind joint {robot.model.names[joint]!r}"


def _mass_matrix(robot: Robot) -> RobotFinding:
    M = pin.crba(robot.model, robot.model.createData(), np.array(robot.configuration()))
    M = np.triu(M) + np.triu(M, 1).T
    empty = list(joints_without_inertia(robot.model, M))
    if empty:
        joints = "; ".join(empty)
        advice = (
            "fix the joint: `lock: {JOINT: 0}` in loading of hydrodynamics.yaml, or --lock JOINT"
        )
        return _error(
            "mass matrix", f"no inertia about its axis: {joints}; give an <inertial>, or {advice}"
        )
    smallest = float(np.linalg.eigvalsh(M).min())
    text = f"smallest eigenvalue of the mass matrix {smallest:.3g}"
    if smallest > 0.0:
        return _good("mass matrix", text)
    return _error("mass matrix", f"{text}; give inertias to the links")


def _limits(robot: Robot) -> Iterator[RobotFinding]:
    limits_by_name = {
        "velocity": robot.limits.velocity,
        "acceleration": robot.limits.acceleration,
        "effort": robot.limits.effort,
    }
    unlimited = [
        f"{np.isinf(values).sum()} of {len(values)} {name}"
        for name, values in limits_by_name.items()
        if np.isinf(values).any()
    ]
    if unlimited:
        yield _warning("limits", f"unlimited: {', '.join(unlimited)}; {_LIMITING}")
    else:
        yield _good("limits", "velocity, acceleration and effort are limited")


def _shapes(robot: Robot) -> Iterator[RobotFinding]:
    for kind, shapes in (("visual", robot.visual_model), ("collision", robot.collision_model)):
        meshes = sum(
            bool(shape.meshPath and Path(shape.meshPath).is_file())
            for shape in shapes.geometryObjects
        )
        text = f"{shapes.ngeoms} {kind} shapes, {meshes} of them meshes, all found"
        yield (
            _good("shapes", text)
            if shapes.ngeoms
            else _warning("shapes", f"no {kind} shapes; give <{kind}>")
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


def _trim(robot: Robot) -> RobotFinding:
    force, moment = static_balance.static_residual(robot, robot.configuration())
    text = f"{force:+.3g} N upwards and {np.linalg.norm(moment):.3g} N m with the arm stowed"
    density = f"in water of {robot.description.water_density:g} kg/m3"
    if abs(force) < FORCE_TOLERANCE and np.linalg.norm(moment) < MOMENT_TOLERANCE:
        return _good("trim", f"{text} {density}")
    return _warning("trim", f"{text} {density}; {_trim_advice(robot, force, moment)}")


def _trim_advice(robot: Robot, force: float, moment: np.ndarray) -> str:
    link = next(frame.name for frame in robot.model.frames if frame.type == pin.FrameType.BODY)
    bodies = trim_bodies(robot, force, moment)
    present_trim = robot.description.trim
    parts = [
        f"a {body.name.partition('_')[0]} of {abs(lift):.3g} N at x = {body.position[0]:.3g} m, y ="
        f" {body.position[1]:.3g} m"
        for body, lift in bodies
    ]
    linked_bodies = [body.model_copy(update={"link": link}) for body, _ in bodies]
    entries = [
        {key: _rounded(value) for key, value in body.model_dump().items()}
        for body in (*present_trim, *linked_bodies)
    ]
    text = yaml.safe_dump(
        entries, default_flow_style=True, width=math.inf, sort_keys=False, allow_unicode=True
    ).strip()
    replacement = " in place of what stands there" if present_trim else ""
    return f"{' and '.join(parts)} of {link} would trim it{replacement}; trim: {text}"


def _rounded(value: Any) -> Any:
    """A part of an entry with numbers of five digits."""
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
    lever = np.array([moment[1], -moment[0]])
    low, high = _hull(robot)
    used_names = [body.name for body in robot.description.trim]

    def body(name: str, place: np.ndarray, lift: float) -> tuple[description.TrimBody, float]:
        name = f"{'float' if lift > 0.0 else 'ballast'}{name}"
        candidates = chain([name], (f"{name}_{k}" for k in count(1)))
        name = next(candidate for candidate in candidates if candidate not in used_names)
        x, y = place + 0.0  # no zero with a sign
        return static_balance.trim_body(name, float(x), float(y), lift, robot), lift

    if abs(lift) >= FORCE_TOLERANCE:
        place = lever / lift
    else:
        place = np.full(2, np.inf)
    if ((low <= place) & (place <= high)).all():
        return [body("", place, lift)]
    along = lever / np.linalg.norm(lever)
    reach = [_reach(way, low, high) for way in (along, -along)]
    first_lift = (float(np.linalg.norm(lever)) + lift * reach[1]) / sum(reach)
    pair = (
        body("_1", reach[0] * along, first_lift),
        body("_2", -reach[1] * along, lift - first_lift),
    )
    return [entry for entry in pair if abs(entry[1]) > 0.0]


def _hull(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """Corners (2,) [m] of the vehicle's collision shapes and thrusters, x and y in B, with the
    origin between them.
    """
    model = robot.collision_model
    points = [np.zeros(3)]
    for shape in model.geometryObjects:
        if shape.parentJoint == 1:
            points += [
                shape.placement.act(corner) for corner in link_boxes.box_corners(shape.geometry)
            ]
    points += [np.array(thruster.position) for thruster in robot.description.thrusters]
    return _WITHIN * np.min(points, axis=0)[:2], _WITHIN * np.max(points, axis=0)[:2]


def _reach(along: np.ndarray, low: np.ndarray, high: np.ndarray) -> float:
    """Distance [m] from the origin of B to the border of the hull; a hand's breadth where it has
    none.
    """
    ends = [
        r / a
        for r, a in zip(np.where(along > 0.0, high, low), along, strict=True)
        if abs(a) > _RANK_TOLERANCE
    ]
    return max(min(ends), _HAND)


def _thrusters(robot: Robot) -> RobotFinding:
    matrix = thruster_matrix(robot)
    if not matrix.shape[1]:
        text = "none: the vehicle cannot be driven on the dynamic plant"
        alone = robot.description.model_fields_set <= {"links"}  # as variants have them
        return _warning("thrusters", f"{text}; {_ALONE}" if alone else text)
    U, singular, _ = np.linalg.svd(matrix)
    rank = int((singular > _RANK_TOLERANCE * singular[0]).sum())
    text = (
        f"{matrix.shape[1]} thrusters, rank {rank}, singular values"
        f" {' '.join(f'{s:.3g}' for s in singular)}"
    )
    if rank == 6:
        return _good("thrusters", text)
    lost = [thrusters.AXES[int(np.argmax(np.abs(column)))] for column in U.T[rank:]]
    return _warning("thrusters", f"{text}; under-actuated mainly in {', '.join(lost)}")
