"""One tick of the kinematic layer but for the hierarchy: what is known, `before` it, and what comes of it, `after`.

Between the two the hierarchy is solved.
"""

from __future__ import annotations

import math

from uvms_ocp.control.navigation.degraded import restrict
from uvms_ocp.control.navigation.last_known import echo_range, last_sound, look_down
from uvms_ocp.control.navigation.watchdog import Freshness, verdict_on
from uvms_ocp.control.velocity.climb import aim
from uvms_ocp.control.velocity.distress import Why, distress_of
from uvms_ocp.control.velocity.nearest import look_ahead, measure
from uvms_ocp.control.velocity.parameters import take_goals
from uvms_ocp.control.velocity.restraint import restrain
from uvms_ocp.control.velocity.stop import set_out, step_on
from uvms_ocp.control.velocity.tick.layout import TickMemory
from uvms_ocp.control.velocity.viability import comes_near, keep
from uvms_ocp.mission.progress import NONE, follow, gates_at, give_up, is_over, transition_due
from uvms_ocp.model.health import Trust


def _begin(m: TickMemory) -> None:
    """External activations, which tell whether the altitude matters."""
    gates_at(m.mission, m.t, m.gates)
    m.altitude_matters = False
    for i in range(len(m.gates)):
        m.altitude_matters = m.altitude_matters or (m.reads_altitude[i] != 0 and m.gates[i] != 0.0)


def before(m: TickMemory) -> None:
    """What is known, from the measurement and the channels that are not good."""
    last_sound(m.sound, m.t, m.q, m.v, m.age, m.joint_age)
    m.age = m.sound.age
    m.joint_age = m.sound.joint_age
    look_down(m.beam, m.q)
    _begin(m)
    take_goals(m.goals, m.mission, m.climb, m.t)
    restrict(m.restriction, m.t, m.altitude_matters)
    doubted = _doubts_altimeter(m)
    lowest, lower = 0.0, False
    for i in range(len(m.gates)):
        if m.restriction.no_descent and m.lands[i] != 0:
            m.gates[i] = 0.0
        if m.reads_altitude[i] != 0 and m.gates[i] > 0.0 and (not lower or m.rest_altitude[i] < lowest):
            lowest = m.rest_altitude[i]
            lower = True
    m.echo[0] = echo_range(m.beam, m.t, m.altimeter_range, lowest, doubted)
    m.altitude_known = math.isfinite(m.beam.floor) and m.t - m.beam.since <= m.hold_after
    # Joints that brakes hold are where they were.
    braked = m.restriction.joints_held and math.isfinite(m.age) and m.joint_age >= m.age
    age = 0.0 if braked else m.age
    echo_age = m.t - m.beam.since if m.altitude_matters and not doubted else 0.0
    m.echo_is_oldest = echo_age > age
    m.oldest = max(age, echo_age)
    m.freshness = verdict_on(m.oldest, m.hold_after, m.stop_after)
    m.holds = is_blind(m) or m.restriction.hold or (m.restriction.ended and not m.distress.aborts)
    for i in range(len(m.previous)):
        m.previous[i] = m.command[i] / m.pace
    _measure_distances(m)


def _measure_distances(m: TickMemory) -> None:
    """For tasks that are on or begin; on the way to rest where that could come near a limit."""
    target, looked = m.mission.targets[m.mission.phase], False
    for k in range(m.nearest.n_asking):
        i = m.nearest.pairs[k].task
        if target[i] != 0.0 or m.gates[i] != 0.0:
            if not looked:
                least = m.rule.stop.dt if m.near else math.inf
                look_ahead(m.nearest, m.q, m.command, m.rule.stop.acceleration, least)
                looked = True
            measure(m.nearest, k, m.goals.values)


def after(m: TickMemory) -> None:
    """What the tick comes to, after the hierarchy is solved: what is told, the velocity, and where the mission goes."""
    _report(m)
    if m.holds:
        _come_to_rest(m)
    else:
        _choose(m)
    m.why = Why.NOTHING
    m.due = NONE
    m.eventful = False
    if not is_over(m.mission):
        _judge(m)


def _judge(m: TickMemory) -> None:
    """Go on with the mission, or give it up."""
    less, stopped = m.restriction, is_stopped(m)
    hopeless = stopped and (less.ended or less.any_lost)
    m.why = distress_of(m.distress, m.mission, m.t, m.gates, m.told, hopeless, less.ended)
    if m.why != Why.NOTHING:
        m.eventful = True
        if not m.mission.given_up:
            _climb(m)
        give_up(m.mission, m.t, not stopped)
    elif not m.holds:
        m.due = transition_due(m.mission, m.t, m.told)
        m.eventful = m.due != NONE or m.mission.changed
        if m.due != NONE:
            follow(m.mission, m.t, m.due)


