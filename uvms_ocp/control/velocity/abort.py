"""Decide when a mission is aborted, and where the emergency ascent leads."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Annotated

from uvms_ocp.codegen.kernel_layout import Layout, Sized, Vector, assign
from uvms_ocp.control.velocity.tick_state import TickInputs
from uvms_ocp.estimation import degraded_modes
from uvms_ocp.mission import Mission
from uvms_ocp.mission.progress import MissionMemory, always_grows
from uvms_ocp.robot import signals
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import SAME_TIME
from uvms_ocp.robot.size import size, time_unit
from uvms_ocp.tasks.altitude import MinimumAltitude

_PROGRESS = 0.02  # share of what is missing to a limit that counts as progress
# in the floor, where a mission states no depth: sizes of the robot, and [m] at most
_SUNK = (0.125, 0.03)
_SUNK_AFTER = 0.5  # [s] for which arm or hull must be in the floor to be believed
_GROWTH = 0.1  # share of an error by which it grows where the robot runs away
# time units of the robot, such as 10 s for 15 kg; crests are remembered for one to two of it: a swing has one in
# each
_CREST_SPAN = 63.0


@dataclass(frozen=True, kw_only=True, slots=True)
class ActuationFeedback:
    """Feedback of the force layer on the last tick."""

    short: bool = False
    """The limits of the thrusters kept them from what was asked for."""
    at_limits: str = ""
    """Thrusters that were at their limits when they last did."""
    push: float = 0.0
    """Upward force on the vehicle that the model does not know, as a share of the largest of the
    thrusters.
    """
    spent: float = 0.0
    """[J] Electrical energy used so far; NaN where it is not known."""
    fault: str = ""
    """Fault of thrusters or joints without which the mission cannot go on."""
    fault_summary: str = ""
    """Thrusters and joints that are known to be faulty, such as ``thruster3 dead``; empty where all
    are sound.
    """
    jammed: tuple[int, ...] = ()
    """Axes of v that do not move whatever is asked."""


class AbortReason(IntEnum):
    """Reason to give the mission up, by its code."""

    NOTHING = 0
    FAULT = 1
    LATE = 2
    HOPELESS = 3
    ENDED = 4
    CONTACT = 5
    THRUST = 6
    STALL = 7
    RUNAWAY = 8
    FLOOR = 9


class AbortMemory(Layout):
    """Memory of the abort monitor: its thresholds, the feedback of the force layer, and since when
    [s] each holds.
    """

    aborts: bool
    """True where the mission has an abort phase."""
    time_limit: float
    """[s] `Abort.time_limit`."""
    stall_after: float
    """[s] time without progress after which the mission stalls."""
    thrust_after: float
    """[s] time with thrusters at their limits after which thrust is short."""
    runaway_after: float
    """[s] time for which errors may grow at the thrusters' limits."""
    contact: float
    """Upward force that the model does not know, as a share of the largest of the thrusters, from
    which on something bears the vehicle.
    """
    contact_after: float
    """[s] time for which something may bear the vehicle where it should be well above the floor."""
    sunk: float
    """[m] in the floor, from which on a hull, joint or tool counts as sunk."""
    sunk_since: float
    """[s] time since when something has been deeper in the floor than `sunk`; NaN: not asked yet.
    """
    high: Annotated[list[int], Sized("n_tasks")]
    """(n_tasks,) 1 for tasks that keep the robot well above the floor."""
    short: bool
    """True where the limits of the thrusters kept them from what was asked for."""
    fault: bool
    """True where the force layer has reported a fault without which the mission cannot go on."""
    push: float
    """Upward force on the vehicle that the model does not know, as a share of the largest of the
    thrusters.
    """
    spent: float
    """[J] electrical energy used so far; NaN where it is not known."""
    pushed: bool
    """Something under the vehicle bears it where it should be well above the floor."""
    contact_since: float
    """[s] time since when something under the vehicle bears it; NaN: not asked yet."""
    thrust_since: float
    """[s] time since when thrust is short; NaN: not asked yet."""
    stall_since: float
    """[s] time since when there is no progress; NaN: not asked yet."""
    runaway_since: float
    """[s] time since when no error has shrunk; NaN: not asked yet."""
    ticks: int
    """Ticks since `runaway_since`."""
    short_ticks: int
    """Ticks since `runaway_since` with thrusters at their limits."""
    held: Annotated[Vector, Sized("n_quantities")]
    """(n_quantities,) [unit of the quantity] values at `runaway_since`."""
    crest: Annotated[Vector, Sized("n_quantities")]
    """(n_quantities,) [unit of the quantity] largest values in the two spans until `runaway_since`.
    """
    crest_span: float
    """[s] for which crests are remembered at least."""
    span_since: float
    """[s] since when the present span of `crest_span` lasts."""
    span_crest: Annotated[Vector, Sized("n_quantities")]
    """(n_quantities,) [unit of the quantity] largest values in the present span."""
    last_crest: Annotated[Vector, Sized("n_quantities")]
    """(n_quantities,) [unit of the quantity] largest values in the span before."""
    began: float
    """[s] start of the phase that `best` belongs to."""
    best: Annotated[Vector, Sized("n_quantities")]
    """(n_quantities,) [unit of the quantity] smallest distance to its limit in this phase."""


