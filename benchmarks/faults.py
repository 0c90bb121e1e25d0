"""Faults: ``python benchmarks/faults.py --work FOLDER [--hours H] [--seeds N] [--pairs N] [--jobs
N] [--kinds WORD ...] [--drawn --runs N]``.

Runs the study `faults`, or a share of it: what is in FOLDER already is not run again, and after H
hours no case is begun. Writes faults.csv, one row per run, and their sums by kind to faults.md.
With ``--drawn`` the study `drawn_faults` in its place: faults of single sensors, and whom robots that hover blame.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from recording.kept_rows import kept_rows
from recording.report import Report, Row, Table, begin, parser_of
from recording.rows import column, known_values, rows_where
from studies.drawn_faults import GIVEN_UP, TOLD, TRUSTED, drawn_faults, totals
from studies.fault_study import by_kind, faults
from studies.fault_table import (
    ASTRAY,
    FLOOR,
    GUSTS,
    GUSTY,
    JOINTS,
    KINDS,
    NEW,
    NEW_RATES,
    PAIR,
    RATES,
    STILL,
)
from studies.study import Study

from uvms_ocp.report.metrics import CHANCE

PROSE = """
Case 1 with noisy sensors; {runs} of {cases} runs: {kinds} kinds of faults, each setting in in the
middle of each of the phases by the times of a run without faults ({onsets}), {pairs} runs with two
of them, drawn with their phases, and {free} runs without faults, in still water and in gusts of
{gusts:g} m/s. One row each in `faults.csv`, by the truth: `contact_s` and `contact_m` are contact
with the floor that the mission did not take for its landing, `arm_m` is the least height of arm and
tool above the floor, `joints_rad` the largest excess of a joint limit, `rate_share` the largest
true velocity of a joint as a share of its limit, `astray_m` the farthest from the way of a run
without faults, `tool_m` the tool's true error at the end of what completed.

A run has passed that does not end in contact, has arm and tool no deeper than {floor:g} m in the
floor, passes no joint limit by more than {joints:g} mrad and strays no farther than {astray:g} m,
names in its summary a joint whose true velocity passes {rates:g} times its limit, or {new_rates:g}
times within {new:g} s of a fault (`rates_named`), and completes or names what is wrong, of two
faults one; limits are widened by a bias or a drift that no other channel can show. Passed: {passed}
of {struck} runs with faults, {passed_pairs} of {pairs} with two. False alarms: {false} in {free}
runs without. In still water the tool's true error at the end was within its reported bound of
{chance:.0%} in {within} of {still} runs; the bound is {bound:.1f} mm on average, {ratio:.2f} times
what {chance:.0%} of these errors do not exceed.
"""
TABLE = {
    "kind": "",
    "runs": "",
    "completed": "",
    "other_ends": "",
    "not_named": "",
    "false_alarms": "",
    "noticed": "",
    "median_to_detect_s": ".2f",
    "end_in_contact": "",
    "largest_contact_m": ".3f",
    "least_arm_m": ".3f",
    "largest_joints_rad": ".4f",
    "largest_rate_share": ".2f",
    "largest_astray_m": ".2f",
    "largest_tool_m": ".4f",
    "passed": "",
}


DRAWN_PROSE = """
Single faults of sensors of shipped robots that hover, or sway slowly, for {shortest:g} to {longest:g} s with noisy sensors,
some of them with sensors of joint rates: {runs} drawn, each with its channel, kind, size and duration. No mission is given up,
as there is no abort phase: attitudes that drift by 0.3 rad/s for 25 s turn a vehicle over. One row each in
`drawn_faults.csv`: `blamed` is what is not good within {told:g} s of the first that is not, `named_s` when the right channel
is found, `sound_lost_s` how long a sound one was lost in all, `sound_bad_s` how long one was not good, `trusted_after_s` how
long after the end of the fault any still was not.

