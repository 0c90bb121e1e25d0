"""Limits on positions from random starts: ``python benchmarks/viability.py [--runs N] [--rates HZ
...] [--jobs N]``.

Writes viability.csv, one row per run of the study `random_limits`, and the largest figures to
viability.md.
"""

from __future__ import annotations

from typing import Any

from recording.progress import show_runs
from recording.report import Report, Row, Table, add_jobs_option, begin, parser_of
from studies.random_limits import (
    CLEARANCE,
    N_OBSTACLES,
    N_PHASES,
    SELF_CLEARANCE,
    TOLERANCE,
    random_limits,
)

PROSE = """
{runs} runs of the study `random_limits` at each rate of control, kinematic plant. {phases} phases
with goals and tasks that nobody checked, among {obstacles} obstacles and above a floor; each run
starts at rest inside all limits, so that braking could always have kept them. Violations are the
largest of any tick of any run, from the true configurations.
"""


def figures(total: dict[str, Any]) -> dict[str, str]:
    """Label the figures of the study's only row."""
    return {
        f"runs with any violation above {TOLERANCE:g}": str(total["violated"]),
        "joint limits [rad]": f"{total['joints_rad']:.1e}",
        "minimum altitude [m]": f"{total['MAC_m']:.1e}",
        f"clearance of obstacles and floor, {CLEARANCE:g} m [m]": f"{total['CL_m']:.1e}",
        f"clearance of the robot itself, {SELF_CLEARANCE:g} m [m]": f"{total['SC_m']:.1e}",
        "largest one-tick change of v, share of a_max dt": f"{total['largest_step']:.9f}",
        "share of ticks at which the viability rule overruled the hierarchy": (
            f"{total['slowed_share']:.1e}"
        ),
        "mean path of the vehicle [m]": f"{total['mean_path_m']:.2f}",
    }


def main() -> None:
    """Run the study."""
    parser = parser_of(__doc__)
    parser.add_argument("--runs", type=int, default=1000, metavar="N")
    parser.add_argument(
        "--rates", type=float, nargs="+", default=[50.0, 200.0], metavar="HZ", help="of control"
    )
    add_jobs_option(parser)
    arguments, run = begin(parser)
    runs = arguments.runs
    jobs = arguments.jobs
    rates = arguments.rates
    if run.quick:
        runs = 1
        jobs = 1
        rates = rates[:1]
    rows_of_figures: dict[str, dict[str, str]] = {}
    cases: list[Row] = []
    for rate in rates:
        result = random_limits(n=runs, dt=1.0 / rate).run(workers=jobs, progress=show_runs)
        (total,) = result.table
        for name, text in figures(dict(total)).items():
            row = rows_of_figures.setdefault(name, {"figure": name})
            row[f"{rate:g} Hz"] = text
        cases += [{"rate_hz": rate, **case} for case in result.cases]
    run.write(
        Report(
            name="viability",
            title="Limits on positions from random starts and goals",
            prose=PROSE.format(runs=runs, phases=N_PHASES, obstacles=N_OBSTACLES),
            tables=[Table(rows=list(rows_of_figures.values()))],
            data={"viability": cases},
        )
    )


if __name__ == "__main__":
    main()
