"""Calibrate a robot: from recordings to its numbers, their intervals, predictions and doubts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from uvms_ocp.checks import checked
from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification import model, parameters, uncertainty, validation
from uvms_ocp.identification.calibration_robot import CalibratedRobot, with_delays
from uvms_ocp.identification.channel_evidence import Evidence, channel_evidence
from uvms_ocp.identification.completed_recordings import along_axes, with_thrust
from uvms_ocp.identification.data_quality import check_data_quality
from uvms_ocp.identification.estimates import Estimate, FitStatus, Noise
from uvms_ocp.identification.exported_estimate import ExportedEstimate, exported_estimate
from uvms_ocp.identification.fit import FitContext, Search
from uvms_ocp.identification.held_constants import HeldConstant, held_constants
from uvms_ocp.identification.identified_numbers import IdentifiedNumber, numbers
from uvms_ocp.identification.jackknife import DisagreedNumber, disagreed_numbers
from uvms_ocp.identification.prediction_bounds import PredictionBounds, fit_bounds
from uvms_ocp.identification.prediction_text import verdict_words
from uvms_ocp.identification.predictor import Predicted
from uvms_ocp.identification.profiles import Profile, profiles
from uvms_ocp.identification.recording import Recording
from uvms_ocp.identification.recording_gaps import split_at_gaps
from uvms_ocp.identification.rollout import Rollout
from uvms_ocp.identification.segments import COMMANDS, PreparedRecording
from uvms_ocp.identification.settings import CalibrationSettings
from uvms_ocp.identification.settings_checks import check_settings, require_current
from uvms_ocp.identification.static_baselines import StaticBalance, static_baseline
from uvms_ocp.identification.still_comparison import WorseThanStill, worse_than_still
from uvms_ocp.identification.whiteness import (
    Whiteness,
    variance_inflation,
    whiteness,
)
from uvms_ocp.interrupts import raised_outside_casadi
from uvms_ocp.progress import progress_bar
from uvms_ocp.record.display import SmallTable, TableDisplay, cell


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Comparison:
    """A recording, predicted from its commands, its start fitted to the first measurements."""

    name: str
    """Name of the recording."""
    calibrated: Predicted
    """Prediction by the calibrated vehicle."""
    before: Predicted
    """Prediction by the vehicle as declared."""
    static: Predicted
    """Prediction by a vehicle that stays as it was measured first."""
    balance: Predicted
    """Prediction by a vehicle at rest where weight and buoyancy of the calibrated one balance."""
    residuals: Predicted
    """Residuals of the search, segment by segment."""
    whiteness: tuple[Whiteness, ...]
    """Whiteness of the residuals."""

    @property
    def worse_than_still(self) -> tuple[WorseThanStill, ...]:
        """Channels in which the calibrated vehicle errs more than one that stands still."""
        return tuple(worse_than_still(self.name, self.calibrated, self.static))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False, repr=False)
class Calibration(TableDisplay):
    """Result of a calibration of a robot."""

    subject: CalibratedRobot
    """Robot that was calibrated, with the numbers that it began with."""
    estimate: Estimate
    """Result of the search."""
    exported: ExportedEstimate
    """Estimate that the robot's file gets."""
    numbers: tuple[IdentifiedNumber, ...]
    """Numbers of the vehicle that depend on what was learnt."""
    open: tuple[uncertainty.UnidentifiableDirection, ...]
    """Combinations of unknowns that the recordings do not determine."""
    inflation: float
    """Number of samples that miss alike: intervals are wider by its root than with white residuals."""
    whiteness: tuple[Whiteness, ...]
    """Whiteness of the residuals of all recordings."""
    comparisons: tuple[Comparison, ...]
    """Predictions of the recordings that it was calibrated on."""
    issues: tuple[str, ...]
    """Doubts about the recordings, each with the name of its recording."""
    evidence: tuple[tuple[str, Evidence], ...] = ()
    """What the reading of each channel rests on, each with the name of its recording."""
    constants: tuple[HeldConstant, ...] = ()
    """Constants that the fit held fixed though they are uncertain; none for runs of this toolkit,
    whose constants are known.
    """
    profiles: tuple[Profile, ...] = ()
    """Profiles of the determined numbers, if asked for."""
    left_out: tuple[validation.HeldOutRecording, ...] = ()
    """Predictions of every recording by a fit to the others, if asked for."""
    left_out_bounds: PredictionBounds | None = None
    """Fits of vehicles to the recordings that are left out, which bound their predictions."""
    predicted: tuple[validation.HeldOutRecording, ...] = ()
    """Predictions of further recordings, on which nothing was identified, if any were given."""
    predicted_bounds: PredictionBounds | None = None
    """Fits of vehicles to these further recordings, which bound their predictions."""

    @property
    def status(self) -> FitStatus:
        """Reason for which the search ended; `NO_ANSWER` where it converged and nothing comes of it."""
        if self.exported.estimate.status is FitStatus.NO_ANSWER:
            return FitStatus.NO_ANSWER
        return self.estimate.status

    @property
    def advice(self) -> str:
        """What to do next, by the status."""
        if self.status is FitStatus.NO_ANSWER:
            return self.exported.advice
        return self.status.advice

    @property
    def verdicts(self) -> tuple[str, ...]:
        """One line on each set of predictions that was asked for, on what they are worth."""
        verdicts = []
        if self.left_out:
            verdicts.append(verdict_words("left out", self.left_out))
        if self.predicted:
            verdicts.append(verdict_words("predicted", self.predicted))
        return tuple(verdicts)

    @property
    def disagreed(self) -> tuple[DisagreedNumber, ...]:
        """Numbers called determined on which fits without one recording each disagree; none where
        nothing was left out.
        """
        return tuple(disagreed_numbers(self.subject.vehicle, self.numbers, self.left_out))

    @property
    def worse_than_still(self) -> tuple[WorseThanStill, ...]:
        """Channels that are predicted worse than by a vehicle that stands still, of every
        prediction that was made.
        """
        shortfalls: list[WorseThanStill] = []
        for comparison in self.comparisons:
            shortfalls += comparison.worse_than_still
        for recording in (*self.left_out, *self.predicted):
            shortfalls += recording.worse_than_still
        return tuple(shortfalls)

    def _table(self) -> SmallTable:
        rows = []
        for number in self.numbers:
            remark = "" if number.determined else "not determined"
            values = (number.name, number.value, *number.interval, number.unit, remark)
            rows.append(tuple(cell(value) for value in values))
        sentences = (*self.verdicts, *self.worse_than_still, *self.disagreed)
        return SmallTable(
            title="Calibration",
            words=" ".join(str(sentence) for sentence in sentences),
            head=("number", "value", "from", "to, 95 %", "unit", ""),
            rows=tuple(rows),
        )


