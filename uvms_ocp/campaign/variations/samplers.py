"""Numbers from 0 to 1 for every run: a table of which run k has row k, whatever runs before it."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from uvms_ocp.exceptions import InvalidInput, NameNotFound, NotInstalled

SAMPLERS = ("random", "latin", "sobol", "indices")
"""Independent draws; a Latin hypercube; a scrambled Sobol' sequence; the design that Sobol' indices need."""
_DRAWN, _SEED = 0, 1  # streams of a run


@dataclass(frozen=True, kw_only=True, slots=True)
class Design:
    """Which numbers the runs have. Raises `NameNotFound` for an unknown sampler, `InvalidInput` for a wrong number of runs."""

    sampler: str
    runs: int
    """[-]"""
    parameters: int
    """[-] that are varied."""
    seed: int
    """[-]"""

    def __post_init__(self) -> None:
        if self.sampler not in SAMPLERS:
            raise NameNotFound("sampler", self.sampler, SAMPLERS)
        if self.sampler == "indices":
            self._require_blocks()

    def row(self, run: int) -> np.ndarray:
        """Numbers (parameters,) [-] of a run [-], from 0 to 1. Raises `NotInstalled` for indices without SALib."""
        if not self.parameters:
            return np.zeros(0)
        if self.sampler == "random":
            return np.random.default_rng(self._entropy(run, _DRAWN)).random(self.parameters)
        return np.asarray(_table(self)[run])

    def seed_of(self, run: int) -> int:
        """Of everything else that is random in a run [-]."""
        return int(self._entropy(run, _SEED).generate_state(1)[0])

    def _entropy(self, run: int, stream: int) -> np.random.SeedSequence:
        return np.random.SeedSequence(self.seed, spawn_key=(run, stream))

    def _require_blocks(self) -> None:
        block = self.parameters + 2
        if self.parameters < 2:
            raise InvalidInput(f"the sampler indices with {self.parameters} parameters; give 2 or more to compare")
        base = self.runs // block
        if base < 2 or base * block != self.runs or base & (base - 1):
            near = 2 ** max(1, round(np.log2(max(self.runs / block, 2))))
            allowed = f"a power of 2 times {block}, the parameters and 2 more, such as {near * block}"
            raise InvalidInput(f"{self.runs} runs with the sampler indices; give {allowed}")


@lru_cache(maxsize=4)
def _table(design: Design) -> Any:
    """(runs, parameters) [-]."""
    from scipy.stats import qmc

    if design.sampler == "indices":
        return _indices(design)
    if design.sampler == "latin":
        return qmc.LatinHypercube(design.parameters, rng=design.seed).random(design.runs)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="The balance properties")  # any number of runs is allowed
        return qmc.Sobol(design.parameters, rng=design.seed).random(design.runs)


def _indices(design: Design) -> Any:
    problem = problem_of([f"x{k}" for k in range(design.parameters)])
    try:
        from SALib.sample import sobol
    except ImportError:
        raise NotInstalled("the sampler indices", '"uvms-ocp[campaign]"') from None
    base = design.runs // (design.parameters + 2)
    return sobol.sample(problem, base, calc_second_order=False, seed=design.seed)


def problem_of(names: list[str]) -> dict[str, Any]:
    """What SALib calls the parameters of these names, each from 0 to 1."""
    return {"num_vars": len(names), "names": names, "bounds": [[0.0, 1.0]] * len(names)}
