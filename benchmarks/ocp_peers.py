"""Optimal control by ours and by the peers: ``python benchmarks/ocp_peers.py --peers FOLDER``.

FOLDER: of `peer_environments.py`; without it the peers are left out. Writes ocp_peers.csv and
ocp_peers.md, one row per solver and setting.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from horizon.comparison import (
    COMPILED,
    Comparison,
    limited_rows,
    quickest_rows,
    shooting_rows,
    turns,
)
from horizon.ours import CONVERGENCE, GAUSS_NEWTON
from horizon.peer_problems import DURATION, least_time, quickest_problem, shooting_problem
from recording.report import Report, Row, Table, begin, parser_of
from recording.rows import known_values, rows_where
from recording.timing import LONG

REPEATS = 5
STEPS = (20, 40, 100)
ROUNDS = 6
PROSE = """
Every call is made once to warm up and {repeats} times, or until {long:g} s are over, to take the
least time, by the peers as by ours. *build_s* is what has to be done once before: transcription,
code and its compilation from an empty cache, for ours; the problem's classes for the peers. It is
empty for PyRoboPlan, which builds in every call, so that its times hold both.

**Shooting**: {dofs} degrees of freedom on a free-flyer, no water, no gravity, no limits;
{duration:g} s; running cost on all forces and on the state, terminal cost on tool pose and state;
semi-implicit Euler on both sides, so that the costs are the same number. The peer's states and
forces, put into our equations and our cost, give the cost and the violation in its row. Cold: from
rest at the start with zero forces. `ratio` is to the peer's processor time, `off` the relative
difference of the cost. The number in a setting is the convergence tolerance. {found} IPOPT needs
more because its linear solver knows nothing of steps, the exact Hessian because it is indefinite
far from the solution, and the virtual machine because it interprets. The second table has crocoddyl
and stagewise, with its Hessian and a tolerance of {tolerance:g}, in turn: {rounds} rounds of both
at each number of steps, so that they have the same of the machine.

**Limited**: the same with hard limits on the velocity of every axis, on the torque and the position
of every joint, a third below what the unlimited motion takes. The peer is mim-solvers' constrained
SQP with crocoddyl's models, with as many iterations as crocoddyl gets; `ratio` is to its processor
time whether it converges or not.

**Quickest**: the arm alone on a fixed base, posture to posture in the least time within limits on
velocity and acceleration. The answer is known ({best:.4g} s); `off` is the share by which a result
exceeds it, `ratio` is to the fastest peer. crocoddyl has neither free time nor hard limits on the
state; the other two have no forces, so each problem is with those that can express it.
"""
FORMATS = {
    "problem": "",
    "solver": "",
    "setting": "",
    "build_s": ".2f",
    "cpu_ms": ".2f",
    "wall_ms": ".2f",
    "ratio": ".2f",
    "warm_cpu_ms": ".2f",
    "iterations": "",
    "result": ".9f",
    "off": ".1e",
    "status": "",
}
TURNS = {
    "problem": "",
    "solver": "",
    "least_ms": ".2f",
    "median_ms": ".2f",
    "ratio": ".2f",
    "median_ratio": ".2f",
}


def found_text(rows: Sequence[Row]) -> str:
    """Describe what ours take with the peer's kind of Hessian, by tolerance."""
    parts = [*_ratios(rows)]
    if not parts:
        return ""
    return f"With Gauss and Newton's Hessian, which the peer uses as well, {'; '.join(parts)}."


def _ratios(rows: Sequence[Row]) -> Iterator[str]:
    for tolerance in CONVERGENCE:
        setting = f"{GAUSS_NEWTON}, {tolerance:g}, {COMPILED}"
        of_setting = rows_where(
            rows_where(rows, "solver", "uvms_ocp stagewise"), "setting", setting
        )
        shooting = [row for row in of_setting if row["problem"].startswith("shooting")]
        ratios = known_values(shooting, "ratio")
        if ratios:
            apart = max(abs(row["off"]) for row in shooting if row["ratio"] is not None)
            yield (
                f"stagewise takes {min(ratios):.2f} to {max(ratios):.2f} times the peer's time at a"
                f" tolerance of {tolerance:g}, where the costs agree to {apart:.0e}"
            )


def main() -> None:
    """Solve everything with everyone."""
    parser = parser_of(__doc__)
    parser.add_argument("--peers", type=Path, metavar="FOLDER")
    arguments, run = begin(parser)
    if run.quick:
        repeats = 1
        steps: tuple[int, ...] = (5,)
        rounds = 1
    else:
        repeats = REPEATS
        steps = STEPS
        rounds = ROUNDS
    in_turn = list[Row]()
    with tempfile.TemporaryDirectory() as name:
        comparison = Comparison(
            peers=arguments.peers, scratch=Path(name), repeats=repeats, quick=run.quick
        )
        parts = [shooting_rows(comparison, n) for n in steps]
        parts += [limited_rows(comparison, n) for n in steps]
        parts.append(quickest_rows(comparison, steps[:2]))
        for n in steps:
            in_turn += turns(comparison, n, rounds)
    rows = list[Row]()
    versions: dict[str, str] = {}
    for rows_of_part, versions_of_part in parts:
        rows += rows_of_part
        versions |= versions_of_part
    prose = PROSE.format(
        repeats=repeats,
        long=LONG,
        dofs=shooting_problem(1).robot.n_v,
        duration=DURATION,
        best=least_time(quickest_problem(1)),
        found=found_text(rows),
        tolerance=CONVERGENCE[0],
        rounds=rounds,
    )
    run.write(
        Report(
            name="ocp_peers",
            title="Optimal control: the peers",
            prose=prose,
            tables=[Table(rows=rows, columns=FORMATS), Table(rows=in_turn, columns=TURNS)],
            peers=versions,
        )
    )


if __name__ == "__main__":
    main()
