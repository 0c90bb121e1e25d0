"""Drawn robot files of all kinds of mechanisms and names, whose roles are known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

PREFIXES = ("", "", "", "sensor_rov/", "camera_boat/", "ins/", "thruster_rov_", "tool.", "rov1/")
HULLS = ("hull", "base", "vehicle", "body", "frame", "pressure_hull", "chassis")
THRUSTERS = ("links", "spinning", "ducted", "mounted", "by_joint", "astern", "anonymous")
ENDS = (
    "tcp",
    "nothing",
    "jaws",
    "phalanges",
    "blade",
    "load_cell",
    "eye",
    "tool_frame",
    "named",
    "finger_wrist",
)
ARMS = ("arm", "link", "rs2 21", "segment", "axis")
MISLEADING_ARMS = (
    "sonar manipulator",
    "light arm",
    "camera arm",
    "probe arm",
    "thruster arm",
    "blade axis",
    "jaw segment",
    "gimbal gripper",
)
EXTRAS = (
    "ballast",
    "head",
    "anonymous_head",
    "fin",
    "anonymous_fin",
    "hatch",
    "winch",
    "piston",
    "lidar",
    "power_box",
    "rack",
    "bracket",
    "camera",
)


def snake(words: str) -> str:
    return words.replace(" ", "_")


def camel(words: str) -> str:
    return "".join(word.capitalize() for word in words.split())


def lower_camel(words: str) -> str:
    name = camel(words)
    return name[0].lower() + name[1:]


def dashed(words: str) -> str:
    return words.replace(" ", "-") + "-link"


STYLES: tuple[Callable[[str], str], ...] = (snake, snake, camel, lower_camel, dashed)


@dataclass(kw_only=True, slots=True)
class DrawnMechanism:
    """A URDF and its roles, as whoever built it means them."""

    rng: np.random.Generator
    style: Callable[[str], str]
    prefix: str
    kinds: tuple[str, ...] = ()
    """What it has: kind of thrusters, of ends and extras."""
    text: str = ""
    thrusters: set[str] = field(default_factory=set)
    """Links or joints of thrusters, by the name that a proposal gives them."""
    tools: set[str] = field(default_factory=set)
    joints: set[str] = field(default_factory=set)
    """Joints that are to move."""

    def link_name(self, words: str) -> str:
        return self.prefix + self.style(words)

    def joint_name(self, words: str) -> str:
        return self.prefix + self.style(f"{words} joint")

    def place(self, scale: float = 0.3) -> str:
        return " ".join(f"{x:.3f}" for x in self.rng.uniform(-scale, scale, 3))

    def add_link(self, words: str, mass: float = 1.0, at: str = "0.1 0 0") -> None:
        name = self.link_name(words)
        if not mass:
            self.text += f"<link name='{name}'/>"
            return
        moment = 0.01 * mass
        self.text += (
            f"<link name='{name}'><inertial><origin xyz='{at}'/><mass value='{mass}'/>"
            f"<inertia ixx='{moment}' ixy='0' ixz='0' iyy='{moment}' iyz='0' izz='{moment}'/>"
            "</inertial></link>"
        )

    def add(
        self,
        parent: str,
        child: str,
        kind: str = "revolute",
        *,
        mass: float = 1.0,
        axis: str = "0 1 0",
        xyz: str = "0.2 0 0",
        at: str = "0.1 0 0",
        joint: str = "",
    ) -> None:
        """Add a link that hangs on another one."""
        self.add_link(child, mass, at)
        limit = ""
        if kind in ("revolute", "prismatic"):
            limit = "<limit lower='-0.5' upper='0.5' velocity='0.7' effort='9'/>"
        self.text += (
            f"<joint name='{self.joint_name(joint or child)}' type='{kind}'>"
            f"<parent link='{self.link_name(parent)}'/><child link='{self.link_name(child)}'/>"
            f"<origin xyz='{xyz}'/><axis xyz='{axis}'/>{limit}</joint>"
        )


def drawn_mechanism(seed: int) -> DrawnMechanism:
    """Draw a vehicle with thrusters, none to two arms, and up to three parts that are neither."""
    rng = np.random.default_rng([63, seed])
    style = STYLES[rng.integers(len(STYLES))]
    mechanism = DrawnMechanism(rng=rng, style=style, prefix=str(rng.choice(PREFIXES)))
    hull = str(rng.choice(HULLS)).replace("_", " ")
    mechanism.add_link(hull, 40.0, "0 0 0")
    kind = THRUSTERS[seed % len(THRUSTERS)]
    mechanism.kinds += (kind,)
    _add_thrusters(mechanism, kind, hull)
    arms = [""]
    n_arms = int(rng.choice([0, 1, 1, 1, 2]))
    if n_arms == 2:
        arms = ["left ", "right "]
    last_arm_link = ""
    for side in arms[:n_arms]:
        end = str(rng.choice(ENDS))
        mechanism.kinds += (end,)
        last_arm_link = _add_arm(mechanism, hull, side, end, n_joints=int(rng.integers(3, 7)))
    for extra in rng.choice(EXTRAS, size=int(rng.integers(0, 4)), replace=False):
        mechanism.kinds += (str(extra),)
        _add_extra(mechanism, str(extra), hull, last_arm_link)
    mechanism.text = f"<robot name='drawn'>{mechanism.text}</robot>"
    return mechanism


def _add_thrusters(m: DrawnMechanism, kind: str, hull: str) -> None:
    word = str(m.rng.choice(["thruster", "prop", "propeller", "screw"]))
    n_thrusters = int(m.rng.integers(3, 9))
    for k in range(n_thrusters):
        name = f"{word} {k}"
        place = m.place()
        if kind == "anonymous":
            m.add(hull, f"part {k}", "continuous", mass=0.05, axis="1 0 0", xyz=place, at="0 0 0")
            m.thrusters.add(m.joint_name(f"part {k}"))
        elif kind == "spinning" or (kind == "astern" and k == 0):
            m.add(hull, name, "continuous", mass=0.05, axis="1 0 0", xyz=place, at="0 0 0")
            m.thrusters.add(m.joint_name(name))
        elif kind == "ducted":
            m.add(hull, f"duct {k}", "fixed", mass=0.2, xyz=place)
            m.add(f"duct {k}", name, "continuous", mass=0.05, axis="1 0 0", xyz="0 0 0", at="0 0 0")
            m.thrusters.add(m.joint_name(name))
        elif kind == "mounted":
            m.add(hull, f"{name} mount", "fixed", mass=0.0, xyz=place)
            m.add(f"{name} mount", name, "fixed", mass=0.2)
            m.thrusters.add(m.link_name(name))
        elif kind == "by_joint":
            m.add(hull, f"part {k}", "fixed", mass=0.2, xyz=place, joint=f"thruster {k}")
            m.thrusters.add(m.link_name(f"part {k}"))
        else:
            m.add(hull, name, "fixed", mass=0.0, xyz=place)
            m.thrusters.add(m.link_name(name))


def _add_arm(m: DrawnMechanism, hull: str, side: str, end: str, n_joints: int) -> str:
    """Add an arm, and return the link in the middle of it."""
    word = str(m.rng.choice(ARMS))
    if m.rng.uniform() < 0.4:
        word = str(m.rng.choice(MISLEADING_ARMS))
        side = f"{word} {side}"
    links = [f"{side}{word} {k}" for k in range(n_joints)]
    if end == "finger_wrist":
        links[-1] = f"{side}finger wrist"
    parent = hull
    for k, name in enumerate(links):
        kind = "continuous" if k and m.rng.uniform() < 0.1 else "revolute"
        axis = str(m.rng.choice(["1 0 0", "0 1 0", "0 0 1"]))
        m.add(parent, name, kind, axis=axis, xyz=m.place())
        m.joints.add(m.joint_name(name))
        parent = name
    tool = parent
    if end in ("tcp", "jaws", "blade"):
        tool = f"{side}{m.rng.choice(['tcp', 'tool0', 'ee', 'end effector'])}"
        m.add(parent, tool, "fixed", mass=0.0)
    elif end == "tool_frame":
        tool = f"{side}tool frame"
        m.add(parent, tool, "fixed", mass=0.0)
        m.add(parent, f"{side}cover", "fixed", mass=0.0)
    elif end == "named":
        tool = f"{side}gripper"
        m.add(parent, tool, "fixed", mass=0.3)
    elif end == "load_cell":
        tool = f"{side}hand"
        m.add(parent, f"{side}force torque sensor", "fixed", mass=0.1)
        m.add(f"{side}force torque sensor", tool, "fixed", mass=0.3)
    elif end == "eye":
        m.add(parent, f"{side}wrist camera", "fixed", mass=0.1)
    m.tools.add(m.link_name(tool))
    if end in ("jaws", "phalanges", "finger_wrist"):
        word = str(m.rng.choice(["finger", "piece", "rs3"]))
        for k in range(int(m.rng.integers(2, 4))):
            m.add(parent, f"{side}{word} {k} a", mass=0.05)
            if end == "phalanges":
                m.add(f"{side}{word} {k} a", f"{side}{word} {k} b", mass=0.05)
                if n_joints > 3:
                    m.add(f"{side}{word} {k} b", f"{side}{word} {k} c", mass=0.05)
    elif end == "blade":
        name = f"{side}{m.rng.choice(['cutter blade', 'rotor', 'saw', 'propeller tool'])}"
        m.add(parent, name, "continuous", mass=0.1, axis="1 0 0", at="0 0 0")
    return links[n_joints // 2 - 1]


def _add_extra(m: DrawnMechanism, kind: str, hull: str, arm_link: str) -> None:
    if kind == "ballast":
        word = str(m.rng.choice(["battery", "slider", "trim weight"]))
        for k in range(int(m.rng.integers(2, 5))):
            m.add(hull, f"{word} {k}", "prismatic", axis="1 0 0", xyz=m.place())
    elif kind in ("head", "anonymous_head"):
        sensor = "camera" if kind == "head" else "eye"
        m.add(hull, f"{sensor[0]} pan", axis="0 0 1", mass=0.3, xyz=m.place())
        m.add(f"{sensor[0]} pan", f"{sensor[0]} tilt", mass=0.3)
        m.add(f"{sensor[0]} tilt", sensor, "fixed", mass=0.2)
    elif kind in ("fin", "anonymous_fin"):
        word = "rudder" if kind == "fin" else "surface"
        for k in range(2):
            m.add(hull, f"{word} {k}", mass=0.1, axis="0 0 1", xyz=m.place())
    elif kind in ("hatch", "winch"):
        joint_kind = "revolute" if kind == "hatch" else "continuous"
        m.add(hull, kind, joint_kind, mass=0.4, xyz=m.place(), at="0.2 0 0")
    elif kind == "piston" and arm_link:
        m.add(arm_link, "piston", "prismatic", axis="1 0 0", mass=0.1)
    elif kind == "lidar":
        m.add(hull, "lidar", "continuous", axis="0 0 1", mass=0.1, at="0 0 0")
    elif kind == "power_box":
        m.add(hull, "thruster power box", "fixed", mass=0.5, xyz=m.place())
    elif kind == "rack":
        m.add(hull, "tool rack", "fixed", mass=0.5, xyz="0 0 1")
    elif kind == "bracket" and arm_link:
        m.add(arm_link, "tool bracket", "fixed", mass=0.1)
    elif kind == "camera":
        m.add(hull, "front cam", mass=0.1, xyz=m.place())
