"""Drawn problems of optimal control, and what is true of what is said of their plans:
``python benchmarks/ocp_truth.py [--problems N] [--jobs N] [--work DIR --hours H] [--seed K]``.

Robots, starts, goals, guesses, phases, obstacles, own rows and costs are drawn. Every plan is
judged by a dense look along its motion, by IPOPT on a transcription of its own from three starts,
and by planning again from the result. Writes ocp_truth.csv, one row a problem, and its sums to
ocp_truth.md. With --work DIR it goes on where it was; --seed K runs one problem and prints its row.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections import Counter
from pathlib import Path

from recording.kept_rows import add_study_options, kept_rows
from recording.report import Report, Row, Table, begin, parser_of
from recording.rows import column
from truth.dense_check import LOOKS
from truth.drawing import FEWEST_STEPS, MOST_STEPS
from truth.study import (
    AT_NODES,
    BETWEEN,
    NEAR,
    NOTES,
    OF_FORCES,
    SOLVED,
    TIME_LIMIT,
    WRONGS,
    ocp_truth,
    run_problem,
    totals,
)

PROBLEMS = 400
PROSE = """
{problems} problems with seeds from {first} to {last}, one row each in `ocp_truth.csv`; `python
benchmarks/ocp_truth.py --seed K` runs one again. Robots are the shipped ones and drawn ones, of
{fewest_dof} to {most_dof} degrees of freedom; there are {fewest} to {most} steps or so, in one to
three phases of uneven steps. Guesses are the planner's own, the start held, a way to somewhere
else, or noise. Around the robots are open water, still and moving shapes and balls, their own
links, or a user's own rows. Goals are of one or several strict levels, durations fixed or free.
Start and goal keep everything, so most problems have a way.

Of every plan the motion is looked at in {looks} places and more, by coal and by rows written for
this benchmark: it may break a limit by {nodes:g} (m, rad, shares of limits) at a node and by
{between:g} between them, that of a force by {forces:g} inside a step, a little more than plans
state. IPOPT solves a transcription written for this benchmark from the straight way, the start held
and the plan's own result. Costs within {near:.0%} are one. A plan has {limit:g} s.

{solved} are solved ({share:.1%}). Of these {dearer} are dearer than what planning again from them
finds; {nodes_broken} are broken at nodes, {between_broken} between them; {touching} are certified
and touch; {faults} raise something that is no message. Of all plans that the dense look finds
broken `judge_motion` overlooks {unseen}. None of these may be. Seeds: {seeds}.

From {no_minimum} of the solved plans IPOPT goes on to more than {near:.0%} less, from elsewhere it
comes to another, cheaper minimum in {another}: local minima exist, and which one is found depends
on the guess. Seeds of the first: {seeds_first}.

Of {unsolved} that are not solved ({statuses}) a way is known to {known}, to {known_at_nodes} more
one that keeps everything at the nodes alone; {good} keep everything themselves, and nothing cheaper
is known. Seeds: {seeds_known}.
"""


def prose(rows: list[Row]) -> str:
    """Fill in the figures of all problems."""
    wrong = {kind: _seeds(rows, "wrong", kind) for kind in WRONGS}
    notes = {kind: _seeds(rows, "note", kind) for kind in NOTES}
    seeds_first = {kind: notes[kind] for kind in NOTES[:1]}
    seeds_known = {kind: notes[kind] for kind in NOTES[2:]}
    statuses = Counter(column(rows, "status"))
    solved = statuses.pop(SOLVED, 0)
    status_texts = [f"{n} {status}" for status, n in statuses.most_common()]
    dearer, nodes, between, touching, unseen, faults = map(len, wrong.values())
    no_minimum, another, way_known, way_at_nodes, good = map(len, notes.values())
    dofs = column(rows, "dof")
    return PROSE.format(
        problems=len(rows),
        first=rows[0]["seed"],
        last=rows[-1]["seed"],
        fewest_dof=min(dofs),
        most_dof=max(dofs),
        fewest=FEWEST_STEPS,
        most=MOST_STEPS,
        looks=LOOKS,
        nodes=AT_NODES,
        between=BETWEEN,
        forces=OF_FORCES,
        near=NEAR,
        limit=TIME_LIMIT,
        solved=solved,
        share=solved / len(rows),
        dearer=dearer,
        nodes_broken=nodes,
        between_broken=between,
        touching=touching,
        unseen=unseen,
        faults=faults,
        seeds=_listed(wrong),
        no_minimum=no_minimum,
        another=another,
        seeds_first=_listed(seeds_first),
        unsolved=len(rows) - solved,
        statuses=", ".join(status_texts) or "none",
        known=way_known,
        known_at_nodes=way_at_nodes,
        good=good,
        seeds_known=_listed(seeds_known),
    )


def _seeds(rows: list[Row], name: str, kind: str) -> list[int]:
    return [row["seed"] for row in rows if kind in str(row[name]).split(", ")]


def _listed(seeds: dict[str, list[int]]) -> str:
    parts = []
    for kind, numbers in seeds.items():
        if numbers:
            parts.append(f"{kind} {', '.join(map(str, numbers))}")
    return "; ".join(parts) or "none"


def show(seed: int) -> None:
    """Run one problem, and print what becomes of it."""
    for name, value in run_problem({"seed": seed}).items():
        sys.stdout.write(f"{name:>22}  {value}\n")


def main() -> None:
    """Run the study, or one problem of it."""
    parser = parser_of(__doc__)
    parser.add_argument("--problems", type=int, default=PROBLEMS, metavar="N")
    parser.add_argument("--first", type=int, default=0, metavar="K", help="seed of the first")
    parser.add_argument("--seed", type=int, metavar="K", help="run this problem alone")
    add_study_options(parser)
    arguments, run = begin(parser)
    os.environ.setdefault("UVMS_OCP_CFLAGS", "-O0")  # what is compiled runs a few times
    if arguments.seed is not None:
        show(arguments.seed)
        return
    n = arguments.problems
    jobs = arguments.jobs
    if run.quick:
        n = 1
        jobs = 1
    with tempfile.TemporaryDirectory() as folder:
        work = arguments.work or Path(folder) / "work"
        rows = kept_rows(ocp_truth(n=n, seed=arguments.first), work, jobs, arguments.hours)
    run.write(
        Report(
            name="ocp_truth",
            title="What is said of plans, and what is so",
            prose=prose(rows),
            tables=[Table(rows=totals(rows))],
            data={"ocp_truth": rows},
        )
    )


if __name__ == "__main__":
    main()
