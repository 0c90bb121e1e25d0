"""Optimal control problems with strict priorities, as data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field
from enum import Enum
from typing import Annotated

import numpy as np

from uvms_ocp.checks import checked, checked_dataclass
from uvms_ocp.errors import InvalidInput, NameNotFound
from uvms_ocp.ocp.terms import At, Term
from uvms_ocp.record.display import FieldTable
from uvms_ocp.robot import Robot, State
from uvms_ocp.types import DAY, AtLeastOne, Bound, Positive, Range

MOST_STEPS = 2000
"""Largest number of steps of a phase."""


class Integrator(Enum):
    """Integrator: how a constant acceleration a moves the configuration over a step h.

    MIDPOINT: ``q (+) (h v + h^2/2 a)``, second order on the manifold. MAGNUS: with the commutator
    of v and a, fourth order. EULER: semi-implicit, ``q (+) h (v + h a)`` with the forces of the
    beginning of the step, first order: what shooting solvers for robots usually have, to compare
    with them.
    """

    MIDPOINT = "midpoint"
    MAGNUS = "magnus"
    EULER = "euler"


class Actuation(Enum):
    """Actuators of the vehicle. THRUSTERS: within each thruster's limits, through the thruster
    matrix. WRENCH: any wrench on the vehicle.
    """

    THRUSTERS = "thrusters"
    WRENCH = "wrench"


class HessianKind(Enum):
    """Hessian of the NLP. EXACT, or GAUSS_NEWTON: cheaper and never indefinite, but blind to the
    curvature of the constraints.
    """

    EXACT = "exact"
    GAUSS_NEWTON = "gauss-newton"


@checked_dataclass(eq=False)
class OcpPhase:
    """A part of the horizon with a duration of its own. Raises `InvalidInput` without steps, and for
    durations that are not finite and positive.
    """

    name: str = "horizon"
    """Name by which terms refer to it."""
    n_steps: AtLeastOne = 40
    """Number of its steps."""
    duration: float | tuple[float, float]
    """[s] fixed, or a range ``(shortest, longest)`` to choose from."""

    def __post_init__(self) -> None:
        shortest, longest = self.range
        if self.n_steps > MOST_STEPS:
            raise InvalidInput(
                f"phase {self.name!r}: n_steps = {self.n_steps}; give at most {MOST_STEPS}: each"
                " step takes 0.6 MB and its share of every iteration"
            )
        if not (np.isfinite([shortest, longest]).all() and 0 < shortest <= longest):
            raise InvalidInput(
                f"phase {self.name!r}: duration {self.duration} s; give a time > 0, or a range of"
                " such"
            )
        if longest > DAY:
            raise InvalidInput(
                f"phase {self.name!r}: duration {self.duration} s; give at most {DAY:g} s, a day"
            )

    @property
    def free(self) -> bool:
        """True where the duration is to be chosen."""
        return isinstance(self.duration, tuple)

    @property
    def range(self) -> tuple[float, float]:
        """Shortest and longest duration [s]."""
        if isinstance(self.duration, tuple):
            return self.duration
        return (self.duration, self.duration)

    @property
    def nominal(self) -> float:
        """Duration [s] of guesses, and for references that depend on time."""
        return 0.5 * sum(self.range)


@checked_dataclass(eq=False)
class OcpLevel:
    """Terms of one priority; their squared distances add up by weight, path terms as a mean over
    the nominal time.

    Raises `InvalidInput` without terms.
    """

    name: str
    """Name of the level, for reports."""
    terms: tuple[Term, ...]
    """Terms that are minimised together."""
    relax: Positive | None = None
    """Share by which the cost of the level may rise for lower levels, see
    `uvms_ocp.solvers.nlp.program.NlpLevel`; `None` keeps its rows as they are.
    """

    def __post_init__(self) -> None:
        if not self.terms:
            raise InvalidInput(f"level {self.name!r} has no terms; give at least one")


@checked_dataclass(eq=False, repr=False)
class OcpProblem(FieldTable):
    """Levels from the highest priority to the lowest, subject to dynamics, limits of the robot and
    `constraints`.

    Raises `NameNotFound` for a term of a phase that there is not, and `InvalidInput` without phases
    or levels, for phases or levels of one name, a level that minimises time above others without
    `relax`, thrusters that the robot does not have, power that is not known, a start or current of
    the wrong shape or not finite, and a freedom of the start that is negative.
    """

    robot: Robot
    """Robot that moves."""
    start: State
    """State at the first node."""
    phases: tuple[OcpPhase, ...]
    """Phases, one after the other."""
    levels: tuple[OcpLevel, ...]
    """Levels of terms, highest priority first."""
    constraints: tuple[Term, ...] = ()
    """Terms whose ranges are kept at all levels."""
    current: np.ndarray = field(default_factory=lambda: np.zeros(3))
    """(3,) [m/s] water velocity in W, uniform; or (n_steps, 3), that of each step."""
    floor: Bound = -np.inf
    """[m] height of the seafloor, for altitude terms."""
    integrator: Integrator = Integrator.MIDPOINT
    """Integration of the motion over a step."""
    actuation: Actuation = Actuation.THRUSTERS
    """Actuators of the vehicle."""
    hessian: HessianKind = HessianKind.EXACT
    """Hessian of the NLP."""
    water: bool = True
    """False leaves out all forces of the water, for comparisons."""
    limited: bool = True
    """False leaves out all limits of the robot, for comparisons."""
    altimeter_frame: str = "altimeter"
    """Frame of the altimeter, for altitude terms."""
    start_freedom: np.ndarray | None = None
    """(2 n_v,) [m, rad, m/s, rad/s] allowed difference of the first state from `start`, of each axis
    of the configuration, then of the velocity; infinite where it is free within the limits. `None`
    keeps the first state at `start`.
    """
    periodic: bool = False
    """True where the motion ends in the state in which it begins."""
    longest: Annotated[float, Range(0.0)] = np.inf
    """[s] largest duration of all phases together; without effect where durations are fixed."""

    def __post_init__(self) -> None:
        if not self.phases or not self.levels:
            raise InvalidInput(
                "an optimal control problem needs phases and levels; give at least one of each"
            )
        self._check_names()
        self._check_times_of_levels()
        self._check_current()
        self._check_thrusters()
        self._check_powers()
        self._check_start()

    @property
    def n_steps(self) -> int:
        """Number of steps of all phases."""
        return sum(phase.n_steps for phase in self.phases)

    @property
    def fixed_start(self) -> bool:
        """True where the first state is that of `start`."""
        return self.start_freedom is None

    @property
    def currents(self) -> np.ndarray:
        """Water velocity (n_steps, 3) [m/s] in W at the steps."""
        return np.broadcast_to(self.current, (self.n_steps, 3))

    @property
    def mean_current(self) -> np.ndarray:
        """Mean water velocity (3,) [m/s] over the steps."""
        if np.ndim(self.current) == 1:
            return np.asarray(self.current)
        return np.asarray(np.mean(self.current, axis=0))

    @property
    def free_time(self) -> bool:
        """True where the duration of some phase is to be chosen."""
        return any(phase.free for phase in self.phases)

    @property
    def limits_total(self) -> bool:
        """True where durations are free, but their sum is limited."""
        return self.free_time and bool(np.isfinite(self.longest))

    @property
    def terms(self) -> tuple[Term, ...]:
        """Terms of constraints and of all levels."""
        terms = list(self.constraints)
        for level in self.levels:
            terms += level.terms
        return tuple(terms)

    def starts_of_phases(self) -> np.ndarray:
        """Return the first node of every phase, and the last node of all (n_phases + 1,)."""
        return np.cumsum([0, *(phase.n_steps for phase in self.phases)])

    def nominal_times(self) -> np.ndarray:
        """Return the times (n_steps + 1,) [s] of the nodes with nominal durations."""
        steps = [np.full(phase.n_steps, phase.nominal / phase.n_steps) for phase in self.phases]
        return np.concatenate([[0.0], np.cumsum(np.concatenate(steps))])

    def _check_names(self) -> None:
        """Check the names by which reports, multipliers and terms find phases and levels."""
        phases = [phase.name for phase in self.phases]
        levels = [level.name for level in self.levels]
        for kind, names in (("phases", phases), ("levels", levels)):
            if len(set(names)) < len(names):
                raise InvalidInput(f"{kind} {names} share a name; give each its own")
        for term in self.terms:
            if term.phase is not None and term.phase not in phases:
                raise NameNotFound(f"phase of {term.name}", term.phase, phases)

    def _check_times_of_levels(self) -> None:
        """Refuse a level that minimises time and holds all below it to the last digit."""
        for level in self.levels[:-1]:
            if level.relax is None and any(term.minimises_time for term in level.terms):
                raise InvalidInput(
                    f"level {level.name!r} minimises time: give it `relax`, such as 0.01, or put it"
                    " last"
                )

    def _check_current(self) -> None:
        has_shape = np.shape(self.current) in ((3,), (self.n_steps, 3))
        if not has_shape or not np.isfinite(self.current).all():
            raise InvalidInput(
                f"current {self.current}; give three finite numbers [m/s], or three for each step"
            )

    def _check_thrusters(self) -> None:
        needs_thrusters = self.robot.n_vehicle and self.actuation is Actuation.THRUSTERS
        if needs_thrusters and not self.robot.description.thrusters:
            raise InvalidInput(
                f"robot {self.robot.name!r} has no thrusters; give some in hydrodynamics.yaml,"
                " plan without forces by `plan curve`, or in Python with Actuation.WRENCH"
            )

    def _check_start(self) -> None:
        self.robot.check_configuration(self.start.q)
        n_v = self.robot.n_v
        if np.shape(self.start.v) != (n_v,) or not np.isfinite(self.start.v).all():
            raise InvalidInput(
                f"velocity at the start has shape {np.shape(self.start.v)}; give {n_v} finite"
                " numbers"
            )
        freedom = self.start_freedom
        if freedom is None:
            return
        if np.shape(freedom) != (2 * n_v,) or not (np.asarray(freedom) >= 0).all():
            raise InvalidInput(
                f"start_freedom {freedom}; give {2 * n_v} numbers >= 0, of all axes and of their"
                " velocities"
            )

    def _check_powers(self) -> None:
        """Refuse terms of electrical power where a power is not known."""
        names = [term.name for term in self.terms if term.needs_powers]
        if not (names and self.robot.n_vehicle):
            return
        if self.actuation is Actuation.WRENCH:
            raise InvalidInput(
                f"{names[0]}: the power of a wrench is not known; use Actuation.THRUSTERS, or"
                " Effort"
            )
        unknown = [
            thruster.name for thruster in self.robot.description.thrusters if thruster.power is None
        ]
        if unknown:
            raise InvalidInput(
                f"{names[0]}: no power is given for thruster {', '.join(unknown)}; add it, or use"
                " Effort"
            )


@checked
def single_phase(
    *,
    robot: Robot,
    start: State,
    duration: float,
    n_steps: int,
    levels: Sequence[OcpLevel],
    **options: object,
) -> OcpProblem:
    """Make a problem over one horizon of fixed duration [s]; `options` are further fields of
    `OcpProblem`.
    """
    phase = OcpPhase(duration=duration, n_steps=n_steps)
    return OcpProblem(robot=robot, start=start, phases=(phase,), levels=tuple(levels), **options)  # type: ignore[arg-type]


def counts(problem: OcpProblem, term: Term, phase: OcpPhase, *, at_end: bool) -> bool:
    """Check whether the term has rows at the steps of the phase, or at the node that ends it.

    The last node of the horizon has no step of its own: path terms of the state count there as
    well. So do constraints of one phase at the node that ends it, which begins the next: else the
    last step of the phase would leave their range.
    """
    is_last = phase is problem.phases[-1]
    if term.at is At.END:
        return at_end and (term.phase == phase.name or (term.phase is None and is_last))
    if term.phase not in (None, phase.name):
        return False
    if not at_end:
        return True
    is_constraint = any(term is item for item in problem.constraints)
    is_constraint_of_phase = term.phase is not None and is_constraint
    return term.state_only and (is_last or is_constraint_of_phase)
