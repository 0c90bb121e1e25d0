"""Identification of vehicles whose numbers are known: ``python benchmarks/identification_simulated.py``.

Vehicles with drawn numbers are driven by a designed excitation, again and again, seen by noisy
sensors, and identified from where all of them were drawn. Writes identification_simulated.csv and
identification_simulated.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import erf, sqrt
from time import process_time

import numpy as np
from drawn_vehicles.driving import NOISE, RATE, VELOCITY, VERTICAL, drawn, limits, recorded, vehicle
from recording.report import Report, Row, Table, begin, parser_of
from recording.rows import column, rows_where

from uvms_ocp.identification.experiment_design import (
    DesignSettings,
    Excitation,
    ExperimentTask,
    design_experiment,
    simulate_commands,
)
from uvms_ocp.identification.fit import Search, search_fit
from uvms_ocp.identification.identified_numbers import (
    DETERMINED_BELOW,
    INTERVAL,
    SIZES,
    IdentifiedNumber,
    numbers,
    values_of,
)
from uvms_ocp.identification.model import Vehicle, stage_of
from uvms_ocp.identification.rollout import Rollout
from uvms_ocp.identification.segments import PreparedRecording

ROBOTS = 20
RECORDINGS = 5  # of each robot
DURATION = 60.0  # [s] of a recording
SEARCH = Search(step=0.005)
"""Longer steps move delays by more than five minutes leave open: by their square over eight
lags.
"""
PROSE = """
{robots} vehicles like a BlueROV2 without its arm, with drawn numbers, and {recordings} recordings
of {duration:g} s of each, all with the same excitation: one that was designed for the vehicle as it
is believed to be, for a pool of {pool} m, in which {inside} of the others stay too. Sensors have a
noise of {velocity:g} m/s, {rate:g} rad/s and {vertical:g} in the vertical, ten times a second;
thrusters have a lag, and commands and velocities a delay, which are drawn too. Beliefs of a number
have {robots} parts that are equally likely, and one vehicle in each. A number is called determined
where its standard error is below {known:.0f} % of its size, lengths and times relative to
{length:g} cm and {time:g} ms. Of these, {covered:.0f} % lie within their {share:.0f} % intervals,
with a median error of {error:.1f} %; {open} of {n} numbers are called undetermined in half of the
vehicles or more{named}. A vehicle takes {seconds:.0f} s of a processor in the median.

