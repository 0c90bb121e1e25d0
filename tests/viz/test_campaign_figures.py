"""Figures of a campaign draw whatever finite or infinite numbers its runs have."""

import io

import numpy as np
import pytest
from matplotlib.figure import Figure

from uvms_ocp.viz.campaign_figures import figure_spread

_COLUMNS = {
    "constant": np.full(6, 0.25),
    "constant and large": np.full(6, 1e17),
    "one rounding apart": 0.1 + 2.8e-17 * np.arange(6),
    "one subnormal apart": np.array([0.0, 5e-324, 0.0, 0.0, 0.0, 0.0]),
    "infinite and unknown": np.array([1.0, np.inf, -np.inf, np.nan, 2.0, 3.0]),
    "unlike in size": np.array([1e-300, 1.0, 1e300, -1.0, 2.0, 0.0]),
    "from end to end of double": np.array([-1.7e308, 1.7e308, 0.0, 1.0, 2.0, 3.0]),
}


@pytest.mark.sampled
@pytest.mark.parametrize("name", _COLUMNS)
def test_each_run_with_a_number_is_in_the_histogram(name: str) -> None:
    column = _COLUMNS[name]
    success = np.array([True, False, True, True, False, True])
    figure = figure_spread({name: column}, success)
    figure.savefig(io.BytesIO(), format="png")
    counted = sum(patch.get_height() for patch in figure.axes[0].patches)
    assert counted == np.count_nonzero(np.abs(column) <= 1e300)


@pytest.mark.sampled
@pytest.mark.parametrize("width", ["column", 3.5, "page", 7.2])
def test_histograms_stand_below_each_other_where_the_figure_is_narrow(width: str | float) -> None:
    values = {f"m{i} [s]": np.arange(4.0) for i in range(4)}
    success = np.ones(4, dtype=bool)
    inches = {"column": 3.5, "page": 7.2}.get(str(width)) or float(width)
    own = figure_spread(values, success, width=width)
    for figure in (own, figure_spread(values, success, fig=Figure(figsize=(inches, 5.0)))):
        columns = {axis.get_subplotspec().colspan.start for axis in figure.axes}
        assert len(columns) == (1 if inches < 5.0 else 3)
    assert own.get_figheight() == pytest.approx(1.7 * (4 if inches < 5.0 else 2))
