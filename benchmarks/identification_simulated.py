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

from uvms_ocp.identification.experiment_design import (
    DesignSettings,
    Excitation,
    ExperimentTask,
    design_experiment,
    simulate_commands,
)
from uvms_ocp.identification.fit import Search, search_fit
from uvms_ocp.identification.model import Vehicle, stage_of
from uvms_ocp.identification.rollout import PreparedRecording, Rollout
from uvms_ocp.identification.uncertainty import (
    DETERMINED_BELOW,
    INTERVAL,
    SIZES,
    IdentifiedNumber,
    numbers,
    values_of,
)

ROBOTS = 20
RECORDINGS = 5
DURATION = 60.0
""", of each, [s] of one."""
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
    one: Vehicle,
    rollout: Rollout,
    truth: np.ndarray,
    driven: Excitation,
    seed: int,
    recordings: int,
    search: Search,
) -> list[Row]:
    """A row for each number of one vehicle with unknowns truth (n,) [as `Unknowns.start`]."""
    rng = np.random.default_rng(seed)
    names = [f"drawn{k}" for k in range(recordings)]
    found = [recorded(one, rollout.stage, truth, rng, driven.commands, name) for name in names]
    begun = process_time()
    estimate = search_fit(
        one, [PreparedRecording.of(each, one) for each in found], NOISE, rollout, search
    )
    taken = process_time() - begun
    off = estimate.shared - truth
    same = {
        "robot": seed,
        "status": estimate.status.value,
        "time [s]": taken,
        "weighed": float(off @ estimate.information @ off) / len(off),
    }
    pairs = zip(numbers(one, estimate), values_of(one, truth), strict=True)
    return [{**_row(told, float(wanted)), **same} for told, wanted in pairs]


def _row(told: IdentifiedNumber, truth: float) -> Row:
    least, most = told.interval
    return {
        "unknown": told.name,
        "truth": truth,
        "estimate": told.value,
        "standard error [%]": 100.0 * told.sigma / told.size,
        "error [%]": 100.0 * abs(told.value - truth) / told.size,
        "determined": told.determined,
        "inside": least <= truth <= most,
    }


def by_unknown(rows: Sequence[Row]) -> list[Row]:
    """How often each is determined, right, and how well."""
    names = dict.fromkeys(row["unknown"] for row in rows)
    return [_summary(name, [row for row in rows if row["unknown"] == name]) for name in names]


def _summary(name: str, rows: Sequence[Row]) -> Row:
    known = [row for row in rows if row["determined"]]
    return {
        "unknown": name,
        "determined [%]": 100.0 * len(known) / len(rows),
        "inside [%]": _inside(known),
        "median error [%]": _error(known),
        "median standard error [%]": float(np.median([row["standard error [%]"] for row in rows])),
    }


def _inside(rows: Sequence[Row]) -> float | None:
    return 100.0 * float(np.mean([row["inside"] for row in rows])) if rows else None


def _error(rows: Sequence[Row]) -> float | None:
    return float(np.median([row["error [%]"] for row in rows])) if rows else None


def main() -> None:
    """Design, draw, drive and identify."""
    _, run = begin(parser_of(__doc__))
    one = vehicle()
    robots, recordings, search = (
        (1, 1, replace(SEARCH, iterations=1)) if run.quick else (ROBOTS, RECORDINGS, SEARCH)
    )
    given = ExperimentTask(
        vehicle=one, limits=limits(one), duration=6.0 if run.quick else DURATION, noise=NOISE
    )
    rollout = Rollout(stage_of(one))
    driven = design_experiment(
        given, rollout, DesignSettings(iterations=1, starts=1) if run.quick else None
    )
    truths = drawn(one, np.random.default_rng(0), robots)
    rows = [
        row
        for k, truth in enumerate(truths)
        for row in identified(one, rollout, truth, driven, k, recordings, search)
    ]
    states = [simulate_commands(given, rollout, driven.commands, truth) for truth in truths]
    inside = sum(not given.limits.beyond(each, margin=0.0)[0].any() for each in states)
    summary = by_unknown(rows)
    form = {
        "unknown": "",
        **dict.fromkeys([name for name in summary[0] if name != "unknown"], ".1f"),
    }
    title = "Identification of simulated vehicles"
    name = "identification_simulated"
    prose = PROSE.format(
        **told(given, rows, summary), robots=robots, recordings=recordings, inside=inside
    )
    run.write(
        Report(
            name=name,
            title=title,
            prose=prose,
            tables=[Table(rows=summary, columns=form)],
            data={name: rows},
        )
    )


def told(given: ExperimentTask, rows: Sequence[Row], summary: Sequence[Row]) -> dict[str, object]:
    """Figures of the prose."""
    known = [row for row in rows if row["determined"]]
    weighed = [row["weighed"] for row in rows if row["unknown"] == rows[0]["unknown"]]
    open_ones = [str(row["unknown"]) for row in summary if row["determined [%]"] <= 50.0]
    return {
        "duration": given.duration,
        "pool": " x ".join(f"{side:g}" for side in given.limits.pool[1] - given.limits.pool[0]),
        "velocity": VELOCITY,
        "rate": RATE,
        "vertical": VERTICAL,
        "covered": _inside(known),
        "known": 100.0 * DETERMINED_BELOW,
        "length": 1e2 * SIZES["m"],
        "time": 1e3 * SIZES["s"],
        "share": 100.0 * erf(INTERVAL / sqrt(2.0)),
        "error": _error(known),
        "open": len(open_ones),
        "named": f" ({', '.join(open_ones)})" if open_ones else "",
        "n": len(summary),
        "seconds": float(np.median([row["time [s]"] for row in rows])),
        "weighed": float(np.mean(weighed)),
        "least": min(weighed),
        "most": max(weighed),
    }


if __name__ == "__main__":
    main()
