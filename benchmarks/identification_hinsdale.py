"""Identification of a vehicle whose arm moves: ``python benchmarks/identification_hinsdale.py
FOLDER``.

Nothing drives the vehicle; the measured joints are what goes in. Every recording in which the arm
moves is predicted by a vehicle identified on the others, once by each sensor of attitude, and what
both sensors say of the same motion is compared. Writes identification_hinsdale.csv,
identification_hinsdale_swings.csv and identification_hinsdale.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pool.judging import ANGLES, about_mean, apart, errors, row, still, turned_back
from pool.learnt import KNOWN, NOISE, Learner, pool_learner
from pool.scores import OFFSET_TIME
from pool.sensors import IMU, MOCAP, moves, recordings_of
from pool.swings import LARGE, swings
from recording.report import Report, Row, Table, begin, parser_of
from recording.rows import column, rows_where

from uvms_ocp.identification.estimates import Estimate
from uvms_ocp.identification.prediction_verdict import FitShares
from uvms_ocp.identification.predictor import Predicted
from uvms_ocp.identification.segments import PreparedRecording
from uvms_ocp.identification.still_comparison import MEAN, NOTHING_MOVES, compared

OTHERS = "left out"
SEEN = "seen"
ALONE = "seen alone"
PRIOR = "the author's figures"
STILL = NOTHING_MOVES
APART = "between the sensors"
# Errors that are asked for
WANTED = 0.65  # [deg] in roll and pitch
PERIOD = 10.0  # [%] of a swing's period
DAMPING = 30.0  # [%] of a swing's damping ratio
PROSE = """
{n} recordings of a BlueROV2 with a Reach Alpha 5 arm that moves (H. Kolano, UVMS-SysID-with-EAs);
no thrust. Its measured joints drive a vehicle whose buoyancy, inertia and drag in roll and pitch,
and the way in which the sensor of attitude sits in it, were identified on the other recordings. Of
the recording that is predicted the first {known:g} s give its start and a constant offset of the
attitude; then the mean of the first {offset:g} s is removed from both, as in the replay. The table
has medians of the RMSE in roll and pitch. Asked for: {wanted:g} deg by the motion capture in both.

## What bounds it

The vehicle's own IMU and the motion capture see the same motion, and differ: "{apart}" is their RMS
difference, with both turned as they were found to sit. The motion capture sits turned by
{turn_mocap:.1f} deg about z, the IMU by {turn_imu:.1f} deg; markers that are mistaken for others
make its attitude jump. No prediction is nearer to the motion capture than this, but by chance. A
vehicle that has seen all recordings, "{seen}", is the best that one vehicle can do; "{alone}" is a
vehicle identified on the predicted recording alone, the best that this model can do. Where the
vehicle comes to rest differs between recordings by {rest_imu} deg (standard deviations of the
offsets in roll and pitch, by the IMU).

## Of what one vehicle could explain

Fits are `100 (1 - RMSE / standard deviation)`, medians over the recordings:

{shares}

## Worse than standing still

Left-out predictions that err more than a vehicle that does not move, or than one at the mean of
what was then seen. Of recordings in which the arm is at rest too, {at_rest}, which nothing is
identified on and no median holds:

{worse}

By more than the sensors differ there: {beyond}.

## Free swings

