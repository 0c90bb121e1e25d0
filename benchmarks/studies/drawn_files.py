"""Drawn robot files: sound ones with two changes each, from the file to runs, a scene, a curve and
C.
"""

from __future__ import annotations

import tempfile
import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import yaml
from recording.rows import column
from typer.testing import CliRunner

from studies.study import Study, seeds_from
from uvms_ocp.campaign.jobs import Row
from uvms_ocp.cli.commands import app
from uvms_ocp.errors import UvmsError, plain_line
from uvms_ocp.export.controller import export_controller
from uvms_ocp.planning.request import PlanRequest, PostureGoal, plan_path
from uvms_ocp.record.record import Record
from uvms_ocp.report.planned_motion import motion_record
from uvms_ocp.report.summary import summarize
from uvms_ocp.robot.loading import robot_called
from uvms_ocp.robot.robot import Robot
from uvms_ocp.scenario.own_code import load_scenario
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.types import Count
from uvms_ocp.viz.scene.show import show

# A sound robot: a hull with propellers and sensors, and none to two arms that end in a tip.

Element = ElementTree.Element
_LIMIT = {"lower": "-1.5", "upper": "1.5", "velocity": "0.7", "effort": "9"}
_FANS = {
    "ahead": ((-0.3, 0.2, 0.0), (-0.3, -0.2, 0.0), (1.0, 0.0, 0.0)),
    "sideways": ((0.25, 0.0, 0.0), (-0.25, 0.0, 0.0), (0.0, 1.0, 0.0)),
    "up": ((0.25, 0.0, 0.1), (-0.25, 0.2, 0.1), (-0.25, -0.2, 0.1), (0.0, 0.0, 1.0)),
}


@dataclass(kw_only=True, slots=True, eq=False)
class Drawn:
    """A robot's files on their way to be written."""

    urdf: Element
    tips: list[Element]
    """The true ends of the arms."""
    water: dict[str, Any] | None = None
    """Content of hydrodynamics.yaml, once there is one."""

    def link(self, name: str, mass: float = 0.0, shape: str = "", at: str = "0.15 0 0") -> Element:
        """A new link; shape: size of a box."""
        link = ElementTree.SubElement(self.urdf, "link", name=name)
        if mass:
            inertial = ElementTree.SubElement(link, "inertial")
            ElementTree.SubElement(inertial, "origin", xyz=at)
            ElementTree.SubElement(inertial, "mass", value=repr(mass))
            moments = dict.fromkeys(("ixx", "iyy", "izz"), repr(0.01 * mass))
            moments |= dict.fromkeys(("ixy", "ixz", "iyz"), "0")
            ElementTree.SubElement(inertial, "inertia", moments)
        if not shape:
            return link
        for kind in ("visual", "collision"):
            part = ElementTree.SubElement(link, kind)
            ElementTree.SubElement(part, "origin", xyz=at)
            ElementTree.SubElement(ElementTree.SubElement(part, "geometry"), "box", size=shape)
        return link

    def joint(
        self, parent: str, child: str, kind: str = "fixed", xyz: str = "0 0 0", axis: str = "0 1 0"
    ) -> Element:
        """A new joint, named after its child; limited where it is revolute or prismatic."""
        joint = ElementTree.SubElement(self.urdf, "joint", name=f"{child}_joint", type=kind)
        ElementTree.SubElement(joint, "parent", link=parent)
        ElementTree.SubElement(joint, "child", link=child)
        ElementTree.SubElement(joint, "origin", xyz=xyz)
        if kind != "fixed":
            ElementTree.SubElement(joint, "axis", xyz=axis)
        if kind in ("revolute", "prismatic"):
            ElementTree.SubElement(joint, "limit", _LIMIT)
        return joint

    def arm(self, name: str, y: float) -> None:
        """A chain of two links on the hull, with a tip."""
        parent = "hull"
        at = f"0.4 {y} -0.1"
        for part, mass in (("upper", 0.5), ("fore", 0.4)):
            self.link(f"{name}_{part}", mass, "0.25 0.05 0.05")
            self.joint(parent, f"{name}_{part}", "revolute", at)
            parent = f"{name}_{part}"
            at = "0.3 0 0"
        self.tips.append(self.link(f"{name}_tip"))
        self.joint(parent, f"{name}_tip", xyz=at)

    def fan(self, name: str, xyz: str, axis: str) -> None:
        """A propeller on the hull."""
        self.link(name, 0.05, at="0 0 0")
        self.joint("hull", name, "continuous", xyz, axis)

    @property
    def joints(self) -> list[Element]:
        """Joints of arms."""
        joints = self.urdf.findall("joint")
        return [joint for joint in joints if joint.get("type") not in ("fixed", "continuous")]

    @property
    def mass(self) -> float:
        """[kg] of all links."""
        masses = self.urdf.iterfind("link/inertial/mass")
        return sum(float(mass.get("value", "0")) for mass in masses)

    @property
    def first(self) -> str:
        """Name of the first link."""
        return self.urdf.findall("link")[0].get("name", "")

    def carrier(self, tip: Element) -> Element:
        """The link that carries a tip."""
        links = {link.get("name"): link for link in self.urdf.findall("link")}
        for joint in self.urdf.findall("joint"):
            parent = next(joint.iter("parent")).get("link")
            child = next(joint.iter("child")).get("link")
            if child == tip.get("name"):
                return links[parent]
        raise LookupError(f"nothing carries {tip.get('name')}")


