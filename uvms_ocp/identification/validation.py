"""Validate a fit by predictions of recordings that it has not seen, beside those of vehicles that
know less: leave-one-out cross-validation, and predictions of further recordings.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification.estimates import Estimate
from uvms_ocp.identification.fit import FitContext, search_fit
from uvms_ocp.identification.prediction_bounds import PredictionBounds
from uvms_ocp.identification.prediction_errors import (
    SCORED,
    errors,
    root_mean_square,
)
from uvms_ocp.identification.predictor import Predicted, Predictor
from uvms_ocp.identification.segments import PreparedRecording
from uvms_ocp.identification.static_baselines import StaticBalance, static_baseline
from uvms_ocp.identification.still_comparison import (
    NOTHING_MOVES,
    WorseThanStill,
    worse_than_still,
)
from uvms_ocp.identification.uncertainty import covariance
from uvms_ocp.identification.whiteness import variance_inflation

HORIZONS = (5.0, 20.0, 60.0)
"""[s] lengths of predictions; recordings that are shorter cut them."""
OTHERS = "identified on the others"
"""Name of the predictor that was fitted to other recordings."""
BEFORE = "before"
"""Name of the predictor with the vehicle as declared."""
STATIC = NOTHING_MOVES
"""Name of the predictor that keeps the first attitude, with zero velocities."""
BALANCE = "static balance"
"""Name of the predictor that rests where weight and buoyancy balance, with zero velocities."""
_DRAWS = 12  # number of draws of the unknowns by their covariance


def leave_one_out(
    fitted: FitContext,
    horizons: Sequence[float] = HORIZONS,
    progress: Callable[[str], None] = lambda _: None,
    bounds: PredictionBounds | None = None,
) -> Iterator[HeldOutRecording]:
    """Hold out and predict each recording; horizons [s]; progress gets a line for each.

    bounds: vehicles that have seen all recordings, whose predictions are added. The search on the
    remaining recordings begins at the vehicle as declared, so that it knows nothing of the
    recording that is left out. Raises `InvalidInput` for a single recording.
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

    bounds: vehicles that have seen these recordings, whose predictions are added. Raises
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


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class HeldOutRecording:
    """A recording that a fit has not seen, with its predictions."""

    name: str
    """Name of the recording."""
    estimate: Estimate
    """Estimate from other recordings alone, with their starts."""
    predictor: Predictor
    """Predictor with that estimate."""
    horizons: tuple[HorizonPrediction, ...]
    """Predictions over each horizon, where they stay finite."""

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


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class HorizonPrediction:
    """Predictions of one recording, horizon by horizon, each from the measurements before it."""

    asked: float
    """[s] horizon that was asked for."""
    length: float
    """[s] horizon, as far as the recording is long enough for it."""
    by: Mapping[str, Predicted]
    """Predictions of the recording, by the name of the predictor."""
    bounds: Mapping[str, Predicted]
    """Predictions by vehicles that have seen the recording, by `TOGETHER` and `ALONE`; empty without
    bounds.
    """
    open_error: np.ndarray
    """(7,) [m/s, rad/s, deg] standard deviation of `SCORED` that follows from the uncertainty of the
    unknowns.
    """
    seen_error: np.ndarray
    """(7,) [m/s, rad/s, deg] error of `SCORED` in the recordings that the vehicle was fitted to."""

    @property
    def expected_error(self) -> np.ndarray:
        """(7,) [m/s, rad/s, deg] standard deviation of `SCORED` by which the prediction may err."""
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
    """Fit the recordings from other sources alone, with the vehicle as declared for a start."""
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
    begin, end = prepared.span
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
        BALANCE: partial(balance.of_segment, shared=predictor.shared),
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
