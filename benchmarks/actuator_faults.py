"""Thrusters that fail, found and named: ``python benchmarks/actuator_faults.py [--seeds N] [--free
N]``.

Writes actuator_faults.csv, one row per robot and kind, and actuator_faults.md.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from actuators.hovering import Hover, Outcome, ThrusterFault, run
from recording.report import Report, Row, Table, begin, parser_of

from uvms_ocp.control.faults.verdicts import ActuatorHealth

ROBOTS = {"girona_maris7_full": 150.0, "bluerov2_alpha5": 40.0}
KINDS = ("dead", "weak", "stuck", "reversed")
WRONG = ((1.0, 1.0), (0.8, 0.8), (1.2, 1.2), (0.8, 1.2), (1.2, 0.8))
PROSE = """
Each thruster fails in {seeds} runs of {duration:g} s per kind, amid small manoeuvres in a gusty
current, with the noise of the sensors. Weak gives half of what it is asked; stuck gives a share of
its limit, either way. Fault-free runs: {free} a robot, in gusts, with added mass and drag that are
not what the controller knows.
"""


def fault_of(kind: str, thruster: int, seed: int, limit: float) -> ThrusterFault:
    """The one of that kind; limit [N]."""
    rng = np.random.default_rng(100 * seed + thruster)
    onset = 8.0 + 3.0 * float(rng.uniform())
    share = {"dead": 0.0, "weak": 0.5, "stuck": 0.0, "reversed": -1.0}[kind]
    constant = 0.0
    if kind == "stuck":
        constant = float(rng.choice([-1.0, 1.0]) * rng.uniform(0.1, 0.4)) * limit
    return ThrusterFault(thruster=thruster, share=share, constant=constant, onset=onset)


def faulty_runs(
    robot: str, kind: str, seeds: int, duration: float, thrusters: int
) -> Iterator[tuple[ThrusterFault, Outcome]]:
    """Run all faults of one kind, thruster by thruster and seed by seed."""
    for seed in range(seeds):
        for i in range(thrusters):
            fault = fault_of(kind, i, seed, ROBOTS[robot])
            hover = Hover(
                robot=robot,
                seed=1000 * seed + i,
                faults=(fault,),
                duration=duration,
                current=(0.5, 0.3)[i % 2],
            )
            yield fault, run(hover)


def row_of(robot: str, kind: str, runs: list[tuple[ThrusterFault, Outcome]]) -> Row:
    """Figures of all runs of one kind."""
    times = []
    right = 0
    wrong = 0
    for fault, outcome in runs:
        assert outcome.monitor is not None
        verdicts = outcome.monitor.thrusters
        name = f"thruster{fault.thruster + 1} "
        alarm_times = [t for t, text in outcome.alarms if text.startswith(name)]
        if alarm_times:
            times.append(alarm_times[0] - fault.onset)
        right += verdicts[fault.thruster].kind.word == kind
        for i, verdict in enumerate(verdicts):
            if i != fault.thruster and verdict.health is ActuatorHealth.FAULTY:
                wrong += 1
                break
    return {
        "robot": robot,
        "kind": kind,
        "runs": len(runs),
        "thruster found": len(times),
        "kind right at the end": right,
        "another thruster named": wrong,
        "median time [s]": float(np.median(times)) if times else float("nan"),
    }


def free_row(robot: str, n: int, duration: float) -> Row:
    """Figures of runs without a fault."""
    alarms = 0
    for seed in range(n):
        hover = Hover(
            robot=robot,
            seed=seed,
            duration=duration,
            moves=1.0 if seed % 3 else 0.3,
            current=(0.5, 0.3, 0.5, 0.1)[seed % 4],
            gusts=(0.05, 0.1)[seed % 2],
            wrong=WRONG[seed % 5],
        )
        alarms += bool(run(hover).alarms)
    return {"robot": robot, "runs": n, "with an alarm": alarms}


def main() -> None:
    """Run all."""
    parser = parser_of(__doc__)
    parser.add_argument(
        "--seeds", type=int, default=2, metavar="N", help="runs of each thruster and kind"
    )
    parser.add_argument(
        "--free", type=int, default=100, metavar="N", help="runs without a fault, per robot"
    )
    arguments, bench = begin(parser)
    if bench.quick:
        seeds = 1
        free = 1
        duration = 2.0
        thrusters = 1
    else:
        seeds = arguments.seeds
        free = arguments.free
        duration = 30.0
        thrusters = 8
    rows = []
    for robot in ROBOTS:
        for kind in KINDS:
            runs = list(faulty_runs(robot, kind, seeds, duration, thrusters))
            rows.append(row_of(robot, kind, runs))
    sound = [free_row(robot, free, duration) for robot in ROBOTS]
    columns = dict.fromkeys(rows[0], "") | {"median time [s]": ".1f"}
    bench.write(
        Report(
            name="actuator_faults",
            title="Thrusters that fail",
            prose=PROSE.format(seeds=seeds, duration=duration, free=free),
            tables=[
                Table(rows=rows, columns=columns),
                Table(rows=sound, columns=dict.fromkeys(sound[0], "")),
            ],
            data={"actuator_faults": rows},
        )
    )


if __name__ == "__main__":
    main()