def abort_reason(
    abort: AbortMemory,
    mission: MissionMemory,
    t: float,
    gates: Vector,
    quantities: Vector,
    hopeless: bool,
    ended: bool,
    clearance: float,
) -> int:
    """Return the `AbortReason` to give up the mission at t [s]. A kernel. clearance [m]: above the
    floor, NaN for unknown.

    gates, quantities [in their units], NaN where not known. hopeless: the thrust is cut, and the
    health monitor has judged why. ended: the restriction by sensors that are lost ends the mission.
    """
    abort.pushed = abort.aborts and abort.push > abort.contact and _is_high(abort, gates)
    if not abort.aborts:
        if abort.fault:
            return AbortReason.FAULT
        return AbortReason.NOTHING
    if mission.given_up:
        if t - mission.since > abort.time_limit + SAME_TIME:
            return AbortReason.LATE
        if hopeless:
            return AbortReason.HOPELESS
        return AbortReason.NOTHING
    if hopeless or ended or abort.fault:
        if hopeless:
            return AbortReason.HOPELESS
        if ended:
            return AbortReason.ENDED
        return AbortReason.FAULT
    abort.sunk_since = _since(clearance < -abort.sunk, abort.sunk_since, t)
    if t - abort.sunk_since > _SUNK_AFTER + SAME_TIME:
        return AbortReason.FLOOR
    abort.contact_since = _since(abort.pushed, abort.contact_since, t)
    if t - abort.contact_since > abort.contact_after + SAME_TIME:
        return AbortReason.CONTACT
    abort.thrust_since = _since(abort.short, abort.thrust_since, t)
    if t - abort.thrust_since > abort.thrust_after + SAME_TIME:
        return AbortReason.THRUST
    if _runs_away(abort, mission, t, quantities):
        return AbortReason.RUNAWAY
    waits = not _progresses(abort, mission, quantities)
    abort.stall_since = _since(waits, abort.stall_since, t)
    if t - abort.stall_since > abort.stall_after + SAME_TIME:
        return AbortReason.STALL
    return AbortReason.NOTHING


def _since(so: bool, since: float, t: float) -> float:
    """Return the time [s] since when a condition holds: t where it holds no longer, or did not
    before.
    """
    if so and not math.isnan(since):
        return since
    return t


def _is_high(abort: AbortMemory, gates: Vector) -> bool:
    """Return whether the robot should be well above the floor."""
    is_high = False
    for i in range(len(abort.high)):
        is_high = is_high or (abort.high[i] != 0 and gates[i] != 0.0)
    return is_high


def _runs_away(abort: AbortMemory, mission: MissionMemory, t: float, quantities: Vector) -> bool:
    """Return whether an error that the phase waits for has grown for too long, and none fallen, at
    the thrusters' limits.

    An error that swings grows from every trough. It has grown where it exceeds its crests: those of
    a swing that lasts or dies away are no farther than the ones before.
    """
    is_new = mission.since != abort.began or math.isnan(abort.runaway_since)
    _remember_crests(abort, t, quantities, is_new)
    grown = False
    fallen = is_new
    for i in range(mission.first[mission.phase], mission.end[mission.phase]):
        for k in range(mission.first_condition[i], mission.end_condition[i]):
            quantity = quantities[mission.quantity[k]]
            held = abort.held[mission.quantity[k]]
            crest = abort.crest[mission.quantity[k]]
            if mission.below[k] != 0 and not quantity < mission.limit[k]:
                grown = grown or quantity > (1.0 + _GROWTH) * crest
                fallen = fallen or not quantity >= (1.0 - _PROGRESS) * held
    abort.ticks += 1
    abort.short_ticks += 1 if abort.short else 0
    late = not fallen and t - abort.runaway_since > abort.runaway_after + SAME_TIME
    if late and grown and 2 * abort.short_ticks > abort.ticks:
        return True
    if late or fallen:
        abort.runaway_since = t
        abort.ticks = 0
        abort.short_ticks = 0
        abort.held[:] = quantities
        for i in range(len(abort.crest)):
            abort.crest[i] = abort.span_crest[i]
            if abort.last_crest[i] > abort.crest[i]:
                abort.crest[i] = abort.last_crest[i]
    return False


def _remember_crests(abort: AbortMemory, t: float, quantities: Vector, is_new: bool) -> None:
    """Update the largest quantities of the present span and of the one before."""
    if is_new:
        abort.last_crest[:] = quantities
    elif t - abort.span_since > abort.crest_span + SAME_TIME:
        abort.last_crest[:] = abort.span_crest
    if is_new or t - abort.span_since > abort.crest_span + SAME_TIME:
        abort.span_since = t
        abort.span_crest[:] = quantities
    for i in range(len(abort.span_crest)):
        if not quantities[i] <= abort.span_crest[i]:
            abort.span_crest[i] = quantities[i]


