"""Tell what a level above costs a level, by the multipliers of the rows that hold it."""

from __future__ import annotations

import numpy as np

from uvms_ocp.ocp.transcription.transcription import Transcription
from uvms_ocp.solvers import LexicographicResult


def level_prices(
    transcription: Transcription, result: LexicographicResult, level: int
) -> tuple[float, ...]:
    """Return `uvms_ocp.ocp.plan_file.LevelReport.prices` of a level; zeros where a level is met in
    full by anticipation, none if not known.

    Of all ways to let the residual of a level above grow by 1 as a norm, the best one lowers the
    cost by the norm of its multipliers.
    """
    is_last = level == len(result.points) - 1
    multipliers = result.points[level].row_multipliers
    if multipliers is None or (result.anticipated and not is_last):
        return (0.0,) * level
    levels_above = transcription.ranges().levels[:level]
    prices = [float(np.linalg.norm(multipliers[above.frozen])) for above in levels_above]
    if np.isnan(prices).any():
        return ()
    return tuple(prices)
