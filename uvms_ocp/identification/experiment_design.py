"""Optimal experiment design: commands after which the numbers that matter are known best, within
thrust, pool and time.

Single shooting: commands at knots are the unknowns, the trajectory follows from them, and its
information has a gradient by all. The search begins with drawn sines, flown so that they stay in
the pool. Limits of thrust hold all along; slew, pool and tilt are penalties with a margin, dearer
from round to round. What comes out is limited in thrust and slew exactly. Finer steps say where it
leads: by how much they differ is added to the trajectories of the next round.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated

import numpy as np

from uvms_ocp.checks import checked_dataclass
from uvms_ocp.errors import AdvisedStatus, InvalidInput, NameNotFound
from uvms_ocp.identification import experiment
from uvms_ocp.identification.model import N_Q, N_V, Vehicle
from uvms_ocp.identification.output_error import Noise
from uvms_ocp.identification.recording import Channel, ZeroOrderHold
from uvms_ocp.identification.rollout import Rollout
from uvms_ocp.identification.uncertainty import (
    DETERMINED_BELOW,
    IdentifiedNumber,
    numbers_at,
    slopes_of,
)
from uvms_ocp.robot.spatial import quaternion_to_matrix
from uvms_ocp.types import Positive, Range

# What an excitation is to find out, and with which means.

# [s]: maps from knots to commands grow with the square
_SHORTEST = 1.0
_LONGEST = 1800.0

FINER = 5
"""Steps of the simulation that says where commands lead, in one of the search."""

_AHEAD = 1.0  # [s] that the spring looks ahead

STEP = 0.05
"""[s] for which a command is held."""
_AMPLITUDES = np.linspace(1.0, 0.05, 20)  # of the largest thrust, tried one after the other
_HOLD = 2.0  # [s] of a step
# [Hz] of chirps
_SLOWEST = 0.1
_FASTEST = 1.0

HALF = 0.5
"""Target, as a share of the smallest standard error by hand."""

_PRICES = 100.0, 300.0, 1000.0, 1000.0  # of leaving the pool, round by round
_DEARER = 3000.0, 10000.0, 30000.0  # where the finer steps still find it outside
_START_FREQUENCY = 0.2  # [Hz] of the sines where the search begins
_START_AMPLITUDES = 1.0, 2.0, 4.0  # of what each axis can get alone, where the search begins


@checked_dataclass(eq=False)
class ExperimentTask:
    """Experiment to be designed: its vehicle, limits, sensors, and the numbers that are to be known
    well.

    Raises InvalidInput for limits of other actuators, and too little time or too much.
    """

    vehicle: Vehicle
    """Vehicle with its unknowns at their prior values."""
    limits: experiment.ExperimentLimits
    duration: Annotated[float, Range(_SHORTEST, _LONGEST)] = 60.0
    """[s] of a recording."""
    matter: tuple[str, ...] = ()
    """Numbers, or quantities, which are to be known well; all where none is named."""
    noise: Noise = field(default_factory=Noise)
    """Noise of the sensors."""
    rate: Positive = 10.0
    """[Hz] of the sensors."""
    prior_information: np.ndarray | None = None
    """(n_p, n_p) [1 / unknowns^2] information of recordings that there are."""
    joints: tuple[float, ...] = ()
    """(n_j,) [rad or m] of the arm, which is held still; 0 where none is given."""

    def __post_init__(self) -> None:
        n_u = len(self.vehicle.actuators.names)
        if len(self.limits.thrust) != n_u:
            raise InvalidInput(
                f"thrust of {len(self.limits.thrust)} actuators given; allowed: {n_u}"
            )

    @property
    def unknowns(self) -> np.ndarray:
        """(n_p,) [as `Unknowns.start`]"""
        return np.concatenate([self.vehicle.shared.start, self.vehicle.own.start])

    @property
    def still(self) -> np.ndarray:
        """(3 n_j,) [as `StageFunctions` has joints]"""
        n_j = self.vehicle.dynamics.model.nv - N_V
        return np.concatenate([self.joints or np.zeros(n_j), np.zeros(2 * n_j)])

    def aim(self) -> experiment.InformationCriterion:
        """Build the criterion. Raises NameNotFound for a number that does not depend on the
        unknowns.
        """
        names, slopes = slopes_of(self.vehicle, self.vehicle.shared.start)
        chosen = slopes[_chosen(names, self.matter)]
        priors = np.concatenate([self.vehicle.shared.sigma, self.vehicle.own.sigma])
        if self.prior_information is None:
            information = np.zeros((len(priors),) * 2)
        else:
            information = self.prior_information
        return experiment.InformationCriterion(
            slopes=np.hstack([chosen, np.zeros((len(chosen), len(self.vehicle.own.start)))]),
            prior_information=information + np.diag(1.0 / priors**2),
            noise=self.noise,
            rate=self.rate,
        )


def _chosen(names: Sequence[tuple[str, str]], matter: Sequence[str]) -> list[int]:
    """List places of the numbers that matter, by their name or quantity; names: (quantity,
    number).
    """
    for label in matter:
        if not any(label in pair for pair in names):
            raise NameNotFound("number", label, [number for _, number in names])
    return [k for k, pair in enumerate(names) if not matter or set(pair) & set(matter)]


# What commands are expected to tell where the vehicle is as it is believed to be, and where they
# lead it.


class DesignStatus(AdvisedStatus):
    """Outcome of a design."""

    INSIDE = "inside the pool", "See how far vehicles with other numbers go before it drives one."
    OUTSIDE = (
        "leaves the pool or tilts too far",
        "Give a larger pool, less thrust or less time, or allow more iterations.",
    )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Excitation:
    """Commands, and the numbers that they are expected to determine."""

    commands: Channel
    """(n, n_u) [N, N m] held for a step each; they begin with 0."""
    states: np.ndarray
    """(k, n_x) [as `StageFunctions`] that they lead to, from rest, in the finer steps of the last
    simulation.
    """
    swept: np.ndarray
    """(2, 3) [m] lowest and highest corner of what the hull sweeps, in W, from where the vehicle's
    origin begins.
    """
    numbers: tuple[IdentifiedNumber, ...]
    """Expected numbers after one recording, if the vehicle is as the priors have it."""
    information: np.ndarray
    """(n_p, n_p) [1 / unknowns^2] of one recording, priors left out."""
    status: DesignStatus


def excitation_of(task: ExperimentTask, rollout: Rollout, commands: Channel) -> Excitation:
    """Predict what other commands, held for equal steps, would determine."""
    step = float(commands.t[1] - commands.t[0])
    courses = experiment.TrajectorySimulator(rollout, task.unknowns, step, task.still)
    held = ZeroOrderHold(commands)
    edges = commands.t[0] + experiment.edges_of(len(commands.t), step, courses.delay)
    aim = task.aim()
    information = aim.information(courses.of(held.mean(edges), -held.mean_slope(edges)), step)
    n = len(task.vehicle.shared.start)
    states = simulate_commands(task, rollout, commands, task.unknowns)
    outside = task.limits.beyond(states, margin=0.0)[0].any()
    return Excitation(
        commands=commands,
        states=states,
        swept=task.limits.swept(states),
        numbers=numbers_at(
            task.vehicle, task.vehicle.shared.start, aim.covariance(information)[:n, :n]
        ),
        information=information,
        status=DesignStatus.OUTSIDE if outside else DesignStatus.INSIDE,
    )


def simulate_commands(
    task: ExperimentTask, rollout: Rollout, commands: Channel, p: np.ndarray
) -> np.ndarray:
    """Simulate states (k, n_x) [as `StageFunctions`] to which commands lead a vehicle with unknowns
    p (n_p,) [as `Unknowns.start`].
    """
    step = float(commands.t[1] - commands.t[0]) / FINER
    courses = experiment.TrajectorySimulator(rollout, p, step, task.still)
    edges = commands.t[0] + experiment.edges_of(FINER * len(commands.t), step, courses.delay)
    return courses.states(ZeroOrderHold(commands).mean(edges))


# Any commands, made to stay in the pool: where they lead out of it, a spring at the actuators pulls
# back.


def keep_inside_pool(
    task: ExperimentTask, rollout: Rollout, shares: np.ndarray, step: float
) -> np.ndarray:
    """Make commands (n, n_u) [N, N m] within thrust and slew from shares (n, 6) [-] of the largest
    force or torque along each axis alone, held for a step [s].

    At a wall the spring balances all that an axis can get; the vehicle is as it is believed to be.
    """
    B = task.vehicle.actuators.wrench
    p = task.unknowns
    joints = task.still
    spread = np.linalg.pinv(B)
    largest_wrench = 1.0 / (np.abs(spread) / np.abs(task.limits.thrust).min(axis=1)[:, None]).max(
        axis=0
    ).clip(1e-9)
    stiff = largest_wrench / np.concatenate(
        [task.limits.room, [task.limits.tilt, task.limits.tilt, np.inf]]
    )
    x = np.zeros(rollout.stage.n_x)
    commands = []
    before = np.zeros(len(spread))
    x[N_Q - 1] = 1.0
    for share in shares:
        # (6,) [m, rad] from where it began and from upright, in B; yaw is free.
        R = np.array(quaternion_to_matrix(x[3:N_Q]))
        back = stiff * (
            np.concatenate([R.T @ x[:3], [R[2, 1], -R[2, 0], 0.0]]) + _AHEAD * x[N_Q : N_Q + N_V]
        )
        before = task.limits.after(before, spread @ (share * largest_wrench - back), step)
        commands.append(before)
        x = np.asarray(rollout.step(x, before, joints, p, step)).ravel()
    return np.array(commands)


# Thrust as one would think of it: steps, chirps, and both at once; each flown within the same pool,
# as large as it allows.


def steps(t: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Push axis after axis ahead and back, (n, 6) [-] at t (n,) [s]; half as far in every other
    turn.
    """
    place = (t / _HOLD).astype(int)
    size = np.where(place // 12 % 2, 0.5, 1.0) * np.where(place % 2, -1.0, 1.0)
    return np.asarray(size[:, None] * (place[:, None] // 2 % 6 == np.arange(6)))


def chirps(t: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Swing axis after axis, from slow to fast, (n, 6) [-] at t (n,) [s]."""
    duration = (t[-1] + t[1]) / 6
    since = t % duration
    wave = np.cos(2 * np.pi * (_SLOWEST + (_FASTEST - _SLOWEST) * since / duration / 2) * since)
    return np.asarray(wave[:, None] * ((t / duration).astype(int)[:, None] == np.arange(6)))


def both(t: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Draw steps of all axes at once, chirps beside them, (n, 6) [-] at t (n,) [s]."""
    shape = int(t[-1] / 3) + 1, 6
    drawn = rng.uniform(-1, 1, size=shape) * (rng.uniform(size=shape) < 0.5)
    chirp = 0.3 * np.sin(2 * np.pi * (0.05 + 0.15 * t / t[-1])[:, None] * t[:, None] + np.arange(6))
    return np.asarray(drawn[(t / 3).astype(int)] + chirp)


BY_HAND = {"steps": steps, "chirps": chirps, "steps and chirps": both}


def largest(task: ExperimentTask, rollout: Rollout, name: str, seed: int = 0) -> Excitation:
    """Predict the motion of a name in `BY_HAND`, as large as the limits allow."""
    t = STEP * np.arange(round(task.duration / STEP))
    motion = BY_HAND[name](t, np.random.default_rng(seed))
    for share in _AMPLITUDES:
        excitation = excitation_of(
            task,
            rollout,
            Channel(t=t, values=keep_inside_pool(task, rollout, share * motion, STEP)),
        )
        if excitation.status is DesignStatus.INSIDE:
            break
    return excitation


# How well numbers are to be known: twice as well as steps and chirps by hand tell them, and well
# enough to count.


def target_deviations(task: ExperimentTask, rollout: Rollout) -> np.ndarray:
    """Compute the standard errors (m,) [units of numbers] that the numbers that matter are to have.

    Recordings can only add to what is believed: it is their own information that is to be more.
    Where those by hand say less than that, belief is left to stand. Raises NameNotFound for a
    number that there is not.
    """
    aim = task.aim()
    chosen = _chosen(slopes_of(task.vehicle, task.vehicle.shared.start)[0], task.matter)
    by_hand = [largest(task, rollout, name).numbers for name in BY_HAND]
    smallest = np.full(len(by_hand[0]), np.inf)
    learnt = np.zeros(len(by_hand[0]), dtype=bool)
    for numbers in by_hand:
        smallest = np.minimum(smallest, [number.sigma for number in numbers])
        learnt |= [number.informed for number in numbers]
    smallest = smallest[chosen]
    learnt = learnt[chosen]
    sizes = np.array([number.size or np.inf for number in by_hand[0]])[chosen]
    believed = 1.0 / aim.deviations(np.zeros_like(aim.prior_information)) ** 2
    information = np.where(learnt, 1.0 / smallest**2 - believed, 0.0)
    return np.asarray(
        (believed + np.maximum(information / HALF**2, 1.0 / (DETERMINED_BELOW * sizes) ** 2))
        ** -0.5
    )


# What a search of commands lowers: what is left unknown, and what it costs to leave the pool or to
# hurry thrusters.


@dataclass(frozen=True, slots=True, eq=False)
class Objective:
    """Objective of the design, a function of knots (n_knots, n_u) [N, N m]."""

    aim: experiment.InformationCriterion
    limits: experiment.ExperimentLimits
    history: experiment.KnotCommands
    courses: experiment.TrajectorySimulator
    wanted: np.ndarray
    """(m,) [units of numbers] standard errors that those of the aim are compared with."""
    off: np.ndarray = field(default_factory=lambda: np.zeros(1))
    """(n + 1, n_x) [as `StageFunctions`], or none (1,), that states are truly beside the course."""

    def value(self, knots: np.ndarray, price: float) -> tuple[float, np.ndarray]:
        """Compute the objective at knots (n_knots, n_u) [N, N m], with its slope [1/N, 1/(N m)];
        price: of leaving the pool.
        """
        trajectory = self.courses.of(self.history.acting @ knots, self.history.late @ knots)
        figure, M = self.aim.figure(trajectory, self.courses.h, self.wanted)
        out, slope = self.limits.beyond(trajectory.x + self.off)
        share = 2.0 * price / len(trajectory.x)
        with_x = np.pad(
            share * np.einsum("ki,kij->kj", out, slope),
            ((0, 0), (0, trajectory.x.shape[1] - slope.shape[2])),
        )
        with_u, with_late = self.courses.pulled(trajectory, M, with_x)
        hurry, with_sent = self._hurry(self.history.sent @ knots, price)
        pulled = (
            self.history.acting.T @ with_u
            + self.history.late.T @ with_late
            + self.history.sent.T @ with_sent
        )
        return figure + share * float((out**2).sum()) / 2.0 + hurry, pulled

    def lowered(self, knots: np.ndarray, price: float, iterations: int) -> np.ndarray:
        """Search for better knots (n_knots, n_u) [N, N m], by a quasi-Newton method within the
        limits of thrust; price: of leaving the pool.
        """
        from scipy.optimize import minimize  # half a second, which few need

        size = np.abs(self.limits.thrust).max(axis=1)

        def lower(scaled: np.ndarray) -> tuple[float, np.ndarray]:
            value, slope = self.value(scaled.reshape(knots.shape) * size, price)
            return value, (slope * size).ravel()

        bounds = np.tile(self.limits.thrust / size[:, None], (len(knots), 1))
        options = {"maxiter": iterations, "maxcor": 30}
        solution = minimize(
            lower,
            (knots / size).ravel(),
            jac=True,
            method="L-BFGS-B",
            bounds=bounds,
            options=options,
        )
        return np.asarray(solution.x.reshape(knots.shape) * size)

    def _hurry(self, commands: np.ndarray, price: float) -> tuple[float, np.ndarray]:
        """Compute the penalty of steps beyond the slew limit, with its slope (n, n_u) [1/N,
        1/(N m)].
        """
        slope = np.zeros_like(commands)
        largest_change = self.limits.slew * self.courses.h
        if not np.isfinite(largest_change):
            return 0.0, slope
        change = np.diff(commands, axis=0)
        over = np.sign(change) * np.maximum(np.abs(change) / largest_change - 1.0, 0.0)
        gradient = 2.0 * price / len(commands) * over / largest_change
        slope[1:] += gradient
        slope[:-1] -= gradient
        return price / len(commands) * float((over**2).sum()), slope


# Excitation design: commands after which the numbers that matter are known best, within thrust,
# pool and time.
#
# Optimal control in its simplest form: commands at knots are the unknowns, the course follows from
# them, and its information has a slope with all of them at once. The search begins with drawn
# sines, flown so that they stay in the pool. Limits of thrust hold all along; slew, pool and tilt
# are penalties with a margin, dearer from round to round. What comes out is limited in thrust and
# slew exactly. Finer steps say where it leads: by how much they differ is added to the courses of
# the next round.


@dataclass(frozen=True, kw_only=True, slots=True)
class DesignSettings:
    """Settings of the search for commands."""

    step: float = 0.05
    """[s] of the simulation, for which a command is held."""
    knots: float = 0.2
    """[s] between the commands that are searched for."""
    starts: int = 3
    """Drawn in each size, of which the best is made better."""
    iterations: int = 200
    """In a round; leaving the pool costs little in the first and much in the last."""
    seed: int = 0


def design_experiment(
    task: ExperimentTask, rollout: Rollout, effort: DesignSettings | None = None
) -> Excitation:
    """Search for commands that determine what matters best:
    `uvms_ocp.identification.experiment_design.Excitation`.

    rollout: ``Rollout(stage_of(task.vehicle))``. Raises NameNotFound for a number that there is
    not.
    """
    search = _DesignSearch(task, rollout, effort or DesignSettings())
    knots = search.begun()
    for price in _PRICES:
        knots = search.lowered(knots, price)
    for price in _DEARER:
        if search.expected(knots).status is DesignStatus.INSIDE:
            break
        knots = search.lowered(knots, price)
    return search.expected(knots)


class _DesignSearch:
    """For knots (n_knots, n_u) [N, N m]."""

    def __init__(self, task: ExperimentTask, rollout: Rollout, effort: DesignSettings) -> None:
        self.given = task
        self.rollout = rollout
        self.effort = effort
        aim = task.aim()
        courses = experiment.TrajectorySimulator(rollout, task.unknowns, effort.step, task.still)
        history = experiment.KnotCommands(task.duration, effort.knots, effort.step, courses.delay)
        self.objective = Objective(
            aim, task.limits, history, courses, target_deviations(task, rollout)
        )

    def begun(self) -> np.ndarray:
        """Return the best of several sines that are made to stay in the pool."""
        task = self.given
        history = self.objective.history
        rng = np.random.default_rng(self.effort.seed)
        candidates = []
        for share in _START_AMPLITUDES * self.effort.starts:
            sines = experiment.multisine(
                rng, history.sent.shape[0], 6, task.duration * _START_FREQUENCY
            )
            exported = keep_inside_pool(task, self.rollout, share * sines, self.effort.step)
            candidates.append(np.clip(history.nearest(exported), *task.limits.thrust.T))
        return min(candidates, key=lambda knots: self.objective.value(knots, _PRICES[0])[0])

    def lowered(self, knots: np.ndarray, price: float) -> np.ndarray:
        """Search for better knots in one round, for a price of leaving the pool."""
        coarse = self.objective.courses.states(self.objective.history.acting @ knots)
        off = self.expected(knots).states[::FINER] - coarse
        return replace(self.objective, off=off).lowered(knots, price, self.effort.iterations)

    def expected(self, knots: np.ndarray) -> Excitation:
        """Predict the experiment of these knots, clipped to thrust and slew limits."""
        step = self.effort.step
        commands = self.given.limits.kept(self.objective.history.sent @ knots, step)
        return excitation_of(
            self.given, self.rollout, Channel(t=step * np.arange(len(commands)), values=commands)
        )