def _progresses(abort: AbortMemory, mission: MissionMemory, quantities: Vector) -> bool:
    """Return whether something that the phase waits for to fall has come nearer to its limit, or
    nothing is missing.

    A phase that time or energy alone ends, wherever that leads, does not stall.
    """
    if mission.since != abort.began:
        abort.began = mission.since
        abort.stall_since = math.nan
        for i in range(len(abort.best)):
            abort.best[i] = math.inf
    waiting = False
    nearer = False
    for i in range(mission.first[mission.phase], mission.end[mission.phase]):
        timed = True
        for k in range(mission.first_condition[i], mission.end_condition[i]):
            gap = quantities[mission.quantity[k]] - mission.limit[k]
            timed = timed and mission.below[k] == 0 and always_grows(mission, mission.quantity[k])
            if mission.below[k] != 0 and not gap < 0.0:
                waiting = True
                if gap < (1.0 - _PROGRESS) * abort.best[mission.quantity[k]]:
                    abort.best[mission.quantity[k]] = gap
                    nearer = True
        nearer = nearer or timed
    return nearer or not waiting


class AbortMonitor:
    """Monitor of the reasons to give up the mission. Remembers since when each holds: build one per
    run.
    """

    def __init__(self, mission: Mission, robot: Robot, memory: AbortMemory) -> None:
        """memory: of the kernel, which is set up."""
        self._mission = mission
        self._memory = memory
        abort = mission.abort
        high = [isinstance(task, MinimumAltitude) for task in mission.hierarchy.tasks]
        assign(memory, aborts=abort is not None, began=-math.inf, high=high)
        memory.crest_span = _CREST_SPAN * time_unit(robot.model)
        memory.sunk_since = memory.contact_since = memory.thrust_since = memory.stall_since = (
            memory.runaway_since
        ) = math.nan
        copied = (
            "time_limit",
            "stall_after",
            "thrust_after",
            "runaway_after",
            "contact",
            "contact_after",
        )
        if abort is not None:
            assign(memory, **{name: getattr(abort, name) for name in copied})
            share, deepest = _SUNK
            memory.sunk = abort.sunk or min(share * size(robot.model), deepest)

    def describe(
        self,
        why: AbortReason,
        tick: TickInputs,
        quantities: Mapping[str, float],
        feedback: ActuationFeedback,
    ) -> str:
        """Describe the reason that the kernel found at a tick, from the quantities [in their
        units].
        """
        abort = self._mission.abort
        less = tick.restriction
        if why is AbortReason.FAULT:
            return feedback.fault
        if why is AbortReason.NOTHING or abort is None:
            return ""
        lift = f"{100 * feedback.push:.0f} % of the thrusters' lift"
        pending = self._mission.pending(tick.mission, quantities)
        thrusters = f" ({feedback.at_limits})" if feedback.at_limits else ""
        hopeless = ""
        if tick.stopped:
            hopeless = less.abort or degraded_modes.describe_channels(less.lost)
        texts = {
            AbortReason.CONTACT: (
                f"contact or rising water: pushed up by {lift} for {abort.contact_after:g} s"
            ),
            AbortReason.FLOOR: (
                f"hull or arm {self._memory.sunk:.2g} m in the floor that the altimeter shows, or deeper"
            ),
            AbortReason.LATE: f"{abort.time_limit:g} s were not enough for it",
            AbortReason.HOPELESS: hopeless,
            AbortReason.ENDED: less.abort,
            AbortReason.RUNAWAY: (
                f"runaway: {pending}, and farther than"
                f" {abort.runaway_after:g} s ago, with thrusters at their limits{thrusters}"
            ),
            AbortReason.THRUST: (
                f"thrust: the thrusters have been at their limits for {abort.thrust_after:g}"
                f" s{thrusters}"
            ),
        }
        stall = f"stall: {pending}, no nearer for {abort.stall_after:g} s{_held_back(less.bad)}"
        words = texts.get(why, stall)
        if words and feedback.fault_summary not in words:
            return f"{words}; {feedback.fault_summary}"
        return words


def _held_back(bad: Sequence[signals.ChannelHealth]) -> str:
    """Describe channels that are not good, by reason: many have one in common."""
    channels_by_reason: dict[str, list[str]] = {}
    for health in sorted(bad, key=lambda health: health.channel):
        reason = health.why or health.trust.name.lower()
        channels_by_reason.setdefault(reason, []).append(health.channel)
    if not channels_by_reason:
        return ""
    causes = ", ".join(
        f"{reason} ({', '.join(channels)})" for reason, channels in channels_by_reason.items()
    )
    return (
        f"; sensors that are not good end no phase: {causes}; see to them, or to what the robot's"
        " file says of them"
    )
