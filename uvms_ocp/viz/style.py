"""One look for all figures: colours that colour-blind readers can tell apart, phase bands, marks of faults, no pyplot."""

from __future__ import annotations

import warnings
from base64 import b64encode
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import wraps
from io import BytesIO
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from matplotlib.axes import Axes
from matplotlib.backend_bases import RendererBase
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.style import context
from matplotlib.ticker import LogFormatterSciNotation

from uvms_ocp.checks import checked
from uvms_ocp.errors import plain_line
from uvms_ocp.record.output import as_output_errors
from uvms_ocp.record.record import Record
from uvms_ocp.viz.series import PhaseSpan, axis_label, fault_spans, phase_spans

# One look for all figures: colours that colour-blind readers can tell apart, phase bands, a figure without pyplot.

P = ParamSpec("P")
R = TypeVar("R")

DPI = 180
WIDTH = 7.2  # [in] two columns of a journal page

# [Okabe2008], without the yellow that vanishes on white.
LINES = ("#0072B2", "#D55E00", "#009E73", "#E69F00", "#CC79A7", "#56B4E9", "#000000")
BLUE, VERMILLION, GREEN, ORANGE, PINK, SKY, BLACK = LINES
AXES_XYZ = (VERMILLION, GREEN, BLUE)
THRESHOLD = "#555555"
FADED = "#AEB4B9"
DASHES: tuple[Any, ...] = ("-", (0, (5, 1.5)), (0, (4, 1.5, 1, 1.5)))
_TALLEST = 9  # entries of a column of a legend
_FEW, _MANY = 12, 60  # stays in phases that are each named, however short; and that no lines part, which were a grey page
_LETTER = 0.055  # [in] mean width of a letter in a phase's label
_BANDS = ("#E8F1FA", "#FDF0E1", "#E6F4EC", "#F6EAF2", "#EFEFEF")

_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")

# All of Matplotlib's settings: those of the caller's style would make some of ours unreadable.
_STYLE: list[Any] = [
    "default",
    Path(__file__).with_name("figures.mplstyle"),
    {
        "text.parse_math": False,  # names are no formulas
        "pdf.fonttype": 42,  # letters that can be searched and edited
        "svg.fonttype": "none",
    },
]


class _PlainPowers(LogFormatterSciNotation):
    """Labels of a logarithmic axis in letters, 10⁻³ or 4·10⁻³, as formulas are off."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        if not super().__call__(x, pos):
            return ""
        factor, _, exponent = f"{x:.0e}".partition("e")
        power = "10" + str(int(exponent)).translate(_RAISED)
        return power if factor == "1" else f"{factor}·{power}"


class RecordFigure(Figure):
    """A Matplotlib figure that no pyplot window manager knows, in this style alone; notebooks show it as PNG."""

    def __init__(self, **options: Any) -> None:
        super().__init__(dpi=DPI, layout="constrained", **options)
        FigureCanvasAgg(self)

    def draw(self, renderer: RendererBase) -> None:
        """Ticks get their labels only now; letters that the font has not are drawn as boxes."""
        with context(_STYLE), warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="Glyph .* missing from font")
            super().draw(renderer)

    def savefig(self, *args: Any, **options: Any) -> None:
        """Write a file as `matplotlib.figure.Figure.savefig` does, whatever the caller's style says of files."""
        with context(_STYLE):
            super().savefig(*args, **options)

    def _repr_png_(self) -> bytes:
        return png_of(self)


class Figures(tuple[Figure, ...]):
    """Several figures; notebooks show them one below the other."""

    def _repr_html_(self) -> str:
        pictures = (b64encode(png_of(figure)).decode("ascii") for figure in self)
        return "".join(f'<img src="data:image/png;base64,{picture}" style="max-width:100%"><br>' for picture in pictures)


def png_of(figure: Figure, dpi: int = DPI) -> bytes:
    """The figure as a PNG file, of so many dots per inch."""
    buffer = BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi)
    return buffer.getvalue()


def styled(draw: Callable[P, R]) -> Callable[P, R]:
    """Check the arguments of `draw`, and run it under this module's settings, after which the caller's are back."""

    @wraps(draw)
    def wrapper(*args: P.args, **kwargs: P.kwargs) -> R:
        with context(_STYLE):
            return draw(*args, **kwargs)

    return checked(wrapper)


def titled(height: float, title: str) -> RecordFigure:
    """An empty figure of a height [in], with its title on the left."""
    figure = RecordFigure(figsize=(WIDTH, height))
    figure.suptitle(title, fontsize=10, fontweight="bold", x=0.01, ha="left")
    return figure