Numbers of one vehicle are not independent of each other: all forces and masses are known but for a
factor, which priors alone tell. Squares of errors, weighed by the information, are {weighed:.2f}
times what is expected of them, by vehicle from {least:.2f} to {most:.2f}.
"""


def identified(
    auv: Vehicle,
    rollout: Rollout,
    truth: np.ndarray,
    driven: Excitation,
    seed: int,
    recordings: int,
    search: Search,
) -> list[Row]:
    """A row for each number of one vehicle with unknowns truth (n,) [as `Unknowns.start`]."""
    rng = np.random.default_rng(seed)
    measured = []
    for k in range(recordings):
        measured.append(recorded(auv, rollout.stage, truth, rng, driven.commands, f"drawn{k}"))
    begun = process_time()
    prepared = [PreparedRecording.of(recording, auv) for recording in measured]
    estimate = search_fit(auv, prepared, NOISE, rollout, search)
    duration = process_time() - begun
    error = estimate.shared - truth
    common = {
        "robot": seed,
        "status": estimate.status.value,
        "time [s]": duration,
        "weighed": float(error @ estimate.information @ error) / len(error),
    }
    rows = list[Row]()
    for number, true in zip(numbers(auv, estimate), values_of(auv, truth), strict=True):
        rows.append({**_row(number, float(true)), **common})
    return rows


def _row(number: IdentifiedNumber, truth: float) -> Row:
    lower, upper = number.interval
    return {
        "unknown": number.name,
        "truth": truth,
        "estimate": number.value,
        "standard error [%]": 100.0 * number.sigma / number.size,
        "error [%]": 100.0 * abs(number.value - truth) / number.size,
        "determined": number.determined,
        "inside": lower <= truth <= upper,
    }


def by_unknown(rows: Sequence[Row]) -> list[Row]:
    """How often each is determined, right, and how well."""
    names = dict.fromkeys(column(rows, "unknown"))
    return [_summary(name, rows_where(rows, "unknown", name)) for name in names]


def _summary(name: str, rows: Sequence[Row]) -> Row:
    determined = rows_where(rows, "determined", True)
    return {
        "unknown": name,
        "determined [%]": 100.0 * len(determined) / len(rows),
        "inside [%]": _inside(determined),
        "median error [%]": _error(determined),
        "median standard error [%]": float(np.median(column(rows, "standard error [%]"))),
    }


def _inside(rows: Sequence[Row]) -> float | None:
    if not rows:
        return None
    return 100.0 * float(np.mean(column(rows, "inside")))


def _error(rows: Sequence[Row]) -> float | None:
    if not rows:
        return None
    return float(np.median(column(rows, "error [%]")))


def main() -> None:
    """Design, draw, drive and identify."""
    _, run = begin(parser_of(__doc__))
    if run.quick:
        robots = 1
        recordings = 1
        duration = 6.0
        search = replace(SEARCH, iterations=1)
        settings = DesignSettings(iterations=1, starts=1)
    else:
        robots = ROBOTS
        recordings = RECORDINGS
        duration = DURATION
        search = SEARCH
        settings = None
    auv = vehicle()
    experiment = ExperimentTask(vehicle=auv, limits=limits(auv), duration=duration, noise=NOISE)
    rollout = Rollout(stage_of(auv))
    driven = design_experiment(experiment, rollout, settings)
    truths = drawn(auv, np.random.default_rng(0), robots)
    rows = list[Row]()
    inside = 0
    for seed, truth in enumerate(truths):
        rows += identified(auv, rollout, truth, driven, seed, recordings, search)
    for truth in truths:
        states = simulate_commands(experiment, rollout, driven.commands, truth)
        beyond, *_ = experiment.limits.beyond(states, margin=0.0)
        inside += not beyond.any()
    summary = by_unknown(rows)
    form = {**dict.fromkeys(summary[0], ".1f"), "unknown": ""}
    name = "identification_simulated"
    prose = PROSE.format(
        **figures(experiment, rows, summary), robots=robots, recordings=recordings, inside=inside
    )
    run.write(
        Report(
            name=name,
            title="Identification of simulated vehicles",
            prose=prose,
            tables=[Table(rows=summary, columns=form)],
            data={name: rows},
        )
    )


def figures(
    experiment: ExperimentTask, rows: Sequence[Row], summary: Sequence[Row]
) -> dict[str, object]:
    """Figures of the prose."""
    determined = rows_where(rows, "determined", True)
    weighed = column(rows_where(rows, "unknown", rows[0]["unknown"]), "weighed")
    undetermined = [str(row["unknown"]) for row in summary if row["determined [%]"] <= 50.0]
    sides = experiment.limits.pool[1] - experiment.limits.pool[0]
    return {
        "duration": experiment.duration,
        "pool": " x ".join(f"{side:g}" for side in sides),
        "velocity": VELOCITY,
        "rate": RATE,
        "vertical": VERTICAL,
        "covered": _inside(determined),
        "known": 100.0 * DETERMINED_BELOW,
        "length": 1e2 * SIZES["m"],
        "time": 1e3 * SIZES["s"],
        "share": 100.0 * erf(INTERVAL / sqrt(2.0)),
        "error": _error(determined),
        "open": len(undetermined),
        "named": f" ({', '.join(undetermined)})" if undetermined else "",
        "n": len(summary),
        "seconds": float(np.median(column(rows, "time [s]"))),
        "weighed": float(np.mean(weighed)),
        "least": min(weighed),
        "most": max(weighed),
    }


if __name__ == "__main__":
    main()
