"""One tick of the velocity layer in order: prepare it, solve the hierarchy, finish it."""

from __future__ import annotations

import math
from collections.abc import Callable
from time import perf_counter
from typing import Annotated, Any

import casadi as ca
import numpy as np

from uvms_ocp.codegen.kernel_layout import FunctionField, Layout, Sized, Vector, structure_of, view
from uvms_ocp.codegen.kernels import bind_memory
from uvms_ocp.control.velocity import abort, ascent, braking, distances, speed_limit, viability
from uvms_ocp.control.velocity.goals import load_goals
from uvms_ocp.control.velocity.levels import LevelsProblem
from uvms_ocp.control.velocity.tick_memory import TickMemory
from uvms_ocp.estimation.degraded_modes import CHANNELS, restrict
from uvms_ocp.estimation.fallbacks import (
    Freshness,
    echo_range,
    freshness_of,
    hold_last_valid,
    is_under_way,
    point_altimeter,
)
from uvms_ocp.mission import progress
from uvms_ocp.robot.signals import Trust
from uvms_ocp.solvers.hierarchy.solution import Status, TickResult, dense

_EXCESS_GAIN = 1.3
"""Times the error of a joint's velocity that is left of its limit: the error still grows as it is
seen.
"""
_LARGEST_EXCESS = 0.2
"""Share of its velocity limit that a joint leaves at most."""
_RISE_TIME = 0.04
"""[s] Time constant with which it is learnt that a joint goes faster than commanded."""
_DECAY_TIME = 5.0
"""[s] Time constant with which that is forgotten."""
_SHORT_PERIOD = 0.01
"""[s] Control period up to which a joint is corrected before it is much faster than commanded."""
_UNCORRECTED = 2.0
"""[1/s] Share of its limit by which it gets faster than commanded in a longer period."""

_GYRO = CHANNELS.index("angular_velocity")

Solved = tuple[int, np.ndarray, np.ndarray, float]
"""Code of the `Status`, residual (n_rows,) [m/s, rad/s], activity (n_activity,), time [s] of the
solver or of both.
"""
_STATUS_CODE = {status: code for code, status in enumerate(Status)}


def prepare_tick(m: TickMemory) -> None:
    """Prepare a tick: replace what is missing of the estimate, and evaluate restriction, quantities
    and gates.
    """
    hold_last_valid(m.sound, m.t, m.q, m.v, m.age, m.joint_age)
    m.age = m.sound.age
    m.joint_age = m.sound.joint_age
    _follow_swing(m)
    point_altimeter(m.beam, m.q)
    _begin(m)
    load_goals(m.goals, m.mission, m.ascent, m.t)
    restrict(m.restriction, m.t, m.altitude_matters)
    distrusted = _doubts_altimeter(m)
    lowest = 0.0
    lower = False
    for i in range(len(m.gates)):
        if m.restriction.no_descent and m.lands[i] != 0:
            m.gates[i] = 0.0
        if (
            m.reads_altitude[i] != 0
            and m.gates[i] > 0.0
            and (not lower or m.rest_altitude[i] < lowest)
        ):
            lowest = m.rest_altitude[i]
            lower = True
    m.echo[0] = echo_range(m.beam, m.t, m.altimeter_range, lowest, distrusted)
    m.altitude_valid = math.isfinite(m.beam.floor) and m.t - m.beam.since <= m.hold_after
    # Joints that brakes hold are where they were.
    braked = m.restriction.joints_held and math.isfinite(m.age) and m.joint_age >= m.age
    age = 0.0 if braked else m.age
    if m.altitude_matters and not distrusted:
        echo_age = m.t - m.beam.since
    else:
        echo_age = 0.0
    m.echo_is_oldest = echo_age > age
    m.oldest = max(age, echo_age)
    m.freshness = freshness_of(m.oldest, m.hold_after, m.stop_after)
    m.awaits_first = m.awaits_first and m.age == math.inf
    if m.awaits_first and is_under_way(m.t - m.mission.began, m.stop_after):
        # Weight and buoyancy are carried meanwhile, or the vehicle would fall.
        m.freshness = int(Freshness.STALE)
    m.holds = is_blind(m) or m.restriction.hold or (m.restriction.ended and not m.distress.aborts)
    for i in range(len(m.previous)):
        m.previous[i] = m.command[i] / m.pace
    _measure_distances(m)


def _follow_swing(m: TickMemory) -> None:
    """Separate what swings from its mean, and smooth the weight that the force layer finds at the
    tool.
    """
    gain = m.rule.stop.dt / m.swing_memory
    for k in range(3):
        if m.swings[k] != 0:
            m.passive[k] += m.rule.stop.dt * m.v[3 + k] - gain * m.passive[k]
    m.passive[3] -= gain * (m.distress.push * m.lift + m.passive[3])