def sound(arms: int) -> Drawn:
    """A hull with propellers for all axes, an altimeter, a camera and none to two arms."""
    drawn = Drawn(urdf=ElementTree.Element("robot", name="drawn"), tips=[])
    drawn.link("hull", 30.0, "0.7 0.5 0.4", at="0 0 0")
    for name, (*places, axis) in _FANS.items():
        for k, place in enumerate(places):
            drawn.fan(f"thruster_{name}_{k}", " ".join(map(str, place)), " ".join(map(str, axis)))
    for name, xyz in (("altimeter", "0 0 -0.2"), ("camera", "0.35 0 0")):
        drawn.link(name)
        drawn.joint("hull", name, xyz=xyz)
    if arms == 1:
        drawn.arm("left", 0.0)
    if arms == 2:
        drawn.arm("left", 0.15)
        drawn.arm("right", -0.15)
    return drawn


# Changes of the URDF, and of the hydrodynamics.yaml that is proposed for it. What a change needs
# may be gone: then it is none.

Change = Callable[[Drawn, np.random.Generator], object]


def _set(path: str, part: slice = slice(None), **values: str) -> Change:
    """Other attributes of those elements, or of a part of them."""

    def change(drawn: Drawn, rng: np.random.Generator) -> None:
        for element in drawn.urdf.findall(path)[part]:
            element.attrib.update(values)

    return change


def _joints(kind: str, *, single: bool = False) -> Change:
    """Joints of arms, or a drawn one of them, of another type."""

    def change(drawn: Drawn, rng: np.random.Generator) -> None:
        joints = drawn.joints
        if single and joints:
            joints = [joints[int(rng.integers(len(joints)))]]
        for joint in joints:
            joint.set("type", kind)

    return change


def _take_out(tag: str, within: str) -> Change:
    """All elements of a tag."""

    def change(drawn: Drawn, rng: np.random.Generator) -> None:
        for element in drawn.urdf.findall(within):
            element[:] = [part for part in element if part.tag != tag]

    return change


def _without(*words: str) -> Change:
    """No links with these words in their names, and nothing that hangs on them."""
    return lambda drawn, rng: _drop(drawn, lambda name: any(word in name for word in words))


def _drop(drawn: Drawn, leaves: Callable[[str], bool]) -> None:
    """Remove the links whose names leave, their joints and all that hangs on them."""
    names = [link.get("name", "") for link in drawn.urdf.findall("link")]
    waiting = [name for name in names if leaves(name)]
    while waiting:
        name = waiting.pop()
        for link in drawn.urdf.findall("link"):
            if link.get("name") == name:
                drawn.urdf.remove(link)
        for joint in drawn.urdf.findall("joint"):
            ends = [
                end.get("link", "") for end in (*joint.findall("parent"), *joint.findall("child"))
            ]
            if name not in ends:
                continue
            drawn.urdf.remove(joint)
            waiting += [end for end in ends[1:] if ends[0] == name]
    links = drawn.urdf.findall("link")
    drawn.tips = [tip for tip in drawn.tips if tip in links]


def _renamed(new: Callable[[str], str]) -> Change:
    """Other names of links and joints, wherever they stand."""

    def change(drawn: Drawn, rng: np.random.Generator) -> None:
        for element in drawn.urdf.iter():
            if element.tag not in ("link", "joint", "parent", "child"):
                continue
            for key in ("name", "link"):
                if key in element.attrib:
                    element.set(key, new(element.attrib[key]))

    return change


