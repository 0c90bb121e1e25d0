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

from uvms_ocp.checks import checked, checked_dataclass
from uvms_ocp.errors import AdvisedStatus, InvalidInput, NameNotFound
from uvms_ocp.identification.estimates import Noise
from uvms_ocp.identification.experiment_limits import ExperimentLimits
from uvms_ocp.identification.identified_numbers import (
    DETERMINED_BELOW,
    IdentifiedNumber,
    numbers_at,
    slopes_of,
)
from uvms_ocp.identification.information_criterion import InformationCriterion
from uvms_ocp.identification.knot_commands import (
    KnotCommands,
    edges_of,
    multisine,
)
from uvms_ocp.identification.model import N_Q, N_V, Vehicle
from uvms_ocp.identification.motions_by_hand import BY_HAND
from uvms_ocp.identification.recording import Channel
from uvms_ocp.identification.resampling import ZeroOrderHold
from uvms_ocp.identification.rollout import Rollout
from uvms_ocp.identification.trajectory_simulator import TrajectorySimulator
from uvms_ocp.robot.spatial import quaternion_to_matrix
from uvms_ocp.types import Positive, Range

STEP = 0.05
"""[s] for which a command is held."""
FINER = 5
"""Number of steps of the final simulation in a step of the search."""
HALF = 0.5
"""Target of a standard error, as a share of the smallest one by hand."""
# Durations of recordings: maps from knots to commands grow with the square.
_SHORTEST = 1.0  # [s]
_LONGEST = 1800.0  # [s]
# The search.
_PRICES = (100.0, 300.0, 1000.0, 1000.0)  # prices of leaving the pool, round by round
_DEARER = (3000.0, 10000.0, 30000.0)  # price where the finer steps still lead outside
_START_FREQUENCY = 0.2  # [Hz] frequency of the sines with which the search begins
_START_AMPLITUDES = (1.0, 2.0, 4.0)  # shares of what each axis can get alone, of these sines
# Motions by hand.
_AHEAD = 1.0  # [s] by which the spring that keeps the vehicle in the pool looks ahead
_AMPLITUDES = np.linspace(1.0, 0.05, 20)  # shares of the largest thrust, tried in this order


@checked
def design_experiment(
    task: ExperimentTask, rollout: Rollout, effort: DesignSettings | None = None
) -> Excitation:
    """Search for commands that determine the numbers that matter best.

    rollout: ``Rollout(stage_of(task.vehicle))``. Raises NameNotFound for a number that there is
    not.
    """
    search = _DesignSearch(task, rollout, effort or DesignSettings())
    knots = search.start()
    for price in _PRICES:
        knots = search.lowered(knots, price)
    for price in _DEARER:
        if search.expected(knots).status is DesignStatus.INSIDE:
            break
        knots = search.lowered(knots, price)
    return search.expected(knots)


@checked_dataclass(eq=False)
class ExperimentTask:
    """Experiment to be designed: its vehicle, limits, sensors, and the numbers that are to be known
    well.

    Raises InvalidInput for limits of other actuators, and too little time or too much.
    """

    vehicle: Vehicle
    """Vehicle with its unknowns at their prior values."""
    limits: ExperimentLimits
    """Limits of commands and motion."""
    duration: Annotated[float, Range(_SHORTEST, _LONGEST)] = 60.0
    """[s] duration of a recording."""
    matter: tuple[str, ...] = ()
    """Names of numbers, or of quantities, that are to be known well; empty for all."""
    noise: Noise = field(default_factory=Noise)
    """Noise of the sensors."""
    rate: Positive = 10.0
    """[Hz] rate of the sensors."""
    prior_information: np.ndarray | None = None
    """(n_p, n_p) [1 / unknowns^2] information of recordings that there are."""
    joints: tuple[float, ...] = ()
    """(n_j,) [rad or m] positions of the arm's joints, which are held; 0 by default."""

    def __post_init__(self) -> None:
        n_u = len(self.vehicle.actuators.names)
        if len(self.limits.thrust) != n_u:
            raise InvalidInput(
                f"thrust of {len(self.limits.thrust)} actuators given; allowed: {n_u}"
            )

    @property
    def unknowns(self) -> np.ndarray:
        """(n_p,) [as `Unknowns.start`] prior values of the unknowns: shared ones, then those of the
        recording.
        """
        return np.concatenate([self.vehicle.shared.start, self.vehicle.per_recording.start])

    @property
    def still(self) -> np.ndarray:
        """(3 n_j,) [rad or m, and rates] positions, velocities and accelerations of the arm at rest."""
        n_j = self.vehicle.dynamics.model.nv - N_V
        positions = self.joints or np.zeros(n_j)
        return np.concatenate([positions, np.zeros(2 * n_j)])

    def aim(self) -> InformationCriterion:
        """Build the criterion. Raises NameNotFound for a number that does not depend on the
        unknowns.
        """
        names, slopes = slopes_of(self.vehicle, self.vehicle.shared.start)
        by_shared = slopes[_places_of(self.matter, names)]
        by_recording = np.zeros((len(by_shared), len(self.vehicle.per_recording.start)))
        priors = np.concatenate([self.vehicle.shared.sigma, self.vehicle.per_recording.sigma])
        information = np.diag(1.0 / priors**2)
        if self.prior_information is not None:
            information = self.prior_information + information
        return InformationCriterion(
            slopes=np.hstack([by_shared, by_recording]),
            prior_information=information,
            noise=self.noise,
            rate=self.rate,
        )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Excitation:
    """Commands, and the numbers that they are expected to determine."""

    commands: Channel
    """(n, n_u) [N, N m] commands of the actuators, held for a step each; they begin with 0."""
    states: np.ndarray
    """(k, n_x) [as `StageFunctions`] states to which the commands lead from rest, in the finer steps
    of the last simulation.
    """
    swept: np.ndarray
    """(2, 3) [m] lowest and highest corner of a box in W that the hull sweeps, from where the
    vehicle's origin begins.
    """
    numbers: tuple[IdentifiedNumber, ...]
    """Expected numbers after one recording, if the vehicle is as the priors have it."""
    information: np.ndarray
    """(n_p, n_p) [1 / unknowns^2] information of one recording, without priors."""
    status: DesignStatus
    """Outcome of the design."""


