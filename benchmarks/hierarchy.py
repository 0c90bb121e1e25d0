"""Problems by hierarchy solvers: ``python benchmarks/hierarchy.py --peers FOLDER [--lexls PROGRAM]
[--random N]``.

FOLDER: of `peer_environments.py`; without it the peers are left out. PROGRAM: as `lexls_results`
calls it. Writes hierarchy.csv and hierarchy.md.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from hierarchy_solvers.found import CERTIFIED, EXCESS, Found, rows_of
from hierarchy_solvers.ours import IN_C, SOLVERS, cold_rows, exactness_rows, solved, whole_tick_rows
from hierarchy_solvers.peers import daqp_results, lexls_results, pink_rows
from hierarchy_solvers.problems import (
    HUMANOID,
    LARGE,
    NEARLY,
    SEPARATED,
    Problem,
    large_problems,
    problems,
    random_states,
    recorded_ticks,
)
from peer_environments import interpreter
from recording.report import Report, Row, Table, begin, parser_of

PASSES = 3
PROSE = """
All rows are from one run. Every solver has one call to warm up.

- *whole tick*: all ticks of Case 1, kinematics included, called from Python, the shortest of
  {passes} passes. pink: kinematics and `solve_ik` of what the phases of Case 1 ask for, in its own
  terms (`hierarchy_solvers/peer_pink.py`): weights, no strict levels; not exact: ticks that its
  solver refused. It builds its QP in every call.
- *build_s*: symbolic levels, code and its compilation, from an empty cache, once for a mission.
- *random states, cold*: Case 1 at random states, no active set to start from.
- Other problems: matrices given, from Python. *case1*: every recorded tick, in sequence (warm). The
  rest is cold.
- *grown*: a box, four levels of equalities and inequalities whose rows grow with n, least velocity
  below; *box and equalities*: three levels of equalities in their place, hardly a conflict;
  *humanoid's size*: simple bounds of most variables, four levels below. Ours with its call from
  Python and its certificate, LexLS without.
- *not exact*: results that the solver itself does not call exact; daqp: an exit flag below one.
  iCAT is regularised by design.
- *largest certificate where exact*: by how much any level can be above its least at most [rate], of
  results called exact. The cascade is certified in Python in every call, which is most of its time.
- *largest excess*: of a level's residual norm over the best certified to {certified:g}, at the
  first level that differs by more than {excess:g}; below that, rounding cannot tell who is better,
  because the norm of a level is flat at its optimum.
- *dependent to {nearly:.0e}* has rows between dependent and independent: only a truthful status is
  asked for there.
- *exactness*: every one of {exactness} hierarchies certified, rows dependent exactly or separated
  by {separated:g} and more.
"""
FORMATS = {
    "problem": "",
    "solver": "",
    "problems": "",
    "build_s": ".1f",
    "p50_us": ".1f",
    "p99_us": ".1f",
    "max_us": ".1f",
    "not exact": "",
    "largest certificate where exact": ".1e",
    "largest excess": ".1e",
}


def large_rows(sets: list[Problem], lexls: Path | None) -> list[Row]:
    """The active set and LexLS on sets that grow, each the least time of some passes."""
    by_lexls = lexls_results(lexls, sets, PASSES) if lexls else {}
    rows: list[Row] = []
    for problem in sets:
        passes = [solved(SOLVERS[IN_C], problem) for _ in range(PASSES)]
        shortest = np.min([results.seconds for results in passes], axis=0)
        results_of = {IN_C: replace(passes[0], seconds=shortest)}
        if lexls:
            results_of["LexLS, native"] = by_lexls[problem.name]
        rows += rows_of(problem, results_of)
    return rows


def matrix_rows(
    sets: list[Problem], peers: Path | None, lexls: Path | None
) -> tuple[list[Row], dict[str, str]]:
    """Every solver on given matrices; and the versions of the peers."""
    versions = {}
    by_daqp: dict[str, Found] = {}
    if peers:
        by_daqp, versions["daqp"] = daqp_results(interpreter(peers, "pink"), sets)
    by_lexls = lexls_results(lexls, sets, PASSES) if lexls else {}
    rows: list[Row] = []
    for problem in sets:
        results_of = {name: solved(solver, problem) for name, solver in SOLVERS.items()}
        if problem.name in by_daqp:
            results_of["daqp, native"] = by_daqp[problem.name]
        if problem.name in by_lexls:
            results_of["LexLS, native"] = by_lexls[problem.name]
        rows += rows_of(problem, results_of)
    return rows, versions


def main() -> None:
    """Run everything and write the results."""
    parser = parser_of(__doc__)
    parser.add_argument("--peers", type=Path, metavar="FOLDER")
    parser.add_argument("--lexls", type=Path, metavar="PROGRAM")
    parser.add_argument(
        "--random", type=int, default=200, metavar="N", help="hierarchies of each random set"
    )
    parser.add_argument(
        "--exactness", type=int, default=10_000, metavar="N", help="hierarchies to certify"
    )
    arguments, run = begin(parser)
    if run.quick:
        size = _Size(
            duration=0.25,
            passes=1,
            states=20,
            pink_ticks=5,
            random=2,
            largest=HUMANOID,
            exactness=10,
        )
    else:
        size = _Size(
            duration=120.0,
            passes=PASSES,
            states=3000,
            pink_ticks=500,
            random=arguments.random,
            largest=max(LARGE),
            exactness=arguments.exactness,
        )
    problem, inputs = recorded_ticks(duration=size.duration)
    rows = whole_tick_rows(problem, inputs, passes=size.passes, cold=not run.quick)
    rows += cold_rows(problem, random_states(inputs, size.states), size.passes)
    versions: dict[str, str] = {}
    if arguments.peers:
        python = interpreter(arguments.peers, "pink")
        rows_of_pink, versions["pin-pink"] = pink_rows(
            python, passes=size.passes, ticks=size.pink_ticks
        )
        rows += rows_of_pink
    sets = problems(problem, inputs, size.random)
    rows_of_matrices, versions_of_matrices = matrix_rows(sets, arguments.peers, arguments.lexls)
    versions |= versions_of_matrices
    rows += rows_of_matrices
    rows += large_rows(large_problems(size.largest), arguments.lexls)
    rows += exactness_rows(size.exactness)
    prose = PROSE.format(
        passes=size.passes,
        certified=CERTIFIED,
        excess=EXCESS,
        nearly=NEARLY,
        separated=min(SEPARATED),
        exactness=size.exactness,
    )
    if arguments.lexls:
        prose += f"\nLexLS: a program that is given, its least time of {PASSES}.\n"
    else:
        prose += "\nLexLS: not there.\n"
    table = Table(rows=rows, columns=FORMATS)
    run.write(
        Report(
            name="hierarchy",
            title="Hierarchy solvers",
            prose=prose,
            tables=[table],
            peers=versions,
        )
    )


@dataclass(frozen=True, kw_only=True, slots=True)
class _Size:
    """How much is measured."""

    duration: float
    """[s] of the recorded run."""
    passes: int
    states: int
    """Random states of Case 1."""
    pink_ticks: int
    random: int
    """Hierarchies of each random set."""
    largest: int
    """Unknowns of the sets that grow, at most."""
    exactness: int
    """Hierarchies to certify."""


if __name__ == "__main__":
    main()