def _numbered(drawn: Drawn, rng: np.random.Generator) -> None:
    """Names without a meaning for all links but thrusters."""
    names = [link.get("name", "") for link in drawn.urdf.findall("link")]
    numbers = {}
    for k, name in enumerate(dict.fromkeys(names)):
        if "thruster" not in name:
            numbers[name] = f"part{k}"
    _renamed(lambda name: numbers.get(name, name))(drawn, rng)


def _no_joints(drawn: Drawn, rng: np.random.Generator) -> None:
    _set("joint", type="fixed")(drawn, rng)
    drawn.tips = []


def _no_tip(drawn: Drawn, rng: np.random.Generator) -> None:
    ends = [drawn.carrier(tip) for tip in drawn.tips]
    tips = [tip.get("name") for tip in drawn.tips]
    _drop(drawn, lambda name: name in tips)
    drawn.tips = ends


def _at_wrist(suffix: str, mass: float = 0.0) -> Change:
    """One more link beside each tip."""

    def change(drawn: Drawn, rng: np.random.Generator) -> None:
        for tip in drawn.tips:
            name = f"{tip.get('name')}_{suffix}"
            drawn.link(name, mass)
            drawn.joint(drawn.carrier(tip).get("name", ""), name, xyz="0.2 0 0.1")

    return change


def _fingers(drawn: Drawn, rng: np.random.Generator) -> None:
    mimics = rng.random() < 0.5
    for tip in drawn.tips:
        names = [f"{tip.get('name')}_finger_{k}" for k in (0, 1)]
        for name, y in zip(names, (0.03, -0.03), strict=True):
            drawn.link(name, 0.02, at="0.02 0 0")
            joint = drawn.joint(drawn.carrier(tip).get("name", ""), name, "prismatic", f"0.3 {y} 0")
        if mimics:
            ElementTree.SubElement(joint, "mimic", joint=f"{names[0]}_joint", multiplier="-1")


def _mimic(drawn: Drawn, rng: np.random.Generator) -> None:
    for first, second in zip(drawn.joints[:1], drawn.joints[1:2], strict=False):
        ElementTree.SubElement(
            second, "mimic", joint=first.get("name", ""), multiplier="0.5", offset="0.1"
        )


def _bracket(drawn: Drawn, rng: np.random.Generator) -> None:
    drawn.link("bracket")
    drawn.joint(drawn.first, "bracket", xyz="0 0.1 0.2")


def _weightless(drawn: Drawn, rng: np.random.Generator) -> None:
    for link in drawn.urdf.findall("link"):
        for inertial in link.findall("inertial"):
            if float(next(inertial.iter("mass")).get("value", "0")) < 1.0:
                link.remove(inertial)


def _fixed_thrusters(drawn: Drawn, rng: np.random.Generator) -> None:
    for joint in drawn.urdf.findall("joint"):
        if "thruster" in joint.get("name", ""):
            joint.set("type", "fixed")


def _fins(drawn: Drawn, rng: np.random.Generator) -> None:
    for name, axis in (("fin_0", "0 1 0"), ("rudder", "0 0 1")):
        drawn.link(name, 0.1, at="-0.05 0 0")
        drawn.joint(drawn.first, name, "revolute", "-0.4 0 0", axis)


def _gone(kind: str) -> Change:
    """Meshes that are nowhere."""

    def change(drawn: Drawn, rng: np.random.Generator) -> None:
        for geometry in drawn.urdf.findall(f"link/{kind}/geometry"):
            geometry[:] = [ElementTree.Element("mesh", filename="package://gone/part.dae")]

    return change


def _no_shapes(drawn: Drawn, rng: np.random.Generator) -> None:
    for link in drawn.urdf.findall("link"):
        link[:] = [part for part in link if part.tag == "inertial"]


def _below(name: str, kind: str) -> Change:
    """Another root, unless there is one."""

    def change(drawn: Drawn, rng: np.random.Generator) -> None:
        first = drawn.first
        if first not in [child.get("link") for child in drawn.urdf.findall("joint/child")]:
            drawn.link(name)
            drawn.joint(name, first, kind)

    return change


def _twins(drawn: Drawn, rng: np.random.Generator) -> None:
    for joint in drawn.urdf.findall("joint"):
        for origin in joint.findall("origin"):
            ElementTree.SubElement(joint, "origin", origin.attrib)


def _name_twice(drawn: Drawn, rng: np.random.Generator) -> None:
    ElementTree.SubElement(drawn.urdf, "link", name=drawn.urdf.findall("link")[-1].get("name", ""))


