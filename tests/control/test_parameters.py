"""Parameters of tasks at one tick: references, and distances measured on the way to rest."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import casadi as ca
import coal
import numpy as np
import pinocchio as pin
import pytest
from compiler import needs_compiler

import uvms_ocp as uo
from uvms_ocp.codegen.kernel_layout import doubles, structure_of
from uvms_ocp.codegen.kernels import bind_memory
from uvms_ocp.control.velocity.distances import NearestMemory, measure_pairs, place_along_stop
from uvms_ocp.control.velocity.goals import (
    DistanceProvider,
    StoppingMotion,
    load_goals,
    measured_distances,
    mission_parameters,
    motion_function,
    with_nearest,
)
from uvms_ocp.control.velocity.kinematic import KinematicController
from uvms_ocp.errors import InvalidInput
from uvms_ocp.mission.progress import write_state
from uvms_ocp.robot.dimensions import dimensions_of
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.shapes.collision_model import CollisionModel, any_places, with_any_distances
from uvms_ocp.robot.shapes.obstacles import Obstacle, mesh_shape
from uvms_ocp.robot.signals import StateEstimate
from uvms_ocp.tasks.clearance import Clearance
from uvms_ocp.tasks.hierarchy import Hierarchy
from uvms_ocp.tasks.joints import JointTracking
from uvms_ocp.tasks.nearest_pairs import FAR, NearestPairs
from uvms_ocp.tasks.task import Rows, Task, TaskClass, TickSymbols, equality_rows
from uvms_ocp.trajectories.polynomial import PiecewisePolynomial

DT = 0.005
ROUNDING = 1e-8  # [m] coal begins a search where its last one ended


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("girona_maris7_full")


def ball(x: float, y: float, z: float, radius: float = 0.3) -> Obstacle:
    return Obstacle(
        name="ball", shape=coal.Sphere(radius), X_WO=pin.SE3(np.eye(3), np.array([x, y, z]))
    )


def mesh(x: float, y: float, z: float) -> Obstacle:
    corners = np.vstack([np.zeros(3), 0.3 * np.eye(3)])
    faces = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
    return Obstacle(
        name="rubble",
        shape=mesh_shape(corners, np.array(faces)),
        X_WO=pin.SE3(np.eye(3), np.array([x, y, z])),
    )


def split(
    pairs: NearestPairs, values: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray, np.ndarray]:
    """Split values of parameters into smallest distance, distances (m,), speeds (m,) and gradients (m,
    n_v), by the symbols of a task's rows.
    """
    p = ca.SX.sym("p", len(values))
    symbols = pairs.symbols(p)
    function = ca.Function(
        "split", [p], [symbols.smallest, symbols.distance, symbols.closing, symbols.jacobian]
    )
    smallest, distance, closing, gradient = (np.array(value) for value in function(values))
    return smallest.item(), distance.ravel(), closing.ravel(), gradient


def way_of(motion: StoppingMotion, q: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return the quarters of the proportional stop by Pinocchio: durations (4,) [s] at the present
    velocity, and the configurations to which they lead.
    """
    stop_time = (np.abs(motion.v) / motion.robot.limits.acceleration).max()
    durations = 0.5 * stop_time * np.array([0.25, 0.5, 0.75, 1.0])
    places = [pin.integrate(motion.robot.model, q, motion.v * duration) for duration in durations]
    return durations, places


def random_motion(robot: Robot, rng: np.random.Generator) -> tuple[np.ndarray, StoppingMotion]:
    q = robot.configuration(position=rng.uniform(-0.5, 0.5, 3), rpy=rng.uniform(-0.3, 0.3, 3))
    return q, StoppingMotion(
        robot=robot, v=rng.uniform(-0.5, 0.5, robot.n_v) * robot.limits.velocity, dt=DT
    )


