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
from recording.rows import column, known_values, rows_where

from uvms_ocp.identification.data_quality import check_data_quality
from uvms_ocp.identification.estimates import Estimate, Noise
from uvms_ocp.identification.model import Vehicle, stage_of
from uvms_ocp.identification.output_error import OutputErrorProblem
from uvms_ocp.identification.parameters import Prior
from uvms_ocp.identification.prediction_verdict import FitShares
from uvms_ocp.identification.predictor import (
    Predicted,
    Predictor,
    fit_percent,
    rolled_out,
)
from uvms_ocp.identification.rollout import Rollout
from uvms_ocp.identification.segments import (
    RATE_WINDOW,
    PreparedRecording,
    Segment,
)
from uvms_ocp.identification.static_baselines import static_baseline
from uvms_ocp.identification.still_comparison import MEAN, NOTHING_MOVES, compared

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
            stretches = list[Segment]()
            for prepared in chosen:
                stretches += prepared.segments(STEP, duration)
            error = OutputErrorProblem(self.vehicle, stretches, NOISE, self.rollout)
            estimate = error.solve(error.start(shared), iterations=iterations, tolerance=1e-3)
            shared = estimate.shared
        return estimate

    def predictor(self, shared: np.ndarray) -> Predictor:
        """Make a predictor with unknowns shared (n,) [as they are], and with what a recording has
        for itself.
        """
        return Predictor(
            vehicle=self.vehicle,
            rollout=self.rollout,
            shared=shared,
            noise=NOISE,
            fits_per_recording=True,
        )


def bench(folder: Path, *, quick: bool, **learnt: Prior) -> Bench:
    """Prepare a vehicle and the recordings of a folder."""
    auv = vehicle(**learnt)
    recordings = read_recordings(folder)
    if quick:
        recordings = recordings[:2]
    return Bench(
        vehicle=auv,
        rollout=Rollout(stage_of(auv)),
        prepared=tuple(PreparedRecording.of(recording, auv) for recording in recordings),
    )


def row(name: str, kind: str, predicted: Predicted) -> Row:
    """Fits of one prediction; none where a channel hardly moves."""
    fits = {channel: _fit(channel, *pair) for channel, pair in judged(predicted).items()}
    return {"recording": name, "prediction": kind, **fits}


def _fit(channel: str, measured: np.ndarray, predicted: np.ndarray) -> float | None:
    if measured.std() <= MOVING[channel]:
        return None
    return fit_percent(measured, predicted)


def one_vehicle(steady: Bench, shared: np.ndarray, kind: str) -> list[Row]:
    """Every recording, predicted from its beginning by unknowns shared (n,) [as they are], with no
    force of its own.
    """
    predictor = steady.predictor(shared)
    rows = []
    for prepared in steady.prepared:
        whole = prepared.segments(STEP)[0]
        rows.append(row(prepared.recording.name, kind, predictor.of(whole)))
    return rows


def by_halves(
    steady: Bench, drifting: Bench, stages: Sequence[tuple[float | None, int]]
) -> list[Row]:
    """Every second recording by a vehicle identified on the others, and these by one identified on
    them, each beside the vehicle that has seen what is predicted.
    """
    even = slice(0, None, 2)
    odd = slice(1, None, 2)
    from_even = drifting.trained(drifting.prepared[even], None, stages).shared
    from_odd = drifting.trained(drifting.prepared[odd], None, stages).shared
    rows = []
    for half, from_half, from_other in ((even, from_even, from_odd), (odd, from_odd, from_even)):
        predicted = replace(steady, prepared=steady.prepared[half])
        rows += one_vehicle(predicted, from_other, HALF)
        rows += one_vehicle(predicted, from_half, HALF_SEEN)
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
    still = {row["recording"]: row for row in rows_where(rows, "prediction", STILL)}
    sentences = []
    for prediction in rows:
        if prediction["prediction"] not in kinds:
            continue
        for channel in CHANNELS:
            fit = prediction[channel]
            still_fit = still[prediction["recording"]][channel]
            if fit is None or still_fit is None:
                continue
            shortfall = compared(
                recording=f"{prediction['recording']} ({prediction['prediction']})",
                channel=channel,
                unit="standard deviations",
                error=1.0 - fit / 100.0,
                baselines={NOTHING_MOVES: 1.0 - still_fit / 100.0, MEAN: 1.0},
            )
            if shortfall is not None:
                sentences.append(f"- {shortfall}")
    return "\n".join(sentences) or "None."


def left_out(
    steady: Bench, drifting: Bench, stages: Sequence[tuple[float | None, int]]
) -> list[Row]:
    """Every recording, predicted by what the others tell, in a search that begins at the prior."""
    rows = []
    for prepared in drifting.prepared:
        training = [candidate for candidate in drifting.prepared if candidate is not prepared]
        shared = drifting.trained(training, None, stages).shared
        (whole,) = prepared.segments(STEP)
        rows.append(row(prepared.recording.name, ALL, steady.predictor(shared).of(whole)))
        rows += _by_horizon(prepared, steady.predictor(shared), "")
        rows += _by_horizon(prepared, drifting.predictor(shared), f", {FORCE}")
    return rows


def _by_horizon(prepared: PreparedRecording, predictor: Predictor, how: str) -> list[Row]:
    rows = []
    for horizon in HORIZONS:
        predicted = predictor.over(prepared, STEP, horizon)
        rows.append(row(prepared.recording.name, f"{horizon:g} s{how}", predicted))
    return rows


