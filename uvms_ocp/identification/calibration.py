"""Calibrate a robot: from recordings to all that is known of it after them.

An unknown that recordings do not determine ends anywhere, often at next to nothing, and a vehicle
would fly with it: the exported estimate holds these where they were declared, and fits all others
anew about them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification import model, parameters, uncertainty, validation
from uvms_ocp.identification.data_quality import (
    MAY,
    SHIFTS,
    ExplainedMotion,
    check_data_quality,
    commanded,
    motion_of,
)
from uvms_ocp.identification.fit import FitContext, Predicted, Search, constant_slopes
from uvms_ocp.identification.jackknife import DisagreedNumber, disagreed_numbers
from uvms_ocp.identification.output_error import Estimate, FitStatus, Noise
from uvms_ocp.identification.prediction_bounds import PredictionBounds, fit_bounds
from uvms_ocp.identification.prediction_text import verdict_words
from uvms_ocp.identification.recording import Channel, Recording, ZeroOrderHold, split_at_gaps
from uvms_ocp.identification.rollout import COMMANDS, POSE_INTERVAL, PreparedRecording, Rollout
from uvms_ocp.identification.sample_checks import QualityIssue
from uvms_ocp.identification.settings import CalibratedRobot, CalibrationSettings, with_delays
from uvms_ocp.identification.still_comparison import WorseThanStill, worse_than_still
from uvms_ocp.interrupts import raised_outside_casadi
from uvms_ocp.progress import progress_bar
from uvms_ocp.record.display import SmallTable, TableDisplay, cell
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.thrusters import thrust_limits, thrust_of_signals, thruster_matrix

# Whether a vehicle accelerates as its thrusters push, or as if some were exchanged or reversed.

_BETTER = 0.5  # of one axis, by which another way must explain more
# of what moves, that it must explain: what holds a vehicle against waves pushes against its motion
_WELL = 0.4
_MOST = 4  # changes that are looked for, one after the other

_FLOWS = 0.01  # [m/s] of a current that is told
_STRONG = 0.05  # [m/s] of one that spoils a fit without it: added mass and drag take its place
_SOON = 0.005  # [s] of a delay that is not
_BEYOND = 1e-3  # of a limit
_LEVEL = (0.0, 0.0, 0.0, 1.0)

_ALIKE = {"wrench_offset": "bias", "attitude_offset": "attitude_turn"}
"""Constants that each recording has one of, and the constant of all recordings that a fit adds to
it.
"""
_FILED = ("mass", "centre_of_mass", "second_moment")
_SEEN = ("bias", "current")
"""Constants of the robot's file, and assumed ones that are no part of intervals: recordings show
them where they are not 0.
"""
_NOISIER = {"velocity": "m/s", "rate": "rad/s", "vertical": "-", "process": "m/s, rad/s, rad"}
"""Deviations of noise that weigh samples, and units: what they would change if they were twice as
large.
"""


def mixed_thrusters(
    recording: Recording, thrust: Channel, B: np.ndarray, names: Sequence[str]
) -> str:
    """Detect thrusters that were exchanged or reversed, by commands that explain the motion better;
    empty if none is clear.

    thrust: [N] columns in the order of names, which push by B (6, n) [-, m].
    """
    motion = motion_of(recording)
    if motion is None or thrust.values.shape[1] != B.shape[1]:
        return ""
    agreement = _agreement(motion, thrust)
    changes = list[str]()
    axes = int((np.abs(B) > 1e-9).any(axis=1).sum())
    best = agreement(B)
    for _ in range(_MOST):
        ways = {text: B @ Q for text, Q in _ways(names).items()}
        agreements: Mapping[str, float] = {text: agreement(way) for text, way in ways.items()}
        text = max(agreements, key=lambda change: agreements[change])
        if agreements[text] < best + _BETTER:
            break
        best = agreements[text]
        B = ways[text]
        changes.append(text)
    if best > _WELL * axes:
        return " and ".join(changes)
    return ""


def _agreement(motion: ExplainedMotion, thrust: Channel) -> Callable[[np.ndarray], float]:
    """Shares that thrusters B (6, n) [-, m] explain, less where a vehicle accelerates against them;
    mean over axes.

    From correlations of accelerations, in units of their own size, with thrust, at time shifts of
    the one before the other.
    """
    held = ZeroOrderHold(thrust)
    commands = np.array([commanded(held, motion, shift) for shift in SHIFTS[MAY]])
    size = np.maximum(np.linalg.norm(motion.acceleration, axis=0), 1e-300)
    common = (motion.acceleration / size).T @ commands
    gram = commands.swapaxes(1, 2) @ commands

    def of(B: np.ndarray) -> float:
        along = (B * common).sum(axis=2)
        size = np.sqrt(np.maximum(np.einsum("ij,mjk,ik->mi", B, gram, B), 0.0))
        pushed = size > 1e-9 * max(float(size.max()), 1e-300)
        cosine = np.where(pushed, along / np.where(pushed, size, 1.0), 0.0)
        return float((cosine * np.abs(cosine)).sum(axis=1).max())

    return of


def _ways(names: Sequence[str]) -> dict[str, np.ndarray]:
    """Build matrices (n, n) that permute or reverse the names, by a text that says how."""
    places = np.arange(len(names))
    permutations = {"all reversed": -np.eye(len(names))}
    permutations |= {
        f"{name} reversed": np.diag(np.where(places == k, -1.0, 1.0))
        for k, name in enumerate(names)
    }
    for i, j in combinations(range(len(names)), 2):
        order = places.copy()
        order[[i, j]] = j, i
        permutations[f"{names[i]} and {names[j]} exchanged"] = np.eye(len(names))[order]
    return permutations


# What a recording says, and a fit with these settings takes for something else: doubts about both
# together.


def check_settings(
    subject: CalibratedRobot, settings: CalibrationSettings, recording: Recording
) -> Iterator[QualityIssue]:
    """Check the settings, one after the other."""
    quantities = subject.vehicle.own.declaration.quantities
    channels = recording.channels
    if "current" in channels:
        yield from _of_current(channels["current"], learnt=bool(quantities["current"].free.all()))
    if not channels.keys() & {"thrust", "wrench"}:
        yield QualityIssue(
            channel=settings.commands,
            problem="not recorded: a fit along some axes takes nothing to push it",
        )
    if "linear_velocity" not in channels and "position" in channels:
        text = (
            f"not recorded: means between poses {POSE_INTERVAL:g} s apart or more take its place,"
            " with large noise"
        )
        yield QualityIssue(channel="linear_velocity", problem=text)
    delayed = (
        settings.delay is not None and settings.delay > _SOON and not quantities["delay"].free.any()
    )
    if recording.at_once and delayed:
        text = (
            "commands of a run of this toolkit act at once, and a fit holds their delay at"
            f" {settings.delay:g} s: leave it out"
        )
        yield QualityIssue(channel=settings.commands, problem=text)
    if recording.at_once and settings.commands == "wrench" and "thrust" in channels:
        text = (
            "thrusters were driven ahead of their lag to give it, and a lag by it is not theirs:"
            " give commands: thrust"
        )
        yield QualityIssue(channel="wrench", problem=text)
    if "thrust" in channels and settings.commands != "wrench":
        yield from _of_thrust(
            recording, channels["thrust"].of(subject.robot.thruster_names, "thrust"), subject
        )


def along_axes(recording: Recording, settings: CalibrationSettings, n_commands: int) -> Recording:
    """Complete the recording of a vehicle that moves along some axes alone by channels that it need
    not have.

    It stands level, is at rest along the others, and nothing pushes it where no commands are
    recorded, as in a decay test.
    """
    held = frozenset(parameters.AXES).difference(settings.axes)
    names = parameters.AXES
    commands = "wrench" if settings.commands == "wrench" else "thrust"
    rest: dict[str, tuple[tuple[str, ...], Any]] = {
        commands: ((), [0.0] * n_commands),
        "attitude": (names[3:5], _LEVEL),
    }
    rest |= {"linear_velocity": (names[:3], [0.0] * 3), "angular_velocity": (names[3:], [0.0] * 3)}
    longest = max(recording.channels.values(), key=lambda channel: len(channel.t))
    assumed = {
        name: replace(longest, values=np.tile(value, (len(longest.t), 1)), columns=())
        for name, (axes, value) in rest.items()
        if held
        and held.issuperset(axes)
        and not (name == "linear_velocity" and "position" in recording.channels)
    }
    return replace(recording, channels={**assumed, **recording.channels})


def require_current(subject: CalibratedRobot, recording: Recording) -> None:
    """Check currents; raises InvalidInput for a recorded current that is strong, and that no
    unknown may take.

    Such a fit converges where its numbers are wrong by many of their standard errors.
    """
    current = recording.channels.get("current")
    free = subject.vehicle.own.declaration.quantities["current"].free
    if current is None:
        size = 0.0
    else:
        size = float(np.linalg.norm(current.values.mean(axis=0)))
    if size > _STRONG and not free.any():
        problem = (
            f"{recording.name}: a current of {size:.2g} m/s, which the fit would take for still"
            " water"
        )
        raise InvalidInput(
            f"{problem}; learn it too: `current: {{prior: 0.2}}`, or leave the recording out"
        )


def _of_current(current: Channel, *, learnt: bool) -> Iterator[QualityIssue]:
    values = current.values - (current.values.mean(axis=0) if learnt else 0.0)
    size = float(np.linalg.norm(values, axis=1).max())
    if size > _FLOWS:
        assumption = (
            "that a fit takes for still water: learn it",
            "about its mean, and a fit takes it for steady",
        )[learnt]
        yield QualityIssue(channel="current", problem=f"up to {size:.2g} m/s {assumption}")


def _of_thrust(
    recording: Recording, thrust: Channel, subject: CalibratedRobot
) -> Iterator[QualityIssue]:
    lower, upper = thrust_limits(subject.robot)
    beyond = (
        (thrust.values > upper * (1.0 + _BEYOND)) | (thrust.values < lower * (1.0 + _BEYOND))
    ).any(axis=0)
    if beyond.any():
        names = ", ".join(np.array(subject.robot.thruster_names)[beyond])
        yield QualityIssue(
            channel="thrust",
            problem=f"more is asked of {names} than they can give: a fit takes it for given",
        )
    mixed = mixed_thrusters(
        recording, thrust, thruster_matrix(subject.robot), subject.robot.thruster_names
    )
    if mixed:
        yield QualityIssue(
            channel="thrust",
            problem=f"the vehicle accelerates as with {mixed}: their order, their signs?",
        )


# What a robot's file may say of what was learnt: what stays open is as it was declared, and all
# else is fitted anew about it.
#
# An unknown that recordings do not determine ends anywhere, often at next to nothing, and a vehicle
# would fly with it. The others have taken its part where they were fitted with it: they are not
# kept as they were either. What is next to nothing because the recordings say so, as drag that
# another one takes the place of, stays so: as it was before it would contradict them.


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ExportedEstimate:
    """Estimate as it is exported to the robot's file."""

    estimate: Estimate
    kept: tuple[str, ...] = ()
    """Unknowns that are as they were declared, as ``added_mass surge``."""

    @property
    def usable(self) -> bool:
        """True if a file may be made of it: the search has converged."""
        return self.estimate.status is FitStatus.CONVERGED


