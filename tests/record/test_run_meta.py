"""Metadata of records: typed, unchangeable, the same after JSON; files of 0.1 still work; damage is
told in one line.
"""

from __future__ import annotations

import ast
import json
import math
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

import uvms_ocp
from uvms_ocp.errors import InvalidInput
from uvms_ocp.record.meta_values import AxisLimitsMeta, LimitsMeta, PhaseMeta, QuantityMeta
from uvms_ocp.record.record import Record
from uvms_ocp.record.run_meta import PlanMeta, RunMeta, read_meta, write_meta
from uvms_ocp.report.comparison import compare, transition_table
from uvms_ocp.report.end_of_run import cause_of_end
from uvms_ocp.report.summary import summarize
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.scenario.cases.case1 import case1
from uvms_ocp.viz.comparison_figures import figure_joint_comparison
from uvms_ocp.viz.plan_figures import write_plan_figures
from uvms_ocp.viz.run_figures import FIGURES, write_figures
from uvms_ocp.viz.scene.show import write_scene
from uvms_ocp.viz.task_figures import figure_row_activations

RECORDS = Path(__file__).parents[1] / "records"
RUN = "run_v0_1.npz"
PLANS = ("plan_curve_v0_1.npz", "plan_ocp_v0_1.npz")
UNLIMITED = LimitsMeta(
    position_lower=(-math.inf,),
    position_upper=(math.inf,),
    velocity=(1.0,),
    acceleration=(0.1 + 0.2,),
    effort=(1e-300,),
)
BARE = RunMeta(
    scenario="bare",
    robot="any",
    joints=("j",),
    phases=(PhaseMeta(name="A"),),
    limits=UNLIMITED,
    true_quantities=(QuantityMeta(name="T.position_error", value=math.nan),),
    plant="kinematic",
    solver="none",
    floating=False,
    dt=0.1,
    completed=True,
)
PLAN = PlanMeta(
    scenario="nothing near",
    robot="any",
    joints=("j",),
    phases=(PhaseMeta(name="plan"),),
    axes=("j",),
    axis_limits=AxisLimitsMeta(x_rate=(math.inf,)),
    breaks=(0.0, 1.0),
    clearance_wanted=0.06,
)


def raw(name: str) -> dict[str, Any]:
    """The metadata as they stand in the file."""
    with np.load(RECORDS / name) as data:
        return json.loads(str(data["__meta__"]))


@pytest.mark.parametrize("name", [RUN, *PLANS])
def test_metadata_are_the_same_after_json(name: str, tmp_path: Path) -> None:
    record = Record.load(RECORDS / name)
    record.save(tmp_path / name)
    again = Record.load(tmp_path / name)
    assert again.meta == record.meta
    assert json.loads(write_meta(again.meta))["version"] == "0.2"
    assert pickle.loads(pickle.dumps(record.meta)) == record.meta


def test_a_fresh_run_is_the_same_after_json() -> None:
    meta = case1(plant="kinematic", duration=0.1, dt=0.05).run().meta
    assert read_meta(write_meta(meta)) == meta


def test_infinity_and_nan_survive_json() -> None:
    again = read_meta(write_meta(BARE))
    assert again.limits == UNLIMITED
    assert isinstance(again, RunMeta)
    assert math.isnan(again.true_quantity("T.position_error") or 0.0)
    assert read_meta(write_meta(PLAN)) == PLAN


def test_nothing_in_metadata_can_be_changed() -> None:
    meta = Record.load(RECORDS / RUN).run_meta
    for value, field in (
        (meta, "completed"),
        (meta.events[0], "t"),
        (meta.surroundings, "floor"),
        (meta.limits, "effort"),
    ):
        with pytest.raises(ValidationError, match="frozen"):
            setattr(value, field, None)
    hash(meta)  # no list and no dictionary anywhere


def test_a_field_that_does_not_exist_is_refused() -> None:
    with pytest.raises(ValidationError, match="Extra inputs"):
        PhaseMeta(name="A", titel="way point")  # type: ignore[call-arg]


