"""The greedy mission on the kinematic plant: where a search for something better begins."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from uvms_ocp.model.sensing import IDEAL_SENSORS
from uvms_ocp.preflight.forecast import main_path
from uvms_ocp.scenario import Scenario, our_controller

_DT = 0.05  # [s] control period: a guess needs no better
_EVERY = 4  # ticks between two configurations that are kept
_UNKNOWN = 10.0  # [s] of a phase that the greedy mission does not come to, or not out of


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class GreedyWay:
    """Configurations, and when each phase of the way begins."""

    t: np.ndarray
    """(n,) [s]"""
    q: np.ndarray
    """(n, n_q) [m, rad]"""
    phases: tuple[int, ...]
    """Indices in the mission of the phases on the way."""
    begins: np.ndarray
    """(n_phases + 1,) [s] of each, and the end of the last."""

    quantities: Mapping[str, np.ndarray]
    """(n,) each, by the names of conditions [in their units]."""

    def rows(self, k: int) -> np.ndarray:
        """Indices of what is kept of the k-th phase on the way."""
        return np.flatnonzero((self.t >= self.begins[k]) & (self.t < self.begins[k + 1]))

    def at(self, row: int) -> dict[str, float]:
        """All quantities in a row."""
        return {name: float(values[row]) for name, values in self.quantities.items()}


def greedy_way(scenario: Scenario) -> GreedyWay:
    """Fly it without water, noise and faults."""
    ideal = replace(
        scenario,
        plant="kinematic",
        sensors=IDEAL_SENSORS,
        faults=(),
        plant_robot=None,
        controller=our_controller,
        dt=_DT,
    )
    record = ideal.run()
    ends = [(event.source, event.t) for event in record.run_meta.events]
    phases = main_path(scenario.mission.phases)
    names = [scenario.mission.phases[index].name for index in phases]
    kept = slice(None, None, _EVERY)
    return GreedyWay(
        t=record["t"][kept],
        q=record["q"][kept],
        phases=tuple(phases),
        begins=_begins(names, ends),
        quantities=dict(zip(record.meta.quantities, record["quantities"][kept].T, strict=True)),
    )


def _begins(names: Sequence[str], ends: Sequence[tuple[str, float]]) -> np.ndarray:
    """Beginnings of the phases [s], as far as the greedy mission goes through them in their order, and the last end."""
    begins = [0.0]
    for k, name in enumerate(names):
        known = k < len(ends) and ends[k][0] == name
        begins.append(max(ends[k][1], begins[-1]) if known else begins[-1] + _UNKNOWN)
    return np.array(begins)
