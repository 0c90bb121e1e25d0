"""A mission as one problem: what its phases ask for holds at the nodes, and costs less than one
phase after the other.
"""

from __future__ import annotations

import signal
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from uvms_ocp.errors import InvalidInput
from uvms_ocp.interrupts import Interrupted
from uvms_ocp.mission.phase import Above, Below, Condition, Phase, Transition
from uvms_ocp.mission_plan import Margins, MissionPlan, plan_mission
from uvms_ocp.mission_plan.planner import mission_problem
from uvms_ocp.mission_plan.segments import PlanMargins
from uvms_ocp.mission_plan.terms import MissionWeights
from uvms_ocp.ocp.plan import OcpStatus
from uvms_ocp.ocp.planner import Planner
from uvms_ocp.ocp.terms import At
from uvms_ocp.record.meta_values import DONE
from uvms_ocp.record.record import Record
from uvms_ocp.report.phase_resources import resources
from uvms_ocp.scenario.cases import case1, reach, transit, two_targets
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.sim.currents import OnsetCurrent
from uvms_ocp.solvers.nlp.options import NlpOptions
from uvms_ocp.tasks.pose import ToolPosition, VehiclePose

pytestmark = pytest.mark.slow

_ROUNDING = 1e-5


def task_of(scenario: Scenario, kind: type[Any]) -> Any:
    return next(task for task in scenario.mission.hierarchy.tasks if isinstance(task, kind))


def placed(scenario: Scenario, q: np.ndarray, frame: str) -> pin.SE3:
    model = scenario.robot.model
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    return data.oMf[scenario.robot.frame_id(frame)].copy()


def margins_of(scenario: Scenario) -> PlanMargins:
    return Margins().of(scenario.robot)


def energy(record: Record) -> float:
    return float(resources(record)[-1]["energy_j"])


def test_the_plan_is_solved_and_no_longer_than_it_may_be(
    planned: MissionPlan, greedy: Record
) -> None:
    assert planned.status is OcpStatus.SOLVED
    assert planned.duration <= greedy["t"][-1]
    assert planned.names == ("A", "B")


def test_the_way_point_is_reached_where_its_phase_ends(
    mission: Scenario, planned: MissionPlan
) -> None:
    q = planned.trajectory.state_at(mission.robot.model, planned.phases[0].end)[0]
    goal = task_of(mission, VehiclePose).goal
    X_WB = placed(mission, q, "base_link")
    assert (
        np.linalg.norm(X_WB.translation - goal.translation)
        <= 0.2 - margins_of(mission).position + _ROUNDING
    )
    assert (
        np.linalg.norm(pin.log3(goal.rotation @ X_WB.rotation.T))
        <= 0.2 - margins_of(mission).angle + _ROUNDING
    )


def test_the_tool_is_within_its_threshold_for_as_long_as_it_has_to_be(
    mission: Scenario, planned: MissionPlan
) -> None:
    trajectory = planned.trajectory
    goal = task_of(mission, ToolPosition).goal
    held = trajectory.q[
        trajectory.t >= planned.duration - 1.0 - margins_of(mission).hold - _ROUNDING
    ]
    assert len(held) > 2
    for q in held:
        error = np.linalg.norm(placed(mission, q, "tool").translation - goal.translation)
        assert error <= 0.01 * 0.25 + _ROUNDING
    np.testing.assert_allclose(trajectory.v[-1], 0.0, atol=_ROUNDING)


def test_tilt_and_altitude_are_kept_at_every_node(mission: Scenario, planned: MissionPlan) -> None:
    for q in planned.trajectory.q[1:]:
        R_WB = placed(mission, q, "base_link").rotation
        assert np.arccos(R_WB[2, 2]) <= 0.1 - margins_of(mission).angle + 1e-4
        height = placed(mission, q, mission.robot.description.altimeter or "altimeter").translation[
            2
        ]
        assert height >= -10.0 + 1.0 + margins_of(mission).altitude - _ROUNDING


def test_a_flown_plan_completes_the_mission_for_less_energy_in_no_more_time(
    greedy: Record, flown: Record
) -> None:
    assert flown.run_meta.completed
    assert not flown.run_meta.alarms
    assert flown["guided"].all()
    assert flown["t"][-1] <= greedy["t"][-1]
    assert energy(flown) < 0.5 * energy(greedy)


def test_thrust_stays_within_the_limits_of_the_thrusters(
    mission: Scenario, planned: MissionPlan
) -> None:
    limits = [
        (thruster.minimum, thruster.maximum) for thruster in mission.robot.description.thrusters
    ]
    lower, upper = np.array(limits).T
    assert (planned.trajectory.thrust >= lower - 1e-3).all()
    assert (planned.trajectory.thrust <= upper + 1e-3).all()