def exported_estimate(fitted: FitContext, inflation: float) -> ExportedEstimate:
    """Hold undetermined numbers at their declared values where the recordings allow it, else one
    quantity after the other.

    inflation: samples that miss alike, as `variance_inflation` finds.
    """
    shared = fitted.vehicle.shared
    estimate = fitted.estimate
    is_open = (
        uncertainty.standard_errors(fitted.vehicle, estimate, inflation) > uncertainty.DETERMINED
    )
    is_held = np.zeros(len(is_open), dtype=bool)
    best = estimate
    if estimate.status is FitStatus.CONVERGED:
        for chosen in _chosen(shared, is_open):
            if (chosen <= is_held).all():
                held_fit = None
            else:
                held_fit = _held(fitted, is_held | chosen)
            allowed = uncertainty.INTERVAL**2 * inflation * int((is_held | chosen).sum())
            if held_fit is not None and 2.0 * (held_fit.cost - estimate.cost) < allowed:
                is_held = is_held | chosen
                best = held_fit
    return ExportedEstimate(estimate=best, kept=tuple(np.array(shared.names)[is_held].tolist()))


def _chosen(shared: parameters.Unknowns, is_open: np.ndarray) -> Iterator[np.ndarray]:
    """Yield masks (n,) [bool] of unknowns: all, then quantity by quantity."""
    yield is_open
    quantities = np.array([name.partition(" ")[0] for name in shared.names])
    for name in dict.fromkeys(quantities.tolist()):
        yield is_open & (quantities == name)