def _begin(m: TickMemory) -> None:
    """Evaluate the external activations, which tell whether the altitude matters."""
    progress.start_at_first_tick(m.mission, m.t)
    progress.activations_at(m.mission, m.t, m.gates)
    m.altitude_matters = False
    for i in range(len(m.gates)):
        m.altitude_matters = m.altitude_matters or (m.reads_altitude[i] != 0 and m.gates[i] != 0.0)


def _measure_distances(m: TickMemory) -> None:
    """Measure the distances that tasks ask for which are on or begin; on the way to rest where that
    could come near a limit.
    """
    target = m.mission.targets[m.mission.phase]
    looked = False
    for k in range(m.nearest.n_asking):
        i = m.nearest.pairs[k].task
        if target[i] != 0.0 or m.gates[i] != 0.0:
            if not looked:
                first_step = m.rule.stop.dt if m.near else math.inf
                distances.place_along_stop(
                    m.nearest, m.q, m.command, m.rule.stop.acceleration, first_step
                )
                looked = True
            distances.measure_pairs(m.nearest, k, m.goals.values)


def finish_tick(m: TickMemory) -> None:
    """Finish a tick once the hierarchy is solved: outputs, velocity, and the mission's next
    state.
    """
    _report(m)
    if m.holds:
        _come_to_rest(m)
    else:
        _choose(m)
    m.why = abort.AbortReason.NOTHING
    m.due = progress.NONE
    m.eventful = False
    if not progress.is_over(m.mission):
        _check_mission(m)


def _check_mission(m: TickMemory) -> None:
    """Take the transition that is due, or give the mission up."""
    less = m.restriction
    stopped = is_stopped(m)
    hopeless = stopped and (less.ended or less.any_lost)
    clearance = math.nan
    if m.distress.aborts:  # nothing else asks for it
        m.lowest(m.q, m.height)
        unseen = m.holds or _doubts_altimeter(m) or not m.altitude_valid
        clearance = math.nan if unseen else m.height[0] - m.beam.floor
    m.why = abort.abort_reason(
        m.distress, m.mission, m.t, m.gates, m.phase_quantities, hopeless, less.ended, clearance
    )
    if m.why != abort.AbortReason.NOTHING:
        m.eventful = True
        if not m.mission.given_up:
            believed = not (m.distress.pushed or _doubts_altimeter(m))
            ascent.aim_ascent(m.ascent, m.q, m.beam.highest if believed else math.nan)
        progress.abort_mission(m.mission, m.t, not stopped)
    elif not m.holds:
        m.due = progress.transition_due(m.mission, m.t, m.phase_quantities)
        m.eventful = m.due != progress.NONE or m.mission.changed
        if m.due != progress.NONE:
            progress.take_transition(m.mission, m.t, m.due)


def _doubts_altimeter(m: TickMemory) -> bool:
    """Return whether the altimeter is not to be trusted."""
    return m.restriction.level[m.channel[m.altimeter]] != Trust.GOOD


def is_blind(m: TickMemory) -> bool:
    """Evaluate the property of `TickInputs` of this name."""
    return m.freshness != Freshness.FRESH or m.restriction.blind


def damps_turns(m: TickMemory) -> bool:
    """Return whether the angular velocity is fed back although the robot is blind.

    So while first readings are awaited and nothing speaks against the gyro: where it has not spoken
    the filter knows of no turn.
    """
    return m.awaits_first and m.restriction.level[_GYRO] == Trust.GOOD


def is_stopped(m: TickMemory) -> bool:
    """Evaluate the property of `TickInputs` of this name."""
    return m.freshness == Freshness.LOST or (m.restriction.ended and not m.restriction.can_ascend)


def commit_velocity(m: TickMemory) -> None:
    """Command the velocity that is wanted."""
    for i in range(len(m.command)):
        m.change[i] = m.wanted[i] / m.wanted_pace - m.previous[i]
        m.command[i] = m.wanted[i]
    m.pace = m.wanted_pace


def is_unknown(age: float, of_altitude: bool, altitude_valid: bool) -> bool:
    """Return whether a quantity is NaN: before the first measurement, and where its altitude is a
    fallback.

    age [s]: of the measurement.
    """
    return age == math.inf or (of_altitude and not altitude_valid)


