"""State of the health monitor, and the trust in a channel: from complaints, silence and the time
without either.

A complaint makes a channel suspect for `HealthTuning.clean` seconds; silence makes it suspect and
then lost, and so do readings that are all refused. A reading that is used ends the loss; nothing is
lost for good.
"""

from __future__ import annotations

import math
from typing import Annotated

from uvms_ocp.codegen.kernel_layout import Layout, Sized, Vector
from uvms_ocp.estimation.filter_memory import ChannelIndex
from uvms_ocp.estimation.health import plausibility, redundancy
from uvms_ocp.estimation.health.floor import FloorMemory
from uvms_ocp.estimation.health.tuning import (
    Complaint,
    Reason,
    copy_complaint,
    set_complaint,
)
from uvms_ocp.robot.signals import Trust

TOO_LATE = 2.0
"""[s] beyond its delay after which a reading is not used: half the length of a vehicle at its usual
speed.
"""

LEAST_TO_SUSPECT = 0.05
"""[s] of silence of a quick sensor: as long as joints are fed back without encoders."""
_LEAST_TO_LOSE = 0.25  # [s] of silence of a quick sensor
_BLAMED_FOR = 3.0  # [s] for which what was found to be wrong by height explains what others say
_UNDONE = 0.5  # share of a jump that may be left of it once the channel has gone back
_REMEMBERED = 60.0  # [s] after a jump in which the channel may go back by it
_AGREES = 0.3  # share of what is allowed by which fixes and depths agree
_PERIODS_TO_SUSPECT = 2.5  # of silence: 0.5 s of a 5 Hz DVL, before a watchdog of 0.6 s holds
_PERIODS_TO_LOSE = 8.0  # of silence, or of nothing but refused readings


class ChannelMemory(Layout):
    """The newest reading of one channel, the last that was used, and a verdict with its reason."""

    # What is set once.
    number: int
    """`ChannelIndex` of the channel."""
    present: bool
    """The robot has the channel."""
    size: int
    """Numbers of a value of the channel."""
    delay: float
    """[s] of its readings, as declared."""
    period: float
    """[s] between two readings, 0 for once per tick."""
    losses: float
    """Largest number of readings in a row that are lost by chance."""
    rival: int
    """`ChannelIndex` of a channel that may be why the estimate does not agree with this one; -1 for
    none.
    """
    other_rival: int
    """`ChannelIndex` of a second rival; -1 for none."""
    gate: plausibility.PlausibilityGate
    """Allowed distance of a reading from the estimate."""
    # The newest reading.
    fresh: bool
    """A reading has come since the last tick."""
    arrived: bool
    """A reading has come at this tick, screened or not yet."""
    misshapen: int
    """Number of the text about the wrong shape of the reading, 0 where the shape is right."""
    stamp: float
    """[s] time at which the reading was taken."""
    value: Annotated[Vector, Sized("n_width")]
    """(n_width,) [unit of the channel] value of the reading, of which `size` numbers count."""
    # What is remembered.
    seen: float
    """[s] stamp of the last reading that was screened."""
    started: bool
    """A reading was screened before."""
    behind: bool
    """The filter sees an older reading."""
    used: float
    """[s] stamp of the reading that the filter sees, -inf before the first."""
    used_value: Annotated[Vector, Sized("n_width")]
    """(n_width,) [unit of the channel] value of the reading that the filter sees."""
    taken: float
    """[s] stamp of the last reading that the estimate rests on, nan before the first."""
    used_at: float
    """[s] time at which that reading arrived; before the first, the beginning of the run."""
    refused_at: float
    """[s] time of the last refusal of a reading, by the monitor or by the filter's gate."""
    impossible_at: float
    """[s] time of the last refusal before the filter saw the reading: of one that could not be,
    whatever else is wrong.
    """
    bad_at: float
    """[s] time of the last complaint about the channel."""
    doubted_at: float
    """[s] time of the last complaint about readings that were used, or of silence: refused ones alone
    spoil nothing.
    """
    excluded_until: float
    """[s] time from which readings may be used again."""
    compared_at: float
    """[s] stamp of the last reading whose outcome at the filter's gate is known."""
    agreed: int
    """Number of readings in a row that agreed with the estimate."""
    off_in_a_row: int
    """Number of readings in a row that did not agree with the estimate."""
    empty: bool
    """The sensor works but has nothing to tell."""
    gated: bool
    """The filter has a gate of its own for it."""
    complaint: Complaint
    """Reason why the channel is not good."""
    refusal: Complaint
    """Last refusal by the filter's gate."""
    trust: int
    """`Trust` in the channel."""
    changed: bool
    """The trust changed in the last tick."""
    repeats: plausibility.RepetitionMemory
    # Distances from the estimate.
    off: float
    """[unit of the channel] distance of the newest reading from the estimate, -1 where they were
    not compared.
    """
    offset: Annotated[Vector, Sized("n_width")]
    """(n_width,) [unit of the channel] the newest reading less the estimate; of an attitude a
    rotation vector in B.
    """
    jumped: Annotated[Vector, Sized("n_width")]
    """(n_width,) [unit of the channel] `offset` by which it came back elsewhere; 0 where it never did,
    or has gone back since.
    """
    jumped_at: float
    """[s] stamp of the reading with which it did."""
    explained: float
    """[unit of the channel] part of that distance that noise and unforeseen motion explain."""
    refused_off: float
    """[unit of the channel] distance of the last refused reading, 0 where it was explained."""
    jump: float
    """[unit of the channel] distance that two readings in a row had alike since the last one that
    was used.
    """
    shift: float
    """[unit of the channel] distance at which the channel came back since it was good last."""
    unexplained: float
    """[unit of the channel] largest unexplained distance: readings may be wrong since, or were
    before.
    """


