"""Layout of figures: pages of a width, panels on them, scales of axes, and legends beside them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal, TypeAlias, cast

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogFormatterSciNotation

from uvms_ocp.errors import InvalidInput
from uvms_ocp.types import Range
from uvms_ocp.viz.series import axis_label
from uvms_ocp.viz.style import Canvas, Panels, RecordFigure, axes_list, points

WIDTH = 7.2
"""[in] Width of two columns of a journal page."""
NARROW = 5.0
"""[in] Width below which views stand one below the other."""
VIEWS = {"from above": (0, 1), "from the side": (0, 2)}
"""Axes of W to the right and upwards in `abreast`, by the title of a view."""
_WIDTHS = {"page": WIDTH, "column": 3.5}  # [in]
_TALLEST = 9  # entries of a column of a legend
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")

Width: TypeAlias = Literal["page", "column"] | Annotated[float, Range(1.0, 100.0)]
"""Width of a figure that is not the caller's: of a page or a column of a journal, or a number
[in].
"""
Page: TypeAlias = tuple[Canvas, Width]
"""Where to draw: on a figure of the caller's, or on a page of a width."""


def titled(height: float, title: str, fig: Canvas = None, width: Width = "page") -> Figure:
    """Return an empty figure of a height [in], on a page with its title on the left; or the
    caller's, without.

    A caller's that is empty too gets the constrained layout, unless it has an engine or margins of
    its own.
    """
    if fig is not None:
        page = fig.figure
        has_margins = vars(page.subplotpars) != vars(type(page.subplotpars)())
        if page.get_layout_engine() is None and not page.axes and not has_margins:
            page.set_layout_engine("constrained")
        return cast(Figure, fig)
    if isinstance(width, str):
        width = _WIDTHS[width]
    figure = RecordFigure(figsize=(width, height))
    if title and inches(figure) > NARROW:
        figure.suptitle(title, fontsize=points(10), fontweight="bold", x=0.01, ha="left")
    return figure


def inches(figure: Figure) -> float:
    """Return the width [in] of a figure, or of a part of one."""
    return float(figure.bbox.width / figure.dpi)


def stacked(
    n_rows: int, height: float, title: str, fig: Canvas = None, width: Width = "page"
) -> tuple[Figure, list[Axes]]:
    """Return a figure with panels below each other over one time axis; height [in] of one panel."""
    figure = titled(height * n_rows + 0.55, title, fig, width)
    axes = figure.subplots(n_rows, 1, sharex=True, squeeze=False)[:, 0]
    axes[-1].set_xlabel(axis_label("time", "t"))
    return figure, list(axes)


def abreast(figure: Figure) -> list[Axes]:
    """Add the two `VIEWS` beside each other, in a column one below the other; of one scale in both
    directions.
    """
    is_wide = inches(figure) > NARROW
    if not is_wide and isinstance(figure, RecordFigure):
        figure.set_figheight(1.6 * figure.get_figheight())
    n_rows = 1 if is_wide else 2
    axes = list(figure.subplots(n_rows, 2 // n_rows))
    for axis, (title, (right, up)) in zip(axes, VIEWS.items(), strict=True):
        axis.set_xlabel(axis_label("xyz"[right], "q", "position"))
        axis.set_ylabel(axis_label("xyz"[up], "q", "position"))
        axis.set_title(title)
        axis.set_aspect("equal", adjustable="datalim")
    return axes


def panels(ax: Panels, n: int, fig: Canvas) -> tuple[Figure, list[Axes]]:
    """Return the caller's axes and their figure. Raises `InvalidInput` where there are not n, or
    there is a figure besides.
    """
    axes = axes_list(ax)
    if len(axes) != n or fig is not None:
        fig_text = " and fig" if fig is not None else ""
        raise InvalidInput(
            f"ax of {len(axes)} axes{fig_text} for {n} names; give one for each name, or fig alone"
        )
    for axis in axes:
        axis.set_xlabel(axis_label("time", "t"))
    return cast(Figure, axes[0].figure), axes


def heading_legend(figure: Figure, handles: Sequence[Line2D]) -> None:
    """Add one legend for all panels, on the line of the title."""
    figure.legend(handles=handles, loc="outside upper right", ncols=len(handles))


def legend_beside(axis: Axes) -> None:
    """Add a legend, one entry below the other, to the right of the panel, where it covers nothing;
    none where nothing is named.
    """
    n = len(axis.get_legend_handles_labels()[0])
    if not n:
        return
    axis.legend(
        loc="center left",
        bbox_to_anchor=(1.0, 0.5),
        ncols=1 + (n - 1) // _TALLEST,
        fontsize=points(6.5),
    )


def logarithmic(axis: Axes) -> None:
    """Make the upward axis logarithmic; what is not positive is left out."""
    axis.set_yscale("log", nonpositive="mask")
    axis.yaxis.set_major_formatter(_PlainPowers())
    axis.yaxis.set_minor_formatter(_PlainPowers(labelOnlyBase=False))


class _PlainPowers(LogFormatterSciNotation):
    """Labels of a logarithmic axis in letters, 10⁻³ or 4·10⁻³, as formulas are off."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        if not super().__call__(x, pos):
            return ""
        factor, _, exponent = f"{x:.0e}".partition("e")
        power = "10" + str(int(exponent)).translate(_RAISED)
        if factor == "1":
            return power
        return f"{factor}·{power}"
