"""Find single columns whose numbers have few digits: a fit takes the steps between them for motion, or
for noise that it is not told of.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from uvms_ocp.identification.recording import CHANNEL_KINDS, Recording

_COARSE = {
    "position": 0.1,
    "linear_velocity": 0.05,
    "angular_velocity": 0.05,
    "specific_force": 0.5,
}
"""[unit of the channel] steps from which on a column is coarse: its rate over a second, or its noise,
is then larger than what sensors have.
"""
_MIN_LEVELS = 3
_OFF_GRID = 0.01  # steps by which a number may be beside a multiple of the step
_ROUNDING = 1e-9  # of the range, within which numbers are the same


def of_resolution(recording: Recording) -> Iterator[tuple[str, str]]:
    """Yield channels with columns whose numbers are multiples of a large step."""
    for name, limit in _COARSE.items():
        channel = recording.channels.get(name)
        if channel is None:
            continue
        kind = CHANNEL_KINDS[name]
        for k, label in enumerate(kind.columns):
            if k in channel.constants:
                continue
            step = _step(channel.values[:, k])
            if step is not None and step > (1.0 - _OFF_GRID) * limit:
                yield (
                    name,
                    (
                        f"{label} changes in steps of {step:.3g} {kind.unit}: too few digits, which"
                        f" make an error of {step / np.sqrt(12.0):.2g}; take it from a finer source, or"
                        " give as much noise"
                    ),
                )


def _step(values: np.ndarray) -> float | None:
    """Find the step of which all differences of samples (n,) are multiples; `None` where there is
    none, or where all samples are different.
    """
    levels = np.unique(values)
    differences = np.diff(levels)
    differences = differences[differences > _ROUNDING * max(float(np.ptp(values)), 1e-300)]
    if len(differences) < _MIN_LEVELS - 1 or len(differences) > len(values) / 2:
        return None
    step = float(differences.min())
    multiples = differences / step
    if np.abs(multiples - np.round(multiples)).max() > _OFF_GRID:
        return None
    return step
