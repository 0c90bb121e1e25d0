"""Public values show themselves as small tables: 80 columns in a shell, a table in a notebook,
names as text.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import uvms_ocp as uo
from uvms_ocp.campaign import Campaign
from uvms_ocp.control import Nmpc
from uvms_ocp.ocp.problem import OcpLevel, OcpProblem, single_phase
from uvms_ocp.ocp.terms import Effort
from uvms_ocp.record.display import SmallTable, format_value
from uvms_ocp.record.meta_values import PhaseMeta
from uvms_ocp.record.run_meta import RunMeta
from uvms_ocp.report import compare, resources
from uvms_ocp.robot.signals import State
from uvms_ocp.scenario.preflight.findings import Finding, PreflightReport, Severity
from uvms_ocp.sim.sensors import SensorSuite
from uvms_ocp.trajectories import min_snap

EVIL = "<script>alert(1)</script>\x1b[31m"


def flown() -> uo.Record:
    return uo.scenario.reach(plant="kinematic", duration=1.0, dt=0.02).run()


def record() -> uo.Record:
    meta = RunMeta(
        scenario=EVIL,
        robot="planar5",
        joints=("a",),
        phases=(PhaseMeta(name="A"),),
        plant="kinematic",
        solver="none",
        floating=False,
        dt=0.1,
        completed=True,
    )
    return uo.Record(
        series={"t": np.array([0.0, 0.1]), "q": np.zeros((2, 1)), "own": np.zeros(2)}, meta=meta
    )


def report() -> PreflightReport:
    text = (
        "the target is out of reach by so much that no posture of this long arm leads there,"
        " whatever the vehicle does"
    )
    return PreflightReport(findings=(Finding(severity=Severity.ERROR, check=EVIL, text=text),))


def level() -> uo.Level:
    return uo.Level(jacobian=np.eye(2), lower=[0.1, 0.1], upper=[0.2, 0.2])


def problem() -> OcpProblem:
    robot = uo.load_robot("planar5")
    start = State(q=np.zeros(robot.n_q), v=np.zeros(robot.n_v))
    levels = [OcpLevel(name="effort", terms=(Effort(),))]
    return single_phase(
        robot=robot, start=start, duration=1.0, n_steps=4, levels=levels, water=False
    )


VALUES: dict[str, Callable[[], Any]] = {
    "record": record,
    "report": report,
    "mission": lambda: uo.scenario.case1().mission,
    "hierarchy": lambda: uo.scenario.case1().mission.hierarchy,
    "scenario": uo.scenario.case1,
    "phase": lambda: uo.scenario.case1().mission.phases[0],
    "limits": lambda: uo.load_robot("planar5").limits,
    "kinematics": lambda: uo.Kinematics(
        uo.load_robot("planar5"), uo.load_robot("planar5").configuration()
    ),
    "dynamics": lambda: uo.robot_dynamics(uo.load_robot("planar5")),
    "level": level,
    "solution": lambda: uo.LexicographicActiveSet().solve([level()]),
    "campaign": lambda: Campaign(scenario="case1", runs=3),
    "summary": lambda: uo.summarize(flown()),
    "run_meta": lambda: record().meta,
    "kinematic controller": lambda: uo.scenario.case1(plant="kinematic").controller(),
    "dynamic controller": lambda: uo.scenario.case1(learn_load=True).controller(),
    "watched controller": lambda: replace(
        uo.scenario.case1(), controller=lambda scenario: print
    ).controller(),
    "receding horizon": lambda: Nmpc(problem()),
    "estimator": lambda: uo.scenario.case1(noise=True).estimator().estimator,
    "guarded estimator": lambda: uo.scenario.case1(noise=True).estimator(),
    "readings as they are": lambda: uo.scenario.case1().estimator().estimator,
    "problem": problem,
    "tasks by phases": lambda: uo.scenario.case1().mission.table(),
    "resources": lambda: resources(flown()),
    "comparison": lambda: compare(flown(), flown()),
    "curve": lambda: min_snap(np.array([[0.0], [1.0]]), [0.0, 1.0]),
}


@pytest.mark.parametrize("name", VALUES)
def test_a_value_is_shown_in_80_columns_of_plain_letters(name: str) -> None:
    lines = repr(VALUES[name]()).splitlines()
    assert 1 < len(lines) < 50
    assert max(map(len, lines)) <= 80
    assert all(line.isprintable() for line in lines)


@pytest.mark.parametrize("name", VALUES)
def test_a_notebook_gets_a_table_in_which_names_are_text(name: str) -> None:
    html = VALUES[name]()._repr_html_()
    assert html.count("<table>") == 1
    assert "<script" not in html


def test_a_record_tells_its_series_with_their_units() -> None:
    shown = repr(record())
    assert "2 rows, 0 to 0.1 s" in shown
    assert "true configuration" in shown
    assert "own" in shown


def test_a_mission_tells_which_tasks_are_on_when() -> None:
    rows = repr(uo.scenario.case1().mission).splitlines()
    assert rows[1].split()[:3] == ["task", "type", "A"]
    assert next(row for row in rows if " PC " in row).split()[:6] == [
        "PC",
        "[R,E,AD]",
        "1",
        "0",
        "0",
        "0",
    ]


def test_a_controller_tells_where_its_mission_is() -> None:
    shown = repr(uo.scenario.case1().controller())
    assert "phases" in shown
    assert "in phase A" in shown
    assert "borne by the joints [-] 1" in " ".join(shown.split())


def test_an_estimator_tells_until_when_its_channels_were_used() -> None:
    scenario = replace(uo.scenario.case1(noise=True), duration=0.1)
    guarded = scenario.estimator()
    assert repr(guarded.estimator).count("no reading yet") == 6
    suite = SensorSuite(scenario.robot, scenario.environment.seafloor, scenario.specs)
    state = State(q=np.array(scenario.start), v=np.zeros(scenario.robot.n_v))
    for t in (0.0, 0.005):
        guarded(suite.read(state, t), t)
    assert "no reading yet" not in repr(guarded.estimator)
    assert "good" in repr(guarded)


def test_metadata_tells_values_of_many_fields_by_their_names_or_their_number() -> None:
    shown = repr(uo.scenario.case1(plant="kinematic", duration=0.1).run().meta)
    assert "A, B, C, D" in shown
    assert "NR, JL, MAC" in " ".join(shown.split())


def test_a_robot_tells_its_joints_in_a_notebook() -> None:
    robot = uo.load_robot("planar5")
    html = robot._repr_html_()
    assert all(name in html for name in robot.joint_names)
    assert repr(robot).startswith("Robot('planar5'")


@pytest.mark.parametrize(
    ("value", "row"),
    [
        (None, "-"),
        (0.123456, "0.1235"),
        (np.zeros(3), "[0. 0. 0.]"),
        (np.zeros((2, 3)), "array of shape (2, 3)"),
        ((1, 2), "1, 2"),
        (tuple(range(10)), "0, 1, 2, 3, 4, 5, 6, 7 and 2 more"),
        (({"a": 1}, {"a": 2}), "2 rows"),
        ({"x": 1, "y": 2}, "x, y"),
        (object(), "object"),
        (level, "level"),
        (np.ones(3).tolist() * 100, "1, 1, 1, 1, 1, 1, 1, 1 and 292 more"),
    ],
)
def test_a_field_is_told_in_a_row(value: Any, row: str) -> None:
    assert format_value(value) == row


def test_rows_beyond_the_first_are_counted() -> None:
    table = SmallTable(title="numbers", rows=tuple((str(k),) for k in range(100)))
    assert table.text().splitlines()[-1].strip() == "and 60 more"
    assert "and 60 more" in table.html()


def test_a_finding_of_pre_flight_is_printed_to_its_last_word() -> None:
    finding = Finding(
        severity=Severity.ERROR, check="reach", phase="approach", text=report().findings[0].text
    )
    lines = str(PreflightReport(findings=(finding, finding))).splitlines()
    assert max(map(len, lines)) <= 80
    words = [word for line in lines[2:] for word in line.split()]
    assert [word for word in words if word not in ("error", "approach", "reach")] == [
        word for word in finding.text.split() * 2 if word != "reach"
    ]
