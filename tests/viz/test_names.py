"""Laws of names: whatever a robot, a phase, a task, a marker is called, every output shows it and
does nothing else with it.
"""

from __future__ import annotations

import base64
import io
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.text import Text
from rich.console import Console
from synthetic_record import SURROUNDINGS, synthetic_record

from uvms_ocp.cli.plan import _print_motion
from uvms_ocp.cli.plan_output import PlanOutput, _print_plan
from uvms_ocp.cli.printing import console_of, print_findings, table_of
from uvms_ocp.cli.robots import _print_robot
from uvms_ocp.cli.run import _print_summary
from uvms_ocp.errors import plain_line
from uvms_ocp.export.c_files import ControllerNames, table
from uvms_ocp.mission.mission import Mission
from uvms_ocp.mission.phase import Below, Phase, Transition
from uvms_ocp.record.meta_values import (
    DONE,
    FrameMeta,
    LevelMeta,
    MarkerMeta,
    PhaseMeta,
    TaskMeta,
    ThresholdMeta,
)
from uvms_ocp.record.record import Record
from uvms_ocp.report.summary import summarize
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.scenario.preflight.findings import Finding, PreflightReport, Severity
from uvms_ocp.scenario.preflight.robot_check import RobotFinding, RobotReport, RobotVerdict
from uvms_ocp.tasks.attitude import HorizontalAttitude
from uvms_ocp.tasks.hierarchy import Hierarchy
from uvms_ocp.viz.comparison_figures import figure_joint_comparison, figure_paths
from uvms_ocp.viz.plan_figures import figure_clearance, figure_joint_motion
from uvms_ocp.viz.run_figures import FIGURES
from uvms_ocp.viz.scene.show import show

HOSTILE = {
    "closing tag": "[/]",
    "style": "[bold red]x[/bold red]",
    "emoji": ":skull:",
    "formula": r"$\frac{$",
    "dollars": "$a$ and $b$",
    "lines": "two\nlines\r\x0b",
    "terminal": "\x1b[31mred\x1b]0;title\x07",
    "image": "<img src=x onerror=alert(1)>",
    "script": "</script><script>alert(1)</script><!--",
    "C comment": "*/ #error /* \\",
    "mark": "__DETAILS__ __SCRIPT__ __TITLE__",
    "hidden": "_hidden",
    "dots": "a.b.c",
    "backwards": "\u202egnp",
    "letters": "漢字",
    "long": 200 * "ab ",
    "arrow": "A --> B : x; %%{init}%%",
    "path": "../../etc/passwd",
    "format": "%s {0} {phase.x}",
    "quotes": "\"'`\\",
    "nothing": "\x00",
}
NAMES = list(HOSTILE.values())
STEP = 3  # names of tasks in one record, so that every name is once that of a task


@pytest.fixture(scope="module")
def records(robot: Robot) -> list[Record]:
    return [hostile_record(robot, first) for first in range(0, len(NAMES), STEP)]


def hostile_record(robot: Robot, first: int) -> Record:
    rotated_names = [*NAMES[first:], *NAMES[:first]]
    a, b, c, d = rotated_names[:4]
    frame = FrameMeta(name=d, pose=(2.5, 1.0, -39.9, 1.0, 0.0, 0.0, 0.0))
    markers = (
        MarkerMeta(name=a, position=(2.5, 1.0, -39.9)),
        MarkerMeta(name=b, position=(1.5, 0.5, -38.0)),
    )
    record = synthetic_record(
        robot,
        duration=0.4,
        scenario=c,
        solver=a,
        phases=(PhaseMeta(name=a, title=b), PhaseMeta(name=c, title=d)),
        tasks=tuple(TaskMeta(name=name, label=rotated_names[5]) for name in (a, b, c)),
        tool_task=b,
        levels=tuple(
            LevelMeta(name=name, rows=n) for name, n in ((d, robot.n_v), (a, 2), (b, 1), (c, 0))
        ),
        quantities=(
            f"{a}.x",
            "LA.altitude",
            f"{c}.y",
            f"{b}.orientation_error",
            f"{b}.position_error",
        ),
        thresholds=(ThresholdMeta(quantity=f"{b}.position_error", limit=0.17, sign="<", phase=a),),
        joints=tuple(rotated_names[: robot.n_joints]),
        surroundings=SURROUNDINGS.model_copy(update={"markers": markers, "frames": (frame,)}),
        statuses=("solved",),
        pending=d,
        completed=False,
    )
    return replace(record, meta=record.meta.model_copy(update={"robot": d}))


@pytest.mark.slow
@pytest.mark.parametrize("draw", FIGURES.values(), ids=FIGURES)
def test_every_figure_draws_every_name_as_it_is(draw: Any, records: list[Record]) -> None:
    chosen = (
        records[::2] if draw is FIGURES["joints"] else records
    )  # which shows seven names at once
    drawn = [figure for record in chosen if (figure := draw(record)) is not None]
    assert drawn or draw in (
        FIGURES["errors"],
        FIGURES["misalignment"],
    )  # of tasks that are not in these records
    for figure in drawn:
        figure.set_dpi(30)
        figure.canvas.draw()
        assert not any(text.get_parse_math() for text in figure.findobj(Text))


