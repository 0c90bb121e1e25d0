"""A vehicle whose pitch nobody drives reaches way points, with tasks on its attitude and with a
load that nobody told it of.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from six_thrusters import six_thrusters

import uvms_ocp as uo
from uvms_ocp.control.velocity.tick import _shorten
from uvms_ocp.report.metrics import swings
from uvms_ocp.robot.description import Thruster, TrimBody, checked_copy
from uvms_ocp.scenario.options import (
    RunOptions,
    abort_phase,
    activate,
    current_from,
    mission_of,
    run_options,
)
from uvms_ocp.scenario.preflight import Severity
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.tasks import (
    Alignment,
    HorizontalAttitude,
    JointLimits,
    JointTracking,
    MinimumAltitude,
    ToolPosition,
    VehiclePose,
)
from uvms_ocp.types import Point

WAY_POINT = (3.0, 0.0, -8.0)
TARGET = (4.1, 0.0, -8.6)


def loaded(load: float) -> RunOptions:
    """Options of a run of a minute in still water and without noise, with a load [kg] at the
    tool.
    """
    body = TrimBody(name="load", link="tool", position=(0.0, 0.0, 0.0), mass=load, volume=0.0)
    return run_options(
        {"robot": six_thrusters(), "payload": body if load else None, "duration": 60.0},
        seabed=-12.0,
    )


def scenario_of(
    run: RunOptions,
    start: Point,
    target: Point,
    on: tuple[str, ...],
    ends: uo.Transition,
    tools: tuple[ToolPosition, ...] = (),
) -> Scenario:
    """One phase from a start, with its bow on a target, with the tasks that are on."""
    robot = run.robot
    tasks = [
        JointLimits(),
        MinimumAltitude(),
        HorizontalAttitude(),
        Alignment(goal=target),
        *tools,
        VehiclePose(goal=uo.pose_at(WAY_POINT)),
        JointTracking(joints=robot.joint_names, goal=robot.home),
    ]
    phase = uo.Phase(name="A", activations=activate(*on), transitions=(ends,))
    mission = mission_of(robot, tasks, (phase,), abort=abort_phase("JL", "MAC", "HA", "MP"))
    return run.scenario(name="six", mission=mission, start=run.start(uo.pose_at(start)), markers={})


def swim(load: float, *, aligned: bool = True) -> Scenario:
    """To a way point 3.6 m away with a load [kg] at the tool."""
    on = ("JL", "MAC", "HA", *(("AT",) if aligned else ()), "PC", "MP")
    arrived = uo.Below(quantity="PC.position_error", limit=0.1)
    conditions = (
        (arrived, uo.Below(quantity="AT.misalignment", limit=0.1)) if aligned else (arrived,)
    )
    return scenario_of(
        loaded(load),
        (0.0, 0.0, -6.0),
        TARGET,
        on,
        uo.Transition(to=uo.DONE, when=conditions, hold=1.0),
    )


def reach(run: RunOptions, limit: float) -> Scenario:
    """With the tool, from rest at the way point, until it is nearer than the limit [m]."""
    target = (4.3, 0.0, -8.6)
    on = ("JL", "MAC", "HA", "AT", "TP", "PC", "MP")
    transition = uo.Transition(
        to=uo.DONE, when=(uo.Below(quantity="TP.position_error", limit=limit),), hold=1.0
    )
    return scenario_of(
        run, WAY_POINT, target, on, transition, (ToolPosition(goal=uo.pose_at(target)),)
    )


def test_a_pitch_beyond_its_limit_slows_no_other_axis() -> None:
    memory = swim(0.0).kinematic_controller().memory
    memory.solved[0] = 0.4
    memory.solved[4] = 2.0
    _shorten(memory)
    assert (memory.wanted[0], memory.wanted[4]) == pytest.approx((0.4, 2.0))


def test_pre_flight_tells_once_which_axes_no_thruster_drives() -> None:
    (finding,) = swim(0.0).check().of_check("axes without thrust")
    assert finding.severity is Severity.NOTE
    assert finding.text == "no thruster drives pitch: HA, AT, PC ask for the other axes alone"


@pytest.mark.slow
@pytest.mark.parametrize("aligned", [True, False])
@pytest.mark.parametrize("load", [0.0, 2.0, 4.0])
def test_the_way_point_is_reached_with_any_load_and_never_fled(load: float, aligned: bool) -> None:
    record = swim(load, aligned=aligned).run()
    assert record.meta.events[-1].target == uo.DONE
    away = np.linalg.norm(record.series["q"][:, :3] - WAY_POINT, axis=1)
    assert away.max() < away[0] + 0.1


@pytest.mark.slow
@pytest.mark.parametrize("load", [0.0, 2.0, 4.0])
def test_a_tool_reaches_its_target_on_a_swinging_vehicle_and_the_swing_dies_away(
    load: float,
) -> None:
    """From rest at the way point, where the load lets go: it pitches the vehicle by 20 deg and
    more, which no thruster holds.
    """
    record = reach(loaded(load), 0.01).run()
    assert record.meta.events[-1].target == uo.DONE
    energy = record.series["v"][:, 4] ** 2
    later = len(energy) // 2
    assert energy[later:].max() <= 0.5 * energy[:later].max() + 1e-4
    assert energy[-200:].max() <= 0.05 * energy.max() + 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("current", [(0.2, 0.0, 0.0), (-0.2, 0.0, 0.0), (0.0, 0.2, 0.0)])
def test_the_heaviest_load_is_held_in_a_current(current: tuple[float, float, float]) -> None:
    """It leans the vehicle by 40 deg, and drag on a leaning hull pitches it: the tool comes to rest
    all the same.
    """
    record = reach(replace(loaded(4.0), current=current_from(current)), 1e-6).run()
    last_errors = record.series["quantities"][
        -1000:, record.meta.quantities.index("TP.position_error")
    ]
    assert last_errors.max() < 0.005


@pytest.mark.sampled
@pytest.mark.parametrize("robot", ["bluerov2", "bluerov2_six_alpha5"])
def test_the_shipped_vehicles_that_do_not_pitch_reach(robot: str) -> None:
    record = uo.scenario.reach(robot=robot).run()
    assert record.run_meta.completed
    assert swings(record) == []


def _mounted_inexactly(thruster: Thruster, rng: np.random.Generator) -> Thruster:
    position = np.array(thruster.position) + rng.uniform(-1e-3, 1e-3, 3)
    return Thruster.model_validate(dict(thruster) | {"position": position.tolist()})


@pytest.mark.sampled
@pytest.mark.parametrize("density", [998.0, 1025.0])
@pytest.mark.parametrize("seed", range(6))
def test_a_millimetre_at_the_thrusters_takes_no_more_thrust(seed: int, density: float) -> None:
    robot = six_thrusters()
    rng = np.random.default_rng(seed)
    thrusters = tuple(_mounted_inexactly(thruster, rng) for thruster in robot.description.thrusters)
    inexact = checked_copy(robot.description, thrusters=thrusters, water_density=density)
    exact = checked_copy(robot.description, water_density=density)
    shares = []
    for description in (exact, inexact):
        scenario = uo.scenario.reach(robot=replace(robot, description=description))
        (forces,) = (f for f in scenario.check().findings if f.check == "forces")
        assert forces.severity is Severity.NOTE, forces.text
        shares.append(forces.figures["thrust_share"])
    assert shares[1] == pytest.approx(shares[0], abs=0.01)
