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
from recording.report import Report, Table, begin, parser_of

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


def prose(vehicle: PoolVehicle, all_of_them: Sequence[Evaluation]) -> str:
    """With the figures of all recordings."""
    moving = [one for one in all_of_them if one.recording.moves]
    return PROSE.format(
        recordings=len(all_of_them),
        moving=len(moving),
        offset_time=OFFSET_TIME,
        centre=f"({', '.join(f'{x:g}' for x in CENTRE_OF_BUOYANCY)})",
        **{
            f"shift_{axis}": span(1e3 * one.shift[i] for one in moving)
            for i, axis in enumerate("xyz")
        },
        **_offsets(moving),
        **_dynamics(vehicle, moving),
        **_swings(vehicle, moving),
        **_measurements(all_of_them),
        explained=100 * EXPLAINED,
        jump=JUMP,
        worse=listed(
            one.recording.name
            for one in moving
            if _pitch_rmse(one, FITTED) > _pitch_rmse(one, REPLAY)
        ),
        still=" ".join(worse_than_still(all_of_them)) or "none.",
        ballast=BALLAST_DENSITY,
        foam=FOAM_DENSITY,
        added=ADDED_INERTIA,
        smoothing=SMOOTHING * SAMPLE_TIME,
    )


def worse_than_still(all_of_them: Sequence[Evaluation]) -> list[str]:
    """Sentences on roll and pitch of each recording that the fitted replay predicts worse than a
    vehicle that stands still.
    """
    sentences = []
    for one in all_of_them:
        seen = without_offset(one.recording.t, one.recording.attitude)
        for i, angle in enumerate(("roll", "pitch")):
            baselines = {
                NOTHING_MOVES: float(np.sqrt(np.mean(seen[:, i] ** 2))),
                MEAN: float(seen[:, i].std()),
            }
            shortfall = compared(
                recording=one.recording.name,
                channel=angle,
                unit="deg",
                error=one.scores[FITTED][i].rmse,
                baselines=baselines,
            )
            if shortfall is not None:
                sentences.append(str(shortfall))
    return sentences


def span(values: Iterable[float], form: str = ".1f") -> str:
    """The least and the largest value."""
    found = list(values)
    return f"{min(found):{form}} to {max(found):{form}}"


def listed(names: Iterable[str]) -> str:
    """With commas, or none."""
    return ", ".join(names) or "none"


def _pitch_rmse(one: Evaluation, name: str) -> float:
    return one.scores[name][1].rmse


def _offsets(moving: Sequence[Evaluation]) -> dict[str, str]:
    """Before and after the fit."""
    own = [offset_deg(one.recording, one.predictions[REPLAY]) for one in moving]
    fitted = [offset_deg(one.recording, one.predictions[FITTED]) for one in moving]
    pairs = {"offset": own, "fitted": fitted}
    angles = enumerate(("roll", "pitch"))
    return {
        f"{word}_{name}": span(found[i] for found in pairs[word])
        for i, name in angles
        for word in pairs
    }


def _dynamics(vehicle: PoolVehicle, moving: Sequence[Evaluation]) -> dict[str, object]:
    """What the replay adds to the static balance."""
    lags = []
    swings = []
    for one in moving:
        t = one.recording.joint_t
        replayed = one.predictions[REPLAY]
        static = one.predictions[STATIC]
        lags += [lag_of(t, replayed[:, i], static[:, i]) for i in (0, 1)]
        after = t >= rest_begins(one.recording)
        swings.append(float(np.degrees(np.abs(replayed - static)[after].max())))
    static_pitch = [one.scores[STATIC][1] for one in moving]
    static_lags = [score.lag for score in static_pitch]
    return {
        "lag": span((lag for lag in lags if np.isfinite(lag)), ".2f"),
        "swing": span(swings),
        "static_lag": max((lag for lag in static_lags if np.isfinite(lag)), default=np.nan),
        "static_overshoot": 100 * max(score.overshoot for score in static_pitch),
        "ratio": span(
            (restoring_ratio(vehicle, one.recording, one.shift) for one in moving), ".2f"
        ),
    }


def _swings(vehicle: PoolVehicle, moving: Sequence[Evaluation]) -> dict[str, str]:
    """Free swings of the vehicle as simulated, and as measured."""
    rolls, pitches = zip(*(free_swings(vehicle, one.recording) for one in moving), strict=True)
    measured = [
        f"{name} of {one.recording.name} {swing.period:.2f} s, damping ratio {swing.damping:.3f}"
        for one in moving
        for i, name in enumerate(("roll", "pitch"))
        for swing in [measured_swing(one.recording, i)]
        if swing is not None
    ]
    return {**_span_of("roll", rolls), **_span_of("pitch", pitches), "measured": listed(measured)}


def _span_of(name: str, swings: Sequence[Swing]) -> dict[str, str]:
    return {
        f"{name}_period": span(swing.period for swing in swings),
        f"{name}_damping": span((swing.damping for swing in swings), ".3f"),
    }


def _measurements(all_of_them: Sequence[Evaluation]) -> dict[str, str]:
    """What the motion capture itself does."""
    recordings = [one.recording for one in all_of_them]
    first = {one.name: spread_deg(one, OFFSET_TIME) for one in recordings}
    restless = max(first, key=lambda name: float(first[name].max()))
    still = [
        f"{one.name} {' and '.join(f'{x:.1f}' for x in spread_deg(one))} deg"
        for one in recordings
        if not one.moves
    ]
    return {
        "restless": f"{restless} ({' and '.join(f'{x:.1f}' for x in first[restless])} deg)",
        "jumps": listed(f"{one.name} {jumps(one)}" for one in recordings),
        "wander": f"{listed(still)} peak to peak in roll and pitch",
    }


def main() -> None:
    """Replay all recordings of a folder."""
    parser = parser_of(__doc__)
    parser.add_argument("folder", type=Path, help="of the recordings")
    parser.add_argument(
        "--figures", type=Path, metavar="FOLDER", help="draw one figure per recording there"
    )
    given, run = begin(parser)
    recordings = read_recordings(given.folder)
    vehicle = pool_vehicle()
    chosen = [one for one in recordings if one.moves][:2] if run.quick else recordings
    evaluations = evaluate(vehicle, chosen)
    for one in evaluations if given.figures else ():
        given.figures.mkdir(parents=True, exist_ok=True)
        draw(one.recording, one.predictions, given.figures)
    run.write(
        Report(
            name="hinsdale_replay",
            title="Replay of the pool recordings",
            prose=prose(vehicle, evaluations),
            tables=[
                Table(rows=medians(evaluations), columns=SCORES),
                Table(rows=changes(evaluations)),
            ],
            data={"hinsdale_replay": [row for one in evaluations for row in one.rows()]},
        )
    )


if __name__ == "__main__":
    main()
