"""State of the health monitor, and the trust in one channel: from complaints, silence and the time
without either.

A complaint makes a channel suspect for `HealthTuning.clean` seconds; silence makes it suspect and
then lost, and so do readings that are all refused. A reading that is used ends the loss; nothing is
lost for good.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, NamedTuple

import numpy as np

from uvms_ocp.codegen.kernel_layout import Layout, Sized, Vector, structure_of
from uvms_ocp.estimation.filter_memory import JOLTS, N_CHANNELS, NUMBER
from uvms_ocp.estimation.health import plausibility, redundancy
from uvms_ocp.estimation.health.floor import POSITION, FloorMemory, init_floor
from uvms_ocp.estimation.health.tuning import (
    Complaint,
    HealthTuning,
    Reason,
    copy_complaint,
    set_complaint,
)
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import SensorSpec, Trust
from uvms_ocp.types import Array

# All that the monitor knows, as layouts that kernels work on: one part per channel, and what
# channels share.

N_ESTIMATES = 1024
"""that are remembered: five seconds of ticks of 5 ms; shorter ticks are not all kept."""
TOO_LATE = 2.0
"""[s] beyond its delay after which a reading is not used: half the length of a vehicle at its usual
speed.
"""

LEAST_TO_SUSPECT = 0.05
"""[s] of silence of a quick sensor: as long as joints are fed back without encoders."""
_LEAST_TO_LOSE = 0.25  # [s] of silence of a quick sensor
_PERIODS_TO_SUSPECT = 2.5  # of silence: 0.5 s of a 5 Hz DVL, before a watchdog of 0.6 s holds
_PERIODS_TO_LOSE = 8.0  # of silence, or of nothing but refused readings

_SIGMAS = 8.0  # of the channel's noise, which noise passes once in 1e15 readings
# How wrong an estimate can be beyond noise, of a robot that manoeuvres in gusts.
# [m/s] of a position that a DVL carries, or of a depth that anything does: its bias, and the
# attitude's
_POSITION_DRIFT = 0.05
_ATTITUDE = 0.05  # [rad]
_ATTITUDE_DRIFT = (
    0.002  # [rad/s] of an attitude that a gyro carries: its bias, once it is estimated
)
_VELOCITY = 0.25  # [m/s]: a vehicle that accelerates with 1 m/s2 between two readings of a DVL
_VELOCITY_DRIFT = 0.02  # [m/s2] of a velocity that position fixes carry
_RATE = 0.2  # [rad/s] of the vehicle: a blow
_RATE_DRIFT = 0.1  # [rad/s2] of a rate that attitudes carry
_JOINTS = 0.05  # [rad or m] of joint positions
_JOINT_RATE = 0.5  # [rad/s or m/s] of joint velocities: a joint that meets its stop
_ENCODER_TRAVEL = (
    0.02  # [rad or m] that is asked of a joint while its encoder does not change by a bit
)
_BRISK = 1.5  # by how much water and blows move a vehicle faster than it can by itself
_ANY = 1e12  # [unit of the channel] growth of what has no limits
_FASTEST = 10.0  # [rad/s or m/s] of a joint without limits
_WHOLE = ("attitude",)  # whose components cannot be judged one by one: some hardly change
_RATES = ("angular_velocity", "linear_velocity", "joint_velocities")
"""Exact ones may belong to a plant whose velocities jump, as the paper's does."""
_RIVALS = {
    "attitude": ("angular_velocity",),
    "angular_velocity": ("attitude",),
    "position": ("linear_velocity", "depth"),
    "depth": ("position", "linear_velocity"),
    "linear_velocity": ("position",),
}
"""Channels that may be why the estimate does not agree with one."""


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
    order: Annotated[list[int], Sized(N_CHANNELS)]
    """(9,) `ChannelIndex` of these channels, in the order of `Readings`."""
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
    channels: Annotated[list[ChannelMemory], Sized(N_CHANNELS)]
    """Channels by `ChannelIndex`."""
    encoders: plausibility.EncoderMemory
    floor: FloorMemory
    velocity: redundancy.VelocityAgainstPosition
    rate: redundancy.RateAgainstAttitude
    depth: redundancy.DepthAgainstPosition
    encoder: redundancy.RateAgainstEncoder


# Trust in one channel, from complaints, silence and the time without either.