def _report(m: TickMemory) -> None:
    """Update the quantities that are reported, and those that phases read.

    Phases read no quantity that rests on a channel that is not good, but in the abort phase all.
    """
    progress.measure_own(
        m.mission, m.t, 0.0 - m.distress.push * m.lift, m.distress.spent, m.quantities
    )
    of_altitude = m.rests_on[m.altimeter]
    for i in range(len(m.quantities)):
        unknown = is_unknown(m.age, of_altitude[i] != 0, m.altitude_valid)
        m.reported[i] = math.nan if unknown else m.quantities[i]
        m.phase_quantities[i] = m.reported[i]
    for k in range(len(m.channel)):
        channel = m.rests_on[k]
        for i in range(len(m.quantities)):
            if (
                m.restriction.level[m.channel[k]] != Trust.GOOD
                and channel[i] != 0
                and not m.mission.given_up
            ):
                m.phase_quantities[i] = math.nan
    for i in range(len(m.quantities)):
        if not m.holds:
            m.last_phase_quantities[i] = m.phase_quantities[i]


def _come_to_rest(m: TickMemory) -> None:
    """Go on along the stop that the last tick with a measurement has found clear."""
    way = m.rule.stop
    braking.begin_stop(way, m.place, m.command)
    braking.step_stop(way)
    m.place[:] = way.q
    for i in range(len(m.command)):
        m.change[i] = (way.v[i] - m.command[i]) / m.pace
        m.command[i] = way.v[i]
    m.share = 0.0


def _choose(m: TickMemory) -> None:
    """Command the velocity that is wanted, as far as the limits on positions let it be taken."""
    m.place[:] = m.q
    _wanted_velocity(m)
    m.near = viability.may_reach_limit(m.rule, m.wanted, m.gates, m.quantities)
    if m.near:
        m.share = viability.enforce_viability(
            m.rule, m.q, m.command, m.wanted, m.gates, m.quantities
        )
    else:
        m.share = 1.0
    commit_velocity(m)


def _wanted_velocity(m: TickMemory) -> None:
    """Find the velocity that the tasks ask for, within what the limits of each axis and the
    restrictions leave.
    """
    m.wanted_pace = m.pace
    if m.usable:
        _shorten(m)
        if m.restriction.any_bad or m.pace != 1.0:
            m.wanted_pace = speed_limit.limit_speed(
                m.speed_limit, m.restriction, m.beam, m.q, m.command, m.pace, m.wanted
            )
    else:
        for i in range(len(m.wanted)):  # one tick nearer to rest
            m.wanted[i] = m.command[i] - min(
                max(m.command[i], -m.speed_limit.step[i]), m.speed_limit.step[i]
            )
    for i in range(len(m.wanted)):
        # From rest at every tick: the hierarchy counts on no more than one tick's acceleration of
        # such a joint.
        if m.jammed[i] != 0:
            m.wanted[i] = 0.0


def _shorten(m: TickMemory) -> None:
    """Shorten the solver's velocity to the velocity limits, with its direction kept.

    A joint that has lately been faster than commanded leaves that much of its limit, so that it
    keeps the limit itself: each joint by itself, or one that is driven by the vehicle's drag would
    slow the whole mission. At long control periods a joint leaves some of its limit from the start.
    Its lag as it brakes does not count, nor what moves it at rest.
    """
    excess = 1.0
    dt = m.rule.stop.dt
    for i in range(len(m.solved)):
        if m.is_joint[i] != 0:
            ahead = m.command[i] * (m.v[i] - m.command[i]) > 0.0
            if ahead:
                faster = min(
                    _EXCESS_GAIN * abs(m.v[i] - m.command[i]), _LARGEST_EXCESS * m.velocity_limit[i]
                )
            else:
                faster = 0.0
            if m.command[i] * m.change[i] < 0.0:
                faster = min(faster, m.faster[i])
            gain = min(1.0, dt / (_RISE_TIME if faster > m.faster[i] else _DECAY_TIME))
            m.faster[i] += gain * (faster - m.faster[i])
        excess = max(excess, abs(m.solved[i]) / m.velocity_limit[i])
    for i in range(len(m.solved)):
        margin = m.faster[i]
        if m.is_joint[i] != 0:
            margin = max(margin, _UNCORRECTED * max(dt - _SHORT_PERIOD, 0.0) * m.velocity_limit[i])
        largest_speed = m.velocity_limit[i] - margin
        m.wanted[i] = min(max(m.solved[i] / excess, -largest_speed), largest_speed)


# The hierarchy solved between `before` and `after`, in machine code: levels, solver, and what comes
# of it.