`named`: the right channel alone; `one_of_two`: it and another one, where nothing tells which of the two it is; `wrong`: others
alone. Right: {right} of {runs}. `sound_lost`: a sound channel was lost for more than {given_up:g} s; `not_trusted`: something was
not good {trusted:g} s after the end. A run has passed that names the right channel, alone or as one of two, and loses no sound
one.
"""


def sizes() -> list[Row]:
    """List the faults of each kind and what is widened for them."""
    return [
        {
            "kind": kind.name,
            "fault": " ".join(kind.texts),
            "lasts [s]": kind.lasts,
            "joint limits widened by [rad]": kind.joints or None,
            "floor lowered by [m]": kind.floor or None,
        }
        for kind in KINDS.values()
    ]


def onsets(rows: Sequence[Row]) -> str:
    """List the onset of each phase."""
    onset_of = {row["phase"]: row["onset_s"] for row in rows if row["kind"] != PAIR}
    return ", ".join(f"{phase} at {onset_of[phase]:g} s" for phase in sorted(onset_of))


def report(rows: Sequence[Row], study: Study) -> Report:
    """Make the report of all rows that there are."""
    faulty = []
    free = []
    for row in rows:
        if row["kind"] in (STILL, GUSTY):
            free.append(row)
        else:
            faulty.append(row)
    pairs = rows_where(faulty, "kind", PAIR)
    ended = rows_where(rows_where(free, "kind", STILL), "end", "completed")
    errors = np.array(column(ended, "tool_m"))
    bounds = np.array(column(ended, "tool_bound_m"))
    mean_bound = math.nan
    ratio = math.nan
    if ended:
        mean_bound = bounds.mean()
        ratio = mean_bound / np.quantile(errors, CHANCE)
    return Report(
        name="faults",
        title="Faults",
        prose=PROSE.format(
            runs=len(rows),
            cases=len(study.cases),
            kinds=len(set(column(faulty, "kind")) - {PAIR}),
            pairs=len(pairs),
            passed_pairs=_passed(pairs),
            floor=FLOOR,
            rates=RATES,
            new_rates=NEW_RATES,
            new=NEW,
            onsets=onsets(faulty),
            free=len(free),
            gusts=GUSTS,
            within=int((errors <= bounds).sum()),
            still=len(ended),
            bound=1e3 * mean_bound,
            ratio=ratio,
            chance=CHANCE,
            joints=1e3 * JOINTS,
            astray=ASTRAY,
            passed=_passed(faulty),
            struck=len(faulty),
            false=sum(known_values(free, "alarms_before")),
        ),
        tables=[Table(rows=by_kind(rows), columns=TABLE), Table(rows=sizes())],
        data={"faults": rows},
    )


def drawn_report(rows: Sequence[Row]) -> Report:
    """Make the report of drawn faults."""
    outcomes = column(rows, "outcome")
    right = outcomes.count("named") + outcomes.count("one of two")
    durations = known_values(rows, "duration_s")
    prose = DRAWN_PROSE.format(
        shortest=min(durations),
        longest=max(durations),
        runs=len(rows),
        told=TOLD,
        right=right,
        given_up=GIVEN_UP,
        trusted=TRUSTED,
    )
    return Report(
        name="drawn_faults",
        title="Drawn faults of sensors",
        prose=prose,
        tables=[Table(rows=totals(rows))],
        data={"drawn_faults": rows},
    )


def _passed(rows: Sequence[Row]) -> int:
    return sum(map(bool, column(rows, "passed")))


def chosen_kinds(words: Sequence[str]) -> list[str]:
    """Kinds whose names have any of the words in them; all without words."""
    if not words:
        return list(KINDS)
    names = []
    for name in KINDS:
        if any(word in name for word in words):
            names.append(name)
    return names


def main() -> None:
    """Run what is not known yet, and write."""
    parser = parser_of(__doc__)
    parser.add_argument("--seeds", type=int, default=5, metavar="N", help="of each kind and phase")
    parser.add_argument(
        "--free",
        type=int,
        default=100,
        metavar="N",
        help="runs without faults in still water, and as many in gusts",
    )
    parser.add_argument("--pairs", type=int, default=200, metavar="N", help="runs with two faults")
    parser.add_argument(
        "--kinds", nargs="*", default=[], metavar="WORD", help="of the names of kinds to run alone"
    )
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="processes")
    parser.add_argument(
        "--hours", type=float, default=8.0, metavar="H", help="after which no run is begun"
    )
    parser.add_argument("--work", type=Path, metavar="FOLDER", help="where rows are kept")
    parser.add_argument("--drawn", action="store_true", help="faults of sensors that are drawn")
    parser.add_argument("--runs", type=int, default=300, metavar="N", help="of drawn faults")
    arguments, run = begin(parser)
    if arguments.drawn:
        study = drawn_faults(n=2 if run.quick else arguments.runs)
        run.write(drawn_report(_rows(study, arguments)))
        return
    study = faults(
        n=arguments.seeds,
        fault_free=arguments.free,
        pairs=arguments.pairs,
        kinds=chosen_kinds(arguments.kinds),
    )
    if run.quick:
        kinds = ["altimeter_range frozen", "joint 2 jammed"]
        study = faults(
            n=1,
            fault_free=1,
            pairs=1,
            kinds=kinds,
            phases=("A",),
            plant="kinematic",
            dt=0.05,
            duration=12.0,
        )
    run.write(report(_rows(study, arguments), study))


def _rows(study: Study, arguments: argparse.Namespace) -> list[Row]:
    with tempfile.TemporaryDirectory() as temporary:
        folder = (arguments.work or Path(temporary)) / "study"
        return kept_rows(study, folder, arguments.jobs, arguments.hours)


if __name__ == "__main__":
    main()