class ScreeningResult(Layout):
    """Result of the screening of a reading."""

    used: bool
    """The reading is passed on to the estimator."""
    sane: bool
    """Nothing but, at most, the estimate speaks against the reading."""
    why: Complaint
    """Complaint, if any."""


class HealthMemory(Layout):
    """Memory of the health monitor."""

    n: int
    """Number of channels that the robot has."""
    order: Annotated[list[int], Sized("n_channels")]
    """(n_channels,) `ChannelIndex` of these channels, in the order of `Readings`."""
    clean: float
    """[s] `HealthTuning.clean`."""
    clock: float
    """[s] `HealthTuning.clock`."""
    late: float
    """[s] `HealthTuning.late`."""
    started: bool
    """There was a tick before."""
    t: float
    """[s] time of the tick."""
    dt: float
    """[s] period of control."""
    tick_t: float
    """[s] time of the tick, an input in machine code."""
    moving: bool
    """An input in machine code: there was a command, and no brakes."""
    n_changed: int
    """Number of channels whose trust changed in the tick."""
    n_behind: int
    """Number of channels of which the filter sees an older reading than the newest."""
    exposed: bool
    """The source of the velocity proved wrong in this tick."""
    velocity_unobserved: bool
    """No channel has told the velocity for too long, by this tick."""
    unobserved_at: float
    """[s] time at which the velocity was last unobserved, 0 before."""
    now: plausibility.PastEstimate
    history: plausibility.EstimateHistory
    belief: ScreeningResult
    channels: Annotated[list[ChannelMemory], Sized("n_channels")]
    """Channels by `ChannelIndex`."""
    encoders: plausibility.EncoderMemory
    floor: FloorMemory
    velocity: redundancy.VelocityAgainstPosition
    rate: redundancy.RateAgainstAttitude
    depth: redundancy.DepthAgainstPosition
    heights: redundancy.HeightPairs
    turns_disputed: bool
    """Attitude and gyro were doubted together, and the attitude is not good yet."""
    culprit: int
    """`ChannelIndex` of the channel by which the height is wrong, -1 for none."""
    blamed_at: float
    """[s] time at which it was found last."""
    ways_turned: bool
    """Ways by the DVL have drifted from fixes or depths while the attitude was in doubt."""
    encoder: redundancy.RateAgainstEncoder


# Trust in one channel, from complaints, silence and the time without either.


