"""Limits on positions hold whatever is asked for: the viability rule alone, in Case 1, and from
random starts.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace

import coal
import numpy as np
import pinocchio as pin
import pytest
from compiler import IN_C_AND_PYTHON, needs_compiler
from studies.random_limits import limit_violations, random_limits

from uvms_ocp.codegen.kernel_layout import assign, connect, doubles, structure_of
from uvms_ocp.codegen.kernels import bind_memory
from uvms_ocp.control.velocity.braking import (
    StopMemory,
    begin_stop,
    finite_acceleration,
    slow_down,
    step_stop,
    stop_functions,
)
from uvms_ocp.control.velocity.position_guards import (
    ViabilitySetup,
    models_of,
    position_guards,
    viability_functions,
    with_guards,
)
from uvms_ocp.control.velocity.viability import ViabilityMemory, enforce_viability, may_reach_limit
from uvms_ocp.robot.dimensions import dimensions_of
from uvms_ocp.robot.limits import PositionLimit
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.shapes.collision_model import CollisionModel, any_places, with_any_distances
from uvms_ocp.robot.shapes.obstacles import Obstacle
from uvms_ocp.scenario.cases.case1 import case1
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.tasks.altitude import MinimumAltitude
from uvms_ocp.tasks.clearance import Clearance
from uvms_ocp.tasks.hierarchy import Hierarchy

DT = 0.02


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("girona_maris7_full")


def ball(name: str, x: float, y: float, z: float, radius: float) -> Obstacle:
    return Obstacle(
        name=name, shape=coal.Sphere(radius), X_WO=pin.SE3(np.eye(3), np.array([x, y, z]))
    )


class Stop:
    """The way to rest, by the kernels."""

    def __init__(self, robot: Robot, dt: float) -> None:
        functions = stop_functions(robot, dt)
        self.way = structure_of(StopMemory, dimensions_of(robot), n_limits=1, **functions)()
        assign(self.way, dt=dt, acceleration=finite_acceleration(robot))
        connect(self.way)

    def slower(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        slowed = doubles(np.zeros(len(v)))
        slow_down(self.way, doubles(q), doubles(v), slowed)
        return np.array(slowed)

    def path(self, q: np.ndarray, v: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Configuration at the end of every tick and velocity during it, until rest."""
        begin_stop(self.way, doubles(q), doubles(v))
        while not self.way.done:
            step_stop(self.way)
            yield np.array(self.way.q), np.array(self.way.velocity)


class Viability:
    """The rule for a robot and the tasks of its hierarchy, by itself."""

    def __init__(
        self, *, robot: Robot, tasks: tuple, quantity_names: tuple[str, ...], dt: float
    ) -> None:
        guards = position_guards(robot, tasks, quantity_names)
        models = models_of(guards)
        dimensions = with_guards(dimensions_of(robot), robot, guards)
        self.memory = structure_of(
            ViabilityMemory,
            with_any_distances(dimensions, models, robot),
            places=any_places(models, robot),
            **viability_functions(robot, guards, dt),
        )()
        self.stop = Stop(robot, dt)
        self.near, self.enforce = bind_memory(self.memory, (may_reach_limit, enforce_viability))
        self.setup = ViabilitySetup(robot, guards, dt, self.memory)

    def kept(
        self,
        *,
        q: np.ndarray,
        previous: np.ndarray,
        desired: np.ndarray,
        gates: np.ndarray,
        quantities: np.ndarray,
    ) -> np.ndarray:
        """The velocity for this tick in place of the wanted one."""
        place, before, v, on, measured = map(doubles, (q, previous, desired, gates, quantities))
        self.is_near = bool(self.near(self.memory, v, on, measured))
        self.share = 1.0
        if self.is_near:
            self.share = self.enforce(self.memory, place, before, v, on, measured)
            self.setup.answer.check()
        return np.array(v)


