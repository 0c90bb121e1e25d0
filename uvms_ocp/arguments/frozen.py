"""Values that cannot be changed: mappings and arrays."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike


class FrozenDict(dict[Any, Any]):
    """A dictionary that stays as it was made; it can be pickled, copied and written as JSON."""

    __slots__ = ()

    def _refuse(self, *_: object, **__: object) -> NoReturn:
        raise TypeError(
            "this mapping is part of a frozen value; make a new one, as by dict(...) or dataclasses.replace"
        )

    __setitem__ = __delitem__ = __ior__ = _refuse
    clear = pop = popitem = setdefault = update = _refuse

    def __reduce__(self) -> tuple[type[FrozenDict], tuple[dict[Any, Any]]]:
        return FrozenDict, (dict(self),)

    def __copy__(self) -> FrozenDict:
        return self


def frozen_mapping(items: Mapping[Any, Any]) -> FrozenDict:
    """The same entries, for good."""
    return items if type(items) is FrozenDict else FrozenDict(items)


def read_only(values: ArrayLike, dtype: type | None = None) -> np.ndarray:
    """``values`` (...) [any] as an array that neither its holder nor its giver can write to: a copy unless it is one."""
    array = np.asarray(values, dtype=dtype)
    if array is not values or array.flags.writeable or array.base is not None:
        array = np.array(array)
        array.flags.writeable = False
    return array
