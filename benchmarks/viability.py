"""Limits on positions from random starts: ``python benchmarks/viability.py [--runs N] [--rate HZ]``.

Writes ``results/viability.csv``, one row per run of the study ``random_limits``, and beside it the largest figures as a
report, ``viability.md``.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from uvms_ocp.campaign.random_limits import random_limits
from uvms_ocp.campaign.study import StudyResult

REPORT = """# Limits on positions from random starts and goals

`python benchmarks/viability.py --runs {runs} --rate {rate:g}`: {runs} runs of the study `random_limits`, kinematic plant.
Four phases with goals and tasks that nobody checked, among six obstacles and above a floor; each run starts at rest inside
all limits, so that braking could always have kept them. Violations are the largest of any tick of any run, from
the true configurations.

| figure | value |
|---|---|
| runs with any violation above 1e-6 | {violated} |
| joint limits [rad] | {joints_rad:.1e} |
| minimum altitude [m] | {MAC_m:.1e} |
| clearance of obstacles and floor, 0.05 m [m] | {CL_m:.1e} |
| clearance of the robot itself, 0.03 m [m] | {SC_m:.1e} |
| largest one-tick change of v, share of a_max dt | {largest_step:.9f} |
| share of ticks at which the viability rule overruled the hierarchy | {slowed_share:.1e} |
| mean path of the vehicle [m] | {mean_path_m:.2f} |
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--rate", type=float, default=50.0, help="control rate [Hz]")
    parser.add_argument("--output", type=Path, default=Path(__file__).parent / "results" / "viability.csv")
    arguments = parser.parse_args()
    result = random_limits(n=arguments.runs, dt=1.0 / arguments.rate).run(progress=_show)
    write(result, arguments.rate, arguments.output)


def write(result: StudyResult, rate: float, path: Path) -> None:
    """The rows and the report."""
    (total,) = result.table
    result.write_csv(path)
    path.with_suffix(".md").write_text(REPORT.format(**total, rate=rate))


def _show(done: int, total: int) -> None:
    if done % 50 == 0:
        sys.stderr.write(f"{done} of {total}\n")


if __name__ == "__main__":
    main()
