"""Priorities by weights against priorities by levels, on problems whose answers are known.

python benchmarks/ocp/priorities.py [RESULTS] [FIGURE.png]
"""

from __future__ import annotations

import csv
import os
import platform
import sys
from importlib.metadata import version
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from conflicts import Conflict, arm, vehicle
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, onenormest, splu
from toys import toy_rows

from uvms_ocp.ocp.plan import Plan
from uvms_ocp.ocp.planner import Planner
from uvms_ocp.solvers.nlp.lexicographic_nlp import NlpOptions

HERE = Path(__file__).parent
WEIGHTS = (1.0, 3.0, 1e1, 3e1, 1e2, 3e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8)
OPTIONS = NlpOptions(max_iterations=300)
COLUMNS = ("problem", "priorities", "status", "iterations", "cpu_ms", "condition", "errors_m", "above_best_m")
Row = dict[str, Any]


def rows(conflict: Conflict) -> list[Row]:
    """Levels first, then the sum for every weight."""
    plan, seconds = solved(Planner(conflict.problem, OPTIONS))
    found = [row(conflict, "levels", plan, seconds, None)]
    for weight in WEIGHTS:
        planner = Planner(conflict.as_sum(weight), OPTIONS)
        plan, seconds = solved(planner)
        found.append(row(conflict, f"weight {weight:g}", plan, seconds, condition(planner, plan)))
    return found


def solved(planner: Planner) -> tuple[Plan, float]:
    """A cold plan, and its processor time [s]."""
    begin = process_time()
    plan = planner.plan(diagnose=False)
    return plan, process_time() - begin


def row(conflict: Conflict, priorities: str, plan: Plan, seconds: float, condition: float | None) -> Row:
    assert plan.result is not None
    errors = conflict.errors(plan)
    known = [error - best for error, best in zip(errors, conflict.best, strict=True) if best is not None]
    return {
        "problem": conflict.name,
        "priorities": priorities,
        "status": plan.result.status.value,
        "iterations": plan.iterations,
        "cpu_ms": f"{1e3 * seconds:.0f}",
        "condition": "" if condition is None else f"{condition:.0e}",
        "errors_m": " ".join(f"{error:.3e}" for error in errors),
        "above_best_m": " ".join(f"{error:.1e}" for error in known),
    }


def condition(planner: Planner, plan: Plan) -> float:
    """Estimate, in the 1-norm, for the matrix of Newton's step at the plan: Hessian and Jacobian of the constraints."""
    assert plan.result is not None
    (point,), (nlp,) = plan.result.points, planner.transcription.program.nlps
    if point.row_multipliers is None:
        return float("nan")
    p = planner.transcription.parameters()
    J = nlp.functions["nlp_jac_g"](point.x, p)[1].sparse()
    H = nlp.functions["nlp_hess_l"](point.x, p, 1.0, point.row_multipliers[nlp.rows]).sparse()
    H = H + sparse.triu(H, 1).T
    K = sparse.bmat([[H, J.T], [J, None]], format="csc")
    try:
        factors = splu(K)
    except RuntimeError:
        return float("inf")
    inverse = LinearOperator(K.shape, matvec=factors.solve, rmatvec=lambda b: factors.solve(b, trans="T"))
    return float(onenormest(K) * onenormest(inverse))


def table(found: list[Row], columns: tuple[str, ...]) -> list[str]:
    head = ["| " + " | ".join(columns) + " |", "|" + "---|" * len(columns)]
    return [*head, *("| " + " | ".join(str(row[column]) for column in columns) + " |" for row in found)]


def write_csv(found: list[Row], path: Path) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(found[0]))
        writer.writeheader()
        writer.writerows(found)


def draw(found: list[Row], path: Path) -> None:
    """Errors over the weight, one panel per problem; crosses where the solver did not finish, lines for the levels."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    names = list(dict.fromkeys(row["problem"] for row in found))
    figure, panels = plt.subplots(1, len(names), figsize=(6 * len(names), 4), layout="constrained")
    for name, panel in zip(names, np.atleast_1d(panels), strict=True):
        levels, *sums = (row for row in found if row["problem"] == name)
        errors = np.array([[float(word) for word in row["errors_m"].split()] for row in sums])
        done = np.array([row["status"] == "solved" for row in sums])
        for i, reference in enumerate(float(word) for word in levels["errors_m"].split()):
            (line,) = panel.loglog(WEIGHTS, errors[:, i], label=f"goal {i + 1}")
            weights = np.array(WEIGHTS)
            panel.loglog(weights[done], errors[done, i], "o", color=line.get_color())
            panel.loglog(weights[~done], errors[~done, i], "x", color=line.get_color())
            panel.axhline(reference, color=line.get_color(), linestyle="--", linewidth=1)
        panel.set(title=name, xlabel="weight of a goal over the next", ylabel="error at the end [m]")
        panel.legend()
    figure.savefig(path, dpi=120)


def main(results: Path, figure: Path | None) -> None:
    before = os.getloadavg()[0]
    found, toys = [*rows(arm()), *rows(vehicle())], toy_rows()
    write_csv(found, results / "ocp_priorities.csv")
    write_csv(toys, results / "ocp_toys.csv")
    packages = ", ".join(f"{name} {version(name)}" for name in ("casadi", "pin", "numpy"))
    load = f"{before:.1f} at the start, {os.getloadavg()[0]:.1f} at the end"
    lines = [
        "# Optimal control: priorities",
        "",
        (HERE / "priorities.md").read_text(encoding="utf-8").strip(),
        "",
        f"{platform.machine()}, Python {platform.python_version()}, {packages}; load average {load}.",
        "",
        *table(found, COLUMNS),
        "",
        *table(toys, tuple(toys[0])),
        "",
    ]
    (results / "ocp_priorities.md").write_text("\n".join(lines), encoding="utf-8")
    if figure is not None:
        draw(found, figure)


if __name__ == "__main__":
    given = [Path(word) for word in sys.argv[1:]]
    main(given[0] if given else HERE.parent / "results", given[1] if len(given) > 1 else None)
