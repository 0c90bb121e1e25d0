"""Sampling design of a campaign: a table of numbers from 0 to 1, of which run k has row k, whatever runs
before it.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from uvms_ocp.errors import InvalidInput, optional_module, require_known
from uvms_ocp.record.table_files import CAMPAIGN_EXTRA

SAMPLERS = ("random", "latin", "sobol", "indices")
"""Independent draws; a Latin hypercube; a scrambled Sobol' sequence; the design that Sobol' indices
need.
"""
GROWING = ("random", "sobol")
"""Samplers whose design of more runs begins with that of fewer."""
_PARAMETER_STREAM = 0  # of the random numbers of a run, for its parameters
_SEED_STREAM = 1  # the same, for its seed


@dataclass(frozen=True, kw_only=True, slots=True)
class Design:
    """Design of samples in the unit cube. Raises `NameNotFound` for a sampler, `InvalidInput` for a
    number of runs.
    """

    sampler: str
    """One of `SAMPLERS`."""
    runs: int
    """Number of runs."""
    parameters: int
    """Number of varied parameters."""
    seed: int
    """Seed of everything drawn."""

    def __post_init__(self) -> None:
        require_known("sampler", self.sampler, SAMPLERS)
        if self.sampler != "indices":
            return
        block = self.parameters + 2
        if self.parameters < 2:
            raise InvalidInput(
                f"the sampler indices with {self.parameters} parameters; give 2 or more to compare"
            )
        base = self.runs // block
        if base < 2 or base * block != self.runs or base & (base - 1):
            nearest_base = 2 ** max(1, round(np.log2(max(self.runs / block, 2))))
            allowed = (
                f"a power of 2 times {block}, the parameters and 2 more, such as"
                f" {nearest_base * block}"
            )
            raise InvalidInput(f"{self.runs} runs with the sampler indices; give {allowed}")

    def row(self, run: int) -> np.ndarray:
        """Return the numbers (parameters,) of a run, from 0 to 1. Raises `NotInstalled` for indices
        without SALib.
        """
        if not self.parameters:
            return np.zeros(0)
        if self.sampler == "random":
            return np.random.default_rng(self._entropy(run, _PARAMETER_STREAM)).random(
                self.parameters
            )
        return np.asarray(_table(self)[run])

    def seed_of(self, run: int) -> int:
        """Return the seed of everything else that is random in a run."""
        return int(self._entropy(run, _SEED_STREAM).generate_state(1)[0])

    def _entropy(self, run: int, stream: int) -> np.random.SeedSequence:
        """Return the source of the random numbers of a stream of a run."""
        return np.random.SeedSequence(self.seed, spawn_key=(run, stream))


@lru_cache(maxsize=4)
def _table(design: Design) -> Any:
    """Draw the numbers of a design (runs, parameters), from 0 to 1."""
    from scipy.stats import qmc

    if design.sampler == "indices":
        sobol = optional_module("SALib.sample.sobol", "the sampler indices", CAMPAIGN_EXTRA)
        problem = problem_of([f"x{k}" for k in range(design.parameters)])
        return sobol.sample(
            problem,
            design.runs // (design.parameters + 2),
            calc_second_order=False,
            seed=design.seed,
        )
    if design.sampler == "latin":
        return qmc.LatinHypercube(design.parameters, rng=design.seed).random(design.runs)
    with warnings.catch_warnings():
        # Any number of runs is allowed.
        warnings.filterwarnings("ignore", message="The balance properties")
        return qmc.Sobol(design.parameters, rng=design.seed).random(design.runs)


def problem_of(names: list[str]) -> dict[str, Any]:
    """Return the problem of these parameters for SALib, each from 0 to 1."""
    return {"num_vars": len(names), "names": names, "bounds": [[0.0, 1.0]] * len(names)}
