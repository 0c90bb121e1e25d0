"""`completed` is said of missions whose goals are truly reached, wherever it is said: report,
exit code, campaign, record.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from command_line import called
from compiler import long_without_compiler

from uvms_ocp.campaign.campaign import Campaign
from uvms_ocp.cli.exit_codes import NOT_COMPLETED
from uvms_ocp.errors import InvalidInput
from uvms_ocp.mission.phase import Above, Below, Transition
from uvms_ocp.ocp.plan import OcpStatus, Plan
from uvms_ocp.ocp.problem import OcpLevel, single_phase
from uvms_ocp.ocp.terms import Effort
from uvms_ocp.ocp.trajectory import hold_guess
from uvms_ocp.record.meta_values import DONE, EventMeta
from uvms_ocp.record.record import Record
from uvms_ocp.record.run_meta import RunMeta, read_meta, write_meta
from uvms_ocp.report.end_of_run import cause_of_end, goal_table
from uvms_ocp.report.metrics import failed_ticks
from uvms_ocp.report.summary import summarize
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.signals import Command, State
from uvms_ocp.scenario.cases.case1 import Thresholds, case1
from uvms_ocp.scenario.plan_replay import replay
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.sim.plant import KinematicPlant
from uvms_ocp.solvers.hierarchy.solution import Status

NEAR = 0.2  # [m] that the tool is to come near its goal
BIAS = "position:bias=0.5,0,0@0"  # [m] which no other sensor contradicts


def reach(**options: object) -> Scenario:
    thresholds = Thresholds(way_point=0.2, tool_position=NEAR, tool_orientation=1.0)
    return case1(thresholds=thresholds, duration=90.0, dt=0.02, plant="kinematic", **options)


@pytest.fixture(scope="module")
def honest() -> Record:
    return reach().run()


@pytest.fixture(scope="module")
def elsewhere() -> Record:
    """Completed by readings that are wrong by half a metre."""
    return reach(faults=BIAS).run()


def true_distance(scenario: Scenario, record: Record) -> float:
    """[m] of the tool from its goal at the last row, by the kinematics of Pinocchio alone."""
    robot = scenario.robot
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, record["q"][-1])
    (goal,) = (task.goal for task in scenario.mission.hierarchy.tasks if task.name == "T")
    return float(np.linalg.norm(data.oMf[robot.frame_id("tool")].translation - goal.translation))


def with_events(record: Record, change: Callable[[EventMeta], EventMeta]) -> Record:
    events = tuple(map(change, record.run_meta.events))
    return replace(record, meta=record.run_meta.model_copy(update={"events": events}))


@long_without_compiler
def test_a_mission_is_completed_where_the_tool_truly_is_at_its_goal(
    honest: Record, elsewhere: Record
) -> None:
    for record, kind in ((honest, "completed"), (elsewhere, "ended too early")):
        assert record.run_meta.completed
        is_there = true_distance(reach(), record) < NEAR
        assert is_there == (kind == "completed")
        assert cause_of_end(record)["kind"] == kind


def turned(record: Record, tilt: float, error: float) -> Record:
    """Return the record with its last row at another tilt, and that error of each vehicle task."""
    q = record["q"].copy()
    q[-1, 3:7] = pin.Quaternion(pin.rpy.rpyToMatrix(tilt, 0.0, 0.3)).coeffs()
    values = record["quantities"].copy()
    for column, name in enumerate(record.meta.quantities):
        if name.endswith((".tilt", ".orientation_error")):
            values[-1, column] = error
    return replace(record, series={**record.series, "q": q, "quantities": values})


@long_without_compiler
@pytest.mark.parametrize(
    ("tilt", "error", "kind"),
    [(0.4, 0.5, "tilted"), (0.4, 0.1, "completed"), (0.2, 0.4, "completed")],
)
def test_a_mission_that_ends_tilted_unasked_is_not_called_complete(
    honest: Record, tilt: float, error: float, kind: str
) -> None:
    activations = honest["activations"].copy()
    activations[-1] = 1.0
    record = replace(honest, series={**honest.series, "activations": activations})
    cause = cause_of_end(turned(record, tilt, error))
    assert cause["kind"] == kind
    assert kind == "completed" or "lies at 23 deg" in cause["text"]
    activations[-1] = 0.0  # nobody asks for anything
    record = replace(honest, series={**honest.series, "activations": activations})
    assert cause_of_end(turned(record, tilt, error))["kind"] == "completed"


@long_without_compiler
def test_the_command_says_what_the_report_says(tmp_path: Path) -> None:
    words = ["run", "mission.py", "--out", "run", "--figures", "none", "--force"]
    options = f"thresholds=Thresholds(way_point={NEAR}, tool_position={NEAR}, tool_orientation=1.0)"
    source = (
        "from uvms_ocp.scenario.cases.case1 import Thresholds, case1\n"
        f"scenario = case1({options}, plant='kinematic', duration=90.0, dt=0.02)\n"
    )
    (tmp_path / "mission.py").write_text(source)
    good = called(*words, cwd=tmp_path)
    assert good.returncode == 0, good.stderr
    assert "mission complete;" in good.stdout
    wrong = called(*words, "--fault", BIAS, cwd=tmp_path)
    assert wrong.returncode == NOT_COMPLETED
    assert "mission complete by the estimate alone;" in wrong.stdout
    assert "ended too early" in wrong.stdout


@pytest.mark.sampled
@long_without_compiler
@pytest.mark.parametrize(("faults", "succeeds"), [((), True), (BIAS, False)])
def test_a_run_of_a_campaign_succeeds_where_its_record_says_so(
    faults: str | tuple[()], succeeds: bool
) -> None:
    campaign = Campaign(scenario=lambda: reach(faults=faults), runs=1, records="all")
    result = campaign.work.make(0)
    assert result.row["success"] is succeeds
    assert result.row["finished"]
    assert (result.row["tool_position_error_m"] < NEAR) is succeeds


@long_without_compiler
def test_a_run_of_which_the_truth_is_not_known_is_no_success(honest: Record) -> None:
    """As where the program ended between the end of the mission and that of the record."""
    blind = with_events(honest, lambda event: event.model_copy(update={"true_quantities": ()}))
    cause = cause_of_end(blind)
    assert cause["kind"] == "truth unknown"
    assert "PC.position_error at the end of phase A is not known" in cause["text"]
    assert summarize(blind)["cause"] == cause


@long_without_compiler
def test_a_mission_that_nothing_ended_is_not_completed(honest: Record) -> None:
    silent = replace(honest, meta=honest.run_meta.model_copy(update={"events": ()}))
    assert cause_of_end(silent)["kind"] == "truth unknown"


@long_without_compiler
@pytest.mark.parametrize("altered", ["completed", "events"])
def test_a_record_whose_words_contradict_its_events_is_refused(
    altered: str, honest: Record
) -> None:
    meta = honest.run_meta
    values = {"completed": False} if altered == "completed" else {"events": meta.events[:-1]}
    assert read_meta(write_meta(meta)) == meta
    with pytest.raises(InvalidInput, match="its last event leads to"):
        read_meta(write_meta(meta.model_copy(update=values)))


def ending_when(condition: Above | Below, hold: float = 0.0) -> Record:
    """Of case 1 whose first phase is the only one, and ends on a condition."""
    scenario = reach()
    first = scenario.mission.phases[0]
    end = Transition(to=DONE, when=(condition,), hold=hold)
    mission = replace(scenario.mission, phases=(replace(first, transitions=(end,)),))
    return replace(scenario, mission=mission).run()


def with_truth(record: Record, value: float) -> Record:
    """With another true value of what ended the mission."""

    def change(event: EventMeta) -> EventMeta:
        quantity = event.conditions[0].quantity
        truths = tuple(
            item.model_copy(update={"value": value}) if item.name == quantity else item
            for item in event.true_quantities
        )
        return event.model_copy(update={"true_quantities": truths})

    return with_events(record, change)


@long_without_compiler
def test_what_has_to_rise_above_a_limit_is_judged_by_the_truth_too() -> None:
    deep = ending_when(Above(quantity="vehicle.depth", limit=30.0))
    assert cause_of_end(deep)["kind"] == "completed"
    (row,) = goal_table(deep)
    assert (row["sign"], row["limit"], row["met"]) == (">", 30.0, True)
    assert row["true"] == pytest.approx(-deep["q"][-1, 2])
    shallow = with_truth(deep, 29.0)
    assert cause_of_end(shallow)["kind"] == "ended too early"
    assert "truly 29 against a limit of 30" in cause_of_end(shallow)["text"]


@long_without_compiler
def test_a_condition_that_held_is_judged_by_its_release() -> None:
    loose = Below(quantity="PC.position_error", limit=3.0, release=3.5)
    record = ending_when(loose, hold=1.0)
    assert cause_of_end(record)["kind"] == "completed"
    assert cause_of_end(with_truth(record, 3.4))["kind"] == "completed"
    assert cause_of_end(with_truth(record, 3.6))["kind"] == "ended too early"


@long_without_compiler
def test_a_back_step_is_no_goal() -> None:
    """What a phase was left for to try again says nothing of how the mission ended."""
    scenario = reach()
    first, second, *later = scenario.mission.phases
    again = Transition(to=first.name, when=(Above(quantity="PC.position_error", limit=1e-4),))
    loop = replace(second, transitions=(replace(again, retries=1), *second.transitions))
    mission = replace(scenario.mission, phases=(first, loop, *later))
    record = replace(scenario, mission=mission, duration=40.0).run()
    steps = [(event.source, event.target) for event in record.run_meta.events]
    assert (second.name, first.name) in steps
    assert all(row["sign"] == "<" for row in goal_table(record))


def test_a_mission_is_over_by_its_events_alone() -> None:
    with pytest.raises(ValueError, match="a mission that is completed; its last event leads to"):
        RunMeta.model_validate(
            {
                "scenario": "s",
                "robot": "r",
                "joints": (),
                "phases": ({"name": "A"}, {"name": "B"}),
                "packages": (),
                "plant": "kinematic",
                "solver": "none",
                "floating": True,
                "dt": 0.01,
                "completed": True,
                "events": ({"t": 1.0, "source": "A", "target": "B", "reason": ""},),
            }
        )


class RunsAway(KinematicPlant):
    """Whose motion grows beyond all bounds after some steps."""

    def step(self, command: Command, dt: float) -> None:
        super().step(command, dt)
        self.n_steps = getattr(self, "n_steps", 0) + 1
        if self.n_steps == 20:
            self.state = State(q=self.state.q, v=np.full_like(self.state.v, 1e300))


@pytest.mark.parametrize("plant", [KinematicPlant, RunsAway])
def test_a_plan_is_carried_out_where_the_plant_came_to_its_end(
    plant: type[KinematicPlant], caplog: pytest.LogCaptureFixture
) -> None:
    robot = load_robot("planar5")
    start = State(q=robot.configuration(), v=np.zeros(robot.n_v))
    levels = [OcpLevel(name="effort", terms=(Effort(),))]
    problem = single_phase(
        robot=robot, start=start, duration=1.0, n_steps=4, levels=levels, water=False
    )
    plan = Plan(
        robot=robot,
        trajectory=hold_guess(problem),
        status=OcpStatus.SOLVED,
        reason="",
        levels=(),
        solve_time=0.0,
    )
    meta = replay(plan, plant(robot, start.q), dt=0.02).record.run_meta
    is_whole = plant is KinematicPlant
    assert meta.completed is is_whole
    assert meta.stopped == ("" if is_whole else "diverged")


@long_without_compiler
@pytest.mark.parametrize("status", Status, ids=lambda status: status.name)
def test_ticks_that_are_exact_have_not_failed(status: Status, honest: Record) -> None:
    code = honest.run_meta.statuses.index(status.value)
    codes = np.full_like(honest["status"], code)
    record = replace(honest, series={**honest.series, "status": codes})
    assert failed_ticks(record) == ({} if status.exact else {status.value: len(record)})
