"""What is thought of one channel, from complaints, silence and the time without either.

A complaint makes a channel suspect for `HealthTuning.clean` seconds; silence makes it suspect and then lost, and so do
readings that are all refused. A reading that is used ends the loss; nothing is lost for good.
"""

from __future__ import annotations

import math

from uvms_ocp.control.navigation.health.health_memory import ChannelMemory, HealthMemory, Rules
from uvms_ocp.control.navigation.health.reasons import Reason, Why, copy_why, give
from uvms_ocp.model.health import Trust


def use(c: ChannelMemory, t: float) -> None:
    """The filter may see the newest reading at time t [s]; where it has a gate of its own, its outcome is waited for."""
    c.used = c.stamp
    c.empty = False
    c.behind = False
    if not c.gated:
        _take(c, t)


def pass_empty(c: ChannelMemory) -> None:
    """The sensor works but has nothing to tell, such as an echo that does not come back."""
    c.used = c.stamp
    c.empty = True
    c.behind = False


def refuse(c: ChannelMemory, why: Why, t: float) -> None:
    """A reading is not used at time t [s], and why."""
    c.refused_at = t
    c.impossible_at = t
    doubt(c, why, t)


def doubt(c: ChannelMemory, why: Why, t: float) -> None:
    """Something speaks against the channel at time t [s]; its readings are used all the same."""
    if c.trust == Trust.GOOD or c.complaint.code == Reason.NONE:
        copy_why(c.complaint, why)
    c.bad_at = t


def bar(c: ChannelMemory, why: Why, t: float, clean: float) -> bool:
    """Something speaks against all readings of the channel at time t [s]: none is used for clean [s] after it.

    Returns whether that is news.
    """
    news = not is_barred(c, t)
    doubt(c, why, t)
    c.barred_until = t + clean
    return news


def is_barred(c: ChannelMemory, t: float) -> bool:
    """Whether no reading is used at time t [s]."""
    return t <= c.barred_until


def hear(m: HealthMemory, channel: int, squared: float, degrees: float, accepted: bool, t: float) -> None:
    """The outcome of the filter's own gate on a reading of a channel, at time t [s].

    squared [-]: its innovation, normalised and squared, of `degrees` [-] of freedom. The gate is narrow enough to refuse a
    sound reading now and then: refusals count as silence, and give it their reason.
    """
    c = m.channels[channel]
    c.gated = True
    if accepted:
        _take(c, t)
    else:
        c.refused_at = t
        give(c.refusal, Reason.REFUSED, math.sqrt(squared / degrees), 0.0)


def settle(m: HealthMemory, c: ChannelMemory) -> bool:
    """Look at the clock. Returns whether the verdict changed."""
    if math.isnan(c.used_at):
        c.used_at = m.t
    quiet, period = m.t - c.used_at, max(c.period, m.dt)
    trust = _by_silence(c, m.rules, quiet, period)
    if c.gated and c.refused_at >= m.t - m.rules.least_to_lose - period and _is_contested(m, c):
        trust = min(trust, int(Trust.SUSPECT))
    if trust != Trust.GOOD:
        _be_silent(c, quiet, m.t, trust != c.trust)
    elif m.t - c.bad_at <= m.rules.clean:
        trust = int(Trust.SUSPECT)
    else:
        c.complaint.code = Reason.NONE
    c.changed = trust != c.trust
    c.trust = trust
    return c.changed


def _take(c: ChannelMemory, t: float) -> None:
    if c.used > -math.inf:
        c.taken = c.used
        c.used_at = t


def _by_silence(c: ChannelMemory, rules: Rules, quiet: float, period: float) -> int:
    patience = c.delay + period * c.losses
    lost = patience + max(rules.least_to_lose, rules.periods_to_lose * period)
    suspect = patience + max(rules.least_to_suspect, rules.periods_to_suspect * period)
    if quiet > lost and not c.empty:
        return int(Trust.LOST)
    return int(Trust.SUSPECT) if quiet > suspect else int(Trust.GOOD)


def _be_silent(c: ChannelMemory, quiet: float, t: float, anew: bool) -> None:
    """anew: the verdict changes, and its reason gets new figures."""
    code = c.complaint.code
    if code == Reason.NONE or c.bad_at < t - quiet or (anew and (code == Reason.SILENT or code == Reason.NO_ECHO)):
        if c.gated and c.refused_at >= t - quiet:
            copy_why(c.complaint, c.refusal)
        else:
            give(c.complaint, int(Reason.NO_ECHO) if c.empty else int(Reason.SILENT), quiet, 0.0)
    c.bad_at = t


def _is_contested(m: HealthMemory, c: ChannelMemory) -> bool:
    """Whether a suspect channel may be why the filter refuses this one, which then is not lost for it."""
    return _is_suspect(m, c.rival) or _is_suspect(m, c.other_rival)


def _is_suspect(m: HealthMemory, channel: int) -> bool:
    return channel >= 0 and m.channels[channel].trust == Trust.SUSPECT
