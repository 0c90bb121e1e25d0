"""Check heights: way points against the minimum altitude, landing against it, goals, and the start."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
import pinocchio as pin

from uvms_ocp.robot.kinematics import STEEP, AltimeterBeam
from uvms_ocp.scenario.preflight.findings import Finding, Severity
from uvms_ocp.scenario.preflight.phase_forecast import (
    Visit,
    main_path,
    points_on_ball,
    threshold_of,
)
from uvms_ocp.scenario.preflight.setup import Setup, goals_of
from uvms_ocp.tasks import HorizontalAttitude, LandingAltitude, MinimumAltitude, goals
from uvms_ocp.tasks.pose import PoseTask, ToolPosition, VehiclePose

MINIMUM_ALTITUDE = "minimum altitude"
ECHO = "echo"


def check_altitude(setup: Setup, visits: Sequence[Visit]) -> Iterator[Finding]:
    """Check heights of the start, and of phases in which the minimum altitude is on."""
    if not setup.robot.n_vehicle:
        return
    yield from _start(setup, visits[0])
    for visit in visits:
        minimum = visit.active(MinimumAltitude)
        if minimum is None:
            continue
        task = visit.active(VehiclePose)
        if task is not None:
            yield from _way_point(setup, visit, task, minimum)
        landing = visit.active(LandingAltitude)
        if landing is not None:
            yield from _landing(visit, landing, minimum)


def check_echo(setup: Setup) -> Iterator[Finding]:
    """Find phases that go by an altitude which no echo tells: without an altimeter, or at the
    start.
    """
    tasks = {task.name for task in setup.mission.hierarchy.tasks if task.needs_altimeter}
    blind = setup.altimeter_frame is None or setup.sensors.altimeter_range is None
    if blind:
        indices = main_path(setup.mission.phases)
    else:
        indices = [0]
    for index in indices:
        phase = setup.mission.phases[index]
        on = sorted(tasks.intersection(phase.on))
        awaited = {
            condition.quantity
            for condition in phase.conditions
            if condition.quantity.rpartition(".")[0] in tasks
        }
        if not (on or awaited):
            continue
        names = ", ".join([*on, *sorted(awaited)])
        if blind:
            text = (
                f"{names}: there is no altimeter, so that no altitude is ever known; give one, or"
                " do without"
            )
            yield (Severity.ERROR if on else Severity.WARNING).finding(ECHO, text, phase.name)
        else:
            yield from _silent_start(setup, phase.name, names)


def _silent_start(setup: Setup, phase: str, names: str) -> Iterator[Finding]:
    """Find a start at which the altimeter has no echo; names: tasks and quantities that need one."""
    beam = AltimeterBeam(setup.robot, setup.altimeter_frame or "").at(setup.start)
    if beam.cosine > STEEP and math.isfinite(
        setup.environment.seafloor.range_along(beam.origin, beam.direction)
    ):
        return
    tilt = math.acos(max(-1.0, min(1.0, beam.cosine)))
    why = (
        f"the altimeter looks {tilt:.2f} rad away from straight down, at most"
        f" {math.acos(STEEP):.2f} rad tells an altitude"
    )
    silent = (
        f"{names}: the start has no echo"
        f" ({why if beam.cosine <= STEEP else 'the floor returns none'})"
    )
    then = (
        "nothing sinks, no condition on altitude is met, and a task on it soon makes the robot"
        " hold; start elsewhere"
    )
    yield Severity.WARNING.finding(ECHO, f"{silent}; until one comes {then}", phase, tilt_rad=tilt)


def check_goals(setup: Setup) -> Iterator[Finding]:
    """Find goals of vehicle or tool that lie below the floor, one for each phase and task."""
    for index, phase in enumerate(setup.mission.phases):
        for task in setup.mission.tasks_of(index):
            if isinstance(task, (PoseTask, ToolPosition)) and task.name in phase.on:
                depths = []  # of goals below the floor, with their heights and the floor's [m]
                for goal in goals_of(setup, task.name, task.goal):
                    x, y, z = goal.translation
                    floor = setup.floor_at(x, y)
                    depths.append((floor - z, z, floor))
                depth, z, floor = max(depths)
                if depth >= 0:
                    text = (
                        f"the goal of {task.name}, z = {z:g} m, is {depth:.2f} m below the"
                        f" seafloor, z = {floor:g} m"
                    )
                    yield Severity.ERROR.finding(
                        "goal", f"{text}; raise it", phase.name, below_floor_m=floor - float(z)
                    )


def _start(setup: Setup, visit: Visit) -> Iterator[Finding]:
    """Find a start inside the floor, below the minimum altitude, or too much tilted."""
    X_WS = setup.altimeter_pose(setup.start)
    altitude = float(X_WS.translation[2]) - setup.floor_at(X_WS.translation[0], X_WS.translation[1])
    minimum = visit.active(MinimumAltitude)
    if altitude <= 0:
        text = f"the altimeter starts {-altitude:.2f} m inside the floor; raise the start"
        yield Severity.ERROR.finding("start", text, altitude_m=altitude)
    elif minimum is not None and altitude < minimum.threshold:
        text = (
            f"the start is at an altitude of {altitude:.2f} m, below {minimum.name}'s"
            f" {minimum.threshold:g} m"
        )
        yield Severity.WARNING.finding("start", text, altitude_m=altitude)
    attitude = visit.active(HorizontalAttitude)
    tilt = math.acos(min(1.0, float(pin.Quaternion(setup.start[3:7]).matrix()[2, 2])))
    if attitude is not None and tilt > attitude.activation.end:
        text = (
            f"the vehicle starts with a tilt of {tilt:.2f} rad, outside {attitude.name}'s"
            f" {attitude.activation.end:g} rad"
        )
        yield Severity.WARNING.finding("start", text, tilt_rad=tilt)


def _way_point(
    setup: Setup, visit: Visit, task: VehiclePose, minimum: MinimumAltitude
) -> Iterator[Finding]:
    """Find how far the minimum altitude holds the vehicle above its way point."""
    goal, _ = goals.evaluate_pose(task.name, task.goal, 0.0)
    radius = threshold_of(visit.phase, f"{task.name}.position_error")
    gap = minimum.threshold - _altitude(setup, goal)
    if gap <= 0:
        return
    higher_task = next(item.name for item in visit.tasks if item in (task, minimum))
    figures = {
        "kept_away_m": gap,
        "ball_m": radius,
        "altitude_at_way_point_m": minimum.threshold - gap,
    }
    if higher_task == task.name:
        text = (
            f"{task.name} ranks above {minimum.name} and breaks the minimum altitude by {gap:.2f} m"
            " at its way point"
        )
        yield Severity.WARNING.finding(MINIMUM_ALTITUDE, text, visit.phase.name, **figures)
        return
    shut = radius is not None and _least_gap(setup, goal, minimum, radius) > 0
    altitudes = f"altitude {minimum.threshold - gap:.2f} m, minimum {minimum.threshold:g} m"
    text = f"{minimum.name} keeps the vehicle {gap:.2f} m above its way point ({altitudes})"
    if shut:
        severity = Severity.ERROR
        text += (
            f", outside the ball of {radius or 0:g} m that ends the phase; raise the way point by"
            f" {gap:.2f} m"
        )
    else:
        severity = Severity.WARNING
    yield severity.finding(MINIMUM_ALTITUDE, text, visit.phase.name, **figures)


def _altitude(setup: Setup, X_WB: pin.SE3) -> float:
    """Return the altitude [m] of the altimeter above the floor below it, for the vehicle at X_WB."""
    q = setup.start.copy()
    q[:7] = pin.SE3ToXYZQUAT(X_WB)
    p = setup.altimeter_pose(q).translation
    return float(p[2]) - setup.floor_at(p[0], p[1])


def _least_gap(setup: Setup, goal: pin.SE3, minimum: MinimumAltitude, radius: float) -> float:
    """Return the smallest distance [m] by which the minimum altitude keeps the vehicle away, over the
    ball around a way point.
    """
    top = pin.SE3(goal.rotation, goal.translation + np.array([0.0, 0.0, radius]))
    rim = (pin.SE3(goal.rotation, point) for point in points_on_ball(goal.translation, radius))
    return float(np.min([minimum.threshold - _altitude(setup, pose) for pose in (top, *rim)]))


def _landing(visit: Visit, landing: LandingAltitude, minimum: MinimumAltitude) -> Iterator[Finding]:
    """Find a landing that aims below the minimum altitude."""
    aim = landing.rest_altitude
    if aim < minimum.threshold:
        text = (
            f"{landing.name} aims at {aim:.2f} m while {minimum.name} keeps {minimum.threshold:g}"
            " m; switch one off"
        )
        yield Severity.ERROR.finding(
            "contradiction", text, visit.phase.name, aim_m=aim, minimum_m=minimum.threshold
        )