def _held(fitted: FitContext, which: np.ndarray) -> Estimate | None:
    """Refit with the unknowns of a mask which (n,) [bool] held as declared; `None` where that does
    not converge.
    """
    shared = fitted.vehicle.shared
    problem = replace(fitted, vehicle=replace(fitted.vehicle, shared=shared.held(which))).problem()
    warm_start = problem.resumed(
        replace(fitted.estimate, shared=np.where(which, shared.start, fitted.estimate.shared))
    )
    solution = problem.solve(
        warm_start, iterations=fitted.search.iterations, tolerance=1e-3
    )  # from near: a step leaves its square
    exact = replace(solution, shared=np.where(which, shared.start, solution.shared))
    if solution.status is FitStatus.CONVERGED:
        return exact
    return None


# What a fit takes for known: what numbers would be if it were otherwise. What is assumed widens
# intervals by it.

_SPREADS = {"gain": 0.03, "reverse": 0.03, "lag": 0.1, "delay": 0.01, "velocity_delay": 0.01}
_SPREADS |= {
    "mass": 0.02,
    "centre_of_mass": 0.005,
    "second_moment": 0.1,
    "velocity_point": 0.02,
    "attitude_turn": 0.01,
}
_SPREADS |= {"bias": 0.003, "current": 0.01, "rate_bias": 0.002}
"""Assumed standard deviations of constants: relative for gains, lags and masses, delays [s], points
[m], turns [rad], rates [rad/s], currents [m/s], biases by shares of the weight, and that at an arm
of 1 m.
"""


