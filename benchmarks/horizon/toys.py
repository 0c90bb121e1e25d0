"""Rosenbrock and Himmelblau in an order of priority: small problems with known lexicographic
optima.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import casadi as ca
import numpy as np
from scipy.optimize import minimize_scalar

from uvms_ocp.solvers.nlp.lexicographic_nlp import LexicographicNlp
from uvms_ocp.solvers.nlp.options import NlpOptions
from uvms_ocp.solvers.nlp.program import NlpLevel, lexicographic_program

TIGHT = NlpOptions(tolerance=1e-9, convergence=1e-10)
FORMATS = {"toy": "", "status": "", "iterations": "", "answer": "", "off": ".1e"}


def himmelblau(x: ca.SX) -> ca.SX:
    """Rows (2,) of Himmelblau's function of x (2,)."""
    return ca.vertcat(x[0] ** 2 + x[1] - 11, x[0] + x[1] ** 2 - 7)


def rosenbrock(x: ca.SX) -> ca.SX:
    """Rows (2,) of Rosenbrock's function of x (2,)."""
    return ca.vertcat(10 * (x[1] - x[0] ** 2), 1 - x[0])


def toys(x: ca.SX) -> Iterator[tuple[str, list[ca.SX], tuple[float, float], np.ndarray]]:
    """Name, rows of each level, start and answer."""
    yield (
        "Himmelblau over Rosenbrock",
        [himmelblau(x), rosenbrock(x)],
        (2.5, 1.5),
        np.array([3.0, 2.0]),
    )
    yield (
        "Rosenbrock over Himmelblau",
        [rosenbrock(x), himmelblau(x)],
        (-1.2, 1.0),
        np.array([1.0, 1.0]),
    )
    parabola = himmelblau(x)[0]
    circle = ca.sumsqr(x) - 4
    yield (
        "a row of Himmelblau over Rosenbrock",
        [parabola, rosenbrock(x)],
        (1.0, 2.0),
        on_parabola(),
    )
    yield "a circle over Himmelblau", [circle, himmelblau(x)], (1.0, 1.5), on_circle()


def on_parabola() -> np.ndarray:
    """Least Rosenbrock where ``x0^2 + x1 = 11``, found along the curve."""
    minimum = minimize_scalar(
        lambda s: (10 * (11 - 2 * s**2)) ** 2 + (1 - s) ** 2,
        bounds=(1, 4),
        method="bounded",
        options={"xatol": 1e-12},
    )
    return np.array([minimum.x, 11 - minimum.x**2])


def on_circle() -> np.ndarray:
    """Least Himmelblau at distance 2 from the origin, found along the circle."""

    def along(s: float) -> float:
        x = 2 * np.cos(s)
        y = 2 * np.sin(s)
        return float((x**2 + y - 11) ** 2 + (x + y**2 - 7) ** 2)

    minimum = minimize_scalar(
        along, bounds=(0, np.pi / 2), method="bounded", options={"xatol": 1e-12}
    )
    return 2 * np.array([np.cos(minimum.x), np.sin(minimum.x)])


def toy_rows() -> list[dict[str, Any]]:
    """One row per toy: how far the solution is from the answer."""
    x = ca.SX.sym("x", 2)
    rows = []
    for name, levels, start, answer in toys(x):
        nlp = LexicographicNlp(lexicographic_program(x, [NlpLevel(y=y) for y in levels]), TIGHT)
        result = nlp.solve(np.array(start))
        rows.append(
            {
                "toy": name,
                "status": result.status.value,
                "iterations": sum(result.iterations),
                "answer": " ".join(f"{value:.6f}" for value in answer),
                "off": float(np.abs(result.x - answer).max()),
            }
        )
    return rows
