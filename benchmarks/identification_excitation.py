"""Designed excitation against steps and chirps by hand: ``python benchmarks/identification_excitation.py``.

All of one length, within the same limits of thrust and the same pool. Standard errors are compared
as the information has them, and as fits of simulated recordings have them. Writes
identification_excitation.csv and identification_excitation.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from time import process_time

import numpy as np
from drawn_vehicles.driving import LEARNT, NOISE, drawn, limits, recorded, vehicle
from recording.report import Report, Row, Table, begin, parser_of

from uvms_ocp.identification.experiment_design import (
    BY_HAND,
    HALF,
    DesignSettings,
    DesignStatus,
    Excitation,
    ExperimentTask,
    design_experiment,
    largest,
)
from uvms_ocp.identification.fit import Search, search_fit
from uvms_ocp.identification.model import stage_of
from uvms_ocp.identification.rollout import PreparedRecording, Rollout
from uvms_ocp.identification.uncertainty import (
    DETERMINED_BELOW,
    TOTAL,
    IdentifiedNumber,
    numbers,
    values_of,
)

DURATION = 60.0
VEHICLES = 8
SINGLE = 3
"""[s] of a recording; whose recordings are fitted; numbers that a design is made for alone."""
DESIGNED = "designed"
ALONE = "alone"
"""A kind of excitation; what one for a single number would tell of it."""
SEARCH = Search(step=0.005)
LITTLE = DesignSettings(iterations=1, starts=1)
"""To see that it runs."""
SCALED = ("mass", "gain")
"""Quantities that are known here: with the motion alone, forces and masses are known but for a
common factor.
"""
PROSE = """
A vehicle like a BlueROV2 without its arm, from rest, for {duration:g} s, with {thrust:g} N of each
thruster, {slew:g} N/s, and a pool of {pool} m. Mass and gains of the thrusters are known: motions
tell forces and masses but for a common factor, and how well that is known is the same for every
excitation. All else of the vehicle is learnt. By hand are steps of full thrust of one axis after
the other, chirps likewise, and drawn steps of all axes with chirps beside them, flown with a spring
that keeps the vehicle in the pool, and as large as the pool allows.

The design is asked for half the standard error of the best of these, number by number, and looks
most at those that are farthest from it. Of {n} numbers that are determined (standard error below
{known:.0f} % of their size), it has {median:.2f} times that standard error in the median, and
{most:.2f} times in the worst, {worst}; {half:.0f} % have at most half. Of the {single} that are
farthest, a design for that number alone, where nothing else matters, has: {possible}. Against each
of them alone: {alone}.

Fits of simulated recordings, of {vehicles} vehicles with drawn numbers that nobody knew when
commands were made: errors of the same numbers have a root mean square of {fitted:.2f} times those
after "{best}", the best by hand, in the median over the numbers.

