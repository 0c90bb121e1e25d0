"""Recordings in, all that is known of a robot after them out."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.identification.answers.certainty import Open, correlated, left_open
from uvms_ocp.identification.answers.fitted import Fitted
from uvms_ocp.identification.answers.left_out import LeftOut, left_out
from uvms_ocp.identification.answers.nulls import Balance, still
from uvms_ocp.identification.answers.numbers import Number, numbers
from uvms_ocp.identification.answers.predictions import Predicted
from uvms_ocp.identification.answers.profiles import Profile, profiles
from uvms_ocp.identification.answers.whiteness import Whiteness, whiteness
from uvms_ocp.identification.calibration.flown import Flown, flown
from uvms_ocp.identification.calibration.neglected import neglected, require_current
from uvms_ocp.identification.calibration.settings import Settings
from uvms_ocp.identification.calibration.subject import Subject
from uvms_ocp.identification.methods.output_error import Estimate, Noise
from uvms_ocp.identification.methods.rollout import Rollout
from uvms_ocp.identification.methods.search import Search, searched
from uvms_ocp.identification.methods.stretch import Prepared
from uvms_ocp.identification.models.stage import stage_of
from uvms_ocp.identification.recordings.doubts import doubts
from uvms_ocp.identification.recordings.recording import Recording
from uvms_ocp.identification.recordings.silences import parted


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Comparison:
    """A recording, predicted from its commands, its start fitted on what was seen first."""

    name: str
    calibrated: Predicted
    before: Predicted
    """By the vehicle as it was declared."""
    still: Predicted
    """By one that stays as it was seen first."""
    balance: Predicted
    """By one that stays where weight and buoyancy turn the calibrated vehicle no further."""
    left: Predicted
    """Stretch by stretch, as the search has left it."""
    whiteness: tuple[Whiteness, ...]
    """Of what is left."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Calibration:
    """Of a subject."""

    subject: Subject
    estimate: Estimate
    flown: Flown
    """What the robot's file says of it."""
    numbers: tuple[Number, ...]
    open: tuple[Open, ...]
    """Combinations of unknowns that the recordings do not determine."""
    together: float
    """[-] samples that miss alike: intervals are wider by its root than white residuals would have them."""
    whiteness: tuple[Whiteness, ...]
    """Of what is left of all recordings."""
    comparisons: tuple[Comparison, ...]
    doubts: tuple[str, ...]
    profiles: tuple[Profile, ...] = ()
    """Of the numbers that are determined, where they were asked for."""
    left_out: tuple[LeftOut, ...] = ()
    """Every recording, predicted by what the others tell, where that was asked for."""


def calibrated(
    subject: Subject,
    settings: Settings,
    recordings: Sequence[Recording],
    *,
    profiled: bool = False,
    leave_one_out: bool = False,
    tell: Callable[[str], None] = lambda _: None,
    warn: Callable[[str], None] = lambda _: None,
) -> Calibration:
    """Identify; with profiles and leave-one-out, which take longer, if wanted; tell is told what is being done.

    warn is told every doubt before anything is searched. Recordings with silences are cut there.
    Raises InvalidInput for no recordings, one alone to be left out, equal names, or a current that is recorded and not
    learnt, and NameNotFound for a channel that is missing.
    """
    recordings = parted(recordings)
    _require(recordings, leave_one_out)
    prepared = tuple(Prepared.of(one, subject.vehicle) for one in recordings)
    for one in prepared:
        one.stretches(settings.step, settings.stretch)  # or it is too short
        require_current(subject, one.recording)
    doubtful = tuple(_doubtful(subject, settings, recordings))
    for doubt in doubtful:
        warn(doubt)
    fitted = _fitted(subject, settings, prepared)
    left = fitted.left()
    together = correlated(left, fitted.noise)
    told = numbers(subject.vehicle, fitted.estimate, together)
    return Calibration(
        subject=subject,
        estimate=fitted.estimate,
        flown=flown(fitted, together),
        numbers=told,
        open=left_open(subject.vehicle, fitted.estimate, together),
        together=together,
        whiteness=whiteness(left, fitted.noise),
        comparisons=_comparisons(fitted),
        doubts=doubtful,
        profiles=tuple(profiles(fitted, told, together, tell)) if profiled else (),
        left_out=tuple(left_out(fitted, tell=tell)) if leave_one_out else (),
    )


def _doubtful(subject: Subject, settings: Settings, recordings: Sequence[Recording]) -> Iterator[str]:
    for one in recordings:
        yield from (f"{one.name}: {doubt}" for doubt in (*doubts(one), *neglected(subject, settings, one)))


def _require(recordings: Sequence[Recording], leave_one_out: bool) -> None:
    names = [one.name for one in recordings]
    if not names or len(set(names)) < len(names):
        raise InvalidInput(f"recordings {names} given; allowed: one at least, each with a name of its own")
    if leave_one_out and len(names) < 2:
        raise InvalidInput(f"recordings {names} given; leave-one-out needs at least 2")


def _fitted(subject: Subject, settings: Settings, prepared: tuple[Prepared, ...]) -> Fitted:
    vehicle, noise = subject.vehicle, Noise(**settings.noise.model_dump())
    rollout = Rollout(stage_of(vehicle))
    search = Search(step=settings.step, stretch=settings.stretch)
    return Fitted(
        vehicle=vehicle,
        rollout=rollout,
        prepared=prepared,
        noise=noise,
        search=search,
        estimate=searched(vehicle, prepared, noise, rollout, search),
    )


def _comparisons(fitted: Fitted) -> tuple[Comparison, ...]:
    balance = Balance.of(fitted.vehicle)
    return tuple(_comparison(fitted, balance, one) for one in fitted.prepared)


def _comparison(fitted: Fitted, balance: Balance, one: Prepared) -> Comparison:
    (whole,) = one.stretches(fitted.search.step)
    after, before = fitted.predictor(), fitted.predictor(fitted.vehicle.shared.start)
    left = fitted.left(one.recording.name)
    return Comparison(
        name=one.recording.name,
        calibrated=after.of(whole),
        before=before.of(whole),
        still=still(whole, after.known),
        balance=balance.of_stretch(whole, fitted.estimate.shared),
        left=left,
        whiteness=whiteness(left, fitted.noise),
    )
