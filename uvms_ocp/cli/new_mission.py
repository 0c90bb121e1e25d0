"""Write a mission of what a robot has: a way point for its vehicle, a target for each of its tools,
and what is uncertain.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
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

# [m, rad]
_START = (0.0, 0.0, -6.0)
_WAY_POINT = (3.0, 1.0, -8.0)
_YAW = 0.4
# [m] the floor, and what stays between it and all parts at their goals
_FLOOR = -10.0
_OVER = 1.2
# [m] from where a tool is anyway to its target
_FORWARD = 0.25
_DOWN = 0.1
_SMALL = 0.15  # of the range of each joint, for the target of an arm that stands


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class NewMission:
    """A mission of a robot, ready to be written. robot: `None` for bluerov2_alpha5 of the package,
    by name.
    """

    robot: Robot
    place: str
    """Expression for ROBOT, the folder of the robot."""
    load: str
    """Statement that loads the robot."""

    def text(self, file: Path, vary: Path) -> str:
        """Write the source of the mission's file."""
        robot = self.robot
        tasks = list(self._tasks())
        names = [name for _, name in tasks if name]
        safe = [name for name in names if name in ("JL", "MAC", "HA", "MP")]
        template = (TEMPLATES / "mission.py.txt").read_text(encoding="utf-8")
        if robot.n_vehicle:
            abort = f", abort=abort_phase({', '.join(map(_quoted, safe))})"
        else:
            abort = ""
        return template.format(
            title=self.title,
            file=file.name,
            vary=vary.name,
            robot=self.place,
            load=self.load,
            imports="\n".join(self._imports(tasks)),
            constants="\n".join(self._constants(self._goal())),
            defaults="" if self.has_forces else '"plant": "kinematic", ',
            duration="90.0" if robot.n_vehicle else "30.0",
            tasks="\n".join(f"        {line}" for line, _ in tasks),
            conditions="\n".join(f"    {line}" for line in self._conditions()),
            phases="\n".join(self._phases(names)),
            name=file.stem if file.stem.isidentifier() else "my_mission",
            abort=abort,
            start="run.start(START)" if robot.n_vehicle else "robot.configuration()",
            markers=self._markers(),
        )

    @property
    def title(self) -> str:
        """Summarize the mission in a phrase."""
        bring = (
            "bring the tool to a target and hold it there"
            if len(self.tools) == 1
            else "bring each tool to its target"
        )
        swim = "swim to a way point"
        if not self.robot.n_vehicle:
            if self.tools:
                return bring
            return "hold the posture"
        if self.tools:
            return f"{swim}, then {bring}"
        return swim

    @property
    def tools(self) -> tuple[str, ...]:
        """Frames of the tools that joints move, or the vehicle."""
        if self.robot.n_joints:
            return self.robot.tools
        return ()

    @property
    def held(self) -> Mapping[str, limits.Joint]:
        """Joints of one degree of freedom, which a posture is of."""
        return {joint.name: joint for joint in self.robot.joints if joint.n_v == 1}

    @property
    def level_frame(self) -> str:
        """Argument of tasks of the vehicle where ``base_link`` does not lie as the vehicle does:
        the root has a frame, too.
        """
        R = Kinematics(self.robot, self.robot.configuration()).pose(roles.BASE).rotation
        root = self.robot.frame_names[1]
        if np.allclose(R, np.eye(3), atol=1e-6):
            return ""
        return f"frame={_quoted(root)}"

    @property
    def has_forces(self) -> bool:
        """Check that the dynamic plant can move it: by thrusters, or an arm that stands by its
        motors.
        """
        return bool(self.robot.description.thrusters) or not self.robot.n_vehicle

    @property
    def missing(self) -> tuple[int, ...]:
        """Axes of the vehicle that no thruster drives, where it has thrusters."""
        return thrusters.undriven_axes(self.robot)

    @property
    def turns_first(self) -> bool:
        """Check that it goes ahead alone, and so has to turn its bow to where it goes."""
        return 1 in self.missing and not {0, 5} & set(self.missing)

    def notes(self) -> Iterator[str]:
        """Yield what is left out, one line each, with how to have it."""
        yield from (
            text
            for is_good, text in roles.role_notes(self.robot.model, self.robot.description)
            if not is_good
        )
        if not self.has_forces:
            yield (
                "thrusters: none, so that the mission flies on the kinematic plant; write them into"
                " hydrodynamics.yaml"
            )
        free_joints = [joint.name for joint in self.robot.joints if joint.name not in self.held]
        if free_joints:
            yield (
                f"joint {', '.join(free_joints)}: has several degrees of freedom, which no posture"
                " holds; --lock JOINT fixes it"
            )
        if self.missing:
            axis_names = ", ".join(thrusters.AXES[axis] for axis in self.missing)
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
        """Return the way point to which all axes lead; straight ahead where some are missing and
        the robot cannot turn there first.
        """
        x, _, z = [_START[axis] if axis in self.missing else _WAY_POINT[axis] for axis in range(3)]
        if self.turns_first:
            return (x, _WAY_POINT[1], z), round(float(np.arctan2(_WAY_POINT[1], x)), 3)
        if {0, 1, 2} & set(self.missing):
            return ((x, 0.0, z), 0.0)
        return (_WAY_POINT, _YAW)

    def _targets(self, goal: np.ndarray) -> list[tuple[float, ...]]:
        """Return positions [m] in W that the tools can reach."""
        robot = self.robot
        if robot.n_vehicle:
            poses = [Kinematics(robot, goal).pose(tool).translation for tool in self.tools]
            R = pin.rpy.rpyToMatrix(0.0, 0.0, self._way_point()[1])
            offset = R @ np.array([_FORWARD, 0.0, 0.0 if 2 in self.missing else -_DOWN])
            return [tuple(np.round(pose + offset, 2).tolist()) for pose in poses]
        values = np.zeros(robot.n_v)
        for joint, lower_limit, upper_limit in limits.bounded_joints(robot.joints, robot.limits):
            position = float(goal[joint.idx_q])
            # Rails may be as long as a tank.
            lower = max(lower_limit, position - np.pi)
            upper = min(upper_limit, position + np.pi)
            direction = 1.0 if upper - position > position - lower else -1.0
            values[joint.v] = _SMALL * (upper - lower) * direction
        configuration = pin.integrate(robot.model, goal, values)
        return [
            tuple(np.round(Kinematics(robot, configuration).pose(tool).translation, 3).tolist())
            for tool in self.tools
        ]

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
            if len(targets) == 1:
                subject = "the tool"
            else:
                subject = tool
            yield f"{name} = {target}  # [m] where {subject} goes"

    def _floor(self, goal: np.ndarray, targets: list[tuple[float, ...]]) -> float:
        data = self.robot.model.createData()
        pin.framesForwardKinematics(self.robot.model, data, goal)
        heights = [float(X.translation[2]) for X in list(data.oMf)[1:]] + [
            target[2] for target in targets
        ]
        lowest = min(heights) - _OVER
        if self.robot.n_vehicle:
            return min(_FLOOR, float(np.floor(lowest)))
        return float(np.floor(lowest - 1.0))

    def _numbered(self, name: str, mark: str = "_") -> list[str]:
        """Return names of what there is one of for each tool: the name itself for a single tool."""
        if len(self.tools) == 1:
            return [name]
        return [f"{name}{mark}{k}" for k in range(1, len(self.tools) + 1)]

    def _tasks(self) -> Iterator[tuple[str, str]]:
        """Yield lines, each with the name of its task, if it is one."""
        robot = self.robot
        if robot.n_vehicle and self.level_frame:
            frame_argument = f", {self.level_frame}"
        else:
            frame_argument = ""
        if robot.n_joints:
            yield "JointLimits(),", "JL"
        if robot.n_vehicle:
            if robot.description.altimeter:
                yield "MinimumAltitude(threshold=0.8),  # [m]", "MAC"
            else:
                yield "# MinimumAltitude() needs `altimeter: LINK` in hydrodynamics.yaml", ""
            if not {3, 4} & set(self.missing):
                yield f"HorizontalAttitude({self.level_frame}),", "HA"
        if self.turns_first:
            yield f"Alignment(goal=WAY_POINT.translation{frame_argument}),", "AT"
        for name, tool, target in zip(
            self._numbered("TP", ""), self.tools, self._numbered("TARGET"), strict=True
        ):
            if len(self.tools) == 1:
                tool_arguments = ""
            else:
                tool_arguments = f'name="{name}", frame={_quoted(tool)}, '
            yield f"ToolPosition({tool_arguments}goal=uo.pose_at({target})),", name
        if robot.n_vehicle:
            yield f"VehiclePose(goal=WAY_POINT{frame_argument}),", "PC"
        if len(self.held) == len(robot.joints) > 0:
            yield "JointTracking(joints=robot.joint_names, goal=robot.home),", "MP"
        elif self.held:
            names = ", ".join(map(_quoted, self.held))
            places = [joint.idx_v - robot.n_vehicle for joint in self.held.values()]
            yield f"JointTracking(joints=({names},), goal=robot.home[{places}]),", "MP"

    def _conditions(self) -> Iterator[str]:
        if self.robot.n_vehicle:
            # The axes that nothing drives drift as weight and buoyancy have it.
            error = "horizontal_error" if 2 in self.missing else "position_error"
            limit = 0.3 if self.missing else 0.1
            yield f'arrived = uo.Below(quantity="PC.{error}", limit={limit})  # [m]'
        if self.turns_first:
            yield 'turned = uo.Below(quantity="AT.misalignment", limit=0.07)  # [rad]'
        for reached, name in zip(self._numbered("reached"), self._numbered("TP", ""), strict=True):
            yield f'{reached} = uo.Below(quantity="{name}.position_error", limit=0.02)  # [m]'
        if not self.robot.n_vehicle and not self.tools:
            unit = of_joints("rad or m", [joint.slides for joint in self.robot.joints])
            yield f'still = uo.Below(quantity="MP.posture_error", limit=0.02)  # [{unit}]'

    def _phases(self, names: list[str]) -> Iterator[str]:
        tools = set(self._numbered("TP", ""))
        if self.robot.n_vehicle:
            next_phase = '"B"' if self.tools else "uo.DONE"
            vehicle_tasks = [name for name in names if name not in tools]
            if self.turns_first:
                yield _phase(
                    "T", "turn", [name for name in vehicle_tasks if name != "PC"], '"A"', "turned"
                )
            yield _phase(
                "A",
                "way point",
                vehicle_tasks,
                next_phase,
                "arrived",
                "  # [s]: noise alone ends no phase",
            )
        if self.tools:
            yield _phase(
                "B",
                "reach",
                [name for name in names if name != "AT"],
                "uo.DONE",
                ", ".join(self._numbered("reached")),
            )
        if not self.robot.n_vehicle and not self.tools:
            yield _phase("A", "posture", names, "uo.DONE", "still")

    def _markers(self) -> str:
        if len(self.tools) == 1:
            names = ["target"]
        else:
            names = [*self.tools]
        values = dict(zip(names, self._numbered("TARGET"), strict=True))
        items = [f"{_quoted(name)}: {value}" for name, value in values.items()]
        if self.robot.n_vehicle:
            items.append('"way point": tuple(np.asarray(WAY_POINT.translation).tolist())')
        return f"{{{', '.join(items)}}}"

    def _imports(self, tasks: list[tuple[str, str]]) -> Iterator[str]:
        kinds = sorted({line.partition("(")[0] for line, name in tasks if name})
        options = [
            *(["abort_phase"] if self.robot.n_vehicle else []),
            "activate",
            "mission_of",
            "run_options",
        ]
        if self.robot.n_vehicle:
            yield "import numpy as np\n"
        yield "import uvms_ocp as uo"
        yield f"from uvms_ocp.scenario.options import {', '.join(options)}"
        yield f"from uvms_ocp.tasks import {', '.join(kinds)}"


