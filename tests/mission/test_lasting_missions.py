"""Missions end and go on by time, energy, how often they have been there, and the depth and speed
of the vehicle.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from lasting import NEAR, START, going_to, lasting, patrol

from uvms_ocp.errors import InvalidInput, NameNotFound
from uvms_ocp.mission.phase import Above, Below, Transition
from uvms_ocp.mission.progress import measure_own
from uvms_ocp.mission_plan import plan_mission
from uvms_ocp.record.meta_values import DONE, OWN_QUANTITIES, ThresholdMeta
from uvms_ocp.record.record import Record
from uvms_ocp.report.end_of_run import _trend
from uvms_ocp.report.phase_resources import repeated_phases, resources
from uvms_ocp.report.summary import summarize
from uvms_ocp.robot.description import TrimBody
from uvms_ocp.robot.signals import ChannelHealth, StateEstimate, Trust
from uvms_ocp.viz.motion_figures import figure_velocities
from uvms_ocp.viz.path_figures import figure_path

DT = 0.05
KINEMATIC = {"plant": "kinematic", "dt": DT}
OVER = Transition(to=DONE, when=(Above(quantity="mission.time", limit=65.0),))


def way(record: Record) -> list[tuple[str, str]]:
    return [(event.source, event.target) for event in record.run_meta.events]


def test_station_is_kept_for_a_time() -> None:
    """It was refused: a mission ended by what a task measures, or not at all."""
    scenario = lasting(going_to("keep", START, OVER), duration=70.0, **KINEMATIC)
    assert scenario.check().accepted
    record = scenario.run()
    assert record.run_meta.completed
    assert record["t"][-1] == pytest.approx(65.0, abs=2 * DT)
    (event,) = record.run_meta.events
    assert event.reason.startswith("mission.time = 65")
    assert event.truth["mission.time"] == pytest.approx(event.t)
    assert record["quantities"][:, record.meta.quantities.index("mission.time")] == pytest.approx(
        record["t"]
    )


def test_what_is_missing_of_the_time_is_said() -> None:
    record = lasting(going_to("keep", START, OVER), duration=50.0, **KINEMATIC).run()
    assert not record.run_meta.completed
    assert summarize(record)["cause"]["kind"] == "slow"
    assert "mission.time = 50 against a limit of 65" in summarize(record)["cause"]["text"]


@pytest.mark.parametrize("clock", [0.0, 50.0, 1.76e9])
def test_time_is_that_of_the_mission_on_any_clock(clock: float) -> None:
    scenario = lasting(going_to("keep", START, OVER), **KINEMATIC)
    control = scenario.kinematic_controller()
    still = StateEstimate(q=scenario.start, v=np.zeros(scenario.robot.n_v), altimeter_range=3.0)
    for k in range(4):
        control(still, clock + k * DT)
        assert control.quantities["mission.time"] == pytest.approx(k * DT, abs=1e-6)


def test_rounds_are_counted() -> None:
    scenario = patrol(rounds=3, duration=120.0, **KINEMATIC)
    assert scenario.check().accepted
    record = scenario.run()
    assert record.run_meta.completed
    assert way(record) == [*2 * [("out", "home"), ("home", "out")], ("out", DONE)]
    stays = [
        event.t - before.t
        for before, event in zip(
            record.run_meta.events[:4:2], record.run_meta.events[1:4:2], strict=True
        )
    ]
    assert stays == pytest.approx([2.0, 2.0], abs=2 * DT)


def test_steps_by_hand_take_the_same_way() -> None:
    """Kernels and `Mission.step`."""
    scenario = patrol(rounds=2, duration=60.0, **KINEMATIC)
    record = scenario.run()
    mission = scenario.mission
    state = mission.start(0.0)
    found = []
    for t, row in zip(record["t"], record["quantities"], strict=True):
        tasks = {
            name: value
            for name, value in zip(record.meta.quantities, row, strict=True)
            if name not in OWN_QUANTITIES
        }
        state, event = mission.step(state, float(t), tasks)
        found += [] if event is None else [(event.source, event.target)]
    assert found == way(record)


def test_a_phase_that_time_ends_does_not_stall() -> None:
    """The tool never comes nearer: without a time limit of its own the phase is given up after 60
    s.
    """
    never = Transition(to=DONE, when=(Below(quantity="TP.position_error", limit=0.01),))
    held = Transition(to="home", when=(Above(quantity="phase.time", limit=70.0),))
    home = going_to("home", (0.3, 0.0, -5.0), Transition(to=DONE, when=(NEAR,)))
    limited = lasting(going_to("stay", START, never, held), home, duration=100.0, **KINEMATIC).run()
    assert way(limited) == [("stay", "home"), ("home", DONE)]
    (first, *_) = (
        lasting(going_to("stay", START, never), home, duration=65.0, **KINEMATIC)
        .run()
        .run_meta.events
    )
    assert first.t == pytest.approx(60.0, abs=1.0)
    assert "no nearer for 60 s" in first.reason


def test_depth_and_speed_of_the_vehicle() -> None:
    deep = Transition(to="rest", when=(Above(quantity="vehicle.depth", limit=6.0),))
    slow = Transition(to=DONE, when=(Below(quantity="vehicle.speed", limit=0.01),), hold=0.5)
    phases = going_to("dive", (0.0, 0.0, -6.2), deep), going_to("rest", (0.0, 0.0, -6.2), slow)
    record = lasting(*phases, duration=60.0, **KINEMATIC).run()
    assert way(record) == [("dive", "rest"), ("rest", DONE)]
    below = -np.interp(record.run_meta.events[0].t, record["t"], record["q"][:, 2])
    assert below == pytest.approx(6.0, abs=0.05)
    assert np.linalg.norm(record["v"][-1, :3]) < 0.01


def test_a_quantity_that_nothing_measures_is_refused_with_those_there_are() -> None:
    wrong = Transition(to=DONE, when=(Above(quantity="mission.tiem", limit=1.0),))
    with pytest.raises(NameNotFound, match=r"phase 'keep' 'mission\.tiem'.*mission\.time"):
        lasting(going_to("keep", START, wrong), **KINEMATIC).check()


def test_a_plan_of_the_mission_says_that_it_cannot_state_time() -> None:
    with pytest.raises(
        InvalidInput,
        match=r"looks at phase\.visits > 1\.5, which no residual states; fly this mission without",
    ):
        plan_mission(patrol(rounds=2))


def test_rounds_are_reported_by_phase_and_not_one_by_one() -> None:
    record = patrol(rounds=5, duration=120.0, **KINEMATIC).run()
    out, home = repeated_phases(resources(record))
    assert (out["phase"], out["visits"], home["phase"], home["visits"]) == ("out", 5, "home", 4)
    each = [row["duration_s"] for row in resources(record)[:-1] if row["phase"] == "home"]
    assert home["mean_duration_s"] == pytest.approx(np.mean(each))
    assert home["largest_duration_s"] == max(each)
    assert out["largest_energy_j"] is None
    assert "visits" in str(summarize(record))
    assert repeated_phases(resources(patrol(rounds=1, duration=60.0, **KINEMATIC).run())) == []


@pytest.mark.slow
def test_figures_of_many_rounds_name_no_phase_on_another() -> None:
    record = patrol(rounds=40, duration=300.0, **KINEMATIC).run()
    figure = figure_velocities(record)
    figure.draw_without_rendering()
    boxes = [text.get_window_extent() for text in figure.axes[0].texts if text.get_text()]
    assert all(not one.overlaps(other) for k, one in enumerate(boxes) for other in boxes[k + 1 :])
    colours = {
        line.get_color()
        for line in figure_path(record).axes[0].get_lines()
        if line.get_linewidth() == 2
    }
    assert len(colours) == 2


def test_time_beside_an_error_does_not_end_a_phase_and_hides_no_stall() -> None:
    never = (
        Below(quantity="TP.position_error", limit=0.01),
        Above(quantity="phase.time", limit=5.0),
    )
    record = lasting(
        going_to("stay", START, Transition(to=DONE, when=never)), duration=65.0, **KINEMATIC
    ).run()
    (first, *_) = record.run_meta.events
    assert "no nearer for 60 s" in first.reason


def test_the_phase_of_an_abort_is_visited_once() -> None:
    scenario = patrol(rounds=2, **KINEMATIC)
    memory = scenario.kinematic_controller().memory.mission
    memory.own[:] = [-1, -1, 0, -1, -1, -1]
    for given_up, phase, visits in ((False, 0, 1.0), (False, 1, 0.0), (True, 2, 1.0)):
        memory.given_up = given_up
        memory.phase = phase
        found = [np.nan]
        measure_own(memory, 0.0, 0.0, 0.0, found)
        assert found == [visits]


def test_a_speed_is_unknown_to_phases_while_the_velocity_is_doubted() -> None:
    slow = Transition(to=DONE, when=(Below(quantity="vehicle.speed", limit=0.01),))
    control = lasting(going_to("rest", START, slow), **KINEMATIC).kinematic_controller()
    still = StateEstimate(
        q=control.robot.configuration(position=START),
        v=np.zeros(control.robot.n_v),
        altimeter_range=3.0,
        health=(ChannelHealth(channel="linear_velocity", trust=Trust.SUSPECT),),
    )
    assert np.isnan(
        [control(still, k * DT) and control.quantities["vehicle.speed"] for k in range(3)]
    ).all()


def test_an_error_that_grows_is_not_still_improving() -> None:
    record = lasting(going_to("keep", START, OVER), duration=12.0, **KINEMATIC).run()
    rising = np.array(record["quantities"])
    column = record.meta.quantities.index("PC.position_error")
    rising[:, column] = np.linspace(0.01, 0.5, len(rising))
    spoilt = replace(record, series={**record.series, "quantities": rising})
    for sign, gained in (("<", -1.0), (">", 1.0)):
        asked = ThresholdMeta(phase="keep", quantity="PC.position_error", limit=0.1, sign=sign)
        assert np.sign(_trend(spoilt, asked)[1]) in (gained, 0.0)


@pytest.mark.sampled
@pytest.mark.parametrize("mass", [2.0, -2.0])
def test_a_phase_ends_by_what_the_vehicle_carries(mass: float) -> None:
    """Of either sign, and not while it carries nothing."""
    weight = mass * 9.81
    sign = Above if mass > 0.0 else Below
    carried = Transition(
        to=DONE, when=(sign(quantity="vehicle.load", limit=0.8 * weight),), hold=0.5
    )
    payload = TrimBody(
        name="load",
        link="base_link",
        position=(0.0, 0.0, 0.0),
        mass=2.0,
        volume=0.0 if mass > 0.0 else 4.0 / 1025.0,
    )
    for body in (payload, None):
        record = lasting(going_to("keep", START, carried), duration=10.0, payload=body).run()
        load = record["quantities"][:, record.meta.quantities.index("vehicle.load")]
        assert record.run_meta.completed == (body is not None)
        assert load[-1] == pytest.approx(weight if body else 0.0, rel=0.25, abs=1.0)
    with pytest.raises(InvalidInput, match="give a finite value > 0"):
        Below(quantity="PC.position_error", limit=-1.0)


def test_phases_end_by_the_energy_that_was_used() -> None:
    """As the controller finds it, which is that of the plant to what its model of the thrusters
    leaves out.
    """
    away = Transition(to="home", when=(Above(quantity="phase.energy", limit=300.0),))
    over = Transition(to=DONE, when=(Above(quantity="mission.energy", limit=450.0),))
    phases = going_to("out", (0.5, 0.0, -5.0), away), going_to("home", START, over)
    scenario = lasting(*phases, duration=60.0, dt=0.02, current=(0.3, 0.0, 0.0))
    assert scenario.check().accepted
    record = scenario.run()
    assert record.run_meta.completed
    for event, of_phase, of_all in zip(
        record.run_meta.events, (300.0, 150.0), (300.0, 450.0), strict=True
    ):
        assert event.truth["phase.energy"] == pytest.approx(of_phase, abs=3.0)
        assert event.truth["mission.energy"] == pytest.approx(of_all, abs=3.0)
    found = record["quantities"][:, record.meta.quantities.index("mission.energy")]
    used = record["thruster_energy"].sum(axis=1) + record["joint_energy"]
    np.testing.assert_allclose(found, used, atol=0.01 * used[-1])
    early = replace(scenario, duration=2.0).run()
    assert "phase.energy = " in summarize(early)["cause"]["text"]


def test_an_energy_that_nobody_knows_is_refused_as_a_condition() -> None:
    over = going_to(
        "keep", START, Transition(to=DONE, when=(Above(quantity="mission.energy", limit=450.0),))
    )
    (kinematic,) = [
        item.text for item in lasting(over, **KINEMATIC).check().findings if item.check == "energy"
    ]
    assert kinematic.endswith(
        "waits for mission.energy, but the kinematic plant uses none; use the dynamic plant"
    )
    scenario = lasting(over)
    silent = tuple(
        thruster.model_copy(update={"power": None})
        for thruster in scenario.robot.description.thrusters
    )
    robot = replace(
        scenario.robot,
        description=scenario.robot.description.model_copy(update={"thrusters": silent}),
    )
    (unknown, *_) = [
        item.text
        for item in replace(scenario, robot=robot).check().findings
        if "waits for" in item.text
    ]
    assert "no power is given for thruster T1, T2, " in unknown
