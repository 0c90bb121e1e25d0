"""Follow a plan: as the guide of a mission, or by computed torque."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pinocchio as pin

from uvms_ocp.checks import checked_dataclass, replace_unchecked
from uvms_ocp.control.force.computed_torque import ComputedTorque, TrackingGains
from uvms_ocp.control.velocity.abort import ActuationFeedback
from uvms_ocp.control.velocity.guide import GuideOutput
from uvms_ocp.control.velocity.tick_state import TickInputs
from uvms_ocp.estimation import degraded_modes, fallbacks
from uvms_ocp.mission.mission import Mission
from uvms_ocp.ocp.trajectory import Trajectory
from uvms_ocp.robot import Command, Robot, StateEstimate, signals
from uvms_ocp.robot.dynamics import Dynamics
from uvms_ocp.robot.hydrodynamics import STILL_WATER, Water
from uvms_ocp.robot.size import joint_units, size
from uvms_ocp.types import Magnitude, Positive

_CATCH_UP = (
    1.2  # speed of the plan's clock where a goal that moves has begun before its phase in the plan
)
# from the plan, at which it is left where no distance is given: sizes of the robot, and [m] at most
_AWAY = (1.2, 0.3)
_LEFT = GuideOutput(v=None)


class PlanTracker:
    """Follows one trajectory to its end: a callable ``(StateEstimate, t) -> Command`` with thrust
    and torque.

    By computed torque. Build one per run.
    """

    def __init__(
        self,
        trajectory: Trajectory,
        robot: Robot,
        dynamics: Dynamics,
        *,
        dt: float,
        gains: TrackingGains | None = None,
        water: Water = STILL_WATER,
    ) -> None:
        """dt [s]: control period. gains: of the feedback, by default `TrackingGains`. water: as far
        as the controller knows it.
        """
        self._trajectory = trajectory
        self._model = robot.model
        self._law = ComputedTorque(robot, dynamics, dt=dt, gains=gains, water=water)
        self._end = float(trajectory.t[-1]) - 0.5 * dt
        self._sound = fallbacks.LastValidEstimate(robot)

    def __call__(self, estimate: StateEstimate, t: float) -> Command:
        """Return the command for the tick at time t [s] of the trajectory; finished at its end."""
        estimate = self._sound(estimate, t)
        q, v, a = self._trajectory.state_at(self._model, t)
        command = self._law.command(
            signals.unchecked_state(q=estimate.q, v=estimate.v), q=q, v=v, a=a
        )
        return replace_unchecked(command, finished=t > self._end)


# A plan of a whole mission as a guide: followed while the mission goes as planned, left where it
# does not.


@checked_dataclass()
class PlannedPhase:
    """A phase of the mission on the plan's time."""

    phase: int
    """Index in the mission."""
    begin: Magnitude
    """[s] time of the plan at which the phase begins."""
    end: Magnitude
    """[s] time of the plan at which the phase ends."""
    moves: bool
    """The phase has goals of its own that move: it begins when the mission says so, and the plan
    waits for that.
    """


@checked_dataclass()
class FollowingTuning:
    """Tuning of how a plan is followed, and when it is left."""

    vehicle: Positive = 0.5
    """[1/s] velocity of the vehicle per deviation from the plan."""
    joints: Positive = 2.0
    """[1/s] velocity of the joints per deviation from the plan."""
    bandwidth: Positive = 0.7
    """Share of the usual feedback of the vehicle's velocity: the plan is fed forward."""
    smoothing: Positive = 0.5
    """[s] time constant of the correction: noise is not to become acceleration."""
    position: Positive | None = None
    """[m] distance of the vehicle from the plan at which it is left; default: 1.2 times the robot's
    size, at most 0.3 m.
    """
    attitude: Positive = 0.3
    """[rad] rotation of the vehicle from the plan at which it is left."""
    posture: Positive = 0.3
    """[rad, or share of the robot's size] distance of any joint from the plan at which it is left."""
    late: Positive = 3.0
    """[s] time beyond its end in the plan after which a phase is late, and the plan is left."""


