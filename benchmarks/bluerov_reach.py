"""Reaching with a small vehicle under five published sets of drag: how many seeded missions complete, and why not.

    python benchmarks/bluerov_reach.py [--seeds 20] [--output results.csv]

The controller keeps the nominal set; the plant gets each of the five, with sensor noise.
"""

from __future__ import annotations

import argparse
import csv
from itertools import product
from multiprocessing import Pool
from pathlib import Path

from uvms_ocp.model.files.library import list_variants
from uvms_ocp.report.summary import summarize
from uvms_ocp.scenarios.reach import reach

ROBOT = "bluerov2_alpha5"


def attempt(job: tuple[int, str | None]) -> dict[str, object]:
    seed, variant = job
    report = summarize(reach(robot=ROBOT, seed=seed, variant=variant).run())
    return {
        "seed": seed,
        "drag": variant or "nominal",
        "completed": report["completed"],
        "simulated_s": round(report["simulated_s"], 2),
        "tool_error_mm": round(1e3 * report["tool_position_error_m"], 2),
        "cause": report["pending"],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    jobs = list(product(range(options.seeds), (None, *list_variants(ROBOT))))
    with Pool() as pool:
        rows = pool.map(attempt, jobs, chunksize=1)
    completed = sum(bool(row["completed"]) for row in rows)
    worst = max(float(str(row["tool_error_mm"])) for row in rows if row["completed"])
    print(f"{completed} of {len(rows)} completed; worst tool error of those {worst:.1f} mm")
    for row in rows:
        if not row["completed"]:
            print(row)
    if options.output:
        with options.output.open("w", newline="") as file:
            writer = csv.DictWriter(file, fieldnames=list(rows[0]))
            writer.writeheader()
            writer.writerows(rows)


if __name__ == "__main__":
    main()
