"""Drawn robots: vehicles and arms of any make on drawn missions of shipped tasks, judged by where
they went and what they say.
"""

from __future__ import annotations

import math
import re
import tempfile
import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import yaml
from recording.rows import column

from studies.drawn_conditions import Conditions, delayed, drawn_conditions, out_of_trim
from studies.drawn_files import Drawn
from studies.fault_truth import passes_rates
from studies.study import Study, seeds_from
from uvms_ocp.campaign.jobs import Row
from uvms_ocp.errors import UvmsError, plain_line
from uvms_ocp.mission.phase import Below, Phase, Transition
from uvms_ocp.record.meta_values import ABORT, DONE
from uvms_ocp.record.record import Record
from uvms_ocp.report.end_of_run import cause_of_end
from uvms_ocp.report.metrics import mean_sizes, swings
from uvms_ocp.robot import Kinematics
from uvms_ocp.robot.description import TrimBody
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.proposal import propose
from uvms_ocp.robot.robot import Robot
from uvms_ocp.scenario.options import abort_phase, activate, mission_of, run_options
from uvms_ocp.scenario.scenario import Scenario, pose_at
from uvms_ocp.sim.nearest_passage import closest_approach
from uvms_ocp.tasks import (
    Alignment,
    HorizontalAttitude,
    JointLimits,
    JointTracking,
    Manipulability,
    MinimumAltitude,
    Task,
    ToolPose,
    ToolPosition,
    VehiclePose,
)
from uvms_ocp.types import Count

# A robot: its file of bodies is drawn, its water, trim and limits are proposed for it, as for
# anybody's, and then set off.