def line_style(k: int) -> dict[str, Any]:
    """Colour of the k-th line of many, and dashes where the colours come again."""
    return {"color": LINES[k % len(LINES)], "ls": DASHES[k // len(LINES) % len(DASHES)]}


def note(axis: Axes, text: str, place: Any, offset: tuple[float, float], **look: Any) -> None:
    """Write a text at an offset [points] from a place on the axes; look: as of `Axes.annotate`."""
    axis.annotate(text, place, xytext=offset, textcoords="offset points", **look)


def stacked(n_rows: int, height: float, title: str) -> tuple[RecordFigure, list[Axes]]:
    """`n_rows` panels over one time axis; `height` [in] of one panel."""
    figure = titled(height * n_rows + 0.55, title)
    axes = figure.subplots(n_rows, 1, sharex=True, squeeze=False)[:, 0]
    axes[-1].set_xlabel(axis_label("time", "t"))
    return figure, list(axes)


def label_text(name: str, longest: int = 32) -> str:
    """A name as a label of at most so many letters, and not of the kind that Matplotlib keeps out of legends."""
    label = plain_line(name, longest)
    return f" {label}" if label.startswith("_") else label


def save_figure(figure: Figure, path: Path) -> Path:
    """Write a PNG, PDF or SVG, as its name ends, and the folders that it needs; returns its path. Raises `OutputError`."""
    with as_output_errors(path), _laid_out(figure):
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=DPI)
    return path


@contextmanager
def _laid_out(figure: Figure) -> Iterator[None]:
    """With every artist in its place: left to find them itself, Matplotlib draws all of it once more."""
    engine = figure.get_layout_engine()
    if engine is not None:
        with context(_STYLE):
            engine.execute(figure)
    figure.set_layout_engine(None)
    try:
        yield
    finally:
        figure.set_layout_engine(engine)


def heading_legend(figure: Figure, handles: Sequence[Line2D]) -> None:
    """One legend for all panels, on the line of the title."""
    figure.legend(handles=handles, loc="outside upper right", ncols=len(handles))


def legend_beside(axis: Axes) -> None:
    """One entry below the other to the right of the panel, where it covers nothing; none where nothing is named."""
    if not (n := len(axis.get_legend_handles_labels()[0])):
        return
    axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), ncols=1 + (n - 1) // _TALLEST, fontsize=6.5)


def shade_phases(axes: Sequence[Axes], spans: Sequence[PhaseSpan], *, named: bool = True, share: float = 1.0) -> None:
    """Colour the phases behind every panel and name them above the first; share of the page's width is theirs."""
    for axis in axes:
        for span in spans:
            axis.axvspan(span.start, span.end, color=_BANDS[span.index % len(_BANDS)], lw=0, zorder=-2)
        for span in spans[1:] if len(spans) <= _MANY else ():
            axis.axvline(span.start, color="#9AA3AB", lw=0.6, zorder=-1)
        axis.set_xlim(spans[0].start, spans[-1].end)
    if named:
        _name_phases(axes[0], spans, 0.88 * WIDTH * share)


def _name_phases(axis: Axes, spans: Sequence[PhaseSpan], width: float) -> None:
    """Full labels where they fit, none where no letter does; `width` [in] of the panel."""
    scale = width / (spans[-1].end - spans[0].start)
    for span in spans:
        room = scale * (span.end - span.start) / _LETTER
        if room < 2.0 and len(spans) > _FEW:
            continue
        text = span.label if len(span.label) < room else plain_line(span.name, max(2, int(room)))
        look = {"ha": "center", "va": "bottom", "fontsize": 7.5, "color": "#333333"}
        note(axis, text, ((span.start + span.end) / 2, 1.0), (0, 3), xycoords=("data", "axes fraction"), **look)


def logarithmic(axis: Axes) -> None:
    """Upwards; what is not positive is left out."""
    axis.set_yscale("log", nonpositive="mask")
    axis.yaxis.set_major_formatter(_PlainPowers())
    axis.yaxis.set_minor_formatter(_PlainPowers(labelOnlyBase=False))


def threshold(axis: Axes, value: float, text: str) -> None:
    """A dashed line at `value` [unit of the axis], with its meaning written on it."""
    axis.axhline(value, color=THRESHOLD, lw=0.9, ls=(0, (5, 3)), zorder=1.5)
    paper = {"facecolor": "white", "alpha": 0.8, "lw": 0, "pad": 0.6}  # over curves that run through the text
    look = {"ha": "left", "va": "bottom", "fontsize": 7, "color": THRESHOLD, "bbox": paper}
    note(axis, text, (0.0, value), (4, 2), xycoords=("axes fraction", "data"), **look)


# What lies behind the curves of every figure over time: the phases of the mission, and what went wrong on purpose.

_ABOVE_PHASES, _LINE = 13, 8  # [points]
_LONGEST = 40  # letters of what one moment is marked with


def mark_time(axes: Sequence[Axes], record: Record, *, named: bool = True, share: float = 1.0) -> None:
    """Phases and faults on every panel, named on the first unless told otherwise; share of the page's width is theirs."""
    shade_phases(axes, phase_spans(record), named=named, share=share)
    begun: dict[float, list[str]] = {}
    for fault in fault_spans(record):
        begun.setdefault(fault.start, []).append(fault.name)
        for axis in axes:
            axis.axvline(fault.start, color=VERMILLION, lw=0.9, ls=(0, (4, 2)), zorder=1.4)
            if fault.ended:
                axis.axvline(fault.end, color=VERMILLION, lw=0.9, ls=(0, (1, 2)), zorder=1.4)
    for line, (start, names) in enumerate(begun.items() if named else ()):
        _name(axes[0], start, plain_line(", ".join(names), _LONGEST), line)


def space_above(record: Record) -> float:
    """[points] that the names of phases and faults take above a panel."""
    return _ABOVE_PHASES + _LINE * len({fault.start for fault in fault_spans(record)})


def _name(axis: Axes, start: float, text: str, line: int) -> None:
    """Above the names of the phases, from its onset on or up to it; each a line higher than the one before."""
    begin, end = axis.get_xlim()
    late = start - begin > 0.5 * (end - begin)
    offset, side = (-3 if late else 3, _ABOVE_PHASES + _LINE * line), "right" if late else "left"
    look = {"ha": side, "va": "bottom", "fontsize": 6.5, "color": VERMILLION}
    note(axis, text, (start, 1.0), offset, xycoords=("data", "axes fraction"), **look)