@dataclass(frozen=True, kw_only=True, slots=True)
class HeldConstant:
    """A quantity that a fit held, and its effect on the numbers."""

    quantity: str
    known: str
    """``given`` by the settings, of the ``robot's file``, or ``assumed``."""
    spread: float
    """Assumed standard deviation, relative or in [s], [m] or [rad]; of noise by how much it is
    larger, relative.
    """
    most: str
    """Number that it moves farthest by that."""
    change: float
    """[standard errors] of that number."""
    value: float = 0.0
    """Value that the fit takes for it, of noise; of all others the declaration has it."""
    unit: str = ""
    """Unit of `value`."""


def held_constants(
    fitted: FitContext, settings: CalibrationSettings, inflation: float
) -> tuple[Estimate, tuple[HeldConstant, ...]]:
    """Return the estimate with the uncertainty from assumed constants added, and all constants that
    a fit held.
    """
    quantities = fitted.vehicle.shared.declaration.quantities
    names, slopes = constant_slopes(
        fitted, [name for name in _SPREADS if not quantities[name].free.any()]
    )
    owners = np.array([name.partition(" ")[0] for name in names])
    units = {
        name: 1.0 / max(quantities[name].value.item(), parameters.AT_ONCE)
        for name in parameters.DELAYS
    }
    units["bias"] = (
        float(np.linalg.norm(fitted.vehicle.dynamics.model.gravity.linear))
        * quantities["mass"].value.item()
    )
    moved = slopes * [_SPREADS[name] * units.get(name, 1.0) for name in owners]
    numbered, with_unknowns = uncertainty.slopes_of(fitted.vehicle, fitted.estimate.shared)
    C = uncertainty.covariance(fitted.vehicle, fitted.estimate, inflation)
    errors = np.sqrt(np.einsum("ij,jk,ik->i", with_unknowns, C, with_unknowns))
    constants = []
    assumed = fitted.estimate.assumed

    def largest_effect(slopes_of_constant: np.ndarray) -> dict[str, Any]:
        """Find the number that changes (n, m) of unknowns move farthest, and how far."""
        change = np.linalg.norm(with_unknowns @ slopes_of_constant, axis=1) / errors
        return {"most": numbered[int(np.argmax(change))][1], "change": float(change.max())}

    for name in dict.fromkeys(owners.tolist()):
        of_file = name in _FILED or (name == "lag" and settings.commands != "wrench")
        if getattr(settings, name, None) is not None:
            origin = "given"
        else:
            origin = "robot's file" if of_file else "assumed"
        own_slopes = moved[:, owners == name]
        if origin == "assumed" and name not in _SEEN:
            assumed = assumed + own_slopes @ own_slopes.T
        twins = [
            quantity
            for quantity, twin in _ALIKE.items()
            if twin == name and not quantities[quantity].free.any()
        ]
        effect = largest_effect(own_slopes)
        constants += [
            HeldConstant(quantity=quantity, known=origin, spread=_SPREADS[name], **effect)
            for quantity in (name, *twins)
        ]
    for name, unit in _NOISIER.items():
        sigma = getattr(fitted.noise, name)
        origin = "given" if name in settings.noise.model_fields_set else "assumed"
        noisier = replace(fitted, noise=replace(fitted.noise, **{name: 2.0 * sigma})).problem()
        point, _ = noisier.stepped(noisier.resumed(fitted.estimate))
        moved_by = largest_effect((point.shared - fitted.estimate.shared)[:, None])
        constants.append(
            HeldConstant(
                quantity=f"noise {name}",
                known=origin,
                spread=1.0,
                value=sigma,
                unit=unit,
                **moved_by,
            )
        )
    return replace(fitted.estimate, assumed=assumed), tuple(constants)