class VelocityController(Layout):
    """Memory of a tick with its hierarchy: levels, solver, and what comes of it."""

    tick: TickMemory
    """Memory of the tick, before and after the solver."""
    levels: FunctionField
    """Levels, as `LevelsProblem.function`."""
    solver: FunctionField
    """J, lower, upper, rate, activation, gate, state -> v, state, report, residual."""
    jacobian: Annotated[Vector, Sized("n_entries")]
    """(n_rows, n_v) [1, m, 1/rad] Jacobian of all levels, column after column."""
    lower: Annotated[Vector, Sized("n_rows")]
    """(n_rows,) [m/s, rad/s] lower bounds of the rows, see `Level`."""
    upper: Annotated[Vector, Sized("n_rows")]
    """(n_rows,) [m/s, rad/s] upper bounds of the rows."""
    rate: Annotated[Vector, Sized("n_rows")]
    """(n_rows,) [m/s, rad/s] desired rates of the rows."""
    activation: Annotated[Vector, Sized("n_rows")]
    """(n_rows,) activations of the rows, internal times external."""
    gate: Annotated[Vector, Sized("n_rows")]
    """(n_rows,) 1 for rows that count, 0 for others."""
    activity: Annotated[Vector, Sized("n_activity")]
    """(n_activity,) activations again, as the levels function gives them for the record."""
    state: Annotated[Vector, Sized("n_rows")]
    """(n_rows,) state of the solver from the tick before: of the strict one its active set."""
    new_state: Annotated[Vector, Sized("n_rows")]
    """(n_rows,) state of the solver after this tick."""
    report: Annotated[Vector, Sized(2)]
    """(2,) code of the solver's `Status`, and iterations."""
    residual: Annotated[Vector, Sized("n_rows")]
    """(n_rows,) [m/s, rad/s] residuals of the rows, see `TickResult`."""
    usable: Annotated[list[int], Sized("n_statuses")]
    """(n_statuses,) whether a solution of each status has a velocity to use."""


def solve(c: VelocityController) -> int:
    """Solve the hierarchy; return the code of the `Status`. A kernel."""
    m = c.tick
    J = c.jacobian
    low = c.lower
    up = c.upper
    rate = c.rate
    on = c.activation
    gate = c.gate
    goals = m.goals.values
    c.levels(
        m.q,
        m.v,
        m.passive,
        m.previous,
        m.change,
        m.echo,
        goals,
        m.gates,
        J,
        low,
        up,
        rate,
        on,
        gate,
        m.quantities,
        c.activity,
    )
    c.solver(J, low, up, rate, on, gate, c.state, m.solved, c.new_state, c.report, c.residual)
    c.state[:] = c.new_state
    status = int(c.report[0])
    m.usable = c.usable[status] != 0
    return status


def solve_and_finish(c: VelocityController) -> int:
    """Solve the hierarchy and finish the tick; return the code of the `Status`. A kernel."""
    status = solve(c)
    finish_tick(c.tick)
    return status


def velocity_controller(
    tick: TickMemory, problem: LevelsProblem, core: ca.Function | None
) -> VelocityController | None:
    """Return a `VelocityController` whose tick is a copy of this one; `None` without a core, as
    `CompiledSolver.core` gives it.
    """
    if core is None:
        return None
    levels = dense(problem.function)
    structure = structure_of(
        VelocityController,
        tick=type(tick),
        levels=levels,
        solver=core,
        n_rows=sum(problem.sizes),
        n_entries=levels.numel_out(0),
        n_activity=levels.numel_out(levels.n_out() - 1),
        n_statuses=len(Status),
    )
    memory = structure()
    memory.tick = tick
    memory.usable[:] = [status.usable for status in Status]
    return memory


def solve_in_c(controller: VelocityController) -> Callable[[VelocityController], int]:
    """Return `solve_and_finish` for this memory, in machine code where there is a compiler."""
    (run,) = bind_memory(controller, (solve_and_finish,))
    return run


def finish_in_c(controller: VelocityController) -> Callable[[], Solved]:
    """Return a function that solves the hierarchy and finishes the tick in one call of machine
    code.
    """
    run = solve_in_c(controller)
    residual = view(controller.residual)
    activity = view(controller.activity)

    def call() -> Solved:
        begin = perf_counter()
        status = run(controller)
        return status, residual.copy(), activity.copy(), perf_counter() - begin

    return call


def finish_by(
    solve: Callable[[], TickResult], after: Callable[[], None], arrays: Any, memory: TickMemory
) -> Callable[[], Solved]:
    """Return a function that solves the hierarchy by a solver that Python calls, and finishes the
    tick by `after`. arrays: those of the `TickMemory`.
    """

    def call() -> Solved:
        result = solve()
        arrays.solved[:] = result.v
        arrays.quantities[:] = result.extras[0]
        memory.usable = result.status.usable
        after()
        return _STATUS_CODE[result.status], result.residual, result.extras[1], result.solve_time

    return call
