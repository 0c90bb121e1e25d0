"""Every recording, predicted by a vehicle that has not seen it, beside predictions by what knows less."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.identification.answers.fitted import Fitted
from uvms_ocp.identification.answers.nulls import Balance, still
from uvms_ocp.identification.answers.predictions import Predicted, Predictor
from uvms_ocp.identification.methods.output_error import Estimate, OutputError
from uvms_ocp.identification.methods.stretch import Prepared

HORIZONS = (5.0, 20.0, 60.0)
"""[s] over which recordings are predicted, the last one as long as they are."""
OTHERS, BEFORE, STILL, BALANCE = "identified on the others", "before", "nothing moves", "static balance"
"""What predicts; the last two say of velocities that there are none."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Horizon:
    """Predictions of one recording, horizon by horizon, each from what was known before it."""

    asked: float
    """[s]"""
    length: float
    """[s] what the recording has of it."""
    by: Mapping[str, Predicted]
    """The same samples, by what predicts."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class LeftOut:
    """A recording that was left out."""

    name: str
    estimate: Estimate
    """From the others alone, with their starts."""
    predictor: Predictor
    """With that estimate."""
    horizons: tuple[Horizon, ...]
    """Those over which what the others tell does not run away."""


def left_out(
    fitted: Fitted, horizons: Sequence[float] = HORIZONS, tell: Callable[[str], None] = lambda _: None
) -> Iterator[LeftOut]:
    """One after the other; horizons [s]; tell is told of each. Raises InvalidInput where there is one recording alone.

    The search on the others begins where all of them together end, which only its last digits can show.
    """
    if len(fitted.prepared) < 2:
        raise InvalidInput("one recording given; leave-one-out needs at least 2")
    balance = Balance.of(fitted.vehicle)
    for k, held in enumerate(fitted.prepared, start=1):
        tell(f"left out {k} of {len(fitted.prepared)}: {held.recording.name}")
        found = without(fitted, held)
        predictor, step = fitted.predictor(found.shared), fitted.search.step
        asked = _lengths(held, step, predictor.known, horizons)
        told = tuple(_horizon(fitted, predictor, balance, held, *pair) for pair in asked)
        yield LeftOut(
            name=held.recording.name,
            estimate=found,
            predictor=predictor,
            horizons=tuple(each for each in told if each.by[OTHERS].finite),
        )


def without(fitted: Fitted, held: Prepared) -> Estimate:
    """Identified on the other recordings, from where the estimate is."""
    others = replace(fitted, prepared=tuple(one for one in fitted.prepared if one is not held))
    problem: OutputError = others.problem()
    return problem.solve(problem.start(fitted.estimate.shared), iterations=fitted.search.iterations)


def _lengths(one: Prepared, step: float, known: float, asked: Sequence[float]) -> Iterator[tuple[float, float]]:
    """Horizons, and how long they are: the first that a recording is too short for is cut, longer ones are left out."""
    begin, end = one.recording.span
    longest = step * (int((end - begin) / step) - round(known / step))
    for horizon in sorted(asked):
        if longest >= step:
            yield horizon, min(horizon, longest)
        if horizon > longest:
            return


def _horizon(
    fitted: Fitted, predictor: Predictor, balance: Balance, held: Prepared, asked: float, length: float
) -> Horizon:
    step, known, before = fitted.search.step, predictor.known, fitted.vehicle.shared.start
    windows = held.windows(step, known, length)
    resting = [still(one, known) for one in windows], [balance.of_stretch(one, predictor.shared) for one in windows]
    later = [[null.after(float(one.edges[0]) + known) for one, null in zip(windows, nulls, strict=True)]
             for nulls in resting]  # fmt: skip
    by = {
        OTHERS: predictor.over(held, step, length),
        BEFORE: fitted.predictor(before).over(held, step, length),
        STILL: Predicted.joined(later[0]),
        BALANCE: Predicted.joined(later[1]),
    }
    return Horizon(asked=asked, length=length, by=by)