class Guarded:
    """The rule with minimum altitude above a floor at z = -2 m, and clearance of two balls."""

    def __init__(self, robot: Robot) -> None:
        balls = [ball("stern", -1.6, 0.0, 0.2, 0.4), ball("side", 0.0, 1.2, 0.0, 0.3)]
        self.robot = robot
        self.clearance = Clearance(
            model=CollisionModel(robot, balls, self_collision=False), threshold=0.05
        )
        self.altitude = MinimumAltitude(threshold=1.0)
        self.altimeter = robot.frame_id("altimeter")
        self.rule = Viability(
            robot=robot,
            tasks=(self.altitude, self.clearance),
            quantity_names=("MAC.altitude", "CL.clearance"),
            dt=DT,
        )

    def quantities(self, q: np.ndarray) -> np.ndarray:
        data = self.robot.model.createData()
        pin.framesForwardKinematics(self.robot.model, data, q)
        return np.array(
            [data.oMf[self.altimeter].translation[2] + 2.0, self.clearance.model.values(q).min()]
        )

    def slack(self, q: np.ndarray) -> np.ndarray:
        return self.quantities(q) - [self.altitude.threshold, self.clearance.threshold]

    def kept(
        self, q: np.ndarray, previous: np.ndarray, desired: np.ndarray, gates: tuple[float, float]
    ) -> np.ndarray:
        quantities = self.quantities(q)
        return self.rule.kept(
            q=q, previous=previous, desired=desired, gates=np.array(gates), quantities=quantities
        )


def reckless(guarded: Guarded, seed: int) -> tuple[int, float]:
    """Ticks at which the rule stepped in, and the smallest slack [m], under full acceleration this
    way and that.
    """
    robot = guarded.robot
    rng = np.random.default_rng(seed)
    limits = robot.limits
    q = robot.configuration()
    v = np.zeros(robot.n_v)
    slowed = 0
    lowest = np.inf
    for index in range(250):
        if index % 50 == 0:
            push = rng.choice([-1.0, 1.0], robot.n_v)
        desired = np.clip(v + push * limits.acceleration * DT, -limits.velocity, limits.velocity)
        viable = guarded.kept(q, v, desired, (1.0, 1.0))
        assert (np.abs(viable - v) <= limits.acceleration * DT * (1 + 1e-9)).all()
        slowed += int((viable != desired).any())
        v = viable
        q = pin.integrate(robot.model, q, v * DT)
        lowest = min(lowest, float(guarded.slack(q).min()))
    return slowed, lowest


def test_reckless_wishes_break_no_limit(robot: Robot) -> None:
    """Without any task that would steer clear."""
    guarded = Guarded(robot)
    runs = [reckless(guarded, seed) for seed in range(8)]
    assert sum(slowed > 0 for slowed, _ in runs) >= 5
    assert min(lowest for _, lowest in runs) > -1e-6


@needs_compiler
def test_distances_that_kernels_measure_make_the_velocities_that_those_of_python_do(
    robot: Robot,
) -> None:
    """Kernels pass over what a bound tells to be clear, and Python is asked for every pair that
    counts.
    """
    kernels = Guarded(robot)
    python = Guarded(robot)
    n_calls = [0]
    model = python.clearance.model
    clearance = python.clearance.position_limit(robot)

    def values(q: np.ndarray, rows: np.ndarray | None) -> np.ndarray:
        n_calls[0] += 1
        return model.values(q, rows)

    limit = replace(clearance, values=values)
    task = SimpleNamespace(name="CL", position_limit=lambda robot: limit)
    python.rule = Viability(
        robot=robot,
        tasks=(python.altitude, task),
        quantity_names=("MAC.altitude", "CL.clearance"),
        dt=DT,
    )
    limits = robot.limits
    q = robot.configuration()
    v = np.zeros(robot.n_v)
    rng = np.random.default_rng(3)
    slowed = 0
    for index in range(400):
        if index % 50 == 0:
            push = rng.choice([-1.0, 1.0], robot.n_v)
        desired = np.clip(v + push * limits.acceleration * DT, -limits.velocity, limits.velocity)
        viable = [rule.kept(q, v, desired, (1.0, 1.0)) for rule in (kernels, python)]
        np.testing.assert_allclose(viable[0], viable[1], rtol=0, atol=1e-9)
        slowed += int((viable[0] != desired).any())
        v = viable[0]
        q = pin.integrate(robot.model, q, v * DT)
    assert slowed > 30
    assert n_calls[0] > 300


