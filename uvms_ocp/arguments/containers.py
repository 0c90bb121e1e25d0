"""What an argument of a composed type may be: alternatives, sequences, mappings, functions, things with certain methods."""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from uvms_ocp.arguments.extents import Shape
from uvms_ocp.arguments.frozen import frozen_mapping
from uvms_ocp.arguments.kinds import Kind, Number, Numbers, Whole, Wrong, short

_TEXT = (str, bytes)


@dataclass(frozen=True)
class Choice(Kind):
    """One of some plain values."""

    values: tuple[Any, ...]

    @property
    def allowed(self) -> str:  # type: ignore[override]
        """In words."""
        return " or ".join(map(repr, self.values))

    def holds(self, value: object) -> bool:
        return isinstance(value, (str, int, bytes, type(None))) and value in self.values


@dataclass(frozen=True)
class Either(Kind):
    """Any of some kinds."""

    kinds: tuple[Kind, ...]

    @property
    def allowed(self) -> str:  # type: ignore[override]
        """In words."""
        return " or ".join(dict.fromkeys(kind.allowed for kind in self.kinds))

    @property
    def converts(self) -> bool:  # type: ignore[override]
        """Whether one of them does."""
        return any(kind.converts for kind in self.kinds)

    @property
    def shaped(self) -> bool:  # type: ignore[override]
        """Whether one of them is."""
        return any(kind.shaped for kind in self.kinds)

    def holds(self, value: object) -> bool:
        return any(kind.holds(value) for kind in self.kinds)

    def wrong(self, place: str, value: object) -> Wrong:
        # An alternative that finds its fault deep inside was the one that was meant.
        found = [kind.wrong(place, value) for kind in self.kinds]
        deeper = [fault for fault in found if fault.place != place or not fault.found.startswith("=")]
        return deeper[0] if deeper else super().wrong(place, value)

    def shape_of(self, value: object) -> Shape | None:
        return next((kind.shape_of(value) for kind in self.kinds if kind.holds(value)), None)

    def taken(self, value: Any) -> Any:
        return self._of(value).taken(value)

    def kept(self, value: Any) -> Any:
        return self._of(value).kept(value)

    def _of(self, value: object) -> Kind:
        return next(kind for kind in self.kinds if kind.holds(value))


@dataclass(frozen=True)
class Items(Kind):
    """Several values of one kind: a tuple, a list, any sequence, or anything to iterate over."""

    holder: type
    kind: Kind

    @property
    def allowed(self) -> str:  # type: ignore[override]
        """In words."""
        name = "sequence" if self.holder in (Sequence, Iterable) else self.holder.__name__
        inner = self.kind.allowed
        return f"a {name}" + ("" if type(self.kind) is Kind else f" of which each is {inner}")

    @property
    def converts(self) -> bool:  # type: ignore[override]
        """A frozen value keeps a tuple."""
        return self.kind.converts or self.holder in (Sequence, list)

    def holds(self, value: object) -> bool:
        if not self._is_holder(value):
            return False
        return not isinstance(value, (Sequence, np.ndarray, set, frozenset)) or all(map(self.kind.holds, value))

    def wrong(self, place: str, value: object) -> Wrong:
        if self._is_holder(value):
            for index, item in enumerate(value):  # type: ignore[var-annotated, arg-type]
                if not self.kind.holds(item):
                    return self.kind.wrong(f"{place}[{index}]", item)
        return super().wrong(place, value)

    def taken(self, value: Any) -> Any:
        return (
            type(value)(map(self.kind.taken, value)) if self.kind.converts and type(value) in (tuple, list) else value
        )

    def kept(self, value: Any) -> Any:
        return tuple(map(self.kind.kept, value)) if isinstance(value, (tuple, list)) else value

    def _is_holder(self, value: object) -> bool:
        if isinstance(value, _TEXT):
            return False
        numbers = isinstance(self.kind, (Number, Whole, Numbers)) and self.holder in (Sequence, Iterable)
        return isinstance(value, self.holder) or (numbers and isinstance(value, np.ndarray) and value.ndim > 0)


