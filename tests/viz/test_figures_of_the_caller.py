"""Figures as parts of the caller's: on their axes and figures, in their style, as wide as a column,
and legible on any paper.
"""

from __future__ import annotations

import inspect
import itertools
from pathlib import Path

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.style import context
from matplotlib.text import Text

from uvms_ocp import viz
from uvms_ocp.errors import InvalidInput
from uvms_ocp.record.record import Record
from uvms_ocp.viz.contrast import contrast, legible
from uvms_ocp.viz.run_figures import FIGURES, write_figure
from uvms_ocp.viz.style import DPI

STYLES = ["default", "dark_background", "seaborn-v0_8-darkgrid"]
OPTIONAL = {"fig": None, "width": "page"}


def _rgb(color: object, paper: np.ndarray) -> np.ndarray:
    *rgb, alpha = to_rgba(color)
    return alpha * np.array(rgb) + (1.0 - alpha) * paper


def _faint(figure: Figure) -> list[str]:
    """Texts whose contrast to what they stand on is below 4.5."""
    sheet = _rgb(figure.get_facecolor(), np.ones(3))
    problems = []
    for text in figure.findobj(Text):
        inside = text.axes is not None and text.get_bbox_patch() is not None
        paper = _rgb(text.axes.get_facecolor(), sheet) if inside else sheet
        if text.get_visible() and contrast(_rgb(text.get_color(), paper), paper) < 4.5:
            problems.append(text.get_text())
    return problems


def _page() -> Figure:
    """A figure as a caller makes it: in the style in force."""
    figure = Figure(figsize=(7.0, 6.0))
    FigureCanvasAgg(figure)
    return figure


def test_every_figure_takes_a_figure_of_the_callers_and_a_width() -> None:
    names = [name for name in dir(viz) if name.startswith("figure_")]
    assert len(names) > 20
    for name in names:
        parameters = inspect.signature(getattr(viz, name)).parameters
        assert {key: parameters[key].default for key in OPTIONAL} == OPTIONAL, name


@pytest.mark.sampled
@pytest.mark.parametrize("look", STYLES)
def test_every_text_can_be_read_on_the_callers_paper(record: Record, look: str) -> None:
    with context(look):
        for draw in FIGURES.values():
            page = _page()
            left, right = page.subfigures(1, 2)
            assert draw(record, fig=right) is page
            assert right.axes or right.subfigs
            assert not left.axes
            assert _faint(page) == [], draw.__name__


@pytest.mark.slow
def test_every_text_of_our_own_figures_can_be_read(record: Record) -> None:
    assert [word for figure in viz.plot(record) for word in _faint(figure)] == []


@pytest.mark.sampled
@pytest.mark.parametrize("name", ["joints", "path", "tracking", "health"])
def test_nothing_of_a_column_leaves_the_sheet(record: Record, name: str) -> None:
    figure = FIGURES[name](record, width="column")
    assert figure is not None
    figure.set_dpi(50)
    figure.canvas.draw()
    drawn = figure.get_tightbbox()
    assert drawn.x0 > -0.05
    assert drawn.x1 < 3.55


@pytest.mark.sampled
@pytest.mark.parametrize("width", ["page", "column"])
@pytest.mark.parametrize(
    "name", ["efforts", "activations", "estimate", "altitude", "health", "velocities"]
)
def test_names_of_phases_stand_apart(record: Record, name: str, width: str) -> None:
    """Beside a legend there is less room, in a column above all."""
    phases = [
        phase.model_copy(update={"title": f"{phase.title} and back"})
        for phase in record.meta.phases
    ]
    figure = FIGURES[name](
        Record(series=record.series, meta=record.meta.model_copy(update={"phases": phases})),
        width=width,
    )
    assert figure is not None
    figure.canvas.draw()
    labels = {f"{phase.name} {phase.title}" for phase in phases} | {phase.name for phase in phases}
    for axis in figure.axes:
        boxes = sorted(
            (t.get_window_extent() for t in axis.texts if t.get_text() in labels),
            key=lambda box: box.x0,
        )
        assert all(left.x1 < right.x0 for left, right in itertools.pairwise(boxes))


def test_the_line_of_an_even_altitude_is_inside_its_panel(record: Record) -> None:
    """It ran along the upper edge."""
    even = np.linspace(2.667, 2.67, len(record))[:, None]
    changed = {
        **record.series,
        "quantities": np.where(np.isfinite(record["quantities"]), even, np.nan),
    }
    figure = FIGURES["altitude"](
        Record(series=changed, meta=record.meta.model_copy(update={"thresholds": ()}))
    )
    assert figure is not None
    assert figure.axes[0].get_ylim()[1] > 1.03 * 2.67


@pytest.mark.parametrize(("width", "inches"), [("page", 7.2), ("column", 3.5), (3.3, 3.3)])
def test_figures_are_as_wide_as_asked_for(
    record: Record, width: float | str, inches: float
) -> None:
    figure = viz.plot(record, "q.z", "thrust", width=width)
    assert figure.get_figwidth() == pytest.approx(inches)


