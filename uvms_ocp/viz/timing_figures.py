"""Figure of the computation time of the control ticks."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from uvms_ocp.record.record import Record
from uvms_ocp.viz import layout, marks, style
from uvms_ocp.viz.colours import BLACK, BLUE, VERMILLION
from uvms_ocp.viz.line_widths import PLAIN
from uvms_ocp.viz.series import axis_label


@style.styled
def figure_tick_time(
    record: Record, *, fig: style.Canvas = None, width: layout.Width = "page"
) -> Figure | None:
    """Draw how long one control tick took, over time and as a distribution."""
    if "tick_time" not in record.series:
        return None
    tick = np.maximum(record["tick_time"] * 1e6, 1e-3)
    figure = layout.titled(2.6, "Computation time of one control tick", fig, width)
    over_time, spread = figure.subplots(1, 2, sharey=True, width_ratios=(3, 1))
    layout.logarithmic(over_time)
    over_time.plot(record["t"], tick, ".", ms=1.4, color=BLUE, rasterized=True)
    over_time.set(
        xlabel=axis_label("time", "t"), ylabel=axis_label("tick", "tick_time", prefix="µ")
    )
    period = 1e6 * record.run_meta.dt
    edges = np.geomspace(tick.min(), tick.max() * 1.01, 50)
    spread.hist(tick, bins=edges, orientation="horizontal", histtype="stepfilled", color=BLUE)
    spread.set_xlabel("ticks")
    lines = []
    for share, color in ((50, BLACK), (99, VERMILLION)):
        value = float(np.percentile(tick, share))
        label = f"p{share}  {value:.0f} µs"
        over_time.axhline(value, color=color, lw=PLAIN, ls="--", label=label)
        lines.append(spread.axhline(value, color=color, lw=PLAIN, ls="--", label=label))
    marks.threshold(over_time, period, "control period")
    # Room for the name of the period below those of the phases.
    over_time.set_ylim(top=3.0 * max(period, float(tick.max())))
    layout.heading_legend(figure, lines)
    marks.mark_time([over_time], record)
    return figure
