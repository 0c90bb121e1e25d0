"""Identification of an AUV from its pool recordings: ``python benchmarks/identification_tauv.py
FOLDER``.

Every recording is predicted by a vehicle identified on the others: open loop over all of it, its
start fitted on the first 2 s, and horizon by horizon. Beside them stands what bounds such
predictions. Writes identification_tauv.csv and identification_tauv.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from driven_auv.bounds import MEMORY, WINDOW, filtered, measured_twice, n_coefficients
from driven_auv.recordings import CHANNELS, MOVING, judged, read_recordings
from driven_auv.vehicle import vehicle
from recording.report import Report, Row, Table, begin, parser_of

from uvms_ocp.identification.data_quality import check_data_quality
from uvms_ocp.identification.fit import Predicted, Predictor, fit_percent, rolled_out
from uvms_ocp.identification.model import Vehicle, stage_of
from uvms_ocp.identification.output_error import Estimate, Noise, OutputErrorProblem
from uvms_ocp.identification.parameters import Prior
from uvms_ocp.identification.prediction_verdict import FitShares
from uvms_ocp.identification.rollout import RATE_WINDOW, PreparedRecording, Rollout
from uvms_ocp.identification.still_comparison import MEAN, NOTHING_MOVES, compared
from uvms_ocp.identification.validation import static_baseline

STEP = 0.1
HORIZONS = (5.0, 20.0)
NOISE = Noise(velocity=0.03, rate=0.06, vertical=0.1)
STAGES = ((15.0, 8), (None, 30))
DRIFT = {"wrench_offset": Prior(sigma=1.0, only=("heave",))}
"""What a recording has for itself while the others are identified."""
ALL = "all of it"
ONE_VEHICLE = "all of it, one vehicle that has seen all"
HALF = "all of it, identified on the other half"
HALF_SEEN = "all of it, one vehicle that has seen this half"
OWN = "all of it, seen"
ALONE = "all of it, seen alone"
PRIOR = "prior"
STILL = NOTHING_MOVES
FORCE = "heave force found"
FILTER = "any filter, seen"
TWICE = "position's derivative"
WANTED = {"surge": 60.0, "sway": 55.0, "heave": 65.0, "yaw rate": 50.0}
"""[%] asked for over whole recordings."""
WANTED_SOON = 75.0
"""[%] asked for over the shortest horizon."""
PROSE = """
{n} recordings of {length:.0f} s of an AUV that is driven by its thrusters. Each is predicted by one
vehicle, identified on all others by a search that begins at the prior and knows nothing of the one
that is left out: from the commanded wrench alone, its start fitted on the first {known:g} s. The
fit is `100 (1 - |error| / |y - mean|)` in percent, of a channel where its standard deviation
exceeds {least:g} m/s ({turning:g} rad/s in yaw). Yaw rate is that of the attitude, smoothed by
local quadratics over {window:g} s. The table has medians over the recordings.

Asked for over whole recordings: {wanted}. Over {short:g} s: {asked:g} in each.

## What bounds it

Forces in heave differ between recordings: with the same command the vehicle sinks in one and hovers
in another. Vehicles are identified with a constant heave force for every recording besides,
{forces} N; a recording that is predicted has none. Where it is found from the first {known:g} s
too, as a part of the state, predictions say "{force}".

- "{one_vehicle}": identified on all recordings that are predicted, and predicting them in the same
  way, with no force of their own: the best that one vehicle can do.
- "{half}": every second recording is predicted by a vehicle identified on the others, and these by
  one identified on them. "{half_seen}" is the bound of that: by the vehicle identified on the
  predicted half.
- "{seen}": a vehicle that has seen all recordings, and is told the force and the start of each.
  Over {short:g} s, with the force found, it has no more than "{soon}".
- "{alone}": a vehicle identified on the predicted recording alone: the best that this model can do.
- "{filter}": no vehicle, but a linear filter for each channel with {coefficients} coefficients, of
  {memory:g} s of what eight thrusters were told and of what of it was beyond their dead zone,
  fitted to the very recordings that it is judged on.