def _paint(drawn: Drawn, rng: np.random.Generator) -> None:
    for visual in drawn.urdf.findall("link/visual"):
        ElementTree.SubElement(visual, "material", name=str(rng.choice(["", "Gazebo/Teal"])))


_HULL = slice(1)
URDF: dict[str, Change] = {
    "no joints": _no_joints,
    "one link": lambda drawn, rng: _drop(drawn, lambda name: name != "hull"),
    "no tip": _no_tip,
    "two ends": _at_wrist("hook"),
    "camera on the wrist": _at_wrist("camera", 0.05),
    "fingers": _fingers,
    "no altimeter": _without("altimeter"),
    "other names": _numbered,
    "prefixes with /": _renamed(lambda name: f"rov/{name}"),
    "unicode": _renamed(lambda name: f"{name} größe_機"),
    "continuous joints": _joints("continuous"),
    "a prismatic joint": _joints("prismatic", single=True),
    "a planar joint": _joints("planar", single=True),
    "zero range": _set("joint/limit", lower="0", upper="0"),
    "range without 0": _set("joint/limit", lower="0.3"),
    "no limits": _take_out("limit", "joint"),
    "limits of 0": _set("joint/limit", velocity="0", effort="0"),
    "a fixed link without mass": _bracket,
    "moving links without mass": _weightless,
    "a hull without inertia": _set(
        "link/inertial/inertia", _HULL, **dict.fromkeys(("ixx", "iyy", "izz"), "0")
    ),
    "a thin hull": _set("link/inertial/inertia", _HULL, izz="9"),
    "mass below 0": _set("link/inertial/mass", slice(-1, None), value="-1"),
    "a joint that mimics": _mimic,
    "no vertical thrust": _without("thruster_up"),
    "no thrusters": _without("thruster"),
    "fixed thrusters": _fixed_thrusters,
    "fins": _fins,
    "pictures that are gone": _gone("visual"),
    "shapes that are gone": _gone("collision"),
    "no shapes": _no_shapes,
    "a world to float on": _below("world", "floating"),
    "a world to stand on": _below("world", "fixed"),
    "a root without mass": _below("base_footprint", "fixed"),
    "twins": _twins,
    "a name twice": _name_twice,
    "two roots": lambda drawn, rng: drawn.link("lost", 1.0),
    "empty elements": _take_out("axis", "joint"),
    "paint of no colour": _paint,
}


def _left_out(*keys: str) -> Change:
    """Keys of the file."""

    def change(drawn: Drawn, rng: np.random.Generator) -> None:
        for key in keys:
            (drawn.water or {}).pop(key, None)

    return change


def _content(make: Callable[[dict[str, Any]], dict[str, Any]]) -> Change:
    """Other content of the file, where there is one."""

    def change(drawn: Drawn, rng: np.random.Generator) -> None:
        if drawn.water is not None:
            drawn.water |= make(drawn.water)

    return change


def _wet(water: dict[str, Any]) -> list[str]:
    return [name for name, link in water.get("links", {}).items() if link.get("coefficients")]


def _one_wet(water: dict[str, Any]) -> dict[str, Any]:
    return {"links": {name: water["links"][name] for name in _wet(water)[:1]}}


def _dry(water: dict[str, Any]) -> dict[str, Any]:
    return {
        "links": water.get("links", {}) | {name: {"coefficients": {}} for name in _wet(water)[1:]}
    }


def _ballast(water: dict[str, Any]) -> dict[str, Any]:
    link = next(iter(water.get("links", {"hull": None})))
    return {
        "trim": [
            {"name": "lead", "link": link, "position": [0, 0, -0.1], "mass": 2.0, "volume": 0.0}
        ]
    }


def _no_file(drawn: Drawn, rng: np.random.Generator) -> None:
    drawn.water = None


WATER: dict[str, Change] = {
    **{
        f"no {key} in the file": _left_out(key)
        for key in ("tool", "altimeter", "base_link", "loading", "thrusters")
    },
    "no limits in the file": _left_out("vehicle_limits", "joints"),
    "no links in the file": _left_out("links"),
    "no file beside it": _no_file,
    "one wet link": _content(_one_wet),
    "all links dry but one": _content(_dry),
    "a tool that is not there": _content(lambda water: {"tool": "nowhere"}),
    "one thruster": _content(lambda water: {"thrusters": water.get("thrusters", [])[:1]}),
    "ballast": _content(_ballast),
}