@checked
@raised_outside_casadi()
def calibrate(
    subject: CalibratedRobot,
    settings: CalibrationSettings,
    recordings: Sequence[Recording],
    *,
    profiled: bool = False,
    leave_one_out: bool = False,
    predict: Sequence[Recording] = (),
    bounds: bool = True,
    progress: Callable[[str], None] | None = None,
    warn: Callable[[str], None] = lambda _: None,
) -> Calibration:
    """Identify the numbers of a robot from recordings, which are cut at their silences.

    profiled, leave_one_out: True for profiles and leave-one-out predictions, which take longer.
    predict: further recordings, on which nothing is identified and which are predicted. bounds:
    False saves the fits that bound predictions, one to all that are predicted and one to each of
    them. progress gets a line at each step, in place of a bar. warn gets every issue before
    anything is searched. Raises InvalidInput for no recordings, one alone to be left out, equal names, a channel that is
    missing, or a current that is recorded and not learnt.
    """
    recordings = _with_commands(subject, settings, recordings)
    to_predict = _with_commands(subject, settings, predict)
    _require_distinct(recordings, to_predict, leave_one_out=leave_one_out)
    at_once = all(recording.at_once for recording in recordings)
    subject = with_delays(subject, settings, at_once=at_once)
    prepared = _prepared(subject, settings, recordings)
    prepared_to_predict = _prepared(subject, settings, to_predict)
    issues, evidence = _issues(subject, settings, (*recordings, *to_predict), warn)
    noise = Noise(**settings.noise.model_dump())
    rollout = Rollout(model.stage_of(subject.vehicle, sharp=True))
    with progress_bar(shown=progress is None, bar_format="{elapsed} {desc}") as bar:
        progress = progress or bar.set_description_str
        fitted = FitContext.searched(
            vehicle=subject.vehicle,
            rollout=rollout,
            prepared=prepared,
            noise=noise,
            search=Search(step=settings.step, segment_length=settings.stretch, progress=progress),
        )
        residuals = fitted.residuals()
        joined_residuals = Predicted.joined(list(residuals.values()))
        inflation = variance_inflation(joined_residuals, fitted.noise)
        constants = tuple[HeldConstant, ...]()
        has_converged = fitted.estimate.status is FitStatus.CONVERGED
        if has_converged and not at_once and len(fitted.estimate.shared):
            progress("what constants would change")
            estimate, constants = held_constants(fitted, settings, inflation)
            fitted = replace(fitted, estimate=estimate)
        left_out_bounds = None
        if leave_one_out and bounds:
            left_out_bounds = fit_bounds(fitted, prepared, progress)
        predicted_bounds = None
        if prepared_to_predict and bounds:
            predicted_bounds = fit_bounds(fitted, prepared_to_predict, progress)
        whiteness_tests = whiteness(joined_residuals, fitted.noise)
        identified = numbers(subject.vehicle, fitted.estimate, inflation, whiteness_tests)
        exported = exported_estimate(fitted, inflation, identified)
        directions = uncertainty.unidentifiable_directions(
            subject.vehicle, fitted.estimate, inflation
        )
        balance = StaticBalance(subject.vehicle)
        comparisons = []
        for recording in prepared:
            missed = residuals[recording.recording.name]
            comparisons.append(_comparison(fitted, balance, recording, missed))
        number_profiles = tuple[Profile, ...]()
        if profiled:
            number_profiles = tuple(profiles(fitted, identified, inflation, progress))
        left_out = tuple[validation.HeldOutRecording, ...]()
        if leave_one_out:
            left_out = tuple(
                validation.leave_one_out(fitted, progress=progress, bounds=left_out_bounds)
            )
        predicted = tuple(
            validation.predict_others(
                fitted, prepared_to_predict, progress=progress, bounds=predicted_bounds
            )
        )
        return Calibration(
            subject=subject,
            estimate=fitted.estimate,
            exported=exported,
            numbers=identified,
            open=directions,
            inflation=inflation,
            whiteness=whiteness_tests,
            comparisons=tuple(comparisons),
            issues=tuple(issues),
            evidence=tuple(evidence),
            constants=constants,
            profiles=number_profiles,
            left_out=left_out,
            left_out_bounds=left_out_bounds,
            predicted=predicted,
            predicted_bounds=predicted_bounds,
        )


