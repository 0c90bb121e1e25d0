"""Drawn robots on drawn missions: ``python benchmarks/drawn_robots.py [--robots N] [--jobs N]
[--work DIR --hours H]``.

Vehicles of 10 to 1,500 kg with 4 to 10 thrusters in drawn places and directions, out of trim by up
to 2 cm and half of them by up to half of their thrust, with none to two arms of 1 to 8 joints and
loads of up to 5 % of the mass, swim to way points and reach with their tools, at any control period
and half of them with late positions and gyros. Writes drawn_robots.csv, one row per robot of the study
`drawn_robots`, and its sums to drawn_robots.md. With --work DIR it goes on where it was.
"""

from __future__ import annotations

from collections import Counter

from recording.kept_rows import add_study_options, kept_rows, study_report
from recording.processes import compiled_once
from recording.report import Row, begin, parser_of
from recording.rows import column, rows_where
from studies.drawn_conditions import GYRO_DELAY, OUT_OF_TRIM, PERIODS, POSITION_DELAY
from studies.drawn_robots import (
    BALLAST,
    CURRENT,
    DURATION,
    FARTHER,
    REASONS,
    SEEN,
    SHORT,
    TRIM,
    WRONGS,
    drawn_robots,
    reason_of,
)
from studies.fault_table import NEW, NEW_RATES, RATES

PROSE = """
{robots} robots, drawn with seeds from {first} to {last}; one row each in `drawn_robots.csv`. Their
files are those that `new-robot --from` proposes, with buoyancy off by up to {trim:g} m and by
{ballast:.1%} of the weight, and thrusters of half to twice what it takes for usual; {trimmed} are
farther out of trim, so that up to {thrust:.0%} of the thrust holds them still, as their files say.
Missions of shipped tasks (JL, MAC, HA, AT, MU, tools, PC, MP) with control periods of {shortest:g}
to {slowest:g} s last {longest:g} s at most; half of them are in a current of up to {current:g} m/s,
{noisy} have the noise of sensors, {late} positions up to {position:g} s and gyros up to {gyro:g} s
late, and {loaded} a load that nobody knows of.

{completed} complete, {gave_up} give up, {over} are stopped when time is over, {refused} are refused
by pre-flight and {faults} raise something else. Wrong are {wrong}, {noisy_wrong} of them with
noise and {loaded_wrong} with a load: {flees} flee, by more than {farther:g} m farther from their way point than at the start,
{touches} touch the floor, {unseen} roll or pitch by more than {seen:g} rad to either side without a
word in alarms or report, {blames} give a sensor up that is sound, and {whips} pass a joint's limit of
velocity by more than {new:.0%} in the first {soon:g} s or {lasting:.0%} later. What pre-flight refuses is flown
all the same: {needless} complete with nothing wrong and thrusters at their limits for less than
{short:.0%} of the time, and are refused without need.

Reasons of refusals, and how many for each: {reasons}. For none of these: {others}. Seeds of what is
wrong: {seeds}.
"""


def prose(rows: list[Row]) -> str:
    """Fill in the figures of the study."""
    number = Counter(column(rows, "outcome"))
    refusals = rows_where(rows, "outcome", "refused")
    refused = Counter(reason_of(text) for text in column(refusals, "text"))
    reasons = [f"{reason} {refused[reason]}" for reason in REASONS if refused[reason]]
    wrong = [row for row in rows if row["wrong"]]
    seeds = [f"{row['seed']} {row['wrong']}" for row in wrong]
    flees, touches, unseen, blames, whips, needless = [_count(wrong, name) for name in WRONGS]
    return PROSE.format(
        robots=len(rows),
        first=rows[0]["seed"],
        last=rows[-1]["seed"],
        completed=number["completed"],
        gave_up=number["gave up"],
        over=number["time over"],
        refused=number["refused"],
        faults=number["fault"],
        wrong=len(wrong),
        flees=flees,
        touches=touches,
        unseen=unseen,
        blames=blames,
        whips=whips,
        needless=needless,
        short=SHORT,
        new=NEW_RATES - 1.0,
        lasting=RATES - 1.0,
        soon=NEW,
        trimmed=sum(share > 0.0 for share in column(rows, "trim_share")),
        thrust=OUT_OF_TRIM,
        late=sum(delay > 0.0 for delay in column(rows, "position_delay_s")),
        position=POSITION_DELAY,
        gyro=GYRO_DELAY,
        trim=TRIM,
        ballast=BALLAST,
        shortest=PERIODS[0],
        slowest=PERIODS[1],
        longest=DURATION,
        current=CURRENT,
        farther=FARTHER,
        seen=SEEN,
        noisy=sum(column(rows, "noise")),
        loaded=sum(load > 0.0 for load in column(rows, "load_kg")),
        noisy_wrong=sum(column(wrong, "noise")),
        loaded_wrong=sum(load > 0.0 for load in column(wrong, "load_kg")),
        seeds=", ".join(seeds) or "none",
        reasons=", ".join(reasons) or "none",
        others=refused[""],
    )


def _count(rows: list[Row], wrong: str) -> int:
    """Count the robots about which one thing was wrong."""
    return sum(wrong in text for text in column(rows, "wrong"))


def main() -> None:
    """Run the study."""
    parser = parser_of(__doc__)
    parser.add_argument("--robots", type=int, default=2000, metavar="N")
    add_study_options(parser)
    arguments, run = begin(parser)
    if run.quick:
        study = drawn_robots(n=1, flies=False)
        jobs = 1
    else:
        study = drawn_robots(n=arguments.robots)
        jobs = arguments.jobs
    with compiled_once() as folder:
        rows = kept_rows(study, arguments.work or folder / "work", jobs, arguments.hours)
    run.write(study_report(study, "Drawn robots", rows, prose(rows)))


if __name__ == "__main__":
    main()
