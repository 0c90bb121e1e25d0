"""How many numbers the stages of a horizon have, and where each of them keeps its own."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise

from uvms_ocp.arguments import checked
from uvms_ocp.exceptions import InvalidInput


@checked
@dataclass(frozen=True, kw_only=True, slots=True)
class StageShape:
    """N + 1 stages: N with states and controls, a last one with states only. Sizes may differ from stage to stage.

    Raises `InvalidInput` for lists of other lengths, negative sizes, and a horizon in which nothing varies.
    """

    n_x: tuple[int, ...]
    """(N + 1,) [-] states."""
    n_u: tuple[int, ...]
    """(N,) [-] controls."""
    n_r: tuple[int, ...]
    """(N + 1,) [-] rows of the residual."""
    n_c: tuple[int, ...]
    """(N + 1,) [-] rows of constraints."""

    def __post_init__(self) -> None:
        for name, length in (("n_x", self.N + 1), ("n_r", self.N + 1), ("n_c", self.N + 1)):
            if len(getattr(self, name)) != length:
                raise InvalidInput(f"{name} of {len(getattr(self, name))} stages; give {length} for {self.N} controls")
        if min((*self.n_x, *self.n_u, *self.n_r, *self.n_c)) < 0:
            raise InvalidInput("a stage has a negative size; give sizes >= 0")
        if sum(self.n_z) == 0:
            raise InvalidInput("no stage has a state or a control; give at least one")

    @property
    def N(self) -> int:
        """[-] Steps."""
        return len(self.n_u)

    @property
    def n_z(self) -> tuple[int, ...]:
        """(N + 1,) [-] Variables ``z = (x, u)``."""
        return tuple(n_x + n_u for n_x, n_u in zip(self.n_x, (*self.n_u, 0), strict=True))


def places(sizes: Iterable[int]) -> list[int]:
    """Where parts of such `sizes` [-] begin in one array, and where the last one ends."""
    return [0, *accumulate(sizes)]


def slices(sizes: Sequence[int]) -> list[slice]:
    """The same as slices; sizes [-]."""
    begin = places(sizes)
    return [slice(a, b) for a, b in pairwise(begin)]