class PlanGuide:
    """Velocities along a trajectory, corrected by the deviation from it: a `Guide`. Build one per
    run.
    """

    def __init__(
        self,
        trajectory: Trajectory,
        phases: Sequence[PlannedPhase],
        mission: Mission,
        robot: Robot,
        *,
        dt: float,
        tuning: FollowingTuning | None = None,
        energy: float | None = None,
    ) -> None:
        """phases: on the way, in their order. dt [s]: control period. energy [J]: what the plan
        takes, where it is known.
        """
        self.energy = energy
        self._trajectory = trajectory
        self._phases = tuple(phases)
        self._mission = mission
        self._model = robot.model
        self._tuning = tuning or FollowingTuning()
        self._dt = dt
        n = robot.n_vehicle
        chosen = self._tuning
        self._gain = np.repeat([chosen.vehicle, chosen.joints], [n, robot.n_joints])
        share, farthest = _AWAY
        position = chosen.position or min(share * size(robot.model), farthest)
        self._bounds = np.concatenate(
            [
                np.repeat([position, chosen.attitude], n // 2),
                chosen.posture * joint_units(robot),
            ]
        )
        self._most = robot.limits.velocity
        self._correction = np.zeros(robot.n_v)
        self._clock = self._late = 0.0
        self._at = 0
        self._left = False

    @property
    def bandwidth(self) -> float:
        """Bandwidth of the velocity loop, all of it once the plan is left."""
        if self._left:
            return 1.0
        return self._tuning.bandwidth

    def __call__(
        self, tick: TickInputs, feedback: ActuationFeedback, waiting: Callable[[], str]
    ) -> GuideOutput:
        """Return the velocity along the plan, or the reason why it is left."""
        if self._left:
            return _LEFT
        q, v, _ = self._trajectory.state_at(self._model, self._clock)
        error = pin.difference(self._model, tick.estimate.q, q)
        why = self._why(tick, feedback, error, waiting)
        if why:
            self._left = True
            return GuideOutput(v=None, why=f"plan left at {self._clock:.2f} s of it: {why}")
        rate = self._rate(tick)
        self._clock += rate * self._dt
        self._correction += (
            self._dt / self._tuning.smoothing * (self._gain * error - self._correction)
        )
        return GuideOutput(v=np.clip(rate * v + self._correction, -self._most, self._most))

    def _why(
        self,
        tick: TickInputs,
        feedback: ActuationFeedback,
        error: np.ndarray,
        waiting: Callable[[], str],
    ) -> str:
        """Return why the plan is left; empty while it is not."""
        if tick.restriction.bad or tick.blind:
            return (
                degraded_modes.describe_channels(tick.restriction.bad) or "measurements are too old"
            )
        if feedback.fault or feedback.fault_summary:
            return feedback.fault or feedback.fault_summary
        return self._other_phase(tick) or self._away(error) or self._too_late(waiting)

    def _other_phase(self, tick: TickInputs) -> str:
        following = self._at + 1
        if following < len(self._phases) and tick.mission.phase == self._phases[following].phase:
            self._at = following
            self._late = 0.0
        if tick.mission.phase == self._phases[self._at].phase:
            return ""
        name = self._mission.phase_names[tick.mission.phase]
        reason = f", {tick.mission.abort_reason}" if tick.mission.abort_reason else ""
        return f"the mission has gone on to phase {name!r}{reason}"

    def _away(self, error: np.ndarray) -> str:
        beyond = np.abs(error) / self._bounds
        worst = int(np.argmax(beyond))
        if beyond[worst] > 1.0:
            return f"{abs(error[worst]):.2g} away from it along axis {worst} of the velocities"
        return ""

    def _too_late(self, waiting: Callable[[], str]) -> str:
        phase = self._phases[self._at]
        if self._clock >= phase.end:
            self._late += self._dt
        name = self._mission.phase_names[phase.phase]
        if self._late > self._tuning.late:
            return f"phase {name!r} does not end: {waiting()}"
        return ""

    def _rate(self, tick: TickInputs) -> float:
        """Return the speed of the plan's clock."""
        phase = self._phases[self._at]
        following = self._phases[min(self._at + 1, len(self._phases) - 1)]
        if following.moves and following is not phase and self._clock >= phase.end:
            return 0.0
        if phase.moves and self._clock < phase.begin + tick.t - tick.mission.since:
            return _CATCH_UP
        return 1.0
