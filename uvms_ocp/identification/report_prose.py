"""Texts of the reports of an identification; names in braces are filled in."""

from __future__ import annotations

NUMBERS = """
The search has ended: {status.value}. {status.advice}
Standard errors take {inflation:.3g} samples for one, as residuals are not white; a number is called
determined below {below:.0f} % of its size (lengths: of 5 cm), beyond what priors said, and none where the
search has not converged, or coloured residuals are beyond {most:g} times the noise; intervals of many
decades are called open. What stays open is in the file as it was before, where the recordings allow it, and the
others as they were fitted anew beside it."""

UNEXPLAINED = """
**The model does not explain {missed}**: more than noise is left. Where what the fit took for
known is wrong, such as delays, lags and terms that were not learnt, numbers lie beyond their intervals,
determined or not."""

AXES = """
The vehicle moves along {axes} alone: along other axes it is held at rest, and numbers of those are as they were."""

SHAPE = """
The file describes {frame} by a {shape}: what that gives is the prior of its coefficients, unless the settings give another.
Deviations are {added_mass:g} of the logarithm, for linear drag {linear_drag:g}."""

OWN = """
## What each recording has for itself
"""

NUMBER_TABLE = """
| number | value | unit | standard error | 95 % interval | determined | in the file |
|---|---:|---|---:|---|---|---|"""

PROFILES = """
## Profiles

Each number that is determined was held at one and two standard errors to either side, and more where its
interval did not close, while all others were fitted anew: the interval does not rely on linearity.

| number | unit | by standard errors | by profile | |
|---|---|---|---|---|"""

EVIDENCE = """
## What the reading of each channel rests on

Known is what the file or its mapping states. Shown is what other channels agree with, as well as it says; an error
that both have in common is not seen. All else is assumed: where it is otherwise, numbers are wrong by as much.

| recording | channel | of | is | by |
|---|---|---|---|---|"""

HELD = """
## Numbers that the fit took for known

None of them was learnt: where one is wrong, those above take its part. How well each is known, and what it would
change most if it were off by as much as it may well be, in standard errors; what is assumed is in the intervals, but
for biases, trims and currents: what the search has left shows them where they are not next to nothing, and they are to
be learnt then. They are off by a share of the weight, for moments at an arm of 1 m, and what each recording may have for
itself by the same in all. A scale is how many times too much a sensor of velocity or of rates reads, which the fit takes for
1: where position or attitude show it, it is off by as much as they say, else by as much as is assumed, and both are in
the intervals. Noise weighs one sensor against another: what twice of it would change.

| number | value | unit | known | if off by | changes most |
|---|---|---|---|---:|---|"""

WHITE = """
## What the search has left

Residuals of all stretches. Where the model says all that there is they are white: p is above {level:g} (Ljung and
Box's test), one sample at a time misses, and the size is 1, in standard deviations of the noise as given.

| channel | size | samples that miss alike | p | white |
|---|---:|---:|---:|---|"""

FITS = """
## Fits of whole recordings, in percent, from commands alone

Recordings were seen by the search: predictions of others are worse. In brackets: before the calibration, and a
vehicle that does not move. Tilt: error of the vertical in degrees; in brackets before, as it was at first, and in
static balance.
"""

LEFT_OUT = """
## Predictions of recordings that were left out

Each recording is predicted by what the others tell, from commands alone, horizon by horizon, each from what was
known before it. Root mean squares of errors in m/s, rad/s and degrees (tilt), medians over the recordings; the last
horizon is as long as recordings are. In bold: worse than one that knows less."""

PREDICTED = """
## Predictions of recordings that the vehicle was not identified on

Each recording is predicted from commands alone, horizon by horizon, each from what was known before it. Root mean
squares of errors in m/s, rad/s and degrees (tilt), medians over the recordings; the last horizon is as long as
recordings are. In bold: worse than one that knows less."""

NONE_WORSE = (
    "None: no channel errs more than that of a vehicle that does not move, nor than its own mean, by"
    " {share:g} % or more."
)

BOUNDS = """
### How good these predictions could be

Fits over the longest horizon that each recording has, `100 (1 - |error| / |y - mean|)` in percent, of what moves by more than
the noise. In brackets: by one vehicle that was identified on all recordings that are predicted, and by a vehicle that was
identified on this recording alone, with what it has for itself. What the first misses no single vehicle explains; what the
second explains beyond it differs between recordings, or is the freedom of a fit to few samples; what it misses too is the
model's or the sensors'. Fits are made in short segments and predictions over long ones: where the vehicle that predicts does
better than the first in brackets, itself is what one vehicle could. From {nearly:g} % on a prediction is called as good as one
vehicle can be, from a difference of {different:g} on recordings are said to differ. These bounds took {seconds:.3g} s."""

RECORDINGS_DIFFER = """
**Recordings differ** in {channels}: one vehicle that has seen them all falls short of what each alone shows."""

DISAGREED = """
### Numbers that recordings disagree on

Of the numbers that are called determined, those that scatter by more than their standard errors allow where one recording
after the other is left out (jackknife; by chance one in a hundred).
"""

EXCITATION = """From where its origin begins the hull sweeps {spans} m in x, y and z, and tilts by {tilt:.2f} rad at most,
if the vehicle is as it is believed to be: keep it in sight, and record what was told if someone interferes.

| number | believed | unit | standard error | determined |
|---|---:|---|---:|---|"""
