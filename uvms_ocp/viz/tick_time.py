"""Figure of the computation time of the control ticks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from uvms_ocp.arguments import checked
from uvms_ocp.record import Record
from uvms_ocp.viz.series import labelled
from uvms_ocp.viz.style import (
    BLACK,
    BLUE,
    VERMILLION,
    WIDTH,
    RecordFigure,
    heading_legend,
    logarithmic,
    styled,
    threshold,
)
from uvms_ocp.viz.time_marks import mark_time


@checked
@styled
def figure_tick_time(record: Record) -> Figure | None:
    """How long one control tick took, over time and as a distribution."""
    if "tick_time" not in record.series:
        return None
    tick = np.maximum(record["tick_time"] * 1e6, 1e-3)
    figure = RecordFigure(figsize=(WIDTH, 2.6))
    figure.suptitle("Computation time of one control tick", fontsize=10, fontweight="bold", x=0.01, ha="left")
    over_time, spread = figure.subplots(1, 2, sharey=True, width_ratios=(3, 1))
    logarithmic(over_time)
    over_time.plot(record["t"], tick, ".", ms=1.4, color=BLUE, rasterized=True)
    over_time.set(xlabel=labelled("time", "t"), ylabel=labelled("tick", "tick_time", prefix="µ"))
    spread.hist(tick, bins=np.geomspace(tick.min(), tick.max() * 1.01, 50), orientation="horizontal", color=BLUE)
    spread.set_xlabel("ticks")
    lines = [_percentile_line((over_time, spread), tick, *entry) for entry in ((50, BLACK), (99, VERMILLION))]
    period = 1e6 * record.run_meta.dt
    threshold(over_time, period, "control period")
    over_time.set_ylim(top=3.0 * max(period, float(tick.max())))  # room for its name below those of the phases
    heading_legend(figure, lines)
    mark_time([over_time], record, share=0.77)
    return figure


def _percentile_line(axes: Sequence[Axes], tick: np.ndarray, share: int, color: str) -> Line2D:
    value = float(np.percentile(tick, share))
    label = f"p{share}  {value:.0f} µs"
    return [axis.axhline(value, color=color, lw=0.9, ls="--", label=label) for axis in axes][-1]
