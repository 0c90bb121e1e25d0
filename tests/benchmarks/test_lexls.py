"""The files that a program of LexLS reads and writes."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from hierarchy_solvers.ours import solved
from hierarchy_solvers.peers import lexls_results
from hierarchy_solvers.problems import Problem, dependent_hierarchy, random_hierarchy

from uvms_ocp.solvers.hierarchy.active_set import LexicographicActiveSet

PROGRAM = """
import sys
import numpy as np
from uvms_ocp.solvers.hierarchy.active_set import LexicographicActiveSet
from uvms_ocp.solvers.hierarchy.level import Level

hierarchies, result, warm, passes = sys.argv[1:]
data = open(hierarchies, "rb").read()
N, n, p = np.frombuffer(data, np.int32, 3)
sizes = np.frombuffer(data, np.int32, p, 12)
rows = np.frombuffer(data, np.float64, offset=12 + 4 * p).reshape(N, sizes.sum(), n + 2)
bound = lambda b: np.where(np.abs(b) >= 1e10, np.copysign(np.inf, b), b)
v, bad = [], []
for rows_of_hierarchy in rows:
    levels = []
    for part in np.split(rows_of_hierarchy, np.cumsum(sizes)[:-1]):
        lower, upper = bound(part[:, n]), bound(part[:, n + 1])
        levels.append(Level(jacobian=part[:, :n], lower=lower, upper=upper))
    solution = LexicographicActiveSet().solve(levels)
    v.append(solution.v)
    bad.append(float(solution.status.value == "inexact"))
np.concatenate([*v, np.full(N, 1e-6), bad, np.ones(N)]).tofile(result)
"""


def test_what_the_program_finds_is_read_as_it_was_written(tmp_path: Path) -> None:
    program = tmp_path / "program"
    (tmp_path / "solve.py").write_text(PROGRAM)
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" "{tmp_path / "solve.py"}" "$@"\n')
    program.chmod(0o755)
    kinds = (
        lambda rng: random_hierarchy(rng, 7, (7, 2, 3, 2, 7)),
        lambda rng: dependent_hierarchy(rng, 13, (6, 6, 3, 13), 0.0),
    )
    sets = []
    for k, make in enumerate(kinds):
        hierarchies = [make(np.random.default_rng(seed)) for seed in range(3)]
        sets.append(Problem(name=str(k), warm=False, sets=hierarchies))
    results = lexls_results(program, sets, passes=1)
    for problem in sets:
        ours = solved(LexicographicActiveSet(), problem)
        theirs = results[problem.name]
        assert np.array_equal(theirs.v, ours.v)
        assert np.array_equal(theirs.exact, ours.exact)
        assert (theirs.seconds == 1e-6).all()
