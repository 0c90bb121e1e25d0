"""One tick of the velocity layer in order: prepare it, solve the hierarchy, finish it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter
from typing import Annotated, Any

import casadi as ca
import numpy as np

from uvms_ocp.codegen.kernel_layout import (
    FunctionField,
    Layout,
    Sized,
    Vector,
    arrays_of,
    number_in_memory,
    structure_of,
)
from uvms_ocp.codegen.kernels import bind_memory
from uvms_ocp.control.velocity import abort, ascent, braking, distances, speed_limit, viability
from uvms_ocp.control.velocity.goals import load_goals
from uvms_ocp.control.velocity.levels import LevelsProblem
from uvms_ocp.control.velocity.tick_memory import TickMemory
from uvms_ocp.estimation.degraded_modes import restrict
from uvms_ocp.estimation.fallbacks import (
    Freshness,
    echo_range,
    freshness_of,
    hold_last_valid,
    is_under_way,
    level_attitude,
    point_altimeter,
)
from uvms_ocp.mission import progress
from uvms_ocp.robot.channels import CHANNELS
from uvms_ocp.robot.signals import Trust
from uvms_ocp.solvers.hierarchy.solution import Status, TickResult, dense

_EXCESS_GAIN = 1.3
"""Factor of the velocity error of a joint by which its limit shrinks: the error still grows while
it is seen.
"""
_LARGEST_EXCESS = 0.2
"""Largest share of its velocity limit that a joint leaves."""
_RISE_TIME = 0.04
"""[s] Time constant with which the velocity error of a joint is learnt."""
_DECAY_TIME = 5.0
"""[s] Time constant with which it is forgotten."""
_SHORT_PERIOD = 0.01
"""[s] Control period up to which a joint is corrected before it is much faster than commanded."""
_UNCORRECTED = 2.0
"""[1/s] Share of its limit by which a joint gets faster than commanded in each second beyond that
period.
"""
_STEADY = 1e-9
"""Rounding: share of a joint's limit below which its command is rest, and share of its command by
which a steady command may change.
"""

_GYRO = CHANNELS.index("angular_velocity")

_STATUS_CODE = {status: code for code, status in enumerate(Status)}


def prepare_tick(tick: TickMemory) -> None:
    """Prepare a tick: replace what is missing of the estimate, and evaluate restriction, quantities
    and gates.
    """
    hold_last_valid(tick.sound, tick.t, tick.q, tick.v, tick.age, tick.joint_age)
    tick.age = tick.sound.age
    tick.joint_age = tick.sound.joint_age
    _begin(tick)
    tick.phase = tick.mission.phase
    restrict(tick.restriction, tick.t, tick.altitude_matters)
    if tick.restriction.attitude_open:
        level_attitude(tick.q)
    _follow_swing(tick)
    point_altimeter(tick.beam, tick.q)
    load_goals(tick.goals, tick.mission, tick.ascent, tick.t)
    doubts_altimeter = _doubts_altimeter(tick)
    lowest = 0.0
    has_altitude_task = False
    for i in range(len(tick.gates)):
        if tick.restriction.no_descent and tick.lands[i] != 0:
            tick.gates[i] = 0.0
        if (
            tick.reads_altitude[i] != 0
            and tick.gates[i] > 0.0
            and (not has_altitude_task or tick.rest_altitude[i] < lowest)
        ):
            lowest = tick.rest_altitude[i]
            has_altitude_task = True
    tick.echo[0] = echo_range(tick.beam, tick.t, tick.altimeter_range, lowest, doubts_altimeter)
    tick.altitude_valid = (
        math.isfinite(tick.beam.floor) and tick.t - tick.beam.since <= tick.hold_after
    )
    # Joints that brakes hold are where they were.
    braked = tick.restriction.joints_held and math.isfinite(tick.age) and tick.joint_age >= tick.age
    age = 0.0 if braked else tick.age
    if tick.altitude_matters and not doubts_altimeter:
        echo_age = tick.t - tick.beam.since
    else:
        echo_age = 0.0
    tick.echo_is_oldest = echo_age > age
    tick.oldest = max(age, echo_age)
    tick.freshness = freshness_of(tick.oldest, tick.hold_after, tick.stop_after)
    tick.awaits_first = tick.awaits_first and tick.age == math.inf
    if tick.awaits_first and is_under_way(tick.t - tick.mission.began, tick.stop_after):
        # Weight and buoyancy are carried meanwhile, or the vehicle would fall.
        tick.freshness = int(Freshness.STALE)
    tick.holds = is_blind(tick) or _waits(tick)
    for i in range(len(tick.previous)):
        tick.previous[i] = tick.command[i] / tick.pace
    _measure_distances(tick)


def _waits(tick: TickMemory) -> bool:
    """Return whether channels that are not good keep the robot where it is; a mission that cannot go
    on for them climbs where it can.
    """
    if tick.restriction.ended and tick.distress.aborts and tick.restriction.can_ascend:
        return False
    return tick.restriction.hold or tick.restriction.ended


def _follow_swing(tick: TickMemory) -> None:
    """Separate the swing of the vehicle from its mean attitude, and smooth the weight that the force
    layer finds at the tool.
    """
    gain = tick.rule.stop.dt / tick.swing_memory
    for k in range(3):
        if tick.swings[k] != 0:
            tick.passive[k] += tick.rule.stop.dt * tick.v[3 + k] - gain * tick.passive[k]
    tick.passive[3] -= gain * (tick.distress.push * tick.lift + tick.passive[3])


def _begin(tick: TickMemory) -> None:
    """Evaluate the external activations, which tell whether the altitude matters."""
    progress.start_at_first_tick(tick.mission, tick.t)
    progress.activations_at(tick.mission, tick.t, tick.gates)
    tick.altitude_matters = False
    for i in range(len(tick.gates)):
        tick.altitude_matters = tick.altitude_matters or (
            tick.reads_altitude[i] != 0 and tick.gates[i] != 0.0
        )


def _measure_distances(tick: TickMemory) -> None:
    """Measure the distances of tasks that are on or begin, at the present configuration and along a
    stop from it; of the stop only where it could come near a limit.
    """
    target = tick.mission.targets[tick.mission.phase]
    is_placed = False
    for k in range(tick.nearest.n_asking):
        i = tick.nearest.pairs[k].task
        if target[i] != 0.0 or tick.gates[i] != 0.0:
            if not is_placed:
                first_step = tick.rule.stop.dt if tick.near else math.inf
                distances.place_along_stop(
                    tick.nearest, tick.q, tick.command, tick.rule.stop.acceleration, first_step
                )
                is_placed = True
            distances.measure_pairs(tick.nearest, k, tick.goals.values)


def finish_tick(tick: TickMemory) -> None:
    """Finish a tick once the hierarchy is solved: outputs, velocity, and the mission's next
    state.
    """
    _report(tick)
    if tick.holds:
        _come_to_rest(tick)
    else:
        _choose(tick)
    tick.why = abort.AbortReason.NOTHING
    tick.due = progress.NONE
    tick.eventful = False
    if not progress.is_over(tick.mission):
        _check_mission(tick)


def _check_mission(tick: TickMemory) -> None:
    """Take the transition that is due, or give the mission up."""
    restriction = tick.restriction
    stopped = is_stopped(tick)
    is_hopeless = stopped and (restriction.ended or restriction.any_lost)
    clearance = math.nan
    if tick.distress.aborts:  # nothing else asks for it
        tick.lowest(tick.q, tick.height)
        unseen = tick.holds or _doubts_altimeter(tick) or not tick.altitude_valid
        clearance = math.nan if unseen else tick.height[0] - tick.beam.floor
    tick.why = abort.abort_reason(
        tick.distress,
        tick.mission,
        tick.t,
        tick.gates,
        tick.phase_quantities,
        is_hopeless,
        restriction.ended,
        clearance,
    )
    if tick.why != abort.AbortReason.NOTHING:
        tick.eventful = True
        if not tick.mission.given_up:
            knows_floor = not (tick.distress.pushed or _doubts_altimeter(tick))
            ascent.aim_ascent(tick.ascent, tick.q, tick.beam.highest if knows_floor else math.nan)
        progress.abort_mission(tick.mission, tick.t, not stopped)
    elif not tick.holds:
        tick.due = progress.transition_due(tick.mission, tick.t, tick.phase_quantities)
        tick.eventful = tick.due != progress.NONE or tick.mission.changed
        if tick.due != progress.NONE:
            progress.take_transition(tick.mission, tick.t, tick.due)


def _doubts_altimeter(tick: TickMemory) -> bool:
    """Return whether the altimeter is not to be trusted."""
    return tick.restriction.level[tick.channel[tick.altimeter]] != Trust.GOOD


def is_blind(tick: TickMemory) -> bool:
    """Judge whether no measurement of the velocity can be trusted."""
    return tick.freshness != Freshness.FRESH or tick.restriction.blind


def damps_turns(tick: TickMemory) -> bool:
    """Check whether the angular velocity is fed back although the robot is blind: while first
    readings are awaited and nothing speaks against the gyro.

    Before its first reading the filter's angular velocity is 0.
    """
    return tick.awaits_first and tick.restriction.level[_GYRO] == Trust.GOOD


def is_stopped(tick: TickMemory) -> bool:
    """Judge whether nothing is known of the state any more."""
    return tick.freshness == Freshness.LOST or (
        tick.restriction.ended and not tick.restriction.can_ascend
    )


def commit_velocity(tick: TickMemory) -> None:
    """Command the desired velocity."""
    for i in range(len(tick.command)):
        tick.change[i] = tick.wanted[i] / tick.wanted_pace - tick.previous[i]
        tick.command[i] = tick.wanted[i]
    tick.pace = tick.wanted_pace


def is_unknown(age: float, of_altitude: bool, altitude_valid: bool) -> bool:
    """Return whether a quantity is NaN: before the first measurement, and where its altitude is a
    fallback.

    age [s]: of the measurement.
    """
    return age == math.inf or (of_altitude and not altitude_valid)


def _report(tick: TickMemory) -> None:
    """Update the quantities that are reported, and those that phases read.

    A quantity that depends on a channel that is not good is NaN for phases, but not in the abort
    phase.
    """
    progress.measure_own(
        tick.mission,
        tick.t,
        0.0 - tick.distress.push * tick.lift,
        tick.distress.spent,
        tick.quantities,
    )
    of_altitude = tick.rests_on[tick.altimeter]
    for i in range(len(tick.quantities)):
        unknown = is_unknown(tick.age, of_altitude[i] != 0, tick.altitude_valid)
        tick.reported[i] = math.nan if unknown else tick.quantities[i]
        tick.phase_quantities[i] = tick.reported[i]
    for k in range(len(tick.channel)):
        channel = tick.rests_on[k]
        for i in range(len(tick.quantities)):
            if (
                tick.restriction.level[tick.channel[k]] != Trust.GOOD
                and channel[i] != 0
                and not tick.mission.given_up
            ):
                tick.phase_quantities[i] = math.nan
    for i in range(len(tick.quantities)):
        if not tick.holds:
            tick.last_phase_quantities[i] = tick.phase_quantities[i]


def _come_to_rest(tick: TickMemory) -> None:
    """Go on along the stop that the last tick with a valid estimate found clear of limits."""
    stop = tick.rule.stop
    braking.begin_stop(stop, tick.place, tick.command)
    braking.step_stop(stop)
    tick.place[:] = stop.q
    for i in range(len(tick.command)):
        tick.change[i] = (stop.v[i] - tick.command[i]) / tick.pace
        tick.command[i] = stop.v[i]
    tick.share = 0.0


def _choose(tick: TickMemory) -> None:
    """Command the desired velocity, as far as the limits on positions allow."""
    tick.place[:] = tick.q
    _wanted_velocity(tick)
    tick.near = viability.may_reach_limit(tick.rule, tick.wanted, tick.gates, tick.quantities)
    if tick.near:
        tick.share = viability.enforce_viability(
            tick.rule, tick.q, tick.command, tick.wanted, tick.gates, tick.quantities
        )
    else:
        tick.share = 1.0
    commit_velocity(tick)


def _wanted_velocity(tick: TickMemory) -> None:
    """Find the velocity that the tasks ask for, within the limits of each axis and the
    restrictions.
    """
    tick.wanted_pace = tick.pace
    if tick.usable:
        _shorten(tick)
        if tick.restriction.any_bad or tick.pace != 1.0:
            tick.wanted_pace = speed_limit.limit_speed(
                tick.speed_limit,
                tick.restriction,
                tick.beam,
                tick.q,
                tick.command,
                tick.pace,
                tick.wanted,
            )
    else:
        for i in range(len(tick.wanted)):  # one tick nearer to rest
            tick.wanted[i] = tick.command[i] - min(
                max(tick.command[i], -tick.speed_limit.step[i]), tick.speed_limit.step[i]
            )
    for i in range(len(tick.wanted)):
        # A jammed joint begins each tick at rest, so that the hierarchy counts on no more than one
        # tick's acceleration of it.
        if tick.jammed[i] != 0:
            tick.wanted[i] = 0.0


def _shorten(tick: TickMemory) -> None:
    """Shorten the solver's velocity to the velocity limits, with its direction kept.

    The limit of a joint that has lately been faster than commanded is reduced by that velocity
    error, so that the joint itself keeps its limit. Each joint has a limit of its own: one that is
    driven by the vehicle's drag would else slow the whole mission. At long control periods limits
    are reduced from the start. Neither the lag of a joint that brakes counts, nor motion at rest.
    """
    largest_ratio = 1.0
    dt = tick.rule.stop.dt
    for i in range(len(tick.solved)):
        if tick.is_joint[i] != 0:
            at_rest = abs(tick.command[i]) < _STEADY * tick.velocity_limit[i]
            ahead = tick.command[i] * (tick.v[i] - tick.command[i]) > 0.0
            if ahead and not at_rest:
                velocity_error = min(
                    _EXCESS_GAIN * abs(tick.v[i] - tick.command[i]),
                    _LARGEST_EXCESS * tick.velocity_limit[i],
                )
            else:
                velocity_error = 0.0
            if tick.command[i] * tick.change[i] < -_STEADY * tick.command[i] * tick.command[i]:
                velocity_error = min(velocity_error, tick.faster[i])
            gain = min(1.0, dt / (_RISE_TIME if velocity_error > tick.faster[i] else _DECAY_TIME))
            tick.faster[i] += gain * (velocity_error - tick.faster[i])
        largest_ratio = max(largest_ratio, abs(tick.solved[i]) / tick.velocity_limit[i])
    for i in range(len(tick.solved)):
        margin = tick.faster[i]
        if tick.is_joint[i] != 0:
            margin = max(
                margin, _UNCORRECTED * max(dt - _SHORT_PERIOD, 0.0) * tick.velocity_limit[i]
            )
        largest_speed = tick.velocity_limit[i] - margin
        tick.wanted[i] = min(max(tick.solved[i] / largest_ratio, -largest_speed), largest_speed)


class VelocityController(Layout):
    """Memory of a tick with its hierarchy, for one call of machine code: levels, solver and result."""

    tick: TickMemory
    """Memory of the tick, before and after the solver."""
    levels: FunctionField
    """Levels of the hierarchy, the function that `build_levels` makes."""
    solver: FunctionField
    """Solver of the hierarchy: J, lower, upper, rate, activation, gate, state -> v, state, report,
    residual.
    """
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
    """(n_rows,) state of the solver from the tick before; the active set of the strict one."""
    new_state: Annotated[Vector, Sized("n_rows")]
    """(n_rows,) state of the solver after this tick."""
    report: Annotated[Vector, Sized(2)]
    """(2,) code of the solver's `Status`, and iterations."""
    residual: Annotated[Vector, Sized("n_rows")]
    """(n_rows,) [m/s, rad/s] residuals of the rows, see `TickResult`."""
    status: int
    """Code of the solver's `Status`."""
    usable: Annotated[list[int], Sized("n_statuses")]
    """(n_statuses,) whether a solution of each status has a velocity to use."""


