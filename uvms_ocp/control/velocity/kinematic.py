"""Kinematic control layer: measurements in, reference velocities out ([Gao2022] figure 4)."""

from __future__ import annotations

from time import perf_counter
from typing import Protocol

import casadi as ca
import numpy as np
import pinocchio as pin

from uvms_ocp.control.navigation.last_known import LastEcho, LastSound
from uvms_ocp.control.navigation.watchdog import Freshness, Watchdog
from uvms_ocp.control.velocity.levels import LevelsProblem, build_levels
from uvms_ocp.control.velocity.viability import Viability
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.mission.mission import Mission
from uvms_ocp.mission.phase import Event, MissionState
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.state import Command, Measurement
from uvms_ocp.solvers.hierarchy.solution import Status
from uvms_ocp.solvers.hierarchy.tick import Tick, TickResult

_STATUS_CODE = {status: code for code, status in enumerate(Status)}


class HierarchySolver(Protocol):
    """What a solver of hierarchies offers to the control layer."""

    def bind(self, levels_function: ca.Function, sizes: tuple[int, ...]) -> Tick: ...


class KinematicController:
    """Runs a mission: a callable ``(Measurement, t) -> Command``.

    Holds the mission's state and the last command; `events` is the log of transitions. Build one per run.
    """

    def __init__(
        self,
        *,
        robot: Robot,
        mission: Mission,
        solver: HierarchySolver,
        dt: float,
        watchdog: Watchdog | None = None,
    ) -> None:
        """dt [s] is the control period. Raises what `build_levels` and `Mission.check_quantities` raise."""
        if not (np.isfinite(dt) and dt > 0):
            raise InvalidInput(f"control period dt = {dt} s; give a finite time > 0")
        self.robot, self.mission, self.dt = robot, mission, dt
        self.problem: LevelsProblem = build_levels(robot, mission.hierarchy, dt)
        mission.check_quantities(self.problem.quantity_names)
        self._viability = Viability(
            robot=robot, tasks=mission.hierarchy.tasks, quantity_names=self.problem.quantity_names, dt=dt
        )
        self._tick = solver.bind(self.problem.function, self.problem.sizes)
        self.events: list[Event] = []
        self.state: MissionState = mission.start()
        self.quantities: dict[str, float] = {}
        self.watchdog = watchdog or Watchdog()
        self._previous, self._near = np.zeros(robot.n_v), True
        self._sound, self._echo = LastSound(robot), LastEcho(robot)
        self._stopping_q = robot.configuration()
        self._altitude_tasks = [index for index, task in enumerate(mission.hierarchy.tasks) if task.needs_altimeter]

    def __call__(self, measurement: Measurement, t: float) -> Command:
        """The command for the tick at time t [s]."""
        begin = perf_counter()
        phase, gates = self.state.phase, self.mission.gates(self.state, t)
        measurement = self._sound(measurement, t)
        echo = self._echo.range(measurement, t)
        freshness = self.watchdog.judge(max(measurement.age, self._echo_age(t, gates)), t)
        result = self._tick(*self._inputs(measurement, echo, t), gates)
        quantities, activity = result.extras
        if freshness is Freshness.FRESH:
            kept = self._viability.kept(
                q=measurement.q,
                wanted=self._within_limits(result),
                previous=self._previous,
                gates=gates,
                quantities=quantities,
            )
            self._stopping_q = measurement.q
            self._previous, self._near, share = kept.v, kept.near, kept.share
            self._advance(t, self._named(quantities))
        else:
            # Along the stop that the last tick with a measurement has found clear.
            self._stopping_q = pin.integrate(self.robot.model, self._stopping_q, self._previous * self.dt)
            self._previous, share = self._viability.stop.slower(self._stopping_q, self._previous), 0.0
        telemetry = {
            "phase": phase,
            "gates": gates,
            "activity": activity,
            "residual": result.residual,
            "quantities": quantities,
            "status": _STATUS_CODE[result.status],
            "viable_share": share,
            "solve_time": result.solve_time,
            "freshness": int(freshness),
            "tick_time": perf_counter() - begin,
        }
        return Command(
            v=self._previous,
            hold=freshness is not Freshness.FRESH,
            stop=freshness is Freshness.LOST,
            finished=self.state.over,
            telemetry=telemetry,
        )

    def pending(self) -> str:
        """What the current phase still waits for, with the last measured values."""
        return self.mission.pending(self.state, self.quantities)

    def evaluate(self, measurement: Measurement, t: float) -> dict[str, float]:
        """All quantities at a measurement, such as the true state after a run; the mission stays where it is."""
        echo = measurement.altimeter_range
        echo = echo if np.isfinite(echo) else self._echo.carried(measurement.q)
        outputs = self.problem.function(*self._inputs(measurement, echo, t), self.mission.gates(self.state, t))
        return self._named(np.array(outputs[self.problem.function.index_out("quantities")]).ravel())

    def _inputs(self, measurement: Measurement, echo: float, t: float) -> tuple[np.ndarray, ...]:
        stop = self._viability.stop.ahead(measurement.q, self._previous) if self._near else None
        return (
            measurement.q,
            measurement.v,
            self._previous,
            np.array([echo]),
            self.mission.parameters(self.state, t, measurement.q, stop),
        )

    def _echo_age(self, t: float, gates: np.ndarray) -> float:
        """Time [s] since the last echo while a task on altitude is on."""
        return t - self._echo.since if gates[self._altitude_tasks].any() else 0.0

    def _named(self, quantities: np.ndarray) -> dict[str, float]:
        return dict(zip(self.problem.quantity_names, quantities.tolist(), strict=True))

    def _advance(self, t: float, quantities: dict[str, float]) -> None:
        self.quantities = quantities
        self.state, event = self.mission.step(self.state, t, quantities)
        if event is not None:
            self.events.append(event)

    def _within_limits(self, result: TickResult) -> np.ndarray:
        """The solver's velocity, shortened to the velocity limits with its direction kept; braking where unusable."""
        if not result.status.usable:
            return self._braking()
        excess = np.max(np.abs(result.v) / self.robot.limits.velocity, initial=1.0)
        return result.v / excess

    def _braking(self) -> np.ndarray:
        """One tick nearer to rest."""
        step = self.robot.limits.acceleration * self.dt
        return self._previous - np.clip(self._previous, -step, step)
