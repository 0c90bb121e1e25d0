"""Case 1 with everything uncertain: ``python benchmarks/campaign_case1.py [--runs N] [--work
FOLDER] [--workers N]``.

Writes campaign_case1.csv, one row per run, and campaign_case1.md with rates, causes and
sensitivities. Killed and started again with the same --work, it goes on where it was.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from time import perf_counter
from typing import Any

from campaigns.case1_runs import BRIEF, VARIATIONS, brief_case1, noisy_case1
from recording.report import Report, Row, Table, begin, parser_of
from recording.rows import rows_where

from uvms_ocp.campaign import Campaign, campaign_report, read_table
from uvms_ocp.campaign.success_criteria import parse_bounds

PROSE = """
{runs} runs on the {plant} plant, drawn by a Sobol' sequence of seed {seed}: {parameters}. The
controller knows the nominal robot and sensors.

Counted strictly, with every goal of every phase truly reached: {strict}. A phase ends when the
estimate is below its limit, on whichever side the truth is. Counted as a mission that is finished
with the tool truly within {useful_mm:.0f} mm: {useful}.

{took}

PAWN above its floor tells that a parameter matters, `rank` is Spearman's correlation.
"""
_USEFUL_ERROR = 0.01  # [m]
_USEFUL = f"tool_position_error_m<{_USEFUL_ERROR}"
_TOP = 6


def throughput(variations: Any, runs: int, folder: Path, workers: int) -> float:
    """Runs per second [1/s] of one campaign of `runs` on `workers`, from the first row to the
    last.
    """
    times: list[tuple[float, int]] = []
    campaign = Campaign(scenario=noisy_case1, variations=variations, runs=runs, seed=1)

    def note_time(done: int, failed: int, total: int) -> None:
        times.append((perf_counter(), done))

    campaign.run(folder, workers=workers, progress=note_time)
    begin_time, done_before = next((time, done) for time, done in times if done >= workers)
    end_time, _ = times[-1]
    return (runs - done_before) / (end_time - begin_time)


def causes(report: dict[str, Any]) -> list[Row]:
    """List the most frequent causes with their intervals."""
    return [
        {
            "outcome": row["outcome"],
            "cause": row["cause"],
            "runs": row["number"],
            "share [%]": 100 * row["share"],
            "from [%]": 100 * row["lower"],
            "to [%]": 100 * row["upper"],
            "such as run": row["run"],
        }
        for row in report["causes"]
    ]


def sensitivities(report: dict[str, Any]) -> list[Row]:
    """List the parameters that matter most for success and for the main figures."""
    rows: list[Row] = []
    for figure in ("success", "tool_position_error_m", "energy_j", "duration_s"):
        parameters = rows_where(report["sensitivity"], "figure", figure)
        for row in sorted(parameters, key=lambda row: -row["pawn"])[:_TOP]:
            rows.append(
                {
                    "figure": row["figure"],
                    "parameter": row["parameter"],
                    "PAWN": row["pawn"],
                    "floor": row["pawn_floor"],
                    "rank": row["rank_correlation"],
                }
            )
    return rows


def main() -> None:
    """Run the campaign, or what is left of it."""
    parser = parser_of(__doc__)
    parser.add_argument("--runs", type=int, default=2000, metavar="N")
    parser.add_argument(
        "--work",
        type=Path,
        metavar="FOLDER",
        help="of the campaign, kept; default: a temporary one",
    )
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, metavar="N")
    arguments, run = begin(parser)
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.work or Path(temporary)
        if run.quick:
            maker = brief_case1
            variations = BRIEF
            runs = 4
            workers = 1
        else:
            maker = noisy_case1
            variations = VARIATIONS
            runs = arguments.runs
            workers = arguments.workers
        campaign = Campaign(scenario=maker, variations=variations, runs=runs)
        campaign.run(folder / "campaign", workers=workers)
        times = read_table(folder / "campaign")["wall_s"]
        took = f"The runs took {times.sum():.0f} s of the workers' time, {workers} at a time."
        if not run.quick:
            n = min(100, runs)
            alone = throughput(variations, n, Path(temporary, "workers1"), 1)
            together = throughput(variations, n, Path(temporary, "workers2"), 2)
            took += (
                f" Two workers make {together / alone:.2f} times as many runs in a second as one"
                f" ({together:.2f} and {alone:.2f})."
            )
        report = campaign_report(folder / "campaign", parse_bounds([_USEFUL]))
        strict = campaign_report(folder / "campaign")
        table = read_table(folder / "campaign").drop(columns=["worker"])
    prose = PROSE.format(
        runs=runs,
        plant="kinematic" if run.quick else "dynamic",
        seed=campaign.seed,
        parameters="; ".join(f"{name} {text}" for name, text in report["parameters"].items()),
        strict=strict["success_text"],
        useful=report["success_text"],
        useful_mm=1e3 * _USEFUL_ERROR,
        took=took,
    )
    names = ("figure", "runs", "least", "5 %", "median", "95 %", "largest")
    spread = []
    for row in report["distributions"]:
        spread.append({name: row[name] for name in names})
    all_rows = (causes(strict), causes(report), spread, sensitivities(report))
    tables = [Table(rows=rows) for rows in all_rows if rows]
    data = {"campaign_case1": table.to_dict("records")}
    run.write(
        Report(
            name="campaign_case1", title="Case 1, uncertain", prose=prose, tables=tables, data=data
        )
    )


if __name__ == "__main__":
    main()
