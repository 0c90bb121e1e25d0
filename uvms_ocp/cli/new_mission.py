"""Write a first mission for a robot: a way point for its vehicle, a target for each of its tools,
and the variations of a campaign.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.record.tables import of_joints
from uvms_ocp.robot import Kinematics, Robot, limits, roles, thrusters
from uvms_ocp.robot.loading import files_of

TEMPLATES = Path(str(files("uvms_ocp.scenario"))) / "templates"

_START = (0.0, 0.0, -6.0)  # [m] position of the vehicle in W
_WAY_POINT = (3.0, 1.0, -8.0)  # [m] in W
_YAW = 0.4  # [rad] of the vehicle at the way point
_FLOOR = -10.0  # [m] z of the floor in W, unless a robot needs a deeper one
_FLOOR_CLEARANCE = 1.2  # [m] at least, between the floor and all parts at their goals
_FORWARD = 0.25  # [m] from a tool, when the vehicle is at the way point, forward to its target
_DOWN = 0.1  # [m] from there down to its target
_JOINT_SHARE = 0.15  # motion to the target of a fixed arm, as a share of the range of each joint


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class NewMission:
    """A mission of a robot, ready to be written."""

    robot: Robot
    """Robot whose vehicle, tools and joints the mission names."""
    place: str
    """Expression for ROBOT, the folder of the robot."""
    load: str
    """Statement that loads the robot."""

    def text(self, file: Path, vary: Path) -> str:
        """Write the source of the mission's file."""
        robot = self.robot
        tasks = list(self._tasks())
        names = [name for _, name in tasks if name]
        template = (TEMPLATES / "mission.py.txt").read_text(encoding="utf-8")
        if robot.n_vehicle:
            abort_tasks = [name for name in names if name in ("JL", "MAC", "HA", "MP")]
            abort = f", abort=abort_phase({_quoted_list(abort_tasks)})"
            start = "run.start(START)"
            duration = "90.0"
        else:
            abort = ""
            start = "robot.configuration()"
            duration = "30.0"
        return template.format(
            title=self.title,
            file=file.name,
            vary=vary.name,
            robot=self.place,
            load=self.load,
            imports="\n".join(self._imports(tasks)),
            constants="\n".join(self._constants(self._goal())),
            defaults="" if self.has_forces else '"plant": "kinematic", ',
            duration=duration,
            tasks="\n".join(f"        {line}" for line, _ in tasks),
            conditions="\n".join(f"    {line}" for line in self._conditions()),
            phases="\n".join(self._phases(names)),
            name=file.stem if file.stem.isidentifier() else "my_mission",
            abort=abort,
            start=start,
            markers=self._markers(),
        )

    @property
    def title(self) -> str:
        """Summarize the mission in a phrase."""
        steps = []
        if self.robot.n_vehicle:
            steps.append("swim to a way point")
        if len(self.tools) == 1:
            steps.append("bring the tool to a target and hold it there")
        elif self.tools:
            steps.append("bring each tool to its target")
        return ", then ".join(steps) or "hold the posture"

    @property
    def tools(self) -> tuple[str, ...]:
        """Frames of the tools that joints move, or the vehicle."""
        if self.robot.n_joints:
            return self.robot.tools
        return ()

    @property
    def posture_joints(self) -> Mapping[str, limits.Joint]:
        """Joints of one degree of freedom, by name: those that a posture can hold."""
        return {joint.name: joint for joint in self.robot.joints if joint.n_v == 1}

    @property
    def level_frame(self) -> str:
        """Argument ``frame=ROOT`` of the tasks of the vehicle; empty where ``base_link`` has the
        orientation of the root, so that tasks may use their default frame.
        """
        kinematics = Kinematics(self.robot, self.robot.configuration())
        R_WB = kinematics.pose(roles.BASE).rotation
        if np.allclose(R_WB, np.eye(3), atol=1e-6):
            return ""
        root = self.robot.frame_names[1]
        return f"frame={_quoted(root)}"

    @property
    def has_forces(self) -> bool:
        """True where the dynamic plant can move the robot: a vehicle by thrusters, or an arm that
        stands by its motors.
        """
        return bool(self.robot.description.thrusters) or not self.robot.n_vehicle

    @property
    def undriven_axes(self) -> tuple[int, ...]:
        """Axes of the vehicle that no thruster drives, where it has thrusters."""
        return thrusters.undriven_axes(self.robot)

    @property
    def turns_first(self) -> bool:
        """True for a vehicle without sway that has to turn its bow to where it goes."""
        return 1 in self.undriven_axes and not {0, 5} & set(self.undriven_axes)

    def notes(self) -> Iterator[str]:
        """Yield a line for each thing that the mission lacks, with how to have it."""
        for is_good, text in roles.role_notes(self.robot.model, self.robot.description):
            if not is_good:
                yield text
        if not self.has_forces:
            yield (
                "thrusters: none, so that the mission flies on the kinematic plant; write them into"
                " hydrodynamics.yaml"
            )
        posture_joints = self.posture_joints
        free_joints = [
            joint.name for joint in self.robot.joints if joint.name not in posture_joints
        ]
        if free_joints:
            yield (
                f"joint {', '.join(free_joints)}: has several degrees of freedom, which no posture"
                " holds; --lock JOINT fixes it"
            )
        if self.undriven_axes:
            axis_names = ", ".join(thrusters.AXES[axis] for axis in self.undriven_axes)
            if self.turns_first:
                way_text = "it turns to the way point first"
            else:
                way_text = "the way point lies where the others lead"
            yield f"thrusters: none for {axis_names}; {way_text}, and these axes are left free"

    def _goal(self) -> np.ndarray:
        """Return the configuration (n_q,) at the way point, with the arm stowed."""
        robot = self.robot
        if not robot.n_vehicle:
            return np.asarray(robot.configuration())
        position, yaw = self._way_point()
        return np.asarray(robot.configuration(position=position, rpy=(0.0, 0.0, yaw)))

    def _way_point(self) -> tuple[tuple[float, float, float], float]:
        """Return position [m] and yaw [rad] of the way point, which the driven axes can reach.

        It is straight ahead where some axes are not driven and the robot cannot turn to it first.
        """
        undriven = set(self.undriven_axes)
        x = _START[0] if 0 in undriven else _WAY_POINT[0]
        y = _WAY_POINT[1]
        z = _START[2] if 2 in undriven else _WAY_POINT[2]
        if self.turns_first:
            return (x, y, z), round(float(np.arctan2(y, x)), 3)
        if undriven & {0, 1, 2}:
            return (x, 0.0, z), 0.0
        return _WAY_POINT, _YAW

    def _targets(self, goal: np.ndarray) -> list[tuple[float, ...]]:
        """Return positions [m] in W that the tools can reach.

        goal: configuration (n_q,) [m, rad] at the way point.
        """
        if self.robot.n_vehicle:
            return self._targets_ahead(goal)
        return self._targets_in_reach(goal)

    def _targets_ahead(self, goal: np.ndarray) -> list[tuple[float, ...]]:
        """Return places a little ahead of where the tools of a vehicle are at the way point."""
        _, yaw = self._way_point()
        down = 0.0 if 2 in self.undriven_axes else _DOWN
        offset = pin.rpy.rpyToMatrix(0.0, 0.0, yaw) @ np.array([_FORWARD, 0.0, -down])
        kinematics = Kinematics(self.robot, goal)
        targets = []
        for tool in self.tools:
            position = kinematics.pose(tool).translation + offset
            targets.append(tuple(np.round(position, 2).tolist()))
        return targets

    def _targets_in_reach(self, goal: np.ndarray) -> list[tuple[float, ...]]:
        """Return where the tools of an arm that stands get by a small motion of all joints."""
        robot = self.robot
        motion = np.zeros(robot.n_v)
        for joint, lower_limit, upper_limit in limits.bounded_joints(robot.joints, robot.limits):
            position = float(goal[joint.idx_q])
            # Rails may be as long as a tank.
            lower = max(lower_limit, position - np.pi)
            upper = min(upper_limit, position + np.pi)
            direction = 1.0 if upper - position > position - lower else -1.0
            motion[joint.v] = _JOINT_SHARE * (upper - lower) * direction
        kinematics = Kinematics(robot, pin.integrate(robot.model, goal, motion))
        targets = []
        for tool in self.tools:
            position = kinematics.pose(tool).translation
            targets.append(tuple(np.round(position, 3).tolist()))
        return targets

    def _constants(self, goal: np.ndarray) -> Iterator[str]:
        targets = self._targets(goal)
        yield f"FLOOR = {self._floor(goal, targets)}  # [m] z of the floor in W; z is up"
        if self.robot.n_vehicle:
            position, yaw = self._way_point()
            yield (
                f"START = uo.pose_at({_START}, (0.0, 0.0, 0.0))  # position [m]; roll, pitch, yaw"
                " [rad]"
            )
            yield f"WAY_POINT = uo.pose_at({position}, (0.0, 0.0, {yaw}))"
        for name, target, tool in zip(self._numbered("TARGET"), targets, self.tools, strict=True):
            subject = "the tool" if len(targets) == 1 else tool
            yield f"{name} = {target}  # [m] where {subject} goes"

    def _floor(self, goal: np.ndarray, targets: list[tuple[float, ...]]) -> float:
        """Return z [m] of a floor in W below all frames and targets at their goals."""
        data = self.robot.model.createData()
        pin.framesForwardKinematics(self.robot.model, data, goal)
        frame_heights = [float(X_WF.translation[2]) for X_WF in list(data.oMf)[1:]]
        target_heights = [target[2] for target in targets]
        lowest = min(frame_heights + target_heights) - _FLOOR_CLEARANCE
        if self.robot.n_vehicle:
            return min(_FLOOR, float(np.floor(lowest)))
        return float(np.floor(lowest - 1.0))

    def _numbered(self, name: str, mark: str = "_") -> list[str]:
        """Return a name for each tool: the name itself for a single tool, else with a number."""
        n_tools = len(self.tools)
        if n_tools == 1:
            return [name]
        return [f"{name}{mark}{number}" for number in range(1, n_tools + 1)]

    def _tasks(self) -> Iterator[tuple[str, str]]:
        """Yield the lines of the list of tasks, each with the name of its task; an empty name for a
        comment.
        """
        robot = self.robot
        level_frame = self.level_frame if robot.n_vehicle else ""
        frame_argument = f", {level_frame}" if level_frame else ""
        if robot.n_joints:
            yield "JointLimits(),", "JL"
        if robot.n_vehicle:
            if robot.description.altimeter:
                yield "MinimumAltitude(threshold=0.8),  # [m]", "MAC"
            else:
                yield "# MinimumAltitude() needs `altimeter: LINK` in hydrodynamics.yaml", ""
            if not {3, 4} & set(self.undriven_axes):
                yield f"HorizontalAttitude({level_frame}),", "HA"
        if self.turns_first:
            yield f"Alignment(goal=WAY_POINT.translation{frame_argument}),", "AT"
        names = self._numbered("TP", "")
        targets = self._numbered("TARGET")
        for name, tool, target in zip(names, self.tools, targets, strict=True):
            arguments = f"goal=uo.pose_at({target})"
            if len(self.tools) > 1:
                arguments = f'name="{name}", frame={_quoted(tool)}, {arguments}'
            yield f"ToolPosition({arguments}),", name
        if robot.n_vehicle:
            yield f"VehiclePose(goal=WAY_POINT{frame_argument}),", "PC"
        posture_joints = self.posture_joints
        if len(posture_joints) == len(robot.joints) > 0:
            yield "JointTracking(joints=robot.joint_names, goal=robot.home),", "MP"
        elif posture_joints:
            joint_names = _quoted_list(posture_joints)
            places = [joint.idx_v - robot.n_vehicle for joint in posture_joints.values()]
            yield f"JointTracking(joints=({joint_names},), goal=robot.home[{places}]),", "MP"

    def _conditions(self) -> Iterator[str]:
        if self.robot.n_vehicle:
            # The axes that nothing drives drift as weight and buoyancy have it.
            error = "horizontal_error" if 2 in self.undriven_axes else "position_error"
            limit = 0.3 if self.undriven_axes else 0.1
            yield f'arrived = uo.Below(quantity="PC.{error}", limit={limit})  # [m]'
        if self.turns_first:
            yield 'turned = uo.Below(quantity="AT.misalignment", limit=0.07)  # [rad]'
        for reached, name in zip(self._numbered("reached"), self._numbered("TP", ""), strict=True):
            yield f'{reached} = uo.Below(quantity="{name}.position_error", limit=0.02)  # [m]'
        if not self.robot.n_vehicle and not self.tools:
            unit = of_joints("rad or m", [joint.slides for joint in self.robot.joints])
            yield f'still = uo.Below(quantity="MP.posture_error", limit=0.02)  # [{unit}]'

    def _phases(self, names: list[str]) -> Iterator[str]:
        """Yield the source of each phase; names: of all tasks."""
        tool_tasks = set(self._numbered("TP", ""))
        if self.robot.n_vehicle:
            way_tasks = [name for name in names if name not in tool_tasks]
            if self.turns_first:
                turn_tasks = [name for name in way_tasks if name != "PC"]
                yield _phase("T", "turn", turn_tasks, '"A"', "turned")
            next_phase = '"B"' if self.tools else "uo.DONE"
            comment = "  # [s]: noise alone ends no phase"
            yield _phase("A", "way point", way_tasks, next_phase, "arrived", comment)
        if self.tools:
            reach_tasks = [name for name in names if name != "AT"]
            conditions = ", ".join(self._numbered("reached"))
            yield _phase("B", "reach", reach_tasks, "uo.DONE", conditions)
        if not self.robot.n_vehicle and not self.tools:
            yield _phase("A", "posture", names, "uo.DONE", "still")

    def _markers(self) -> str:
        names = ["target"] if len(self.tools) == 1 else self.tools
        targets = self._numbered("TARGET")
        items = [f"{_quoted(name)}: {target}" for name, target in zip(names, targets, strict=True)]
        if self.robot.n_vehicle:
            items.append('"way point": tuple(np.asarray(WAY_POINT.translation).tolist())')
        return f"{{{', '.join(items)}}}"

    def _imports(self, tasks: list[tuple[str, str]]) -> Iterator[str]:
        kinds = sorted({line.partition("(")[0] for line, name in tasks if name})
        options = ["activate", "mission_of", "run_options"]
        if self.robot.n_vehicle:
            options.insert(0, "abort_phase")
            yield "import numpy as np\n"
        yield "import uvms_ocp as uo"
        yield f"from uvms_ocp.scenario.options import {', '.join(options)}"
        yield f"from uvms_ocp.tasks import {', '.join(kinds)}"