class DesignStatus(AdvisedStatus):
    """Outcome of a design."""

    INSIDE = "inside the pool", "See how far vehicles with other numbers go before it drives one."
    OUTSIDE = (
        "leaves the pool or tilts too far",
        "Give a larger pool, less thrust or less time, or allow more iterations.",
    )


@dataclass(frozen=True, kw_only=True, slots=True)
class DesignSettings:
    """Settings of the search for commands."""

    step: float = 0.05
    """[s] step of the simulation, for which a command is held."""
    knots: float = 0.2
    """[s] interval between the knots of the commands that are searched for."""
    starts: int = 3
    """Number of sines drawn in each size; the search begins at the best of all."""
    iterations: int = 200
    """Iterations in a round; leaving the pool costs little in the first and much in the last."""
    seed: int = 0
    """Seed of the drawn sines."""


def excitation_of(task: ExperimentTask, rollout: Rollout, commands: Channel) -> Excitation:
    """Predict the motion and the numbers that commands, held for equal steps, would determine."""
    step = float(commands.t[1] - commands.t[0])
    simulator = TrajectorySimulator(rollout, task.unknowns, step, task.still)
    held = ZeroOrderHold(commands)
    edges = commands.t[0] + edges_of(len(commands.t), step, simulator.delay)
    trajectory = simulator.of(held.mean(edges), -held.mean_slope(edges))
    aim = task.aim()
    information = aim.information(trajectory, step)
    shared = task.vehicle.shared.start
    n = len(shared)
    covariance = aim.covariance(information)[:n, :n]
    states = simulate_commands(task, rollout, commands, task.unknowns)
    excess, _ = task.limits.beyond(states, margin=0.0)
    return Excitation(
        commands=commands,
        states=states,
        swept=task.limits.swept(states),
        numbers=numbers_at(task.vehicle, shared, covariance),
        information=information,
        status=DesignStatus.OUTSIDE if excess.any() else DesignStatus.INSIDE,
    )


def _places_of(matter: Sequence[str], names: Sequence[tuple[str, str]]) -> list[int]:
    """List the indices of the numbers that matter in names, pairs of quantity and number; of all where
    none is named.
    """
    if not matter:
        return list(range(len(names)))
    for label in matter:
        if not any(label in pair for pair in names):
            raise NameNotFound("number", label, [number for _, number in names])
    return [k for k, pair in enumerate(names) if not set(pair).isdisjoint(matter)]


def simulate_commands(
    task: ExperimentTask, rollout: Rollout, commands: Channel, p: np.ndarray
) -> np.ndarray:
    """Simulate states (k, n_x) [as `StageFunctions`] to which commands lead a vehicle with unknowns
    p (n_p,) [as `Unknowns.start`].
    """
    step = float(commands.t[1] - commands.t[0]) / FINER
    simulator = TrajectorySimulator(rollout, p, step, task.still)
    edges = commands.t[0] + edges_of(FINER * len(commands.t), step, simulator.delay)
    return simulator.states(ZeroOrderHold(commands).mean(edges))