- "{twice}": the measured velocity by the derivative of the measured position, smoothed over
  {smoothing:g} s, at the lag at which both agree best: what is left is noise of the one or the
  other.

## Of what one vehicle could explain

By medians over the recordings, every recording predicted by the others:

{shares}

Half of the recordings predicted by the other half, beside a vehicle that has seen that half:

{half_shares}

## Worse than standing still

Predictions by the others over whole recordings and by horizons, in surge, sway, heave and yaw rate:

{worse}

## Doubts about the recordings

{doubts}
"""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Bench:
    """A vehicle and the recordings, prepared for it."""

    vehicle: Vehicle
    rollout: Rollout
    prepared: tuple[PreparedRecording, ...]

    def trained(
        self,
        chosen: Sequence[PreparedRecording],
        shared: np.ndarray | None,
        stages: Sequence[tuple[float | None, int]],
    ) -> Estimate:
        """Identified on some recordings, in short stretches first."""
        for duration, iterations in stages:
            stretches = [stretch for one in chosen for stretch in one.stretches(STEP, duration)]
            error = OutputErrorProblem(self.vehicle, stretches, NOISE, self.rollout)
            estimate = error.solve(error.start(shared), iterations=iterations, tolerance=1e-3)
            shared = estimate.shared
        return estimate

    def predictor(self, shared: np.ndarray) -> Predictor:
        """With unknowns shared (n,) [as they are], and with what a recording has for itself."""
        return Predictor(
            vehicle=self.vehicle, rollout=self.rollout, shared=shared, noise=NOISE, own=True
        )


def bench(folder: Path, *, quick: bool, **learnt: Prior) -> Bench:
    """Of a folder of recordings."""
    one = vehicle(**learnt)
    recordings = read_recordings(folder)[: 2 if quick else None]
    return Bench(
        vehicle=one,
        rollout=Rollout(stage_of(one)),
        prepared=tuple(PreparedRecording.of(each, one) for each in recordings),
    )


def row(name: str, kind: str, predicted: Predicted) -> Row:
    """Fits of one prediction; none where a channel hardly moves."""
    fits = {channel: _fit(channel, *pair) for channel, pair in judged(predicted).items()}
    return {"recording": name, "prediction": kind, **fits}


def _fit(channel: str, seen: np.ndarray, predicted: np.ndarray) -> float | None:
    return fit_percent(seen, predicted) if seen.std() > MOVING[channel] else None


def one_vehicle(one: Bench, shared: np.ndarray, kind: str) -> list[Row]:
    """Every recording, predicted from its beginning by unknowns shared (n,) [as they are], with no
    force of its own.
    """
    predictor = one.predictor(shared)
    return [
        row(each.recording.name, kind, predictor.of(each.stretches(STEP)[0]))
        for each in one.prepared
    ]


def by_halves(one: Bench, drifting: Bench, stages: Sequence[tuple[float | None, int]]) -> list[Row]:
    """Every second recording by a vehicle identified on the others, and these by one identified on
    them, each beside the vehicle that has seen what is predicted.
    """
    halves = [slice(0, None, 2), slice(1, None, 2)]
    identified = [drifting.trained(drifting.prepared[half], None, stages).shared for half in halves]
    rows = []
    for half, seen, other in zip(halves, identified, identified[::-1], strict=True):
        predicted = replace(one, prepared=one.prepared[half])
        rows += one_vehicle(predicted, other, HALF) + one_vehicle(predicted, seen, HALF_SEEN)
    return rows


def shares(rows: Sequence[Row], predicted: str, together: str) -> str:
    """Sentences on each channel: what of it is explained, and by what the rest is missed."""
    sentences = []
    for channel in CHANNELS:
        fit = _median(rows, predicted, channel)
        bound = _median(rows, together, channel)
        alone_fit = _median(rows, ALONE, channel)
        if fit is None or bound is None or alone_fit is None:
            continue
        of_channel = FitShares(channel=channel, predicted=fit, together=bound, alone=alone_fit)
        sentences.append(f"- {of_channel}")
    return "\n".join(sentences)


def worse_than_still(rows: Sequence[Row]) -> str:
    """Sentences on each channel of a recording that is predicted worse than it stands still.

    Errors are in shares of the channel's standard deviation, about its mean.
    """
    kinds = [ALL, *(f"{horizon:g} s" for horizon in HORIZONS)]
    still = {each["recording"]: each for each in rows if each["prediction"] == STILL}
    sentences = []
    for each in rows:
        if each["prediction"] not in kinds:
            continue
        for channel in CHANNELS:
            fit = each[channel]
            still_fit = still[each["recording"]][channel]
            if fit is None or still_fit is None:
                continue
            shortfall = compared(
                recording=f"{each['recording']} ({each['prediction']})",
                channel=channel,
                unit="standard deviations",
                error=1.0 - fit / 100.0,
                baselines={NOTHING_MOVES: 1.0 - still_fit / 100.0, MEAN: 1.0},
            )
            if shortfall is not None:
                sentences.append(f"- {shortfall}")
    return "\n".join(sentences) or "None."


def left_out(one: Bench, drifting: Bench, stages: Sequence[tuple[float | None, int]]) -> list[Row]:
    """Every recording, predicted by what the others tell, in a search that begins at the prior."""
    rows = []
    for held in drifting.prepared:
        found = drifting.trained(
            [other for other in drifting.prepared if other is not held], None, stages
        ).shared
        name, (whole,) = held.recording.name, held.stretches(STEP)
        rows.append(row(name, ALL, one.predictor(found).of(whole)))
        rows += _by_horizon(held, one.predictor(found), "")
        rows += _by_horizon(held, drifting.predictor(found), f", {FORCE}")
    return rows


def _by_horizon(held: PreparedRecording, predictor: Predictor, how: str) -> list[Row]:
    return [
        row(held.recording.name, f"{horizon:g} s{how}", predictor.over(held, STEP, horizon))
        for horizon in HORIZONS
    ]


def seen_soon(one: Bench, shared: np.ndarray) -> list[Row]:
    """Every recording over the shortest horizon, by unknowns shared (n,) [as they are] that it was
    used for.
    """
    return [
        each
        for held in one.prepared
        for each in _by_horizon(held, one.predictor(shared), f", {FORCE}, seen")[:1]
    ]


def alone(one: Bench, shared: np.ndarray, *, quick: bool) -> list[Row]:
    """Every recording, predicted by what it tells itself."""
    rows = []
    for each in one.prepared:
        found = one.trained([each], shared, ((None, 1 if quick else 15),))
        rows += in_sample(
            Bench(vehicle=one.vehicle, rollout=one.rollout, prepared=(each,)), found, ALONE
        )
        rows += _by_horizon(each, one.predictor(found.shared), ", seen alone")[:1]
    return rows


def bounds(one: Bench) -> list[Row]:
    """What no vehicle has to be known for."""
    names = [each.recording.name for each in one.prepared]
    pairs = zip(names, filtered(one.prepared, STEP), strict=True)
    rows: list[Row] = [{"recording": name, "prediction": FILTER, **fits} for name, fits in pairs]
    return rows + [
        {"recording": each.recording.name, "prediction": TWICE, **measured_twice(each.recording)}
        for each in one.prepared
    ]


def in_sample(one: Bench, estimate: Estimate, kind: str) -> list[Row]:
    """Every recording, predicted by an estimate that has seen it, with what it has for itself."""
    rows = []
    for k, each in enumerate(one.prepared):
        name, (whole,) = each.recording.name, each.stretches(STEP)
        found = rolled_out(
            one.rollout, whole, estimate.starts[k], estimate.shared, estimate.own[name]
        )
        rows.append(row(name, kind, found))
    return rows


def nulls(one: Bench) -> list[Row]:
    """The vehicle where the search begins, and none that moves."""
    rows = []
    prior = one.predictor(one.vehicle.shared.start)
    for each in one.prepared:
        (whole,) = each.stretches(STEP)
        predicted = prior.of(whole)
        rows += [
            row(each.recording.name, PRIOR, predicted),
            row(each.recording.name, STILL, static_baseline(whole, prior.start_window)),
        ]
    return rows


def medians(rows: Sequence[Row]) -> list[Row]:
    """Over the recordings, by kind of prediction."""
    kinds = dict.fromkeys(each["prediction"] for each in rows)
    return [
        {"prediction": kind, **{name: _median(rows, kind, name) for name in CHANNELS}}
        for kind in kinds
    ]


def _median(rows: Sequence[Row], kind: str, channel: str) -> float | None:
    known = [
        each[channel] for each in rows if each["prediction"] == kind and each[channel] is not None
    ]
    return float(np.median(known)) if known else None


def _length(one: Bench) -> float:
    return float(np.median([np.diff(each.recording.span)[0] for each in one.prepared]))


def _doubts(one: Bench) -> str:
    told = [
        f"- {each.recording.name}: {doubt}"
        for each in one.prepared
        for doubt in check_data_quality(each.recording)
    ]
    return "\n".join(told) or "None."


def prose(one: Bench, drifting: Estimate, rows: Sequence[Row]) -> str:
    """With the figures of a bench, of an estimate with forces of each recording, and of rows."""
    forces = [float(own[0]) for own in drifting.own.values()]
    return PROSE.format(
        n=len(one.prepared),
        length=_length(one),
        force=FORCE,
        filter=FILTER,
        coefficients=n_coefficients(),
        memory=MEMORY,
        twice=TWICE,
        smoothing=WINDOW,
        known=one.predictor(one.vehicle.shared.start).start_window,
        least=MOVING["surge"],
        turning=MOVING["yaw rate"],
        window=RATE_WINDOW,
        wanted=", ".join(f"{name} {least:g}" for name, least in WANTED.items()),
        short=HORIZONS[0],
        asked=WANTED_SOON,
        one_vehicle=ONE_VEHICLE,
        half=HALF,
        half_seen=HALF_SEEN,
        shares=shares(rows, ALL, ONE_VEHICLE),
        half_shares=shares(rows, HALF, HALF_SEEN),
        worse=worse_than_still(rows),
        seen=OWN,
        soon=f"{HORIZONS[0]:g} s, {FORCE}, seen",
        alone=ALONE,
        forces=f"{min(forces):.2g} to {max(forces):.2g}",
        doubts=_doubts(one),
    )


def main() -> None:
    """Identify and predict."""
    parser = parser_of(__doc__)
    parser.add_argument("folder", type=Path, help="of the recordings")
    given, run = begin(parser)
    stages = tuple((duration, 1 if run.quick else iterations) for duration, iterations in STAGES)
    one = bench(given.folder, quick=run.quick)
    drifting = bench(given.folder, quick=run.quick, **DRIFT)
    everything = drifting.trained(drifting.prepared, None, stages)
    rows = left_out(one, drifting, stages) + one_vehicle(one, everything.shared, ONE_VEHICLE)
    rows += by_halves(one, drifting, stages) + in_sample(drifting, everything, OWN)
    rows += seen_soon(drifting, everything.shared) + alone(
        drifting, everything.shared, quick=run.quick
    )
    rows += bounds(one) + nulls(one)
    table = Table(rows=medians(rows), columns={"prediction": "", **dict.fromkeys(CHANNELS, ".0f")})
    run.write(
        Report(
            name="identification_tauv",
            title="Identification of a driven AUV",
            prose=prose(one, everything, rows),
            tables=[table],
            data={"identification_tauv": rows},
        )
    )


if __name__ == "__main__":
    main()
