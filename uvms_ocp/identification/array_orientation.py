"""Decide whether rows or columns of an array of two dimensions are samples, by times that rise
along one of them; its shape alone says nothing.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

_FEWEST_TIMES = 8  # that are no chance
_FEWEST_ALONE = 3  # of a vector, where no longer one tells
_UNEVEN = 5.0  # times the usual step, within which most steps between times are


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class OrientedArray:
    """An array whose rows are samples."""

    values: np.ndarray
    """(n, k) [as in the file] samples, one in each row."""
    note: str = ""
    """Evidence for which it was turned on its side."""
    remark: str = ""
    """Shape whose rows were taken for samples without evidence."""


def oriented(
    array: np.ndarray, n_times: Collection[int], n_few_times: Collection[int] = ()
) -> OrientedArray:
    """Turn an array (n,) or (n, k) so that its rows are samples.

    n_times: lengths of the vectors of times in the same file; n_few_times: lengths of those that are
    short. A single row is a vector. An array that is wider than long, and that no length of times
    explains, is left as it is, with a remark.
    """
    table = array.reshape(len(array), -1)
    n_rows, n_columns = table.shape
    if n_rows == 1:
        return OrientedArray(values=table.T)
    if n_columns <= n_rows:
        return OrientedArray(values=table)
    rows_have_times = n_rows in n_times
    columns_have_times = n_columns in n_times
    if rows_have_times == columns_have_times:
        rows_have_times = n_rows in n_few_times
        columns_have_times = n_columns in n_few_times
    if rows_have_times == columns_have_times:
        rows_have_times = are_times(table[:, 0])
        columns_have_times = are_times(table[0])
    shape = f"{n_rows} rows by {n_columns} columns"
    if columns_have_times and not rows_have_times:
        note = f"{shape} turned on their side, as times rise along the columns"
        return OrientedArray(values=table.T, note=note)
    if rows_have_times and not columns_have_times:
        return OrientedArray(values=table)
    remark = f"{shape}: rows are taken for samples; save it turned on its side where columns are"
    return OrientedArray(values=table, remark=remark)


def are_few_times(series: np.ndarray) -> bool:
    """Recognise times (n,) that are fewer than those that are no chance."""
    return len(series) < _FEWEST_TIMES and _rise(series, _FEWEST_ALONE)


def are_times(series: np.ndarray) -> bool:
    """Recognise times (n,): they rise throughout, mostly by even steps."""
    return _rise(series, _FEWEST_TIMES)


def _rise(series: np.ndarray, fewest: int) -> bool:
    """Check that at least so many numbers (n,) rise throughout, mostly by even steps."""
    if len(series) < fewest or not np.isfinite(series).all():
        return False
    steps = np.diff(series)
    usual = float(np.median(steps))
    short, long = np.percentile(steps, [10.0, 90.0])
    return bool(steps.min() > 0.0 and usual / _UNEVEN < short and long < _UNEVEN * usual)
