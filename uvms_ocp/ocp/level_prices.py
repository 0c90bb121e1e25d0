"""Tell what a level above costs a level, by the multipliers of the rows that hold it."""

from __future__ import annotations

import numpy as np

from uvms_ocp.ocp.transcription.transcription import Transcription
from uvms_ocp.solvers import LexicographicResult


def level_prices(
    transcription: Transcription, result: LexicographicResult, level: int
) -> tuple[float, ...]:
    """See `uvms_ocp.ocp.plan.LevelReport.prices`; zeros where a level is met in full by
    anticipation, none if not known.

    Of all ways to let the residual of a level above grow by 1 as a norm, the best one lowers the
    cost by the norm of its multipliers.
    """
    last = level == len(result.points) - 1
    multipliers = result.points[level].row_multipliers
    if multipliers is None or (result.anticipated and not last):
        return (0.0,) * level
    prices = tuple(
        float(np.linalg.norm(multipliers[above.frozen]))
        for above in transcription.ranges().levels[:level]
    )
    if np.isnan(prices).any():
        return ()
    return prices