The design takes {seconds:.0f} s of a processor. The root mean square of thrust is {roots}. Whether
they stay in the pool, as simulated: {inside}.
"""


def main() -> None:
    """Design, compare, simulate and fit."""
    _, run = begin(parser_of(__doc__))
    given, rollout = assignment(6.0 if run.quick else DURATION)
    vehicles, search = (1, replace(SEARCH, iterations=1)) if run.quick else (VEHICLES, SEARCH)
    begun = process_time()
    found = {DESIGNED: design_experiment(given, rollout, LITTLE if run.quick else None)}
    seconds = process_time() - begun
    found |= {name: largest(given, rollout, name) for name in BY_HAND}
    table = compared(found)
    best = min(BY_HAND, key=lambda name: float(np.median([row[name] for row in table])))
    single = alone(given, rollout, farthest(table)[: 1 if run.quick else SINGLE], run.quick)
    fits = fitted(
        given, rollout, {kind: found[kind] for kind in (DESIGNED, best)}, vehicles, search
    )
    rows = [
        {**row, ALONE: single.get(row["number"]), "fitted": fits[row["number"]]} for row in table
    ]
    title = "Excitation of a vehicle that is identified"
    name = "identification_excitation"
    prose = PROSE.format(**told(given, found, rows), seconds=seconds, best=best, vehicles=vehicles)
    form = {"number": "", **dict.fromkeys((*found, ALONE, "fitted"), ".2f")}
    run.write(
        Report(
            name=name,
            title=title,
            prose=prose,
            tables=[Table(rows=rows, columns=form)],
            data={name: rows},
        )
    )


def assignment(duration: float) -> tuple[ExperimentTask, Rollout]:
    """The vehicle and its pool, for recordings of some duration [s]."""
    one = vehicle({name: status for name, status in LEARNT.items() if name not in SCALED})
    return ExperimentTask(vehicle=one, limits=limits(one), duration=duration, noise=NOISE), Rollout(
        stage_of(one)
    )


def compared(found: Mapping[str, Excitation]) -> list[Row]:
    """Standard errors [%] of what the design determines, by each kind of excitation."""
    chosen = [each.name for each in found[DESIGNED].numbers if each.determined]
    by_kind = {kind: {each.name: each for each in one.numbers} for kind, one in found.items()}
    return [
        {"number": name, **{kind: _share(told[name]) for kind, told in by_kind.items()}}
        for name in chosen
    ]


def _share(one: IdentifiedNumber) -> float:
    return 100.0 * one.sigma / one.size


def ratio(row: Row, kind: str = DESIGNED) -> float:
    """Standard error over that of the best by hand."""
    return float(row[kind] / min(row[name] for name in BY_HAND))


def farthest(rows: Sequence[Row]) -> list[Row]:
    """Rows by their ratio, the largest first; with the mass known, sums with it tell what added
    masses tell.
    """
    return sorted(
        (row for row in rows if not row["number"].startswith(TOTAL)), key=ratio, reverse=True
    )


def alone(
    given: ExperimentTask, rollout: Rollout, rows: Sequence[Row], quick: bool
) -> dict[str, float]:
    """Standard errors [%] of single numbers where nothing else matters."""
    names = [row["number"] for row in rows]
    found = {
        name: design_experiment(replace(given, matter=(name,)), rollout, LITTLE if quick else None)
        for name in names
    }
    return {
        name: _share(next(each for each in one.numbers if each.name == name))
        for name, one in found.items()
    }


def fitted(
    given: ExperimentTask, rollout: Rollout, found: Mapping[str, Excitation], n: int, search: Search
) -> dict[str, float]:
    """Root mean square error after the design, over that by hand, of each number, as n drawn
    vehicles have it.
    """
    truths = drawn(given.vehicle, np.random.default_rng(0), n)
    squares = {
        kind: np.mean(
            [
                _errors(given, rollout, truth, one, seed, search) ** 2
                for seed, truth in enumerate(truths)
            ],
            axis=0,
        )
        for kind, one in found.items()
    }
    less = np.sqrt(
        squares[DESIGNED] / next(part for kind, part in squares.items() if kind != DESIGNED)
    )
    return dict(zip([each.name for each in found[DESIGNED].numbers], less.tolist(), strict=True))


def _errors(
    given: ExperimentTask,
    rollout: Rollout,
    truth: np.ndarray,
    one: Excitation,
    seed: int,
    search: Search,
) -> np.ndarray:
    """(m,) of all numbers, by their sizes."""
    recording = recorded(
        given.vehicle, rollout.stage, truth, np.random.default_rng(seed), one.commands
    )
    estimate = search_fit(
        given.vehicle, [PreparedRecording.of(recording, given.vehicle)], NOISE, rollout, search
    )
    pairs = zip(numbers(given.vehicle, estimate), values_of(given.vehicle, truth), strict=True)
    return np.array([(told.value - wanted) / told.size for told, wanted in pairs])


def told(
    given: ExperimentTask, found: Mapping[str, Excitation], rows: Sequence[Row]
) -> dict[str, object]:
    """Figures of the prose."""
    ratios = np.array([ratio(row) for row in rows])
    single = farthest([row for row in rows if row[ALONE] is not None])
    sides = given.limits.pool[1] - given.limits.pool[0]
    return {
        "duration": given.duration,
        "thrust": given.limits.thrust.max(),
        "slew": given.limits.slew,
        "pool": " x ".join(f"{side:g}" for side in sides),
        "n": len(rows),
        "known": 100.0 * DETERMINED_BELOW,
        "median": np.median(ratios),
        "most": ratios.max(),
        "worst": rows[int(ratios.argmax())]["number"],
        "half": 100.0 * (ratios <= HALF).mean(),
        "single": len(single),
        "possible": ", ".join(f"{ratio(row, ALONE):.2f} ({row['number']})" for row in single),
        "alone": _ratios(rows, list(BY_HAND)),
        "fitted": np.median([row["fitted"] for row in rows]),
        "roots": ", ".join(f"{_root(one):.1f} N ({name})" for name, one in found.items()),
        "inside": ", ".join(f"{name}: {_inside(one)}" for name, one in found.items()),
    }


def _ratios(rows: Sequence[Row], names: Sequence[str]) -> str:
    ratios = {name: [row[DESIGNED] / row[name] for row in rows] for name in names}
    return ", ".join(
        f"{name} {np.median(one):.2f} (worst {max(one):.2f})" for name, one in ratios.items()
    )


def _root(one: Excitation) -> float:
    return float(np.sqrt((one.commands.values**2).mean()))


def _inside(one: Excitation) -> str:
    return "yes" if one.status is DesignStatus.INSIDE else "no"


if __name__ == "__main__":
    main()