# Recordings in, all that is known of a robot after them out.


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Comparison:
    """A recording, predicted from its commands, its start fitted to the first measurements."""

    name: str
    calibrated: Predicted
    before: Predicted
    """Prediction by the vehicle as declared."""
    static: Predicted
    """Prediction by a vehicle that stays as it was measured first."""
    balance: Predicted
    """Prediction by a vehicle at rest where weight and buoyancy of the calibrated one balance."""
    residuals: Predicted
    """Stretch by stretch, as the search has left it."""
    whiteness: tuple[uncertainty.Whiteness, ...]
    """Whiteness of the residuals."""

    @property
    def worse_than_still(self) -> tuple[WorseThanStill, ...]:
        """Channels in which the calibrated vehicle errs more than one that stands still."""
        return tuple(worse_than_still(self.name, self.calibrated, self.static))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False, repr=False)
class Calibration(TableDisplay):
    """Result of a calibration of a robot."""

    subject: CalibratedRobot
    estimate: Estimate
    exported: ExportedEstimate
    """Estimate that the robot's file gets."""
    numbers: tuple[uncertainty.IdentifiedNumber, ...]
    open: tuple[uncertainty.UnidentifiableDirection, ...]
    """Combinations of unknowns that the recordings do not determine."""
    inflation: float
    """samples that miss alike: intervals are wider by its root than white residuals would have
    them.
    """
    whiteness: tuple[uncertainty.Whiteness, ...]
    """Whiteness of the residuals of all recordings."""
    comparisons: tuple[Comparison, ...]
    issues: tuple[str, ...]
    constants: tuple[HeldConstant, ...] = ()
    """Constants that the fit held fixed though they are uncertain; none for runs of this toolkit,
    whose constants are known.
    """
    profiles: tuple[validation.Profile, ...] = ()
    """Profiles of the determined numbers, if asked for."""
    left_out: tuple[validation.HeldOutRecording, ...] = ()
    """Predictions of every recording by a fit to the others, if asked for."""
    left_out_bounds: PredictionBounds | None = None
    """Vehicles that have seen what is left out, which bound its predictions."""
    predicted: tuple[validation.HeldOutRecording, ...] = ()
    """Predictions of other recordings, on which nothing was identified, if any were given."""
    predicted_bounds: PredictionBounds | None = None
    """Vehicles that have seen those, which bound their predictions."""

    @property
    def verdicts(self) -> tuple[str, ...]:
        """One line on each set of predictions that was asked for: what they are worth."""
        sets = {"left out": self.left_out, "predicted": self.predicted}
        return tuple(
            verdict_words(name, recordings) for name, recordings in sets.items() if recordings
        )

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
        shortfalls = [
            shortfall
            for comparison in self.comparisons
            for shortfall in comparison.worse_than_still
        ]
        for recording in (*self.left_out, *self.predicted):
            shortfalls += recording.worse_than_still
        return tuple(shortfalls)

    def _table(self) -> SmallTable:
        rows = (
            (
                number.name,
                number.value,
                *number.interval,
                number.unit,
                "" if number.determined else "not determined",
            )
            for number in self.numbers
        )
        head = ("number", "value", "from", "to, 95 %", "unit", "")
        return SmallTable(
            title="Calibration",
            words=" ".join(map(str, (*self.verdicts, *self.worse_than_still, *self.disagreed))),
            head=head,
            rows=tuple(tuple(map(cell, row)) for row in rows),
        )


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
    """Identify; with profiles and leave-one-out, which take longer, if wanted. progress: gets a
    line at each step, not a bar.

    predict: other recordings, on which nothing is identified and which are predicted. bounds: False
    saves the fits that bound predictions, one to all that are predicted and one to each of them.
    warn gets every issue before anything is searched. Recordings with silences are cut there.
    Raises InvalidInput for no recordings, one alone to be left out, equal names, a channel that is
    missing, or a current that is recorded and not learnt.
    """
    recordings = _with_commands(subject, settings, recordings)
    others = _with_commands(subject, settings, predict)
    names = [item.name for item in recordings]
    every_name = [*names, *(item.name for item in others)]
    if not names or len(set(every_name)) < len(every_name):
        raise InvalidInput(
            f"recordings {every_name} given; allowed: one at least, each with a name of its own"
        )
    if leave_one_out and len({item.source for item in recordings}) < 2:
        raise InvalidInput(f"recordings {names} given; leave-one-out needs at least 2")
    at_once = all(item.at_once for item in recordings)
    subject = with_delays(subject, settings, at_once=at_once)
    prepared = _prepared(subject, settings, recordings)
    prepared_others = _prepared(subject, settings, others)
    doubtful = []
    for recording in (*recordings, *others):
        for doubt in (
            *check_data_quality(recording),
            *check_settings(subject, settings, recording),
        ):
            doubtful.append(f"{recording.name}: {doubt}")
            warn(doubtful[-1])
    vehicle = subject.vehicle
    noise = Noise(**settings.noise.model_dump())
    rollout = Rollout(model.stage_of(vehicle, sharp=True))
    with progress_bar(shown=progress is None, bar_format="{elapsed} {desc}") as bar:
        progress = progress or bar.set_description_str
        search = Search(step=settings.step, stretch=settings.stretch, progress=progress)
        fitted = FitContext.searched(
            vehicle=vehicle, rollout=rollout, prepared=prepared, noise=noise, search=search
        )
        residuals = fitted.residuals()
        joined_residuals = Predicted.joined(list(residuals.values()))
        inflation = uncertainty.variance_inflation(joined_residuals, fitted.noise)
        constants = tuple[HeldConstant, ...]()
        if (
            not at_once
            and fitted.estimate.status is FitStatus.CONVERGED
            and len(fitted.estimate.shared)
        ):
            progress("what constants would change")
            estimate, constants = held_constants(fitted, settings, inflation)
            fitted = replace(fitted, estimate=estimate)
        if leave_one_out and bounds:
            left_out_bounds = fit_bounds(fitted, prepared, progress)
        else:
            left_out_bounds = None
        predicted_bounds = None
        if prepared_others and bounds:
            predicted_bounds = fit_bounds(fitted, prepared_others, progress)
        tests = uncertainty.whiteness(joined_residuals, fitted.noise)
        identified = uncertainty.numbers(subject.vehicle, fitted.estimate, inflation, tests)
        balance = validation.StaticBalance(subject.vehicle)
        exported = exported_estimate(fitted, inflation)
        directions = uncertainty.unidentifiable_directions(
            subject.vehicle, fitted.estimate, inflation
        )
        comparisons = tuple(
            _comparison(fitted, balance, item, residuals[item.recording.name]) for item in prepared
        )
        profiles = tuple[validation.Profile, ...]()
        if profiled:
            profiles = tuple(validation.profiles(fitted, identified, inflation, progress))
        left_out = tuple[validation.HeldOutRecording, ...]()
        if leave_one_out:
            left_out = tuple(
                validation.leave_one_out(fitted, progress=progress, bounds=left_out_bounds)
            )
        predicted = tuple(
            validation.predict_others(
                fitted, prepared_others, progress=progress, bounds=predicted_bounds
            )
        )
        return Calibration(
            subject=subject,
            estimate=fitted.estimate,
            exported=exported,
            numbers=identified,
            open=directions,
            inflation=inflation,
            whiteness=tests,
            comparisons=comparisons,
            issues=tuple(doubtful),
            constants=constants,
            profiles=profiles,
            left_out=left_out,
            left_out_bounds=left_out_bounds,
            predicted=predicted,
            predicted_bounds=predicted_bounds,
        )


