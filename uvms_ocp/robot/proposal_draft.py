"""Draft of a robot's description from its URDF: tools, sensors, motors and thrusters as far as names
and axes tell, and the questions that are left open.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.robot import limits
from uvms_ocp.robot.name_words import NameWords
from uvms_ocp.robot.proposed_water import WATER_DENSITY, rounded
from uvms_ocp.robot.roles import CHOOSE, Roles
from uvms_ocp.robot.simulator_water import SimulatorBlocks, unread_lines
from uvms_ocp.robot.size import mass, size
from uvms_ocp.robot.up_axis import TURN, signs_of_z_down
from uvms_ocp.robot.urdf import UrdfModels, UrdfReading

# Thrusters of vehicles of 10 to 160 kg have the larger of both.
_THRUST_PER_ROOT_MASS = 12.0  # [N/kg^0.5]
_THRUST_PER_MASS = 0.95  # [N/kg]
_TIME_CONSTANT = 0.15  # [s] of a thruster
SPIN_UP = 0.03
"""[s] in which full effort brings the rotor of a joint alone to full speed: mechanical time
constants of small motors are 5 to 20 ms of the torque that stalls them, above the limit.
"""
# up to which a geared motor may exceed what it moves: [kg m2], or [kg] of a joint that slides, or shares of
# the robot's mass, with the square of its size, if that is less
_SMALLEST_ROTOR = 0.01
_SMALLEST_SLIDE = 1.0
_ROTOR_SHARE = 0.01
_SLIDE_SHARE = 0.06
_FINGERS = (
    "fingers that mimic none, held still; <mimic> in the URDF makes them one joint, without `lock`"
    " each is its own; of a wrist give --tool LINK"
)
_EMPTY = (
    "moves nothing that has a mass, and is held still; give its links <inertial>, and take it out"
    " of `lock`"
)
_SPINNERS = "spins a tool at the end of an arm, and is held still"
_BALLAST = (
    "slides a mass along the vehicle, taken for ballast and held still; --tool LINK makes an arm of"
    " it"
)
_HEADS = "points sensors alone, taken for a head and held still; --tool LINK makes an arm of it"
_BRANCHES = (
    "branches off an arm beside the longer part of it, taken for a piston or alike and held still;"
    " --tool LINK makes an arm of it"
)
_STILL_KINDS = {
    "propellers": "turns a thruster or a fin",
    "sensors": "moves sensors alone",
    "held": "has no range",
}
"""Kinds of joints, fields of `Roles`, that are held still without a question."""
_SHOWN_NAMES = 3
_DOWN = 0.9  # cosine to straight down, of a range sensor's -z


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ProposedThruster:
    """A thruster of a URDF."""

    name: str
    X: pin.SE3
    """Pose in B."""
    direction: np.ndarray
    """Direction (3,) of positive thrust in B."""
    source: str
    """Words for where the direction comes from."""
    is_doubtful: bool = False
    """True where it may be something else, as others are alike and this one is called otherwise."""
    minimum: float | None = None
    """[N] smallest thrust as the file states it; `None` where it does not."""
    maximum: float | None = None
    """[N] largest thrust as the file states it; `None` where it does not."""
    time_constant: float | None = None
    """[s] time constant as the file states it; `None` where it does not."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ProposalDraft:
    """Description of a robot before its hydrodynamics are proposed."""

    models: UrdfModels
    roles: Roles
    reading: UrdfReading
    floats: bool
    """True for a vehicle, False for an arm that stands on something."""
    requested_tools: tuple[str, ...]
    """Frames that the user named; empty for none."""
    requested_altimeter: str | None
    """Frame that the user named."""
    requested_dvl: str | None
    """Frame that the user named."""
    thrusters: list[ProposedThruster]
    simulator: SimulatorBlocks
    """Statements of the file about water for simulators."""

    def stated_of(self, link: str) -> Mapping[str, Any]:
        """Return the coefficients of a link that the file states, none for another link."""
        if link not in self.simulator.links:
            return {}
        return self.simulator.links[link].coefficients

    @property
    def water_density(self) -> float:
        """[kg/m3] as the file states it, or of the sea."""
        return self.simulator.density or WATER_DENSITY

    @property
    def tools(self) -> tuple[str, ...]:
        """Tools, one for each arm, where that leaves no doubt."""
        if self.requested_tools:
            return self.requested_tools
        chains = self.roles.tools
        if self._has_tool_frame() and len(chains) < 2:
            return ("tool",)
        if all(len(chain) == 1 for chain in chains):
            return tuple(chain[0] for chain in chains)
        return ()

    def _has_tool_frame(self) -> bool:
        """Check whether a frame is called ``tool`` and is moved by a joint, or no arm is there."""
        for frame in self.models.model.frames:
            if frame.name == "tool":
                vehicle_joint = 1 if self.floats else 0
                return frame.parentJoint > vehicle_joint or not self.roles.tools
        return False

    @property
    def altimeter(self) -> str | None:
        """A link that is called an altimeter and looks down."""
        if self.requested_altimeter or not self.floats:
            return self.requested_altimeter
        model = self.models.model
        data = model.createData()
        pin.framesForwardKinematics(model, data, pin.neutral(model))
        looking_down = list[str]()
        for index, link in self._links_called("altimeter"):
            if data.oMf[index].rotation[2, 2] > _DOWN:
                looking_down.append(str(link.name))
        if len(looking_down) == 1:
            return looking_down[0]
        return None

    @property
    def dvl(self) -> str | None:
        """The only link of the vehicle that is called a DVL."""
        if self.requested_dvl:
            return self.requested_dvl
        candidates = self._dvl_candidates()
        if self.floats and len(candidates) == 1:
            return candidates[0]
        return None

    def _dvl_candidates(self) -> list[str]:
        """Return links of the vehicle that are called a DVL, without those that hang on another one,
        such as its beams.
        """
        frames = self.models.model.frames
        on_vehicle = [i for i, link in self._links_called("dvl") if link.parentJoint <= 1]
        candidates = list[str]()
        for index in on_vehicle:
            above = frames[index].parentFrame
            while above > 0 and above not in on_vehicle:
                above = frames[above].parentFrame
            if above == 0:
                candidates.append(frames[index].name)
        return candidates

    def _links_called(self, kind: str) -> list[tuple[int, pin.Frame]]:
        """Return links whose name is of a kind, with their indices."""
        links = list[tuple[int, pin.Frame]]()
        words = NameWords(self.models.model)
        for index, frame in enumerate(self.models.model.frames):
            if frame.type == pin.FrameType.BODY and words.is_called(kind, frame.name):
                links.append((index, frame))
        return links

    def reasons(self) -> Iterator[str]:
        """Yield which part has which role, and why, one line for each role."""
        model = self.models.model
        if self.floats:
            yield f"vehicle: {self.roles.base}, the root and all that is fixed to it"
        for tool in self.tools:
            if tool in self.requested_tools:
                yield f"tool {tool}: as you said"
                continue
            carrier = model.frames[model.getFrameId(tool)].parentJoint
            chain = [model.names[k] for k in model.supports[carrier]][2 if self.floats else 1 :]
            if chain:
                yield f"tool {tool}: on the last link of an arm of joint {', '.join(chain)}"
        sensors = (
            ("altimeter", self.altimeter, self.requested_altimeter, "that looks down"),
            ("dvl", self.dvl, self.requested_dvl, "that is on the vehicle"),
        )
        for role, link, requested, where in sensors:
            if link and requested:
                yield f"{role} is {link}, as you said"
            elif link:
                yield f"{role} is {link}, the only link {where} and is called one"
        by_source = dict[str, list[str]]()
        for thruster in self.thrusters:
            by_source.setdefault(thruster.source, []).append(thruster.name)
        for source, names in by_source.items():
            shown = ", ".join(names[:_SHOWN_NAMES])
            if len(names) > _SHOWN_NAMES:
                shown += f" and {len(names) - _SHOWN_NAMES} more"
            yield f"{len(names)} thrusters along the {source}: {shown}"
        for kind, why in _STILL_KINDS.items():
            still = [name for name in getattr(self.roles, kind) if name in self.reading.lock]
            if still:
                yield f"joint {', '.join(still)}: {why}, held still"
        yield from unread_lines(self.simulator)

    def questions(self) -> Iterator[str]:
        """Yield the questions that are left open."""
        yield from self._axis_question()
        if not self.thrusters:
            yield self._base_question()
        if not self.tools and self.roles.candidates:
            yield f"tool: any of {', '.join(self.roles.candidates)}; {CHOOSE}"
        if self.floats and not self.altimeter:
            yield (
                "altimeter: no link is called one and looks down along its -z; --altimeter LINK, or"
                " none: no altitude tasks"
            )
        if self.floats and not self.dvl:
            candidates = self._dvl_candidates()
            if candidates:
                choice = f"any of {', '.join(candidates)}"
            else:
                choice = "no link of the vehicle is called one"
            yield f"dvl: {choice}; --dvl LINK, or `sensors: {{linear_velocity: null}}` for none"
        for names, reason in (
            (self.roles.fingers, _FINGERS),
            (self.roles.empty, _EMPTY),
            (self.roles.spinners, _SPINNERS),
            (self.roles.ballast, _BALLAST),
            (self.roles.heads, _HEADS),
            (self.roles.branches, _BRANCHES),
        ):
            still = [name for name in names if name in self.reading.lock]
            if still:
                yield f"joint {', '.join(still)}: {reason}"
        yield from self._arm_questions()
        if self.floats:
            yield from self._thruster_questions()

    def _arm_questions(self) -> Iterator[str]:
        """Ask whether arms that may be heads or fins are some, and whether joints that are called sensors
        are none where no arm is there, or where they are called an arm, too.
        """
        requested = self._requested_joints()
        doubtful = [name for name in self.roles.short_arms if self._is_free(name, requested)]
        if doubtful:
            yield (
                f"joint {', '.join(doubtful)}: a short arm, and nothing on it is called a tool; of a"
                " fin, a hatch, a winch or a head give --lock JOINT=0, which holds it still"
            )
        endless = [name for name in self.roles.endless_ends if self._is_free(name, requested)]
        if endless:
            yield (
                f"joint {', '.join(endless)}: turns without end at the end of an arm, taken for a"
                " wrist; of a drill, a brush or alike give --lock JOINT=0, which holds it still"
            )
        heads = [name for name in self.roles.likely_heads if self._is_free(name, requested)]
        if heads:
            yield (
                f"joint {', '.join(heads)}: taken for an arm, and ends in what is called a sensor; of a"
                " head give --lock JOINT=0, which holds it still"
            )
        has_arm = bool(self.tools or self.roles.candidates)
        words = NameWords(self.models.model)
        sensors = list[str]()
        for name in self.roles.sensors:
            is_alike = not has_arm or words.is_called("arm", name)
            if is_alike and name in self.reading.lock:
                sensors.append(name)
        if sensors:
            yield (
                f"joint {', '.join(sensors)}: moves what is called a sensor, and is held still;"
                " --tool LINK makes an arm of it"
            )

    def _requested_joints(self) -> set[str]:
        """Return the names of the joints that move the tools that the user named."""
        model = self.models.model
        requested = set[str]()
        for tool in self.requested_tools:
            if model.existFrame(tool):
                carrier = model.frames[model.getFrameId(tool)].parentJoint
                requested.update(model.names[k] for k in model.supports[carrier])
        return requested

    def _is_free(self, joint: str, requested: set[str]) -> bool:
        """Check whether a joint moves, and the user said nothing about it."""
        return joint not in requested and joint not in self.reading.lock

    def _axis_question(self) -> Iterator[str]:
        """Ask whether z points down, where something speaks for it."""
        if not self.floats:
            return
        model = self.models.model
        volume = 0.0  # [m3]
        moment = np.zeros(3)  # [m4]
        for link in self.simulator.links:
            stated = self.stated_of(link)
            if "centre_of_buoyancy" in stated and model.existFrame(link):
                frame = model.frames[model.getFrameId(link)]
                if frame.parentJoint == 1:
                    centre = frame.placement.act(np.array(stated["centre_of_buoyancy"]))
                    volume += stated["volume"]
                    moment += stated["volume"] * centre
        buoyancy = moment / volume if volume > 0.0 else None
        shapes = self.models.collision if self.models.collision.ngeoms else self.models.visual
        signs = list(signs_of_z_down(model, shapes, buoyancy))
        if signs:
            yield f"axes: does z point down? {'; '.join(signs)}; it is flown with z up; {TURN}"

    def _base_question(self) -> str:
        if self.floats:
            kind = "a vehicle, as its root is the heaviest part"
            alternative = "fixed"
        else:
            kind = "an arm that stands on something"
            alternative = "free_flyer"
        return f"base: taken for {kind}; --base {alternative} if it is not"

    def _thruster_questions(self) -> Iterator[str]:
        words = NameWords(self.models.model)
        fins = [name for name in self.roles.propellers if words.is_called("fin", name)]
        steering = [*self.roles.gimbals, *fins]
        if steering:
            yield (
                f"joint {', '.join(steering)}: turns thrusters or the flow, which is not modelled;"
                " it is held still"
            )
        moving = list[str]()
        for _, link in self._links_called("propeller"):
            joint = self.models.model.frames[link.parentFrame].name
            is_moved = link.parentJoint > 1 and joint not in self.roles.spinners
            if is_moved and not words.is_called("fin", link.name):
                moving.append(link.name)
        if moving:
            yield (
                f"link {', '.join(moving)}: a thruster on a link that moves is not modelled; it is"
                " left out"
            )
        doubtful = [thruster.name for thruster in self.thrusters if thruster.is_doubtful]
        if doubtful:
            yield (
                f"thruster {', '.join(doubtful)}: called otherwise than the others; if it is none,"
                " take it out of `thrusters` in hydrodynamics.yaml"
            )
        if not self.thrusters:
            yield (
                "thrusters: no link or joint is called one; write them into the file, or fly with"
                " --plant kinematic"
            )

    def content(self, links: dict[str, Any]) -> dict[str, Any]:
        """Return the values of the file, with these of `links`."""
        content: dict[str, Any] = {"base": "free_flyer" if self.floats else "fixed"}
        content["water_density"] = self.water_density
        if self.floats and self.roles.base != "base_link":
            content["base_link"] = self.roles.base
        if len(self.tools) == 1:
            content["tool"] = self.tools[0]
        elif self.tools:
            content["tool"] = self.tools
        if self.altimeter:
            content["altimeter"] = self.altimeter
        if self.dvl:
            content["dvl"] = self.dvl
        content["loading"] = self._loading()
        if self.floats:
            content["vehicle_limits"] = {
                "velocity": [0.5, 0.4, 0.4, 0.4, 0.4, 0.5],
                "acceleration": [0.3] * 3 + [0.4] * 3,
            }
        model = self.models.model
        joints = limits.joints_of(model, free_flyer=self.floats)
        moved = _moved_inertias(model)
        content["joints"] = {joint.name: _motor(model, joint, moved) for joint in joints}
        content["links"] = links
        if self.thrusters:
            content["thrusters"] = self._thruster_entries()
        return content

    def _loading(self) -> dict[str, Any]:
        """Return how the URDF is read, as far as that is not the default."""
        loading = dict[str, Any]()
        if self.reading.mimic not in ("coupled", None):
            loading["mimic"] = self.reading.mimic
        if self.reading.lock:
            loading["lock"] = dict(self.reading.lock)
        if self.reading.drop:
            loading["drop"] = self.reading.drop
        if not self.reading.meshes:
            loading["meshes"] = "no"
        return loading

    def _thruster_entries(self) -> list[dict[str, Any]]:
        model = self.models.model
        mass = sum(inertia.mass for inertia in model.inertias)
        thrust = max(_THRUST_PER_ROOT_MASS * np.sqrt(mass), _THRUST_PER_MASS * mass)
        limit = float(f"{thrust:.2g}")  # [N]
        X_FB = model.frames[model.getFrameId(self.roles.base)].placement.inverse()
        entries = list[dict[str, Any]]()
        for thruster in self.thrusters:
            entry = {
                "name": thruster.name,
                "link": self.roles.base,
                "position": rounded(X_FB.act(thruster.X.translation)),
                "direction": rounded(X_FB.rotation @ thruster.direction),
                "minimum": -limit if thruster.minimum is None else thruster.minimum,
                "maximum": limit if thruster.maximum is None else thruster.maximum,
                "time_constant": thruster.time_constant or _TIME_CONSTANT,
            }
            entries.append(entry)
        return entries


