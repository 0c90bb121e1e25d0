"""Robots as small as they come: no joints, one joint, one link in water, one thruster, none; joints
without end or range.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from uvms_ocp.mission.phase import Below, Phase, Transition
from uvms_ocp.record.meta_values import DONE
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.scenario.options import activate, mission_of
from uvms_ocp.scenario.scenario import Scenario, pose_at
from uvms_ocp.sim.environment import Environment
from uvms_ocp.sim.seafloor import FlatSeafloor
from uvms_ocp.tasks.joints import JointLimits, JointTracking, Manipulability
from uvms_ocp.tasks.pose import ToolPosition, VehiclePose

_HULL = """<link name="base_link">
  <inertial><mass value="24"/><inertia ixx="0.5" ixy="0" ixz="0" iyy="0.7" iyz="0" izz="0.8"/></inertial>
  <collision><geometry><box size="0.6 0.4 0.3"/></geometry></collision></link>"""
_BOOM = """<link name="{name}"><inertial><origin xyz="0.1 0 0"/><mass value="0.6"/>
  <inertia ixx="0.0004" ixy="0" ixz="0" iyy="0.004" iyz="0" izz="0.004"/></inertial></link>
<joint name="{joint}" type="{kind}"><parent link="{parent}"/><child link="{name}"/><origin xyz="0.3 0 0"/>
  <axis xyz="{axis}"/>{limit}</joint>"""
_TOOL = """<link name="tool"/>
<joint name="mount" type="fixed"><parent link="{parent}"/><child link="tool"/>
  <origin xyz="0.3 0 0"/></joint>"""
LIMIT = '<limit lower="-1.2" upper="1.2" effort="8" velocity="0.7"/>'
_ENDLESS = '<limit effort="8" velocity="0.7"/>'
_WET = """coefficients: {added_mass: [9, 14, 18, 0.3, 0.4, 0.5], linear_drag: [12, 15, 20, 1, 1, 1],
    quadratic_drag: [30, 45, 60, 2, 2, 2], volume: 0.024, centre_of_buoyancy: [0.011, 0, 0.03]}"""
_IN_TRIM = _WET.replace("volume: 0.024", f"volume: {24.0 / 998.0}").replace(
    "[0.011, 0, 0.03]", "[0, 0, 0.03]"
)
_AHEAD = ((-0.3, 0.1, 0.0, 1, 0, 0), (-0.3, -0.1, 0.0, 1, 0, 0))
_ALL = (
    (0.2, 0.2, 0.0, 1, -1, 0),
    (0.2, -0.2, 0.0, 1, 1, 0),
    (-0.2, 0.2, 0.0, 1, 1, 0),
    (-0.2, -0.2, 0.0, 1, -1, 0),
    (0.2, 0.15, 0.1, 0, 0, 1),
    (0.2, -0.15, 0.1, 0, 0, 1),
    (-0.2, 0.15, 0.1, 0, 0, 1),
    (-0.2, -0.15, 0.1, 0, 0, 1),
)


LEVEL = tuple((x, y, 0.0, 1, -1 if x * y > 0 else 1, 0) for x in (0.2, -0.2) for y in (0.2, -0.2))
"""Position and direction of four thrusters that drive surge, sway and yaw."""


def heading_with_roll(heading: float) -> tuple[tuple[float, ...], ...]:
    """Return thrusters (position, direction) whose free roll takes so much heading [rad] along for each of
    its own: what turns the vehicle rolls it.
    """
    height = 0.4 * heading
    level = tuple((x, y, height if x > 0.0 else -height, u, v, w) for x, y, _, u, v, w in LEVEL)
    return (*level, (0.2, 0.0, 0.1, 0, 0, 1), (-0.2, 0.0, 0.1, 0, 0, 1))


@dataclass(frozen=True, kw_only=True)
class Tiny:
    """What the files of a robot are written from."""

    joints: tuple[tuple[str, str, str], ...] = (("revolute", "0 1 0", LIMIT),)
    """Type, axis and limit of each."""
    dry: bool = False
    """The arm is named as one without water, so that two links are."""
    thrusters: tuple[tuple[float, ...], ...] = _ALL
    """Position and direction of each."""
    base: str = "free_flyer"
    more: str = ""
    """Of the URDF."""
    limited: bool = True
    """The vehicle is, in velocity and acceleration."""
    in_trim: bool = False
    """Buoyancy is as much as the weight of the vehicle without an arm, and above it."""

    def write(self, folder: Path) -> Path:
        (folder / "robot.urdf").write_text(self._urdf(), encoding="utf-8")
        (folder / "hydrodynamics.yaml").write_text(self._hydrodynamics(), encoding="utf-8")
        return folder

    def _urdf(self) -> str:
        parts = [_HULL]
        parent = "base_link"
        for k, (kind, axis, limit) in enumerate(self.joints):
            name = f"arm{k}"
            parts.append(
                _BOOM.format(
                    name=name, joint=f"turn{k}", kind=kind, parent=parent, axis=axis, limit=limit
                )
            )
            parent = name
        parts += [_TOOL.format(parent=parent), self.more]
        body = "\n".join(parts)
        return f"<robot name='tiny'>{body}</robot>"

    def _hydrodynamics(self) -> str:
        wet = _IN_TRIM if self.in_trim else _WET
        links = f"base_link: {{{wet}}}"
        if self.dry:
            links += ", arm0: {coefficients: {}}"
        thrusters = ""
        for k, (x, y, z, u, v, w) in enumerate(self.thrusters):
            place = f"position: [{x}, {y}, {z}], direction: [{u}, {v}, {w}]"
            bound = "minimum: -40, maximum: 40, time_constant: 0.1"
            thrusters += f"\n  - {{name: t{k}, {place}, {bound}}}"
        lines = [f"base: {self.base}", "altimeter: base_link"]
        if self.limited:
            bounds = "[0.8, 0.5, 0.5, 0.6, 0.6, 0.6]"
            lines.append(f"vehicle_limits: {{velocity: {bounds}, acceleration: {bounds}}}")
        lines += [f"links: {{{links}}}", f"thrusters: {thrusters or '[]'}", ""]
        return "\n".join(lines)


ENDLESS = ("continuous", "0 1 0", _ENDLESS)
_SONAR = """<link name="sonar"><inertial><mass value="0.05"/>
  <inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-4"/></inertial></link>