def test_a_run_of_0_1_says_what_it_said() -> None:
    old = raw(RUN)
    meta = Record.load(RECORDS / RUN).run_meta
    assert "version" not in old
    for name in (
        "scenario",
        "robot",
        "plant",
        "solver",
        "dt",
        "wall_s",
        "seed",
        "noise",
        "floating",
        "completed",
        "pending",
    ):
        assert getattr(meta, name) == old[name]
    for name in ("events", "alarms", "thresholds", "tasks", "levels"):
        assert [
            item.model_dump(exclude={"true_quantities", "conditions", "tool"})
            for item in getattr(meta, name)
        ] == old[name]
    assert not any(event.true_quantities for event in meta.events)
    assert {item.name: item.value for item in meta.true_quantities} == old["true_quantities"]
    assert {item.name: list(item.position) for item in meta.surroundings.markers} == old["markers"]
    assert {item.name: list(item.pose) for item in meta.surroundings.frames} == old["frames"]
    assert [item.name for item in meta.surroundings.obstacles] == ["boulder", "wreck"]
    np.testing.assert_array_equal(meta.surroundings.floor.z, old["floor"]["z"])  # type: ignore[union-attr]
    assert {item.name: item.version for item in meta.packages} == old["versions"]


@pytest.mark.parametrize("name", PLANS)
def test_a_plan_of_0_1_says_what_it_said(name: str) -> None:
    old = raw(name)
    meta = Record.load(RECORDS / name).plan_meta
    for field in ("axes", "breaks", "clearance_groups"):
        assert list(getattr(meta, field)) == old[field]
    assert meta.min_clearance is not None
    assert list(meta.min_clearance.model_dump().values()) == old["min_clearance"]
    assert meta.axis_limits.model_dump(exclude_none=True) == {
        key: tuple(old["axis_limits"][key]) for key in old["axis_limits"]
    }


def test_a_plan_of_0_1_that_can_meet_nothing_has_no_smallest_distance() -> None:
    old = raw(PLANS[0]) | {"min_clearance": [0.0, math.inf, ""]}
    meta = read_meta(json.dumps(old))
    assert isinstance(meta, PlanMeta)
    assert meta.min_clearance is None


@pytest.mark.slow
def test_every_figure_report_and_scene_works_from_a_run_of_0_1(tmp_path: Path) -> None:
    record = Record.load(RECORDS / RUN)
    robot = load_robot("girona_maris7_full")
    expected_figures = [name for name in FIGURES if name not in ("health", "estimate")]
    assert [path.stem for path in write_figures(record, tmp_path)] == expected_figures
    assert write_plan_figures(record, tmp_path / "plan") == (tmp_path / "plan" / "efforts.png",)
    assert figure_row_activations(record) is not None
    assert figure_joint_comparison({"one": record}) is not None
    assert write_scene(record, robot, tmp_path / "scene.html").exists()
    report = summarize(record)
    json.dumps(report)
    assert [row["name"] for row in report["phases"]] == list("ABCDABCD")
    assert len(report["alarms"]) == 3
    assert cause_of_end(record)["kind"] == "slow"
    assert transition_table({"one": record})
    assert compare(record, record)


@pytest.mark.slow
@pytest.mark.parametrize("name", PLANS)
def test_every_figure_report_and_scene_works_from_a_plan_of_0_1(name: str, tmp_path: Path) -> None:
    record = Record.load(RECORDS / name)
    robot = load_robot("girona_maris7_full")
    figures = {path.stem for path in write_plan_figures(record, tmp_path)}
    assert figures == {"vehicle_motion", "joint_motion", "clearance"} | (
        {"efforts"} if "ocp" in name else set()
    )
    assert {"velocities", "joints", "path"} <= {
        path.stem for path in write_figures(record, tmp_path)
    }
    assert write_scene(record, robot, tmp_path / "scene.html").exists()
    assert {row["figure"]: row["first"] for row in compare(record, record)}["min_clearance_m"] > 0.0
    with pytest.raises(InvalidInput, match=r"of a plan \(.*\); give that of a run"):
        summarize(record)


EVENT = {"t": 1.0, "source": "A", "target": "B", "reason": "near"}


def changed(**fields: Any) -> str:
    """The metadata of the run of 0.1, some of them others."""
    return json.dumps(raw(RUN) | fields)


