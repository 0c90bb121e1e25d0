"""Laws of one tick of Case 1 that hold at every state: limits, braking, strict priority."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
import pytest
from recording_solver import RecordingSolver

from uvms_ocp.control.velocity.swing import N_PASSIVE
from uvms_ocp.scenario.cases.case1 import case1
from uvms_ocp.scenario.scenario import Scenario, pose_at
from uvms_ocp.solvers.hierarchy.certificate import certificate
from uvms_ocp.solvers.hierarchy.level import Level, row_slices
from uvms_ocp.solvers.hierarchy.solution import Tick, TickResult

STARTS = 100
TICKS = 150


@dataclass(frozen=True)
class Machine:
    scenario: Scenario
    tick: Tick
    names: tuple[str, ...]
    sizes: tuple[int, ...]

    @property
    def n_v(self) -> int:
        return self.scenario.robot.n_v

    def random_state(self, rng: np.random.Generator) -> np.ndarray:
        limits = self.scenario.robot.limits
        low = np.maximum(limits.position_lower, -3.0)
        high = np.minimum(limits.position_upper, 3.0)
        share = np.clip(rng.uniform(-0.2, 1.2, len(low)), 0.0, 1.0)
        return self.scenario.robot.configuration(
            position=rng.uniform([8.0, 36.0, -39.0], [13.0, 39.0, -36.0]),
            rpy=rng.uniform([-0.3, -0.3, -3.0], [0.3, 0.3, 3.0]),
            joints=low + share * (high - low),
        )

    def step(
        self,
        q: np.ndarray,
        v: np.ndarray,
        gates: np.ndarray,
        goals: np.ndarray,
        change: np.ndarray | None = None,
    ) -> TickResult:
        change = np.zeros(self.n_v) if change is None else change
        return self.tick(
            q, v, np.zeros(N_PASSIVE), v, change, [max(q[2] + 40.0, 0.01)], goals, gates
        )


@pytest.fixture(scope="module")
def machine() -> Machine:
    scenario = case1(plant="kinematic")
    problem = scenario.kinematic_controller().problem
    return Machine(
        scenario,
        scenario.solver.bind(problem.function, problem.sizes),
        problem.names,
        problem.sizes,
    )


def _goals(machine: Machine, rng: np.random.Generator) -> np.ndarray:
    """Parameters of all tasks, with the tool asked for anywhere."""
    tool = pose_at(
        tuple(rng.uniform([8.0, 36.0, -41.0], [13.0, 39.0, -36.0])),
        tuple(rng.uniform(-3.0, 3.0, 3)),
    )
    tasks = machine.scenario.mission.hierarchy.tasks
    moved = [task.with_goal(tool) if task.name == "T" else task for task in tasks]
    return np.concatenate([task.reference(0.0) for task in moved])


def _gates(machine: Machine, rng: np.random.Generator) -> np.ndarray:
    phases = machine.scenario.mission.phases
    tasks = machine.scenario.mission.hierarchy.tasks
    phase = phases[rng.integers(len(phases))]
    return np.array([phase.activations.get(task.name, 0.0) for task in tasks])


@pytest.mark.slow
def test_from_any_start_the_limits_hold_and_the_command_never_steps_by_more_than_the_acceleration(
    machine: Machine,
) -> None:
    robot = machine.scenario.robot
    dt = machine.scenario.dt
    limits = robot.limits
    for seed in range(STARTS):
        rng = np.random.default_rng(seed)
        q = machine.random_state(rng)
        v = np.zeros(machine.n_v)
        goals = _goals(machine, rng)
        change = np.zeros(machine.n_v)
        for index in range(TICKS):
            if index % 50 == 0:
                on = _gates(machine, rng)
                gates = on * rng.choice([1.0, rng.random(), 1e-9], len(on))
            result = machine.step(q, v, gates, goals, change)
            assert result.status.exact, (seed, index)
            assert (np.abs(result.v - v) <= limits.acceleration * dt * (1 + 1e-9) + 1e-12).all(), (
                seed,
                index,
            )
            assert (np.abs(result.v) <= limits.velocity * (1 + 1e-9)).all()
            change = result.v - v
            v = result.v
            q = pin.integrate(robot.model, q, v * dt)
            joints = q[robot.joint_q]
            assert (joints >= limits.position_lower - 1e-6).all(), (seed, index)
            assert (joints <= limits.position_upper + 1e-6).all(), (seed, index)


def test_the_first_ticks_of_every_phase_are_certified_optimal(machine: Machine) -> None:
    recording = RecordingSolver(solver=machine.scenario.solver)
    replace(machine.scenario, solver=recording).run()
    function = machine.scenario.kinematic_controller().problem.function
    for recorded in recording.ticks:
        J, lower, upper, _, _, gate = (np.array(x) for x in function(*recorded.inputs)[:6])
        rows = (lower.ravel(), upper.ravel(), gate.ravel())
        levels = [
            Level(jacobian=J[r], lower=rows[0][r], upper=rows[1][r], gate=rows[2][r])
            for r in row_slices(machine.sizes)
        ]
        assert certificate(levels, recorded.v) < 1e-9


def test_the_smallest_gate_gives_the_velocity_of_a_gate_of_0(machine: Machine) -> None:
    rng = np.random.default_rng(0)
    tasks = machine.scenario.mission.hierarchy.tasks
    for index in range(8 * len(tasks)):
        q = np.array(machine.random_state(rng))
        v = rng.uniform(-0.05, 0.05, machine.n_v)
        goals = _goals(machine, rng)
        gates = (rng.random(len(tasks)) < 0.7).astype(float)
        velocities = []
        for gate in (0.0, 1e-9, 0.1):
            gates[index % len(tasks)] = gate
            velocities.append(machine.step(q, v, gates, goals).v)
        np.testing.assert_allclose(velocities[1], velocities[0], rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(velocities[2], velocities[0], rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("turned", [task.name for task in case1().mission.hierarchy.tasks])
def test_turning_a_lower_task_on_or_off_leaves_every_higher_level_as_it_was(
    machine: Machine, turned: str
) -> None:
    index = machine.scenario.mission.hierarchy.index(turned)
    rng = np.random.default_rng(index)
    n_tasks = len(machine.scenario.mission.hierarchy.tasks)
    higher = slice(0, sum(machine.sizes[: machine.names.index(turned)]))
    moved = 0
    for _ in range(40):
        q = np.array(machine.random_state(rng))
        v = rng.uniform(-0.05, 0.05, machine.n_v)
        goals = _goals(machine, rng)
        q[2] -= rng.uniform(0.0, 1.0)  # down to where the minimum altitude matters
        gates = (rng.random(n_tasks) < 0.7).astype(float)
        results = []
        for gate in (0.0, 1.0):
            gates[index] = gate
            results.append(machine.step(q, v, gates, goals))
        assert all(result.status.exact for result in results)
        np.testing.assert_allclose(
            results[0].residual[higher], results[1].residual[higher], rtol=0.0, atol=1e-8
        )
        moved += int(np.abs(results[0].v - results[1].v).max() > 1e-6)
    assert moved > 0  # the task matters at some of these states
