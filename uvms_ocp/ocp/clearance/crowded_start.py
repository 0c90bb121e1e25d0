"""Which shapes are nearer at the start than a constraint allows, in words."""

from __future__ import annotations

from uvms_ocp.ocp.clearance.shape_clearance import ShapeClearance
from uvms_ocp.ocp.problem import OcpProblem


def crowded_start(problem: OcpProblem, constraint: str) -> str:
    """The pair that a constraint of that name finds nearest for its margin, as a bracket; empty for one without shapes."""
    terms = [term for term in problem.constraints if isinstance(term, ShapeClearance) and term.name == constraint]
    return max((_lack(term, problem) for term in terms), default=(0.0, ""))[1]


def _lack(term: ShapeClearance, problem: OcpProblem) -> tuple[float, str]:
    distances = term.distances([0.0], problem.start.q[None])[0]
    lack = term.margins - distances
    k = int(lack.argmax())
    pair, margin = term.scene.pairs[k], term.margins[k]
    return float(lack[k]), f" ({pair.name}: {distances[k]:.4g} m apart, margin {margin:.4g} m)"