def keep_inside_pool(
    task: ExperimentTask, rollout: Rollout, shares: np.ndarray, step: float
) -> np.ndarray:
    """Make commands (n, n_u) [N, N m] within thrust and slew from shares (n, 6) [-] of the largest
    force or torque along each axis alone, held for a step [s].

    Where they lead out of the pool a spring at the actuators pulls back; at a wall it balances all
    that an axis can get. The vehicle is as it is believed to be.
    """
    p = task.unknowns
    joints = task.still
    allocation = np.linalg.pinv(task.vehicle.actuators.wrench)
    largest_thrust = np.abs(task.limits.thrust).min(axis=1)
    thrust_shares = np.abs(allocation) / largest_thrust[:, None]
    largest_wrench = 1.0 / thrust_shares.max(axis=0).clip(1e-9)
    reach = np.concatenate([task.limits.room, [task.limits.tilt, task.limits.tilt, np.inf]])
    stiffness = largest_wrench / reach
    x = np.zeros(rollout.stage.n_x)
    x[N_Q - 1] = 1.0
    command = np.zeros(len(allocation))
    commands = []
    for share in shares:
        # (6,) [m, rad] from where it began and from upright, in B; yaw is free.
        R = np.array(quaternion_to_matrix(x[3:N_Q]))
        away = np.concatenate([R.T @ x[:3], [R[2, 1], -R[2, 0], 0.0]])
        back = stiffness * (away + _AHEAD * x[N_Q : N_Q + N_V])
        command = task.limits.after(command, allocation @ (share * largest_wrench - back), step)
        commands.append(command)
        x = np.asarray(rollout.step(x, command, joints, p, step)).ravel()
    return np.array(commands)


def largest(task: ExperimentTask, rollout: Rollout, name: str, seed: int = 0) -> Excitation:
    """Predict the motion of a name in `BY_HAND`, as large as the limits allow."""
    t = STEP * np.arange(round(task.duration / STEP))
    motion = BY_HAND[name](t, np.random.default_rng(seed))
    for share in _AMPLITUDES:
        commands = keep_inside_pool(task, rollout, share * motion, STEP)
        excitation = excitation_of(task, rollout, Channel(t=t, values=commands))
        if excitation.status is DesignStatus.INSIDE:
            break
    return excitation


def target_deviations(task: ExperimentTask, rollout: Rollout) -> np.ndarray:
    """Compute target standard errors (m,) [units of numbers] of the numbers that matter: half of
    those by hand, and small enough for a number to be determined.

    Recordings can only add to what is believed: it is their own information that is to be more.
    Where those by hand say less than that, belief is left to stand. Raises NameNotFound for a
    number that there is not.
    """
    aim = task.aim()
    names, _ = slopes_of(task.vehicle, task.vehicle.shared.start)
    chosen = _places_of(task.matter, names)
    smallest = np.full(len(chosen), np.inf)
    is_learnt = np.zeros(len(chosen), dtype=bool)
    for motion in BY_HAND:
        all_numbers = largest(task, rollout, motion).numbers
        numbers = [all_numbers[k] for k in chosen]
        smallest = np.minimum(smallest, [number.sigma for number in numbers])
        is_learnt |= [number.informed for number in numbers]
    sizes = np.array([number.size or np.inf for number in numbers])
    believed = 1.0 / aim.deviations(np.zeros_like(aim.prior_information)) ** 2
    by_hand = np.where(is_learnt, 1.0 / smallest**2 - believed, 0.0)
    determined = 1.0 / (DETERMINED_BELOW * sizes) ** 2
    information = believed + np.maximum(by_hand / HALF**2, determined)
    return np.asarray(information**-0.5)


