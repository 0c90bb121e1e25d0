"""From the readings of one channel to where kernels see them, and back to those that the filter may see."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np

from uvms_ocp.arrays import Array
from uvms_ocp.control.navigation.health.reasons import Texts
from uvms_ocp.model.state import Reading


class Seat:
    """Where a channel's readings are taken in."""

    __slots__ = ("_scalar", "_shape", "_texts", "_value", "memory", "seen", "used")

    def __init__(self, memory: ctypes.Structure, shape: tuple[int, ...], texts: Texts) -> None:
        """memory: a `ChannelMemory`. shape: of a right value."""
        self.memory, self._shape, self._texts = memory, shape, texts
        self._scalar = shape == ()
        self._value = np.ctypeslib.as_array(memory.value)[: memory.size]
        self.seen: Reading[Any] | None = None
        """The newest."""
        self.used: Reading[Any] | None = None
        """What the filter sees: the last reading that was not refused, or one that says that there is nothing to read."""

    def take(self, reading: Reading[Any]) -> None:
        """Another reading than the newest so far."""
        self.seen, memory, value = reading, self.memory, reading.value
        memory.stamp, memory.fresh = reading.t, True
        if self._scalar and isinstance(value, float):
            self._value[0] = value
        elif value.__class__ is np.ndarray and value.shape == self._shape:
            self._value[:] = value
        else:
            self._take_in(np.asarray(value))

    def _take_in(self, value: Array) -> None:
        """One of any shape."""
        if value.shape == self._shape:
            self._value[:] = value
        else:
            self.memory.misshapen = self._texts.shape(value.shape, self._shape)
