"""Options of the solver of QPs of stages: tolerance, iterations, starts."""

from __future__ import annotations

from typing import Annotated

from uvms_ocp.checks import checked_dataclass
from uvms_ocp.types import Positive, Range


@checked_dataclass(eq=False)
class StageQpOptions:
    """Options of a `StageQpSolver`. Raises `InvalidInput` for numbers that are not positive and finite, and more than 10,000
    iterations.
    """

    tolerance: Positive = 1e-9
    """Tolerance of the KKT conditions, relative to the largest term in them."""
    max_iterations: Annotated[int, Range(1, 10_000)] = 60
    """Factors of one run; a QP that one run does not solve takes two more."""
    warm_mu: Positive = 1e-6
    """Complementarity at a warm start, relative to the largest curvature: a squared distance to
    bounds.
    """
    cold_mu: Positive = 0.1
    """Complementarity at a cold start, relative to what missed bounds cost by curvature and
    gradient. With more of it QPs in which many bounds are reached take fewer factors, and those
    without a point are told later.
    """
    compiled: bool = True
    """False keeps to PIQP, which solves the same QPs without warm starts."""
