"""Kinematic control layer: state estimates in, reference velocities out ([Gao2022] figure 4)."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from time import perf_counter
from typing import Any, Protocol

import casadi as ca
import numpy as np

from uvms_ocp.checks import checked, checked_on_failure, replace_unchecked, unchecked_constructor
from uvms_ocp.codegen.kernel_layout import arrays_of, number_in_memory
from uvms_ocp.codegen.kernels import bind_memory
from uvms_ocp.codegen.sequence import Elapsed, Source, Step, values_of
from uvms_ocp.control.velocity import (
    goal_tracks,
    goals as task_goals,
    levels,
    position_guards,
    tick as velocity_tick,
)
from uvms_ocp.control.velocity.abort import (
    AbortMonitor,
    AbortReason,
    ActuationFeedback,
)
from uvms_ocp.control.velocity.ascent import ascent_goal
from uvms_ocp.control.velocity.guide import Guide
from uvms_ocp.control.velocity.tick_memory import altimeter_of, inputs_of, tick_memory
from uvms_ocp.control.velocity.tick_state import TickInputs
from uvms_ocp.errors import InvalidInput
from uvms_ocp.estimation import degraded_modes
from uvms_ocp.estimation.fallbacks import Freshness, LastFloorRange, LastValidEstimate, Watchdog
from uvms_ocp.mission import Event, Mission, MissionState, Phase
from uvms_ocp.mission.progress import (
    is_over,
    state_after_abort,
    state_after_transition,
    write_state,
)
from uvms_ocp.record.display import SmallTable, TableDisplay, rows_of
from uvms_ocp.record.swings import SwingWatch
from uvms_ocp.robot.dimensions import dimensions_of
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.shapes.collision_model import any_places, with_any_distances
from uvms_ocp.robot.signals import ChannelHealth, Command, StateEstimate, unchecked_command
from uvms_ocp.solvers.hierarchy.core import CompiledSolver
from uvms_ocp.solvers.hierarchy.solution import InPlaceTick, Tick
from uvms_ocp.types import Period

_tick_state = unchecked_constructor(TickInputs)
_FRESHNESS = tuple(Freshness)


class HierarchySolver(Protocol):
    """Solver of hierarchies for the control layer."""

    def bind(self, levels_function: ca.Function, sizes: tuple[int, ...]) -> Tick: ...


@checked
class KinematicController(TableDisplay):
    """Runs a mission: a callable ``(StateEstimate, t) -> Command``.

    One tick: `observe` what is known, solve the hierarchy, keep what a stop can keep, advance the
    mission, `command`. Holds the mission's state and the last motion; `events` is the log of
    transitions. Build one per run, which begins with its first tick, whatever the clock shows.
    """

    def __init__(
        self,
        *,
        robot: Robot,
        mission: Mission,
        solver: HierarchySolver,
        dt: Period,
        watchdog: Watchdog | None = None,
        guide: Guide | None = None,
    ) -> None:
        """dt [s]: control period. guide: whose velocities replace those of the hierarchy until it
        gives up.

        Raises `InvalidInput` where it is not > 0, and what `build_levels` and
        `Mission.check_quantities` raise.
        """
        self.robot = robot
        self.mission = mission
        self.dt = dt
        self.guide = guide
        self.problem: levels.LevelsProblem = levels.build_levels(
            robot, mission.hierarchy, dt, mission.beside_tasks
        )
        mission.check_quantities(self.problem.quantity_names)
        self.events: list[Event] = []
        self.left: list[MissionState] = []
        """State of the mission just before each event."""
        self.watchdog = watchdog or Watchdog()
        names = self.problem.quantity_names
        tasks = mission.hierarchy.tasks
        guards = position_guards.position_guards(robot, tasks, names)
        tracks = goal_tracks.tracks_of(mission, dt)
        asking = task_goals.distance_tasks(mission)
        pairs = [pairs for _, _, pairs in asking]
        models = position_guards.models_of(guards)
        models += [nearest_pairs.model for nearest_pairs in pairs]
        dimensions = position_guards.with_guards(dimensions_of(robot), robot, guards)
        dimensions = goal_tracks.with_tracks(dimensions, tracks)
        dimensions = task_goals.with_nearest(dimensions, pairs)
        dimensions = with_any_distances(dimensions, models, robot)
        functions = {
            **position_guards.viability_functions(robot, guards, dt),
            "integrate": task_goals.motion_function(robot, pairs, dimensions),
            "places": any_places(models, robot),
        }
        memory = tick_memory(robot, mission, self.problem, self.watchdog, dimensions, functions)
        core = None
        if isinstance(solver, CompiledSolver):
            core = solver.core(self.problem.function.size2_out(0), self.problem.sizes)
        self.whole = velocity_tick.velocity_controller(memory, self.problem, core)
        """A `VelocityController` around `memory`; `None` where Python calls the solver."""
        if self.whole is not None:
            memory = self.whole.tick
        self.memory = memory
        """All that a tick knows, a `TickMemory`."""
        self._arrays = arrays_of(memory)
        self._parameters = task_goals.MissionParameters(mission, memory.goals, tracks, dt)
        self._measuring = task_goals.DistanceProvider(memory.nearest, asking, robot)
        self.prepare, self._take = bind_memory(
            memory, (velocity_tick.prepare_tick, velocity_tick.commit_velocity)
        )
        if self.whole is None:
            solved, self._finish = self._finish_by(solver)
        else:
            solved, self._finish = velocity_tick.finish_in_c(self.whole)
        self._solved: velocity_tick.Solved = solved
        self._tick_time = np.zeros(())
        self._guarding = position_guards.ViabilitySetup(robot, guards, dt, memory.rule)
        self._sound = LastValidEstimate(robot, memory.sound)
        self._echo = LastFloorRange(robot, altimeter_of(robot, tasks), memory.beam)
        self._distress = AbortMonitor(mission, robot, memory.distress)
        self._feedback = ActuationFeedback()
        self._restriction = degraded_modes.FREE
        self._health: tuple[ChannelHealth, ...] = ()
        self._bad: list[ChannelHealth] = []
        """Channels of the last verdicts that are not good, searched only where these are new."""
        self._awaited_limits = [_awaited_limits(phase, names) for phase in mission.all_phases]
        """Quantities whose fall below a limit ends a phase, for each phase; watched for swings."""
        self._swings = SwingWatch(dt, floating=bool(robot.n_vehicle))
        self._state = mission.start()
        self._progress = memory.mission  # made anew whenever it is asked for
        write_state(self._progress, self._state)
        self._progress.started = False

    def _table(self) -> SmallTable:
        values = {
            "robot": self.robot.name,
            **self.mission.describe(self._state),
            "period [s]": self.dt,
        }
        return SmallTable(title=type(self).__name__, rows=rows_of(values))

    @property
    def state(self) -> MissionState:
        """State of the mission."""
        return self._state

    @property
    def quantities(self) -> dict[str, float]:
        """Quantities as last measured [in their units]; NaN where unknown."""
        return self._named(self._arrays.last_phase_quantities)

    def steps(self) -> list[Step] | None:
        """Return the steps of a tick, from the inputs in `memory` to the command there; `None` with
        a guide, which looks at every tick. The last one is `solve`, before which the force layer
        tells what it met in the tick before.
        """
        if self.guide is not None:
            return None
        steps = [Step("prepare", self.prepare, (self.memory,))]
        if any(self._parameters.asked):
            steps.append(Step("ask_goals", self._ask_goals))
        if self.whole is None:
            steps.append(Step("solve", self._finish))
        else:
            steps.append(Step("solve", velocity_tick.solve_in_c(self.whole), (self.whole,)))
        return steps

    def _ask_goals(self) -> None:
        """Ask tasks for goals that no kernel evaluates."""
        self._parameters.ask(self._state, self.memory.t)

    @property
    def without_c_form(self) -> dict[str, str]:
        """Names of tasks that Python is asked about wherever kernels run, and for what."""
        return position_guards.without_c_form(
            self.robot, self.mission, self.dt, self.problem.quantity_names
        )

    @property
    def kinematic(self) -> KinematicController:
        """This controller, under the name by which a `DynamicController` gives the one below it."""
        return self

    @checked_on_failure
    def __call__(self, estimate: StateEstimate, t: float) -> Command:
        """Return the command for the tick at time t [s]."""
        return self.command(self.observe(estimate, t))

    @checked_on_failure
    def observe(self, estimate: StateEstimate, t: float) -> TickInputs:
        """Begin a tick at time t [s]: what is missing of the measurement is replaced by its last
        value.
        """
        started = perf_counter()
        memory = self.memory
        arrays = self._arrays
        self._sound.check(estimate)
        arrays.q[:] = estimate.q
        arrays.v[:] = estimate.v
        memory.t = t
        memory.altimeter_range = estimate.altimeter_range
        memory.age = estimate.age
        memory.joint_age = estimate.joint_age
        self._hear(estimate.health)
        bad = self._bad
        if bad or self._restriction is not degraded_modes.FREE:
            restriction = memory.restriction
            degraded_modes.write_trust(restriction.level, restriction.since, bad)
        if not self._progress.started:
            self._state = self.mission.start(t)
        self.prepare(memory)
        self._measuring.answer.check()
        return self._inputs(self._sound.substitute(estimate), t, started)

    def _inputs(self, estimate: StateEstimate, t: float, started: float) -> TickInputs:
        """Read the inputs of the tick as kernels have left them, and log changes of restriction and
        freshness.
        """
        memory = self.memory
        arrays = self._arrays
        bad = self._bad
        if bad or self._restriction is not degraded_modes.FREE:
            restriction = self._restricted(bad)
        else:
            restriction = degraded_modes.FREE
        freshness = _FRESHNESS[memory.freshness]
        if freshness is not self.watchdog.verdict:
            lost = ", ".join(item.channel for item in self._restriction.lost)
            if memory.echo_is_oldest:
                channel = degraded_modes.ALTIMETER
            else:
                channel = estimate.oldest or lost
            self.watchdog.judge(memory.oldest, t, channel)
        return _tick_state(
            begin=started,
            t=t,
            estimate=estimate,
            echo=arrays.echo.item(),
            altitude_valid=bool(memory.altitude_valid),
            mission=self._state,
            gates=arrays.gates.copy(),
            freshness=freshness,
            restriction=restriction,
            blind=bool(velocity_tick.is_blind(memory)),
            stopped=bool(velocity_tick.is_stopped(memory)),
        )

    def note_feedback(self, feedback: ActuationFeedback) -> None:
        """Note what the force layer met in a tick, for guides and reasons to give up; kernels have
        it from `hear_forces`.
        """
        self._feedback = feedback

    def hear_fault(self, fault: str) -> None:
        """Take the reason why somebody else's controller cannot go on, for the next tick; empty where
        it can.
        """
        self.note_feedback(ActuationFeedback(fault=fault))
        self.memory.distress.fault = bool(fault)

    @checked_on_failure
    def command(self, tick: TickInputs) -> Command:
        """Return the command for what `observe` has found."""
        arrays = self._arrays
        if self._parameters.asked[tick.mission.phase]:
            self._parameters.ask(tick.mission, tick.t)
        self._finish()
        self._settle(tick, 1)
        self._tick_time[...] = perf_counter() - tick.begin
        command = unchecked_command(
            v=arrays.command.copy(),
            hold=tick.blind,
            stop=tick.stopped,
            brakes=tick.restriction.joints_held,
            finished=self._state.over,
            telemetry=values_of(self.series()),
        )
        if self.guide is None:
            return command
        return self._guided(self.guide, tick, command)

    @checked_on_failure
    def catch_up(
        self,
        estimate: StateEstimate,
        t: float,
        ticks: int,
        feedback: ActuationFeedback | None = None,
    ) -> None:
        """Take note of what kernels alone have done for so many ticks, the last with this
        measurement at t [s].

        feedback: of the force layer in the tick before that.
        """
        if feedback is not None:
            self.note_feedback(feedback)
        self._hear(estimate.health)
        self._settle(self._inputs(estimate, t, 0.0), ticks)

    @property
    def quiet_ticks(self) -> int:
        """Ticks until `look_for_swings` is due."""
        return self._swings.due

    def _hear(self, health: tuple[ChannelHealth, ...]) -> None:
        if health is not self._health:
            self._health = health
            self._bad = degraded_modes.degraded_channels(health)

    def _settle(self, tick: TickInputs, ticks: int) -> None:
        """Log swings and events once kernels have finished the tick, so many after the last that
        was settled.
        """
        self.look_for_swings(tick.t, ticks)
        if self.memory.eventful:
            self._advance(tick)

    @checked_on_failure
    def look_for_swings(self, t: float, ticks: int) -> None:
        """Log swings at time t [s], so many ticks after the last look: all there is to do where
        kernels alone met nothing new.
        """
        self._measuring.answer.check()
        self._guarding.answer.check()
        phase = self._state.phase
        arrays = self._arrays
        for swing in self._swings.after(
            phase, arrays.q, arrays.phase_quantities, self._awaited_limits[phase], ticks
        ):
            self.watchdog.alarms.append((t, str(swing)))

    def _guided(self, guide: Guide, tick: TickInputs, command: Command) -> Command:
        """Replace the command by that of the guide; where the guide gives up, log an alarm."""
        guided = guide(tick, self._feedback, self.pending)
        if guided.why:
            self.watchdog.alarms.append((tick.t, guided.why))
        telemetry = {**command.telemetry, "guided": guided.v is not None}
        if guided.v is None:
            return replace_unchecked(command, telemetry=telemetry)
        new = replace_unchecked(command, v=guided.v, telemetry=telemetry)
        self.follow(new)
        return new

    def series(self, *, clocked: bool = False) -> dict[str, Source]:
        """Return the series of a tick for the record, on the memory that the newest tick has left.

        clocked: a sequence of the `steps` measures times.
        """
        memory = self.memory
        solved = self._solved
        solve_time: Source = solved.solve_time
        tick_time: Source = self._tick_time
        if clocked:
            tick_time = Elapsed("prepare", "solve")
        if clocked and self.whole is not None:
            solve_time = Elapsed("solve", "solve")
        return {
            "phase": number_in_memory(memory, "phase"),
            "activations": self._arrays.gates,
            "activity": solved.activity,
            "residual": solved.residual,
            "quantities": self._arrays.reported,
            "status": solved.status,
            "viable_share": number_in_memory(memory, "share"),
            "solve_time": solve_time,
            "freshness": number_in_memory(memory, "freshness"),
            "tick_time": tick_time,
        }

    def _finish_by(
        self, solver: HierarchySolver
    ) -> tuple[velocity_tick.Solved, Callable[[], None]]:
        tick = solver.bind(self.problem.function, self.problem.sizes)
        inputs = inputs_of(self._arrays, arrays_of(self.memory.goals))
        if isinstance(tick, InPlaceTick):
            solve = tick.adopt(*inputs)
        else:
            solve = partial(tick, *inputs)
        (finish,) = bind_memory(self.memory, (velocity_tick.finish_tick,))
        return velocity_tick.finish_by(
            solve, partial(finish, self.memory), self.problem, self._arrays, self.memory
        )

    @checked_on_failure
    def follow(self, command: Command) -> None:
        """Take what somebody else commands for the velocity of this tick. Raises `InvalidInput` for
        one of another size.
        """
        if command.v.shape != self._arrays.command.shape:
            raise InvalidInput(f"command.v has shape {command.v.shape}; give ({self.robot.n_v},)")
        self.memory.wanted[:] = command.v.tolist()
        self.memory.wanted_pace = 1.0
        self._take(self.memory)

    def pending(self) -> str:
        """Describe what the current phase waits for, with the last values, and which channels hold
        it back.
        """
        waits = self.mission.pending(self.state, self.quantities)
        bad = self._restriction.bad
        if self.state.over or not bad:
            return waits
        return f"{waits}; {degraded_modes.describe_channels(bad)}"

    def evaluate(
        self, estimate: StateEstimate, t: float, state: MissionState | None = None
    ) -> dict[str, float]:
        """Evaluate all quantities at a state at time t [s], such as the true one after a run; the
        mission stays where it is.

        An altitude is NaN unless the echo of the measurement itself tells it. state: where the
        mission was then, for the goals of another phase than the present one.
        """
        state = state or self.state
        (echo, has_echo) = self._echo.at(estimate)
        gates = self.mission.activations(state, t)
        q = estimate.q
        if self.memory.near:
            moves = task_goals.StoppingMotion(
                robot=self.robot, v=self._arrays.command.copy(), dt=self.dt
            )
        else:
            moves = None
        parameters = task_goals.mission_parameters(
            self.mission, state, t, gates=gates, q=q, motion=moves
        )
        motion = self._arrays.passive, self._arrays.command / self.memory.pace, self._arrays.change
        outputs = self.problem.function(q, estimate.v, *motion, echo, parameters, gates)
        quantities = np.array(outputs[self.problem.function.index_out("quantities")]).ravel()
        rests = self.problem.rests_on[degraded_modes.ALTIMETER]
        unknown = [velocity_tick.is_unknown(estimate.age, bool(of), has_echo) for of in rests]
        return {
            **self._named(np.where(unknown, np.nan, quantities)),
            **self.mission.own_quantities(state, t),
        }

    def _restricted(self, bad: list[ChannelHealth]) -> degraded_modes.Restriction:
        """Read the restriction that the kernel has found."""
        restriction = self.memory.restriction
        before = self._restriction
        if not (bad == list(before.bad) and before.abort == "" and not restriction.ended):
            self._restriction = degraded_modes.read_restriction(restriction, bad)
        return self._restriction

    def _advance(self, tick: TickInputs) -> None:
        """Advance the mission as the kernels found, and log the event."""
        memory = self.memory
        state = self._state
        quantities = self._named(self._arrays.phase_quantities)
        phases = self.mission.all_phases
        progress = memory.mission
        if memory.why:
            why = self._distress.describe(AbortReason(memory.why), tick, quantities, self._feedback)
            goals: tuple[Any, ...] = ()
            if not is_over(progress):
                goals = self.mission.ascent_goals(ascent_goal(memory.ascent))
            went: tuple[MissionState, Event | None] = state_after_abort(
                phases, state, progress, tick.t, why, goals
            )
        else:
            went = state_after_transition(phases, state, progress, memory.due, tick.t, quantities)
        self._state, event = went
        if event is not None:
            self.events.append(event)
            self.left.append(state)

    def _named(self, quantities: np.ndarray) -> dict[str, float]:
        return dict(zip(self.problem.quantity_names, quantities.tolist(), strict=True))


def _awaited_limits(phase: Phase, names: tuple[str, ...]) -> dict[int, tuple[str, float]]:
    """Return what a phase waits for to fall below a limit: by index of the quantity, its name and
    the limit [its unit].
    """
    awaited = dict[int, tuple[str, float]]()
    for condition in phase.conditions:
        if condition.is_below:
            awaited[names.index(condition.quantity)] = (condition.quantity, condition.limit)
    return awaited
