"""Series of a record whose values are objects of Python: each gets an array that stays where it is, of
which rows are copied.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from uvms_ocp.errors import InvalidInput

_NUMBERS = "biuf"
"""Kinds of NumPy's types that a record holds."""


class SeriesOfObjects:
    """Arrays by the name of the series, of the shapes and types of the values that came first; whole
    numbers of C, which kernels have for other things too, are longer ones.
    """

    def __init__(self) -> None:
        self.arrays: dict[str, np.ndarray] = {}
        """Newest values; empty before the first."""
        self._has_begun = False

    def write(self, values: Mapping[str, Any]) -> None:
        """Take down the values of a tick.

        Raises `InvalidInput` for names other than those of the first tick, and for what is no
        number; shapes must fit those of the first.
        """
        if not self._has_begun:
            self._has_begun = True
            self.arrays = {name: _array(name, value) for name, value in values.items()}
            return
        if values.keys() != self.arrays.keys():
            given, first = (", ".join(names) or "nothing" for names in (values, self.arrays))
            raise InvalidInput(f"row of {given}; give {first}, as in the first one")
        for name, value in values.items():
            self.arrays[name][...] = value


def _array(name: str, value: Any) -> np.ndarray:
    array = np.array(value, order="C")  # row by row, as the rows of a record
    if array.dtype.kind not in _NUMBERS:
        raise InvalidInput(f"series {name} is {value!r}; give numbers")
    if array.dtype == np.int32:
        return array.astype(np.int64)
    return array
