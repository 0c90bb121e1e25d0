"""One look for all figures: colours that colour-blind readers can tell apart, phase bands, marks of
faults, no pyplot.

A figure is one of our own, drawn wholly in this look, or, with ``fig`` or ``ax``, part of one of
the caller's, with the caller's fonts, sizes and papers.
"""

from __future__ import annotations

import warnings
from base64 import b64encode
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import wraps
from io import BytesIO
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal, ParamSpec, TypeAlias, TypeVar, cast

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backend_bases import RendererBase
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb, to_rgba
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D
from matplotlib.style import context
from matplotlib.text import Text
from matplotlib.ticker import LogFormatterSciNotation

from uvms_ocp.checks import checked
from uvms_ocp.errors import InvalidInput, plain_line, short
from uvms_ocp.record.output import as_output_errors
from uvms_ocp.record.record import Record
from uvms_ocp.types import Range
from uvms_ocp.viz.series import PhaseSpan, axis_label, fault_spans, phase_spans

P = ParamSpec("P")
R = TypeVar("R")

DPI = 180
WIDTH = 7.2
"""[in] Width of two columns of a journal page."""
NARROW = 5.0
"""[in] Width below which views stand one below the other."""
VIEWS = {"from above": (0, 1), "from the side": (0, 2)}
"""Axes of W to the right and upwards in `abreast`."""
_WIDTHS = {"page": WIDTH, "column": 3.5}

Width: TypeAlias = Literal["page", "column"] | Annotated[float, Range(1.0, 100.0)]
"""Width of a figure that is not the caller's: of a page or a column of a journal, or a number
[in].
"""
Given: TypeAlias = Figure | SubFigure | None
"""A figure of the caller's, or a part of one, to draw on."""
Page: TypeAlias = tuple[Given, Width]
"""Where to draw: on a figure of the caller's, or on a page of a width."""
Panels: TypeAlias = Any
"""Axes of the caller's, or several: a sequence, or an array as ``matplotlib.pyplot.subplots``
gives.
"""

LINES = ("#0072B2", "#D55E00", "#009E73", "#E69F00", "#CC79A7", "#56B4E9", "#000000")
"""Colours of lines [Okabe2008], without the yellow that vanishes on white."""
BLUE, VERMILLION, GREEN, ORANGE, PINK, SKY, BLACK = LINES
AXES_XYZ = (VERMILLION, GREEN, BLUE)
THRESHOLD = "#555555"
FADED = "#AEB4B9"
DASHES: tuple[Any, ...] = ("-", (0, (5, 1.5)), (0, (4, 1.5, 1, 1.5)))
"""Dashes of lines, one after the other where the colours come again."""
_BANDS = ((BLUE, 0.09), (ORANGE, 0.12), (GREEN, 0.1), (PINK, 0.16), ("#808080", 0.12))
"""Colours of phases and how much they cover, on light and dark paper."""

# Contrast to the paper, as WCAG 2 defines it.
_TEXT_CONTRAST = 4.5  # of texts, at least
_LINE_CONTRAST = 3.0  # of lines on dark paper, at least
_MIDDLE = 0.18  # luminance that is as far from black as from white
_GREY = 0.06  # by which the parts of a grey differ at most
_TO_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])

# Letters and legends.
_FONT = 8.5  # [points] of the style, that sizes are given for
_TALLEST = 9  # entries of a column of a legend
_HANDLE = 5  # letters that the line before a legend's text takes
_SEPARATORS = "_./- "  # of the parts of a name
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")

# Names of phases and moments above a panel.
_FEW = 12  # stays in phases that are each named, however short
_MANY = 60  # stays in phases that no lines part any more: they were a grey page
_LEFT = 0.775  # share of a figure's width that one panel has before labels are laid out
_LETTER = 0.055  # [in] mean width of a letter in a phase's label
_ABOVE_PHASES = 13  # [points] height of the names of phases
_LINE = 8  # [points] height of the name of a moment
_LONGEST = 40  # letters of the name of a moment
CURVE = "curve of a record"
_PHASE = "phase of a record"
"""What artists are called on axes of the caller's, where more than one record is drawn."""
_IN_TIME: dict[str, Any] = {"xycoords": ("data", "axes fraction")}
"""Coordinates of a note: a time, and a share of the panel's height."""

