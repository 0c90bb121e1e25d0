"""What a record must still be after it was written in any format and read again."""

from __future__ import annotations

import numpy as np

from uvms_ocp.record.record import Record


def require_same(again: Record, record: Record) -> None:
    """The same metadata, series in the same order, of the same types and to the last digit."""
    assert again.meta == record.meta
    assert list(again.series) == list(record.series)
    for name, array in record.series.items():
        assert again[name].dtype == array.dtype
        assert np.array_equal(again[name], array, equal_nan=array.dtype.kind == "f")