@pytest.mark.slow
def test_figures_of_two_runs_draw_every_name_as_it_is(records: list[Record]) -> None:
    paths = np.linspace(0.0, 1.0, 6).reshape(2, 3)
    figures = [
        figure_paths(dict.fromkeys(NAMES[k : k + 4], paths)) for k in range(0, len(NAMES), 4)
    ]
    figures += [
        figure_joint_comparison({record.meta.robot: record}, record.meta.phases[1].name)
        for record in records[::3]
    ]
    for figure in figures:
        figure.set_dpi(30)
        figure.canvas.draw()
        assert not any(text.get_parse_math() for text in figure.findobj(Text))


@pytest.mark.slow
def test_figures_of_a_plan_draw_every_name_as_it_is() -> None:
    record = Record.load(Path(__file__).parents[1] / "records" / "plan_curve_v0_1.npz")
    axes = record.plan_meta.axes
    for k in range(0, len(NAMES), 7):
        joints = (NAMES + NAMES)[k : k + 7]
        renamed_clearance = record.plan_meta.min_clearance.model_copy(
            update={"between": f"{joints[0]} - {joints[1]}"}
        )
        names = {
            "joints": joints,
            "axes": (*axes[:4], *joints),
            "clearance_groups": joints[:2],
            "min_clearance": renamed_clearance,
        }
        meta = record.meta.model_copy(update=names)
        for draw in (figure_joint_motion, figure_clearance):
            figure = draw(replace(record, meta=meta))
            figure.set_dpi(30)
            figure.canvas.draw()
            assert not any(text.get_parse_math() for text in figure.findobj(Text))


