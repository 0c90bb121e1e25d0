"""A patrol that lasts: ``python benchmarks/patrol.py [--hours H] [--kills N]``.

A BlueROV2 goes out and home for a day, with noise, a current, and faults of a thruster and of
sensors that come and go; rows go to a folder, one a second. Before that it is killed at random
moments, and what is left is opened. Writes patrol.csv and patrol.md.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from resource import RUSAGE_SELF, getrusage
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pinocchio as pin
from recording.report import Report, Row, Table, begin, parser_of

from uvms_ocp.mission import Above, Below, Phase, Transition
from uvms_ocp.record.meta_values import DONE
from uvms_ocp.record.record import Record
from uvms_ocp.scenario import Scenario, reach

PROSE = """
`uvms_ocp.scenario.reach` with two phases in place of its own, {way:g} m out and home, where it
stays for {rest:g} s, until {hours:g} h are nearly over; {rate:g} ticks a second, a row a second.
Faults: {faults}. *peak_mb*: the most memory of the process; *killed_after_s*: from its first rows
on, and the time of the last row that can be opened; what is left says of itself that it was cut
off.
"""
WAY = 3.0  # [m] out
REST = 30.0  # [s] for which it stays at home
FAULTS = (
    "thruster3:weak=0.6@{0:g}-{1:g}",
    "linear_velocity:lost@{2:g}-{3:g}",
    "position:spikes=3,0.05@{4:g}-{5:g}",
    "attitude:late=0.05@{6:g}-{7:g}",
)
SHARES = (0.1, 0.2, 0.3, 0.3, 0.4, 0.5, 0.6, 0.7)
_LOST = 8.0  # [s]


def patrol(seconds: float) -> Scenario:
    """Out and home until so many seconds are nearly over."""
    arrived = Below(quantity="PC.position_error", limit=0.15)
    over = Transition(to=DONE, when=(Above(quantity="mission.time", limit=0.99 * seconds),))
    times = [share * seconds for share in SHARES]
    times[3] += _LOST
    scenario = reach(
        noise=True,
        current=(0.1, 0.05, 0.0),
        seed=4,
        duration=seconds,
        record_rate=1.0,
        faults=tuple(text.format(*times) for text in FAULTS),
    )
    rested = Above(quantity="phase.time", limit=min(REST, 0.1 * seconds))
    out = _way("out", WAY, over, Transition(to="home", when=(arrived,)))
    home = _way("home", 0.0, over, Transition(to="out", when=(arrived, rested)))
    return replace(scenario, mission=replace(scenario.mission, phases=(out, home)))


def _way(name: str, x: float, *transitions: Transition) -> Phase:
    gates = dict.fromkeys(("JL", "MAC", "HA", "PC"), 1.0)
    goal = pin.SE3(np.eye(3), np.array([x, 0.0, -5.0]))
    return Phase(name=name, activations=gates, goals={"PC": goal}, transitions=transitions)


def flown(seconds: float, folder: Path) -> Row:
    """Run it, in this process."""
    begin = time.process_time()
    record = patrol(seconds).run(folder=folder)
    spent = time.process_time() - begin
    meta = record.run_meta
    return {
        "simulated_s": float(record["t"][-1]),
        "completed": meta.completed,
        "processor_s": spent,
        "real_time": float(record["t"][-1]) / spent,
        "peak_mb": getrusage(RUSAGE_SELF).ru_maxrss / 1e3,
        "disk_mb": sum(path.stat().st_size for path in folder.iterdir()) / 1e6,
        "events": len(meta.events),
        "alarms": len(meta.alarms),
    }


def killed(seconds: float, folder: Path, after: float) -> Row:
    """Kill it some time [s] after its first rows, and open what is left."""
    process = subprocess.Popen(_command(seconds, folder), stdout=subprocess.DEVNULL)
    while process.poll() is None and not (folder / "meta.json").exists():
        time.sleep(0.05)
    time.sleep(after)
    process.kill()
    process.wait()
    record = Record.load(folder)
    return {
        "killed_after_s": after,
        "last_row_s": float(record["t"][-1]),
        "says": record.run_meta.stopped,
    }


def _command(seconds: float, folder: Path) -> list[str]:
    return [sys.executable, __file__, "--one", f"{seconds:g}", str(folder)]


def main() -> None:
    """Kill a few, and fly one to its end."""
    if sys.argv[1:2] == ["--one"]:
        sys.stdout.write(json.dumps(flown(float(sys.argv[2]), Path(sys.argv[3]))))
        return
    parser = parser_of(__doc__)
    parser.add_argument("--hours", type=float, default=24.0, metavar="H", help="simulated")
    parser.add_argument("--kills", type=int, default=3, metavar="N")
    arguments, run = begin(parser)
    if run.quick:
        hours = 0.01
        kills = 1
        shortest = 0.0
        longest = 0.1
    else:
        hours = arguments.hours
        kills = arguments.kills
        shortest = 1.0
        longest = 20.0
    seconds = 3600.0 * hours
    waits = np.random.default_rng(0).uniform(shortest, longest, size=kills)
    with TemporaryDirectory() as place:
        rows: list[Any] = []
        for k, wait in enumerate(waits):
            rows.append(killed(seconds, Path(place, f"killed{k}"), float(wait)))
        whole = _command(seconds, Path(place, "whole"))
        process = subprocess.run(whole, capture_output=True, check=True, text=True)
    tables = [Table(rows=[json.loads(process.stdout)]), Table(rows=rows)]
    scenario = patrol(seconds)
    faults = ", ".join(f"`{fault}`" for fault in scenario.faults)
    prose = PROSE.format(hours=hours, way=WAY, rest=REST, rate=1.0 / scenario.dt, faults=faults)
    run.write(Report(name="patrol", title="A patrol that lasts", prose=prose, tables=tables))


if __name__ == "__main__":
    main()
