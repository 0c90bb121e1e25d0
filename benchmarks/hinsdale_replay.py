"""Replay of the pool recordings: ``python benchmarks/hinsdale_replay.py FOLDER [--figures
FOLDER]``.

Simulates the vehicle without thrust under the measured joint motion and compares roll and pitch
with the motion capture, the mean of the first seconds removed from both. Then the vehicle's centre
of buoyancy is fitted, always on the other moving recordings, and reported apart. Writes
hinsdale_replay.csv and hinsdale_replay.md.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from pool.drawing import draw
from pool.evaluation import FITTED, REPLAY, STATIC, Evaluation, changes, evaluate, medians
from pool.findings import (
    EXPLAINED,
    JUMP,
    Swing,
    free_swings,
    jumps,
    measured_swing,
    offset_deg,
    rest_begins,
    restoring_ratio,
    spread_deg,
)
from pool.recordings import SAMPLE_TIME, SMOOTHING, read_recordings
from pool.scores import OFFSET_TIME, lag_of, without_offset
from pool.vehicle import (
    ADDED_INERTIA,
    BALLAST_DENSITY,
    CENTRE_OF_BUOYANCY,
    FOAM_DENSITY,
    PoolVehicle,
    pool_vehicle,
)
from recording.report import Report, Row, Table, begin, parser_of

from uvms_ocp.identification.still_comparison import MEAN, NOTHING_MOVES, compared

PROSE = """
{recordings} recordings of a BlueROV2 with a Reach Alpha 5 arm (H. Kolano, UVMS-SysID-with-EAs): the
measured joint motion drives the arm of the simulated vehicle, no thrust, and roll and pitch are
compared with the motion capture. From both the mean of the first {offset_time:g} s is removed,
nothing else. The first table has medians over the {moving} recordings in which the arm moves, the
second what the fit changes in the replay.

## Fitted centre of buoyancy

Three numbers, found with the replay itself on the moving recordings other than the one reported.
From the author's {centre} m the fits move it by {shift_x} mm along x, {shift_y} mm along y and
{shift_z} mm along z. An independent check: the constant offset that the comparison removes, and the
fit therefore never sees, goes from {offset_roll} deg in roll and {offset_pitch} deg in pitch to
{fitted_roll} and {fitted_pitch} deg.

## Lag and overshoot

The arm moves slowly: the replay is the static balance plus {lag} s of lag, and is {swing} deg away
from it at most after the arm has stopped. Against the measurement the pitch of the static balance
lags by up to {static_lag:.2f} s and overshoots by up to {static_overshoot:.0f} %: these are wrong
shapes, not delays. The fitted righting moment is {ratio} times the author's.

## What does not match

- **Free swinging.** Linearised at rest, our vehicle rolls with a period of {roll_period} s and
  pitches with {pitch_period} s, damping ratios {roll_damping} and {pitch_damping}. Measured after
  the arm has stopped, where a damped swing explains {explained:.0f} % of the motion: {measured}.
- **The fit makes worse** the pitch of {worse}.
- **Worse than standing still** are, with the fitted centre of buoyancy: {still}
- **Starts.** Roll and pitch spread most within the first {offset_time:g} s, whose mean is the
  offset, in {restless}; the replay starts at rest.
- **Measurement.** Samples of the motion capture that jump by more than {jump:g} deg: {jumps}. Where
  the arm rests the measured attitude wanders all the same: {wander}. The best that a prediction can
  do there is the error in the second table.
- The tether is not modelled, nor the free surface; the vehicle's drift in the pool is not compared.

## Assumed