_DURATION = 2.0  # [s] of a run
_DT = 0.02  # [s] control period

# The way of one file. Each step may be refused in one line; anything else that is raised, or lost
# on the way, is a fault.


class Fault(Exception):
    """A result that must not be."""


@dataclass(kw_only=True, slots=True)
class _Way:
    """How far a file has come."""

    step: str = ""
    refusals: list[str]
    faults: list[str]

    @contextmanager
    def at(self, step: str) -> Iterator[None]:
        """A step; what it raises is a refusal, or a fault of the package."""
        self.step = step
        try:
            yield
        except UvmsError as error:
            self.refusals.append(f"{step}: {plain_line(str(error))}")
        except Exception as error:
            self.faults.append(f"{step}: {plain_line(f'{type(error).__name__}: {error}', 300)}")


def _command(*words: object) -> str:
    """Run a command, and return its output. Raises `UvmsError` where it refuses, and what it
    raises.
    """
    result = CliRunner().invoke(app, [str(word) for word in words])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    if result.exit_code == 1 or "Traceback" in result.output:
        raise Fault(f"exit code {result.exit_code}, {result.output}")
    if result.exit_code:
        raise UvmsError(plain_line(result.output[max(0, result.output.find("error")) :], 400))
    return result.output


def run_file(case: dict[str, Any]) -> Row:
    """All steps of one drawn file."""
    rng = np.random.default_rng(case["seed"])
    names = [*URDF, *WATER]
    first, second = rng.choice(len(names), size=2, replace=False)
    chosen = [names[first], names[second]]
    arms = int(rng.integers(3))
    drawn = sound(arms)
    way = _Way(refusals=[], faults=[])
    for name in chosen:
        if name in URDF:
            URDF[name](drawn, rng)
    with tempfile.TemporaryDirectory() as place:
        changes = [WATER[name] for name in chosen if name in WATER]
        _follow(way, drawn, Path(place), changes, rng, exports=case["exports"])
    if way.faults:
        outcome = "fault"
        texts = way.faults
    elif way.refusals:
        outcome = "refused"
        # what has no reason first
        texts = sorted(way.refusals, key=lambda text: bool(reason_of(text)))
    else:
        outcome = "through"
        texts = []
    return {
        **case,
        "arms": arms,
        "first": chosen[0],
        "second": chosen[1],
        "outcome": outcome,
        "completed": not way.faults,
        "text": "".join(texts[:1]).replace(place, "DIR"),
    }


def _follow(
    way: _Way,
    drawn: Drawn,
    place: Path,
    changes: Sequence[Change],
    rng: np.random.Generator,
    *,
    exports: bool,
) -> None:
    source = place / "theirs.urdf"
    folder = place / "mine"
    mission = place / "m.py"
    source.write_text(ElementTree.tostring(drawn.urdf, encoding="unicode"), encoding="utf-8")
    with way.at("new-robot"):
        _command("new-robot", "--from", source, folder)
    if not folder.exists():
        return
    file = folder / "hydrodynamics.yaml"
    drawn.water = yaml.safe_load(file.read_text(encoding="utf-8"))
    if changes:
        for change in changes:
            change(drawn, rng)
        file.unlink()
        if drawn.water is not None:
            file.write_text(
                yaml.safe_dump(drawn.water, allow_unicode=True, sort_keys=False), encoding="utf-8"
            )
    robots: list[Robot] = []
    with way.at("load"):
        robots.append(robot_called(str(folder)))
        _check_kept(drawn, robots[0])
    with way.at("check-robot"):
        _command("check-robot", folder)
    with way.at("new-mission"):
        _command("new-mission", mission, "--robot", folder)
    if robots and mission.exists():
        with way.at("check"):
            _command("check", mission)
        for plant in ("kinematic", "dynamic"):
            with way.at(f"run, {plant}"):
                _fly(mission, plant, place)
        with way.at("plan curve"):
            _plan(robots[0], place)
        if exports:
            with way.at("export"):
                export_controller(_scenario(mission, "kinematic", 0.1), place / "c")


def _check_kept(drawn: Drawn, robot: Robot) -> None:
    """Nothing is lost, and no other tool is taken."""
    trim = sum(body.mass for body in robot.description.trim)
    mass = float(pin.computeTotalMass(robot.model)) - trim
    if not np.isclose(mass, drawn.mass, rtol=1e-9):
        raise Fault(f"{mass:g} kg of {drawn.mass:g} kg")
    meant = {tip.get("name", "") for tip in drawn.tips}
    for tool in robot.tools:
        frame = robot.model.frames[robot.frame_id(tool)]
        link = tool if tool in meant else robot.model.frames[frame.parentFrame].name
        is_hook = f"{link}_hook" in meant or str(link).endswith("_hook")
        if link not in meant and not is_hook:
            raise Fault(f"the tool is {link}; meant: {', '.join(sorted(meant)) or 'none'}")


