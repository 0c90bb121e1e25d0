"""State of the health monitor, and the trust in one channel: from complaints, silence and the time without either.

A complaint makes a channel suspect for `HealthTuning.clean` seconds; silence makes it suspect and then lost, and so do readings
that are all refused. A reading that is used ends the loss; nothing is lost for good.
"""

from __future__ import annotations

import math
from typing import Annotated

from uvms_ocp.codegen.kernel_layout import Layout, Sized, Vector
from uvms_ocp.estimation.filter_memory import N_CHANNELS
from uvms_ocp.estimation.health.estimate_history import EstimateHistory, PastEstimate
from uvms_ocp.estimation.health.floor import FloorMemory
from uvms_ocp.estimation.health.plausibility import EncoderMemory, PlausibilityGate, RepetitionMemory
from uvms_ocp.estimation.health.redundancy import DepthAgainstPosition, RateAgainstAttitude, VelocityAgainstPosition
from uvms_ocp.estimation.health.tuning import Complaint, Reason, copy_complaint, set_complaint
from uvms_ocp.robot.signals import Trust

# All that the monitor knows, as layouts that kernels work on: one part per channel, and what channels share.

N_ESTIMATES = 1024
"""that are remembered: five seconds of ticks of 5 ms; shorter ticks are not all kept."""
TOO_LATE = 2.0
"""[s] beyond its delay after which a reading is not used: half the length of a vehicle at its usual speed."""


class ChannelMemory(Layout):
    """The newest reading of one channel, the last that was used, and a verdict with its reason."""

    # What is set once.
    number: int
    """`Channel`"""
    present: bool
    size: int
    """Numbers of its value."""
    delay: float
    """[s]"""
    period: float
    """[s] between two readings, 0 for once per tick."""
    losses: float
    """Readings in a row that are lost by chance."""
    rival: int
    """A channel that may be why the estimate does not agree with this one, -1 for none."""
    other_rival: int
    """Another one."""
    gate: PlausibilityGate
    # The newest reading.
    fresh: bool
    """There is one since the last tick."""
    misshapen: int
    """Number of the text of its wrong shape, 0 where that is right."""
    stamp: float
    """[s] when it was taken."""
    value: Annotated[Vector, Sized("n_width")]
    """(n_width,) [unit of the channel] of which `size` numbers count."""
    # What is remembered.
    seen: float
    """[s] stamp of the last reading that was looked at."""
    started: bool
    """There was one."""
    behind: bool
    """The filter sees an older reading."""
    used: float
    """[s] stamp of the reading that the filter sees, -inf before the first."""
    used_value: Annotated[Vector, Sized("n_width")]
    """(n_width,) [unit of the channel] its value."""
    taken: float
    """[s] when the last reading was taken that the estimate rests on, nan before the first."""
    used_at: float
    """[s] when it arrived; before the first, when the run began."""
    refused_at: float
    """[s] when a reading was last refused, by whomever."""
    impossible_at: float
    """[s] when one was last refused before the filter saw it: one that could not be, whatever else is wrong."""
    bad_at: float
    """[s] when something last spoke against the channel."""
    excluded_until: float
    """[s] when its readings may be used again."""
    compared_at: float
    """[s] stamp of the last reading whose outcome was heard."""
    agreed: int
    """Readings in a row that agreed with the estimate."""
    off_in_a_row: int
    """Readings in a row that did not."""
    empty: bool
    """The sensor works but has nothing to tell."""
    gated: bool
    """The filter has a gate of its own for it."""
    complaint: Complaint
    refusal: Complaint
    """Refusal by the filter's gate, the last one."""
    trust: int
    """`Trust`"""
    changed: bool
    """The verdict did, in the last tick."""
    repeats: RepetitionMemory


class ScreeningResult(Layout):
    """Result of the screening of a reading."""

    used: bool
    """It is passed on."""
    sane: bool
    """Nothing speaks against it but the estimate, if anything."""
    why: Complaint
    """Complaint, if any."""


class HealthMemory(Layout):
    """Memory of the health monitor."""

    n: int
    """Channels that the robot has."""
    order: Annotated[list[int], Sized(N_CHANNELS)]
    """(9,) their numbers, in the order of `Readings`."""
    clean: float
    """[s] as the next two of `HealthTuning`."""
    clock: float
    """[s]"""
    late: float
    """[s]"""
    started: bool
    t: float
    """[s] of the tick."""
    dt: float
    """[s]"""
    n_behind: int
    """Channels that the filter sees an older reading of than the newest."""
    exposed: bool
    """The source of the velocity proved wrong in this tick."""
    velocity_unobserved: bool
    """Nothing has told it for too long, by this tick."""
    unobserved_at: float
    """[s] when that was so last, 0 before."""
    now: PastEstimate
    history: EstimateHistory
    belief: ScreeningResult
    channels: Annotated[list[ChannelMemory], Sized(N_CHANNELS)]
    """Channels by `ChannelIndex`."""
    encoders: EncoderMemory
    floor: FloorMemory
    velocity: VelocityAgainstPosition
    rate: RateAgainstAttitude
    depth: DepthAgainstPosition