def accept(channel: ChannelMemory, t: float) -> None:
    """Let the filter see the newest reading at time t [s]; where it has a gate of its own, its
    outcome is waited for.
    """
    channel.used = channel.stamp
    channel.empty = channel.behind = False
    if not channel.gated:
        _mark_used(channel, t)


def accept_empty(channel: ChannelMemory) -> None:
    """Accept that the sensor works but has nothing to tell, such as an echo that does not come
    back.
    """
    channel.used = channel.stamp
    channel.empty = True
    channel.behind = False


def reject(channel: ChannelMemory, why: Complaint, t: float) -> None:
    """Refuse a reading at time t [s], and note why."""
    _mark_refused(channel, t)
    channel.impossible_at = t
    _complain(channel, why, t)


def suspect(channel: ChannelMemory, why: Complaint, t: float) -> None:
    """Note a complaint about the channel at time t [s]; its readings are used all the same."""
    _complain(channel, why, t)
    channel.doubted_at = t


def _complain(channel: ChannelMemory, why: Complaint, t: float) -> None:
    if channel.trust == Trust.GOOD or channel.complaint.code == Reason.NONE:
        copy_complaint(channel.complaint, why)
    channel.bad_at = t


def exclude(channel: ChannelMemory, why: Complaint, t: float, clean: float) -> bool:
    """Exclude all readings of the channel at time t [s]: none is used for clean [s] after it.

    Returns whether that is news.
    """
    news = not is_excluded(channel, t)
    suspect(channel, why, t)
    channel.excluded_until = t + clean
    return news


def is_excluded(channel: ChannelMemory, t: float) -> bool:
    """Return whether no reading is used at time t [s]."""
    return t <= channel.excluded_until


def update_gate_outcome(
    health: HealthMemory, channel: int, squared: float, degrees: float, accepted: bool, t: float
) -> None:
    """Note the outcome of the filter's own gate on a reading of a channel, at time t [s].

    squared: its innovation, normalised and squared, of `degrees` of freedom. The gate is narrow
    enough to refuse a sound reading now and then: refusals count as silence, and give it their
    reason.
    """
    channel_memory = health.channels[channel]
    channel_memory.gated = True
    if accepted:
        _mark_used(channel_memory, t)
    else:
        _mark_refused(channel_memory, t)
        set_complaint(channel_memory.refusal, Reason.REFUSED, math.sqrt(squared / degrees), 0.0)


def update_trust(health: HealthMemory, channel: ChannelMemory) -> bool:
    """Update the trust in a channel by the clock. Returns whether it changed."""
    if math.isnan(channel.used_at):
        channel.used_at = health.t
    quiet = health.t - channel.used_at
    period = max(channel.period, health.dt)
    trust = _by_silence(channel, quiet, period)
    if channel.gated and channel.refused_at >= health.t - _LEAST_TO_LOSE - period:
        is_early = trust == Trust.SUSPECT and _is_height_open(health, channel.number)
        if is_early or is_vouched_for(health, channel.number):
            trust = int(Trust.GOOD)
        elif (
            _is_suspect(health, channel.rival)
            or _is_suspect(health, channel.other_rival)
            or _is_misjudged(health, channel, period)
        ):
            trust = min(trust, int(Trust.SUSPECT))
    elif _is_disputed(health, channel) or _is_left_out(health, channel, period):
        trust = min(trust, int(Trust.SUSPECT))
    if trust != Trust.GOOD:
        _be_silent(channel, quiet, health.t, trust != channel.trust)
    elif health.t - channel.bad_at <= health.clean:
        trust = int(Trust.SUSPECT)
    else:
        channel.complaint.code = Reason.NONE
    channel.changed = trust != channel.trust
    if health.ways_turned and not is_attitude_doubted(health):
        redundancy.forget_ways(health.velocity)
        health.ways_turned = False
    if channel.trust == Trust.GOOD and channel.changed:
        channel.shift = 0.0
    channel.trust = trust
    return channel.changed


def culprit_of_height(health: HealthMemory) -> int:
    """Return the `ChannelIndex` of the channel that height is, or was not long ago, wrong by; -1 for
    none.
    """
    if health.t - health.blamed_at <= _BLAMED_FOR:
        return health.culprit
    return -1


