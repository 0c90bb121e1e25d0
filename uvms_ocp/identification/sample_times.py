"""Correct the times of samples: over midnight, of messages that arrive in bursts, and of echoes."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification import tables

_DAY = 86_400.0  # [s]
_AROUND_MIDNIGHT = 600.0  # [s] on each side, within which times of day go on to the next day
_AT_ONCE = 0.05  # share of the usual interval within which an equal message is an echo


def pass_midnight(channel_tables: Iterable[tables.TableColumns]) -> None:
    """Let times of day [s], in the first column of tables, go on from one day to the next where those of
    any channel do, in place; other times stay.

    The middles of all are then within half a day of the middle of the first that does.
    """
    columns = [table.values[:, 0] for table in channel_tables]
    times_of_day = [t for t in columns if _are_times_of_day(t)]
    continued_times = [_continued(t[np.isfinite(t)]) for t in times_of_day]
    first_middle = None
    for continued in continued_times:
        if continued.min() < 0.0 or continued.max() >= _DAY:
            first_middle = _middle(continued)
            break
    if first_middle is None:
        return
    for column, continued in zip(times_of_day, continued_times, strict=True):
        n_days = np.round((first_middle - _middle(continued)) / _DAY)
        column[np.isfinite(column)] = continued + _DAY * n_days


def _are_times_of_day(t: np.ndarray) -> bool:
    """Check that times (n,) [s], of which some are finite, lie within a day."""
    is_outside = (t < 0.0) | (t >= _DAY)
    return bool(np.isfinite(t).any() and not is_outside.any())


def _continued(t: np.ndarray) -> np.ndarray:
    """Let times of day (n,) [s] go on after midnight."""
    return np.unwrap(t, _DAY - 2.0 * _AROUND_MIDNIGHT, period=_DAY)


def _middle(t: np.ndarray) -> float:
    """Return the middle [s] of times (n,) [s]."""
    return 0.5 * float(t.min() + t.max())


def without_echoes(rows: np.ndarray) -> np.ndarray:
    """Drop rows (n, 1 + k) that repeat the one before at nearly the same time, as republished
    topics do.
    """
    steps = np.diff(rows[:, 0])
    same = (np.diff(rows[:, 1:], axis=0) == 0.0).all(axis=1)
    if (~same).sum() < 2:
        return rows
    usual_step = float(np.median(np.diff(rows[np.r_[True, ~same], 0])))  # [s] between new values
    is_echo = same & (steps >= 0.0) & (steps < _AT_ONCE * usual_step)
    return rows[np.r_[True, ~is_echo]]


def even_send_times(arrived: np.ndarray, period: float) -> np.ndarray:
    """Compute times (n,) [s] at which messages were sent every `period` [s], from when they arrived
    (n,) [s].

    A message was sent no later than it arrived, and at least a period before the next one: its time is
    the smallest of all these bounds. Where messages are lost, the times after the gap are right again as soon
    as one comes without delay. What all messages are late by stays. Raises InvalidInput for a
    period that is not positive.
    """
    if not period > 0.0:
        raise InvalidInput(f"period = {period} s given; allowed: more than 0")
    since = period * np.arange(len(arrived))
    return np.asarray(np.minimum.accumulate((arrived - since)[::-1])[::-1] + since)
