"""Figures of anything that a record holds, in the formats that papers take, with obstacles where
they stand.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from synthetic_record import QUANTITIES, synthetic_record

from uvms_ocp.errors import InvalidInput, NameNotFound
from uvms_ocp.record.meta_values import MarkerMeta, ObstacleMeta, SurroundingsMeta
from uvms_ocp.record.record import Record
from uvms_ocp.robot.robot import Robot
from uvms_ocp.viz import figure_of, figure_path, figure_quantities, plot, write_figures
from uvms_ocp.viz.path_figures import obstacle_outline


def _labels(figure: Figure | None) -> list[str]:
    assert figure is not None
    return [" ".join(axis.get_ylabel().split()) for axis in figure.axes]


def test_any_quantity_series_or_column_has_a_panel_with_its_unit(record: Record) -> None:
    figure = plot(record, "T.position_error", "thrust", "q.z", "tick_time")
    assert _labels(figure) == ["T.position_error [m]", "thrust [N]", "q.z [m]", "tick_time [s]"]
    lines = [axis.get_lines() for axis in figure.axes]
    np.testing.assert_array_equal(lines[0][0].get_ydata(), record["T.position_error"])
    np.testing.assert_array_equal(lines[2][0].get_ydata(), record["q"][:, 2])
    assert len(figure.axes[1].get_legend().get_texts()) == record["thrust"].shape[1]


def test_every_column_of_a_series_is_drawn_and_called_by_a_name_of_its_own(record: Record) -> None:
    """Of quantities by task and name: two tasks have errors of one name."""
    for name in ("quantities", "q", "v"):
        (axis,) = plot(record, name).axes
        labels = [text.get_text() for text in axis.get_legend().get_texts()]
        assert len(set(labels)) == len(labels) == record[name].shape[1]
    (axis,) = plot(record, "quantities").axes
    assert [text.get_text() for text in axis.get_legend().get_texts()] == list(
        record.meta.quantities
    )


def test_several_names_at_once_are_as_good_as_one_after_the_other(record: Record) -> None:
    assert _labels(plot(record, ("q", "v"))) == _labels(plot(record, "q", "v"))
    assert _labels(plot(record, ["q.z"], "thrust")) == ["q.z [m]", "thrust [N]"]


@pytest.mark.parametrize("wrong", [3, ("q", 2), (), np.zeros(2)])
def test_what_is_no_name_is_refused_in_one_line(record: Record, wrong: object) -> None:
    with pytest.raises(InvalidInput, match="give names such as 'q'"):
        plot(record, wrong)


def test_an_unknown_name_is_answered_with_the_nearest(record: Record) -> None:
    with pytest.raises(NameNotFound, match=r"Did you mean 'T.position_error'"):
        plot(record, "T.position_eror")
    with pytest.raises(NameNotFound, match=r"Did you mean 'q.joint3'"):
        plot(record, "q.jiont3")
    with pytest.raises(NameNotFound, match="unknown quantity, series or column 'nothing'"):
        figure_of(record, "q", "nothing")


def test_without_a_name_a_run_gives_every_figure_and_a_notebook_shows_them(record: Record) -> None:
    figures = plot(record)
    assert len(figures) > 10
    assert figures[:2] != ()
    assert type(figures)(figures[:2])._repr_html_().count("data:image/png;base64,") == 2


@pytest.mark.slow
@pytest.mark.parametrize(
    ("format", "head"), [("pdf", b"%PDF"), ("svg", b"<?xml"), ("png", b"\x89PNG")]
)
def test_figures_are_written_in_the_formats_of_papers(
    record: Record, tmp_path: Path, format: str, head: bytes
) -> None:
    paths = write_figures(record, tmp_path, format)
    assert {path.suffix for path in paths} == {f".{format}"}
    assert all(path.read_bytes().startswith(head) for path in paths)


def test_quantities_of_own_tasks_appear_by_themselves(robot: Robot) -> None:
    record = synthetic_record(robot, quantities=("OWN.swing", *QUANTITIES[1:]))
    assert _labels(figure_quantities(record)) == ["OWN.swing [-]", "MP.posture_error [rad or m]"]
    assert (
        figure_quantities(synthetic_record(robot, quantities=(*QUANTITIES[:5], "HA.tilt"))) is None
    )


BALL = ObstacleMeta(name="ball", shape="sphere", size=(0.5,), position=(1.0, 2.0, -3.0))
PILE = ObstacleMeta(name="pile", shape="cylinder", size=(0.2, 3.0), position=(0.0, 0.0, 0.0))
CRATE = ObstacleMeta(
    name="crate",
    shape="box",
    size=(2.0, 1.0, 0.5),
    position=(0.0, 0.0, 0.0),
    rpy=(0.0, 0.0, np.pi / 2),
)
PLATE = ObstacleMeta(
    name="plate",
    shape="mesh",
    vertices=((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.2, 0.2, 0.0)),
    triangles=((0, 1, 2), (0, 1, 3)),
    position=(5.0, 0.0, 0.0),
)


@pytest.mark.parametrize(
    ("obstacle", "axes", "low", "high"),
    [
        (BALL, (0, 1), (0.5, 1.5), (1.5, 2.5)),
        (BALL, (0, 2), (0.5, -3.5), (1.5, -2.5)),
        (PILE, (0, 1), (-0.2, -0.2), (0.2, 0.2)),
        (PILE, (0, 2), (-0.2, -1.5), (0.2, 1.5)),
        (CRATE, (0, 1), (-0.5, -1.0), (0.5, 1.0)),
        (PLATE, (0, 1), (5.0, 0.0), (6.0, 1.0)),
    ],
)
def test_an_obstacle_covers_what_it_covers(
    obstacle: ObstacleMeta,
    axes: tuple[int, int],
    low: tuple[float, float],
    high: tuple[float, float],
) -> None:
    outline = obstacle_outline(obstacle, *axes)
    np.testing.assert_allclose(outline.min(axis=0), low, atol=0.01)
    np.testing.assert_allclose(outline.max(axis=0), high, atol=0.01)


def test_names_of_two_goals_at_one_place_do_not_hide_each_other(robot: Robot) -> None:
    """Those of two tools are a hand apart, in a figure of some metres."""
    markers = tuple(
        MarkerMeta(name=f"{side}_tool", position=(2.5, 1.0, -39.9))
        for side in ("port", "starboard")
    )
    figure = figure_path(synthetic_record(robot, surroundings=SurroundingsMeta(markers=markers)))
    assert figure is not None
    figure.draw_without_rendering()
    for axis in figure.axes:
        port, starboard = (
            text.get_window_extent() for text in axis.texts if text.get_text().endswith("_tool")
        )
        assert not port.overlaps(starboard)


def test_obstacles_stand_in_the_figure_of_the_path(record: Record) -> None:
    around = record.meta.surroundings.model_copy(update={"obstacles": (BALL, PILE)})
    figure = figure_path(
        replace(record, meta=record.meta.model_copy(update={"surroundings": around}))
    )
    assert figure is not None
    for axis in figure.axes:
        assert len(axis.patches) == 2
        assert {"ball", "pile"} <= {text.get_text() for text in axis.texts}