def is_vouched_for(health: HealthMemory, number: int) -> bool:
    """Return whether others tell that it is not this channel which is wrong where it does not agree
    with the estimate.

    Of what tells of the height another one is to blame; or a depth agrees with fixes, and it is
    neither.
    """
    is_of_height = (
        number == ChannelIndex.POSITION
        or number == ChannelIndex.DEPTH
        or number == ChannelIndex.LINEAR_VELOCITY
        or number == ChannelIndex.ALTIMETER_RANGE
    )
    culprit = culprit_of_height(health)
    if is_of_height and culprit >= 0:
        return number != culprit
    return number == ChannelIndex.DEPTH and 0.0 <= health.heights.fixes_and_depths < _AGREES


def _is_disputed(health: HealthMemory, channel: ChannelMemory) -> bool:
    """Return whether a DVL is not used as it may be the one that disagrees with fixes, or they."""
    is_unused = is_excluded(channel, health.t)
    is_velocity = channel.number == ChannelIndex.LINEAR_VELOCITY
    return is_velocity and is_unused and _is_suspect(health, channel.rival)


def _is_left_out(health: HealthMemory, channel: ChannelMemory, period: float) -> bool:
    """Return whether echoes of an altimeter come that can be, and are not used as by an attitude that is
    in doubt the beam seems to lie flat, or the floor to be farther away.
    """
    is_altimeter = channel.number == ChannelIndex.ALTIMETER_RANGE
    is_speaking = health.t - channel.seen <= _patience(channel, period)
    return is_altimeter and is_speaking and _is_misjudged(health, channel, period)


def _is_misjudged(health: HealthMemory, channel: ChannelMemory, period: float) -> bool:
    """Return whether readings that are turned into W may not be used because the attitude is in doubt:
    echoes that were refused of late could not be by any attitude.
    """
    is_altimeter = channel.number == ChannelIndex.ALTIMETER_RANGE
    if is_altimeter and health.t - channel.impossible_at <= _patience(channel, period):
        return False
    return is_turned_by_attitude(channel.number) and is_attitude_doubted(health)


def _patience(channel: ChannelMemory, period: float) -> float:
    """Return the time [s] after which a channel that says nothing, or is always refused, is lost."""
    return channel.delay + max(_LEAST_TO_LOSE, _PERIODS_TO_LOSE * period)


def is_attitude_doubted(health: HealthMemory) -> bool:
    """Return whether the estimated attitude may be wrong, and with it all that it turns into W: not by
    spikes, which are refused.
    """
    attitude = health.channels[ChannelIndex.ATTITUDE]
    return attitude.present and health.t - attitude.doubted_at <= health.clean


def update_turn_dispute(health: HealthMemory) -> None:
    """Note whether attitude and gyro are doubted together, until the attitude is good again."""
    attitude = health.channels[ChannelIndex.ATTITUDE]
    gyro = health.channels[ChannelIndex.ANGULAR_VELOCITY]
    if not (attitude.present and gyro.present) or attitude.trust == Trust.GOOD:
        health.turns_disputed = False
    elif gyro.trust != Trust.GOOD:
        health.turns_disputed = True


def keep_undisputed_turns(health: HealthMemory, v: Vector) -> None:
    """Reduce the angular velocity, entries 3 to 5 of the estimated v [rad/s], to what the newest
    reading of the gyro vouches for as well, where attitude and gyro are in dispute.

    Of each axis the smaller one where both have one sign, and 0 where not: whichever of the two is
    right, feedback of it does not drive a turn.
    """
    gyro = health.channels[ChannelIndex.ANGULAR_VELOCITY]
    for i in range(3):
        rate = gyro.value[i]
        if not math.isfinite(rate) or rate * v[3 + i] <= 0.0:
            v[3 + i] = 0.0
        elif abs(rate) < abs(v[3 + i]):
            v[3 + i] = rate


def is_turned_by_attitude(number: int) -> bool:
    """Return whether a channel tells of W by the attitude alone."""
    return number == ChannelIndex.LINEAR_VELOCITY or number == ChannelIndex.ALTIMETER_RANGE