def straight(name: str, axis: int, upper: float, reach: float = 1.0) -> SimpleNamespace:
    """A stand-in for a task: the planar robot's coordinate `axis` stays at or below `upper`."""
    limit = PositionLimit(
        quantity="room",
        lower=0.0,
        values=lambda q, rows: np.array([upper - q[axis]]),
        reach=np.where(np.arange(5) == axis, reach, 0.0),
    )
    return SimpleNamespace(name=name, position_limit=lambda robot: limit)


def test_between_two_velocities_that_keep_a_limit_the_answer_keeps_it_too() -> None:
    """Of what is wanted, slow to stop, and of what there was, quick to stop, a mixture can go
    farther than both.
    """
    planar = load_robot("planar5")
    rng = np.random.default_rng(5)
    mixed = 0
    for _ in range(100):
        at_rest = np.zeros(5)
        previous = np.zeros(5)
        desired = np.zeros(5)
        previous[3] = rng.uniform(0.1, 0.5)
        desired[1] = rng.uniform(0.5, 1.0)
        upper = rng.uniform([0.05, 0.005], [0.4, 0.1])
        tasks = (straight("y", 1, upper[0]), straight("theta1", 3, upper[1]))
        rule = Viability(robot=planar, tasks=tasks, quantity_names=("y.room", "theta1.room"), dt=DT)
        end = np.array([q for q, _ in rule.stop.path(at_rest, rule.stop.slower(at_rest, previous))])
        if (end[:, [1, 3]] > upper).any():
            continue
        viable = rule.kept(
            q=at_rest, previous=previous, desired=desired, gates=np.ones(2), quantities=upper
        )
        way = np.array([q for q, _ in rule.stop.path(at_rest, viable)])
        assert (way[:, [1, 3]] <= upper + 1e-9).all(), (previous, desired, upper)
        mixed += int(0.0 < rule.share < 1.0)
    assert mixed > 16


def test_axes_that_bring_nothing_to_a_limit_go_on() -> None:
    """A vehicle stood still for minutes, as its arm shivered where it may go no farther."""
    planar = load_robot("planar5")
    at_rest = np.zeros(5)
    for speed, upper in ((0.02, 0.0), (0.3, 0.01), (0.3, 0.0)):
        rule = Viability(
            robot=planar,
            tasks=(straight("theta1", 3, upper),),
            quantity_names=("theta1.room",),
            dt=DT,
        )
        previous = np.array([0.5, 0.0, 0.0, speed, 0.0])
        desired = previous * 1.01
        viable = rule.kept(
            q=at_rest,
            previous=previous,
            desired=desired,
            gates=np.ones(1),
            quantities=np.array([upper]),
        )
        others = [0, 1, 2, 4]
        np.testing.assert_array_equal(viable[others], desired[others])
        assert viable[3] < previous[3]
        braked = np.array([q[3] for q, _ in rule.stop.path(at_rest, viable)])
        before = np.array(
            [q[3] for q, _ in rule.stop.path(at_rest, rule.stop.slower(at_rest, previous))]
        )
        assert braked.max(initial=0.0) <= max(upper, before.max(initial=0.0)) + 1e-12


@pytest.mark.parametrize("unknown", [np.inf, np.nan])
def test_a_reach_that_nobody_knows_guards_all_the_same(unknown: float) -> None:
    planar = load_robot("planar5")
    desired = np.zeros(5)
    upper = 0.05
    desired[1] = 1.0
    rule = Viability(
        robot=planar,
        tasks=(straight("y", 1, upper, reach=unknown),),
        quantity_names=("y.room",),
        dt=DT,
    )
    viable = rule.kept(
        q=np.zeros(5),
        previous=np.zeros(5),
        desired=desired,
        gates=np.ones(1),
        quantities=np.array([upper]),
    )
    assert rule.is_near
    assert max(q[1] for q, _ in rule.stop.path(np.zeros(5), viable)) <= upper