def _with_commands(
    subject: CalibratedRobot, settings: CalibrationSettings, recordings: Sequence[Recording]
) -> tuple[Recording, ...]:
    """Return recordings, cut at silences, with thrust in the place of propeller commands."""
    if settings.commands == "propeller_commands":
        free = len(subject.vehicle.axes) == len(
            parameters.AXES
        )  # others may have no commands, as decay tests
        with_commands = []
        for recording in recordings:
            if free or recording.channels.keys() & COMMANDS:
                with_commands.append(with_thrust(subject.robot, recording))
            else:
                with_commands.append(recording)
        recordings = with_commands
    return split_at_gaps(recordings)


def _prepared(
    subject: CalibratedRobot, settings: CalibrationSettings, recordings: Sequence[Recording]
) -> tuple[PreparedRecording, ...]:
    """Return recordings, prepared for the vehicle. Raises InvalidInput for one that is too short,
    or in a current that is not learnt.
    """
    n = subject.vehicle.actuators.allocation.shape[1]
    prepared = tuple(
        PreparedRecording.of(along_axes(item, settings, n), subject.vehicle) for item in recordings
    )
    for item in prepared:
        item.stretches(settings.step, settings.stretch)  # or it is too short
        require_current(subject, item.recording)
    return prepared


def with_thrust(robot: Robot, recording: Recording) -> Recording:
    """Return the recording with the steady thrust of its `propeller_commands`, by the robot's
    thrust curves.

    Without a curve -1 and 1 are a thruster's limits. Raises InvalidInput without that channel, or
    for one of other thrusters.
    """
    signals = recording.channel("propeller_commands").of(robot.thruster_names, "propeller_commands")
    n = len(robot.thruster_names)
    if signals.values.shape[1] != n:
        problem = (
            f"{recording.name}: propeller_commands of {signals.values.shape[1]} thrusters given"
        )
        raise InvalidInput(
            f"{problem}; allowed: {n}, those that drive it, in the order of the robot's file"
        )
    ends = (
        (thruster.curve[0][0], thruster.curve[-1][0]) if thruster.curve else (-1.0, 1.0)
        for thruster in robot.description.thrusters
    )
    low, high = np.transpose(list(ends))
    share = float(((signals.values < low - 1e-6) | (signals.values > high + 1e-6)).mean())
    text = (
        f"{100.0 * share:.2g} % of its numbers are beyond the thrust curves, and taken for their"
        " ends: scale, pulses of 0?"
    )
    issues = recording.issues_in_file + ((("propeller_commands", text),) if share > _BEYOND else ())
    thrust = replace(signals, values=thrust_of_signals(robot, signals.values))
    return replace(
        recording, channels={**recording.channels, "thrust": thrust}, issues_in_file=issues
    )


def _comparison(
    fitted: FitContext,
    balance: validation.StaticBalance,
    recording: PreparedRecording,
    missed: Predicted,
) -> Comparison:
    (segment,) = recording.stretches(fitted.search.step)
    after = fitted.predictor()
    before = fitted.predictor(fitted.vehicle.shared.start)
    return Comparison(
        name=recording.recording.name,
        calibrated=after.of(segment),
        before=before.of(segment),
        static=validation.static_baseline(segment, after.start_window),
        balance=balance.of_stretch(segment, fitted.estimate.shared),
        residuals=missed,
        whiteness=uncertainty.whiteness(missed, fitted.noise),
    )
