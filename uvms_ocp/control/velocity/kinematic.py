"""Kinematic control layer: measurements in, reference velocities out ([Gao2022] figure 4)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from time import perf_counter
from typing import Any, Protocol

import casadi as ca
import numpy as np
import pinocchio as pin

from uvms_ocp.arguments import Period, checked, late, trusted
from uvms_ocp.control.navigation.degraded import ALTIMETER, FREE, Restriction, restriction_of, told
from uvms_ocp.control.navigation.last_known import LastEcho, LastSound
from uvms_ocp.control.navigation.watchdog import Freshness, Watchdog
from uvms_ocp.control.velocity.distress import Distress, Strain, climb_goal
from uvms_ocp.control.velocity.levels import LevelsProblem, build_levels
from uvms_ocp.control.velocity.parameters import mission_parameters
from uvms_ocp.control.velocity.restraint import Restraint
from uvms_ocp.control.velocity.tick_state import Motion, TickState
from uvms_ocp.control.velocity.viability import Viability
from uvms_ocp.mission.mission import Mission
from uvms_ocp.mission.phase import Event, MissionState
from uvms_ocp.model.health import ChannelHealth
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.state import Command, Measurement
from uvms_ocp.solvers.hierarchy.solution import Status
from uvms_ocp.solvers.hierarchy.tick import Tick, TickResult
from uvms_ocp.tasks.task import Task

_command = trusted(Command)

_STATUS_CODE = {status: code for code, status in enumerate(Status)}


class HierarchySolver(Protocol):
    """What a solver of hierarchies offers to the control layer."""

    def bind(self, levels_function: ca.Function, sizes: tuple[int, ...]) -> Tick: ...


@checked
class KinematicController:
    """Runs a mission: a callable ``(Measurement, t) -> Command``.

    One tick: `observe` what is known, solve the hierarchy, keep what a stop can keep, advance the mission, `command`. Holds
    the mission's state and the last motion; `events` is the log of transitions. Build one per run.
    """

    def __init__(
        self,
        *,
        robot: Robot,
        mission: Mission,
        solver: HierarchySolver,
        dt: Period,
        watchdog: Watchdog | None = None,
    ) -> None:
        """dt [s]: control period.

        Raises `InvalidInput` where it is not > 0, and what `build_levels` and `Mission.check_quantities` raise.
        """
        self.robot, self.mission, self.dt = robot, mission, dt
        self.problem: LevelsProblem = build_levels(robot, mission.hierarchy, dt)
        mission.check_quantities(self.problem.quantity_names)
        self._viability = Viability(
            robot=robot, tasks=mission.hierarchy.tasks, quantity_names=self.problem.quantity_names, dt=dt
        )
        self._solve = solver.bind(self.problem.function, self.problem.sizes)
        self.events: list[Event] = []
        self.left: list[MissionState] = []
        """Where the mission was at each event, just before."""
        self.state: MissionState = mission.start()
        self.quantities = dict.fromkeys(self.problem.quantity_names, math.nan)
        """As last measured [in their units]; NaN where nothing tells."""
        self.watchdog = watchdog or Watchdog()
        altimeter = _altimeter(robot, mission.hierarchy.tasks)
        self._sound, self._echo = LastSound(robot), LastEcho(robot, altimeter)
        self._restraint = Restraint(robot, dt=dt, altimeter=altimeter)
        self._distress, self._strain = Distress(mission), Strain()
        self._bad: tuple[ChannelHealth, ...] = ()
        rest = np.zeros(robot.n_v)
        self._motion = Motion(q=robot.configuration(), v=rest, change=rest, near=True, share=1.0)
        self._altitude_tasks = [index for index, task in enumerate(mission.hierarchy.tasks) if task.needs_altimeter]
        self._landing_tasks = [i for i in self._altitude_tasks if mission.hierarchy.tasks[i].equality]

    @property
    def kinematic(self) -> KinematicController:
        """Itself: what `DynamicController` has below it."""
        return self

    @late
    def __call__(self, measurement: Measurement, t: float) -> Command:
        """The command for the tick at time t [s]."""
        return self.command(self.observe(measurement, t))

    @late
    def observe(self, measurement: Measurement, t: float) -> TickState:
        """What is known at time t [s]; what is missing of the measurement is replaced by what was known last."""
        begin, gates = perf_counter(), self.mission.gates(self.state, t)
        measurement, high = self._sound(measurement, t), bool(gates[self._altitude_tasks].any())
        restriction = restriction_of(measurement.health, t, altitude_matters=high)
        if restriction.no_descent:
            gates[self._landing_tasks] = 0.0
        self._bad, doubted = restriction.bad, ALTIMETER in restriction.doubted
        echo = self._echo.range(measurement, t, self._lowest_rest(gates), doubted)
        return TickState(
            begin=begin,
            t=t,
            measurement=measurement,
            echo=echo,
            altitude_known=self._echo.known(t, self.watchdog.hold_after),
            mission=self.state,
            gates=gates,
            freshness=self._freshness(measurement, t, restriction, echo_matters=high and not doubted),
            restriction=restriction,
        )

    def feel(self, strain: Strain) -> None:
        """Take in what the force layer meets."""
        self._strain = strain

    @late
    def command(self, tick: TickState) -> Command:
        """The command for what `observe` has found."""
        result = self._solve(*self._inputs(tick))
        quantities = self._reported(result.extras[0], tick)
        holds = self._holds(tick)
        self._motion = self._stopping() if holds else self._viable(tick, result)
        self._advance(tick, self._named(self._told(quantities, tick)), holds)
        return _command(
            v=self._motion.v,
            hold=tick.blind,
            stop=tick.stopped,
            brakes=tick.restriction.joints_held,
            finished=self.state.over,
            telemetry=_telemetry(tick, result, quantities, self._motion.share),
        )

    def pending(self) -> str:
        """What the current phase still waits for, with the last measured values, and which channels hold it back."""
        waits = self.mission.pending(self.state, self.quantities)
        return waits if self.state.over or not self._bad else f"{waits}; {told(self._bad)}"

    def evaluate(self, measurement: Measurement, t: float, state: MissionState | None = None) -> dict[str, float]:
        """All quantities at a measurement at time t [s], such as the true state after a run; the mission stays where it is.

        An altitude is NaN unless the echo of the measurement itself tells it. state: where the mission was then, for the goals of
        another phase than the present one.
        """
        state = state or self.state
        echo, altitude_known = self._echo.at(measurement)
        tick = TickState(
            begin=perf_counter(),
            t=t,
            measurement=measurement,
            echo=echo,
            altitude_known=altitude_known,
            mission=state,
            gates=self.mission.gates(state, t),
            freshness=Freshness.FRESH,
        )
        outputs = self.problem.function(*self._inputs(tick))
        quantities = np.array(outputs[self.problem.function.index_out("quantities")]).ravel()
        return self._named(self._reported(quantities, tick))

    def _inputs(self, tick: TickState) -> tuple[np.ndarray, ...]:
        """Of the levels function."""
        q, v = tick.measurement.q, tick.measurement.v
        stop = self._viability.stop.ahead(q, self._motion.v) if self._motion.near else None
        parameters = mission_parameters(self.mission, tick.mission, tick.t, gates=tick.gates, q=q, stop=stop)
        previous = self._motion.v / self._motion.pace
        return q, v, previous, self._motion.change, np.array([tick.echo]), parameters, tick.gates

    def _viable(self, tick: TickState, result: TickResult) -> Motion:
        """The velocity that the solver asks for, as far as restrictions let it and a stop from it keeps all limits."""
        wanted, pace = self._within_limits(result), self._motion.pace
        if result.status.usable and not (tick.restriction is FREE and pace == 1.0):
            q, previous = tick.measurement.q, self._motion.v
            wanted, pace = self._restraint.kept(tick.restriction, q=q, wanted=wanted, previous=previous, pace=pace)
        if self._strain.jammed:
            # From rest at every tick: the hierarchy counts on no more than one tick's acceleration of such a joint.
            wanted[list(self._strain.jammed)] = 0.0
        kept = self._viability.kept(
            q=tick.measurement.q,
            wanted=wanted,
            previous=self._motion.v,
            gates=tick.gates,
            quantities=result.extras[0],
        )
        change = kept.v / pace - self._motion.v / self._motion.pace
        return Motion(q=tick.measurement.q, v=kept.v, change=change, near=kept.near, share=kept.share, pace=pace)

    def _stopping(self) -> Motion:
        """Along the stop that the last tick with a measurement has found clear."""
        q = pin.integrate(self.robot.model, self._motion.q, self._motion.v * self.dt)
        v = self._viability.stop.slower(q, self._motion.v)
        return replace(self._motion, q=q, v=v, change=(v - self._motion.v) / self._motion.pace, share=0.0)

    def _holds(self, tick: TickState) -> bool:
        """Whether the robot comes to rest, whatever the tasks want."""
        return tick.blind or tick.restriction.hold or bool(tick.restriction.abort and self.mission.abort is None)

    def _advance(self, tick: TickState, quantities: dict[str, float], holds: bool) -> None:
        """Go on with the mission, or give it up; where the robot holds, only the latter."""
        if not holds:
            self.quantities = quantities
        state, event = self.state, None
        why = "" if state.over else self._distress.reason(tick, quantities, self._strain)
        if why:
            floor = math.nan if self._distress.pushed(tick, self._strain) else self._echo.highest
            goal = climb_goal(self.mission, tick, robot=self.robot, floor=floor)
            self.state, event = self.mission.abandon(state, tick.t, why, goal)
        elif not holds:
            self.state, event = self.mission.step(state, tick.t, quantities)
        if event is not None:
            self.events.append(event)
            self.left.append(state)

    def _freshness(
        self, measurement: Measurement, t: float, restriction: Restriction, *, echo_matters: bool
    ) -> Freshness:
        """Of what is needed: joints that brakes hold are where they were."""
        braked = restriction.joints_held and math.isfinite(measurement.age) and measurement.joint_age >= measurement.age
        age = 0.0 if braked else measurement.age
        echo_age = t - self._echo.since if echo_matters else 0.0
        oldest = measurement.oldest or ", ".join(item.channel for item in restriction.lost)
        return self.watchdog.judge(max(age, echo_age), t, ALTIMETER if echo_age > age else oldest)

    def _lowest_rest(self, gates: np.ndarray) -> float:
        """Altitude [m] at which no task that is on lets the robot sink."""
        tasks = self.mission.hierarchy.tasks
        return min((tasks[i].rest_altitude for i in self._altitude_tasks if gates[i] > 0), default=0.0)

    def _reported(self, quantities: np.ndarray, tick: TickState) -> np.ndarray:
        """NaN before the first measurement, and where they rest on an altitude that only stands in for one."""
        if tick.measurement.age == math.inf:
            return np.full(len(quantities), np.nan)
        return quantities if tick.altitude_known else np.where(self.problem.rests_on[ALTIMETER], np.nan, quantities)

    def _told(self, quantities: np.ndarray, tick: TickState) -> np.ndarray:
        """What phases may end on: NaN where it rests on a channel that is not good, but in the abort phase the best there is."""
        if tick.mission.why:
            return quantities
        known = self.problem.rests_on
        doubted = [known[channel] for channel in tick.restriction.doubted if channel in known]
        return np.where(np.any(doubted, axis=0), np.nan, quantities) if doubted else quantities

    def _named(self, quantities: np.ndarray) -> dict[str, float]:
        return dict(zip(self.problem.quantity_names, quantities.tolist(), strict=True))

    def _within_limits(self, result: TickResult) -> np.ndarray:
        """The solver's velocity, shortened to the velocity limits with its direction kept; braking where unusable."""
        if not result.status.usable:
            return self._braking()
        excess = np.max(np.abs(result.v) / self.robot.limits.velocity, initial=1.0)
        return result.v / excess

    def _braking(self) -> np.ndarray:
        """One tick nearer to rest."""
        v = self._motion.v
        return v - np.clip(v, -self.problem.step, self.problem.step)


def _altimeter(robot: Robot, tasks: Sequence[Task]) -> str | None:
    """The frame that tasks on altitude name, or that of the robot's file."""
    named = (getattr(task, "frame", None) for task in tasks if task.needs_altimeter)
    return next(filter(None, named), robot.description.altimeter)


def _telemetry(tick: TickState, result: TickResult, quantities: np.ndarray, share: float) -> dict[str, Any]:
    """For the record."""
    return {
        "phase": tick.mission.phase,
        "gates": tick.gates,
        "activity": result.extras[1],
        "residual": result.residual,
        "quantities": quantities,
        "status": _STATUS_CODE[result.status],
        "viable_share": share,
        "solve_time": result.solve_time,
        "freshness": int(tick.freshness),
        "tick_time": perf_counter() - tick.begin,
    }
