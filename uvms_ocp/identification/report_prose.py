"""Texts of the reports of an identification, in the order in which a report has them.

Names in braces are filled in by `uvms_ocp.identification.results`,
`uvms_ocp.identification.fit_tables` and `uvms_ocp.identification.prediction_text`.
"""

from __future__ import annotations

STATUS = """
The search has ended: {status.value}. {status.advice}

Standard errors take {inflation:.3g} samples for one, as residuals are not white. A number is called
determined where its standard error is below {below:.0f} % of its size (of lengths: of 5 cm), and
below what its prior said. None is determined where the search has not converged, or where coloured
residuals are beyond {most:g} times the noise. Intervals of many decades are called open.

In the file a number that stays open is as it was before, where the recordings allow that; all
others were fitted anew beside it."""
"""How the search ended, and what is called determined."""

UNEXPLAINED = """
**The model does not explain {missed}**: more than noise is left. Where something is wrong that the
fit took for known, such as a delay, a lag or a term that was not learnt, numbers lie beyond their
intervals, determined or not."""
"""Warning of channels whose residuals are far from white."""

HELD_AXES = """
The vehicle moves along {axes} alone. Along other axes it is held at rest, and their numbers are as
they were."""
"""Remark on a vehicle that was held along some axes."""

SHAPE_PRIORS = """
The file describes {frame} by a {shape}. What that gives is the prior of its coefficients, unless
the settings give another. Deviations are {added_mass:g} of the logarithm, for linear drag
{linear_drag:g}."""
"""Remark on the priors of a hull that is described by a shape."""

NUMBER_TABLE = """
| number | value | unit | standard error | 95 % interval | determined | in the file |
|---|---:|---|---:|---|---|---|"""
"""Head of the table of numbers."""

PER_RECORDING = """
## What each recording has for itself
"""
"""Heading of the table of unknowns that each recording has of its own."""

PROFILES = """
## Profiles

Each number that is determined was held at one and two standard errors to either side, and at more
where its interval did not close, while all others were fitted anew. Such an interval does not rely
on linearity.

| number | unit | by standard errors | by profile | |
|---|---|---|---|---|"""
"""Section of intervals by profile likelihood."""

HELD_CONSTANTS = """
## Numbers that the fit took for known

None of them was learnt: where one is wrong, those above take its part. The table says how well each
is known, and what it would change most, in standard errors, if it were off by as much as it may
well be.

- What is assumed is in the intervals. Biases, trims and currents are not: what the search has left
  shows them where they are not next to nothing, and then they are to be learnt.
- They are off by a share of the weight, for moments at an arm of 1 m. What each recording may have
  for itself is off by the same in all.
- A scale is how many times too much a sensor of velocity or of rates reads; the fit takes it for 1.
  Where position or attitude show it, it is off by as much as they say, else by as much as is
  assumed. Both are in the intervals.
- Noise weighs one sensor against another: the table says what twice of it would change.

| number | value | unit | known | if off by | changes most |
|---|---|---|---|---:|---|"""
"""Section of the numbers that were not learnt."""

WHITENESS = """
## What the search has left

Residuals of all stretches. Where the model says all that there is they are white: p is above
{level:g} (Ljung and Box's test), one sample at a time misses, and the size is 1, in standard
deviations of the noise as given.

| channel | size | samples that miss alike | p | white |
|---|---:|---:|---:|---|"""
"""Section of the residuals."""

FITS = """
## Fits of whole recordings, in percent, from commands alone

Recordings were seen by the search: predictions of others are worse. In brackets: before the
calibration, and a vehicle that does not move. Tilt: error of the vertical in degrees; in brackets
before, as it was at first, and in static balance.
"""
"""Section of the recordings that the search used."""

LEFT_OUT = """
## Predictions of recordings that were left out

Each recording is predicted by what the others tell, from commands alone, horizon by horizon, each
from what was known before it. Root mean squares of errors in m/s, rad/s and degrees (tilt), medians
over the recordings; the last horizon is as long as recordings are. In bold: worse than one that
knows less."""
"""Section of predictions of recordings that were left out one by one."""

NONE_WORSE = (
    "None: no channel errs more than that of a vehicle that does not move, nor than its own mean, by"
    " {share:g} % or more."
)
"""Sentence where no prediction is worse than a vehicle that stands still."""

BOUNDS = """
### How good these predictions could be

Fits over the longest horizon that each recording has, `100 (1 - |error| / |y - mean|)` in percent,
of what moves by more than the noise. In brackets: first by one vehicle that was identified on all
recordings that are predicted, then by a vehicle that was identified on this recording alone, with
what it has for itself.

What the first misses no single vehicle explains. What the second explains beyond it differs between
recordings, or is the freedom of a fit to few samples. What the second misses too is the model's or
the sensors'. Fits are made in short segments and predictions over long ones: where the vehicle that
predicts does better than the first in brackets, it is itself what one vehicle could.

From {nearly:g} % on a prediction is called as good as one vehicle can be, from a difference of
{different:g} on recordings are said to differ. These bounds took {seconds:.3g} s."""
"""Section below predictions: what any vehicle of this model could reach."""

RECORDINGS_DIFFER = """
**Recordings differ** in {channels}: one vehicle that has seen them all falls short of what each
alone shows."""
"""Warning of recordings that no single vehicle explains."""

DISAGREED = """
### Numbers that recordings disagree on

Of the numbers that are called determined, those that scatter by more than their standard errors
allow where one recording after the other is left out (jackknife; by chance one in a hundred).
"""
"""Section of numbers that move where a recording is left out."""

PREDICTED = """
## Predictions of recordings that the vehicle was not identified on

Each recording is predicted from commands alone, horizon by horizon, each from what was known before
it. Root mean squares of errors in m/s, rad/s and degrees (tilt), medians over the recordings; the
last horizon is as long as recordings are. In bold: worse than one that knows less."""
"""Section of predictions of other recordings."""

EVIDENCE = """
## What the reading of each channel rests on

Known is what the file or its mapping states. Shown is what other channels agree with, as well as it
says; an error that both have in common is not seen. All else is assumed: where it is otherwise,
numbers are wrong by as much.

| recording | channel | of | is | by |
|---|---|---|---|---|"""
"""Section of what is known, shown or assumed of each channel."""

EXCITATION = """From where its origin begins the hull sweeps {spans} m in x, y and z, and tilts by
{tilt:.2f} rad at most, if the vehicle is as it is believed to be: keep it in sight, and record what
was told if someone interferes.

| number | believed | unit | standard error | determined |
|---|---:|---|---:|---|"""
"""Begin of the report of an experiment: what the hull sweeps, and the head of its table."""