DAMAGES = [
    ("{", "metadata that is no JSON"),
    ("[]", "metadata that is a list; allowed: an object"),
    ("{}", "neither a run nor a plan"),
    (
        write_meta(BARE).replace('"0.2"', '"7.0"'),
        "format '7.0'; this version reads 0.2 and 0.1: install a newer one",
    ),
    (write_meta(BARE).replace('"run"', '"walk"'), "neither a run nor a plan, but 'walk'"),
    (
        write_meta(BARE).replace('"plant"', '"plnt"'),
        "plant: missing; give it a value; and plnt: unknown key; did you mean",
    ),
    (
        write_meta(BARE).replace('"completed":true', '"completed":"yes"'),
        "completed: given 'yes'; allowed: a valid boolean",
    ),
    (
        write_meta(BARE).replace('"title":""', '"title":"","colour":1'),
        "phases.0.colour: unknown key; known here: name, tasks",
    ),
    (write_meta(PLAN).replace('"axes":["j"]', '"axes":"j"'), "axes: given 'j'"),
    (json.dumps(raw(RUN) | {"markers": 3}), "surroundings.markers: given 3"),
    (json.dumps(raw(RUN) | {"phases": []}), "phases: given"),
    (
        json.dumps(raw(RUN) | {"floor": {"x": [0, 1], "y": [1, 0], "z": []}}),
        "x and y of a floor ascend",
    ),
    (
        json.dumps(raw(RUN) | {"floor": {"x": [0, 1], "y": [0, 1], "z": [[1, 2]]}}),
        "2 rows of 2 heights",
    ),
    (json.dumps(raw(RUN) | {"remark": "x"}), "remark: unknown key"),
    (changed(events=raw(RUN)["events"][::-1]), "leads from 'C' to 'D'; the mission was in 'A'"),
    (
        changed(events=[EVENT, EVENT | {"source": "B", "target": "A"}]),
        "after one at 1 s; events stand in order of time",
    ),
    (
        changed(events=[EVENT | {"target": "Q"}]),
        "an event at 1 s leads from 'A' to 'Q'; the mission was in 'A'",
    ),
    (
        changed(events=[EVENT | {"target": "done"}, EVENT | {"t": 2.0}]),
        "from 'A' to 'B'; the mission was in 'done'",
    ),
    (changed(phases=[{"name": "A"}, {"name": "A"}]), "two phases are called 'A'"),
    (changed(phases=[{"name": "A"}, {"name": "abort"}]), "two phases are called 'abort'"),
    (changed(dt=0.0), "dt: given 0.0; allowed: greater than or equal to 0.000000001"),
    (
        changed(thresholds=[{"phase": "A", "quantity": "x", "limit": math.nan, "sign": "<"}]),
        "thresholds.0.limit: given nan",
    ),
    (changed(frames={"goal": [0.0] * 7}), "has norm 1, not 0"),
    (changed(markers={"x": [0.0, 0.0, 1e308]}), "surroundings.markers.0.position.2: given 1e+308"),
    (
        json.dumps(raw(PLANS[0]) | {"axis_limits": {"x_rate": [1.0]}}),
        "axis_limits have one number for each of 11 axes",
    ),
    (json.dumps(raw(PLANS[0]) | {"min_clearance": [1, 2]}), "min_clearance: given"),
]


@pytest.mark.parametrize(("text", "message"), DAMAGES)
def test_damaged_metadata_are_told_in_one_line_that_names_the_file(
    text: str, message: str, tmp_path: Path
) -> None:
    np.savez(tmp_path / "r.npz", t=np.zeros(2), __meta__=np.array(text))
    with pytest.raises(InvalidInput) as caught:
        Record.load(tmp_path / "r.npz")
    assert str(caught.value).startswith(f"{tmp_path / 'r.npz'}: ")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_no_code_looks_up_metadata_by_a_string() -> None:
    """`meta[...]` and `meta.get(...)`, of any object called so."""
    lookups = []
    for path in Path(uvms_ocp.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            inner = node.value if isinstance(node, ast.Subscript | ast.Attribute) else None
            name = inner.attr if isinstance(inner, ast.Attribute) else getattr(inner, "id", "")
            if name.endswith("meta") and (
                isinstance(node, ast.Subscript) or getattr(node, "attr", "") in ("get", "items")
            ):
                lookups.append(f"{path.name}:{node.lineno}")
    assert not lookups
