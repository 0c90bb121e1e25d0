"""What sends a mission into its abort phase: lost sensors, contact, too little thrust, no progress."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from uvms_ocp.control.navigation.degraded import ALTIMETER, told
from uvms_ocp.control.velocity.tick_state import TickState
from uvms_ocp.mission.abort import Abort
from uvms_ocp.mission.conditions import Below
from uvms_ocp.mission.mission import Mission
from uvms_ocp.mission.phase import MissionState
from uvms_ocp.model.robot import Robot
from uvms_ocp.tasks.altitude import MinimumAltitude

_PROGRESS = 0.02  # share of what is missing to a limit that counts as progress


@dataclass(frozen=True, kw_only=True, slots=True)
class Strain:
    """What the force layer met in the last tick."""

    short: bool = False
    """The limits of the thrusters kept them from what was asked for."""
    push: float = 0.0
    """[-] upward force on the vehicle that the model does not know, as a share of the largest of the thrusters."""
    fault: str = ""
    """Of thrusters or joints, without which the mission cannot go on."""
    handicap: str = ""
    """All that is known to be faulty of them, such as ``thruster3 dead``."""
    jammed: tuple[int, ...] = ()
    """Axes of v [-] that do not move whatever is asked."""


class Distress:
    """Why the mission is to be given up, asked at every tick. Remembers since when: build one per run."""

    def __init__(self, mission: Mission) -> None:
        self._mission = mission
        self._high = [i for i, task in enumerate(mission.hierarchy.tasks) if isinstance(task, MinimumAltitude)]
        self._waits = [
            [c for transition in phase.transitions for c in transition.when if isinstance(c, Below)]
            for phase in mission.all_phases
        ]
        self._since: dict[str, float] = {}
        """[s] since when what is told by its name has been so."""
        self._began = -math.inf
        """[s] the start of the phase that `_best` belongs to."""
        self._best: dict[str, float] = {}
        """[unit of the quantity] by quantity, the least that was missing to its limit in this phase."""

    def reason(self, tick: TickState, quantities: Mapping[str, float], strain: Strain) -> str:
        """Empty while there is none. quantities [in their units]: NaN where not known. Names what is faulty."""
        why = self._reason(tick, quantities, strain)
        return f"{why}; {strain.handicap}" if why and strain.handicap not in why else why

    def _reason(self, tick: TickState, quantities: Mapping[str, float], strain: Strain) -> str:
        abort, state = self._mission.abort, tick.mission
        if abort is None:
            return strain.fault
        if state.why:
            over = tick.t - state.since > abort.time_limit
            return f"{abort.time_limit:g} s were not enough for it" if over else self._hopeless(tick)
        return (
            self._hopeless(tick)
            or tick.restriction.abort
            or strain.fault
            or self._met(abort, tick, strain)
            or self._stalled(abort, tick, quantities)
        )

    def pushed(self, tick: TickState, strain: Strain) -> bool:
        """Something under the vehicle bears it where it should be well above the floor."""
        abort = self._mission.abort
        return abort is not None and bool(tick.gates[self._high].any()) and strain.push > abort.contact

    def _hopeless(self, tick: TickState) -> str:
        """Where the thrust is cut, and somebody judges why."""
        return (tick.restriction.abort or told(tick.restriction.lost)) if tick.stopped else ""

    def _met(self, abort: Abort, tick: TickState, strain: Strain) -> str:
        if self._lasts("contact", self.pushed(tick, strain), tick.t, abort.contact_after):
            lift = f"{100 * strain.push:.0f} % of the thrusters' lift"
            return f"contact or rising water: pushed up by {lift} for {abort.contact_after:g} s"
        if self._lasts("thrust", strain.short, tick.t, abort.thrust_after):
            return f"thrust: the thrusters have been at their limits for {abort.thrust_after:g} s"
        return ""

    def _stalled(self, abort: Abort, tick: TickState, quantities: Mapping[str, float]) -> str:
        waiting = not self._progresses(tick.mission, quantities)
        if not self._lasts("stall", waiting, tick.t, abort.stall_after):
            return ""
        doubt = ", ".join(sorted(tick.restriction.doubted))
        without = f" without {doubt}" if doubt else ""
        return (
            f"stall: {self._mission.pending(tick.mission, quantities)}, no nearer for {abort.stall_after:g} s{without}"
        )

    def _lasts(self, what: str, so: bool, t: float, patience: float) -> bool:
        if not so:
            self._since[what] = t
        return t - self._since.setdefault(what, t) > patience

    def _progresses(self, state: MissionState, quantities: Mapping[str, float]) -> bool:
        """Whether something that the phase waits for has come nearer, or nothing is missing."""
        if state.since != self._began:
            self._began, self._best = state.since, {}
            self._since.pop("stall", None)
        waiting, nearer = False, False
        for condition in self._waits[state.phase]:
            gap = quantities[condition.quantity] - condition.limit
            if not gap < 0.0:
                waiting = True
                if gap < (1.0 - _PROGRESS) * self._best.get(condition.quantity, math.inf):
                    self._best[condition.quantity], nearer = gap, True
        return nearer or not waiting


def climb_goal(mission: Mission, tick: TickState, *, robot: Robot, floor: float) -> pin.SE3 | None:
    """Where the abort phase climbs to from where the robot is: straight up, upright; None where that cannot be known.

    floor [m]: z in W of the highest that is known, NaN where none is to be believed.
    """
    if mission.abort is None or tick.stopped:
        return None
    # No `Kinematics`: what sends the robot here may show joints beyond their limits.
    data, frame = robot.model.createData(), robot.frame_id(mission.climb_frame)
    pin.framesForwardKinematics(robot.model, data, tick.measurement.q)
    X_WF = data.oMf[frame]
    here, altitude = float(X_WF.translation[2]), mission.abort.altitude
    believed = math.isfinite(floor) and ALTIMETER not in tick.restriction.doubted
    z = max(here, floor + altitude) if believed else here + altitude
    yaw = float(pin.rpy.matrixToRpy(X_WF.rotation)[2])
    return pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, yaw), np.array([*X_WF.translation[:2], z]))
