"""Priorities by weights against priorities by levels: ``python benchmarks/ocp_priorities.py
[--figure PNG]``.

Problems whose answers are known. Writes ocp_priorities.csv, ocp_toys.csv and ocp_priorities.md; the
figure only where a path is given.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from horizon.condition import condition
from horizon.conflicts import AHEAD, N_LINKS, Conflict, arm, vehicle
from horizon.toys import FORMATS as TOY_FORMATS, toy_rows
from recording.processes import hide_compiler
from recording.report import Report, Row, Table, begin, parser_of
from recording.rows import column, rows_where
from recording.timing import once

from uvms_ocp.ocp.planner import Planner
from uvms_ocp.solvers.nlp.options import NlpOptions

WEIGHTS = (1.0, 3.0, 1e1, 3e1, 1e2, 3e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8)
OPTIONS = NlpOptions(max_iterations=300)
LEVELS = "levels"
SOLVED = "solved"
PROSE = """
**Levels against a weighted sum.** Every goal of the sum weighs `weight` times the next, residuals
squared afterwards; effort and smoothness weigh one. `errors_m` are the distances of the frames from
their goals at the end, highest priority first; `above_best_m` is what they exceed the known optimum
by (negative: the goals above paid for it). `condition` is an estimate for the matrix of Newton's
step at the solution. Levels freeze within {tolerance:g} and need no weight.

*arm*: {links} joints in a plane; the tool can reach its goal, elbow and shoulder cannot below it:
geometry gives {arm_best} m. *vehicle and arm*: the vehicle is to stay where it is while the tool is
to reach {ahead:g} m ahead, in water, with the limits of thrusters and joints.

{found}

**Toys** have two variables, and answers known from algebra or from a search along the curve that
the first level leaves.
"""
FORMATS = {
    "problem": "",
    "priorities": "",
    "status": "",
    "iterations": "",
    "cpu_ms": ".0f",
    "condition": ".0e",
    "errors_m": "",
    "above_best_m": "",
}


def rows(conflict: Conflict, weights: Sequence[float]) -> Iterator[Row]:
    """Levels first, then the sum for every weight."""
    yield _row(conflict, LEVELS, Planner(conflict.problem, OPTIONS), of_sum=False)
    for weight in weights:
        yield _row(
            conflict, f"weight {weight:g}", Planner(conflict.as_sum(weight), OPTIONS), of_sum=True
        )


def _row(conflict: Conflict, priorities: str, planner: Planner, *, of_sum: bool) -> Row:
    planning = once(partial(planner.plan, diagnose=False))
    plan = planning.value
    assert plan.result is not None
    errors = conflict.errors(plan)
    return {
        "problem": conflict.name,
        "priorities": priorities,
        "status": plan.result.status.value,
        "iterations": plan.iterations,
        "cpu_ms": 1e3 * planning.cpu,
        "condition": condition(planner, plan) if of_sum else None,
        "errors_m": " ".join(f"{error:.3e}" for error in errors),
        "above_best_m": " ".join(f"{excess:.1e}" for excess in _excesses(conflict, errors)),
    }


def _excesses(conflict: Conflict, errors: Sequence[float]) -> list[float]:
    return [
        error - best for error, best in zip(errors, conflict.best, strict=True) if best is not None
    ]


def found_text(table: Sequence[Row]) -> str:
    """For each problem: what the largest weight that converges pays, from which weight on none
    does.
    """
    names = dict.fromkeys(column(table, "problem"))
    return "\n".join(_found_in(name, table) for name in names)


def _found_in(name: str, table: Sequence[Row]) -> str:
    levels, *sums = rows_where(table, "problem", name)
    done = rows_where(sums, "status", SOLVED)
    text = f"- {name}: by levels the first goal is missed by {_first_error_mm(levels):.2g} mm"
    if not done:
        return f"{text}; no weight converges."
    last = done[-1]
    text += (
        f", with {last['priorities']}, the largest that converges, by {_first_error_mm(last):.2g}"
        f" mm at a condition of {last['condition']:.0e}"
    )
    beyond = sums[sums.index(last) + 1 :]
    if not beyond:
        return f"{text}."
    return f"{text}; {beyond[0]['priorities']} ends as: {beyond[0]['status']}."


def _first_error_mm(row: Row) -> float:
    return 1e3 * _errors(row)[0]


def _errors(row: Row) -> list[float]:
    """[m] of all goals, as the row has them."""
    return [float(word) for word in row["errors_m"].split()]


def draw(table: Sequence[Row], path: Path) -> None:
    """Errors over the weight, one panel per problem; crosses where the solver did not finish, lines
    for the levels.
    """
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    names = list(dict.fromkeys(column(table, "problem")))
    figure, panels = plt.subplots(1, len(names), figsize=(6 * len(names), 4), layout="constrained")
    for name, panel in zip(names, np.atleast_1d(panels), strict=True):
        levels, *sums = rows_where(table, "problem", name)
        errors = np.array([_errors(row) for row in sums])
        weights = np.array([float(row["priorities"].split()[1]) for row in sums])
        done = np.array(column(sums, "status")) == SOLVED
        for i, reference in enumerate(_errors(levels)):
            (line,) = panel.loglog(weights, errors[:, i], label=f"goal {i + 1}")
            panel.loglog(weights[done], errors[done, i], "o", color=line.get_color())
            panel.loglog(weights[~done], errors[~done, i], "x", color=line.get_color())
            panel.axhline(reference, color=line.get_color(), linestyle="--", linewidth=1)
        panel.set(
            title=name, xlabel="weight of a goal over the next", ylabel="error at the end [m]"
        )
        panel.legend()
    figure.savefig(path, dpi=120)


def main() -> None:
    """Solve with levels and with all weights."""
    parser = parser_of(__doc__)
    parser.add_argument("--figure", type=Path, metavar="PNG", help="draw it as well")
    arguments, run = begin(parser)
    if run.quick:
        hide_compiler()
        conflicts = [arm(5)]
        weights: tuple[float, ...] = WEIGHTS[2:4]
    else:
        conflicts = [arm(), vehicle()]
        weights = WEIGHTS
    table = list[Row]()
    for conflict in conflicts:
        table += rows(conflict, weights)
    toys = toy_rows()
    prose = PROSE.format(
        tolerance=OPTIONS.tolerance,
        links=N_LINKS,
        arm_best=", ".join(f"{best:.4g}" for best in arm(1).best),
        ahead=AHEAD,
        found=found_text(table),
    )
    run.write(
        Report(
            name="ocp_priorities",
            title="Optimal control: priorities",
            prose=prose,
            tables=[Table(rows=table, columns=FORMATS), Table(rows=toys, columns=TOY_FORMATS)],
            data={"ocp_priorities": table, "ocp_toys": toys},
        )
    )
    if arguments.figure:
        draw(table, arguments.figure)


if __name__ == "__main__":
    main()