def _require_distinct(
    recordings: Sequence[Recording], to_predict: Sequence[Recording], *, leave_one_out: bool
) -> None:
    """Check that there are recordings, each with its name, and two at least to leave one out."""
    names = [recording.name for recording in recordings]
    all_names = names + [recording.name for recording in to_predict]
    if not names or len(set(all_names)) < len(all_names):
        raise InvalidInput(
            f"recordings {all_names} given; allowed: one at least, each with a name of its own"
        )
    if leave_one_out and len({recording.source for recording in recordings}) < 2:
        raise InvalidInput(f"recordings {names} given; leave-one-out needs at least 2")


def _issues(
    subject: CalibratedRobot,
    settings: CalibrationSettings,
    recordings: Sequence[Recording],
    warn: Callable[[str], None],
) -> tuple[list[str], list[tuple[str, Evidence]]]:
    """List the doubts about recordings and settings, and what the reading of channels rests on, each
    with the name of its recording; warn gets each doubt at once.
    """
    issues = []
    evidence = []
    for recording in recordings:
        quality_issues = check_data_quality(recording)
        for entry in channel_evidence(recording, quality_issues):
            evidence.append((recording.name, entry))
        for doubt in (*quality_issues, *check_settings(subject, settings, recording)):
            issue = f"{recording.name}: {doubt}"
            issues.append(issue)
            warn(issue)
    return issues, evidence


def _with_commands(
    subject: CalibratedRobot, settings: CalibrationSettings, recordings: Sequence[Recording]
) -> tuple[Recording, ...]:
    """Return recordings, cut at silences, with thrust in the place of propeller commands."""
    if settings.commands != "propeller_commands":
        return split_at_gaps(recordings)
    moves_freely = len(subject.vehicle.axes) == len(parameters.AXES)
    with_commands = []
    for recording in recordings:
        # Decay tests, of vehicles that are held, may have no commands.
        if moves_freely or recording.channels.keys() & COMMANDS:
            with_commands.append(with_thrust(subject.robot, recording))
        else:
            with_commands.append(recording)
    return split_at_gaps(with_commands)


def _prepared(
    subject: CalibratedRobot, settings: CalibrationSettings, recordings: Sequence[Recording]
) -> tuple[PreparedRecording, ...]:
    """Return recordings, prepared for the vehicle. Raises InvalidInput for one that is too short,
    or in a current that is not learnt.
    """
    n_commands = subject.vehicle.actuators.allocation.shape[1]
    prepared = []
    for recording in recordings:
        completed = along_axes(recording, settings, n_commands)
        prepared.append(PreparedRecording.of(completed, subject.vehicle))
    for item in prepared:
        item.segments(settings.step, settings.stretch)  # or it is too short
        require_current(subject, item.recording)
    return tuple(prepared)


def _comparison(
    fitted: FitContext,
    balance: StaticBalance,
    recording: PreparedRecording,
    missed: Predicted,
) -> Comparison:
    """Predict a recording by the calibrated vehicle, and by those that know less."""
    (segment,) = recording.segments(fitted.search.step)
    after = fitted.predictor()
    before = fitted.predictor(fitted.vehicle.shared.start)
    return Comparison(
        name=recording.recording.name,
        calibrated=after.of(segment),
        before=before.of(segment),
        static=static_baseline(segment, after.start_window),
        balance=balance.of_segment(segment, fitted.estimate.shared),
        residuals=missed,
        whiteness=whiteness(missed, fitted.noise),
    )
