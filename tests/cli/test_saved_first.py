"""A run is saved before anything is made of it: what fails then costs itself alone."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from io import StringIO
from pathlib import Path
from types import MappingProxyType
from typing import Any

import pytest
from rich.console import Console
from tiny_robots import TINY, robot_of, scenario_of
from typer.testing import CliRunner

from uvms_ocp.campaign.mission_job import MissionJob
from uvms_ocp.campaign.sampling_design import Design
from uvms_ocp.cli import drawing, plan, plan_output, run
from uvms_ocp.cli.commands import app
from uvms_ocp.cli.drawing import Job
from uvms_ocp.cli.exit_codes import NOT_COMPLETED
from uvms_ocp.errors import NameNotFound
from uvms_ocp.ocp.plan import OcpStatus, Plan
from uvms_ocp.planning.request import PlanRequest, PostureGoal
from uvms_ocp.record.record import Record
from uvms_ocp.record.recorder import Recorder
from uvms_ocp.report.summary import summarize
from uvms_ocp.robot.signals import Command, State
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.sim.loop import simulate
from uvms_ocp.solvers.nlp.solve_monitor import IterationReport
from uvms_ocp.viz import run_figures


def _tiny() -> Scenario:
    return scenario_of(robot_of(TINY["one wet link"]), "kinematic")


def _fails(record: Record, **options: object) -> None:
    raise ValueError("no axes\nleft")


def test_a_figure_that_fails_costs_that_figure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        run_figures, "FIGURES", MappingProxyType({**run_figures.FIGURES, "errors": _fails})
    )
    console = Console(record=True, width=200, file=StringIO())
    report = run.run_and_write(
        _tiny(), tmp_path / "out", console, drawn=("scene", "errors", "joints", "quantities")
    )
    written = {
        path.relative_to(tmp_path / "out").as_posix() for path in (tmp_path / "out").rglob("*.*")
    }
    expected = {
        "record.npz",
        "report.json",
        "scene.html",
        "figures/joints.png",
        "figures/quantities.png",
    }
    assert expected <= written
    assert "figures/errors.png" not in written
    not_drawn_lines = [line for line in console.export_text().splitlines() if "not drawn" in line]
    assert not_drawn_lines == ["figures/errors.png: not drawn, ValueError: no axes left"]
    assert report["completed"] == Record.load(tmp_path / "out" / "record.npz").run_meta.completed


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("asked", "written"),
    [
        ("none", set()),
        ("path, scene", {"figures/path.png", "scene.html"}),
        ("joints", {"figures/joints.png"}),
    ],
)
def test_only_what_is_asked_for_is_drawn(asked: str, written: set[str], tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = CliRunner().invoke(
        app,
        [
            "run",
            "case1",
            "--plant",
            "kinematic",
            "--duration",
            "0.2",
            "--figures",
            asked,
            "--out",
            str(out),
        ],
    )
    assert result.exit_code == NOT_COMPLETED
    written_files = {path.relative_to(out).as_posix() for path in out.rglob("[!.]*.*")}
    assert written_files - {".uvms_ocp/manifest.json"} == {"record.npz", "report.json", *written}


def test_figures_that_there_are_not_are_refused_before_the_run(tmp_path: Path) -> None:
    result = CliRunner().invoke(
        app, ["run", "case1", "--figures", "path,paths", "--out", str(tmp_path / "out")]
    )
    assert isinstance(result.exception, NameNotFound)
    assert "unknown figure 'paths'" in str(result.exception)
    assert not (tmp_path / "out").exists()


def test_a_report_that_fails_leaves_the_record(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run, "summarize", _fails)
    with pytest.raises(ValueError, match="no axes"):
        run.run_and_write(_tiny(), tmp_path, Console(quiet=True))
    assert len(Record.load(tmp_path / "record.npz")) > 1


@pytest.mark.slow
def test_what_was_flown_before_ctrl_c_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def press(t: float, state: State, command: Command) -> None:
        if t >= 0.1:
            signal.raise_signal(signal.SIGINT)

    def pressed(**parts: Any) -> Recorder:
        return simulate(**{**parts, "observer": press})

    monkeypatch.setattr("uvms_ocp.scenario.scenario_run.simulate", pressed)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        words = ["run", "reach", "--plant", "kinematic", "--out", str(tmp_path / "out"), "--json"]
        done = CliRunner().invoke(app, words)
    finally:
        signal.signal(signal.SIGINT, before)
    assert done.exit_code == 130, done.output
    record = Record.load(tmp_path / "out" / "record.npz")
    assert record["t"][-1] == pytest.approx(0.1)
    assert record.run_meta.stopped
    assert (tmp_path / "out" / "report.json").exists()
    assert "by hand; phase" in done.output


def test_a_plan_that_is_stopped_by_hand_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def press(moment: IterationReport) -> str:
        if moment.iteration == 1:
            signal.raise_signal(signal.SIGINT)
        return ""

    monkeypatch.setattr("uvms_ocp.cli.plan._describe_iteration", press)
    monkeypatch.setattr("uvms_ocp.cli.plan_output.drawer", lambda: nullcontext(lambda drawings: []))
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        words = [
            "plan",
            "ocp",
            "--robot",
            "planar5",
            "--joint",
            "x0=0.9",
            "--out",
            str(tmp_path / "out"),
            "--json",
        ]
        done = CliRunner().invoke(app, words)
    finally:
        signal.signal(signal.SIGINT, before)
    assert done.exit_code == 130, done.output
    assert Plan.load(tmp_path / "out" / "plan.npz").status is OcpStatus.INTERRUPTED


def test_a_figure_of_a_plan_that_fails_costs_that_figure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        run_figures,
        "PLAN_FIGURES",
        MappingProxyType({**run_figures.PLAN_FIGURES, "clearance": _fails}),
    )
    robot = robot_of(TINY["fixed base, no thrusters"])
    before = set[str]()
    request = PlanRequest(
        robot=robot, start=robot.configuration(), goal=PostureGoal(joints={"turn0": 0.3})
    )
    not_drawn_lines = list[str]()

    @contextmanager
    def drawer() -> Iterator[Callable[[Mapping[str, Job]], list[str]]]:
        def noted(drawings: Mapping[str, Job]) -> list[str]:
            before.update(path.name for path in (tmp_path / "out").iterdir())
            not_drawn_lines.extend(draw(drawings))
            return not_drawn_lines

        with drawing.drawer() as draw:
            yield noted

    monkeypatch.setattr(plan_output, "drawer", drawer)
    plan_output.make_and_write_plan(lambda _: plan._by_curve(request), tmp_path / "out", False)
    written = {
        path.relative_to(tmp_path / "out").as_posix() for path in (tmp_path / "out").rglob("*.*")
    }
    saved = {"report.json", "plan.npz", "plan.csv", "record.npz"}
    assert saved <= before
    assert saved | {"scene.html", "figures/joint_motion.png"} <= written
    assert "figures/clearance.png" not in written
    assert not_drawn_lines == ["figures/clearance.png: not drawn, ValueError: no axes left"]
    assert Record.load(tmp_path / "out" / "record.npz").meta.kind == "plan"


@pytest.mark.parametrize(
    "failing",
    [
        "scenario_run.ScenarioRun._true_estimate",
        "run_metadata.quantity_stds",
        "run_metadata.floor_relief",
    ],
)
def test_what_fails_after_a_run_costs_itself(
    failing: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def fail(*given: object) -> None:
        raise ValueError("low has NaN")

    whole = _tiny().run()
    monkeypatch.setattr(f"uvms_ocp.scenario.{failing}", fail)
    record = _tiny().run()
    assert record["q"].tolist() == whole["q"].tolist()
    assert "not in the record: " in caplog.text
    assert "ValueError: low has NaN" in caplog.text
    assert summarize(record)["phases"]


@pytest.mark.parametrize("records", ["none", "all"])
def test_metrics_that_fail_leave_the_record_of_a_run_of_a_campaign(
    records: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "uvms_ocp.campaign.run_metrics.run_metrics", lambda scenario, record: _fails(record)
    )
    design = Design(sampler="random", runs=1, parameters=0, seed=0)
    done = MissionJob(scenario=_tiny, variations=(), names=(), design=design, records=records).make(
        0
    )
    assert (done.row["outcome"], done.row["success"]) == ("error", False)
    assert "no axes left" in str(done.row["cause"])
    assert bool(done.attachment) == (records == "all")
