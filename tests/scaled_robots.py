"""A shipped robot at another size: lengths by a factor, all else as Froude's similarity has it, so that it
swims as the robot does, in times that grow with the root of the factor.
"""

from __future__ import annotations

import json
import math
import xml.etree.ElementTree as ET
from collections.abc import Set
from dataclasses import fields, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import yaml
from edited_robots import load_edited

from uvms_ocp.control.force.dynamic import VelocityGains
from uvms_ocp.mission.phase import Abort, Below
from uvms_ocp.record.meta_values import ABORT, DONE
from uvms_ocp.robot.description import TrimBody
from uvms_ocp.robot.loading import robot_folder
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.static_balance import with_trim
from uvms_ocp.scenario.options import mission_of, phase_of, run_options
from uvms_ocp.scenario.scenario import Scenario, pose_at
from uvms_ocp.tasks import (
    HorizontalAttitude,
    JointLimits,
    JointTracking,
    MinimumAltitude,
    VehiclePose,
)
from uvms_ocp.tasks.task import Task

_SKIN_DRAG = 0.4  # [N/(m/s)] of shapes that state none
_LINEAR = np.repeat([1.0, 0.0], 3)
"""(6,) by how many lengths a velocity is larger for the axes of translation."""


def _scale_lengths(element: ET.Element, name: str, factor: float) -> None:
    if name in element.attrib:
        values = [factor * float(word) for word in element.attrib[name].split()]
        element.attrib[name] = " ".join(map(repr, values))


def _scale_joint(joint: ET.Element, length: float) -> None:
    slides = 1 if joint.attrib["type"] == "prismatic" else 0
    dynamics = joint.find("dynamics")
    if dynamics is not None:
        _scale_lengths(dynamics, "damping", length ** (4.5 - 2 * slides))
        _scale_lengths(dynamics, "friction", length ** (4 - slides))
    limit = joint.find("limit")
    if limit is None:
        return
    for name, dimension in (("lower", slides), ("upper", slides), ("velocity", slides - 0.5)):
        _scale_lengths(limit, name, length**dimension)
    _scale_lengths(limit, "effort", length ** (4 - slides))


def _scale_urdf(root: ET.Element, length: float) -> None:
    for origin in root.iter("origin"):
        _scale_lengths(origin, "xyz", length)
    for mass in root.iter("mass"):
        _scale_lengths(mass, "value", length**3)
    for inertia in root.iter("inertia"):
        for name in inertia.attrib:
            _scale_lengths(inertia, name, length**5)
    for kind in ("box", "cylinder", "sphere"):
        for shape in root.iter(kind):
            for name in ("size", "radius", "length"):
                _scale_lengths(shape, name, length)
    for mesh in root.iter("mesh"):
        mesh.attrib.setdefault("scale", "1 1 1")
        _scale_lengths(mesh, "scale", length)
    for joint in root.findall("joint"):
        _scale_joint(joint, length)


def _scaled_matrix(value: Any, length: float, rate: float) -> list[Any]:
    """Scale coefficients of forces [N, N m] by velocities to the power of `rate`, or of masses where
    that is 0.
    """
    coefficients = np.array(value)
    # force * length**turns over (velocity / length**turns)**rate, of which masses are of acceleration
    power = 3.0 - rate / 2.0
    turns = 1.0 - _LINEAR
    by_axis = length**turns
    if coefficients.ndim == 2:
        column = by_axis if rate <= 1.0 else by_axis**rate
        return (coefficients * length**power * np.outer(by_axis, column)).tolist()
    column = by_axis if rate <= 1.0 else by_axis**rate
    return (coefficients * length**power * by_axis * column).tolist()


def _scale_point(entry: dict[str, Any], name: str, length: float) -> None:
    if name in entry:
        entry[name] = [length * value for value in entry[name]]


def _scale_link(link: dict[str, Any], length: float) -> None:
    for kind, shape in link.items():
        if "pose" in shape:
            _scale_point(shape["pose"], "position", length)
        _scale_point(shape, "centre_of_buoyancy", length)
        _scale_point(shape, "size", length)
        for name in ("radius", "length"):
            if name in shape:
                shape[name] *= length
        if "volume" in shape:
            shape["volume"] *= length**3
        if kind != "coefficients":
            shape["skin_drag"] = length**2.5 * shape.get("skin_drag", _SKIN_DRAG)
        for name, rate in (("added_mass", 0.0), ("linear_drag", 1.0), ("quadratic_drag", 2.0)):
            if name in shape:
                shape[name] = _scaled_matrix(shape[name], length, rate)


def _scale_thruster(thruster: dict[str, Any], length: float) -> None:
    _scale_point(thruster, "position", length)
    thruster["time_constant"] *= math.sqrt(length)
    for name in ("minimum", "maximum", "dead_zone"):
        if name in thruster:
            thruster[name] *= length**3
    if "curve" in thruster:
        thruster["curve"] = [[command, length**3 * thrust] for command, thrust in thruster["curve"]]
    if "power" in thruster:
        thruster["power"]["thrust"] *= length**3
        thruster["power"]["watts"] *= length**3.5


