"""Excitation design: commands after which the numbers that matter are known best, within thrust, pool and time.

Optimal control in its simplest form: commands at knots are the unknowns, the course follows from them, and its information
has a slope with all of them at once. The search begins with drawn sines, flown so that they stay in the pool. Limits of thrust
hold all along; slew, pool and tilt are penalties with a margin, dearer from round to round. What comes out is limited in thrust
and slew exactly. Finer steps say where it leads: by how much they differ is added to the courses of the next round.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from uvms_ocp.identification.excitation.assignment import Assignment
from uvms_ocp.identification.excitation.course import Courses
from uvms_ocp.identification.excitation.expected import FINER, DesignStatus, Excitation, excitation_of
from uvms_ocp.identification.excitation.history import History, multisine
from uvms_ocp.identification.excitation.keeping import kept_inside
from uvms_ocp.identification.excitation.objective import Objective
from uvms_ocp.identification.excitation.wanted import wanted
from uvms_ocp.identification.methods.rollout import Rollout
from uvms_ocp.identification.recordings.recording import Channel

_PRICES = 100.0, 300.0, 1000.0, 1000.0  # [-] of leaving the pool, round by round
_DEARER = 3000.0, 10000.0, 30000.0  # [-] where the finer steps still find it outside
_SHARES = 1.0, 2.0, 4.0  # [-] of what each axis can get alone, where the search begins


@dataclass(frozen=True, kw_only=True, slots=True)
class Effort:
    """Of the search."""

    step: float = 0.05
    """[s] of the simulation, for which a command is held."""
    knots: float = 0.2
    """[s] between the commands that are searched for."""
    fastest: float = 0.2
    """[Hz] of the sines where the search begins."""
    starts: int = 3
    """[-] drawn in each size, of which the best is made better."""
    iterations: int = 200
    """[-] in a round; leaving the pool costs little in the first and much in the last."""
    seed: int = 0


def designed(given: Assignment, rollout: Rollout, effort: Effort | None = None) -> Excitation:
    """Search. rollout: of the vehicle's stage. Raises NameNotFound for a number that there is not."""
    search = _Search.of(given, rollout, effort or Effort())
    knots = search.begun()
    for price in _PRICES:
        knots = search.lowered(knots, price)
    for price in _DEARER:
        if search.expected(knots).status is DesignStatus.INSIDE:
            break
        knots = search.lowered(knots, price)
    return search.expected(knots)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Search:
    """For knots (n_knots, n_u) [N, N m]."""

    given: Assignment
    rollout: Rollout
    effort: Effort
    objective: Objective

    @staticmethod
    def of(given: Assignment, rollout: Rollout, effort: Effort) -> _Search:
        aim, courses = given.aim(), Courses(rollout, given.unknowns, effort.step, given.still)
        history = History.of(given.duration, effort.knots, effort.step, courses.delay)
        objective = Objective(aim, given.limits, history, courses, wanted(given, rollout))
        return _Search(given=given, rollout=rollout, effort=effort, objective=objective)

    def begun(self) -> np.ndarray:
        """The best of sines that are made to stay in the pool."""
        given, history, rng = self.given, self.objective.history, np.random.default_rng(self.effort.seed)
        found = []
        for share in _SHARES * self.effort.starts:
            sines = multisine(rng, history.told.shape[0], 6, given.duration * self.effort.fastest)
            flown = kept_inside(given, self.rollout, share * sines, self.effort.step)
            found.append(np.clip(history.nearest(flown), *given.limits.thrust.T))
        return min(found, key=lambda knots: self.objective.value(knots, _PRICES[0])[0])

    def lowered(self, knots: np.ndarray, price: float) -> np.ndarray:
        """Better ones after a round, for a price [-] of leaving the pool."""
        coarse = self.objective.courses.states(self.objective.history.acting @ knots)
        off = self.expected(knots).states[::FINER] - coarse
        return replace(self.objective, off=off).lowered(knots, price, self.effort.iterations)

    def expected(self, knots: np.ndarray) -> Excitation:
        """What they tell, kept to thrust and slew, and where they lead."""
        step = self.effort.step
        told = self.given.limits.kept(self.objective.history.told @ knots, step)
        return excitation_of(self.given, self.rollout, Channel(t=step * np.arange(len(told)), values=told))
