"""Designed excitation against steps and chirps by hand: ``python benchmarks/identification_excitation.py``.

All of one length, within the same limits of thrust and the same pool. Standard errors are compared
as the information has them, and as fits of simulated recordings have them. Writes
identification_excitation.csv and identification_excitation.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from time import process_time
from typing import Any

import numpy as np
from drawn_vehicles.driving import LEARNT, NOISE, drawn, limits, recorded, vehicle
from recording.report import Report, Row, Table, begin, parser_of
from recording.rows import column

from uvms_ocp.identification.experiment_design import (
    HALF,
    DesignSettings,
    DesignStatus,
    Excitation,
    ExperimentTask,
    design_experiment,
    largest,
)
from uvms_ocp.identification.fit import Search, search_fit
from uvms_ocp.identification.identified_numbers import (
    DETERMINED_BELOW,
    TOTAL,
    IdentifiedNumber,
    numbers,
    values_of,
)
from uvms_ocp.identification.model import stage_of
from uvms_ocp.identification.motions_by_hand import BY_HAND
from uvms_ocp.identification.rollout import Rollout
from uvms_ocp.identification.segments import PreparedRecording

DURATION = 60.0
"""[s] Duration of a recording."""
VEHICLES = 8
"""Drawn vehicles whose recordings are fitted."""
SINGLE = 3
"""Numbers for each of which alone a design is made."""
DESIGNED = "designed"
"""Kind of excitation that is compared with those by hand."""
ALONE = "alone"
"""Column of what a design for a single number would tell of it."""
SEARCH = Search(step=0.005)
LITTLE = DesignSettings(iterations=1, starts=1)
"""Settings of a quick run."""
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
    if run.quick:
        duration = 6.0
        vehicles = 1
        n_single = 1
        search = replace(SEARCH, iterations=1)
        settings = LITTLE
    else:
        duration = DURATION
        vehicles = VEHICLES
        n_single = SINGLE
        search = SEARCH
        settings = None
    experiment, rollout = assignment(duration)
    begun = process_time()
    excitations = {DESIGNED: design_experiment(experiment, rollout, settings)}
    seconds = process_time() - begun
    for name in BY_HAND:
        excitations[name] = largest(experiment, rollout, name)
    table = compared(excitations)
    best = min(BY_HAND, key=lambda name: float(np.median(column(table, name))))
    single = alone(experiment, rollout, farthest(table)[:n_single], settings)
    judged = {kind: excitations[kind] for kind in (DESIGNED, best)}
    fits = fitted(experiment, rollout, judged, vehicles, search)
    rows = []
    for row in table:
        number = row["number"]
        rows.append({**row, ALONE: single.get(number), "fitted": fits[number]})
    prose = PROSE.format(
        **figures(experiment, excitations, rows), seconds=seconds, best=best, vehicles=vehicles
    )
    name = "identification_excitation"
    form = {"number": "", **dict.fromkeys((*excitations, ALONE, "fitted"), ".2f")}
    run.write(
        Report(
            name=name,
            title="Excitation of a vehicle that is identified",
            prose=prose,
            tables=[Table(rows=rows, columns=form)],
            data={name: rows},
        )
    )


def assignment(duration: float) -> tuple[ExperimentTask, Rollout]:
    """The vehicle and its pool, for recordings of some duration [s]."""
    learnt = {name: status for name, status in LEARNT.items() if name not in SCALED}
    auv = vehicle(learnt)
    experiment = ExperimentTask(vehicle=auv, limits=limits(auv), duration=duration, noise=NOISE)
    return experiment, Rollout(stage_of(auv))


def compared(excitations: Mapping[str, Excitation]) -> list[Row]:
    """Standard errors [%] of what the design determines, by each kind of excitation."""
    rows = list[Row]()
    for designed in excitations[DESIGNED].numbers:
        if not designed.determined:
            continue
        row: dict[str, Any] = {"number": designed.name}
        for kind, excitation in excitations.items():
            row[kind] = _share(_number_of(excitation, designed.name))
        rows.append(row)
    return rows


def _number_of(excitation: Excitation, name: str) -> IdentifiedNumber:
    return next(number for number in excitation.numbers if number.name == name)


def _share(number: IdentifiedNumber) -> float:
    return 100.0 * number.sigma / number.size


def ratio(row: Row, kind: str = DESIGNED) -> float:
    """Standard error over that of the best by hand."""
    best = min(row[name] for name in BY_HAND)
    return float(row[kind] / best)


def farthest(rows: Sequence[Row]) -> list[Row]:
    """Rows by their ratio, the largest first; with the mass known, sums with it tell what added
    masses tell.
    """
    no_sums = [row for row in rows if not row["number"].startswith(TOTAL)]
    return sorted(no_sums, key=ratio, reverse=True)


def alone(
    experiment: ExperimentTask,
    rollout: Rollout,
    rows: Sequence[Row],
    settings: DesignSettings | None,
) -> dict[str, float]:
    """Standard errors [%] of single numbers where nothing else matters."""
    errors = {}
    for name in column(rows, "number"):
        single = replace(experiment, matter=(name,))
        excitation = design_experiment(single, rollout, settings)
        errors[name] = _share(_number_of(excitation, name))
    return errors


def fitted(
    experiment: ExperimentTask,
    rollout: Rollout,
    excitations: Mapping[str, Excitation],
    n: int,
    search: Search,
) -> dict[str, float]:
    """Root mean square error after the design, over that by hand, of each number, as n drawn
    vehicles have it.
    """
    truths = drawn(experiment.vehicle, np.random.default_rng(0), n)
    mean_squares = {}
    for kind, excitation in excitations.items():
        squares = []
        for seed, truth in enumerate(truths):
            errors = _errors(experiment, rollout, truth, excitation, seed, search)
            squares.append(errors**2)
        mean_squares[kind] = np.mean(squares, axis=0)
    (by_hand,) = (kind for kind in mean_squares if kind != DESIGNED)
    ratios = np.sqrt(mean_squares[DESIGNED] / mean_squares[by_hand])
    names = [number.name for number in excitations[DESIGNED].numbers]
    return dict(zip(names, ratios.tolist(), strict=True))


def _errors(
    experiment: ExperimentTask,
    rollout: Rollout,
    truth: np.ndarray,
    excitation: Excitation,
    seed: int,
    search: Search,
) -> np.ndarray:
    """(m,) of all numbers, by their sizes."""
    auv = experiment.vehicle
    rng = np.random.default_rng(seed)
    recording = recorded(auv, rollout.stage, truth, rng, excitation.commands)
    prepared = PreparedRecording.of(recording, auv)
    estimate = search_fit(auv, [prepared], NOISE, rollout, search)
    errors = []
    for number, true_value in zip(numbers(auv, estimate), values_of(auv, truth), strict=True):
        errors.append((number.value - true_value) / number.size)
    return np.array(errors)


def figures(
    experiment: ExperimentTask, excitations: Mapping[str, Excitation], rows: Sequence[Row]
) -> dict[str, object]:
    """Figures of the prose."""
    ratios = np.array(list(map(ratio, rows)))
    single = farthest([row for row in rows if row[ALONE] is not None])
    possible = [f"{ratio(row, ALONE):.2f} ({row['number']})" for row in single]
    sides = experiment.limits.pool[1] - experiment.limits.pool[0]
    roots = []
    inside = []
    for name, excitation in excitations.items():
        roots.append(f"{_root(excitation):.1f} N ({name})")
        inside.append(f"{name}: {_inside(excitation)}")
    return {
        "duration": experiment.duration,
        "thrust": experiment.limits.thrust.max(),
        "slew": experiment.limits.slew,
        "pool": " x ".join(f"{side:g}" for side in sides),
        "n": len(rows),
        "known": 100.0 * DETERMINED_BELOW,
        "median": np.median(ratios),
        "most": ratios.max(),
        "worst": rows[int(ratios.argmax())]["number"],
        "half": 100.0 * (ratios <= HALF).mean(),
        "single": len(single),
        "possible": ", ".join(possible),
        "alone": _ratios(rows, list(BY_HAND)),
        "fitted": np.median(column(rows, "fitted")),
        "roots": ", ".join(roots),
        "inside": ", ".join(inside),
    }


def _ratios(rows: Sequence[Row], names: Sequence[str]) -> str:
    texts = []
    for name in names:
        ratios = [row[DESIGNED] / row[name] for row in rows]
        texts.append(f"{name} {np.median(ratios):.2f} (worst {max(ratios):.2f})")
    return ", ".join(texts)


def _root(excitation: Excitation) -> float:
    return float(np.sqrt((excitation.commands.values**2).mean()))


def _inside(excitation: Excitation) -> str:
    """Say whether an excitation keeps the vehicle in the pool."""
    if excitation.status is DesignStatus.INSIDE:
        return "yes"
    return "no"


if __name__ == "__main__":
    main()
