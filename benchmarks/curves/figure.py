"""One figure of a trajectory benchmark."""

from __future__ import annotations

from recording.report import Row

FORMATS = {"problem": "", "solver": "", "quantity": "", "value": ".3g", "target": ""}


def figure(problem: str, solver: str, quantity: str, value: float, target: str = "") -> Row:
    """A row; the target is what value [as the quantity says] should not exceed, or reach."""
    return {
        "problem": problem,
        "solver": solver,
        "quantity": quantity,
        "value": float(value),
        "target": target,
    }