def _phase(
    name: str, title: str, tasks: list[str], next_phase: str, condition: str, comment: str = ""
) -> str:
    """Return the source of a phase that ends in a transition to the next one."""
    transition = f"uo.Transition(to={next_phase}, when=({condition},), hold=1.0)"
    lines = [
        "uo.Phase(",
        f'    name="{name}",',
        f'    title="{title}",',
        f"    activations=activate({_quoted_list(tasks)}),",
        f"    transitions=({transition},),{comment}",
        "),",
    ]
    return "\n".join(f"        {line}" for line in lines)


def _quoted_list(names: Iterable[str]) -> str:
    return ", ".join(_quoted(name) for name in names)


def _quoted(name: str) -> str:
    """Return a name as a string of Python's source."""
    return '"' + name.replace("\\", "\\\\").replace('"', '\\"') + '"'


def loading_line(
    file: Path, robot: Path, hydrodynamics: str | None, loading: Mapping[str, Any]
) -> tuple[str, str]:
    """Return the source for `NewMission.place` and `NewMission.load`, for a mission in `file`."""

    def relative_path(path: Path) -> str:
        return os.path.relpath(path.resolve(), file.resolve().parent).replace(os.sep, "/")

    files = files_of(robot, hydrodynamics)
    urdf = Path(files["urdf"])
    parts = [f'urdf=ROBOT / "{urdf.name}"']
    if files["hydrodynamics"] is not None:
        hydrodynamics_file = Path(files["hydrodynamics"])
        if hydrodynamics_file.resolve().parent == urdf.resolve().parent:
            location = f"ROBOT / {_quoted(hydrodynamics_file.name)}"
        else:
            location = f"HERE / {_quoted(relative_path(hydrodynamics_file))}"
        parts.append(f"hydrodynamics={location}")
    for key, value in loading.items():
        if key == "package_dirs":
            folders = [f"HERE / {_quoted(relative_path(Path(folder)))}" for folder in value]
            parts.append(f"{key}=[{', '.join(folders)}]")
        else:
            parts.append(f"{key}={value!r}")
    place = f"HERE / {_quoted(relative_path(urdf.parent))}"
    return place, f"return uo.load_robot({', '.join(parts)})"


def variations_text(mission: NewMission) -> str:
    """Write the variations of a robot's mission: the template without the lines that need a part
    which the robot, or its plant, does not have.
    """
    robot = mission.robot
    text = (TEMPLATES / "variations.py.txt").read_text(encoding="utf-8")
    absent = []
    if not (mission.tools and mission.has_forces):
        absent.append('Variation("payload.')
    if not robot.n_vehicle:
        absent.append('Variation("start.yaw')
    if not (robot.description.links and mission.has_forces):
        absent.append('Variation("water.')
    if not mission.has_forces:
        absent.append('Variation("current.')
    lines = []
    for line in text.split("\n"):
        if not any(words in line for words in absent):
            lines.append(line)
    return "\n".join(lines)
