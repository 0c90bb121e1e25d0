"""Identification of vehicles whose numbers are known: ``python benchmarks/identification_simulated.py``.

Vehicles with drawn numbers are driven by steps and chirps, seen by noisy sensors, and identified from where all of them were
drawn. Writes identification_simulated.csv and identification_simulated.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import erf, sqrt
from time import process_time

import numpy as np
from drawn_vehicles.driving import RATE, VELOCITY, VERTICAL, drawn, recorded, vehicle
from recording.report import Report, Row, Table, begin, parser_of

from uvms_ocp.identification.answers.numbers import INTERVAL, KNOWN, SIZES, Number, numbers, values_of
from uvms_ocp.identification.methods.output_error import Noise
from uvms_ocp.identification.methods.rollout import Rollout
from uvms_ocp.identification.methods.search import Search, searched
from uvms_ocp.identification.methods.stretch import Prepared
from uvms_ocp.identification.models.stage import Vehicle, stage_of

ROBOTS, DURATION = 20, 300.0
"""[-], [s]."""
NOISE = Noise(velocity=VELOCITY, rate=RATE, vertical=VERTICAL, process=0.02, start=0.05)
SEARCH = Search(step=0.01)
"""Steps of 0.02 s move lags by 1 ms, which is more than five minutes leave open."""
PROSE = """
{robots} vehicles like a BlueROV2 without its arm, with drawn numbers, {duration:g} s of steps and chirps each. Sensors have a
noise of {velocity:g} m/s, {rate:g} rad/s and {vertical:g} in the vertical, at ten samples a second; thrusters have a lag, and
commands and velocities a delay, which are drawn too. A number is called determined where its standard error is below
{known:.0f} % of its size, lengths and times relative to {length:g} cm and {time:g} ms. Of these, {covered:.0f} % lie within
their {share:.0f} % intervals, with a median error of
{error:.1f} %; {open} of {n} numbers are called undetermined in half of the vehicles or more. A vehicle takes {seconds:.0f} s of a
processor in the median.
"""


def identified(one: Vehicle, rollout: Rollout, seed: int, duration: float) -> list[Row]:
    """A row for each number of one vehicle, driven for a duration [s]."""
    rng = np.random.default_rng(seed)
    truth = drawn(one, rng)
    prepared, begun = Prepared.of(recorded(one, rollout.stage, truth, rng, duration), one), process_time()
    estimate = searched(one, [prepared], NOISE, rollout, SEARCH)
    taken, pairs = process_time() - begun, zip(numbers(one, estimate), values_of(one, truth), strict=True)
    return [{"robot": seed, **_row(told, float(wanted)), "status": estimate.status.value, "time [s]": taken}
            for told, wanted in pairs]  # fmt: skip


def _row(told: Number, truth: float) -> Row:
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
    """Draw, drive and identify."""
    _, run = begin(parser_of(__doc__))
    robots, duration = (2, 40.0) if run.quick else (ROBOTS, DURATION)
    one = vehicle()
    rollout = Rollout(stage_of(one))
    rows = [row for seed in range(robots) for row in identified(one, rollout, seed, duration)]
    summary, known = by_unknown(rows), [row for row in rows if row["determined"]]
    prose = PROSE.format(
        robots=robots,
        duration=duration,
        velocity=VELOCITY,
        rate=RATE,
        vertical=VERTICAL,
        covered=_inside(known),
        known=100.0 * KNOWN,
        length=1e2 * SIZES["m"],
        time=1e3 * SIZES["s"],
        share=100.0 * erf(INTERVAL / sqrt(2.0)),
        error=_error(known),
        open=sum(row["determined [%]"] <= 50.0 for row in summary),
        n=len(summary),
        seconds=float(np.median([row["time [s]"] for row in rows])),
    )
    form = {"unknown": "", **dict.fromkeys([name for name in summary[0] if name != "unknown"], ".1f")}
    title, name = "Identification of simulated vehicles", "identification_simulated"
    run.write(
        Report(name=name, title=title, prose=prose, tables=[Table(rows=summary, columns=form)], data={name: rows})
    )


if __name__ == "__main__":
    main()