@dataclass(frozen=True)
class Several(Kind):
    """A tuple of a given length; where numbers are asked for, any sequence of them will do."""

    kinds: tuple[Kind, ...]

    @property
    def allowed(self) -> str:  # type: ignore[override]
        """In words."""
        return f"({', '.join(kind.allowed for kind in self.kinds)})"

    @property
    def converts(self) -> bool:  # type: ignore[override]
        """Numbers in a list or array become a tuple."""
        return True

    def holds(self, value: object) -> bool:
        if not self._is_holder(value) or len(value) != len(self.kinds):  # type: ignore[arg-type]
            return False
        return all(kind.holds(item) for kind, item in zip(self.kinds, value, strict=True))  # type: ignore[call-overload]

    def wrong(self, place: str, value: object) -> Wrong:
        if self._is_holder(value) and len(value) == len(self.kinds):  # type: ignore[arg-type]
            for index, (kind, item) in enumerate(zip(self.kinds, value, strict=True)):  # type: ignore[call-overload]
                if not kind.holds(item):
                    return kind.wrong(f"{place}[{index}]", item)
        return super().wrong(place, value)

    def taken(self, value: Any) -> Any:
        return value if isinstance(value, tuple) else tuple(value)

    def kept(self, value: Any) -> Any:
        return tuple(kind.kept(item) for kind, item in zip(self.kinds, value, strict=True))

    def _is_holder(self, value: object) -> bool:
        numbers = all(isinstance(kind, (Number, Whole)) for kind in self.kinds)
        return isinstance(value, tuple) or (
            numbers and isinstance(value, (list, np.ndarray)) and getattr(value, "ndim", 1) == 1
        )


@dataclass(frozen=True)
class Table(Kind):
    """A mapping."""

    key: Kind
    item: Kind
    allowed = "a mapping"
    converts = True

    def holds(self, value: object) -> bool:
        return isinstance(value, Mapping) and not any(True for _ in self._faults("", value))

    def wrong(self, place: str, value: object) -> Wrong:
        if isinstance(value, Mapping):
            return next(self._faults(place, value))
        return super().wrong(place, value)

    def kept(self, value: Any) -> Any:
        return frozen_mapping(
            {key: self.item.kept(item) for key, item in value.items()} if self.item.converts else value
        )

    def _faults(self, place: str, value: Mapping[Any, Any]) -> Iterator[Wrong]:
        for key, item in value.items():
            if not self.key.holds(key):
                yield self.key.wrong(f"a key of {place}", key)
            if not self.item.holds(item):
                yield self.item.wrong(f"{place}[{short(key)}]", item)


@dataclass(frozen=True)
class Filled(Kind):
    """A value of a generic class of which some fields are of certain kinds."""

    cls: type
    parts: tuple[tuple[str, Kind], ...]

    @property
    def allowed(self) -> str:  # type: ignore[override]
        """In words."""
        inner = " and ".join(f"`{name}` is {kind.allowed}" for name, kind in self.parts)
        return f"a {self.cls.__name__} of which {inner}"

    def holds(self, value: object) -> bool:
        return isinstance(value, self.cls) and all(kind.holds(getattr(value, name)) for name, kind in self.parts)

    def wrong(self, place: str, value: object) -> Wrong:
        if isinstance(value, self.cls):
            for name, kind in self.parts:
                if not kind.holds(item := getattr(value, name)):
                    return kind.wrong(f"{place}.{name}", item)
        return super().wrong(place, value)


@dataclass(frozen=True)
class Function(Kind):
    """Something to call, with so many arguments as far as its signature can be read."""

    n_arguments: int | None = None

    @property
    def allowed(self) -> str:  # type: ignore[override]
        """In words."""
        return "a function" + ("" if self.n_arguments is None else f" of {self.n_arguments} arguments")

    def holds(self, value: object) -> bool:
        if not callable(value):
            return False
        try:
            inspect.signature(value).bind(*[None] * (self.n_arguments or 0))
        except TypeError:
            return self.n_arguments is None
        except ValueError:  # built in
            return True
        return True


@dataclass(frozen=True)
class Duck(Kind):
    """A value, of whatever class, with the methods of a protocol."""

    protocol: type
    methods: tuple[str, ...]

    @property
    def allowed(self) -> str:  # type: ignore[override]
        """In words."""
        return f"a value with the methods of {self.protocol.__name__} ({', '.join(self.methods)})"

    def holds(self, value: object) -> bool:
        return not isinstance(value, type) and all(hasattr(value, name) for name in self.methods)


@dataclass(frozen=True)
class Subclass(Kind):
    """A class."""

    base: type

    @property
    def allowed(self) -> str:  # type: ignore[override]
        """In words."""
        return f"a class of {self.base.__name__}s"

    def holds(self, value: object) -> bool:
        return isinstance(value, type) and issubclass(value, self.base)
