"""When messages were sent that arrived late, in bursts or with gaps."""

from __future__ import annotations

import numpy as np

from uvms_ocp.exceptions import InvalidInput


def evenly_sent(arrived: np.ndarray, period: float) -> np.ndarray:
    """Times (n,) [s] at which messages were sent every `period` [s], from when they arrived (n,) [s].

    A message was sent no later than it arrived, and at least a period before the next one: of all these bounds the least. Where
    messages are lost, the times after the gap are right again as soon as one comes without delay. What all messages are
    late by stays. Raises InvalidInput for a period that is not positive.
    """
    if not period > 0.0:
        raise InvalidInput(f"period = {period} s given; allowed: more than 0")
    since = period * np.arange(len(arrived))
    return np.asarray(np.minimum.accumulate((arrived - since)[::-1])[::-1] + since)
