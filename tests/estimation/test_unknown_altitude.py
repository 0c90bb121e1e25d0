"""An altitude that no echo tells is unknown: in quantities, for conditions, at events and in what
tasks do meanwhile.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
import pytest
from compiler import long_without_compiler
from recording_solver import RecordingSolver

import uvms_ocp as uo
from uvms_ocp.codegen.kernel_layout import doubles
from uvms_ocp.control.velocity.kinematic import KinematicController
from uvms_ocp.estimation.fallbacks import LastFloorRange, Watchdog, echo_range, point_altimeter
from uvms_ocp.mission.phase import Condition
from uvms_ocp.record.record import Record, quantity
from uvms_ocp.report.summary import summarize
from uvms_ocp.robot.kinematics import STEEP, AltimeterBeam
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import SensorSpecs, StateEstimate
from uvms_ocp.scenario.preflight.findings import Severity
from uvms_ocp.tasks import (
    Hierarchy,
    HorizontalAttitude,
    LandingAltitude,
    MinimumAltitude,
    Task,
    VehiclePose,
)

DT = 0.02
FLOOR = -10.0
LANDED = uo.Below(quantity="LA.altitude", limit=0.17)


@dataclass(frozen=True, kw_only=True, slots=True)
class DeafFloor(uo.FlatSeafloor):
    """One that returns no echo."""

    def range_along(self, origin: np.ndarray, direction: np.ndarray) -> float:
        return math.nan


@pytest.fixture(scope="module")
def robot() -> Robot:
    return uo.load_robot("girona_maris7_full")


def scenario(
    robot: Robot,
    *,
    roll: float = 0.0,
    when: tuple[Condition, ...] = (LANDED,),
    tasks: tuple[Task, ...] = (LandingAltitude(), HorizontalAttitude()),
    duration: float = 1.0,
    floor: uo.FlatSeafloor | None = None,
) -> uo.Scenario:
    """One phase, 4 m above the floor."""
    go = uo.Phase(
        name="go",
        activations={task.name: 1.0 for task in tasks},
        transitions=(uo.Transition(to=uo.DONE, when=when),),
    )
    return uo.Scenario(
        name="landing",
        robot=robot,
        start=robot.configuration(position=(0, 0, FLOOR + 4), rpy=(roll, 0, 0), joints=robot.home),
        plant="kinematic",
        dt=DT,
        duration=duration,
        environment=uo.Environment(seafloor=floor or uo.FlatSeafloor(z=FLOOR)),
        mission=uo.Mission(hierarchy=Hierarchy(list(tasks)), phases=(go,), ramp=0.0),
    )


def controller(robot: Robot, *tasks: Task, solver: object | None = None) -> KinematicController:
    study = scenario(
        robot, tasks=tasks, when=(uo.Below(quantity=f"{tasks[0].name}.altitude", limit=1e-9),)
    )
    return replace(study, **({} if solver is None else {"solver": solver})).kinematic_controller()


def measured(robot: Robot, echo: float, *, z: float = -6.0, roll: float = 0.0) -> StateEstimate:
    q = robot.configuration(position=(0, 0, z), rpy=(roll, 0, 0), joints=robot.home)
    return StateEstimate(q=q, v=np.zeros(robot.n_v), altimeter_range=echo)


def altitudes(record: Record) -> np.ndarray:
    values = quantity(record, "LA.altitude")
    assert values is not None
    return values


def rise(robot: Robot, q: np.ndarray, v: np.ndarray) -> float:
    """Velocity [m/s] of the altimeter in z of W."""
    data = robot.model.createData()
    frame = robot.frame_id("altimeter")
    pin.forwardKinematics(robot.model, data, q, v)
    return float(pin.getFrameVelocity(robot.model, data, frame, pin.LOCAL_WORLD_ALIGNED).linear[2])


@long_without_compiler
@pytest.mark.parametrize("roll", [1.9, 2.5, math.pi])
@pytest.mark.parametrize("condition", [LANDED, uo.Above(quantity="LA.altitude", limit=0.17)])
def test_a_robot_whose_altimeter_looks_up_has_not_landed(
    robot: Robot, roll: float, condition: Condition
) -> None:
    study = scenario(robot, roll=roll, when=(condition,))
    (finding,) = study.check().of_check("echo")
    assert finding.severity is Severity.WARNING
    assert f"{roll:.2f} rad" in finding.text
    record = study.run()
    report = summarize(record)
    assert not report["completed"]
    assert report["goals"] == []
    assert report["pending"].startswith(
        f"LA.altitude is not known, asked {condition.sign} 0.17; altimeter_range suspect: no echo"
        " for "
    )
    assert np.isnan(altitudes(record)).all()
    assert report["phases"][-1]["final_errors"]["LA.altitude"] is None
    assert report["phases"][-1]["true_errors"]["LA.altitude"] is None
    assert report["alarms"][0]["text"].startswith("altimeter_range suspect: no echo for ")


@long_without_compiler
def test_a_robot_on_its_side_that_rights_itself_lands_on_its_first_echo_not_before(
    robot: Robot,
) -> None:
    record = scenario(robot, roll=1.62, duration=40.0).run()
    assert record.run_meta.completed
    tilt = quantity(record, "HA.tilt")
    altitude = altitudes(record)
    assert tilt is not None
    tilted = tilt >= math.acos(STEEP)
    assert np.isnan(altitude[tilted]).all()
    upright = record["t"][tilted].max()
    assert not np.isnan(altitude[record["t"] > upright + 1.0]).any(), (
        "believed again once a few echoes agree"
    )
    assert np.isnan(altitude[0])
    assert altitude[-1] < LANDED.limit <= np.nanmin(altitude[:-1])


@long_without_compiler
def test_upright_without_an_echo_the_altitude_is_unknown_and_nothing_sinks(robot: Robot) -> None:
    study = scenario(robot, floor=DeafFloor(z=FLOOR))
    assert "the floor returns none" in study.check().of_check("echo")[0].text
    record = study.run()
    assert np.isnan(altitudes(record)).all()
    assert record["q"][:, 2].min() >= FLOOR + 4 - 1e-9
    (deaf,) = record.run_meta.alarms
    assert deaf.text.startswith("altimeter_range suspect: no echo for ")


@long_without_compiler
def test_with_an_echo_the_altitude_is_what_it_was_and_the_truth_is_that_of_the_floor(
    robot: Robot,
) -> None:
    study = scenario(robot, duration=40.0)
    assert not study.check().of_check("echo")
    record = study.run()
    (goal,) = summarize(record)["goals"]
    assert goal["met"]
    assert goal["true"] == pytest.approx(goal["estimated"])
    beam = AltimeterBeam(robot, "altimeter").at(record["q"][-1])
    assert goal["true"] == pytest.approx(float(beam.origin[2]) - FLOOR)


@pytest.mark.parametrize("solver", [uo.LexicographicActiveSet(), uo.Icat()])
@pytest.mark.parametrize("roll", [0.0, 0.5, 1.62, 3.0])
@pytest.mark.parametrize("task", [LandingAltitude(), MinimumAltitude()])
def test_before_the_first_echo_no_task_on_altitude_sinks(
    robot: Robot, solver: object, roll: float, task: Task
) -> None:
    control = controller(robot, task, solver=solver)
    down = VehiclePose(goal=uo.pose_at((0, 0, -9)))
    for tested in (control, controller(robot, MinimumAltitude(), down)):
        for k in range(8):
            measurement = measured(robot, math.nan, roll=roll)
            v = tested(measurement, k * DT).v
            assert rise(robot, measurement.q, v) >= -1e-9
            assert any(map(math.isnan, tested.quantities.values()))


def test_an_echo_is_carried_for_as_long_as_the_watchdog_waits_and_no_longer(robot: Robot) -> None:
    control = controller(robot, LandingAltitude())
    moved = -0.01
    control(measured(robot, 3.0), 0.0)
    assert control.quantities["LA.altitude"] == 3.0
    for k in range(1, 60):
        t = k * DT
        z = -6.0 + moved * k
        command = control(measured(robot, math.nan, z=z), t)
        shown = command.telemetry["quantities"][control.problem.quantity_names.index("LA.altitude")]
        if t <= Watchdog().hold_after:
            assert shown == pytest.approx(3.0 + moved * k)
        else:
            assert math.isnan(shown)
            assert command.hold


@pytest.mark.parametrize("roll", [0.4, 1.5, 2.5])
def test_a_carried_echo_stands_for_the_height_above_its_floor_however_the_robot_is_turned(
    robot: Robot, roll: float
) -> None:
    memory = LastFloorRange(robot, "altimeter").memory

    def carried(measurement: StateEstimate, t: float) -> float:
        point_altimeter(memory, doubles(measurement.q))
        return echo_range(memory, t, measurement.altimeter_range, 9.0, False)

    at = measured(robot, 3.0)
    floor = float(AltimeterBeam(robot, "altimeter").at(at.q).origin[2]) - carried(at, 0.0)
    turned = measured(robot, math.nan, roll=roll)
    beam = AltimeterBeam(robot, "altimeter").at(turned.q)
    assert carried(turned, DT) * beam.cosine == pytest.approx(float(beam.origin[2]) - floor)


@pytest.mark.parametrize(
    ("roll", "tells"), [(math.acos(STEEP) - 1e-6, True), (math.acos(STEEP) + 1e-6, False)]
)
def test_an_echo_of_a_beam_too_far_from_straight_down_tells_no_altitude(
    robot: Robot, roll: float, tells: bool
) -> None:
    control = controller(robot, LandingAltitude())
    control(measured(robot, 20.0, roll=roll), 0.0)
    assert math.isfinite(control.quantities["LA.altitude"]) is tells
    assert (
        math.isfinite(control.evaluate(measured(robot, 20.0, roll=roll), 0.0)["LA.altitude"])
        is tells
    )


def test_the_truth_is_never_a_stand_in(robot: Robot) -> None:
    control = controller(robot, LandingAltitude())
    control(measured(robot, 3.0), 0.0)
    assert math.isnan(control.evaluate(measured(robot, math.nan), DT)["LA.altitude"])
    assert control.evaluate(measured(robot, 2.0), DT)["LA.altitude"] == 2.0


def test_before_anything_is_measured_nothing_is_known(robot: Robot) -> None:
    control = controller(robot, LandingAltitude(), HorizontalAttitude())
    assert all(map(math.isnan, control.quantities.values()))
    broken = StateEstimate(
        q=np.full(robot.n_q, np.nan), v=np.zeros(robot.n_v), altimeter_range=math.nan
    )
    assert np.isnan(control(broken, 0.0).telemetry["quantities"]).all()
    assert control.pending() == "LA.altitude is not known, asked < 1e-09"


def test_only_what_rests_on_the_range_is_unknown(robot: Robot) -> None:
    control = controller(
        robot, MinimumAltitude(), HorizontalAttitude(), VehiclePose(goal=pin.SE3.Identity())
    )
    control(measured(robot, math.nan), 0.0)
    unknown = {name for name, value in control.quantities.items() if math.isnan(value)}
    assert unknown == {"MAC.altitude"}


def test_the_exported_tick_gets_finite_inputs_without_an_echo_and_says_what_is_unknown(
    robot: Robot,
) -> None:
    recording = RecordingSolver(solver=uo.LexicographicActiveSet())
    control = controller(robot, LandingAltitude(), HorizontalAttitude(), solver=recording)
    commands = [
        control(measured(robot, math.nan, roll=roll), 0.1 * k).v
        for k, roll in enumerate((0.0, 1.0, 2.0))
    ]
    for tick, v in zip(recording.ticks, commands, strict=True):
        assert all(np.isfinite(values).all() for values in tick.inputs)
        np.testing.assert_array_equal(tick.v, v)


def test_a_mission_by_altitude_without_an_altimeter_is_refused(robot: Robot) -> None:
    deaf = replace(scenario(robot), sensors=SensorSpecs(altimeter_range=None))
    (finding,) = deaf.check().of_check("echo")
    assert finding.severity is Severity.ERROR
    assert "no altimeter" in finding.text
    waiting = scenario(robot, tasks=(HorizontalAttitude(), LandingAltitude()))
    (phase,) = waiting.mission.phases
    off = replace(waiting.mission, phases=(replace(phase, activations={"HA": 1.0}),))
    (finding,) = replace(deaf, mission=off).check().of_check("echo")
    assert finding.severity is Severity.WARNING
    tilt = uo.Below(quantity="HA.tilt", limit=0.1)
    free = replace(
        off,
        phases=(replace(off.phases[0], transitions=(uo.Transition(to=uo.DONE, when=(tilt,)),)),),
    )
    assert not replace(deaf, mission=free).check().of_check("echo")