def _scale_hydrodynamics(data: dict[str, Any], length: float, sliding: Set[str]) -> None:
    velocity = np.sqrt(length) ** (2.0 * _LINEAR - 1.0)
    acceleration = length ** (_LINEAR - 1.0)
    limits = data.get("vehicle_limits", {})
    for name, factor in (("velocity", velocity), ("acceleration", acceleration)):
        if name in limits:
            limits[name] = (factor * limits[name]).tolist()
    for link in data.get("links", {}).values():
        _scale_link(link, length)
    for body in data.get("trim", []):
        _scale_point(body, "position", length)
        body["mass"] *= length**3
        if "volume" in body:
            body["volume"] *= length**3
    for thruster in data.get("thrusters", []):
        _scale_thruster(thruster, length)
    for name, joint in data.get("joints", {}).items():
        slides = name in sliding
        if "acceleration" in joint and not slides:
            joint["acceleration"] /= length
        if "rotor_inertia" in joint:
            joint["rotor_inertia"] *= length ** (3 if slides else 5)


def scaled_files(folder: Path, length: float) -> Robot:
    """Load the robot of robot.urdf and hydrodynamics.yaml in a folder at `length` times its size."""
    tree = ET.parse(folder / "robot.urdf")
    root = tree.getroot()
    for mesh in root.iter("mesh"):
        beside = folder / mesh.attrib["filename"]
        if beside.is_file():
            mesh.attrib["filename"] = str(beside)
    sliding = {
        joint.attrib["name"]
        for joint in root.findall("joint")
        if joint.attrib["type"] == "prismatic"
    }
    _scale_urdf(root, length)
    text = (folder / "hydrodynamics.yaml").read_text(encoding="utf-8")
    data = json.loads(json.dumps(yaml.safe_load(text)))  # entries that are one are apart now
    _scale_hydrodynamics(data, length, sliding)
    return load_edited(tree, data)


@cache
def scaled_robot(name: str, length: float) -> Robot:
    """Load a shipped robot at `length` times its size."""
    return scaled_files(robot_folder(name), length)


def scaled_reach(name: str, length: float, **situation: Any) -> Scenario:
    """Bring a shipped robot at `length` times its size to a place, see `reach_at`."""
    return reach_at(scaled_robot(name, length), length, **situation)


def reach_at(
    robot: Robot,
    length: float,
    *,
    current: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ballast: float = 0.0,
    dt: float = 0.02,
    duration: float = 60.0,
) -> Scenario:
    """Bring a vehicle to a place `length` times as far as at the robot's own size; current [m/s], dt
    [s], duration [s], tasks, gains and the rules of an abort are scaled too.

    ballast: on the keel of plant and controller, share of the weight.
    """
    if ballast:
        mass = ballast * sum(float(inertia.mass) for inertia in robot.model.inertias)
        place = (0.0, 0.0, -0.1 * length)
        robot = with_trim(robot, [TrimBody(name="lead", position=place, mass=mass, volume=0.0)])
    period = math.sqrt(length)
    goal = pose_at((2.0 * length, 1.0 * length, -6.0 * length), (0.0, 0.0, 0.5))
    tasks = _scaled_tasks(robot, goal, length)
    names = tuple(task.name for task in tasks)
    arrived = (
        Below(quantity="PC.position_error", limit=0.05 * length),
        Below(quantity="PC.orientation_error", limit=0.05),
    )
    phase = phase_of("A", "approach", names, DONE, *arrived, hold=period)
    mission = mission_of(robot, tasks, (phase,), abort=_scaled_abort(names, length))
    options = {
        "robot": robot,
        "dt": dt * period,
        "duration": duration * period,
        "current": period * np.array(current),
    }
    run = run_options(options, seabed=-10.0 * length)
    scenario = run.scenario(
        name="reach",
        mission=replace(mission, ramp=0.2 * period),
        start=run.start(pose_at((0.0, 0.0, -5.0 * length))),
        markers={},
    )
    gains = VelocityGains()
    scaled_gains = {}
    for field in fields(gains):
        gain = getattr(gains, field.name)
        scaled_gains[field.name] = gain if field.name == "lead" else gain / period
    return replace(scenario, gains=VelocityGains(**scaled_gains))


def _scaled_tasks(robot: Robot, goal: pin.SE3, length: float) -> list[Task]:
    speed = math.sqrt(length)
    rate = 1.0 / math.sqrt(length)
    tasks: list[Task] = [
        MinimumAltitude(
            threshold=length, margin=0.5 * length, gain=0.4 * rate, saturation=0.5 * speed
        ),
        HorizontalAttitude(gain=0.2 * rate, saturation=0.5 * rate),
        VehiclePose(
            goal=goal,
            gain_linear=0.2 * rate,
            gain_angular=0.5 * rate,
            saturation_linear=0.5 * speed,
            saturation_angular=0.5 * rate,
        ),
    ]
    if robot.n_joints:
        tasks.insert(0, JointLimits(gain=0.2 * rate, saturation=0.5 * rate))
        tasks.append(
            JointTracking(
                joints=robot.joint_names, goal=robot.home, gain=0.5 * rate, saturation=0.5 * rate
            )
        )
    return tasks


def _scaled_abort(names: tuple[str, ...], length: float) -> Abort:
    period = math.sqrt(length)
    near = Below(quantity="PC.position_error", limit=0.3 * length)
    climb = phase_of("climb", "abort", names, ABORT, near, hold=2.0 * period)
    abort = Abort(phase=climb)
    return replace(
        abort,
        altitude=length * abort.altitude,
        time_limit=period * abort.time_limit,
        stall_after=period * abort.stall_after,
        thrust_after=period * abort.thrust_after,
        runaway_after=period * abort.runaway_after,
        contact_after=period * abort.contact_after,
    )
