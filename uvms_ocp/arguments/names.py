"""Annotations that say more than their type, by name."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np

from uvms_ocp.arguments.extents import Range, Shape

Finite = Annotated[float, Range(open=True)]
Positive = Annotated[float, Range(0.0, open=True)]
Count = Annotated[int, Range(0)]
AtLeastOne = Annotated[int, Range(1)]
Magnitude = Annotated[float, Range(0.0, 1e6)]
"""[m], [rad], [s] Never negative, and finite."""
DAY = 86_400.0
"""[s] Beyond it no run, plan or solution is waited for."""
Bound = Annotated[float, Range()]
"""Infinite where there is no bound, never NaN."""
Period = Annotated[float, Range(0.0, DAY, open=True)]
"""[s] Of control, of a step, of an action: no longer than a day."""
Vector3 = Annotated[np.ndarray, Shape(3)]
Point = Annotated[Sequence[float], Shape(3), Range(open=True)]