def test_the_nearest_pairs_come_first(robot: Robot) -> None:
    model = CollisionModel(robot, [ball(2.0, 0.5, 0.0)])
    q = robot.configuration()
    pairs = Clearance(model=model, n_nearest=5).nearest_pairs
    smallest, distance, closing, gradient = split(pairs, measured_distances(pairs, q))
    order = np.argsort(model.values(q))[:5]
    assert smallest == pytest.approx(model.values(q).min(), abs=ROUNDING)
    np.testing.assert_allclose(distance, model.values(q)[order], rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(gradient, model.distances(q, order).gradient, rtol=0, atol=1e-4)
    np.testing.assert_array_equal(closing, FAR)


def test_of_all_pairs_those_are_measured_that_come_nearest_at_any_place_of_the_stop(
    robot: Robot,
) -> None:
    """Against all pairs at all places, which the search for the nearest leaves out where it can."""
    model = CollisionModel(robot, [ball(1.6, 0.4, -0.3), ball(-1.8, 0.0, 0.4)])
    rng = np.random.default_rng(6)
    pairs = NearestPairs(task="CL", model=model, n=6, threshold=0.05)
    moved = 0
    for _ in range(20):
        q, motion = random_motion(robot, rng)
        smallest, distance, closing, gradient = split(pairs, measured_distances(pairs, q, motion))
        places = (q, *way_of(motion, q)[1])
        everywhere = np.array([model.values(place) for place in places])
        order = np.argsort(everywhere.min(axis=0))[:6]
        worst = everywhere[:, order].argmin(axis=0)
        assert smallest == pytest.approx(everywhere[0].min(), abs=ROUNDING)
        np.testing.assert_allclose(distance, everywhere.min(axis=0)[order], rtol=0, atol=ROUNDING)
        for row, (pair, place) in enumerate(zip(order, worst, strict=True)):
            expected = model.distances(places[place], [pair]).gradient[0]
            np.testing.assert_allclose(gradient[row], expected, rtol=0, atol=1e-4)
            assert (closing[row] == FAR) == (place == 0)
        moved += int((worst > 0).sum())
    assert moved > 20


def test_a_row_counts_the_smallest_distance_on_the_way_to_rest(robot: Robot) -> None:
    """A corner of the hull swings towards a ball on a curve."""
    model = CollisionModel(
        robot, [ball(0.9, 0.9, 0.0)], self_collision=False, links=["base_link_0"]
    )
    pairs = Clearance(model=model, threshold=0.05).nearest_pairs
    q = robot.configuration()
    v = np.zeros(robot.n_v)
    v[5] = 0.5
    stop = StoppingMotion(robot=robot, v=v, dt=DT)
    ahead = StoppingMotion(robot=robot, v=1.02 * v, dt=DT)
    longest = way_of(stop, q)[0][-1]
    swept = [
        model.values(pin.integrate(robot.model, q, v * t))[0] for t in np.linspace(0.0, 0.25, 51)
    ]
    smallest, (nearest,), (fastest,), (gradient,) = split(pairs, measured_distances(pairs, q, stop))
    assert smallest == pytest.approx(swept[0])
    assert nearest == pytest.approx(min(swept), abs=1e-3)
    assert nearest < smallest - 0.01
    # The stop from a slightly faster turn ends nearer by what the row's gradient and speed say.
    change = split(pairs, measured_distances(pairs, q, ahead))[1][0] - nearest
    assert change == pytest.approx(2.0 * longest * gradient @ (0.02 * v), rel=0.05)
    assert fastest == pytest.approx((nearest - 0.05) / (2.0 * longest) - gradient @ v, rel=1e-6)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class StandOff(Task):
    """A task of one's own on distances: a goal beside what is measured."""

    needs: ClassVar[int] = 1
    name: str = "SO"
    task_class: TaskClass = TaskClass.ACTION
    model: CollisionModel
    goal: float

    @property
    def nearest_pairs(self) -> NearestPairs:
        return NearestPairs(task=self.name, model=self.model, n=self.needs, threshold=0.05)

    def n_parameters(self, robot: Robot) -> int:
        return 1 + self.nearest_pairs.n_parameters

    def reference(self, t: float) -> np.ndarray:
        return np.concatenate([[self.goal], self.nearest_pairs.far_away()])

    def rows(self, symbols: TickSymbols, parameters: ca.SX) -> Rows:
        pairs = self.nearest_pairs.symbols(parameters)
        error = parameters[0] - pairs.distance
        return equality_rows(
            pairs.jacobian, 0.5 * error, {"error": ca.fabs(error[0]), "distance": pairs.smallest}
        )


def standing_off(
    robot: Robot, goal: float, gate: float = 1.0, by: Obstacle | None = None
) -> uo.Mission:
    model = CollisionModel(
        robot, [by or ball(2.0, 0.0, 0.0)], self_collision=False, links=["base_link_0"]
    )
    reached = uo.Transition(to=uo.DONE, when=(uo.Below(quantity="SO.error", limit=1e-3),))
    phase = uo.Phase(
        name="go", activations={"SO": gate}, transitions=(reached,), goals={"SO": goal}
    )
    return uo.Mission(
        hierarchy=Hierarchy([StandOff(model=model, goal=0.0)]), phases=(phase,), ramp=0.0
    )


def test_a_task_of_ones_own_on_distances_has_its_goal_and_what_is_measured(robot: Robot) -> None:
    mission = standing_off(robot, 0.4)
    q = robot.configuration()
    task = mission.tasks_of(0)[0]
    state = mission.start()
    assert task.nearest_pairs is not None
    parameters = mission_parameters(mission, state, 0.0, gates=np.ones(1), q=q, motion=None)
    np.testing.assert_array_equal(parameters, [0.4, *measured_distances(task.nearest_pairs, q)])


def test_a_task_of_ones_own_on_distances_is_carried_out(robot: Robot) -> None:
    control = KinematicController(
        robot=robot, mission=standing_off(robot, 0.4), solver=uo.LexicographicActiveSet(), dt=0.02
    )
    q = robot.configuration()
    v = np.zeros(robot.n_v)
    for k in range(1500):
        command = control(StateEstimate(q=q, v=v, altimeter_range=5.0), 0.02 * k)
        v = command.v
        q = pin.integrate(robot.model, q, 0.02 * v)
        if command.finished:
            break
    assert command.finished
    assert control.quantities["SO.distance"] == pytest.approx(0.4, abs=2e-3)


def test_nothing_is_measured_for_a_task_that_is_off(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    q = robot.configuration()

    def refuse(*arguments: object) -> np.ndarray:
        raise AssertionError(arguments)

    rubble = mesh(2.0, 0.0, 0.0)
    off = standing_off(robot, 0.4, gate=0.0, by=rubble)
    on = standing_off(robot, 0.4, by=rubble)
    monkeypatch.setattr(CollisionModel, "values", refuse)
    parameters = mission_parameters(off, off.start(), 0.0, gates=np.zeros(1), q=q, motion=None)
    np.testing.assert_array_equal(parameters, off.tasks_of(0)[0].reference(0.0))
    at = StateEstimate(q=q, v=np.zeros(robot.n_v), altimeter_range=5.0)
    for mission in (off, standing_off(robot, 0.4, gate=0.0)):
        control = KinematicController(
            robot=robot, mission=mission, solver=uo.LexicographicActiveSet(), dt=DT
        )
        control(at, 0.0)
        np.testing.assert_array_equal(control.memory.goals.values, parameters)
    with pytest.raises(AssertionError):
        KinematicController(
            robot=robot, mission=on, solver=uo.LexicographicActiveSet(), dt=DT
        ).observe(at, 0.0)


@needs_compiler
def test_kernels_and_python_measure_the_same_of_shapes_that_have_a_form_in_c(robot: Robot) -> None:
    """In motion, where bounds stand in for what is far; Python, as `evaluate` asks it, takes the
    distances of all pairs.
    """
    rocks = [ball(1.6, 0.4, -0.3), ball(-1.8, 0.0, 0.4)]
    rng = np.random.default_rng(6)
    pairs = NearestPairs(task="CL", model=CollisionModel(robot, rocks), n=6, threshold=0.05)
    dimensions = with_nearest(dimensions_of(robot), [pairs])
    memory = structure_of(
        NearestMemory,
        with_any_distances(dimensions, [pairs.model], robot),
        integrate=motion_function(robot, [pairs], dimensions),
        places=any_places([pairs.model], robot),
    )()
    DistanceProvider(memory, [(0, pairs.n_parameters, pairs)], robot)
    assert memory.pairs[0].in_c
    looks, measures = bind_memory(memory, (place_along_stop, measure_pairs))
    values = doubles(np.zeros(pairs.n_parameters))
    acceleration = doubles(robot.limits.acceleration)
    moved = 0
    for _ in range(40):
        q, motion = random_motion(robot, rng)
        looks(memory, doubles(q), doubles(motion.v), acceleration, motion.dt)
        measures(memory, 0, values)
        np.testing.assert_allclose(
            values, measured_distances(pairs, q, motion), rtol=0, atol=ROUNDING
        )
        moved += int((split(pairs, np.array(values))[2] < FAR).sum())
    assert moved > 20


def test_pairs_that_cannot_be_measured_are_refused(robot: Robot) -> None:
    model = CollisionModel(robot, [ball(3.0, 0.0, 0.0)])
    with pytest.raises(InvalidInput, match="SO: n_nearest = 0; give 1 or more"):
        NearestPairs(task="SO", model=model, n=0, threshold=0.1)
    with pytest.raises(InvalidInput, match="SO: a collision model without pairs"):
        NearestPairs(
            task="SO", model=CollisionModel(robot, self_collision=False), n=1, threshold=0.1
        )


class Turning:
    """A goal that keeps the times at which it was asked."""

    def __init__(self) -> None:
        self.asked: list[float] = []

    def __call__(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        self.asked.append(t)
        return np.array([t]), np.ones(1)


@pytest.mark.parametrize("order", [("still", "moving"), ("moving", "still")])
def test_a_goal_that_moves_is_asked_at_every_tick_and_a_still_one_once_in_a_phase(
    robot: Robot, order: tuple[str, str]
) -> None:
    joint = robot.joints[0].name
    moving = Turning()
    tasks = [
        JointTracking(name="still", joints=(joint,), goal=np.array([0.3])),
        JointTracking(name="moving", joints=(joint,), goal=moving),
    ]
    assert [task.is_constant for task in tasks] == [True, False]
    never = (
        uo.Transition(to=uo.DONE, when=(uo.Below(quantity="still.posture_error", limit=1e-9),)),
    )
    phases = [
        uo.Phase(
            name=name,
            activations={"still": 1.0, "moving": 1.0},
            transitions=never,
            goals={"still": np.array([goal])},
        )
        for name, goal in (("one", 0.1), ("two", 0.2))
    ]
    mission = uo.Mission(hierarchy=Hierarchy(tasks, order), phases=tuple(phases))
    control = KinematicController(
        robot=robot, mission=mission, solver=uo.LexicographicActiveSet(), dt=DT
    )
    memory = control.memory
    q = robot.configuration()
    state = mission.start()
    moving.asked.clear()
    for phase, goal in ((0, 0.1), (1, 0.2), (0, 0.1)):
        moved_state = replace(state, phase=phase)
        for t in (1.0, 2.0, 3.0):
            write_state(memory.mission, moved_state)
            load_goals(memory.goals, memory.mission, memory.ascent, t)
            control._parameters.ask(moved_state, t)
            goals = {"still": [goal, 0.0], "moving": [t, 1.0]}
            np.testing.assert_array_equal(
                memory.goals.values, np.concatenate([goals[name] for name in order])
            )
            parameters = mission_parameters(
                mission, moved_state, t, gates=np.ones(2), q=q, motion=None
            )
            np.testing.assert_array_equal(memory.goals.values, parameters)
    assert moving.asked.count(2.0) == 6


def test_a_goal_that_ends_is_held_as_samples_and_not_asked_again(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its own and that of a phase, before their start, at ticks, between them and after their
    end.
    """
    joint = robot.joints[0].name
    rng = np.random.default_rng(2)
    curves = [
        PiecewisePolynomial(breaks=[0.5, 1.0, 1.7], coefficients=rng.normal(size=(4, 2, 1)))
        for _ in range(2)
    ]
    tasks = [JointTracking(name=name, joints=(joint,), goal=np.zeros(1)) for name in ("one", "two")]
    never = (uo.Transition(to=uo.DONE, when=(uo.Below(quantity="one.posture_error", limit=1e-9),)),)
    phases = [
        uo.Phase(name=name, activations={"one": 1.0, "two": 1.0}, transitions=never, goals=goals)
        for name, goals in (
            ("first", {"one": curves[0]}),
            ("second", {"one": curves[1], "two": curves[0]}),
        )
    ]
    mission = uo.Mission(
        hierarchy=Hierarchy([tasks[0], tasks[1].with_goal(curves[1])]), phases=tuple(phases)
    )
    control = KinematicController(
        robot=robot, mission=mission, solver=uo.LexicographicActiveSet(), dt=DT
    )
    memory = control.memory
    q = robot.configuration()
    states = [replace(mission.start(), phase=phase, since=100 * DT) for phase in (0, 1)]
    ticks = [(state, k * DT) for state in states for k in (0, 100, 227, 300.25, 400, 499.5, 5000)]
    expected = [
        mission_parameters(mission, *at, gates=np.ones(2), q=q, motion=None) for at in ticks
    ]
    monkeypatch.setattr(PiecewisePolynomial, "__call__", lambda self, t: None)
    for (state, t), parameters in zip(ticks, expected, strict=True):
        write_state(memory.mission, state)
        load_goals(memory.goals, memory.mission, memory.ascent, t)
        control._parameters.ask(state, t)
        close = 1e-9 if t / DT == round(t / DT) else 1e-2
        np.testing.assert_allclose(memory.goals.values, parameters, rtol=0, atol=close)


def test_a_task_of_ones_own_is_asked_at_every_tick(robot: Robot) -> None:
    assert not standing_off(robot, 0.4).tasks_of(0)[0].is_constant