_WATER = 1025.0
_GRAVITY = 9.81
TRIM = 0.02  # [m] by which the centre of buoyancy is off at most
BALLAST = 0.005  # share of the mass by which buoyancy is off at most
# vectored ahead, across and up
_MIDDLE = np.array([[1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
_KINDS = ("revolute", "prismatic", "continuous")
_OFTEN = (0.8, 0.1, 0.1)


@dataclass(frozen=True, kw_only=True, slots=True)
class Body:
    """The sizes of a vehicle."""

    mass: float
    size: tuple[float, float, float]
    """[m]"""
    thrusters: int
    arms: tuple[int, ...]
    """Joints of each."""
    load: float
    """[kg] at the first tool."""


def drawn_body(rng: np.random.Generator) -> Body:
    """Sizes of 10 to 1,500 kg, 4 to 10 thrusters, none to two arms of 1 to 8 joints, a load of 0 to
    5 % of the mass.
    """
    mass = float(np.exp(rng.uniform(np.log(10.0), np.log(1500.0))))
    shape = rng.uniform([1.2, 0.8, 0.5], [2.5, 1.2, 0.9])
    size = shape * (mass / _WATER / float(np.prod(shape))) ** (1 / 3)
    n_arms = int(rng.integers(3))
    arms = tuple(rng.integers(1, 9, size=n_arms).tolist())
    load = 0.0
    if arms and rng.random() < 0.5:
        load = float(rng.uniform(0.0, 0.05) * mass)
    x, y, z = size.tolist()
    return Body(mass=mass, size=(x, y, z), thrusters=int(rng.integers(4, 11)), arms=arms, load=load)


def write_robot(body: Body, rng: np.random.Generator, folder: Path) -> Robot:
    """The robot of files that are written to a folder. Raises `UvmsError` where the package refuses
    them.
    """
    drawn = Drawn(urdf=ElementTree.Element("robot", name="drawn"), tips=[])
    length, width, height = body.size
    meshes = folder if rng.random() < 0.3 else None
    _solid(drawn, "hull", body.mass, body.size, (0.0, 0.0, 0.0), meshes)
    for k in range(body.thrusters):
        at = rng.uniform(-0.5, 0.5, 3) * body.size
        drawn.fan(f"thruster_{k}", _text(at), _text(_direction(k, rng)))
    drawn.link("altimeter")
    drawn.joint("hull", "altimeter", xyz=f"0 0 {-height / 2}")
    for k, joints in enumerate(body.arms):
        side = (0.3 - 0.6 * k) * width if len(body.arms) == 2 else 0.0
        _arm(drawn, body, f"arm{k}", joints, (0.5 * length, side, -0.4 * height), rng)
    urdf = folder / "robot.urdf"
    urdf.write_text(ElementTree.tostring(drawn.urdf, encoding="unicode"), encoding="utf-8")
    water = yaml.safe_load(propose(urdf).text)
    off = [*rng.uniform(-TRIM, TRIM, 2), 0.0]
    wet = water["links"]["hull"]["coefficients"]
    wet["centre_of_buoyancy"] = (np.array(wet["centre_of_buoyancy"]) + off).tolist()
    wet["volume"] *= float(1.0 + rng.uniform(-BALLAST, BALLAST))
    stronger = float(rng.uniform(0.5, 2.0))
    for thruster in water["thrusters"]:
        thruster["maximum"] *= stronger
        thruster["minimum"] *= stronger
    file = folder / "hydrodynamics.yaml"
    file.write_text(yaml.safe_dump(water, sort_keys=False), encoding="utf-8")
    return load_robot(urdf=urdf, hydrodynamics=file)


def _direction(k: int, rng: np.random.Generator) -> np.ndarray:
    """Draw the direction of a thruster: near one of the usual ones, or any."""
    direction = _MIDDLE[k % 3] * [1.0, rng.choice([-1.0, 1.0]), 1.0] + 0.1 * rng.normal(size=3)
    if rng.random() >= 0.7:
        direction = rng.normal(size=3)
    return np.asarray(direction / np.linalg.norm(direction))


def _text(values: Sequence[float] | np.ndarray) -> str:
    return " ".join(f"{value:.6g}" for value in values)


def _solid(
    drawn: Drawn,
    name: str,
    mass: float,
    size: Sequence[float],
    at: Sequence[float],
    meshes: Path | None = None,
) -> None:
    """A link that is a box, or a mesh of one, with the inertia of it."""
    link = drawn.link(name, mass, _text(size), _text(at))
    squares = np.square(size)
    moments = mass / 12.0 * (squares.sum() - squares)
    for inertia in link.iter("inertia"):
        for name, moment in zip(("ixx", "iyy", "izz"), moments.tolist(), strict=True):
            inertia.set(name, repr(moment))
    if meshes is None:
        return
    _write_box(meshes / f"{name}.stl", np.array(size))
    for geometry in link.iter("geometry"):
        geometry[:] = [ElementTree.Element("mesh", filename=f"{name}.stl")]


def _write_box(file: Path, size: np.ndarray) -> None:
    """Write a box as a mesh of twelve triangles, in text."""
    lines = ["solid box"]
    for axis in range(3):
        for side in (-0.5, 0.5):
            # Around the normal, which points outwards.
            first = (axis + 1) % 3
            second = (axis + 2) % 3
            if side < 0:
                first, second = second, first
            corners = []
            for a, b in ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)):
                corner = np.zeros(3)
                corner[[axis, first, second]] = side, a, b
                corners.append(f"vertex {_text(corner * size)}")
            for i, j, k in ((0, 1, 2), (0, 2, 3)):
                lines.append("facet normal 0 0 0 outer loop")
                lines += [corners[i], corners[j], corners[k]]
                lines.append("endloop endfacet")
    file.write_text("\n".join([*lines, "endsolid box"]), encoding="utf-8")


def _arm(
    drawn: Drawn,
    body: Body,
    name: str,
    joints: int,
    at: tuple[float, float, float],
    rng: np.random.Generator,
) -> None:
    """A chain with a tip, in a share of them between two fingers, of motors that bear what it
    weighs and most of the loads.
    """
    reach = body.size[0] * float(rng.uniform(0.4, 0.9))
    mass = body.mass * float(rng.uniform(0.02, 0.12))
    weight = _GRAVITY * (0.5 * mass + body.load)
    parent = "hull"
    xyz = _text(at)
    strength = float(rng.uniform(1.0, 3.0))
    for k in range(joints):
        link = f"{name}_link{k}"
        length = reach / joints
        _solid(
            drawn, link, mass / joints, (length, 0.12 * reach, 0.12 * reach), (length / 2, 0.0, 0.0)
        )
        kind = str(rng.choice(_KINDS, p=_OFTEN))
        joint = drawn.joint(
            parent, link, kind, xyz, ("0 1 0", "0 0 1", "1 0 0")[int(rng.integers(3))]
        )
        if kind != "continuous":
            joint.remove(next(joint.iter("limit")))
        limit = _joint_limit(kind, length, strength * weight, reach - k * length, rng)
        ElementTree.SubElement(joint, "limit", limit)
        parent = link
        xyz = f"{length:.6g} 0 0"
    drawn.tips.append(drawn.link(f"{name}_tip"))
    drawn.joint(parent, f"{name}_tip", xyz=xyz)
    if rng.random() < 0.3:
        names = [f"{name}_finger_{k}" for k in (0, 1)]
        for finger, y in zip(names, (0.05, -0.05), strict=True):
            _solid(
                drawn,
                finger,
                0.01 * mass,
                (0.1 * reach, 0.02 * reach, 0.02 * reach),
                (0.05 * reach, 0.0, 0.0),
            )
            follower = drawn.joint(
                parent, finger, "prismatic", f"{xyz.split()[0]} {y * reach:.4g} 0", "0 1 0"
            )
        ElementTree.SubElement(follower, "mimic", joint=f"{names[0]}_joint", multiplier="-1")


def _joint_limit(
    kind: str, length: float, force: float, remaining: float, rng: np.random.Generator
) -> dict[str, str]:
    """Draw the limits of a joint.

    length [m]: of its link. force [N] that its motor bears; remaining [m]: reach beyond it.
    """
    slides = kind == "prismatic"
    if slides:
        limit = {"effort": f"{force * 1.0:.4g}", "velocity": "0.1"}
    else:
        limit = {"effort": f"{force * remaining:.4g}", "velocity": "0.6"}
    if kind == "continuous":
        return limit
    if slides:
        stroke = rng.uniform(0.1, 0.5) * length
        rng.uniform(0.5, 2.0)  # drawn for every kind of joint, so that seeds keep their robots
        return limit | {"lower": f"{0.0:.4g}", "upper": f"{stroke:.4g}"}
    low = rng.uniform(0.5, 2.0)
    high = rng.uniform(0.5, 2.0)
    return limit | {"lower": f"{-low:.4g}", "upper": f"{high:.4g}"}


# A mission: to a way point, then each tool to a target that it can reach from there, with some of
# the other tasks.

# [m]
_START = (0.0, 0.0, -10.0)
_FLOOR = -25.0
DURATION = 150.0  # [s] of a mission at most
CURRENT = 0.3  # [m/s] at most


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class DrawnMission:
    """What a robot is to do, and in which water."""

    start: pin.SE3
    """Pose of the vehicle in W."""
    place: tuple[float, float, float]
    """[m] of the way point in W."""
    tasks: tuple[Task, ...]
    options: dict[str, Any]
    """Options of `run_options` beside the robot and times."""


def drawn_scenario(
    robot: Robot, body: Body, rng: np.random.Generator, conditions: Conditions
) -> Scenario:
    """Draw a mission with or without current, noise and the load. Raises `UvmsError` where the
    package refuses it.
    """
    return scenario_of(robot, drawn_mission(robot, body, rng), conditions)


def drawn_mission(robot: Robot, body: Body, rng: np.random.Generator) -> DrawnMission:
    """Draw a mission."""
    heading = float(rng.uniform(-np.pi, np.pi))
    distance = float(rng.uniform(1.0, 5.0))
    along = np.array([math.cos(heading), math.sin(heading), float(rng.uniform(-0.5, 0.5))])
    place = np.array(_START) + distance * along
    yaw = float(rng.uniform(-1.5, 1.5))
    start_yaw = float(rng.uniform(-np.pi, np.pi))
    speed = rng.uniform(0.0, CURRENT)
    drift = rng.uniform(-np.pi, np.pi)
    payload = None
    if body.load:
        payload = TrimBody(
            name="load", link=robot.tools[0], position=(0.0, 0.0, 0.0), mass=body.load, volume=0.0
        )
    noise = bool(rng.random() < 0.3)
    current = None
    if rng.random() < 0.5:
        current = (speed * math.cos(drift), speed * math.sin(drift), 0.0)
    options = {
        "payload": payload,
        "noise": noise,
        "current": current,
        "seed": int(rng.integers(1000)),
    }
    x, y, z = place.tolist()
    way_point = pose_at((x, y, z), (0.0, 0.0, start_yaw + yaw))
    return DrawnMission(
        start=pose_at(_START, (0.0, 0.0, start_yaw)),
        place=(x, y, z),
        tasks=tuple(_tasks(robot, way_point, rng)),
        options=options,
    )


def scenario_of(robot: Robot, mission: DrawnMission, conditions: Conditions) -> Scenario:
    """Compose the scenario of a mission. Raises `UvmsError` where the package refuses it."""
    times = {"dt": conditions.dt, "duration": DURATION}
    run = run_options({"robot": robot, **mission.options, **times}, seabed=_FLOOR)
    phases = tuple(_phases(mission.tasks))
    scenario = run.scenario(
        name="drawn",
        mission=mission_of(robot, mission.tasks, phases, abort=_abort(mission.tasks)),
        start=run.start(mission.start),
        markers={"way point": mission.place},
    )
    return delayed(scenario, conditions)


def _tasks(robot: Robot, way_point: pin.SE3, rng: np.random.Generator) -> Iterator[Task]:
    q = robot.configuration(
        position=way_point.translation, quaternion=pin.Quaternion(way_point.rotation).coeffs()
    )
    if robot.n_joints:
        yield JointLimits()
    yield MinimumAltitude()
    if rng.random() < 0.7:
        yield HorizontalAttitude()
    if rng.random() < 0.4:
        ahead = way_point.act(np.array([rng.uniform(2.0, 6.0), *rng.uniform(-0.5, 0.5, 2)]))
        yield Alignment(goal=np.asarray(ahead))
    if robot.n_joints and rng.random() < 0.3:
        yield Manipulability()
    reached = _some_posture(robot, q, rng)
    whole = bool(rng.random() < 0.2)
    for k, tool in enumerate(robot.tools):
        target = Kinematics(robot, reached).pose(tool)
        name = f"T{k + 1}"
        if whole:
            yield ToolPose(name=name, frame=tool, goal=target)
        else:
            yield ToolPosition(name=name, frame=tool, goal=target)
    yield VehiclePose(goal=way_point)
    if robot.n_joints:
        yield JointTracking(joints=robot.joint_names, goal=robot.home)


def _some_posture(robot: Robot, q: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(n_q,) with joints half way from home to anywhere, all within their limits."""
    step = np.zeros(robot.n_v)
    low = np.clip(robot.limits.position_lower, -1.5, 1.5)
    high = np.clip(robot.limits.position_upper, -1.5, 1.5)
    home = robot.home
    step[robot.joint_v] = 0.5 * (rng.uniform(np.minimum(low, high), high) - home)
    return np.asarray(pin.integrate(robot.model, q, step))


def _phases(tasks: Sequence[Task]) -> Iterator[Phase]:
    names = [task.name for task in tasks]
    tools = [task.name for task in tasks if isinstance(task, (ToolPose, ToolPosition))]
    arrived = [Below(quantity="PC.position_error", limit=0.2)]
    if "AT" in names:
        arrived.append(Below(quantity="AT.misalignment", limit=0.15))
    active_at_first = [name for name in names if name not in tools]
    onward = Transition(to="B" if tools else DONE, when=tuple(arrived), hold=1.0)
    yield Phase(name="A", activations=activate(*active_at_first), transitions=(onward,))
    if tools:
        reached = [Below(quantity=f"{name}.position_error", limit=0.05) for name in tools]
        end = Transition(to=DONE, when=tuple(reached), hold=1.0)
        yield Phase(name="B", activations=activate(*names), transitions=(end,))


def _abort(tasks: Sequence[Task]) -> Any:
    names = [task.name for task in tasks if task.name in ("JL", "MAC", "HA", "MP")]
    return abort_phase(*names)


# What became of it.

REASONS = {
    "more than thrusters give": "more than the thrusters give",
    "a goal where no axis leads": "waits for a goal",
    "a current where no axis leads": "the current carries the vehicle",
    "no thruster for what it weighs": "no thruster holds its depth",
    "free motions that are no axis": "they are no two axes",
    "no thruster for its heading": "nothing rights it",
    "tilted at rest": "the vehicle will rest at",
    "out of reach": "reach",
    "less freedom than tasks need": "no freedom left",
}
"""Why a mission may be refused, and words of what is said then."""

FARTHER = 1.0  # [m] by which a vehicle that flees is farther away than at the start
_EVERY = 10  # ticks between two configurations whose clearance is measured
SEEN = 0.15  # [rad] half a swing of roll or pitch that nobody may overlook
OUTCOMES = ("refused", "accepted", "completed", "gave up", "time over", "fault")
_BLAME = re.compile(r"\b([a-z]+(?:_[a-z]+)*) lost: (?!silent|no echo)")
REFUSED = "refused without need"
WRONGS = ("flees", "touches", "swings unseen", "blames a sound sensor", "whips", REFUSED)
SHORT = 0.05  # share of its ticks in which thrusters of a mission that is flown with margin are at limits


def run_robot(case: dict[str, Any]) -> Row:
    """One robot on its mission."""
    rng = np.random.default_rng(case["seed"])
    body = drawn_body(rng)
    conditions = drawn_conditions(case["seed"])
    row: Row = {
        **case,
        "dt_s": conditions.dt,
        "position_delay_s": conditions.position_delay,
        "gyro_delay_s": conditions.gyro_delay,
        "mass_kg": round(body.mass, 1),
        "thrusters": body.thrusters,
        "joints": "+".join(map(str, body.arms)),
        "load_kg": round(body.load, 2),
    }
    blank: dict[str, Any] = {
        "trim_share": 0.0,
        "undriven": "",
        "current_m_s": 0.0,
        "noise": False,
        "t": 0.0,
        "clearance_m": None,
        "farther_m": None,
        "swings": "",
        "blamed": "",
        "flown": "",
        "wrong": "",
    }
    with tempfile.TemporaryDirectory() as place:
        try:
            floating = write_robot(body, rng, Path(place))
            robot = out_of_trim(floating, conditions, Path(place))
            if robot is not floating:
                blank["trim_share"] = round(conditions.trim, 2)
            scenario = drawn_scenario(robot, body, rng, conditions)
            blank |= _circumstances(scenario)
            preflight = scenario.check()
            if preflight.accepted and case["flies"]:
                return {**row, **blank, **judge(scenario, scenario.run())}
            if preflight.accepted:
                outcome = "accepted"
                text = ""
            else:
                outcome = "refused"
                text = preflight.errors[0].text
                if case["flies"]:
                    blank |= judge_refusal(scenario)
        except UvmsError as error:
            outcome = "refused"
            text = str(error).replace(place, "DIR")
        except Exception as error:
            outcome = "fault"
            text = f"{type(error).__name__}: {error}".replace(place, "DIR")
    return {
        **row,
        **blank,
        "outcome": outcome,
        "text": _short(text),
        "completed": outcome != "fault" and not blank["wrong"],
    }


def _short(text: str) -> str:
    return plain_line(text, 300)


def _circumstances(scenario: Scenario) -> dict[str, Any]:
    first = scenario.mission.hierarchy.tasks[0]
    attitude = scenario.specs.attitude
    undriven = "".join(map(str, getattr(first, "axes", ())))
    velocity = scenario.environment.current.velocity(np.zeros((1, 3)), 0.0)
    return {
        "undriven": undriven,
        "current_m_s": round(float(np.linalg.norm(velocity)), 2),
        "noise": attitude is not None and not attitude.exact,
        "tasks": " ".join(scenario.mission.hierarchy.names),
    }


def judge(scenario: Scenario, record: Record) -> dict[str, Any]:
    """Outcome, what was wrong about the run, and what it says of itself."""
    cause = cause_of_end(record)
    if cause["kind"] == "completed":
        outcome = "completed"
    elif cause["kind"] in ("aborted", "given up"):
        outcome = "gave up"
    else:
        outcome = "time over"
    farther = farther_by(scenario, record)
    reported_swings = swings(record)
    configurations = record["q"][::_EVERY]
    clearance = closest_approach(scenario.robot, scenario.environment, configurations).distance
    reported = {swing.what for swing in reported_swings}
    reported |= {alarm.text.partition(" ")[0] for alarm in record.run_meta.alarms}
    wrong = []
    if farther > FARTHER:
        wrong.append("flees")
    if clearance <= 0.0:
        wrong.append("touches")
    if any(angle not in reported for angle in tilting(record)):
        wrong.append("swings unseen")
    texts = [alarm.text for alarm in record.run_meta.alarms]
    blamed = blamed_channels([*texts, cause["text"]])
    if blamed:
        wrong.append("blames a sound sensor")
    if passes_rates(scenario.robot, record, onsets=(float(record["t"][0]),)):
        wrong.append("whips")
    return {
        "outcome": outcome,
        "t": round(float(record["t"][-1]), 1),
        "clearance_m": round(clearance, 2),
        "farther_m": round(farther, 2),
        "swings": "; ".join(map(str, reported_swings)),
        "blamed": " ".join(blamed),
        "text": _short(cause["text"]),
        "wrong": "; ".join(wrong),
        "completed": not wrong,
    }


def judge_refusal(scenario: Scenario) -> dict[str, Any]:
    """Fly a mission that pre-flight refuses all the same: it is refused without need where it completes
    with thrust to spare, and with nothing wrong.
    """
    try:
        record = scenario.run()
    except UvmsError as error:
        return {"flown": _short(str(error)), "wrong": ""}
    short = float(np.mean(mean_sizes(record, "saturated", slice(None))))
    judged = judge(scenario, record)
    completes = judged["outcome"] == "completed" and not judged["wrong"]
    flown = ", ".join(filter(None, (judged["outcome"], judged["wrong"])))
    return {
        "t": judged["t"],
        "flown": f"{flown}, thrusters at their limits {short:.0%}",
        "wrong": REFUSED if completes and short < SHORT else "",
    }


def blamed_channels(texts: Iterable[str]) -> list[str]:
    """Name the sensors that alarms and other texts call lost, but for those that were truly silent or
    heard no echo.
    """
    blamed = set[str]()
    for text in texts:
        blamed.update(_BLAME.findall(text))
    return sorted(blamed)


def farther_by(scenario: Scenario, record: Record) -> float:
    """Compute by how much [m] the vehicle was farther from its way point than at the start, while
    the mission had not given up.
    """
    abort_phases = (ABORT, record.run_meta.abort_phase)
    given_up_at = np.inf
    for event in reversed(record.run_meta.events):
        if event.target in abort_phases:
            given_up_at = event.t
    positions = record["q"][record["t"] <= given_up_at, :3]
    distances = np.linalg.norm(positions - scenario.markers["way point"], axis=1)
    return float(distances.max() - distances[0])


def tilting(record: Record) -> Iterator[str]:
    """Roll and pitch that oscillate at the end of a run, by the reversals of their rate alone."""
    n = round(20.0 / record.run_meta.dt)
    R = np.array([pin.Quaternion(q).matrix() for q in record["q"][-n:, 3:7]])
    tilts = {
        "roll": np.arctan2(R[:, 2, 1], R[:, 2, 2]),
        "pitch": -np.arcsin(np.clip(R[:, 2, 0], -1, 1)),
    }
    for angle, tilt in tilts.items():
        turns = np.flatnonzero(np.diff(np.sign(np.diff(tilt))) != 0)
        halves = np.abs(np.diff(tilt[turns])) / 2
        if np.count_nonzero(halves > SEEN) >= 4:
            yield angle


def drawn_robots(*, n: int = 2000, seed: Count = 0, flies: bool = True) -> Study:
    """`n` robots drawn with the seeds `seed`, `seed` + 1, ...; flies: beyond pre-flight.

    Raises `InvalidInput` for no robots or a negative seed.
    """
    cases = [{"seed": drawn, "flies": flies} for drawn in seeds_from(seed, n)]
    return Study(
        name="drawn_robots",
        title=f"{n} drawn robots",
        cases=cases,
        run_case=run_robot,
        summarize=totals,
    )


def reason_of(text: str) -> str:
    """The one of `REASONS` that a refusal gives; "" for none."""
    for reason, words in REASONS.items():
        if words in text:
            return reason
    return ""


def totals(rows: Sequence[Row]) -> list[Row]:
    """How the robots fared, by their arms."""
    table = []
    for n_arms, name in enumerate(("none", "one", "two")):
        table.append(_total(name, [row for row in rows if _n_arms(row) == n_arms]))
    return [*table, _total("all", rows)]


def _n_arms(row: Row) -> int:
    """Count the arms of a robot whose joints are stated as their numbers by arm, such as 3+5."""
    if not row["joints"]:
        return 0
    return len(str(row["joints"]).split("+"))


def _total(arms: str, rows: Sequence[Row]) -> Row:
    outcomes = Counter(column(rows, "outcome"))
    total: dict[str, Any] = {"arms": arms, "robots": len(rows)}
    for outcome in OUTCOMES:
        if outcome != "accepted":
            total[outcome] = outcomes[outcome]
    for wrong in WRONGS:
        total[wrong] = sum(wrong in row["wrong"] for row in rows)
    return total