@dataclass(frozen=True, slots=True, eq=False)
class Objective:
    """Objective of the design, a function of knots (n_knots, n_u) [N, N m]: the criterion of
    information, and penalties for leaving the pool and for slew beyond its limit.
    """

    aim: InformationCriterion
    """Figure of merit of the information: how much of the parameters is left unknown."""
    limits: ExperimentLimits
    """Limits that penalties keep: slew, pool and tilt."""
    history: KnotCommands
    """Maps from knots to commands."""
    simulator: TrajectorySimulator
    """Simulator of the vehicle from rest."""
    targets: np.ndarray
    """(m,) [units of numbers] standard errors to be reached, which the aim compares with."""
    step_error: np.ndarray = field(default_factory=lambda: np.zeros(1))
    """(n + 1, n_x) [as `StageFunctions`] states in finer steps less the simulated ones; (1,) zero
    before these are known.
    """

    def value(self, knots: np.ndarray, price: float) -> tuple[float, np.ndarray]:
        """Compute the objective at knots (n_knots, n_u) [N, N m], with its slope [1/N, 1/(N m)];
        price: of leaving the pool.
        """
        history = self.history
        trajectory = self.simulator.of(history.acting @ knots, history.late @ knots)
        figure, M = self.aim.figure(trajectory, self.simulator.h, self.targets)
        excess, slope = self.limits.beyond(trajectory.x + self.step_error)
        share = 2.0 * price / len(trajectory.x)
        by_pose = share * np.einsum("ki,kij->kj", excess, slope)
        n_without_pose = trajectory.x.shape[1] - slope.shape[2]
        by_x = np.pad(by_pose, ((0, 0), (0, n_without_pose)))
        by_u, by_late = self.simulator.criterion_gradient(trajectory, M, by_x)
        hurry, by_sent = self._hurry(history.sent @ knots, price)
        gradient = history.acting.T @ by_u + history.late.T @ by_late + history.sent.T @ by_sent
        return figure + share * float((excess**2).sum()) / 2.0 + hurry, gradient

    def lowered(self, knots: np.ndarray, price: float, iterations: int) -> np.ndarray:
        """Search for better knots (n_knots, n_u) [N, N m], by a quasi-Newton method within the
        limits of thrust; price: of leaving the pool.
        """
        from scipy.optimize import minimize  # half a second, which few need

        size = np.abs(self.limits.thrust).max(axis=1)

        def scaled_value(scaled: np.ndarray) -> tuple[float, np.ndarray]:
            value, slope = self.value(scaled.reshape(knots.shape) * size, price)
            return value, (slope * size).ravel()

        solution = minimize(
            scaled_value,
            (knots / size).ravel(),
            jac=True,
            method="L-BFGS-B",
            bounds=np.tile(self.limits.thrust / size[:, None], (len(knots), 1)),
            options={"maxiter": iterations, "maxcor": 30},
        )
        return np.asarray(solution.x.reshape(knots.shape) * size)

    def _hurry(self, commands: np.ndarray, price: float) -> tuple[float, np.ndarray]:
        """Compute the penalty of steps beyond the slew limit, with its slope (n, n_u) [1/N,
        1/(N m)].
        """
        slope = np.zeros_like(commands)
        largest_change = self.limits.slew * self.simulator.h
        if not np.isfinite(largest_change):
            return 0.0, slope
        change = np.diff(commands, axis=0)
        excess = np.sign(change) * np.maximum(np.abs(change) / largest_change - 1.0, 0.0)
        by_change = 2.0 * price / len(commands) * excess / largest_change
        slope[1:] += by_change
        slope[:-1] -= by_change
        return price / len(commands) * float((excess**2).sum()), slope


class _DesignSearch:
    """Search for knots (n_knots, n_u) [N, N m]."""

    def __init__(self, task: ExperimentTask, rollout: Rollout, effort: DesignSettings) -> None:
        self.task = task
        self.rollout = rollout
        self.effort = effort
        simulator = TrajectorySimulator(rollout, task.unknowns, effort.step, task.still)
        history = KnotCommands(task.duration, effort.knots, effort.step, simulator.delay)
        self.objective = Objective(
            aim=task.aim(),
            limits=task.limits,
            history=history,
            simulator=simulator,
            targets=target_deviations(task, rollout),
        )

    def start(self) -> np.ndarray:
        """Return the best of several sines that are made to stay in the pool."""
        task = self.task
        history = self.objective.history
        rng = np.random.default_rng(self.effort.seed)
        candidates = []
        for share in _START_AMPLITUDES * self.effort.starts:
            sines = multisine(rng, history.sent.shape[0], 6, task.duration * _START_FREQUENCY)
            commands = keep_inside_pool(task, self.rollout, share * sines, self.effort.step)
            candidates.append(np.clip(history.nearest(commands), *task.limits.thrust.T))
        return min(candidates, key=lambda knots: self.objective.value(knots, _PRICES[0])[0])

    def lowered(self, knots: np.ndarray, price: float) -> np.ndarray:
        """Search for better knots in one round, for a price of leaving the pool."""
        coarse = self.objective.simulator.states(self.objective.history.acting @ knots)
        fine = self.expected(knots).states[::FINER]
        objective = replace(self.objective, step_error=fine - coarse)
        return objective.lowered(knots, price, self.effort.iterations)

    def expected(self, knots: np.ndarray) -> Excitation:
        """Predict the experiment of these knots, clipped to thrust and slew limits."""
        step = self.effort.step
        sent = self.task.limits.kept(self.objective.history.sent @ knots, step)
        commands = Channel(t=step * np.arange(len(sent)), values=sent)
        return excitation_of(self.task, self.rollout, commands)
