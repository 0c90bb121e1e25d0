"""Recordings in, all that is known of a robot after them out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.identification.answers.certainty import Open, correlated, left_open
from uvms_ocp.identification.answers.numbers import Number, numbers
from uvms_ocp.identification.answers.predictions import Predicted, Predictor, rolled_out
from uvms_ocp.identification.calibration.settings import Settings
from uvms_ocp.identification.calibration.subject import Subject
from uvms_ocp.identification.methods.output_error import Estimate, Noise
from uvms_ocp.identification.methods.rollout import Rollout
from uvms_ocp.identification.methods.search import Search, searched
from uvms_ocp.identification.methods.stretch import Prepared
from uvms_ocp.identification.models.stage import stage_of
from uvms_ocp.identification.recordings.doubts import doubts
from uvms_ocp.identification.recordings.recording import Recording


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Comparison:
    """A recording, predicted from its commands, its start fitted on what was seen first."""

    name: str
    calibrated: Predicted
    before: Predicted
    """By the vehicle as it was declared."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Calibration:
    """Of a subject."""

    subject: Subject
    estimate: Estimate
    numbers: tuple[Number, ...]
    open: tuple[Open, ...]
    """Combinations of unknowns that the recordings do not determine."""
    together: float
    """[-] samples that miss alike: intervals are wider by its root than white residuals would have them."""
    comparisons: tuple[Comparison, ...]
    doubts: tuple[str, ...]


def calibrated(subject: Subject, settings: Settings, recordings: Sequence[Recording]) -> Calibration:
    """Identify. Raises InvalidInput for no recordings or equal names, and NameNotFound for a channel that is missing."""
    names = [one.name for one in recordings]
    if not names or len(set(names)) < len(names):
        raise InvalidInput(f"recordings {names} given; allowed: one at least, each with a name of its own")
    vehicle, noise = subject.vehicle, Noise(**settings.noise.model_dump())
    prepared, rollout = [Prepared.of(one, vehicle) for one in recordings], Rollout(stage_of(vehicle))
    search = Search(step=settings.step, stretch=settings.stretch)
    estimate = searched(vehicle, prepared, noise, rollout, search)
    seen = _in_sample(rollout, prepared, estimate, settings)
    together = correlated(seen, noise)
    predictors = [
        Predictor(vehicle=vehicle, rollout=rollout, shared=shared, noise=noise)
        for shared in (estimate.shared, vehicle.shared.start)
    ]
    return Calibration(
        subject=subject,
        estimate=estimate,
        numbers=numbers(vehicle, estimate, together),
        open=left_open(vehicle, estimate, together),
        together=together,
        comparisons=tuple(_comparison(one, predictors, settings.step) for one in prepared),
        doubts=tuple(f"{one.name}: {doubt}" for one in recordings for doubt in doubts(one)),
    )


def _comparison(one: Prepared, predictors: Sequence[Predictor], step: float) -> Comparison:
    (whole,) = one.stretches(step)
    after, before = (predictor.of(whole) for predictor in predictors)
    return Comparison(name=one.recording.name, calibrated=after, before=before)


def _in_sample(rollout: Rollout, prepared: Sequence[Prepared], estimate: Estimate, settings: Settings) -> Predicted:
    """What is left of all stretches, by which samples are found to miss alike."""
    stretches = [part for one in prepared for part in one.stretches(settings.step, settings.stretch)]
    pairs, own = zip(stretches, estimate.starts, strict=True), estimate.own
    return Predicted.joined(
        [rolled_out(rollout, one, start, estimate.shared, own[one.recording]) for one, start in pairs]
    )
