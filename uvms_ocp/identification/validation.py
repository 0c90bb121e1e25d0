"""Validate a fit: profile-likelihood intervals, leave-one-out cross-validation, predictions of
recordings it has not seen, and static baselines.

The deviance of the best fit with a number held, twice the cost beyond the optimum's, gives the
interval: its signed root is where a standard normal variable would be. Where everything is linear
it is a straight line, and this interval is the one of standard errors.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import casadi as ca
import numpy as np

from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification import parameters, recording
from uvms_ocp.identification.fit import FitContext, Predicted, Predictor, search_fit
from uvms_ocp.identification.model import N_Q, Vehicle, as_measured, vehicle_dynamics
from uvms_ocp.identification.output_error import (
    Estimate,
    NormalEquations,
    ProfilePenalty,
    SearchPoint,
)
from uvms_ocp.identification.prediction_bounds import PredictionBounds
from uvms_ocp.identification.rollout import PreparedRecording, Segment
from uvms_ocp.identification.still_comparison import (
    NOTHING_MOVES,
    WorseThanStill,
    worse_than_still,
)
from uvms_ocp.identification.uncertainty import (
    INTERVAL,
    IdentifiedNumber,
    covariance,
    number_of,
    variance_inflation,
)

# How sure a number is, without the belief that all is linear: it is held, and all else is fitted
# anew.
#
# The deviance of the best fit with a number held, twice the cost beyond the optimum's, is what an
# interval is made of: its signed root is where a standard normal variable would be. Where
# everything is linear it is a straight line, and this interval is the one of standard errors.

_FARTHEST = 4  # standard errors: beyond it an interval is called open
_SOFT = 0.05  # of a standard error, by which a number is held
# of Gauss and Newton, where one is nearly all of the way
_STEPS = 3
_DAMPING = 1e-9
_EXACT = 1e-3  # of a deviance
_KEPT = 0.1  # of a deviance, by which it may miss what a step has promised
_OTHER = 0.2  # of the half width, by which ends may be apart that are called equal

# Quaternions (xyzw) of the attitudes whose vertical in B is each of B's axes.
_UPRIGHT = ((0.0, -(0.5**0.5), 0.0, 0.5**0.5), (0.5**0.5, 0.0, 0.0, 0.5**0.5), (0.0, 0.0, 0.0, 1.0))

SCORED = (*parameters.AXES, "tilt")
"""[m/s, rad/s, deg] channels whose errors are reported."""

HORIZONS = (5.0, 20.0, 60.0)
"""[s] over which recordings are predicted, the last one as long as they are."""
OTHERS = "identified on the others"
BEFORE = "before"
STATIC = NOTHING_MOVES
BALANCE = "static balance"
"""Names of predictors; the last two predict zero velocities."""
_DRAWS = 12  # of the unknowns, from what is known of them


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Profile:
    """Profile likelihood of one number."""

    number: IdentifiedNumber
    values: np.ndarray
    """(k,) [unit] at which it was held, increasing."""
    roots: np.ndarray
    """(k,) signed roots of the deviance there."""
    interval: tuple[float, float]
    """[unit] that holds it with 95 %, as the profile has it; infinite, or 0, where it does not
    close.
    """

    @property
    def differs(self) -> bool:
        """True if an end differs from that by standard errors."""
        lines = [_line(self.number, ends) for ends in (self.number.interval, self.interval)]
        return bool(np.abs(lines[1] - lines[0]).max() > _OTHER * (lines[0][1] - lines[0][0]) / 2)


@dataclass(frozen=True, slots=True, eq=False)
class _Best:
    """Optimum of the cost."""

    wide: FitContext
    """Fit with inflated variances."""
    cost: float
    """Half the weighted squares at the optimum."""
    point: SearchPoint
    blocks: list[NormalEquations]
    """Normal equations of each recording at the point."""


@dataclass(frozen=True, slots=True, eq=False)
class _HeldFit:
    """End of a search with a number held."""

    place: float
    """[unit, or its logarithm where it is positive] value of the number."""
    root: float
    """Signed root of the deviance."""
    point: SearchPoint


def profiles(
    fitted: FitContext,
    numbers: Sequence[IdentifiedNumber],
    inflation: float = 1.0,
    progress: Callable[[str], None] = lambda _: None,
) -> Iterator[Profile]:
    """Yield the profile likelihood of every determined number. inflation: samples that miss alike,
    as for the numbers.

    progress gets a line for each. A number that follows from one before it alone has the same
    profile and is left out. One takes a simulation of all recordings for each value at which it is
    held, and a search where that shows that all is not linear.
    """
    wide = fitted.inflated(inflation)
    chosen = list(_distinct(wide, [number for number in numbers if number.determined]))
    if not chosen:
        return
    # The optimum itself: searches end a little beside it, which deviances would show.
    problem = wide.problem()
    estimate = fitted.estimate
    optimum = problem.solve(
        problem.resumed(estimate), tolerance=_EXACT / max(estimate.cost, 1.0), damping=_DAMPING
    )
    point = problem.resumed(optimum)
    best = _Best(wide, optimum.cost, point, problem.blocks(point))
    for k, number in enumerate(chosen, start=1):
        progress(f"profile {k} of {len(chosen)}: {number.name}")
        yield _profile(best, number)


def _distinct(wide: FitContext, numbers: Sequence[IdentifiedNumber]) -> Iterator[IdentifiedNumber]:
    single: set[int] = set()
    for number in numbers:
        unknowns = np.flatnonzero(number_of(wide.vehicle, number)(wide.estimate.shared)[1])
        if len(unknowns) > 1 or unknowns[0] not in single:
            yield number
        if len(unknowns) == 1:
            single.update(unknowns)


def _profile(best: _Best, identified: IdentifiedNumber) -> Profile:
    number = number_of(best.wide.vehicle, identified)
    point = best.point
    sigma = identified.sigma
    if identified.positive:
        sigma /= identified.value
    middle = _HeldFit(number(point.shared)[0], 0.0, point)
    below = _side(best, middle, number, -sigma)
    above = _side(best, middle, number, sigma)
    fits = [*below[::-1], middle, *above]
    places = np.array([fit.place for fit in fits])
    roots = np.array([fit.root for fit in fits])
    ends = np.array([_crossing(places, roots, side) for side in (-INTERVAL, INTERVAL)])
    if identified.positive:
        places = np.exp(places)
        ends = np.exp(ends)

    return Profile(
        number=identified,
        values=places,
        roots=roots,
        interval=(float(ends[0]), float(ends[1])),
    )


def _side(
    best: _Best,
    middle: _HeldFit,
    number: Callable[[np.ndarray], tuple[float, np.ndarray]],
    step: float,
) -> list[_HeldFit]:
    """Hold the number one and two standard errors away, and on until the interval closes."""
    fits = []
    last = middle
    for k in range(1, _FARTHEST + 1):
        pull = ProfilePenalty(
            number=number, target=middle.place + k * step, sigma=_SOFT * abs(step)
        )
        last = _held(best, last, pull, k)
        fits.append(last)
        if k > 1 and abs(last.root) > INTERVAL:
            break
    return fits


def _held(best: _Best, nearest: _HeldFit, pull: ProfilePenalty, k: int) -> _HeldFit:
    """Hold the number by one step from the optimum if its cost is as predicted, else by more steps
    or a search.
    """
    problem = best.wide.problem(pull)
    point, cost = problem.stepped(best.point, best.blocks)
    gain = 2.0 * (cost - pull.cost(point.shared) - best.cost) - k**2
    share = _KEPT * k**2
    for _ in range(_STEPS):
        if abs(gain) < share:
            return _found(best, pull, point, cost)
        next_point, next_cost = problem.stepped(point)
        if not next_cost <= cost:
            break
        gain = 2.0 * (cost - next_cost)
        point = next_point
        cost = next_cost
    estimate = problem.solve(
        nearest.point, tolerance=_EXACT / max(best.cost, 1.0), damping=_DAMPING
    )
    return _found(best, pull, problem.resumed(estimate), estimate.cost)


def _found(best: _Best, pull: ProfilePenalty, point: SearchPoint, cost: float) -> _HeldFit:
    deviance = 2.0 * (cost - pull.cost(point.shared) - best.cost)
    side = np.sign(pull.target - pull.number(best.point.shared)[0])
    return _HeldFit(pull.number(point.shared)[0], float(side * np.sqrt(max(deviance, 0.0))), point)


def _crossing(places: np.ndarray, roots: np.ndarray, root: float) -> float:
    """Interpolate the place at which the signed root of the deviance is `root`; infinite where it
    lies beyond the places that were tried.
    """
    sides = roots - root
    for k, (a, b) in enumerate(pairwise(sides)):
        if a <= 0.0 <= b and a < b:
            return float(places[k] + (places[k + 1] - places[k]) * a / (a - b))
    return float(np.copysign(np.inf, root))


def _line(number: IdentifiedNumber, ends: tuple[float, float]) -> np.ndarray:
    with np.errstate(divide="ignore"):
        if number.positive:
            return np.log(np.array(ends))
        return np.array(ends)


# Vehicles that do not move, as predictors: others are worth as much as they are better.


def static_baseline(stretch: Segment, start_window: float) -> Predicted:
    """Predict that a vehicle does not move and stays as it was seen last, `start_window` [s] after
    the beginning of a stretch.
    """
    samples = np.flatnonzero(stretch.t[2] <= stretch.edges[0] + start_window)
    vertical = stretch.measured[2][samples[-1] if len(samples) else 0]
    return _resting(stretch, np.broadcast_to(vertical, (len(stretch.t[2]), 3)))


class StaticBalance:
    """The vertical in B at which weight and buoyancy turn a vehicle no further, its arm as it was
    measured.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        """Build the function of joints and unknowns for a vehicle."""
        n_j = vehicle.dynamics.model.nq - N_Q
        shared = ca.SX.sym("shared", len(vehicle.shared.start))
        joints = ca.SX.sym("joints", n_j)
        values = vehicle.values(ca.vertcat(shared, ca.DM(vehicle.per_recording.start)))
        dynamics = vehicle_dynamics(vehicle.dynamics, values, vehicle.link)
        poses = [ca.vertcat(ca.DM.zeros(3), ca.DM(turn), joints) for turn in _UPRIGHT]
        g = float(np.linalg.norm(vehicle.dynamics.model.gravity.linear))
        moment = as_measured(
            values, ca.vertcat(*(dynamics.potential_energy(pose) for pose in poses)) / g
        )
        self._function = ca.Function("balance", [joints, shared], [ca.densify(moment)])
        """``joints (n_j,), shared (n,) -> first moment (3,)`` [kg m] of mass, what is displaced
        counting negative.
        """

    def vertical(self, joints: np.ndarray, shared: np.ndarray) -> np.ndarray:
        """Compute the vertical (3, m) [-] in B for joints (n_j, m) [rad or m], where unknowns are
        shared (n,) [as `Unknowns.start`].
        """
        m = joints.shape[1]
        moment = np.asarray(self._function.map(m)(joints, np.repeat(shared[:, None], m, axis=1)))
        return np.asarray(-moment / np.maximum(np.linalg.norm(moment, axis=0), 1e-300))

    def of_stretch(self, stretch: Segment, shared: np.ndarray) -> Predicted:
        """Predict that a vehicle stays where it is in balance, with unknowns shared (n,) [as
        `Unknowns.start`].
        """
        middle = (stretch.edges[1:] + stretch.edges[:-1]) / 2
        vertical = self.vertical(stretch.joints[: stretch.joints.shape[0] // 3], shared)
        return _resting(stretch, recording.interpolated(stretch.t[2], middle, vertical.T))


def _resting(stretch: Segment, vertical: np.ndarray) -> Predicted:
    resting = tuple(np.broadcast_to(0.0, values.shape) for values in stretch.measured[:2])
    return Predicted(t=stretch.t, rows=(*resting, vertical), measured=stretch.measured)


# How far predictions are off.


def errors(predicted: Predicted) -> np.ndarray:
    """Compute (7,) [m/s, rad/s, deg] root mean squares of `SCORED`: velocities, and the angle
    between verticals.
    """
    moving = [root_mean_square(predicted.rows[k] - predicted.measured[k]) for k in range(2)]
    return np.concatenate([*moving, root_mean_square(np.rad2deg(tilts(predicted))[:, None])])


def tilts(predicted: Predicted) -> np.ndarray:
    """Compute angles (m,) [rad] between the vertical in B as predicted and as seen."""
    rows = predicted.rows[2]
    measured = predicted.measured[2]
    return np.arctan2(
        np.linalg.norm(np.cross(rows, measured), axis=1), (rows * measured).sum(axis=1)
    )


def root_mean_square(values: np.ndarray) -> np.ndarray:
    """Compute root mean squares (k,) [as values] of each column of values (m, k) [any]."""
    return np.asarray(np.sqrt((values**2).mean(axis=0)))


# Every recording, predicted by a vehicle that has not seen it, beside predictions by what knows
# less.


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class HorizonPrediction:
    """Predictions of one recording, horizon by horizon, each from the measurements before it."""

    asked: float
    """[s] horizon that was asked for."""
    length: float
    """[s] part of it that the recording has."""
    by: Mapping[str, Predicted]
    """Predictions of these samples, by the name of the predictor."""
    bounds: Mapping[str, Predicted]
    """The same samples, by vehicles that have seen them: `TOGETHER` and `ALONE`; empty without
    bounds.
    """
    open_error: np.ndarray
    """(7,) [m/s, rad/s, deg] standard deviation of `SCORED` from the uncertainty of the unknowns
    that the other recordings leave.
    """
    seen_error: np.ndarray
    """(7,) [m/s, rad/s, deg] that the fit has left in the recordings that it was made from."""

    @property
    def expected_error(self) -> np.ndarray:
        """(7,) [m/s, rad/s, deg] by how much the prediction may err, one standard deviation of
        `SCORED`.
        """
        return np.hypot(self.open_error, self.seen_error)

    @property
    def extrapolated(self) -> tuple[str, ...]:
        """Names of `SCORED` whose error from uncertain unknowns is larger than that of the fit."""
        return tuple(np.array(SCORED)[self.open_error > self.seen_error].tolist())

    @property
    def uninformative(self) -> tuple[str, ...]:
        """Names of `SCORED` whose predicted motion is less than its expected error."""
        motion = errors(replace(self.by[OTHERS], measured=self.by[STATIC].rows))
        return tuple(np.array(SCORED)[motion < self.expected_error].tolist())


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class HeldOutRecording:
    """A recording that was left out."""

    name: str
    estimate: Estimate
    """Estimate from the other recordings alone, with their starts."""
    predictor: Predictor
    """Predictor with that estimate."""
    horizons: tuple[HorizonPrediction, ...]
    """Horizons over which that prediction stays finite."""

    @property
    def worse_than_still(self) -> tuple[WorseThanStill, ...]:
        """Channels in which it is predicted worse than by a vehicle that stands still, horizon by
        horizon.
        """
        shortfalls = list[WorseThanStill]()
        for prediction in self.horizons:
            shortfalls += worse_than_still(
                self.name, prediction.by[OTHERS], prediction.by[STATIC], prediction.asked
            )
        return tuple(shortfalls)


def leave_one_out(
    fitted: FitContext,
    horizons: Sequence[float] = HORIZONS,
    progress: Callable[[str], None] = lambda _: None,
    bounds: PredictionBounds | None = None,
) -> Iterator[HeldOutRecording]:
    """Hold out and predict each recording; horizons [s]; progress gets a line for each.

    bounds: vehicles that have seen all recordings, whose predictions stand beside. The search on
    the others begins where the vehicle is declared: nothing of the recording that is left out is
    known to it. Raises `InvalidInput` where there is one recording alone.
    """
    if len({prepared.recording.source for prepared in fitted.prepared}) < 2:
        raise InvalidInput("one recording given; leave-one-out needs at least 2")
    balance = StaticBalance(fitted.vehicle)
    for k, held in enumerate(fitted.prepared, start=1):
        progress(f"left out {k} of {len(fitted.prepared)}: {held.recording.name}")
        yield _held_out(without(fitted, held), balance, held, horizons, bounds)


def predict_others(
    fitted: FitContext,
    recordings: Sequence[PreparedRecording],
    horizons: Sequence[float] = HORIZONS,
    progress: Callable[[str], None] = lambda _: None,
    bounds: PredictionBounds | None = None,
) -> Iterator[HeldOutRecording]:
    """Predict recordings that a fit has not seen; horizons [s]; progress gets a line for each.

    bounds: vehicles that have seen these recordings, whose predictions stand beside. Raises
    `InvalidInput` for a recording that the fit has seen.
    """
    sources = {prepared.recording.source for prepared in fitted.prepared}
    balance = StaticBalance(fitted.vehicle)
    for k, held in enumerate(recordings, start=1):
        if held.recording.source in sources:
            raise InvalidInput(
                f"{held.recording.name}: the vehicle was identified on it; give recordings to"
                " predict that are not among those to identify on"
            )
        progress(f"predicted {k} of {len(recordings)}: {held.recording.name}")
        yield _held_out(fitted, balance, held, horizons, bounds)


def _held_out(
    fitted: FitContext,
    balance: StaticBalance,
    held: PreparedRecording,
    horizons: Sequence[float],
    bounds: PredictionBounds | None,
) -> HeldOutRecording:
    """Predict a recording by a fit to others."""
    predictor = fitted.predictor()
    lengths = _lengths(held, fitted.search.step, predictor.start_window, horizons)
    predicted = tuple(_horizons(fitted, balance, held, lengths, bounds))
    return HeldOutRecording(
        name=held.recording.name,
        estimate=fitted.estimate,
        predictor=predictor,
        horizons=tuple(horizon for horizon in predicted if horizon.by[OTHERS].finite),
    )


def without(fitted: FitContext, held: PreparedRecording) -> FitContext:
    """Fit the other recordings alone, without other parts of the same, from where the vehicle is
    declared.
    """
    source = held.recording.source
    remaining = tuple(item for item in fitted.prepared if item.recording.source != source)
    estimate = search_fit(fitted.vehicle, remaining, fitted.noise, fitted.rollout, fitted.search)
    return replace(fitted, prepared=remaining, estimate=estimate)


def _lengths(
    prepared: PreparedRecording, step: float, window: float, horizons: Sequence[float]
) -> Iterator[tuple[float, float]]:
    """Yield horizons and their lengths [s]: the first for which a recording is too short is cut,
    longer ones are left out.
    """
    begin, end = prepared.recording.span
    longest = step * (int((end - begin) / step) - round(window / step))
    for horizon in sorted(horizons):
        if longest >= step:
            yield horizon, min(horizon, longest)
        if horizon > longest:
            return


def _horizons(
    fitted: FitContext,
    balance: StaticBalance,
    held: PreparedRecording,
    lengths: Iterable[tuple[float, float]],
    bounds: PredictionBounds | None,
) -> Iterator[HorizonPrediction]:
    """Yield the predictions of a recording over each horizon, by a fit to others and by predictors
    that know less.
    """
    step = fitted.search.step
    bounding = {} if bounds is None else bounds.predictors(held)
    predictor = fitted.predictor()
    before = fitted.predictor(fitted.vehicle.shared.start)
    residuals = Predicted.joined(list(fitted.residuals().values()))
    seen_error = errors(residuals)
    C = covariance(fitted.vehicle, fitted.estimate, variance_inflation(residuals, fitted.noise))
    draws = np.random.default_rng(0).multivariate_normal(
        predictor.shared, C, _DRAWS, method="eigh", check_valid="ignore"
    )
    window = predictor.start_window
    resting = {
        STATIC: partial(static_baseline, start_window=window),
        BALANCE: partial(balance.of_stretch, shared=predictor.shared),
    }
    for horizon, length in lengths:
        windows = held.windows(step, window, length)
        by = {OTHERS: predictor.over(held, step, length), BEFORE: before.over(held, step, length)}
        for name, predict in resting.items():
            parts = []
            for segment in windows:
                parts.append(predict(segment).after(float(segment.edges[0]) + window))
            by[name] = Predicted.joined(parts)
        deviations = []
        for shared in draws:
            prediction = fitted.predictor(shared).over(held, step, length)
            disturbed = replace(prediction, measured=by[OTHERS].rows)
            if disturbed.finite:
                deviations.append(errors(disturbed))
            else:
                deviations.append(np.full(len(SCORED), np.inf))
        yield HorizonPrediction(
            asked=horizon,
            length=length,
            by=by,
            bounds={name: bound.over(held, step, length) for name, bound in bounding.items()},
            open_error=root_mean_square(np.array(deviations)),
            seen_error=seen_error,
        )
