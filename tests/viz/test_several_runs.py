"""Laws of figures of several runs: who is which, from when to when, and what differs."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from synthetic_record import synthetic_record

from uvms_ocp.errors import InvalidInput, NameNotFound
from uvms_ocp.record.record import Record
from uvms_ocp.robot.robot import Robot
from uvms_ocp.viz import plot
from uvms_ocp.viz.label_text import label_texts
from uvms_ocp.viz.several_runs import BAND

ERROR = "T.position_error"


@pytest.fixture(scope="module")
def longer(robot: Robot) -> Record:
    """Another run than `record`: its phases begin later."""
    return synthetic_record(robot, duration=8.0)


def _curves(axis: Axes, n: int) -> list[Line2D]:
    """The lines of a panel that have a row of n times or more."""
    return [line for line in axis.get_lines() if len(np.atleast_1d(line.get_xdata())) >= n]


def _names(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.legends[0].get_texts()]


def _bands(axis: Axes) -> int:
    return sum(patch.get_gid() is not None for patch in axis.patches)


def test_each_run_has_a_colour_and_its_own_times(record: Record, longer: Record) -> None:
    figure = plot({"strict": record, "iCAT": longer}, ERROR, "q.z")
    assert _names(figure) == ["strict", "iCAT"]
    for axis, name in zip(figure.axes, (ERROR, "q.z"), strict=True):
        first, second = _curves(axis, 100)
        assert to_rgba(first.get_color()) != to_rgba(second.get_color())
        for line, run in ((first, record), (second, longer)):
            np.testing.assert_array_equal(line.get_xdata(), run["t"])
            values = run[ERROR] if name == ERROR else run["q"][:, 2]
            np.testing.assert_array_equal(line.get_ydata(), values)
        assert axis.get_xlim() == (0.0, longer["t"][-1])


def test_columns_of_a_series_have_dashes_of_their_own_in_the_colour_of_the_run(
    record: Record, longer: Record
) -> None:
    (axis,) = plot([record, longer], "v").axes
    lines = _curves(axis, 100)
    n = record["v"].shape[1]
    assert len(lines) == 2 * n
    assert len({to_rgba(line.get_color()) for line in lines}) == 2
    of_first = [line._dash_pattern for line in lines[:n]]
    of_second = [line._dash_pattern for line in lines[n:]]
    assert of_first == of_second
    assert all(one != other for one, other in itertools.pairwise(of_first))


def test_phases_are_shaded_once_where_runs_share_them_and_marked_for_each_where_not(
    record: Record, longer: Record
) -> None:
    (alike,) = plot({"a": record, "b": record}, ERROR).axes
    assert _bands(alike) == 2
    (apart,) = plot({"a": record, "b": longer}, ERROR).axes
    assert _bands(apart) == 0
    first, second = _curves(apart, 100)
    marks = {
        (float(np.ravel(line.get_xdata())[0]), to_rgba(line.get_color())[:3])
        for line in apart.get_lines()
        if len(np.ravel(line.get_xdata())) == 2
    }
    for line, run in ((first, record), (second, longer)):
        start = run["t"][np.flatnonzero(np.diff(run["phase"]))[0] + 1]
        assert (start, to_rgba(line.get_color())[:3]) in marks


def test_differences_are_to_the_first_at_the_same_times(record: Record, longer: Record) -> None:
    (axis,) = plot({"a": record, "b": longer}, ERROR, differences=True).axes
    (line,) = _curves(axis, 100)
    t = longer["t"]
    expected = longer[ERROR] - np.interp(t, record["t"], record[ERROR], right=np.nan)
    np.testing.assert_allclose(line.get_ydata(), expected)


def test_many_runs_of_one_name_are_a_median_and_a_band(robot: Robot) -> None:
    runs = [synthetic_record(robot, duration=4.0) for _ in range(21)]
    for k, run in enumerate(runs):
        quantities = run.series["quantities"] + k
        runs[k] = Record(series={**run.series, "quantities": quantities}, meta=run.meta)
    (axis,) = plot({"drawn": runs}, ERROR).axes
    (line,) = _curves(axis, 100)
    t = np.asarray(line.get_xdata(), dtype=float)
    values = [np.interp(t, run["t"], run[ERROR]) for run in runs]
    np.testing.assert_allclose(line.get_ydata(), np.median(values, axis=0))
    corners = axis.collections[0].get_paths()[0].vertices
    low, high = np.percentile(values, BAND, axis=0)
    assert corners[:, 1].min() == pytest.approx(low.min())
    assert corners[:, 1].max() == pytest.approx(high.max())


PANDA = [f"panda_panda_joint{k}" for k in range(1, 8)]
BOTH_ENDS = [f"{side}_arm_of_the_vehicle_joint" for side in ("left", "right")]
THRUSTERS = ["horizontal_bow_port", "horizontal_bow_starboard", "horizontal_stern_port"]


@pytest.mark.parametrize("names", [PANDA, BOTH_ENDS, THRUSTERS, ["a", "b"], ["same", "same"], []])
@pytest.mark.parametrize("longest", [8, 10, 12, 32])
def test_labels_differ_where_names_do(names: list[str], longest: int) -> None:
    labels = label_texts(names, longest)
    assert len(labels) == len(names)
    assert len(set(labels)) == len(set(names))
    if longest >= 10:
        assert all(len(label) <= longest for label in labels)


def test_without_names_all_that_both_measure_is_drawn(record: Record, longer: Record) -> None:
    assert len(plot([record, longer]).axes) == len(record.meta.quantities)


def test_a_second_record_on_the_same_axes_is_another_colour_and_its_phases_stay_apart(
    record: Record, longer: Record
) -> None:
    page = Figure(layout="constrained")
    FigureCanvasAgg(page)
    axis = page.subplots()
    plot(record, ERROR, ax=axis)
    words = [text.get_text() for text in axis.texts]
    bands = _bands(axis)
    plot(longer, ERROR, ax=axis)
    assert [text.get_text() for text in axis.texts] == words
    assert _bands(axis) == bands
    first, second = _curves(axis, 100)
    assert to_rgba(first.get_color()) != to_rgba(second.get_color())
    assert axis.get_xlim() == (0.0, longer["t"][-1])


def test_what_cannot_be_drawn_together_is_refused(record: Record) -> None:
    with pytest.raises(InvalidInput, match="one or more of them"):
        plot({}, ERROR)
    with pytest.raises(InvalidInput, match="nobody: no runs"):
        plot({"nobody": []}, ERROR)
    with pytest.raises(InvalidInput, match="differences of one run"):
        plot([record], ERROR, differences=True)
    with pytest.raises(InvalidInput, match="differences of one run"):
        plot(record, ERROR, differences=True)  # type: ignore[call-overload]
    with pytest.raises(NameNotFound, match=r"TP\.error"):
        plot([record, record], "TP.error")
