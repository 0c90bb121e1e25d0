"""The health of all thrusters and joints of a robot in words, and as telemetry."""

from __future__ import annotations

from typing import Any

import numpy as np

from uvms_ocp.control.actuator_health.authority import Authority, authority_in
from uvms_ocp.control.actuator_health.verdicts import (
    JointVerdict,
    ThrusterVerdict,
    joint_alarm,
    joints_named,
    thruster_alarm,
    thrusters_named,
)
from uvms_ocp.control.actuator_health.watch_memory import joint_verdicts, thruster_verdicts
from uvms_ocp.model.robot import Robot


class ActuatorMonitor:
    """Says what an `ActuatorLook` finds, and logs it in `alarms`."""

    def __init__(self, robot: Robot, memory: Any, alarms: list[tuple[float, str]]) -> None:
        """memory: the `ActuatorLook`; alarms: time [s] and text of each, appended to."""
        self._robot, self._memory, self.alarms = robot, memory, alarms
        self.thrusters: list[ThrusterVerdict] = []
        """Verdicts on each."""
        self.joints: list[JointVerdict] = []
        """Likewise."""
        self.authority: Authority | None = None
        """What thrusters can still reach; `None` while all are sound, and until that is judged."""
        self._told: dict[str, Any] = {}
        self._refresh()

    @property
    def faulty(self) -> str:
        """All that is faulty, in a few words; nothing where nothing is."""
        return ", ".join((*thrusters_named(self.thrusters), *joints_named(self.joints)))

    def hear(self, t: float) -> None:
        """What the look at time t [s] has changed."""
        self._refresh()
        names, thrusters, i = self._robot.joint_names, self._robot.description.thrusters, self._memory.thruster
        for j in range(len(self.joints)):
            if self._memory.joints.found[j]:
                self.alarms.append((t, joint_alarm(j + 1, names[j])))
        if i >= 0:
            self.alarms.append((t, thruster_alarm(i + 1, thrusters[i].name, self.thrusters[i])))
        if self._memory.judgement:
            self.authority = authority_in(self._memory.authority)
            end = "" if self.authority.can_go_on else "; the mission cannot go on"
            self.alarms.append((t, f"without {self.faulty}: {self.authority}{end}"))

    def telemetry(self) -> dict[str, Any]:
        """For the record: shares (n_thrusters,) [-], constants (n_thrusters,) [N], verdicts as whole numbers."""
        return self._told

    def _refresh(self) -> None:
        memory, n = self._memory, len(self._robot.description.thrusters)
        self.thrusters = thruster_verdicts(memory.thrusters, memory.effect, n)
        self.joints = joint_verdicts(memory.joints)
        self._told = {
            "thruster_share": np.array(memory.effect.share[:n]),
            "thruster_constant": np.array(memory.effect.constant[:n]),
            "thruster_health": np.array([verdict.health for verdict in self.thrusters], dtype=np.int8),
            "joint_health": np.array([verdict.health for verdict in self.joints], dtype=np.int8),
        }
