"""Problems by hierarchy solvers: ``python benchmarks/hierarchy.py --peers FOLDER [--lexls PROGRAM]
[--random N]``.

FOLDER: of `peer_environments.py`; without it the peers are left out. PROGRAM: as `lexls_results`
calls it. Writes hierarchy.csv and hierarchy.md.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from hierarchy_solvers.found import CERTIFIED, EXCESS, rows_of
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
    also = lexls_results(lexls, sets, PASSES) if lexls else {}
    rows: list[Row] = []
    for problem in sets:
        passes = [solved(SOLVERS[IN_C], problem) for _ in range(PASSES)]
        found = {
            IN_C: replace(passes[0], seconds=np.min([each.seconds for each in passes], axis=0))
        }
        rows += rows_of(problem, found | ({"LexLS, native": also[problem.name]} if lexls else {}))
    return rows


def matrix_rows(
    sets: list[Problem], peers: Path | None, lexls: Path | None
) -> tuple[list[Row], dict[str, str]]:
    """Every solver on given matrices; and the versions of the peers."""
    daqp, version = daqp_results(interpreter(peers, "pink"), sets) if peers else ({}, "")
    also = lexls_results(lexls, sets, PASSES) if lexls else {}
    rows: list[Row] = []
    for problem in sets:
        found = {name: solved(solver, problem) for name, solver in SOLVERS.items()}
        if problem.name in daqp:
            found["daqp, native"] = daqp[problem.name]
        if problem.name in also:
            found["LexLS, native"] = also[problem.name]
        rows += rows_of(problem, found)
    return rows, {"daqp": version} if peers else {}


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
    given, run = begin(parser)
    quick = run.quick
    random, exactness, passes = (2, 10, 1) if quick else (given.random, given.exactness, PASSES)
    problem, inputs = recorded_ticks(duration=0.25 if quick else 120.0)
    rows = whole_tick_rows(problem, inputs, passes=passes, cold=not quick)
    rows += cold_rows(problem, random_states(inputs, 20 if quick else 3000), passes)
    peers: dict[str, str] = {}
    if given.peers:
        found, peers["pin-pink"] = pink_rows(
            interpreter(given.peers, "pink"), passes=passes, ticks=5 if quick else 500
        )
        rows += found
    found, versions = matrix_rows(problems(problem, inputs, random), given.peers, given.lexls)
    rows += [
        *found,
        *large_rows(large_problems(max(LARGE) if not quick else HUMANOID), given.lexls),
        *exactness_rows(exactness),
    ]
    prose = PROSE.format(
        passes=passes,
        certified=CERTIFIED,
        excess=EXCESS,
        nearly=NEARLY,
        separated=min(SEPARATED),
        exactness=exactness,
    )
    prose += (
        "\nLexLS:"
        f" {'a program that is given, its least time of ' + str(PASSES) if given.lexls else 'not there'}.\n"
    )
    table = Table(rows=rows, columns=FORMATS)
    run.write(
        Report(
            name="hierarchy",
            title="Hierarchy solvers",
            prose=prose,
            tables=[table],
            peers=peers | versions,
        )
    )


if __name__ == "__main__":
    main()