def test_a_solver_that_is_stopped_makes_no_plan_that_could_be_flown(mission: Scenario) -> None:
    stopped = plan_mission(mission, step=3.0, options=NlpOptions(max_iterations=1))
    assert stopped.status is OcpStatus.UNFINISHED
    with pytest.raises(InvalidInput, match="the plan of reach is unfinished"):
        stopped.fly(mission)


def test_a_stop_by_hand_keeps_the_best_plan_so_far(
    mission: Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    solve = Planner.solve

    def pressed(self: Planner, *given: Any, **more: Any) -> Any:
        signal.raise_signal(signal.SIGINT)
        return solve(self, *given, **more)

    monkeypatch.setattr(Planner, "solve", pressed)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(Interrupted) as stop:
            plan_mission(mission, step=3.0, options=NlpOptions(max_iterations=1))
    finally:
        signal.signal(signal.SIGINT, before)
    assert isinstance(stop.value.result, MissionPlan)


def test_a_plan_that_takes_longer_than_is_allowed_is_not_called_solved(mission: Scenario) -> None:
    hasty = plan_mission(mission, step=3.0, duration=1.0)
    assert hasty.status is not OcpStatus.SOLVED
    assert "1 s are allowed" in hasty.reason or not hasty.status.usable


def ended_by(scenario: Scenario, *conditions: Condition) -> Scenario:
    """With another end of its last phase."""
    last = replace(scenario.mission.phases[-1], transitions=(Transition(to=DONE, when=conditions),))
    return replace(
        scenario, mission=replace(scenario.mission, phases=(*scenario.mission.phases[:-1], last))
    )


def test_a_condition_that_no_residual_states_is_refused_by_its_name(mission: Scenario) -> None:
    with pytest.raises(
        InvalidInput, match=r"phase 'B' looks at JL\.margin < 0\.1, which no residual"
    ):
        plan_mission(ended_by(mission, Below(quantity="JL.margin", limit=0.1)))


def test_a_mission_that_is_to_go_away_from_a_pose_is_refused(mission: Scenario) -> None:
    with pytest.raises(InvalidInput, match=r"TP\.position_error > 0\.5"):
        plan_mission(ended_by(mission, Above(quantity="TP.position_error", limit=0.5)))


def test_a_floor_that_is_not_level_is_refused() -> None:
    with pytest.raises(InvalidInput, match="the floor rises by"):
        plan_mission(transit(length=6.0))


def test_a_phase_that_nothing_leaves_is_refused(mission: Scenario) -> None:
    endless = replace(mission.mission.phases[-1], transitions=())
    phases: tuple[Phase, ...] = (*mission.mission.phases[:-1], endless)
    with pytest.raises(InvalidInput, match="no transition leads from phase 'B' to done"):
        plan_mission(replace(mission, mission=replace(mission.mission, phases=phases)))


def test_a_limit_that_does_not_hold_when_its_phase_begins_is_entered_first() -> None:
    posed = mission_problem(two_targets(), margins=Margins(), step=2.0)
    names = [segment.ocp.name for segment in posed.segments]
    assert names[:2] == ["A1", "B1"]
    assert names[names.index("D1 held") + 1 :][:2] == ["A2 entered", "A2"]
    kept = {term.phase for term in posed.terms.constraints if term.name == "MAC"}
    assert kept == {"A1", "B1", "A2", "B2"}


def test_what_is_held_lasts_longer_than_the_mission_asks_for() -> None:
    posed = mission_problem(case1(), margins=Margins(hold=0.3), step=2.0)
    durations = {segment.ocp.name: segment.ocp.range for segment in posed.segments if segment.holds}
    assert durations == {"C held": (0.5, 0.5), "D held": (1.3, 1.3)}


def test_no_back_step_is_triggered_on_the_way(mission: Scenario) -> None:
    back = Transition(to="A", when=(Above(quantity="PC.position_error", limit=0.5),))
    first, last = mission.mission.phases
    phases = (first, replace(last, transitions=(*last.transitions, back)))
    posed = mission_problem(
        replace(mission, mission=replace(mission.mission, phases=phases)),
        margins=Margins(),
        step=2.0,
    )
    kept = [term for term in posed.terms.constraints if term.name == "PC"]
    assert {term.phase for term in kept} == {"B", "B held"}
    assert all(term.at is At.PATH for term in kept)


def test_water_that_changes_later_than_a_plan_may_last_does_not_matter() -> None:
    late = OnsetCurrent((0.4, 0.0, 0.0), start=30.0, rise=1.0)
    posed = mission_problem(reach(seed=3, current=late), margins=Margins(), step=2.0)
    assert posed.steady_until == 30.0
    longer = replace(posed.guess, t=posed.guess.t * (60.0 / posed.guess.t[-1]))
    before, all_along = (
        posed.at(MissionWeights(), longer, longest=s).currents for s in (posed.steady_until, 60.0)
    )
    assert not before.any()
    np.testing.assert_allclose(all_along[-1], [0.4, 0.0, 0.0])