Where the arm rests and a damped swing explains the motion that the IMU saw, {n_swings} in all, the
left-out prediction is read in the same way. Of those of more than {large:g} deg (standard
deviation) periods are off by {periods} % ({period:g} allowed) and damping ratios by {dampings} %
({damping:g} allowed). Of the smaller ones periods are off by {small_periods} %, and damping ratios
by {small_damping} % in the median: motions of two axes add up in them, and little damps them.
"""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Session:
    """Estimates and predictions by one sensor of attitude."""

    sensor: str
    learner: Learner
    prepared: tuple[PreparedRecording, ...]
    estimate: Estimate
    """Unknowns estimated from all recordings."""
    left_out: tuple[Predicted, ...]
    """Every recording, by what the others tell."""
    alone: tuple[Predicted, ...]
    """Every recording, by what it tells itself."""
    at_rest: dict[str, Predicted]
    """Recordings in which the arm does not move, by name: by what all others tell."""

    @property
    def turn(self) -> float:
        """[deg] about z at which the sensor was found to sit."""
        index = self.learner.vehicle.shared.names.index("attitude_turn z")
        return float(np.degrees(self.estimate.shared[index]))

    def rows(self) -> list[Row]:
        """One for each prediction of each recording."""
        start = self.learner.vehicle.shared.start
        rows = []
        for prepared, left_out, alone in zip(self.prepared, self.left_out, self.alone, strict=True):
            together = self.learner.predicted(prepared, self.estimate.shared)
            prior = self.learner.predicted(prepared, start)
            rmse_of = {
                OTHERS: errors(left_out),
                SEEN: errors(together),
                ALONE: errors(alone),
                PRIOR: errors(prior),
                STILL: still(left_out),
                MEAN: about_mean(left_out),
            }
            for kind, rmse in rmse_of.items():
                rows.append(row(prepared.recording.name, self.sensor, kind, rmse))
        return rows


def session(folder: Path, sensor: str, *, quick: bool) -> Session:
    """Identify by one sensor, from all recordings and from all but one; searches begin where all of
    them together end.
    """
    learner = pool_learner(NOISE[sensor])
    moving = []
    resting = []
    for recording in recordings_of(folder)[sensor]:
        prepared = PreparedRecording.of(recording, learner.vehicle)
        if moves(recording):
            moving.append(prepared)
        else:
            resting.append(prepared)
    if quick:
        moving = moving[:2]
    everything = learner.trained(moving, iterations=2 if quick else 25)
    at_rest = {}
    for prepared in resting:
        at_rest[prepared.recording.name] = learner.predicted(prepared, everything.shared)
    return Session(
        sensor=sensor,
        learner=learner,
        prepared=tuple(moving),
        estimate=everything,
        left_out=tuple(_left_out(learner, moving, prepared, quick=quick) for prepared in moving),
        alone=tuple(_alone(learner, prepared, everything, quick=quick) for prepared in moving),
        at_rest=at_rest,
    )


def _alone(
    learner: Learner, prepared: PreparedRecording, everything: Estimate, *, quick: bool
) -> Predicted:
    """Predict a recording by what it tells itself, searched from what all of them tell."""
    estimate = learner.trained([prepared], everything.shared, iterations=2 if quick else 25)
    return learner.predicted(prepared, estimate.shared)


def _left_out(
    learner: Learner,
    moving: Sequence[PreparedRecording],
    prepared: PreparedRecording,
    *,
    quick: bool,
) -> Predicted:
    """Predict a recording by what the others tell, searched from the prior: nothing of it is known
    to that search.
    """
    training = [candidate for candidate in moving if candidate is not prepared]
    estimate = learner.trained(training, iterations=2 if quick else 25)
    return learner.predicted(prepared, estimate.shared)


def between(imu: Session, mocap: Session) -> list[Row]:
    """How far the sensors are from each other."""
    rows = []
    for by_imu, by_mocap in zip(imu.prepared, mocap.prepared, strict=True):
        rmse = apart(
            turned_back(mocap.learner, by_mocap, mocap.estimate.shared),
            turned_back(imu.learner, by_imu, imu.estimate.shared),
        )
        rows.append(row(by_imu.recording.name, MOCAP, APART, rmse))
    return rows


def medians(rows: Sequence[Row]) -> list[Row]:
    """Over the recordings, by sensor and kind of prediction."""
    kinds = dict.fromkeys((row["sensor"], row["prediction"]) for row in rows)
    table = list[Row]()
    for sensor, kind in kinds:
        chosen = _of(rows, sensor, kind)
        errors = {name: float(np.median(column(chosen, name))) for name in COLUMNS}
        table.append({"judged by": sensor, "prediction": kind, **errors})
    return table


COLUMNS = tuple(f"{angle} RMSE [deg]" for angle in ANGLES)


def _of(rows: Sequence[Row], sensor: str, kind: str) -> list[Row]:
    return rows_where(rows_where(rows, "sensor", sensor), "prediction", kind)


def shares(rows: Sequence[Row]) -> str:
    """Sentences on roll and pitch by each sensor: what is explained, and by what the rest is
    missed.
    """
    sentences = []
    for sensor in (IMU, MOCAP):
        for name in COLUMNS:
            of_channel = FitShares(
                channel=f"{name.split()[0]} by the {sensor}",
                predicted=_median_fit(rows, sensor, OTHERS, name),
                together=_median_fit(rows, sensor, SEEN, name),
                alone=_median_fit(rows, sensor, ALONE, name),
            )
            sentences.append(f"- {of_channel}")
    return "\n".join(sentences)


def _median_fit(rows: Sequence[Row], sensor: str, kind: str, name: str) -> float:
    """[%]"""
    errors = np.array(column(_of(rows, sensor, kind), name))
    mean_errors = np.array(column(_of(rows, sensor, MEAN), name))
    return float(np.median(100.0 * (1.0 - errors / mean_errors)))


def worse_than_still(sessions: Sequence[Session]) -> list[str]:
    """Sentences on roll and pitch of each recording that is predicted worse than it stands
    still.
    """
    sentences = []
    for session in sessions:
        names = [prepared.recording.name for prepared in session.prepared]
        predictions = dict(zip(names, session.left_out, strict=True)) | session.at_rest
        for name, predicted in predictions.items():
            sentences += _worse_than_still(f"{name} by the {session.sensor}", predicted)
    return sentences


def _worse_than_still(recording: str, predicted: Predicted) -> list[str]:
    sentences = []
    rmse_of = zip(ANGLES, errors(predicted), still(predicted), about_mean(predicted), strict=True)
    for angle, error, still_error, mean_error in rmse_of:
        shortfall = compared(
            recording=recording,
            channel=angle,
            unit="deg",
            error=float(error),
            baselines={NOTHING_MOVES: float(still_error), MEAN: float(mean_error)},
        )
        if shortfall is not None:
            sentences.append(f"- {shortfall}")
    return sentences


def _beyond_sensors(rows: Sequence[Row]) -> str:
    """Channels that do worse than a vehicle that does not move, by more than the sensors differ."""
    channels = []
    for sensor in (IMU, MOCAP):
        kinds = (_of(rows, sensor, OTHERS), _of(rows, sensor, STILL), _of(rows, MOCAP, APART))
        for predicted, still_row, between_sensors in zip(*kinds, strict=True):
            for name in COLUMNS:
                if predicted[name] > still_row[name] + between_sensors[name]:
                    angle = name.split()[0]
                    channels.append(f"{angle} of {predicted['recording']} by the {sensor}")
    return ", ".join(channels) or "none"


def _span(values: Sequence[float]) -> str:
    if not values:
        return "nothing"
    return f"{min(values):.0f} to {max(values):.0f}"


def _off(free: Sequence[Row], name: str, *, large: bool) -> list[float]:
    """List the differences [%] of free swings, of the large ones or of the others."""
    swings_of_size = [row for row in free if (row["size [deg]"] > LARGE) is large]
    return [row[name] for row in swings_of_size if name in row]


def _middle(values: Sequence[float]) -> str:
    return f"{np.median(np.abs(values)):.0f}" if values else "nothing"


def prose(imu: Session, mocap: Session, rows: Sequence[Row], free: Sequence[Row]) -> str:
    """Fill in the figures of both sensors."""
    offsets = np.degrees(np.std(list(imu.estimate.per_recording.values()), axis=0))
    return PROSE.format(
        n=len(imu.prepared),
        known=KNOWN,
        offset=OFFSET_TIME,
        wanted=WANTED,
        apart=APART,
        seen=SEEN,
        alone=ALONE,
        turn_mocap=mocap.turn,
        turn_imu=imu.turn,
        rest_imu=" and ".join(f"{value:.2f}" for value in offsets),
        shares=shares(rows),
        at_rest=", ".join(imu.at_rest) or "of which there are none",
        worse="\n".join(worse_than_still([imu, mocap])) or "None.",
        beyond=_beyond_sensors(rows),
        n_swings=len(free),
        large=LARGE,
        periods=_span(_off(free, "period [%]", large=True)),
        dampings=_span(_off(free, "damping [%]", large=True)),
        small_periods=_span(_off(free, "period [%]", large=False)),
        small_damping=_middle(_off(free, "damping [%]", large=False)),
        period=PERIOD,
        damping=DAMPING,
    )


def main() -> None:
    """Identify and predict by both sensors."""
    parser = parser_of(__doc__)
    parser.add_argument("folder", type=Path, help="of the recordings")
    arguments, run = begin(parser)
    imu = session(arguments.folder, IMU, quick=run.quick)
    mocap = session(arguments.folder, MOCAP, quick=run.quick)
    rows = [*imu.rows(), *mocap.rows(), *between(imu, mocap)]
    free = list[Row]()
    for prepared, predicted in zip(imu.prepared, imu.left_out, strict=True):
        free += swings(prepared.recording, predicted)
    name = "identification_hinsdale"
    run.write(
        Report(
            name=name,
            title="Identification of a vehicle whose arm moves",
            prose=prose(imu, mocap, rows, free),
            tables=[
                Table(
                    rows=medians(rows),
                    columns={"judged by": "", "prediction": "", **dict.fromkeys(COLUMNS, ".2f")},
                ),
                Table(
                    rows=free,
                    columns={"recording": "", "angle": "", **dict.fromkeys(SWINGS, ".3g")},
                ),
            ],
            data={name: rows, f"{name}_swings": free},
        )
    )


SWINGS = ("size [deg]", "period [s]", "predicted period [s]", "damping", "predicted damping")


if __name__ == "__main__":
    main()
