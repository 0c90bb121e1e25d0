"""Check that control loops stay stable with sensors as late as they are, while they carry weight and
buoyancy, and closed as seldom as they are.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from uvms_ocp.control.force.velocity_law import (
    CONTROLLER_DEAD_TIME,
    DeadTimes,
    bandwidth_derating,
    dead_times,
    largest_dead_time,
)
from uvms_ocp.robot.dynamics import cached_dynamics
from uvms_ocp.scenario.preflight.arm_reach import ArmReach
from uvms_ocp.scenario.preflight.findings import Finding, Severity
from uvms_ocp.scenario.preflight.phase_forecast import Visit
from uvms_ocp.scenario.preflight.setup import Setup, goals_of
from uvms_ocp.tasks.pose import ToolPose, ToolPosition
from uvms_ocp.tasks.vehicle_velocity import NullVelocity

DELAYS = "delays"
_MARGIN = 1.25  # dead time up to which the loops are stable, over the known one
_STEP = 1e-5  # [m, rad] of the difference quotients
# of the bandwidth of joints that a control period leaves at least: with less some arms swing, are caught by
# their brakes, or pass their limits of velocity; with a fifth of it drawn arms do neither
_LEAST_BANDWIDTH = 0.2


def check_delays(setup: Setup, visits: Sequence[Visit] = ()) -> Iterator[Finding]:
    """Check that the control loops stay stable with sensors and actuators as late as they are, in
    all postures foreseen.

    One finding at most, of the axes and the posture with the least margin. A DVL may be as late as
    it will: it measures nothing that weight or buoyancy depends on.
    """
    if not setup.with_forces or "controller" in setup.own_parts:
        return
    delayed = [axes for axes in _delayed_axes(setup) if axes.delay > 0.0]
    if not delayed:
        return
    controller_delay = CONTROLLER_DEAD_TIME * setup.dt
    bounds = []
    for phase, q in _postures(setup, visits):
        stiffness = _stiffness(setup, q)
        for source in delayed:
            block = stiffness[source.axes, source.axes]
            bounds.append((largest_dead_time(block, **source.loop), phase, source))
    longest, phase, worst = min(
        bounds, key=lambda bound: bound[0] / (bound[2].delay + controller_delay)
    )
    if worst.delay + controller_delay <= longest / _MARGIN:
        return
    swings_from = max(longest - controller_delay, 0.0)
    allowed = max(longest / _MARGIN - controller_delay, 0.0)
    text = (
        f"{worst.sensors} {worst.delay:.3g} s late, allowed {allowed:.2g} s: loops that carry the"
        f" weight by where it was swing from {swings_from:.2g} s on; take quicker ones, or a posture"
        " in better balance"
    )
    severity = Severity.ERROR if worst.delay > swings_from else Severity.WARNING
    figures = {"delay_s": worst.delay, "allowed_s": allowed, "swings_from_s": swings_from}
    yield severity.finding(DELAYS, text, phase, **figures)


def check_period(setup: Setup) -> Iterator[Finding]:
    """Check that the control period leaves the loops of joints a bandwidth with which they are held.

    Less is no error: shipped arms complete their missions at 0.15 s, with 8 % of it.
    """
    if not setup.with_forces or not setup.robot.n_joints or "controller" in setup.own_parts:
        return
    gains = setup.gains
    kept = bandwidth_derating(
        DeadTimes(), vehicle=gains.vehicle, joints=gains.joints, dt=setup.dt
    ).joints
    if kept >= _LEAST_BANDWIDTH:
        return
    longest = setup.dt * kept / _LEAST_BANDWIDTH
    text = (
        f"a control period of {setup.dt:.3g} s leaves the loops of joints {100 * kept:.0f} % of their bandwidth"
        f" of {gains.joints:.3g}/s: an arm may swing until its brakes are locked, or pass its limits of velocity;"
        f" take {longest:.2g} s or less, or gains of slower joints"
    )
    yield Severity.WARNING.finding("control period", text, dt_s=setup.dt, longest_s=longest)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class DelayedAxes:
    """Axes whose positions are known late."""

    sensors: str
    """Sensors that are late, with their verb, for a sentence."""
    axes: slice
    """Columns of the axes among those of v (n_v,)."""
    delay: float
    """[s] Delay of sensors and actuators together."""
    loop: Mapping[str, float]
    """Bandwidth and reset [1/s] of their control loop, and its observer's [rad/s]."""


def _delayed_axes(setup: Setup) -> Iterator[DelayedAxes]:
    """Yield the axes on which both sensors and actuators are late: what is under way between them
    is known to neither.
    """
    times = dead_times(setup.sensors)
    robot = setup.robot
    gains = setup.gains
    joint_observer = 0.0
    if gains.observer_vehicle:
        joint_observer = gains.observer_joints or gains.observer_vehicle
    joints = {"bandwidth": gains.joints, "reset": gains.joints_reset, "observer": joint_observer}
    vehicle = {
        "bandwidth": gains.vehicle,
        "reset": gains.vehicle_reset,
        "observer": gains.observer_vehicle,
    }
    if robot.n_joints:
        yield DelayedAxes(
            sensors="encoders are", axes=robot.joint_v, delay=times.joints, loop=joints
        )
    if robot.n_vehicle:
        yield DelayedAxes(
            sensors="gyro and attitude are",
            axes=robot.vehicle_v,
            delay=times.turning,
            loop=vehicle,
        )
    if robot.n_joints and robot.n_vehicle:
        yield DelayedAxes(
            sensors="attitude and encoders are",
            axes=slice(None),
            delay=min(times.turning, times.joints),
            loop=joints,
        )


def _postures(setup: Setup, visits: Sequence[Visit]) -> Iterator[tuple[str, np.ndarray]]:
    """Yield names of phases with q (n_q,) [m, rad] at the start and wherever a tool has to reach
    from a vehicle that stands still.
    """
    yield "", setup.start
    joints = setup.robot.joint_values(setup.start)
    for visit in visits:
        task = visit.active(ToolPose) or visit.active(ToolPosition)
        if task is None or visit.active(NullVelocity) is None:
            continue
        arm = ArmReach.of_task(setup, task)
        stance = visit.stances[0]
        goal = goals_of(setup, task.name, task.goal)[0]
        joints = arm.solve(stance.X_WB, goal, (joints,)).joints
        q = setup.robot.with_joint_values(stance.configuration(setup), joints)
        yield visit.phase.name, q


def _stiffness(setup: Setup, q: np.ndarray) -> np.ndarray:
    """Return (n_v, n_v) [1/s2]: the acceleration per displacement from q (n_q,) [m, rad] by which
    weight and buoyancy bring it back.
    """
    dynamics = cached_dynamics(setup.robot)
    model = setup.robot.model
    still = np.zeros(setup.robot.n_v)

    def force(step: np.ndarray) -> np.ndarray:
        return dynamics.inverse_dynamics(pin.integrate(model, q, step), still, still)

    slopes = [force(step) - force(-step) for step in _STEP * np.eye(setup.robot.n_v)]
    return np.linalg.solve(dynamics.mass_matrix(q), np.transpose(slopes) / (2 * _STEP))