class _Page(HTMLParser):
    """Tags of a page, and what its scripts hold."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)


def tags_of(page: str) -> list[str]:
    parser = _Page()
    parser.feed(page)
    return parser.tags


def test_no_name_adds_anything_to_the_page_but_data(records: list[Record], robot: Robot) -> None:
    usual = show(synthetic_record(robot, duration=0.4), robot).html
    for record in records:
        page = show(record, robot).html
        assert tags_of(page) == tags_of(usual)
        assert scripts_of(page) == scripts_of(usual)
        details = json.loads(blocks_of(page)["details"])
        assert details["phases"][0]["name"] == record.meta.phases[0].name
        assert details["scenario"] == record.meta.scenario
        assert [label["text"] for label in details["labels"]] == [
            m.name for m in record.meta.surroundings.markers
        ]


def scripts_of(page: str) -> list[str]:
    return re.findall(r"<script>(.*?)</script>", page, re.DOTALL)


def blocks_of(page: str) -> dict[str, str]:
    return dict(
        re.findall(r'<script type="application/json" id="(\w+)">(.*?)</script>', page, re.DOTALL)
    )


def test_the_page_makes_no_markup_and_runs_its_own_scripts_only(
    records: list[Record], robot: Robot
) -> None:
    page = show(records[0], robot).html
    last_script = scripts_of(page)[-1]
    for word in ("innerHTML", "outerHTML", "insertAdjacentHTML", "document.write", "eval("):
        assert word not in last_script
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', page)
    assert policy is not None
    rules = dict(rule.split(" ", 1) for rule in policy[1].split("; "))
    assert rules["default-src"] == "'none'"
    assert (
        len(re.findall(r"'sha256-[\w+/=]{44}'", rules["script-src"])) == len(scripts_of(page)) == 2
    )
    assert "unsafe" not in rules["script-src"]


def test_the_frame_in_a_notebook_may_run_scripts_and_nothing_else(
    records: list[Record], robot: Robot
) -> None:
    for record in records:
        frame = show(record, robot)._repr_html_()
        assert tags_of(frame) == ["iframe", "img"]
        assert 'sandbox="allow-scripts"' in frame.split("srcdoc")[0]
        # In the frame, for where there are no frames: a picture that holds lines alone, whatever is
        # called what.
        _, _, inside = frame.removesuffix("</iframe>").partition("<img ")
        picture = re.fullmatch(
            r'alt="[a-z ]+" src="data:image/svg\+xml;base64,([\w+/=]+)"/>[^<>]+', inside
        )
        assert picture is not None
        assert tags_of(base64.b64decode(picture[1]).decode()) == ["svg", "path"]


def printed(show_on: Any) -> str:
    """What a terminal gets, apart from blanks, line ends and the lines of tables."""
    console = console_of()
    console.file = io.StringIO()
    console.width = 400
    show_on(console)
    return console.file.getvalue()


def squeezed(text: str) -> str:
    return re.sub(r"[\s│┃]", "", text)


@pytest.mark.parametrize("name", NAMES, ids=HOSTILE)
def test_tables_and_lines_show_every_name(name: str) -> None:
    finding = Finding(severity=Severity.ERROR, check=name, text=name, phase=name)
    rows = [{name: name, "value": 1.0}]
    report = {"status": name, "advice": name, "links_without_shape": [name]}
    plan = PlanOutput(
        robot=load_robot("planar5"),
        report=report,
        record=None,
        good=False,
        save=None,
        show=_print_motion,
    )
    outputs = [
        printed(lambda console: console.print(table_of(name, rows, (name, "value")))),
        printed(lambda console: print_findings(console, PreflightReport(findings=(finding,)))),
        printed(lambda console: _print_plan(console, plan, [])),
    ]
    for text in outputs:
        assert squeezed(plain_line(name)) in squeezed(text)
        assert "\x1b" not in text
        assert all(letter.isprintable() or letter == "\n" for letter in text)


def test_the_summary_of_a_run_shows_every_name(records: list[Record]) -> None:
    for record in records:
        report = summarize(record)
        text = printed(lambda console, report=report: _print_summary(console, report, []))
        assert all(letter.isprintable() or letter == "\n" for letter in text)
        for name in (record.meta.scenario, record.meta.robot, record.meta.pending):
            assert squeezed(plain_line(name)) in squeezed(text)


def test_the_check_of_a_robot_shows_every_name(monkeypatch: pytest.MonkeyPatch) -> None:
    output = io.StringIO()
    monkeypatch.setattr(
        "uvms_ocp.cli.robots.console_of",
        lambda: Console(
            file=output, width=2000, markup=console_of()._markup, emoji=console_of()._emoji
        ),
    )
    for name in NAMES:
        finding = RobotFinding(subject=name, verdict=RobotVerdict.ERROR, text=name)
        _print_robot(RobotReport(name=name, findings=(finding,)))
    text = output.getvalue()
    assert all(letter.isprintable() or letter == "\n" for letter in text)
    assert all(squeezed(plain_line(name)) in squeezed(text) for name in NAMES)


def test_the_report_gives_every_name_back(records: list[Record]) -> None:
    for record in records:
        report = json.loads(json.dumps(summarize(record), indent=2))
        assert report["scenario"] == record.meta.scenario
        assert report["phases"][0]["name"] == record.meta.phases[0].name


def mission_of(names: list[str]) -> Mission:
    tasks = [replace(HorizontalAttitude(), name=name) for name in names]
    followers = [*names[1:], DONE]
    phases = tuple(
        Phase(
            name=name,
            title=names[0],
            activations={name: 1.0},
            transitions=(Transition(to=to, when=(Below(quantity=f"{name}.tilt", limit=0.1),)),),
        )
        for name, to in zip(names, followers, strict=True)
    )
    return Mission(hierarchy=Hierarchy(tasks), phases=phases)


def test_a_diagram_of_any_names_has_one_line_for_each_state_and_arrow() -> None:
    mission = mission_of([*NAMES, "end", "phase_1", "plain"])
    head, start, *lines = mission.mermaid().splitlines()
    assert (head, start) == ("stateDiagram-v2", "    [*] --> phase_1")
    text = r"(?:[\w .,()-]|#\d+;)*"
    line = re.compile(rf"    \w+(?: --> (?:\w+|\[\*\]))? : {text}(?: < 0\.1)?")
    assert all(line.fullmatch(one) for one in lines)
    assert len(lines) == 2 * len(mission.phases)
    states = {one.split()[0] for one in lines}
    assert len(states) == len(mission.phases)
    assert "plain" in states


def test_a_table_of_any_names_has_one_line_for_each_task() -> None:
    table = str(mission_of(NAMES)).splitlines()
    assert len(table) == 1 + 2 * len(NAMES)
    assert all(line.isprintable() for line in table)


@pytest.mark.parametrize("name", NAMES, ids=HOSTILE)
def test_no_name_ends_a_text_in_c_or_a_cell_of_a_table(name: str) -> None:
    names = ControllerNames(
        export="c", phases=(name, name), statuses=(), quantities=(name,), channels=()
    )
    (text,) = set(names.texts()["c_CONTROLLER_QUANTITIES"])
    assert not set(text) & set('"\\?*/')
    assert text.isprintable() or not text
    assert all(row.count("|") == 3 for row in table((name, name)).splitlines())


def test_a_scene_of_a_robot_with_any_names_is_written(tmp_path: Path) -> None:
    robot = load_robot("planar5")
    record = synthetic_record(robot, duration=0.4, scenario=HOSTILE["script"])
    model = robot.model.copy()
    for joint, name in zip(range(1, model.njoints), NAMES, strict=False):
        model.names[joint] = name
    page = (
        show(record, replace(robot, model=model))
        .write(tmp_path / "scene.html")
        .read_text(encoding="utf-8")
    )
    assert tags_of(page).count("script") == 4
