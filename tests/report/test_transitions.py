"""Figures of phase changes, from a record whose velocities and residuals are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from uvms_ocp.errors import InvalidInput
from uvms_ocp.record.meta_values import LevelMeta, LimitsMeta, PhaseMeta, TaskMeta
from uvms_ocp.record.record import Record
from uvms_ocp.record.run_meta import RunMeta
from uvms_ocp.report.comparison import transition_series, transition_table
from uvms_ocp.viz.comparison_figures import figure_transitions

DT = 0.1


@pytest.fixture
def record() -> Record:
    """Two axes with limits of 1 and 2; phase A for 2 s, then B; in B a safety task and an action
    miss their rate.
    """
    n = 41
    t = DT * np.arange(n)
    command = np.zeros((n, 2))
    command[10:, 0] = 0.05
    command[25:, 1] = 0.4
    activations = np.ones((n, 2))
    activations[20:22, 0] = 0.5
    residual = np.zeros((n, 4))
    residual[20:, 2] = 0.3  # the safety task
    residual[30:, 3] = 0.7  # the action
    unlimited = (np.inf, np.inf)
    limits = LimitsMeta(
        position_lower=(-np.inf, -np.inf),
        position_upper=unlimited,
        velocity=unlimited,
        acceleration=(1.0, 2.0),
        effort=unlimited,
    )
    meta = RunMeta(
        scenario="two axes",
        robot="planar",
        joints=("x", "y"),
        phases=(PhaseMeta(name="A"), PhaseMeta(name="B")),
        tasks=(TaskMeta(name="S", label="[R,I,S]"), TaskMeta(name="G", label="[R,E,AD]")),
        levels=tuple(
            LevelMeta(name=name, rows=rows) for name, rows in (("limits", 2), ("S", 1), ("G", 1))
        ),
        limits=limits,
        plant="kinematic",
        solver="none",
        floating=False,
        dt=DT,
        completed=True,
    )
    phase = (t > 1.95).astype(int)
    series = {
        "t": t,
        "command": command,
        "activations": activations,
        "residual": residual,
        "phase": phase,
    }
    return Record(series=series, meta=meta)


def test_series_are_shares_of_the_acceleration_second_differences_and_what_full_tasks_above_miss(
    record: Record,
) -> None:
    series = transition_series(record)
    assert series["step"][10] == pytest.approx(0.5)
    assert series["step"][25] == pytest.approx(2.0)
    assert series["jerk"][25] == series["jerk"][26] == pytest.approx(0.4 / DT**2)
    np.testing.assert_allclose(series["lost"], np.where(np.arange(41) >= 22, 0.3, 0.0))
    np.testing.assert_allclose(series["changes"], [2.0])


def test_the_table_has_every_change_and_the_whole_run(record: Record) -> None:
    change, whole = transition_table({"first": record})
    assert (change["run"], change["change"], whole["change"]) == ("first", "A-B", "all")
    assert change["t_s"] == pytest.approx(2.0)
    assert whole["t_s"] == pytest.approx(4.0)
    assert change["step"] == whole["step"] == pytest.approx(2.0)
    assert change["jerk_rms"] == pytest.approx(0.4 / DT**2 * np.sqrt(2 / 10))


def test_a_step_back_is_named_after_the_phase_that_it_left(record: Record) -> None:
    phases = tuple(PhaseMeta(name=name) for name in "ABC")
    phase = np.repeat([0, 2, 1], [10, 10, 21])
    again = Record(
        series={**record.series, "phase": phase},
        meta=record.meta.model_copy(update={"phases": phases}),
    )
    assert [row["change"] for row in transition_table({"one": again})] == ["A-C", "C-B", "all"]


def test_an_axis_that_may_not_move_has_no_share(record: Record) -> None:
    assert record.meta.limits is not None
    still = record.meta.limits.model_copy(update={"acceleration": (0.0, 2.0)})
    series = transition_series(
        replace(record, meta=record.meta.model_copy(update={"limits": still}))
    )
    assert series["step"][10] == 0.0
    assert series["step"].max() == pytest.approx(2.0)


def test_the_figure_has_one_line_for_every_run(record: Record) -> None:
    series = transition_series(record)
    figure = figure_transitions({"one": series, "two": series})
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["one", "two"]
    assert len(figure.axes) == 3


def test_a_record_without_limits_has_no_shares_of_them(record: Record) -> None:
    poor = replace(record, meta=record.meta.model_copy(update={"limits": None}))
    with pytest.raises(InvalidInput, match="tells no limits"):
        transition_series(poor)