Ballast of {ballast:g} kg/m^3 and foam of {foam:g} kg/m^3 (inertia only); the author's inertia taken
to hold an added inertia of {added:g} kg m^2 about each axis; jaw fixed; joint positions smoothed by
local cubics over {smoothing:.2f} s.
"""
SCORES = {"prediction": "", "roll RMSE [deg]": ".2f", "pitch RMSE [deg]": ".2f"}


def prose(vehicle: PoolVehicle, evaluations: Sequence[Evaluation]) -> str:
    """Fill in the figures of all recordings."""
    moving = [evaluation for evaluation in evaluations if evaluation.recording.moves]
    shifts = {}
    for i, axis in enumerate("xyz"):
        shifts[f"shift_{axis}"] = span(1e3 * evaluation.shift[i] for evaluation in moving)
    worse = []
    for evaluation in moving:
        if _pitch_rmse(evaluation, FITTED) > _pitch_rmse(evaluation, REPLAY):
            worse.append(evaluation.recording.name)
    return PROSE.format(
        recordings=len(evaluations),
        moving=len(moving),
        offset_time=OFFSET_TIME,
        centre=f"({', '.join(f'{x:g}' for x in CENTRE_OF_BUOYANCY)})",
        **shifts,
        **_offsets(moving),
        **_dynamics(vehicle, moving),
        **_swings(vehicle, moving),
        **_measurements(evaluations),
        explained=100 * EXPLAINED,
        jump=JUMP,
        worse=listed(worse),
        still=" ".join(worse_than_still(evaluations)) or "none.",
        ballast=BALLAST_DENSITY,
        foam=FOAM_DENSITY,
        added=ADDED_INERTIA,
        smoothing=SMOOTHING * SAMPLE_TIME,
    )


def worse_than_still(evaluations: Sequence[Evaluation]) -> list[str]:
    """Sentences on roll and pitch of each recording that the fitted replay predicts worse than a
    vehicle that stands still.
    """
    sentences = []
    for evaluation in evaluations:
        measured = without_offset(evaluation.recording.t, evaluation.recording.attitude)
        for i, angle in enumerate(("roll", "pitch")):
            baselines = {
                NOTHING_MOVES: float(np.sqrt(np.mean(measured[:, i] ** 2))),
                MEAN: float(measured[:, i].std()),
            }
            shortfall = compared(
                recording=evaluation.recording.name,
                channel=angle,
                unit="deg",
                error=evaluation.scores[FITTED][i].rmse,
                baselines=baselines,
            )
            if shortfall is not None:
                sentences.append(str(shortfall))
    return sentences


def span(values: Iterable[float], form: str = ".1f") -> str:
    """The least and the largest value."""
    numbers = list(values)
    return f"{min(numbers):{form}} to {max(numbers):{form}}"


def listed(names: Iterable[str]) -> str:
    """Join names with commas; "none" for no names."""
    return ", ".join(names) or "none"


def _pitch_rmse(evaluation: Evaluation, name: str) -> float:
    return evaluation.scores[name][1].rmse


def _offsets(moving: Sequence[Evaluation]) -> dict[str, str]:
    """Before and after the fit."""
    figures = {}
    for word, prediction in (("offset", REPLAY), ("fitted", FITTED)):
        offsets = []
        for evaluation in moving:
            offsets.append(offset_deg(evaluation.recording, evaluation.predictions[prediction]))
        for i, angle in enumerate(("roll", "pitch")):
            figures[f"{word}_{angle}"] = span(offset[i] for offset in offsets)
    return figures


def _dynamics(vehicle: PoolVehicle, moving: Sequence[Evaluation]) -> dict[str, object]:
    """Describe what the replay adds to the static balance."""
    lags = []
    swings = []
    ratios = []
    static_lags = []
    static_overshoots = []
    for evaluation in moving:
        recording = evaluation.recording
        t = recording.joint_t
        replayed = evaluation.predictions[REPLAY]
        static = evaluation.predictions[STATIC]
        lags += [lag_of(t, replayed[:, i], static[:, i]) for i in (0, 1)]
        after = t >= rest_begins(recording)
        swings.append(float(np.degrees(np.abs(replayed - static)[after].max())))
        ratios.append(restoring_ratio(vehicle, recording, evaluation.shift))
        static_pitch = evaluation.scores[STATIC][1]
        static_lags.append(static_pitch.lag)
        static_overshoots.append(static_pitch.overshoot)
    return {
        "lag": span((lag for lag in lags if np.isfinite(lag)), ".2f"),
        "swing": span(swings),
        "static_lag": max((lag for lag in static_lags if np.isfinite(lag)), default=np.nan),
        "static_overshoot": 100 * max(static_overshoots),
        "ratio": span(ratios, ".2f"),
    }


def _swings(vehicle: PoolVehicle, moving: Sequence[Evaluation]) -> dict[str, str]:
    """Free swings of the vehicle as simulated, and as measured."""
    rolls = []
    pitches = []
    measured = []
    for evaluation in moving:
        recording = evaluation.recording
        roll, pitch = free_swings(vehicle, recording)
        rolls.append(roll)
        pitches.append(pitch)
        for i, angle in enumerate(("roll", "pitch")):
            swing = measured_swing(recording, i)
            if swing is not None:
                measured.append(
                    f"{angle} of {recording.name} {swing.period:.2f} s,"
                    f" damping ratio {swing.damping:.3f}"
                )
    return {**_span_of("roll", rolls), **_span_of("pitch", pitches), "measured": listed(measured)}


def _span_of(name: str, swings: Sequence[Swing]) -> dict[str, str]:
    return {
        f"{name}_period": span(swing.period for swing in swings),
        f"{name}_damping": span((swing.damping for swing in swings), ".3f"),
    }


def _measurements(evaluations: Sequence[Evaluation]) -> dict[str, str]:
    """Describe what the motion capture itself does."""
    recordings = [evaluation.recording for evaluation in evaluations]
    at_first = {recording.name: spread_deg(recording, OFFSET_TIME) for recording in recordings}
    restless = max(at_first, key=lambda name: float(at_first[name].max()))
    wander = []
    for recording in recordings:
        if not recording.moves:
            wander.append(f"{recording.name} {_both_angles(spread_deg(recording))}")
    return {
        "restless": f"{restless} ({_both_angles(at_first[restless])})",
        "jumps": listed(f"{recording.name} {jumps(recording)}" for recording in recordings),
        "wander": f"{listed(wander)} peak to peak in roll and pitch",
    }


def _both_angles(angles: np.ndarray) -> str:
    """Write roll and pitch [deg] as text."""
    return f"{' and '.join(f'{angle:.1f}' for angle in angles)} deg"


def main() -> None:
    """Replay all recordings of a folder."""
    parser = parser_of(__doc__)
    parser.add_argument("folder", type=Path, help="of the recordings")
    parser.add_argument(
        "--figures", type=Path, metavar="FOLDER", help="draw one figure per recording there"
    )
    arguments, run = begin(parser)
    recordings = read_recordings(arguments.folder)
    if run.quick:
        recordings = [recording for recording in recordings if recording.moves][:2]
    vehicle = pool_vehicle()
    evaluations = evaluate(vehicle, recordings)
    if arguments.figures:
        arguments.figures.mkdir(parents=True, exist_ok=True)
        for evaluation in evaluations:
            draw(evaluation.recording, evaluation.predictions, arguments.figures)
    rows = list[Row]()
    for evaluation in evaluations:
        rows += evaluation.rows()
    run.write(
        Report(
            name="hinsdale_replay",
            title="Replay of the pool recordings",
            prose=prose(vehicle, evaluations),
            tables=[
                Table(rows=medians(evaluations), columns=SCORES),
                Table(rows=changes(evaluations)),
            ],
            data={"hinsdale_replay": rows},
        )
    )


if __name__ == "__main__":
    main()
