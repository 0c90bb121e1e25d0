"""Excitation design: commands after which the numbers that matter are known best, within thrust, pool and time.

Optimal control in its simplest form: commands at knots are the unknowns, the course follows from them, and its information
has a slope with all of them at once. The search begins with drawn sines, flown so that they stay in the pool. Limits of thrust
hold all along; slew, pool and tilt are penalties with a margin, dearer from round to round. What comes out is limited in thrust
and slew exactly, and simulated once more in finer steps to see whether it stays in the pool.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from uvms_ocp.identification.answers.numbers import Number, numbers_at
from uvms_ocp.identification.excitation.assignment import Assignment
from uvms_ocp.identification.excitation.course import Courses
from uvms_ocp.identification.excitation.history import History, multisine
from uvms_ocp.identification.excitation.keeping import kept_inside
from uvms_ocp.identification.excitation.objective import Objective
from uvms_ocp.identification.methods.rollout import Rollout
from uvms_ocp.identification.recordings.recording import Channel
from uvms_ocp.identification.recordings.sampling import Held
from uvms_ocp.status import AdvisedStatus

_FINER = 5  # times, the steps of the last simulation
_PRICES = 30.0, 300.0, 3000.0  # [-] of leaving the pool, round by round
_MORE, _MOST_MARGIN = (0.1, 0.2, 0.3), 0.9  # [-] of margin, tried one after the other
_SHARES = 1.0, 2.0, 4.0  # [-] of what each axis can get alone, where the search begins


class DesignStatus(AdvisedStatus):
    """Where a design leads."""

    INSIDE = "inside the pool", "See how far vehicles with other numbers go before it drives one."
    OUTSIDE = (
        "leaves the pool or tilts too far",
        "Give a larger pool, less thrust or less time, or allow more iterations.",
    )


@dataclass(frozen=True, kw_only=True, slots=True)
class Effort:
    """Of the search."""

    step: float = 0.1
    """[s] of the simulation, for which a command is held."""
    knots: float = 0.5
    """[s] between the commands that are searched for."""
    fastest: float = 0.2
    """[Hz] of the sines where the search begins."""
    starts: int = 3
    """[-] drawn in each size, of which the best is made better."""
    iterations: tuple[int, int, int] = (250, 50, 50)
    """[-] while leaving the pool costs little, more, and much."""
    seed: int = 0


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Excitation:
    """Commands, and what they are expected to tell."""

    commands: Channel
    """(n, n_u) [N, N m] held for a step each; they begin with 0."""
    states: np.ndarray
    """(k, n_x) [as `Stage`] that they lead to, from rest, in the finer steps of the last simulation."""
    numbers: tuple[Number, ...]
    """As they are known after one recording, where the vehicle is as it is believed to be."""
    information: np.ndarray
    """(n_p, n_p) [1 / unknowns^2] of one recording, priors left out."""
    status: DesignStatus


def designed(given: Assignment, rollout: Rollout, effort: Effort | None = None) -> Excitation:
    """Search. rollout: of the vehicle's stage. Raises NameNotFound for a number that there is not."""
    chosen = effort or Effort()
    courses = Courses(rollout, given.unknowns, chosen.step, given.still)
    history = History.of(given.duration, chosen.knots, chosen.step, courses.delay)
    objective = Objective(given.aim(), given.limits, history, courses)
    knots = _begun(given, rollout, chosen, history, objective)
    for price, iterations in zip(_PRICES, chosen.iterations, strict=True):
        knots = objective.lowered(knots, price, iterations)
    return _corrected(given, rollout, chosen, objective, knots)


def _corrected(
    given: Assignment, rollout: Rollout, chosen: Effort, objective: Objective, knots: np.ndarray
) -> Excitation:
    """What knots lead to; with more margin where the finer steps find it outside."""
    found = _simulated(given, rollout, chosen, objective, knots)
    for more in _MORE:
        if found.status is DesignStatus.INSIDE:
            break
        wider = replace(given.limits, margin=min(given.limits.margin + more, _MOST_MARGIN))
        knots = replace(objective, limits=wider).lowered(knots, _PRICES[-1], chosen.iterations[-1])
        found = _simulated(given, rollout, chosen, objective, knots)
    return found


def _simulated(
    given: Assignment, rollout: Rollout, chosen: Effort, objective: Objective, knots: np.ndarray
) -> Excitation:
    told = given.limits.kept(objective.history.told @ knots, chosen.step)
    return excitation_of(given, rollout, Channel(t=chosen.step * np.arange(len(told)), values=told))


def excitation_of(given: Assignment, rollout: Rollout, commands: Channel) -> Excitation:
    """What other commands, held for equal steps, would tell."""
    step = float(commands.t[1] - commands.t[0])
    courses, held = Courses(rollout, given.unknowns, step, given.still), Held(commands)
    edges = commands.t[0] + step * np.arange(len(commands.t) + 1) - courses.delay
    aim = given.aim()
    information = aim.information(courses.of(held.mean(edges), -held.mean_slope(edges)), step)
    n, states = len(given.vehicle.shared.start), led(given, rollout, commands, given.unknowns)
    left = given.limits.beyond(states, margin=0.0)[0].any()
    return Excitation(
        commands=commands,
        states=states,
        numbers=numbers_at(given.vehicle, given.vehicle.shared.start, aim.covariance(information)[:n, :n]),
        information=information,
        status=DesignStatus.OUTSIDE if left else DesignStatus.INSIDE,
    )


def led(given: Assignment, rollout: Rollout, commands: Channel, p: np.ndarray) -> np.ndarray:
    """States (k, n_x) [as `Stage`] to which commands lead a vehicle with unknowns p (n_p,) [as `Unknowns.start`]."""
    step = float(commands.t[1] - commands.t[0]) / _FINER
    courses = Courses(rollout, p, step, given.still)
    edges = commands.t[0] + step * np.arange(_FINER * len(commands.t) + 1) - courses.delay
    return courses.states(Held(commands).mean(edges))


def _begun(given: Assignment, rollout: Rollout, chosen: Effort, history: History, objective: Objective) -> np.ndarray:
    """Knots (n_knots, n_u) [N, N m] where the search begins: the best of sines that are made to stay in the pool."""
    rng, found = np.random.default_rng(chosen.seed), []
    for _ in range(chosen.starts):
        for share in _SHARES:
            wanted = share * multisine(rng, len(history.told), 6, given.duration * chosen.fastest)
            told = kept_inside(given, rollout, wanted, chosen.step)
            found.append(np.clip(np.linalg.lstsq(history.told, told, rcond=None)[0], *given.limits.thrust.T))
    return min(found, key=lambda knots: objective.value(knots, _PRICES[0])[0])