def test_columns_are_written(record: Record, tmp_path: Path) -> None:
    path = write_figure(record, "errors", tmp_path, width="column")
    assert path is not None
    assert imread(path).shape[1] == int(3.5 * DPI)


def test_names_are_drawn_on_the_axes_of_the_caller(record: Record) -> None:
    page = _page()
    axes = page.subplots(2, 2)
    assert (
        viz.plot(
            record, "PC.position_error", "q.z", "thrust", ax=[*axes[:, 1].tolist(), axes[0, 0]]
        )
        is page
    )
    np.testing.assert_array_equal(axes[1, 1].get_lines()[0].get_ydata(), record["q"][:, 2])
    assert [axis.get_ylabel().split()[0] for axis in axes.ravel() if axis.lines] == [
        "thrust",
        "PC.position_error",
        "q.z",
    ]
    viz.plot(record, "q.z", ax=axes[1, 0])
    assert len(page.axes) == 4


@pytest.mark.parametrize("look", STYLES)
def test_axes_of_the_caller_keep_their_style(record: Record, look: str) -> None:
    with context([look, {"font.size": 17.0}]):
        page = _page()
        viz.plot(record, "PC.position_error", ax=page.subplots())
        label = next(text for text in page.axes[0].texts if text.get_text() == "A way point")
        assert label.get_fontsize() == pytest.approx(2.0 * 7.5)
        assert page.axes[0].yaxis.label.get_fontsize() == 17.0
        assert _faint(page) == []


def _layout(page: Figure) -> tuple[object, list[tuple[float, ...]]]:
    """The engine, and where the axes stand once they are drawn."""
    page.canvas.draw()
    return page.get_layout_engine(), [axis.get_position().bounds for axis in page.axes]


@pytest.mark.sampled
@pytest.mark.parametrize("layout", [None, "none", "tight", "constrained"])
def test_the_layout_of_the_callers_axes_stays_theirs(record: Record, layout: str | None) -> None:
    page = Figure(figsize=(7.0, 6.0), layout=layout)
    FigureCanvasAgg(page)
    first, second = page.subplots(2, 1)
    if layout in (None, "none"):
        page.subplots_adjust(left=0.3)
    engine, places = _layout(page)
    viz.plot(record, "q.z", ax=second)
    assert page.get_layout_engine() is engine
    if engine is None:
        assert _layout(page) == (None, places)
        page.subplots_adjust(left=0.4)
        assert _layout(page)[1][0][0] == pytest.approx(0.4)
        page.colorbar(first.imshow(np.eye(3)), ax=first)
        viz.plot(record, "q.x", ax=second)
        page.tight_layout()


def test_a_figure_of_the_callers_is_laid_out_only_where_nobody_has_begun(record: Record) -> None:
    margins = _page()
    begun = _page()
    empty = _page()
    margins.subplots_adjust(left=0.3)
    left, right = begun.subfigures(1, 2)
    left.add_axes((0.3, 0.3, 0.5, 0.5))
    before = _layout(begun)[1][0]
    viz.plot(record, "q.z", fig=margins)
    viz.figure_path(record, fig=right)
    viz.figure_path(record, fig=empty)
    assert _layout(margins)[0] is None
    assert margins.axes[0].get_position().x0 == pytest.approx(0.3)
    assert _layout(begun)[0] is None
    assert begun.axes[0].get_position().bounds == before
    assert empty.get_layout_engine() is not None


def test_what_is_no_axes_and_another_number_of_them_is_refused(record: Record) -> None:
    page = _page()
    axes = page.subplots(1, 2)
    with pytest.raises(InvalidInput, match="ax of 2 axes for 1 names; give one for each name"):
        viz.plot(record, "q.z", ax=axes)
    with pytest.raises(InvalidInput, match="ax of 2 axes and fig for 2 names"):
        viz.plot(record, "q.z", "thrust", ax=axes, fig=page)
    with pytest.raises(InvalidInput, match="give an Axes of Matplotlib"):
        viz.plot(record, "q.z", ax=page)
    with pytest.raises(InvalidInput, match="give names such as 'q'"):
        viz.plot(record, fig=page)


def test_names_are_no_formulas_on_the_callers_paper(record: Record) -> None:
    page = _page()
    viz.figure_paths({"a$b_1$": np.zeros((3, 3)), "other": np.ones((3, 3))}, fig=page)
    page.canvas.draw()
    assert not any(text.get_parse_math() for legend in page.legends for text in legend.get_texts())


@pytest.mark.parametrize("paper", [np.zeros(3), np.ones(3), np.array([0.16, 0.2, 0.25])])
def test_a_colour_is_changed_as_little_as_it_has_to_be(paper: np.ndarray) -> None:
    """Colours that can be read stay; the others end between themselves and black or white."""
    for color in ("#D55E00", "#333333", "#AEB4B9", "black", "white", "#0072B2"):
        readable = legible(color, (paper,), 4.5)
        assert contrast(readable, paper) >= 4.5
        if contrast(np.array(to_rgba(color)[:3]), paper) >= 4.5:
            np.testing.assert_array_equal(readable, to_rgba(color)[:3])
