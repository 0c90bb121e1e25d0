"""The greedy mission on the kinematic plant: where a search for something better begins; and what is foretold of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from uvms_ocp.control.velocity.levels import build_levels
from uvms_ocp.model.sensing import IDEAL_SENSORS
from uvms_ocp.preflight.forecast import forecast, main_path
from uvms_ocp.scenario import Scenario, our_controller

_DT = 0.05  # [s] control period: a guess needs no better
_EVERY = 4  # ticks between two configurations that are kept
_UNKNOWN = 10.0  # [s] of a phase that the greedy mission does not come to, or not out of, or that is foretold
_FORETOLD = 0.5  # [s] between two configurations that are foretold


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
        duration=max(scenario.duration, _DT),
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


def foretold_way(scenario: Scenario) -> GreedyWay:
    """As pre-flight foretells it: what cannot be planned is found on it before anything is flown, and compiled for that.

    Straight from stance to stance, as long in every phase; no quantity is known on it. Raises `FrameNotFound` and
    `NameNotFound` for what tasks name and the robot does not have.
    """
    phases = main_path(scenario.mission.phases)
    begins = _UNKNOWN * np.arange(len(phases) + 1)
    t = np.arange(0.0, begins[-1] + _FORETOLD / 2, _FORETOLD)
    q = np.tile(scenario.start, (len(t), 1))
    if scenario.robot.n_vehicle:
        marks = np.array([scenario.start[:3], *(visit.stances[0].position for visit in forecast(scenario.setup()))])
        q[:, :3] = np.stack([np.interp(t, begins, marks[:, axis]) for axis in range(3)], axis=1)
    names = build_levels(scenario.robot, scenario.mission.hierarchy, scenario.dt).quantity_names
    unknown = np.full(len(t), np.nan)
    return GreedyWay(t=t, q=q, phases=tuple(phases), begins=begins, quantities=dict.fromkeys(names, unknown))


def _begins(names: Sequence[str], ends: Sequence[tuple[str, float]]) -> np.ndarray:
    """Beginnings of the phases [s], as far as the greedy mission goes through them in their order, and the last end."""
    begins = [0.0]
    for k, name in enumerate(names):
        known = k < len(ends) and ends[k][0] == name
        begins.append(max(ends[k][1], begins[-1]) if known else begins[-1] + _UNKNOWN)
    return np.array(begins)
