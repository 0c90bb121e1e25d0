"""How calls are timed, the same for us and for the peers, whose environments have the standard
library only.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from math import inf
from time import perf_counter, process_time
from typing import Generic, TypeVar

T = TypeVar("T")
LONG = 10.0
"""[s] after which calls of solvers are not repeated any more."""


@dataclass(frozen=True)
class Timed(Generic[T]):
    """The last value of a repeated call, and its least times."""

    value: T
    wall: float
    """[s] by the clock on the wall."""
    cpu: float
    """[s] of the processor."""


def timed(call: Callable[[], T], repeats: int, long: float = inf) -> Timed[T]:
    """One call to warm up, then the least times of `repeats` calls, or of those that begin within
    `long` [s].
    """
    value = call()
    walls = list[float]()
    cpus = list[float]()
    while len(walls) < repeats and sum(walls) < long:
        wall = perf_counter()
        cpu = process_time()
        value = call()
        walls.append(perf_counter() - wall)
        cpus.append(process_time() - cpu)
    return Timed(value, min(walls), min(cpus))


def once(call: Callable[[], T]) -> Timed[T]:
    """The times of a call that is made once, such as one that builds."""
    wall = perf_counter()
    cpu = process_time()
    value = call()
    return Timed(value, perf_counter() - wall, process_time() - cpu)


def built(build: Callable[[], T], *, cold: bool) -> Timed[T]:
    """The times of a build; cold: from an empty cache of compiled code, as the first time on a
    machine.
    """
    if not cold:
        return once(build)
    before = os.environ.get("UVMS_OCP_CACHE")
    with tempfile.TemporaryDirectory() as cache:
        os.environ["UVMS_OCP_CACHE"] = cache
        try:
            return once(build)
        finally:
            del os.environ["UVMS_OCP_CACHE"]
            if before is not None:
                os.environ["UVMS_OCP_CACHE"] = before