def _moved_inertias(model: pin.Model) -> np.ndarray:
    """Return the inertia (n_v,) [kg, kg m2] that each joint alone moves, in the neutral posture."""
    M = pin.crba(model, model.createData(), pin.neutral(model))
    return np.asarray(np.diag(M))


def _motor(model: pin.Model, joint: limits.Joint, moved: np.ndarray) -> dict[str, float]:
    """Return half a second to full speed, and the rotor that full effort brings there in `SPIN_UP`,
    whatever the gear, but no larger than what it moves: it would hide the arm and its load.
    """
    speed = float(model.upperVelocityLimit[joint.idx_v])
    effort = float(model.upperEffortLimit[joint.idx_v])
    if not 0.0 < speed < 10.0:
        return {"acceleration": 1.0}
    motor = {"acceleration": float(f"{2.0 * speed:.3g}")}
    if 0.0 < effort < 1e4:
        moving_mass = mass(model)
        smallest = min(_SMALLEST_ROTOR, _ROTOR_SHARE * moving_mass * size(model) ** 2)
        if joint.slides:
            smallest = min(_SMALLEST_SLIDE, _SLIDE_SHARE * moving_mass)
        largest = max(float(moved[joint.idx_v]), smallest)
        rotor = min(SPIN_UP * effort / speed, largest)
        motor["rotor_inertia"] = float(f"{rotor:.3g}")
    return motor
