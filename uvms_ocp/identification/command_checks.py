"""Check whether motion follows its commands: after them, soon, and along the axes of a wrench.

An acceleration is explained by a command at an earlier time, beside drag, weight and the turning of
the frame. Where one at a time that cannot be explains much more than all that can be, the clocks
differ.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from uvms_ocp.identification.command_lags import measured_lag
from uvms_ocp.identification.explained_motion import (
    MAY,
    SHIFTS,
    ExplainedMotion,
    commanded,
    commands_and_motion,
)
from uvms_ocp.identification.recording import Recording
from uvms_ocp.identification.resampling import ZeroOrderHold
from uvms_ocp.identification.series_agreement import WAYS, named

_MIN_EXPLAINED = 0.3  # share of what drag leaves that a command must explain to be judged
_MIN_GAIN_OF_SHIFT = 0.1  # share of the same that an implausible time must explain more
_MIN_GAIN_OF_AXES = 0.3  # share of one axis that different axes of a wrench must explain more
_SURE = 3.0  # [standard errors] from which on a lag is certain
_EARLY = 0.03  # [s] by which motion may seem to come before its command
_WRENCH_ROWS = {"forces": slice(0, 3), "moments": slice(3, 6)}


def of_commands(recording: Recording) -> Iterator[tuple[str, str]]:
    """Yield command channels and doubts about them."""
    for name, held, motion in commands_and_motion(recording):
        for text in _command_issues(name, held, motion):
            yield name, text


def _command_issues(name: str, held: ZeroOrderHold, motion: ExplainedMotion) -> Iterator[str]:
    """Yield doubts about the clock of a command, and about the axes of a wrench."""
    signed = name == "wrench"
    shares = np.array([_shares(motion, commanded(held, motion, shift), signed) for shift in SHIFTS])
    moved = shares.max(axis=0) > _MIN_EXPLAINED
    if not moved.any():
        return
    share = shares[:, moved].mean(axis=1)
    late = float(SHIFTS[int(np.argmax(share))])
    early = list(early_motion(held, motion)) if signed else []
    yield from early
    if not early and share.max() > share[MAY].max() + _MIN_GAIN_OF_SHIFT:
        if late > 0:
            when = f"{late:.2f} s after"
        else:
            when = f"{-late:.2f} s before"
        yield f"the vehicle accelerates {when} what it says: a clock of its own?"
    if signed:
        yield from _wrench_axes(held, motion, late)


def early_motion(
    held: ZeroOrderHold, motion: ExplainedMotion, actuator_lag: float = 0.0
) -> Iterator[str]:
    """Yield a doubt where a vehicle accelerates before a wrench (k, 6) that is held says so: nothing does.

    actuator_lag: [s] by which actuators are known to lag. Of other commands than a wrench nothing is
    said: one that works against waves comes after what it works against.
    """
    measured = measured_lag(held, motion, signed=True)
    if measured is None or measured.lag + _SURE * measured.sigma > -_EARLY:
        return
    at_least = "" if actuator_lag else " at least"
    yield (
        f"the vehicle accelerates {-measured.lag:.2f} +- {measured.sigma:.2f} s before what it says: its"
        f" times are late, give delay: {actuator_lag - measured.lag:.2f}{at_least}"
    )


def _wrench_axes(held: ZeroOrderHold, motion: ExplainedMotion, late: float) -> Iterator[str]:
    """Yield axes by which a wrench explains the acceleration better than by those that it has."""
    forces_in_body = commanded(held, motion, late)
    forces_in_world = commanded(held, motion, late, turned=True)
    as_it_is = named(np.eye(3))
    for part, rows in _WRENCH_ROWS.items():
        acceleration = motion.acceleration[:, rows]
        shares = {}
        for Q in WAYS:
            shares[named(Q)] = _signed_share(acceleration, forces_in_body[:, rows], Q)
        share_in_world = _signed_share(acceleration, forces_in_world[:, rows], np.eye(3))
        shares["in W"] = share_in_world - _MIN_GAIN_OF_AXES / 2
        best = max(shares, key=lambda way: shares[way])
        if shares[best] > max(shares[as_it_is], 0.0) + _MIN_GAIN_OF_AXES:
            yield f"its {part} fit the acceleration as {best}"


def _signed_share(acceleration: np.ndarray, forces: np.ndarray, Q: np.ndarray) -> float:
    """Sum the shares that forces (m, 3), turned by Q, explain of the acceleration (m, 3) along each
    axis; negative where they point away from it.
    """
    along = np.diag(_correlations(acceleration, forces @ Q.T))
    return float((along * np.abs(along)).sum())


def _shares(motion: ExplainedMotion, forces: np.ndarray, signed: bool) -> np.ndarray:
    """Compute shares (6,) of all accelerations that a command explains; signed: True if each component
    acts along its axis alone.
    """
    if signed:
        return np.maximum(np.diag(_correlations(motion.acceleration, forces)), 0.0) ** 2
    forces = forces / np.maximum(np.linalg.norm(forces, axis=0), 1e-300)
    common = forces.T @ motion.acceleration
    inverse = np.linalg.pinv(forces.T @ forces, rcond=1e-12, hermitian=True)
    along = (common * (inverse @ common)).sum(axis=0)
    return np.asarray(along / np.maximum((motion.acceleration**2).sum(axis=0), 1e-9))


def _correlations(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Compute correlations (k, l) of the columns of x (m, k) and y (m, l)."""
    sizes = np.outer(np.linalg.norm(x, axis=0), np.linalg.norm(y, axis=0))
    return np.asarray(x.T @ y / np.maximum(sizes, 1e-300))