def _is_height_open(health: HealthMemory, number: int) -> bool:
    """Return whether others have begun to disagree on the height that a depth, or an altimeter, is
    refused by, and it is not known yet which of them is wrong.
    """
    refused = number == ChannelIndex.DEPTH or number == ChannelIndex.ALTIMETER_RANGE
    return refused and redundancy.is_height_disputed(health.heights)


def _mark_used(channel: ChannelMemory, t: float) -> None:
    if channel.used > -math.inf:
        is_off = channel.off > channel.gate.noise
        if is_off and channel.refused_at > channel.used_at:
            _confirm_jump(channel)
            channel.shift = max(channel.shift, min(channel.jump, 2.0 * channel.off))
            channel.unexplained = max(channel.unexplained, channel.shift)
            _keep_jump(channel)
        elif is_off and undoes_jump(channel):
            _forget_jump(channel)
        channel.refused_off = channel.jump = 0.0
        channel.taken = channel.used
        channel.used_at = t


def _mark_refused(channel: ChannelMemory, t: float) -> None:
    if channel.off >= 0.0:
        _confirm_jump(channel)
        channel.refused_off = channel.off if channel.off > channel.explained else 0.0
    channel.refused_at = t


def _confirm_jump(channel: ChannelMemory) -> None:
    """Take a jump for true where two readings in a row are off alike; begin anew after a spike."""
    if channel.off > 0.5 * channel.refused_off:
        channel.jump = max(channel.jump, min(channel.off, channel.refused_off))
    else:
        channel.jump = 0.0


def _keep_jump(channel: ChannelMemory) -> None:
    """Remember where the channel came back, until it goes back."""
    if undoes_jump(channel):
        _forget_jump(channel)
    elif min(channel.jump, channel.off) > channel.gate.noise:
        channel.jumped[: channel.size] = channel.offset[: channel.size]
        channel.jumped_at = channel.stamp


def _forget_jump(channel: ChannelMemory) -> None:
    for i in range(channel.size):
        channel.jumped[i] = 0.0


def undoes_jump(channel: ChannelMemory) -> bool:
    """Return whether the newest reading goes back by what the channel jumped by not long before: then
    it was wrong in between, and so is the estimate.
    """
    if not channel.stamp - channel.jumped_at <= _REMEMBERED:
        return False
    jump = 0.0
    remaining = 0.0
    for i in range(channel.size):
        rest = channel.offset[i] + channel.jumped[i]
        jump += channel.jumped[i] * channel.jumped[i]
        remaining += rest * rest
    return jump > 0.0 and remaining <= _UNDONE * _UNDONE * jump


def _by_silence(channel: ChannelMemory, quiet: float, period: float) -> int:
    patience = channel.delay + period * channel.losses
    lost = patience + max(_LEAST_TO_LOSE, _PERIODS_TO_LOSE * period)
    suspect = patience + max(LEAST_TO_SUSPECT, _PERIODS_TO_SUSPECT * period)
    if quiet > lost and not channel.empty:
        return int(Trust.LOST)
    if quiet > suspect:
        return int(Trust.SUSPECT)
    return int(Trust.GOOD)


def _be_silent(channel: ChannelMemory, quiet: float, t: float, anew: bool) -> None:
    """Give silence, or an echo that is missing, as the reason; anew: the verdict changes, and its
    reason gets new figures.
    """
    code = channel.complaint.code
    if (
        code == Reason.NONE
        or channel.bad_at < t - quiet
        or (anew and (code == Reason.SILENT or code == Reason.NO_ECHO))
    ):
        if channel.gated and channel.refused_at >= t - quiet:
            copy_complaint(channel.complaint, channel.refusal)
        else:
            set_complaint(
                channel.complaint,
                int(Reason.NO_ECHO) if channel.empty else int(Reason.SILENT),
                quiet,
                0.0,
            )
    channel.bad_at = t
    channel.doubted_at = t


def _is_suspect(health: HealthMemory, channel: int) -> bool:
    return channel >= 0 and health.channels[channel].trust == Trust.SUSPECT
