"""What the monitor does in a tick: before the filter, and after it."""

from __future__ import annotations

import math

from uvms_ocp.control.navigation.filter.memory import Channel
from uvms_ocp.control.navigation.health.channel_state import doubt, hear, is_barred, pass_empty, refuse, settle, use
from uvms_ocp.control.navigation.health.cross_checks import compare
from uvms_ocp.control.navigation.health.health_memory import ChannelMemory, HealthMemory
from uvms_ocp.control.navigation.health.laws.history import remember, slot_at
from uvms_ocp.control.navigation.health.laws.still_encoders import ask
from uvms_ocp.control.navigation.health.reading_checks import is_empty, is_stubborn, look_at
from uvms_ocp.control.navigation.health.reasons import Reason
from uvms_ocp.control.navigation.health.repeated import Repeated, repeat
from uvms_ocp.control.navigation.health.support import Support, age_by_support, tell_echo
from uvms_ocp.functions.kernels.layout import Vector

_TOLD = 4  # numbers of an outcome
_ADRIFT = 1.0  # [s] for which a velocity may be carried on by itself


def vet(m: HealthMemory, t: float, moving: bool) -> None:
    """Look at the fresh readings at time t [s]; moving: there was a command, and no brakes."""
    _begin(m, t)
    ask(m.encoders, moving, m.dt)
    m.n_behind = 0
    for k in range(m.n):
        c = m.channels[m.order[k]]
        if c.fresh:
            _vet_newest(m, c)
        if c.behind:
            m.n_behind += 1
    m.adrift = _is_adrift(m)
    m.adrift_at = t if m.adrift else m.adrift_at


def _begin(m: HealthMemory, t: float) -> None:
    m.dt = max(t - m.t, 0.0) if m.started else 0.0
    m.t = t
    m.started = True
    m.exposed = False


def _is_adrift(m: HealthMemory) -> bool:
    """Whether neither fixes nor a DVL have told the velocity for a while, since that was last so."""
    last = max(_last_told(m.channels[Channel.POSITION]), _last_told(m.channels[Channel.LINEAR_VELOCITY]))
    return last >= 0.0 and m.t - max(last, m.adrift_at) > _ADRIFT


def _last_told(c: ChannelMemory) -> float:
    """When [s], -1 before the first and without the channel."""
    return -1.0 if not c.present or math.isnan(c.taken) else c.taken


def judge(m: HealthMemory, t: float, known: bool) -> int:
    """The verdicts at time t [s]; known: `now` is an estimate. Returns how many changed [-]."""
    m.t = t
    m.now.t = t
    if known:
        remember(m.history, m.now)
    n = 0
    for k in range(m.n):
        if settle(m, m.channels[m.order[k]]):
            n += 1
    return n


def conclude(m: HealthMemory, s: Support, outcomes: Vector, t: float) -> int:
    """After the filter: its outcomes (36,), four numbers per channel, what the estimate `now` rests on, and the verdicts.

    t [s] is the time of the tick. Returns how many verdicts changed [-].
    """
    if s.gating:
        _hear_all(m, outcomes)
    return _settle_all(m, s, t)


def take(m: HealthMemory, s: Support, r: Repeated, t: float, moving: bool) -> int:
    """`vet` at time t [s], and `conclude` of the readings that are used, taken for the truth."""
    vet(m, t, moving)
    repeat(m, r)
    return _settle_all(m, s, t)


def _settle_all(m: HealthMemory, s: Support, t: float) -> int:
    age_by_support(m, s)
    n = judge(m, t, s.age < math.inf)
    tell_echo(m, s)
    return n


def _vet_newest(m: HealthMemory, c: ChannelMemory) -> None:
    c.fresh = False
    c.behind = True
    if not c.started or c.stamp != c.seen:
        c.started = True
        c.seen = c.stamp
        _vet_new(m, c)
    c.misshapen = 0
    if not c.behind:
        for i in range(c.size):
            c.used_value[i] = c.value[i]


def _vet_new(m: HealthMemory, c: ChannelMemory) -> None:
    slot, barred, b = slot_at(m.history, c.stamp), is_barred(c, m.t), m.belief
    look_at(m, c, slot)
    if not b.used:
        refuse(c, b.why, m.t)
    elif not barred and is_empty(c):
        pass_empty(c)
    elif not barred:
        use(c, m.t)
    if b.used and b.why.code != Reason.NONE:
        doubt(c, b.why, m.t)
    # Fixes are heard even where the estimate contradicts them, as it may err, and so is a DVL that insists.
    heard = b.used or (b.sane and (barred or c.number == Channel.POSITION or is_stubborn(c)))
    if heard and slot >= 0 and not is_empty(c):
        compare(m, c, m.history.kept[slot])


def _hear_all(m: HealthMemory, outcomes: Vector) -> None:
    """Every outcome once."""
    for k in range(m.n):
        number = m.order[k]
        c, at = m.channels[number], _TOLD * number
        if outcomes[at] > c.heard:
            c.heard = outcomes[at]
            hear(m, number, outcomes[at + 1], outcomes[at + 2], outcomes[at + 3] > 0.0, m.t)