def seen_soon(drifting: Bench, shared: np.ndarray) -> list[Row]:
    """Every recording over the shortest horizon, by unknowns shared (n,) [as they are] that it was
    used for.
    """
    rows = []
    for prepared in drifting.prepared:
        rows += _by_horizon(prepared, drifting.predictor(shared), f", {FORCE}, seen")[:1]
    return rows


def alone(drifting: Bench, shared: np.ndarray, *, quick: bool) -> list[Row]:
    """Every recording, predicted by what it tells itself."""
    stages = ((None, 1 if quick else 15),)
    rows = []
    for prepared in drifting.prepared:
        estimate = drifting.trained([prepared], shared, stages)
        single = Bench(vehicle=drifting.vehicle, rollout=drifting.rollout, prepared=(prepared,))
        rows += in_sample(single, estimate, ALONE)
        rows += _by_horizon(prepared, drifting.predictor(estimate.shared), ", seen alone")[:1]
    return rows


def bounds(steady: Bench) -> list[Row]:
    """Compute bounds for which no vehicle has to be known: a filter of the commands, and the two
    sensors against each other.
    """
    recordings = [prepared.recording for prepared in steady.prepared]
    rows: list[Row] = []
    for recording, fits in zip(recordings, filtered(steady.prepared, STEP), strict=True):
        rows.append({"recording": recording.name, "prediction": FILTER, **fits})
    for recording in recordings:
        fits = measured_twice(recording)
        rows.append({"recording": recording.name, "prediction": TWICE, **fits})
    return rows


def in_sample(drifting: Bench, estimate: Estimate, kind: str) -> list[Row]:
    """Every recording, predicted by an estimate that has seen it, with what it has for itself."""
    rows = []
    for k, prepared in enumerate(drifting.prepared):
        name = prepared.recording.name
        (whole,) = prepared.segments(STEP)
        predicted = rolled_out(
            drifting.rollout,
            whole,
            estimate.starts[k],
            estimate.shared,
            estimate.per_recording[name],
        )
        rows.append(row(name, kind, predicted))
    return rows


def nulls(steady: Bench) -> list[Row]:
    """The vehicle where the search begins, and none that moves."""
    rows = []
    prior = steady.predictor(steady.vehicle.shared.start)
    for prepared in steady.prepared:
        name = prepared.recording.name
        (whole,) = prepared.segments(STEP)
        rows.append(row(name, PRIOR, prior.of(whole)))
        rows.append(row(name, STILL, static_baseline(whole, prior.start_window)))
    return rows


def medians(rows: Sequence[Row]) -> list[Row]:
    """Over the recordings, by kind of prediction."""
    table = list[Row]()
    for kind in dict.fromkeys(column(rows, "prediction")):
        fits = {channel: _median(rows, kind, channel) for channel in CHANNELS}
        table.append({"prediction": kind, **fits})
    return table


def _median(rows: Sequence[Row], kind: str, channel: str) -> float | None:
    fits = known_values(rows_where(rows, "prediction", kind), channel)
    return float(np.median(fits)) if fits else None


def _length(steady: Bench) -> float:
    durations = [np.diff(prepared.recording.span)[0] for prepared in steady.prepared]
    return float(np.median(durations))


def _doubts(steady: Bench) -> str:
    sentences = []
    for prepared in steady.prepared:
        recording = prepared.recording
        sentences += [f"- {recording.name}: {doubt}" for doubt in check_data_quality(recording)]
    return "\n".join(sentences) or "None."


def prose(steady: Bench, drifting: Estimate, rows: Sequence[Row]) -> str:
    """Fill in the figures of a bench, of an estimate with forces of each recording, and of rows."""
    forces = [float(per_recording[0]) for per_recording in drifting.per_recording.values()]
    return PROSE.format(
        n=len(steady.prepared),
        length=_length(steady),
        force=FORCE,
        filter=FILTER,
        coefficients=n_coefficients(),
        memory=MEMORY,
        twice=TWICE,
        smoothing=WINDOW,
        known=steady.predictor(steady.vehicle.shared.start).start_window,
        least=MOVING["surge"],
        turning=MOVING["yaw rate"],
        window=RATE_WINDOW,
        wanted=", ".join(f"{name} {fit:g}" for name, fit in WANTED.items()),
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
        doubts=_doubts(steady),
    )


def main() -> None:
    """Identify and predict."""
    parser = parser_of(__doc__)
    parser.add_argument("folder", type=Path, help="of the recordings")
    arguments, run = begin(parser)
    stages: tuple[tuple[float | None, int], ...] = STAGES
    if run.quick:
        stages = tuple((duration, 1) for duration, _ in STAGES)
    steady = bench(arguments.folder, quick=run.quick)
    drifting = bench(arguments.folder, quick=run.quick, **DRIFT)
    everything = drifting.trained(drifting.prepared, None, stages)
    rows = left_out(steady, drifting, stages)
    rows += one_vehicle(steady, everything.shared, ONE_VEHICLE)
    rows += by_halves(steady, drifting, stages)
    rows += in_sample(drifting, everything, OWN)
    rows += seen_soon(drifting, everything.shared)
    rows += alone(drifting, everything.shared, quick=run.quick)
    rows += bounds(steady)
    rows += nulls(steady)
    table = Table(rows=medians(rows), columns={"prediction": "", **dict.fromkeys(CHANNELS, ".0f")})
    run.write(
        Report(
            name="identification_tauv",
            title="Identification of a driven AUV",
            prose=prose(steady, everything, rows),
            tables=[table],
            data={"identification_tauv": rows},
        )
    )


if __name__ == "__main__":
    main()