# What is thought of one channel, from complaints, silence and the time without either.

LEAST_TO_SUSPECT = 0.05
"""[s] of silence of a quick sensor: as long as joints are fed back without encoders."""
_LEAST_TO_LOSE = 0.25  # [s] of silence of a quick sensor
_PERIODS_TO_SUSPECT = 2.5  # of silence: 0.5 s of a 5 Hz DVL, before a watchdog of 0.6 s holds
_PERIODS_TO_LOSE = 8.0  # of silence, or of nothing but refused readings


def accept(c: ChannelMemory, t: float) -> None:
    """The filter may see the newest reading at time t [s]; where it has a gate of its own, its outcome is waited for."""
    c.used = c.stamp
    c.empty = c.behind = False
    if not c.gated:
        _mark_used(c, t)


def accept_empty(c: ChannelMemory) -> None:
    """The sensor works but has nothing to tell, such as an echo that does not come back."""
    c.used, c.empty, c.behind = c.stamp, True, False


def reject(c: ChannelMemory, why: Complaint, t: float) -> None:
    """A reading is not used at time t [s], and why."""
    c.refused_at, c.impossible_at = t, t
    suspect(c, why, t)


def suspect(c: ChannelMemory, why: Complaint, t: float) -> None:
    """Something speaks against the channel at time t [s]; its readings are used all the same."""
    if c.trust == Trust.GOOD or c.complaint.code == Reason.NONE:
        copy_complaint(c.complaint, why)
    c.bad_at = t


def exclude(c: ChannelMemory, why: Complaint, t: float, clean: float) -> bool:
    """Something speaks against all readings of the channel at time t [s]: none is used for clean [s] after it.

    Returns whether that is news.
    """
    news = not is_excluded(c, t)
    suspect(c, why, t)
    c.excluded_until = t + clean
    return news


def is_excluded(c: ChannelMemory, t: float) -> bool:
    """Return whether no reading is used at time t [s]."""
    return t <= c.excluded_until


def update_gate_outcome(
    m: HealthMemory, channel: int, squared: float, degrees: float, accepted: bool, t: float
) -> None:
    """The outcome of the filter's own gate on a reading of a channel, at time t [s].

    squared: its innovation, normalised and squared, of `degrees` of freedom. The gate is narrow enough to refuse a
    sound reading now and then: refusals count as silence, and give it their reason.
    """
    c = m.channels[channel]
    c.gated = True
    if accepted:
        _mark_used(c, t)
    else:
        c.refused_at = t
        set_complaint(c.refusal, Reason.REFUSED, math.sqrt(squared / degrees), 0.0)


def update_trust(m: HealthMemory, c: ChannelMemory) -> bool:
    """Look at the clock. Returns whether the verdict changed."""
    if math.isnan(c.used_at):
        c.used_at = m.t
    quiet, period = m.t - c.used_at, max(c.period, m.dt)
    trust = _by_silence(c, quiet, period)
    if (
        c.gated
        and c.refused_at >= m.t - _LEAST_TO_LOSE - period
        and (_is_suspect(m, c.rival) or _is_suspect(m, c.other_rival))
    ):
        trust = min(trust, int(Trust.SUSPECT))
    if trust != Trust.GOOD:
        _be_silent(c, quiet, m.t, trust != c.trust)
    elif m.t - c.bad_at <= m.clean:
        trust = int(Trust.SUSPECT)
    else:
        c.complaint.code = Reason.NONE
    c.changed = trust != c.trust
    c.trust = trust
    return c.changed


def _mark_used(c: ChannelMemory, t: float) -> None:
    if c.used > -math.inf:
        c.taken, c.used_at = c.used, t


def _by_silence(c: ChannelMemory, quiet: float, period: float) -> int:
    patience = c.delay + period * c.losses
    lost = patience + max(_LEAST_TO_LOSE, _PERIODS_TO_LOSE * period)
    suspect = patience + max(LEAST_TO_SUSPECT, _PERIODS_TO_SUSPECT * period)
    if quiet > lost and not c.empty:
        return int(Trust.LOST)
    return int(Trust.SUSPECT) if quiet > suspect else int(Trust.GOOD)


def _be_silent(c: ChannelMemory, quiet: float, t: float, anew: bool) -> None:
    """anew: the verdict changes, and its reason gets new figures."""
    code = c.complaint.code
    if code == Reason.NONE or c.bad_at < t - quiet or (anew and (code == Reason.SILENT or code == Reason.NO_ECHO)):
        if c.gated and c.refused_at >= t - quiet:
            copy_complaint(c.complaint, c.refusal)
        else:
            set_complaint(c.complaint, int(Reason.NO_ECHO) if c.empty else int(Reason.SILENT), quiet, 0.0)
    c.bad_at = t


def _is_suspect(m: HealthMemory, channel: int) -> bool:
    return channel >= 0 and m.channels[channel].trust == Trust.SUSPECT
