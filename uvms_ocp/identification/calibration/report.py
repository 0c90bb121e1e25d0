"""A calibration in words: numbers, how sure they are, what is not determined, and how well recordings are predicted."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from uvms_ocp.identification.answers.advice import advice
from uvms_ocp.identification.answers.numbers import KNOWN, Number
from uvms_ocp.identification.answers.profiles import Profile
from uvms_ocp.identification.answers.whiteness import LEAST_TOLD, LEVEL
from uvms_ocp.identification.calibration.fitting import Calibration
from uvms_ocp.identification.calibration.predicted_tables import fits, left_out_tables
from uvms_ocp.identification.calibration.variant import IN_FILE

_TOLD = 6  # combinations, the worst first
_DECADES = 1e3  # [-] between the ends of an interval that is told of what is positive


def report_text(one: Calibration) -> str:
    """Markdown."""
    parts = ["# Calibration", *_numbers(one), *_profiles(one), *_open(one), *_white(one), *fits(one.comparisons)]
    parts += [*left_out_tables(one.left_out), "", "## Doubts about the recordings", ""]
    return "\n".join([*parts, *(f"- {doubt}" for doubt in one.doubts or ("none",))]) + "\n"


def _numbers(one: Calibration) -> Iterator[str]:
    yield f"\nThe search has ended: {one.estimate.status.value}. {one.estimate.status.advice}"
    yield f"Standard errors take {one.together:.3g} samples for one, as residuals are not white; a number is called"
    yield f"determined below {100 * KNOWN:.0f} % of its size (lengths: of 5 cm), beyond what priors said, and none where the"
    yield "search has not converged; intervals of many decades are called open. What stays open is in the file as it was"
    yield "before, where the recordings allow it, and the others as they were fitted anew beside it."
    yield "\n| number | value | unit | standard error | 95 % interval | determined | in the file |"
    yield "|---|---:|---|---:|---|---|---|"
    for each in one.numbers:
        words = "yes" if each.determined else "no", _in_file(one, each)
        told = f"{each.value:.4g} | {each.unit} | {each.sigma:.2g} | {_ends(each.interval)}"
        yield f"| {each.name} | {told} | {words[0]} | {words[1]} |"


def _in_file(one: Calibration, each: Number) -> str:
    if each.quantity not in IN_FILE or not one.flown.usable:
        return "no"
    return "as before" if each.name in one.flown.kept else "yes"


def _profiles(one: Calibration) -> Iterator[str]:
    if not one.profiles:
        return
    yield "\n## Profiles\n"
    yield "Each number that is determined was held at one and two standard errors to either side, and more where its"
    yield "interval did not close, while all others were fitted anew: the interval does not rely on linearity."
    yield "\n| number | unit | by standard errors | by profile | |"
    yield "|---|---|---|---|---|"
    for each in one.profiles:
        yield _profile(each, each.number)


def _profile(one: Profile, told: Number) -> str:
    word = "differs" if one.differs else ""
    return f"| {told.name} | {told.unit} | {_ends(told.interval)} | {_ends(one.interval)} | {word} |"


def _ends(interval: tuple[float, float]) -> str:
    if interval[1] > _DECADES * abs(interval[0]) and interval[0] >= 0.0:
        return "open"
    return f"{interval[0]:.4g} to {interval[1]:.4g}" if np.isfinite(interval).all() else "open"


def _open(one: Calibration) -> Iterator[str]:
    yield "\n## Combinations that the recordings leave open\n"
    if not one.open:
        yield "None."
    for each in one.open[:_TOLD]:
        shares = " ".join(f"{share:+.2f} {name}" for name, share in each.shares)
        yield f"- {shares}: standard error {min(each.sigma, 1e3):.2g} without priors. To determine it: {advice(each)}."


def _white(one: Calibration) -> Iterator[str]:
    yield "\n## What the search has left\n"
    yield f"Residuals of all stretches. Where the model says all that there is they are white: p is above {LEVEL:g} (Ljung and"
    yield "Box's test), one sample at a time misses, and the size is 1, in standard deviations of the noise as given.\n"
    yield "| channel | size | samples that miss alike | p | white |"
    yield "|---|---:|---:|---:|---|"
    for each in one.whiteness:
        word, p = "yes" if each.white else "no", f"{each.p:.2g}" if each.p > LEAST_TOLD else f"below {LEAST_TOLD:g}"
        yield f"| {each.channel} | {each.size:.2g} | {each.together:.3g} | {p} | {word} |"