def _phase(
    name: str, title: str, tasks: list[str], next_phase: str, condition: str, comment: str = ""
) -> str:
    transition = f"uo.Transition(to={next_phase}, when=({condition},), hold=1.0)"
    lines = [
        "uo.Phase(",
        f'    name="{name}",',
        f'    title="{title}",',
        f"    activations=activate({', '.join(map(_quoted, tasks))}),",
        f"    transitions=({transition},),{comment}",
        "),",
    ]
    return "\n".join(f"        {line}" for line in lines)


def _quoted(name: str) -> str:
    return '"' + name.replace("\\", "\\\\").replace('"', '\\"') + '"'


def loading_line(
    file: Path, robot: Path, hydrodynamics: str | None, loading: Mapping[str, Any]
) -> tuple[str, str]:
    """Return the expression for ROBOT and the statement that loads it, for a mission's file."""

    def relative_path(path: Path) -> str:
        return os.path.relpath(path.resolve(), file.resolve().parent).replace(os.sep, "/")

    files = files_of(robot, hydrodynamics)
    urdf = Path(files["urdf"])
    hydrodynamics_file = files["hydrodynamics"]
    parts = [f'urdf=ROBOT / "{urdf.name}"']
    if hydrodynamics_file is not None:
        is_inside = Path(hydrodynamics_file).resolve().parent == urdf.resolve().parent
        if is_inside:
            location = f"ROBOT / {_quoted(Path(hydrodynamics_file).name)}"
        else:
            location = f"HERE / {_quoted(relative_path(Path(hydrodynamics_file)))}"
        parts.append(f"hydrodynamics={location}")
    for key, value in loading.items():
        if key == "package_dirs":
            folders = [f"HERE / {_quoted(relative_path(Path(folder)))}" for folder in value]
            parts.append(f"{key}=[{', '.join(folders)}]")
        else:
            parts.append(f"{key}={value!r}")
    return (
        f"HERE / {_quoted(relative_path(urdf.parent))}",
        f"return uo.load_robot({', '.join(parts)})",
    )


def variations_text(mission: NewMission) -> str:
    """Write the variations of a robot's mission, without the lines about what the robot, or its
    plant, has not.
    """
    robot = mission.robot
    text = (TEMPLATES / "variations.py.txt").read_text(encoding="utf-8")
    conditions = [
        ("payload.", bool(mission.tools and mission.has_forces)),
        ("start.yaw", bool(robot.n_vehicle)),
        ("water.", bool(robot.description.links and mission.has_forces)),
        ("current.", mission.has_forces),
    ]
    absent = [f'Variation("{word}' for word, is_met in conditions if not is_met]
    return "\n".join(line for line in text.split("\n") if not any(word in line for word in absent))