<joint name="sonar_joint" type="revolute"><parent link="base_link"/><child link="sonar"/><axis xyz="1 0 0"/>
  <limit lower="0" upper="0" effort="0" velocity="0"/></joint>"""
_PROPELLER = """<link name="propeller"><inertial><mass value="0.001"/>
  <inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial></link>
<joint name="propeller_joint" type="continuous"><parent link="base_link"/><child link="propeller"/>
  <axis xyz="1 0 0"/></joint>"""
_STAND = """<link name="stand"><collision><origin xyz="0 0 -6"/>
  <geometry><box size="0.2 0.2 0.2"/></geometry></collision></link>
<joint name="stand_mount" type="fixed"><parent link="base_link"/><child link="stand"/></joint>"""

TINY = {
    "no joints": Tiny(joints=()),
    "one wet link": Tiny(),
    "two wet links": Tiny(dry=True),
    "one thruster": Tiny(thrusters=_ALL[:1]),
    "fixed base, no thrusters": Tiny(base="fixed", thrusters=(), limited=False),
    "an endless joint": Tiny(joints=(ENDLESS,)),
    "endless and not": Tiny(joints=(ENDLESS, ("revolute", "0 0 1", LIMIT), ENDLESS)),
    "a joint that slides": Tiny(joints=(("prismatic", "1 0 0", LIMIT),)),
    "no lift": Tiny(thrusters=_AHEAD),
    "a joint without range": Tiny(more=_SONAR),
}
"""Each flies."""
OPEN = Tiny(joints=tuple(("continuous", axis, "") for axis in ("0 0 1", "0 1 0")))
"""Without limits of joints."""
RIGID = Tiny(base="fixed", thrusters=(), limited=False, joints=())
WEIGHTLESS = Tiny(more=_PROPELLER)
STANDING = Tiny(more=_STAND)


@cache
def robot_of(tiny: Tiny) -> Robot:
    with TemporaryDirectory() as folder:
        files = tiny.write(Path(folder))
        return load_robot(urdf=files / "robot.urdf", hydrodynamics=files / "hydrodynamics.yaml")


def scenario_of(robot: Robot, plant: str, duration: float = 0.1, depth: float = 5.0) -> Scenario:
    """A vehicle to a place, its tool to another, its arm stowed: as far as there are vehicle and
    arm.
    """
    tasks = [JointLimits()]
    if robot.n_vehicle:
        start = robot.configuration(position=(0.0, 0.0, -5.0))
        arrived = Below(quantity="PC.position_error", limit=0.01)
        tasks.append(VehiclePose(goal=pose_at((0.5, 0.0, -depth))))
    else:
        start = robot.configuration()
        arrived = Below(quantity="TP.position_error", limit=0.01)
    if robot.n_joints:
        tasks.append(Manipulability())
    tasks.append(ToolPosition(goal=pose_at((1.0, 0.1, -5.0))))
    tasks.append(JointTracking(joints=robot.joint_names, goal=robot.home))
    names = [task.name for task in tasks]
    end = Transition(to=DONE, when=(arrived,))
    phase = Phase(name="A", activations=activate(*names), transitions=(end,))
    mission = mission_of(robot, tasks, (phase,))
    return Scenario(
        name="tiny",
        robot=robot,
        mission=mission,
        environment=Environment(seafloor=FlatSeafloor(z=-10.0)),
        start=start,
        plant=plant,
        duration=duration,
    )