_STYLE: list[Any] = [
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


class RecordFigure(Figure):
    """A Matplotlib figure that no pyplot window manager knows, in this style alone; notebooks show
    it as PNG.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(dpi=DPI, layout="constrained", **options)
        FigureCanvasAgg(self)

    def draw(self, renderer: RendererBase) -> None:
        """Draw it, when ticks get their labels; letters that the font has not become boxes."""
        with context(_STYLE), warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="Glyph .* missing from")
            super().draw(renderer)

    def savefig(self, *args: Any, **options: Any) -> None:
        """Write a file as ``matplotlib.figure.Figure.savefig`` does, whatever the caller's style
        says of files.
        """
        with context(_STYLE):
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


def styled(draw: Callable[P, R]) -> Callable[P, R]:
    """Check the arguments of `draw`, and run it under this module's settings, after which the
    caller's are back.

    On a figure of the caller's, given as ``fig`` or by its ``ax``, it runs under the caller's
    settings. What comes of it raises `InvalidInput` for an ``ax`` that is none.
    """

    @wraps(draw)
    def wrapper(*args: P.args, **kwargs: P.kwargs) -> R:
        ax = kwargs.get("ax")
        canvas = cast(Given, kwargs.get("fig"))
        if ax is not None and canvas is None:
            canvas = _flat(ax)[0].figure
        if canvas is None:
            settings = _STYLE
            former_artists = set()
        else:
            settings = []
            former_artists = set(_artists(canvas))
        with context(settings):
            figure: Any = draw(*args, **kwargs)
            if figure is not None:
                _make_legible(figure, former_artists)
        if canvas is None or figure is None:
            return figure
        return figure.figure

    return checked(wrapper)


def by_name(draws: Sequence[Callable[..., R]]) -> Mapping[str, Callable[..., R]]:
    """Return functions ``figure_NAME`` by their names."""
    return MappingProxyType({draw.__name__.removeprefix("figure_"): draw for draw in draws})


def _make_legible(figure: Figure, former_artists: set[Artist]) -> None:
    """Turn texts, and lines on dark paper, towards black or white as far as they need; names are no
    formulas.
    """
    sheet = _on(to_rgba(figure.figure.get_facecolor()), np.ones(3))
    artists = {artist for artist in _artists(figure) if isinstance(artist, Text | Line2D)}
    for artist in artists - former_artists:
        if artist.axes is None:
            paper = sheet
        else:
            paper = _on(to_rgba(artist.axes.get_facecolor()), sheet)
        if isinstance(artist, Text):
            papers = (paper,) if artist.get_bbox_patch() else (sheet, paper)
            artist.set_parse_math(False)
            artist.set_color(legible(artist.get_color(), papers, _TEXT_CONTRAST))
        elif _luminance(paper) < _MIDDLE:
            artist.set_color(legible(artist.get_color(), (paper,), _LINE_CONTRAST))


def _artists(parent: Artist) -> Iterator[Artist]:
    """Yield all artists within it but the ticks of axes, which nobody has asked for yet."""
    if isinstance(parent, Axis):
        children = [parent.label]
    else:
        children = parent.get_children()
    for child in children:
        yield child
        yield from _artists(child)


def _on(color: tuple[float, float, float, float], paper: np.ndarray) -> np.ndarray:
    """Return the colour (3,) of a colour that lets paper (3,) through."""
    *rgb, opacity = color
    return opacity * np.array(rgb) + (1.0 - opacity) * paper


def _luminance(rgb: np.ndarray) -> float:
    """Return the relative luminance [-] of a colour in sRGB (3,), as WCAG 2 defines it."""
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    return float(linear @ _TO_LUMINANCE)


def contrast(color: np.ndarray, paper: np.ndarray) -> float:
    """Return the contrast of two colours in sRGB (3,), from 1 to 21, as WCAG 2 defines it."""
    dark, light = sorted((_luminance(color), _luminance(paper)))
    return (light + 0.05) / (dark + 0.05)


def legible(color: Any, papers: Sequence[np.ndarray], lowest_contrast: float) -> np.ndarray:
    """Return the colour (3,), or the nearest towards black or white that has the lowest contrast
    [-] to papers in sRGB (3,), or more.

    A grey of too little contrast becomes as light as it is dark first, since what is fainter has to
    stay so.
    """
    rgb = np.array(to_rgb(color))
    black_or_white = np.full(3, float(_luminance(papers[0]) < _MIDDLE))
    shades = [rgb]
    if np.ptp(rgb) < _GREY:
        shades.append(1.0 - rgb)
    for share in np.linspace(0.05, 0.95, 19):
        shades.append((1.0 - share) * rgb + share * black_or_white)
    for shade in shades:
        if min(contrast(shade, paper) for paper in papers) >= lowest_contrast:
            return shade
    return black_or_white


def points(size: float) -> float:
    """Return a size of letters [points], in proportion to the size that the style in use gives
    text.
    """
    return size * mpl.rcParams["font.size"] / _FONT


def inches(figure: Figure) -> float:
    """Return the width [in] of a figure, or of a part of one."""
    return float(figure.bbox.width / figure.dpi)


def titled(height: float, title: str, fig: Given = None, width: Width = "page") -> Figure:
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


def line_style(k: int) -> dict[str, Any]:
    """Return the colour of the k-th line of many, and dashes where the colours come again."""
    n_before, color = divmod(k, len(LINES))
    return {"color": LINES[color], "ls": DASHES[n_before % len(DASHES)]}


def note(axis: Axes, text: str, place: Any, offset: tuple[float, float], **look: Any) -> None:
    """Write a text at an offset [points] from a place on the axes; look: as of `Axes.annotate`."""
    axis.annotate(text, place, xytext=offset, textcoords="offset points", **look)


def stacked(
    n_rows: int, height: float, title: str, fig: Given = None, width: Width = "page"
) -> tuple[Figure, list[Axes]]:
    """Add `n_rows` panels over one time axis; `height` [in] of one panel."""
    figure = titled(height * n_rows + 0.55, title, fig, width)
    axes = figure.subplots(n_rows, 1, sharex=True, squeeze=False)[:, 0]
    axes[-1].set_xlabel(axis_label("time", "t"))
    return figure, list(axes)


def _flat(ax: Panels) -> list[Axes]:
    """Return all axes in a list. Raises `InvalidInput` where something else is among them."""
    axes = list(np.ravel(np.array(ax, dtype=object)))
    if not axes or not all(isinstance(axis, Axes) for axis in axes):
        raise InvalidInput(f"ax = {short(ax)}; give an Axes of Matplotlib, or several")
    return axes


def panels(ax: Panels, n: int, fig: Given) -> tuple[Figure, list[Axes]]:
    """Return the caller's axes and their figure. Raises `InvalidInput` where there are not n, or
    there is a figure besides.
    """
    axes = _flat(ax)
    if len(axes) != n or fig is not None:
        fig_text = " and fig" if fig is not None else ""
        raise InvalidInput(
            f"ax of {len(axes)} axes{fig_text} for {n} names; give one for each name, or fig alone"
        )
    for axis in axes:
        axis.set_xlabel(axis_label("time", "t"))
    return cast(Figure, axes[0].figure), axes


def label_text(name: str, longest: int = 32) -> str:
    """Return a name as a label of at most so many letters, and not of the kind that Matplotlib
    keeps out of legends.
    """
    label = plain_line(name, longest)
    if label.startswith("_"):
        return f" {label}"
    return label


def label_texts(names: Sequence[str], longest: int = 32) -> list[str]:
    """Return labels of at most so many letters that differ where names do: without the beginning
    that all names share, or with a gap in their middle, where they are too long; in full where
    nothing else tells them apart.
    """
    begin = _shared_beginning(names)
    candidates = (
        [label_text(name, longest) for name in names],
        [label_text(name[begin:], longest) for name in names],
        [_without_middle(name[begin:], longest) for name in names],
    )
    for labels in candidates:
        if len(set(labels)) == len(set(names)):
            return labels
    return [label_text(name, len(name)) for name in names]


def _shared_beginning(names: Sequence[str]) -> int:
    """Return how many letters all names begin with that are whole words, with what parts them."""
    shared = 0
    for k, letters in enumerate(zip(*names, strict=False)):
        if len(set(letters)) > 1:
            break
        if letters[0] in _SEPARATORS:
            shared = k + 1
    return shared


def _without_middle(name: str, longest: int) -> str:
    """Return both ends of a name as a label of at most so many letters."""
    if len(name) <= longest:
        return label_text(name, longest)
    n_tail = (longest - 1) // 2
    n_head = longest - 1 - n_tail
    return label_text(f"{name[:n_head]}…{name[len(name) - n_tail :]}", longest)


def save_figure(figure: Figure, path: Path) -> Path:
    """Write a PNG, PDF or SVG, as its name ends, and the folders that it needs; returns its path.
    Raises `OutputError`.
    """
    engine = figure.get_layout_engine()
    options = _WRITING.get(path.suffix.lower(), {})
    try:
        with as_output_errors(path), context(_STYLE):
            path.parent.mkdir(parents=True, exist_ok=True)
            # Left to find the places of artists itself, Matplotlib draws all of it once more.
            if engine is not None:
                engine.execute(figure)
            figure.set_layout_engine(None)
            figure.savefig(path, dpi=DPI, **options)
    finally:
        figure.set_layout_engine(engine)
    return path


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


def n_curves(axis: Axes) -> int:
    """Count the curves of records that a panel of the caller's has already."""
    return sum(line.get_gid() == CURVE for line in axis.get_lines())


def _has_phases(axis: Axes) -> bool:
    return any(patch.get_gid() == _PHASE for patch in axis.patches)


def shade_phases(
    axes: Sequence[Axes], spans: Sequence[PhaseSpan], *, named: bool = True, letters_beside: int = 0
) -> None:
    """Colour the phases behind every panel and name them above the first; letters_beside: number of
    them next to panels, but for legends.

    Panels that show the phases of another record already keep those, and become as long as both.
    """
    if any(_has_phases(axis) for axis in axes):
        for axis in axes:
            begin, end = axis.get_xlim()
            axis.set_xlim(min(begin, spans[0].start), max(end, spans[-1].end))
        return
    for axis in axes:
        for span in spans:
            band = _BANDS[span.index % len(_BANDS)]
            axis.axvspan(span.start, span.end, color=band, lw=0, zorder=-2, gid=_PHASE)
        if len(spans) <= _MANY:
            for span in spans[1:]:
                axis.axvline(span.start, color="#9AA3AB", lw=0.6, zorder=-1)
        axis.set_xlim(spans[0].start, spans[-1].end)
    if not named:
        return
    # Share of the figure, with what is beside the panel, before all is laid out.
    figure_share = axes[0].get_position().width / _LEFT
    letters_beside += _letters_of_legends(axes)
    width = 0.88 * inches(axes[0].figure) * figure_share - points(_LETTER) * letters_beside
    _name_phases(axes[0], spans, width)


def _letters_of_legends(axes: Sequence[Axes]) -> int:
    """Return the letters that the widest entry of the legends beside panels takes, with its line."""
    widest = 0
    for axis in axes:
        legend = axis.get_legend()
        if legend:
            for text in legend.get_texts():
                widest = max(widest, len(text.get_text()) + _HANDLE)
    return widest


def mark_phase_starts(
    axes: Sequence[Axes], spans: Sequence[PhaseSpan], color: str, line: int
) -> None:
    """Mark in a run's colour where its phases begin, named on a line of its own above the first
    panel; line: how many of other runs are below it.
    """
    for axis in axes:
        for span in spans[1:]:
            axis.axvline(span.start, color=color, lw=0.7, ls=(0, (1, 2)), alpha=0.8, zorder=-1)
    length = spans[-1].end - spans[0].start
    look = {"ha": "left", "va": "bottom", "fontsize": points(6.5), "color": color}
    for span in spans:
        if len(spans) <= _FEW or span.end - span.start > length / _FEW:
            name = plain_line(span.name, _LONGEST)
            note(axes[0], name, (span.start, 1.0), (1, 3 + _LINE * line), **_IN_TIME, **look)


def _name_phases(axis: Axes, spans: Sequence[PhaseSpan], width: float) -> None:
    """Write full labels where they fit, none where no letter does; `width` [in] of the panel."""
    scale = width / (spans[-1].end - spans[0].start)
    for span in spans:
        room = scale * (span.end - span.start) / points(_LETTER)
        if room < 2.0 and len(spans) > _FEW:
            continue
        if len(span.label) + 1 < room:
            text = span.label
        else:
            text = plain_line(span.name, max(2, int(room)))
        middle = (span.start + span.end) / 2
        look = {"ha": "center", "va": "bottom", "fontsize": points(7.5), "color": "#333333"}
        note(axis, text, (middle, 1.0), (0, 3), **_IN_TIME, **look)


def logarithmic(axis: Axes) -> None:
    """Make the upward axis logarithmic; what is not positive is left out."""
    axis.set_yscale("log", nonpositive="mask")
    axis.yaxis.set_major_formatter(_PlainPowers())
    axis.yaxis.set_minor_formatter(_PlainPowers(labelOnlyBase=False))


def threshold(axis: Axes, value: float, text: str, place: float = 0.0) -> None:
    """Draw a dashed line at `value` [unit of the axis], with its meaning written on it at that
    share of its length.
    """
    axis.axhline(value, color=THRESHOLD, lw=0.9, ls=(0, (5, 3)), zorder=1.5)
    # Over curves that run through the text.
    paper = {"facecolor": axis.get_facecolor(), "alpha": 0.8, "lw": 0, "pad": 0.6}
    look = {"ha": "left", "va": "bottom", "fontsize": points(7), "color": THRESHOLD, "bbox": paper}
    note(axis, text, (place, value), (4, 2), xycoords=("axes fraction", "data"), **look)


def mark_time(
    axes: Sequence[Axes], record: Record, *, named: bool = True, letters_beside: int = 0
) -> None:
    """Mark phases and faults on every panel, named on the first unless told otherwise;
    letters_beside: as of `shade_phases`.
    """
    shade_phases(axes, phase_spans(record), named=named, letters_beside=letters_beside)
    names_by_start: dict[float, list[str]] = {}
    for fault in fault_spans(record):
        names_by_start.setdefault(fault.start, []).append(fault.name)
        for axis in axes:
            axis.axvline(fault.start, color=VERMILLION, lw=0.9, ls=(0, (4, 2)), zorder=1.4)
            if fault.ended:
                axis.axvline(fault.end, color=VERMILLION, lw=0.9, ls=(0, (1, 2)), zorder=1.4)
    if not named:
        return
    for line, (start, names) in enumerate(names_by_start.items()):
        _name_moment(axes[0], start, plain_line(", ".join(names), _LONGEST), line)


def space_above(record: Record) -> float:
    """Return the height [points] that the names of phases and faults take above a panel."""
    return _ABOVE_PHASES + _LINE * len({fault.start for fault in fault_spans(record)})


def _name_moment(axis: Axes, start: float, text: str, line: int) -> None:
    """Name a moment above the names of the phases, from its onset on or up to it; each a line
    higher than the one before.
    """
    begin, end = axis.get_xlim()
    height = _ABOVE_PHASES + _LINE * line
    if start - begin > 0.5 * (end - begin):
        offset = (-3, height)
        side = "right"
    else:
        offset = (3, height)
        side = "left"
    look = {"ha": side, "va": "bottom", "fontsize": points(6.5), "color": VERMILLION}
    note(axis, text, (start, 1.0), offset, **_IN_TIME, **look)