def _scenario(mission: Path, plant: str, duration: float) -> Scenario:
    return load_scenario(str(mission), {"plant": plant, "duration": duration, "dt": _DT}, {})


def _fly(mission: Path, plant: str, place: Path) -> None:
    """Run the mission; its record must survive its file, and be one to summarize and to show."""
    scenario = _scenario(mission, plant, _DURATION)
    record = scenario.run()
    record.save(place / "record.npz")
    loaded = Record.load(place / "record.npz")
    if not _is_same_record(record, loaded):
        raise Fault("the record is another one once saved and loaded")
    if not all(np.isfinite(record[name]).all() for name in ("q", "v")):
        raise Fault("the motion is not finite")
    summarize(loaded)
    show(loaded).write(place / "scene.html")  # which finds the robot by itself


def _is_same_record(record: Record, loaded: Record) -> bool:
    if repr(loaded.meta) != repr(record.meta):
        return False
    same = [np.array_equal(loaded[name], record[name], equal_nan=True) for name in record.series]
    return all(same)


def _plan(robot: Robot, place: Path) -> None:
    """Plan a path to a posture near home, of the vehicle where there is one, else of the joints."""
    if robot.n_vehicle:
        start = robot.configuration(position=(0.0, 0.0, -5.0))
        goal = PostureGoal(position=(1.0, 0.2, -5.2), joints={})
    else:
        start = robot.configuration()
        joints = (robot.home + 0.1).tolist()
        goal = PostureGoal(position=None, joints=dict(zip(robot.joint_names, joints, strict=True)))
    path = plan_path(PlanRequest(robot=robot, start=start, goal=goal))
    if path.plan is not None:
        motion_record(path, path.plan).save(place / "plan.npz")


def drawn_files(*, n: int = 500, seed: Count = 0, exports: bool = False) -> Study:
    """`n` files drawn with the seeds `seed`, `seed` + 1, ...; exports: to C too, which needs a
    compiler.

    Raises `InvalidInput` for no files or a negative seed.
    """
    cases = []
    for drawn_seed in seeds_from(seed, n):
        cases.append({"seed": drawn_seed, "exports": exports, "duration_s": _DURATION, "dt": _DT})
    return Study(
        name="drawn_files",
        title=f"{n} drawn robot files",
        cases=cases,
        run_case=run_file,
        summarize=totals,
    )


def totals(rows: Sequence[Row]) -> list[Row]:
    """How the files with each change fared, and all of them."""
    table = []
    for name in (*URDF, *WATER):
        changed = [row for row in rows if name in (row["first"], row["second"])]
        table.append(_total(name, changed))
    return [*table, _total("all", rows)]


def _total(change: str, rows: Sequence[Row]) -> Row:
    number = Counter(column(rows, "outcome"))
    outcomes = {outcome: number[outcome] for outcome in OUTCOMES}
    return {"change": change, "files": len(rows), **outcomes}


OUTCOMES = ("through", "refused", "fault")
REASONS = {
    "no thrusters": "has no thrusters; give some",
    "mass below 0": "allowed: >= 0 kg",
    "no tree": "allowed: exactly one, joints must form a tree",
    "a name twice": "names must be unique",
    "a tool that is not there": "tool: 'nowhere' is not in the URDF",
    "an axis that Pinocchio does not keep": "the model that Pinocchio builds has",
    "inertia of no body": "principal moments",
    "no inertia": "no inertia about its axis",
    "shapes that are gone": "nothing would be told of what the link touches",
    "nothing that moves": "nothing of it moves",
    "more than thrusters give": "more than the thrusters give",
    "no thruster for what it weighs": "no thruster holds its depth",
    "no thruster for its heading": "the vehicle turns as it likes",
    "less freedom than tasks need": "no freedom left",
    "no limits to plan by": "no limit of velocity or acceleration",
}
"""Why a file may be refused, and words of what is said then."""


def reason_of(text: str) -> str:
    """The one of `REASONS` that a refusal gives; "" for none."""
    for reason, words in REASONS.items():
        if words in text:
            return reason
    return ""
