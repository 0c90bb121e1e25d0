"""Problems of the hierarchy benchmark: recorded ticks of Case 1, random and adversarial
hierarchies.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from uvms_ocp.control.velocity.levels import LevelsProblem
from uvms_ocp.scenario.cases.case1 import case1
from uvms_ocp.solvers.hierarchy.active_set import LexicographicActiveSet
from uvms_ocp.solvers.hierarchy.level import Level, row_slices, widen_bounds
from uvms_ocp.solvers.hierarchy.solution import Tick, TickResult

Inputs: TypeAlias = tuple[np.ndarray, ...]
"""Arguments of one call of a levels function."""
STRUCTURES = {
    7: (7, 2, 3, 2, 7),
    13: (13, 3, 6, 1, 1, 6, 4, 6, 3, 3, 13),
    60: (60, 9, 20, 12, 30, 60),
}
"""Rows of the levels by the number of unknowns."""
LARGE = (7, 13, 20, 40, 80, 160)
"""Unknowns of the sets that grow."""
HUMANOID = 88
"""Unknowns of the set of a humanoid's size."""
EACH_LARGE = 20
"""Hierarchies of each of these sets."""
DEPENDENT = (6, 6, 6, 3, 13)
"""Rows of the levels whose rows depend on each other."""
NEARLY = 1e-6
"""Distance of rows from dependence at which they are neither dependent nor independent."""
SEPARATED = (1e-4, 1e-3)
"""Distances of rows from dependence at which they are independent, if barely."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Problem:
    """A set of hierarchies of the same shape."""

    name: str
    warm: bool
    """Whether neighbours are one tick apart."""
    sets: list[list[Level]]

    @property
    def sizes(self) -> tuple[int, ...]:
        """Rows of each level."""
        return tuple(level.n_rows for level in self.sets[0])


@dataclass(frozen=True, kw_only=True, slots=True)
class Recording:
    """A solver that keeps the inputs of every tick."""

    solver: LexicographicActiveSet
    inputs: list[Inputs]

    def bind(self, levels_function: ca.Function, sizes: tuple[int, ...]) -> Tick:
        tick = self.solver.bind(levels_function, sizes)

        def recorded(*inputs: ArrayLike) -> TickResult:
            copies = [np.array(value, dtype=float) for value in inputs]
            self.inputs.append(tuple(copies))
            return tick(*inputs)

        return recorded


def recorded_ticks(duration: float) -> tuple[LevelsProblem, list[Inputs]]:
    """The levels function of Case 1, and the inputs of all ticks of a run of duration [s] on the
    kinematic plant.
    """
    scenario = case1(plant="kinematic", duration=duration)
    recording = Recording(solver=LexicographicActiveSet(), inputs=[])
    replace(scenario, solver=recording).run()
    return scenario.kinematic_controller().problem, recording.inputs


def levels_of(problem: LevelsProblem, inputs: Inputs) -> list[Level]:
    """The levels of one tick, gates in the bounds."""
    J, *columns = problem.function(*inputs)[:6]
    J = np.array(J)
    lower, upper, rate, activation, gate = [np.array(column).ravel() for column in columns]
    levels = []
    for rows in row_slices(problem.sizes):
        level = Level(
            jacobian=J[rows],
            lower=lower[rows],
            upper=upper[rows],
            rate=rate[rows],
            activation=activation[rows],
            gate=gate[rows],
        )
        levels.append(_gated(level))
    return levels


def _gated(level: Level) -> Level:
    lower, upper = widen_bounds(level.jacobian, level.lower, level.upper, level.gate)
    rate = level.rate
    activation = level.activation * level.gate
    return Level(
        jacobian=level.jacobian,
        lower=lower,
        upper=upper,
        rate=np.clip(rate, lower, upper),
        activation=activation,
    )


def problems(problem: LevelsProblem, inputs: Sequence[Inputs], count: int) -> list[Problem]:
    """Recorded ticks, and `count` hierarchies of each random kind."""
    recorded = [levels_of(problem, tick) for tick in inputs]
    sets = [Problem(name="case1", warm=True, sets=recorded)]
    for n in STRUCTURES:
        sets.append(_random(f"random n={n}", n, range(count)))
    sets.append(_dependent("dependent", 0.0, range(count)))
    sets.append(_dependent(f"dependent to {NEARLY:.0e}", NEARLY, range(count)))
    return sets


def large_problems(largest: int) -> list[Problem]:
    """Sets that grow up to `largest` unknowns: random ones, ones without a conflict, one of a
    humanoid's size.
    """
    grown = []
    boxed = []
    for n in LARGE:
        if n <= largest:
            grown.append(_large(f"random, grown, n={n}", n, grown_hierarchy))
            boxed.append(_large(f"box and equalities, n={n}", n, boxed_hierarchy))
    sets = grown + boxed
    if largest >= HUMANOID:
        sets.append(_large(f"humanoid's size, n={HUMANOID}", HUMANOID, humanoid_hierarchy))
    return sets


def _large(
    name: str, n: int, hierarchy: Callable[[np.random.Generator, int], list[Level]]
) -> Problem:
    sets = [hierarchy(np.random.default_rng(seed), n) for seed in range(EACH_LARGE)]
    return Problem(name=name, warm=False, sets=sets)


def grown_hierarchy(rng: np.random.Generator, n: int) -> list[Level]:
    """Velocity box, equalities and inequalities, least velocity below."""
    return random_hierarchy(rng, n, (n, n // 7, n // 3, n // 5, n // 2, n))


def boxed_hierarchy(rng: np.random.Generator, n: int) -> list[Level]:
    """Velocity box, three levels of equalities, least velocity below."""
    first, *_, last = random_hierarchy(rng, n, (n, n))
    middle = [_equalities(rng, n, m) for m in (n // 7, n // 3, n // 5)]
    return [first, *middle, last]


def _equalities(rng: np.random.Generator, n: int, m: int) -> Level:
    """Level of m equalities."""
    J = rng.standard_normal((m, n))
    b = rng.standard_normal(m)
    return Level(jacobian=J, lower=b, upper=b)


def humanoid_hierarchy(rng: np.random.Generator, n: int) -> list[Level]:
    """Simple bounds of most variables, 33, 3 and 2 rows, and 97 below."""
    box = Level(
        jacobian=np.eye(n)[14:],
        lower=-rng.uniform(0.5, 1.5, n - 14),
        upper=rng.uniform(0.5, 1.5, n - 14),
    )
    equalities = [_equalities(rng, n, m) for m in (33, 3, 2)]
    below = np.vstack([np.eye(n), rng.standard_normal((97 - n, n))])
    return [box, *equalities, Level(jacobian=below, lower=0.0, upper=0.0)]


def exactness_problems(count: int) -> list[Problem]:
    """`count` hierarchies in all, whose rows are independent, dependent, or separated."""
    separations = (0.0, *SEPARATED)
    seeds = [(7, seed) for seed in range(count // (2 + len(separations)))]
    sets = []
    for n in (7, 13):
        sets.append(_random(f"exactness, random n={n}", n, seeds))
    for nearly in separations:
        sets.append(_dependent(f"exactness, dependent to {nearly:g}", nearly, seeds))
    return sets


def _random(name: str, n: int, seeds: Sequence[int | tuple[int, ...]]) -> Problem:
    sets = [random_hierarchy(np.random.default_rng(seed), n, STRUCTURES[n]) for seed in seeds]
    return Problem(name=name, warm=False, sets=sets)


def _dependent(name: str, nearly: float, seeds: Sequence[int | tuple[int, ...]]) -> Problem:
    sets = []
    for seed in seeds:
        sets.append(dependent_hierarchy(np.random.default_rng(seed), 13, DEPENDENT, nearly))
    return Problem(name=name, warm=False, sets=sets)


def random_states(inputs: Sequence[Inputs], count: int) -> list[Inputs]:
    """Recorded ticks with another attitude, place, posture and velocity."""
    rng = np.random.default_rng(0)
    states = []
    for _ in range(count):
        tick = inputs[int(rng.integers(len(inputs)))]
        q, v, passive, _, change, altitude, *unchanged = map(np.copy, tick)
        q[:3] += rng.uniform(-2.0, 2.0, 3)
        q[3:7] = rng.standard_normal(4)
        q[3:7] /= np.linalg.norm(q[3:7])
        q[7:] += rng.uniform(-0.5, 0.5, len(q) - 7)
        v = rng.uniform(-0.3, 0.3, len(v))
        states.append((q, v, passive, v, change, altitude * rng.uniform(0.2, 2.0), *unchanged))
    return states


def random_hierarchy(rng: np.random.Generator, n: int, sizes: tuple[int, ...]) -> list[Level]:
    """A box on top, conflicting equalities and one- and two-sided inequalities, least velocity at
    the bottom.
    """
    box = Level(jacobian=np.eye(n), lower=-rng.uniform(0.5, 1.5, n), upper=rng.uniform(0.5, 1.5, n))
    at_rest = Level(jacobian=np.eye(n), lower=0.0, upper=0.0)
    middle = [_random_level(rng, n, size) for size in sizes[1:-1]]
    return [box, *middle, at_rest]


def _random_level(rng: np.random.Generator, n: int, size: int) -> Level:
    lower = rng.standard_normal(size)
    kind = rng.integers(0, 4, size)
    width = np.select([kind == 2, kind == 3], [rng.uniform(0.0, 1.0, size), np.inf], 0.0)
    return Level(jacobian=rng.standard_normal((size, n)), lower=lower, upper=lower + width)


def dependent_hierarchy(
    rng: np.random.Generator, n: int, sizes: tuple[int, ...], nearly: float
) -> list[Level]:
    """Half of the rows combine earlier ones, up to `nearly`."""
    earlier = [rng.standard_normal(n)]
    levels = []
    for size in sizes:
        for _ in range(size):
            first, second = rng.integers(0, len(earlier), 2)
            factor = rng.choice([-1.0, 0.0, 2.0])
            row = (earlier[first] + factor * earlier[second]) / 3.0
            if rng.random() < 0.5:
                row = rng.standard_normal(n)
            earlier.append(row + nearly * rng.standard_normal(n))
        low = np.round(rng.standard_normal(size), 1)
        width = rng.choice([0.0, 0.5, np.inf], size)
        levels.append(Level(jacobian=np.array(earlier[-size:]), lower=low, upper=low + width))
    return levels
