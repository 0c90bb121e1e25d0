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

given, result, warm, passes = sys.argv[1:]
data = open(given, "rb").read()
N, n, p = np.frombuffer(data, np.int32, 3)
sizes = np.frombuffer(data, np.int32, p, 12)
rows = np.frombuffer(data, np.float64, offset=12 + 4 * p).reshape(N, sizes.sum(), n + 2)
bound = lambda b: np.where(np.abs(b) >= 1e10, np.copysign(np.inf, b), b)
found = [
    LexicographicActiveSet().solve(
        [
            Level(jacobian=part[:, :n], lower=bound(part[:, n]), upper=bound(part[:, n + 1]))
            for part in np.split(each, np.cumsum(sizes)[:-1])
        ]
    )
    for each in rows
]
bad = [float(one.status.value == "inexact") for one in found]
np.concatenate([*(one.v for one in found), np.full(N, 1e-6), bad, np.ones(N)]).tofile(result)
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
    sets = [
        Problem(
            name=str(k), warm=False, sets=[make(np.random.default_rng(seed)) for seed in range(3)]
        )
        for k, make in enumerate(kinds)
    ]
    found = lexls_results(program, sets, passes=1)
    for problem in sets:
        ours = solved(LexicographicActiveSet(), problem)
        assert np.array_equal(found[problem.name].v, ours.v)
        assert np.array_equal(found[problem.name].exact, ours.exact)
        assert (found[problem.name].seconds == 1e-6).all()