@pytest.mark.parametrize("compiled", IN_C_AND_PYTHON)
def test_what_a_limit_raises_is_raised_by_the_rule(
    compiled: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(q: np.ndarray, rows: np.ndarray | None) -> np.ndarray:
        raise ValueError("no such place")

    if not compiled:
        monkeypatch.setattr(f"{__name__}.bind_memory", lambda memory, kernels: kernels)
    planar = load_robot("planar5")
    limit = PositionLimit(quantity="room", lower=0.0, values=refuse, reach=np.ones(5))
    task = SimpleNamespace(name="y", position_limit=lambda robot: limit)
    rule = Viability(robot=planar, tasks=(task,), quantity_names=("y.room",), dt=DT)
    arguments = {
        "q": np.zeros(5),
        "previous": np.zeros(5),
        "desired": np.ones(5),
        "gates": np.ones(1),
    }
    assert rule.kept(**arguments, quantities=np.full(1, 1e3)).any()
    for _ in range(2):
        with pytest.raises(ValueError, match="no such place"):
            rule.kept(**arguments, quantities=np.zeros(1))


@pytest.mark.slow
@needs_compiler
def test_the_rule_without_compiler_gives_the_same_bits(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick = Guarded(robot)
    with monkeypatch.context() as without:
        without.setattr(f"{__name__}.bind_memory", lambda memory, kernels: kernels)
        slow = Guarded(robot)
    assert slow.rule.enforce is enforce_viability
    assert quick.rule.enforce is not enforce_viability
    rng = np.random.default_rng(0)
    q = robot.configuration(position=(-0.3, 0.0, 0.0))
    slowed = 0
    for _ in range(40):
        desired = rng.uniform(-1.0, 1.0, robot.n_v) * robot.limits.velocity
        previous = desired - rng.uniform(-1.0, 1.0, robot.n_v) * robot.limits.acceleration * DT
        first, second = (
            guarded.kept(q, previous, desired, (1.0, 1.0)) for guarded in (quick, slow)
        )
        np.testing.assert_array_equal(first, second)
        slowed += bool((first != desired).any())
    assert 0 < slowed < 40


def test_a_limit_that_is_off_or_far_away_changes_nothing(robot: Robot) -> None:
    guarded = Guarded(robot)
    q = robot.configuration()
    slow = np.zeros(robot.n_v)
    fast = np.zeros(robot.n_v)
    slow[0] = -0.02
    fast[0] = -1.0  # 1 m/s takes 0.5 m to stop, the ball astern leaves 0.35 m
    np.testing.assert_array_equal(guarded.kept(q, slow, slow, (1.0, 1.0)), slow)
    np.testing.assert_array_equal(guarded.kept(q, fast, fast, (1.0, 0.0)), fast)
    assert guarded.kept(q, fast, fast, (1.0, 1.0))[0] == pytest.approx(-1.0 + DT)


@pytest.mark.parametrize("gate", [1e-9, 0.3, 1.0])
def test_a_limit_counts_fully_while_its_task_is_on_at_all(robot: Robot, gate: float) -> None:
    guarded = Guarded(robot)
    q = robot.configuration()
    fast = np.zeros(robot.n_v)
    fast[0] = -1.0
    assert guarded.kept(q, fast, fast, (1.0, gate))[0] == pytest.approx(-1.0 + DT)


def test_a_limit_that_is_broken_already_is_never_broken_further_than_a_stop_does(
    robot: Robot,
) -> None:
    guarded = Guarded(robot)
    q = robot.configuration(position=(-0.45, 0.0, 0.0))
    away = np.zeros(robot.n_v)
    nearer = np.zeros(robot.n_v)
    away[0] = 0.01
    nearer[0] = -0.01
    at_rest = np.zeros(robot.n_v)
    assert guarded.slack(q)[1] < -0.01
    np.testing.assert_array_equal(guarded.kept(q, at_rest, away, (1.0, 1.0)), away)
    np.testing.assert_array_equal(guarded.kept(q, at_rest, nearer, (1.0, 1.0)), at_rest)


def test_a_stop_keeps_joint_limits_and_accelerations_and_the_direction_of_the_vehicle(
    robot: Robot,
) -> None:
    limits = robot.limits
    rng = np.random.default_rng(3)
    stop = Stop(robot, DT)
    for _ in range(20):
        v = rng.uniform(-1.0, 1.0, robot.n_v) * limits.velocity
        # As near to its limit as each joint may be at this speed.
        a = limits.acceleration[robot.joint_v]
        speed = v[robot.joint_v]
        way = np.abs(speed) * DT + speed**2 / (2.0 * a)
        joints = np.where(speed > 0, limits.position_upper - way, limits.position_lower + way)
        previous = v
        for q, velocity in stop.path(robot.configuration(joints=joints), v):
            assert (np.abs(velocity - previous) <= limits.acceleration * DT * (1 + 1e-9)).all()
            assert (q[robot.joint_q] <= limits.position_upper + 1e-9).all()
            assert (q[robot.joint_q] >= limits.position_lower - 1e-9).all()
            assert np.linalg.matrix_rank(np.vstack([velocity[:6], v[:6]]), tol=1e-9) <= 1
            previous = velocity
        assert np.abs(previous).max() <= limits.acceleration.max() * DT


@pytest.fixture(scope="module")
def case1_among_obstacles() -> Scenario:
    """A ball beside the way to the way point, another one above the target; clearance is off while
    landing.
    """
    scenario = case1(plant="kinematic", dt=1 / 100)
    obstacles = [ball("beside", 9.4, 37.4, -37.0, 0.4), ball("above", 12.3, 38.2, -39.3, 0.25)]
    robot = scenario.robot
    mission = scenario.mission
    tasks = [
        *mission.hierarchy.tasks,
        Clearance(model=CollisionModel(robot, obstacles, self_collision=False), threshold=0.05),
        Clearance(name="SC", model=CollisionModel(robot), threshold=0.02, margin=0.02),
    ]
    phases = tuple(
        replace(
            phase,
            activations={
                **phase.activations,
                "SC": 1.0,
                **({} if phase.name == "C" else {"CL": 1.0}),
            },
        )
        for phase in mission.phases
    )
    environment = replace(scenario.environment, obstacles=tuple(obstacles))
    return replace(
        scenario,
        mission=replace(mission, hierarchy=Hierarchy(tasks), phases=phases),
        environment=environment,
    )


@pytest.mark.slow
def test_case_1_among_obstacles_steps_within_the_accelerations_and_keeps_clear(
    case1_among_obstacles: Scenario,
) -> None:
    scenario = case1_among_obstacles
    limits = scenario.robot.limits
    record = scenario.run()
    assert record.meta.completed
    assert [event.target for event in record.meta.events] == ["B", "C", "D", "done"]
    steps = np.abs(np.diff(record["command"], axis=0, prepend=0.0)) / (
        limits.acceleration * scenario.dt
    )
    assert steps.max() <= 1.0 + 1e-6
    violations = limit_violations(scenario, record)
    assert violations["CL_m"] <= 1e-6
    assert violations["SC_m"] <= 1e-6
    assert violations["joints_rad"] <= 1e-6
    distances = record["quantities"][:, record.meta.quantities.index("CL.clearance")]
    assert distances.min() < 0.1  # the obstacles are in the way


@pytest.mark.slow
def test_from_random_starts_towards_random_goals_every_limit_holds() -> None:
    """The quick run at 50 Hz takes 12 of the thousand of `benchmarks/viability.py`."""
    (total,) = random_limits(n=12, dt=DT).run().table
    assert total["runs"] == 12
    assert total["violated"] == 0, total
    assert total["largest_step"] <= 1.0 + 1e-6
    assert total["mean_path_m"] > 2.0
