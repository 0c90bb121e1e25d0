"""What is not known is `None` in reports, "-" in tables, and no condition that was met."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from uvms_ocp.cli.printing import cell
from uvms_ocp.mission.phase import Above, Below, Condition
from uvms_ocp.record.meta_values import EventMeta, MetConditionMeta, QuantityMeta, ThresholdMeta
from uvms_ocp.record.record import Record
from uvms_ocp.report.comparison import compare
from uvms_ocp.report.end_of_run import cause_of_end, ended_prematurely, goal_table
from uvms_ocp.report.summary import summarize

STORED = Path(__file__).parents[1] / "records" / "run_v0_1.npz"


def run(known: Callable[[str], bool], estimated: float = 0.1) -> Record:
    """A stored run; of the quantities that are not known neither the estimate nor the truth is
    told.
    """
    stored = Record.load(STORED)
    meta = stored.run_meta
    values = stored["quantities"].copy()
    values[:, [not known(name) for name in meta.quantities]] = np.nan
    truth = tuple(
        QuantityMeta(name=name, value=0.1 if known(name) else np.nan) for name in meta.quantities
    )
    met = tuple(
        MetConditionMeta(
            quantity=name, limit=0.2, sign="<", estimated=estimated if known(name) else np.nan
        )
        for name in meta.quantities
    )
    first = EventMeta(
        t=float(stored["t"][0]),
        source="A",
        target="done",
        reason="",
        conditions=met,
        true_quantities=truth,
    )
    meta_with_truth = meta.model_copy(
        update={"events": (first,), "true_quantities": truth, "completed": True}
    )
    return Record(series={**stored.series, "quantities": values}, meta=meta_with_truth)


@pytest.mark.parametrize("known", [lambda _: False, lambda name: not name.endswith("altitude")])
def test_reports_have_no_number_for_what_is_not_known(
    known: Callable[[str], bool], tmp_path: Path
) -> None:
    run(known).save(tmp_path / "record.npz")
    record = Record.load(tmp_path / "record.npz")
    report = summarize(record)
    json.dumps(report, allow_nan=False)
    for phase in report["phases"]:
        for errors in (phase["final_errors"], phase["true_errors"]):
            assert {name for name, value in errors.items() if value is None} == {
                n for n in errors if not known(n)
            }
    for row in goal_table(record):
        assert (row["true"] is None, row["estimated"] is None) == (not known(row["quantity"]),) * 2
        assert row["met"] is (True if known(row["quantity"]) else None)
    assert not ended_prematurely(record)
    for row in compare(record, record):
        assert "nan" not in (cell(row["first"]), cell(row["second"]), cell(row["change"]))


def test_a_mission_that_waits_for_what_is_not_known_says_so() -> None:
    record = run(lambda _: False)
    known_run = run(lambda _: True)
    name = record.meta.quantities[0]
    last = record.meta.phases[int(record["phase"][-1])].name
    waits = (ThresholdMeta(quantity=name, limit=1e-12, sign="<", phase=last),)
    unfinished = {"completed": False, "events": (), "thresholds": waits, "alarms": ()}
    cause = cause_of_end(replace(record, meta=record.run_meta.model_copy(update=unfinished)))
    assert cause == {
        "kind": "stalled",
        "text": f"phase {last}: {name} is not known, and its condition not met",
    }
    other_cause = cause_of_end(
        replace(known_run, meta=known_run.run_meta.model_copy(update=unfinished))
    )
    assert "not known" not in other_cause["text"]


@pytest.mark.parametrize(
    "condition", [Below(quantity="a.b", limit=1.0, release=2.0), Above(quantity="a.b", limit=1.0)]
)
@pytest.mark.parametrize("held", [False, True])
def test_no_condition_holds_of_what_is_not_known(condition: Condition, held: bool) -> None:
    assert not condition.holds({"a.b": np.nan}, held)
    assert condition.describe({"a.b": np.nan}) == f"a.b is not known, asked {condition.sign} 1"


def test_a_table_shows_a_dash_for_what_is_not_known() -> None:
    assert [cell(value) for value in (None, float("nan"), np.float64("nan"), 0.5)] == [
        "-",
        "-",
        "-",
        "0.5",
    ]