def _climb(m: TickMemory) -> None:
    """What would be climbed to: above the highest floor, where that is to be believed."""
    believed = not (m.distress.pushed or _doubts_altimeter(m))
    aim(m.climb, m.q, m.beam.highest if believed else math.nan)


def _doubts_altimeter(m: TickMemory) -> bool:
    return m.restriction.level[m.channel[m.altimeter]] != Trust.GOOD


def is_blind(m: TickMemory) -> bool:
    """As that of `TickState`."""
    return m.freshness != Freshness.FRESH or m.restriction.blind


def is_stopped(m: TickMemory) -> bool:
    """As that of `TickState`."""
    return m.freshness == Freshness.LOST or (m.restriction.ended and not m.restriction.climbs)


def take(m: TickMemory) -> None:
    """The velocity that is wanted is commanded."""
    for i in range(len(m.command)):
        m.change[i] = m.wanted[i] / m.wanted_pace - m.previous[i]
        m.command[i] = m.wanted[i]
    m.pace = m.wanted_pace


def is_unknown(age: float, of_altitude: bool, altitude_known: bool) -> bool:
    """Whether a quantity is NaN: before the first measurement, and where it rests on an altitude that only stands in for one.

    age [s]: of the measurement.
    """
    return age == math.inf or (of_altitude and not altitude_known)


def _report(m: TickMemory) -> None:
    """What is known of the quantities.

    Phases are told less: nothing that rests on a channel that is not good, but in the abort phase the best there is.
    """
    of_altitude = m.rests_on[m.altimeter]
    for i in range(len(m.quantities)):
        unknown = is_unknown(m.age, of_altitude[i] != 0, m.altitude_known)
        m.reported[i] = math.nan if unknown else m.quantities[i]
        m.told[i] = m.reported[i]
    for k in range(len(m.channel)):
        channel = m.rests_on[k]
        for i in range(len(m.quantities)):
            if m.restriction.level[m.channel[k]] != Trust.GOOD and channel[i] != 0 and not m.mission.given_up:
                m.told[i] = math.nan
    for i in range(len(m.quantities)):
        if not m.holds:
            m.last_told[i] = m.told[i]


def _come_to_rest(m: TickMemory) -> None:
    """Along the stop that the last tick with a measurement has found clear."""
    way = m.rule.stop
    set_out(way, m.place, m.command)
    step_on(way)
    for i in range(len(m.place)):
        m.place[i] = way.q[i]
    for i in range(len(m.command)):
        m.change[i] = (way.v[i] - m.command[i]) / m.pace
        m.command[i] = way.v[i]
    m.share = 0.0


def _choose(m: TickMemory) -> None:
    """The velocity that is wanted, as far as the limits on positions let it be taken."""
    for i in range(len(m.place)):
        m.place[i] = m.q[i]
    _want(m)
    m.near = comes_near(m.rule, m.wanted, m.gates, m.quantities)
    m.share = keep(m.rule, m.q, m.command, m.wanted, m.gates, m.quantities) if m.near else 1.0
    take(m)


def _want(m: TickMemory) -> None:
    """The velocity that the tasks ask for, within what the limits of each axis and the restrictions leave."""
    m.wanted_pace = m.pace
    if m.usable:
        _shorten(m)
        if m.restriction.any_bad or m.pace != 1.0:
            m.wanted_pace = restrain(m.restraint, m.restriction, m.beam, m.q, m.command, m.pace, m.wanted)
    else:
        _brake(m)
    for i in range(len(m.wanted)):
        # From rest at every tick: the hierarchy counts on no more than one tick's acceleration of such a joint.
        if m.jammed[i] != 0:
            m.wanted[i] = 0.0


def _shorten(m: TickMemory) -> None:
    """The solver's velocity, shortened to the velocity limits with its direction kept."""
    excess = 1.0
    for i in range(len(m.solved)):
        excess = max(excess, abs(m.solved[i]) / m.velocity_limit[i])
    for i in range(len(m.solved)):
        m.wanted[i] = m.solved[i] / excess


def _brake(m: TickMemory) -> None:
    """One tick nearer to rest."""
    for i in range(len(m.wanted)):
        step = m.restraint.step[i]
        m.wanted[i] = m.command[i] - min(max(m.command[i], -step), step)