def accept(c: ChannelMemory, t: float) -> None:
    """Let the filter see the newest reading at time t [s]; where it has a gate of its own, its
    outcome is waited for.
    """
    c.used = c.stamp
    c.empty = c.behind = False
    if not c.gated:
        _mark_used(c, t)


def accept_empty(c: ChannelMemory) -> None:
    """Accept that the sensor works but has nothing to tell, such as an echo that does not come
    back.
    """
    c.used = c.stamp
    c.empty = True
    c.behind = False


def reject(c: ChannelMemory, why: Complaint, t: float) -> None:
    """Refuse a reading at time t [s], and note why."""
    _mark_refused(c, t)
    c.impossible_at = t
    suspect(c, why, t)


def suspect(c: ChannelMemory, why: Complaint, t: float) -> None:
    """Note a complaint about the channel at time t [s]; its readings are used all the same."""
    if c.trust == Trust.GOOD or c.complaint.code == Reason.NONE:
        copy_complaint(c.complaint, why)
    c.bad_at = t


def exclude(c: ChannelMemory, why: Complaint, t: float, clean: float) -> bool:
    """Exclude all readings of the channel at time t [s]: none is used for clean [s] after it.

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
    """Note the outcome of the filter's own gate on a reading of a channel, at time t [s].

    squared: its innovation, normalised and squared, of `degrees` of freedom. The gate is narrow
    enough to refuse a sound reading now and then: refusals count as silence, and give it their
    reason.
    """
    c = m.channels[channel]
    c.gated = True
    if accepted:
        _mark_used(c, t)
    else:
        _mark_refused(c, t)
        set_complaint(c.refusal, Reason.REFUSED, math.sqrt(squared / degrees), 0.0)


def update_trust(m: HealthMemory, c: ChannelMemory) -> bool:
    """Update the trust in a channel by the clock. Returns whether it changed."""
    if math.isnan(c.used_at):
        c.used_at = m.t
    quiet = m.t - c.used_at
    period = max(c.period, m.dt)
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
    if c.trust == Trust.GOOD and c.changed:
        c.shift = 0.0
    c.trust = trust
    return c.changed


def _mark_used(c: ChannelMemory, t: float) -> None:
    if c.used > -math.inf:
        if c.refused_at > c.used_at and c.off > c.gate.noise:
            _confirm_jump(c)
            c.shift = max(c.shift, min(c.jump, 2.0 * c.off))
            c.unexplained = max(c.unexplained, c.shift)
        c.refused_off = c.jump = 0.0
        c.taken = c.used
        c.used_at = t


def _mark_refused(c: ChannelMemory, t: float) -> None:
    if c.off >= 0.0:
        _confirm_jump(c)
        c.refused_off = c.off if c.off > c.explained else 0.0
    c.refused_at = t


def _confirm_jump(c: ChannelMemory) -> None:
    """Two readings in a row that are off alike tell it; after a spike it begins anew."""
    if c.off > 0.5 * c.refused_off:
        c.jump = max(c.jump, min(c.off, c.refused_off))
    else:
        c.jump = 0.0


def _by_silence(c: ChannelMemory, quiet: float, period: float) -> int:
    patience = c.delay + period * c.losses
    lost = patience + max(_LEAST_TO_LOSE, _PERIODS_TO_LOSE * period)
    suspect = patience + max(LEAST_TO_SUSPECT, _PERIODS_TO_SUSPECT * period)
    if quiet > lost and not c.empty:
        return int(Trust.LOST)
    if quiet > suspect:
        return int(Trust.SUSPECT)
    return int(Trust.GOOD)


def _be_silent(c: ChannelMemory, quiet: float, t: float, anew: bool) -> None:
    """anew: the verdict changes, and its reason gets new figures."""
    code = c.complaint.code
    if (
        code == Reason.NONE
        or c.bad_at < t - quiet
        or (anew and (code == Reason.SILENT or code == Reason.NO_ECHO))
    ):
        if c.gated and c.refused_at >= t - quiet:
            copy_complaint(c.complaint, c.refusal)
        else:
            set_complaint(
                c.complaint, int(Reason.NO_ECHO) if c.empty else int(Reason.SILENT), quiet, 0.0
            )
    c.bad_at = t


def _is_suspect(m: HealthMemory, channel: int) -> bool:
    return channel >= 0 and m.channels[channel].trust == Trust.SUSPECT


# Set up the state of the health monitor: the sensors of the robot, and what its limits allow.


def health_memory(
    robot: Robot, specs: Mapping[str, SensorSpec], tuning: HealthTuning
) -> HealthMemory:
    """A `HealthMemory`; specs: of every channel that the robot has."""
    memory = structure_of(
        HealthMemory,
        n_q=robot.n_q,
        n_v=robot.n_v,
        n_joints=robot.n_joints,
        n_width=max(4, *sizes_of(robot)["joint_positions"]),
        n_estimates=N_ESTIMATES,
    )()
    memory.n = len(specs)
    memory.order[: len(specs)] = [int(NUMBER[name]) for name in specs]
    memory.clean = tuning.clean
    memory.clock = tuning.clock
    memory.late = tuning.late
    memory.history.length = max((spec.delay for spec in specs.values()), default=0.0) + TOO_LATE
    memory.history.spacing = memory.history.length / (N_ESTIMATES - 2)
    for number in range(N_CHANNELS):
        c = memory.channels[number]
        c.number = number
        c.rival = -1
        c.other_rival = -1
        c.gate.by = -1
        c.gate.or_by = -1
        c.used = -math.inf
        c.refused_at = -math.inf
        c.impossible_at = -math.inf
        c.bad_at = -math.inf
        c.excluded_until = -math.inf
        c.compared_at = -math.inf
        c.taken = math.nan
        c.used_at = math.nan
    for name, spec in specs.items():
        _set_channel(memory.channels[NUMBER[name]], robot, name, spec)
    _set_gates(memory, robot, specs, tuning)
    bias = dict.fromkeys(sizes_of(robot), 0.0)
    sigma = dict.fromkeys(sizes_of(robot), 0.0)
    delay = dict.fromkeys(sizes_of(robot), 0.0)
    for name, spec in specs.items():
        bias[name] = _largest_bias(spec)
        sigma[name] = spec.sigma
        delay[name] = spec.delay
    fastest = np.minimum(robot.limits.velocity[robot.joint_v], _FASTEST)
    allowed_travel = _ENCODER_TRAVEL + delay["joint_positions"] * fastest
    memory.encoders.allowed[: robot.n_joints] = allowed_travel.tolist()
    memory.encoders.n = 0
    if _is_plain(robot) and robot.n_joints == len(robot.joint_names):
        memory.encoders.n = robot.n_joints
    noise = {name: bias[name] + sigma[name] for name in bias}
    redundancy.init_comparisons(
        memory.velocity, memory.rate, memory.depth, memory.encoder, noise, bias
    )
    memory.encoder.n = memory.encoders.n
    init_floor(memory.floor, sigma["altimeter_range"], tuning)
    return memory


def sizes_of(robot: Robot) -> dict[str, tuple[int, ...]]:
    """Return the shape of the value of each channel."""
    n_joint_q = robot.joint_q.stop - robot.joint_q.start
    return {
        "position": (3,),
        "depth": (),
        "attitude": (4,),
        "angular_velocity": (3,),
        "linear_velocity": (3,),
        "specific_force": (3,),
        "joint_positions": (n_joint_q,),
        "joint_velocities": (robot.n_joints,),
        "altimeter_range": (),
    }


def _largest_bias(spec: SensorSpec) -> float:
    return max(abs(bias) for bias in spec.biases)


def _set_channel(c: ChannelMemory, robot: Robot, name: str, spec: SensorSpec) -> None:
    c.present = True
    c.size = math.prod(sizes_of(robot)[name])
    c.delay = spec.delay
    c.period = 1.0 / spec.rate
    c.losses = math.inf if spec.dropout >= 1.0 else 0.0
    if 0.0 < spec.dropout < 1.0:  # so many readings in a row such a sensor loses by chance
        c.losses = math.log(plausibility.CHANCE) / math.log(spec.dropout)
    c.rival, c.other_rival = _two(_RIVALS.get(name, ()))
    plain = not name.startswith("joint") or _is_plain(robot)
    plausibility.init_repetitions(
        c.repeats, spec.sigma, size=c.size, each=plain and name not in _WHOLE
    )


def _is_plain(robot: Robot) -> bool:
    """Check that each degree of freedom of the joints is one number in q."""
    return sizes_of(robot)["joint_positions"] == (robot.n_joints,)


def _two(names: tuple[str, ...]) -> tuple[int, int]:
    """Return the numbers of up to two channels, -1 for none."""
    numbers = [int(NUMBER[name]) for name in names]
    numbers += [-1, -1]
    return numbers[0], numbers[1]


def _set_gates(
    memory: HealthMemory, robot: Robot, specs: Mapping[str, SensorSpec], tuning: HealthTuning
) -> None:
    """Set the gate of each channel that has one, by what the robot's limits allow."""
    allowed = _joint_gates(robot)
    if robot.n_vehicle:
        allowed |= _vehicle_gates(robot, tuning)
    for name, spec in specs.items():
        if name not in allowed or (spec.exact and name in _RATES):
            continue
        gate = memory.channels[NUMBER[name]].gate
        of = allowed[name]
        gate.exists = True
        gate.channel = int(NUMBER[name])
        gate.size = memory.channels[NUMBER[name]].size
        gate.start = of.start
        gate.supported = of.supported
        gate.alone = of.alone
        gate.most = math.inf
        gate.noise = _SIGMAS * spec.sigma + _largest_bias(spec)
        gate.base = of.base + gate.noise + _unforeseen(of, spec, specs)
        gate.by, gate.or_by = _two(of.by)
        gate.jolt = JOLTS[NUMBER[name]]
        gate.rates = robot.joint_v.start if name == "joint_positions" else -1
    if robot.n_vehicle:
        v, w = _brisk(robot.limits.velocity)
        memory.channels[NUMBER["angular_velocity"]].gate.most = 4 * w + _RATE
        memory.channels[NUMBER["linear_velocity"]].gate.most = v + tuning.current


