"""Tuning of the search for faults of thrusters and joints."""

from __future__ import annotations

from typing import Annotated

from uvms_ocp.checks import checked_dataclass
from uvms_ocp.types import Positive, Range


@checked_dataclass()
class ActuatorHealthTuning:
    """Tuning of `ActuatorMonitor`. Raises `InvalidInput` for a number not > 0, and a share of 1 or
    more.
    """

    sample_time: Positive = 0.1
    """[s] between two looks at the residual wrench."""
    window: Positive = 4.0
    """[s] of the residual in which a culprit is looked for, and twice that in which its onset
    is.
    """
    explained: Annotated[float, Range(0.0, 1.0, open=True)] = 0.8
    """share of the changes that the fault of a thruster must explain: in Case 1 without one 0.7 was
    seen at most, 0.9 for a while where the model of the water is wrong by a fifth.
    """
    lead: Positive = 4.0
    """times as much as it leaves unexplained must be left by the next best: 2.7 and 9.6 were seen
    there.
    """
    settling: Positive = 1.5
    """[s] after a start or a verdict that are not looked at."""