def solve(controller: VelocityController) -> int:
    """Solve the hierarchy; return the code of the `Status`. A kernel."""
    tick = controller.tick
    J = controller.jacobian
    lower = controller.lower
    upper = controller.upper
    rate = controller.rate
    activation = controller.activation
    gate = controller.gate
    goals = tick.goals.values
    controller.levels(
        tick.q,
        tick.v,
        tick.passive,
        tick.previous,
        tick.change,
        tick.echo,
        goals,
        tick.gates,
        J,
        lower,
        upper,
        rate,
        activation,
        gate,
        tick.quantities,
        controller.activity,
    )
    controller.solver(
        J,
        lower,
        upper,
        rate,
        activation,
        gate,
        controller.state,
        tick.solved,
        controller.new_state,
        controller.report,
        controller.residual,
    )
    controller.state[:] = controller.new_state
    controller.status = int(controller.report[0])
    tick.usable = controller.usable[controller.status] != 0
    return controller.status


def solve_and_finish(controller: VelocityController) -> int:
    """Solve the hierarchy and finish the tick; return the code of the `Status`. A kernel."""
    status = solve(controller)
    finish_tick(controller.tick)
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


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Solved:
    """How the hierarchy was solved at the newest tick, in arrays that stay where they are."""

    status: np.ndarray
    """() code of the `Status`."""
    residual: np.ndarray
    """(n_rows,) [m/s, rad/s]"""
    activity: np.ndarray
    """(n_activity,)"""
    solve_time: np.ndarray
    """() [s] of the solver, or of both solver and end of the tick."""