class _Allowed(NamedTuple):
    """Error that an estimate may have, in the unit of the channel."""

    start: int
    """Index at which the value begins in q or v."""
    base: float
    """Error of an estimate that a reading has just corrected."""
    supported: float
    """Growth [1/s] while other channels support the estimate."""
    alone: float
    """Growth [1/s] while none does."""
    by: tuple[str, ...]
    """Channels that support it."""
    pull: float = math.inf
    """Growth of the growth itself, where the rate of the value is known at first."""


def _unforeseen(of: _Allowed, spec: SensorSpec, specs: Mapping[str, SensorSpec]) -> float:
    """Compute how far the robot may have moved unknown to the estimate when the reading was taken.

    A late reading meets an estimate of its time that had been carried on by itself for as long, at
    worst with full acceleration the other way.
    """
    blind = min([spec.delay, *(specs[name].delay for name in of.by if name in specs)])
    if of.pull < math.inf:
        moved = min(of.alone * blind, of.pull * blind**2)
    else:
        moved = of.alone * blind
    return moved + of.supported * (spec.delay - blind)


def _vehicle_gates(robot: Robot, tuning: HealthTuning) -> dict[str, _Allowed]:
    v, w = _brisk(robot.limits.velocity)
    a, alpha = _brisk(robot.limits.acceleration)
    fixes = ("position", "linear_velocity")
    return {
        "position": _Allowed(0, POSITION, _POSITION_DRIFT, v + tuning.current, fixes[1:], a),
        "depth": _Allowed(2, POSITION, _POSITION_DRIFT, v + tuning.current, fixes, a),
        "attitude": _Allowed(3, _ATTITUDE, _ATTITUDE_DRIFT, w, ("angular_velocity",), alpha),
        "angular_velocity": _Allowed(3, _RATE, _RATE_DRIFT, alpha, ("attitude",)),
        "linear_velocity": _Allowed(0, _VELOCITY, _VELOCITY_DRIFT, a, fixes[:1]),
    }


def _brisk(limits: Array) -> tuple[float, float]:
    """Return the norms of the linear and the angular limits (n_v,) of a vehicle in water."""
    linear = _BRISK * float(np.linalg.norm(_finite(limits[:3])))
    angular = _BRISK * float(np.linalg.norm(_finite(limits[3:6])))
    return linear, angular


def _joint_gates(robot: Robot) -> dict[str, _Allowed]:
    v = _finite(robot.limits.velocity[robot.joint_v])
    a = _finite(robot.limits.acceleration[robot.joint_v])
    fastest = _BRISK * float(v.max(initial=0.0))
    quickest = _BRISK * float(a.max(initial=0.0))
    return {
        "joint_positions": _Allowed(robot.joint_q.start, _JOINTS, fastest, fastest, (), quickest),
        "joint_velocities": _Allowed(robot.joint_v.start, _JOINT_RATE, quickest, quickest, ()),
    }


def _finite(limits: Array) -> Array:
    return np.minimum(limits, _ANY)
