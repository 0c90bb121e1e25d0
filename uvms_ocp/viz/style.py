"""Style of all figures: settings of Matplotlib, figures that pyplot does not show, and their files.

A figure is made in this style, or, with ``fig`` or ``ax``, drawn into a figure of the caller's with
the caller's fonts, sizes and papers. Colours are in `uvms_ocp.viz.colours`.
"""

from __future__ import annotations

import warnings
from base64 import b64encode
from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from io import BytesIO
from pathlib import Path
from types import MappingProxyType
from typing import Any, ParamSpec, TypeAlias, TypeVar, cast

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backend_bases import RendererBase
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure, SubFigure
from matplotlib.style import context

from uvms_ocp.checks import checked
from uvms_ocp.errors import InvalidInput, short
from uvms_ocp.record.output import as_output_errors
from uvms_ocp.viz.contrast import artists_of, make_legible

P = ParamSpec("P")
R = TypeVar("R")

DPI = 180
"""[1/in] Dots of a figure as a picture."""
_FONT = 8.5
"""[points] Size of text in `figures.mplstyle`, for which all other sizes are written."""
SETTINGS: list[Any] = [
    "default",
    Path(__file__).with_name("figures.mplstyle"),
    {
        "text.parse_math": False,  # names are no formulas
        "pdf.fonttype": 42,  # letters that can be searched and edited
        "svg.fonttype": "none",
    },
]
"""All of Matplotlib's settings: those of the caller's style would make some of ours unreadable."""
_WRITING: dict[str, Any] = {".png": {"pil_kwargs": {"compress_level": 1}}}
"""Options of files by suffix: PNG in a third of the time, a sixth larger."""

Canvas: TypeAlias = Figure | SubFigure | None
"""A figure of the caller's, or a part of one, to draw on; `None` for a figure of our own."""
Panels: TypeAlias = Any
"""Axes of the caller's, or several: a sequence, or an array as ``matplotlib.pyplot.subplots``
gives.
"""


def styled(draw: Callable[P, R]) -> Callable[P, R]:
    """Check the arguments of `draw`, and run it under this module's settings, after which the
    caller's are back.

    On a figure of the caller's, given as ``fig`` or by its ``ax``, it runs under the caller's
    settings. The returned function raises `InvalidInput` for an ``ax`` that is none.
    """

    @wraps(draw)
    def wrapper(*args: P.args, **kwargs: P.kwargs) -> R:
        ax = kwargs.get("ax")
        canvas = cast(Canvas, kwargs.get("fig"))
        if ax is not None and canvas is None:
            canvas = axes_list(ax)[0].figure
        if canvas is None:
            settings = SETTINGS
            former_artists = set()
        else:
            settings = []
            former_artists = set(artists_of(canvas))
        with context(settings):
            figure: Any = draw(*args, **kwargs)
            if figure is not None:
                make_legible(figure, former_artists)
        if canvas is None or figure is None:
            return figure
        return figure.figure

    return checked(wrapper)


def axes_list(ax: Panels) -> list[Axes]:
    """Return all axes in a list. Raises `InvalidInput` where something else is among them."""
    axes = list(np.ravel(np.array(ax, dtype=object)))
    if not axes or not all(isinstance(axis, Axes) for axis in axes):
        raise InvalidInput(f"ax = {short(ax)}; give an Axes of Matplotlib, or several")
    return axes


def by_name(draws: Sequence[Callable[..., R]]) -> Mapping[str, Callable[..., R]]:
    """Return functions ``figure_NAME`` by their names."""
    return MappingProxyType({draw.__name__.removeprefix("figure_"): draw for draw in draws})


class RecordFigure(Figure):
    """A Matplotlib figure that no pyplot window manager knows, in this style alone; notebooks show
    it as PNG.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(dpi=DPI, layout="constrained", **options)
        FigureCanvasAgg(self)

    def draw(self, renderer: RendererBase) -> None:
        """Draw the figure in this style, which the labels of ticks, made only now, need too; letters
        that the font does not have become boxes.
        """
        with context(SETTINGS), warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="Glyph .* missing from")
            super().draw(renderer)

    def savefig(self, *args: Any, **options: Any) -> None:
        """Write a file as ``matplotlib.figure.Figure.savefig`` does, without the settings of the
        caller's style for files.
        """
        with context(SETTINGS):
            super().savefig(*args, **options)

    def _repr_png_(self) -> bytes:
        return png_of(self)


class Figures(tuple[Figure, ...]):
    """Several figures; notebooks show them one below the other."""

    def _repr_html_(self) -> str:
        html = ""
        for figure in self:
            picture = b64encode(png_of(figure)).decode("ascii")
            html += f'<img src="data:image/png;base64,{picture}" style="max-width:100%"><br>'
        return html


def png_of(figure: Figure, dpi: int = DPI) -> bytes:
    """Return the figure as a PNG file, of so many dots per inch."""
    buffer = BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi)
    return buffer.getvalue()


def save_figure(figure: Figure, path: Path) -> Path:
    """Write a PNG, PDF or SVG, as its name ends, and the folders that it needs; returns its path.
    Raises `OutputError`.
    """
    engine = figure.get_layout_engine()
    options = _WRITING.get(path.suffix.lower(), {})
    try:
        with as_output_errors(path), context(SETTINGS):
            path.parent.mkdir(parents=True, exist_ok=True)
            # Left to find the places of artists itself, Matplotlib draws all of it once more.
            if engine is not None:
                engine.execute(figure)
            figure.set_layout_engine(None)
            figure.savefig(path, dpi=DPI, **options)
    finally:
        figure.set_layout_engine(engine)
    return path


def points(size: float) -> float:
    """Return a size of letters [points], scaled as the style in use scales its text."""
    return size * mpl.rcParams["font.size"] / _FONT