def finish_in_c(controller: VelocityController) -> tuple[Solved, Callable[[], None]]:
    """Return a function that solves the hierarchy and finishes the tick in one call of machine
    code, and where it leaves how.
    """
    run = solve_in_c(controller)
    solved = Solved(
        status=number_in_memory(controller, "status"),
        residual=arrays_of(controller).residual,
        activity=arrays_of(controller).activity,
        solve_time=np.zeros(()),
    )

    def call() -> None:
        begin = perf_counter()
        run(controller)
        solved.solve_time[...] = perf_counter() - begin

    return solved, call


def finish_by(
    solve: Callable[[], TickResult],
    after: Callable[[], None],
    problem: LevelsProblem,
    arrays: Any,
    memory: TickMemory,
) -> tuple[Solved, Callable[[], None]]:
    """Return a function that solves the hierarchy by a solver that Python calls, and finishes the
    tick by `after`, and where it leaves how. arrays: arrays of the `TickMemory`.
    """
    n_out = problem.function.n_out()
    solved = Solved(
        status=np.zeros((), int),
        residual=np.zeros(sum(problem.sizes)),
        activity=np.zeros(problem.function.numel_out(n_out - 1)),
        solve_time=np.zeros(()),
    )

    def call() -> None:
        result = solve()
        arrays.solved[:] = result.v
        arrays.quantities[:] = result.extras[0]
        memory.usable = result.status.usable
        after()
        solved.status[...] = _STATUS_CODE[result.status]
        solved.residual[:] = result.residual
        solved.activity[:] = result.extras[1]
        solved.solve_time[...] = result.solve_time

    return solved, call
