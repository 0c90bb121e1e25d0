"""Laws of a control period of the plant: it is its steps one by one, compiled or not, and what it
hands out stays.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from compiler import IN_C_AND_PYTHON, needs_compiler

from uvms_ocp.codegen.kernel_layout import arrays_of, assign
from uvms_ocp.codegen.kernels import make_memory
from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot.dynamics import robot_dynamics
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.shapes.hull import skid_points
from uvms_ocp.robot.signals import Command
from uvms_ocp.sim import plant as dynamic_plant
from uvms_ocp.sim.currents import GustyCurrent, UniformCurrent
from uvms_ocp.sim.dynamic_plant import DynamicPlant
from uvms_ocp.sim.dynamic_step import (
    CARRIED,
    INPUTS,
    JointStops,
    StepModel,
    advance_plant,
    plant_structure,
    step_function,
)
from uvms_ocp.sim.environment import Environment
from uvms_ocp.sim.faults import parse_faults
from uvms_ocp.sim.seafloor import FlatSeafloor
from uvms_ocp.sim.seafloor_contact import ContactModel
from uvms_ocp.sim.thrusters import Thrusters

DT = 5e-3
WATER = Environment(
    seafloor=FlatSeafloor(z=-10.0), current=GustyCurrent(base=UniformCurrent([0.2, -0.1, 0.0]))
)


@pytest.fixture(scope="module", name="robot")
def _robot() -> Robot:
    return load_robot("girona_maris7_full")


def model_of(robot: Robot) -> StepModel:
    return StepModel(
        robot=robot,
        dynamics=robot_dynamics(robot).symbolic,
        points=skid_points(robot),
        contact=ContactModel(),
        stops=JointStops(),
        thrusters=Thrusters.of(robot),
    )


def plant_of(robot: Robot, *texts: str, max_step: float = 1e-3) -> DynamicPlant:
    """Just above the floor, so that it touches down."""
    q = robot.configuration(position=(0.0, 0.0, -9.48), joints=0.2 + robot.home)
    faults = parse_faults(texts)
    return DynamicPlant(
        robot,
        q,
        dynamics=robot_dynamics(robot),
        environment=WATER,
        max_step=max_step,
        faults=faults,
    )


def command_at(robot: Robot, k: int) -> Command:
    n = len(robot.description.thrusters)
    t = k * DT
    thrust = 40.0 * np.sin(3.0 * t + np.arange(n)) - 10.0
    torque = 5.0 * np.cos(2.0 * t + np.arange(robot.n_joints))
    return Command(v=np.zeros(robot.n_v), thrust=thrust, torque=torque, brakes=k % 50 > 40)


def rows_of(plant: DynamicPlant, robot: Robot, ticks: int, dt: float = DT) -> np.ndarray:
    rows = []
    for k in range(ticks):
        plant.step(command_at(robot, k), dt)
        rows.append(
            np.hstack([plant.state.q, plant.state.v, plant.state.a, *plant.telemetry().values()])
        )
    return np.array(rows)


@pytest.mark.sampled
@pytest.mark.parametrize("compiled", IN_C_AND_PYTHON)
@pytest.mark.parametrize("name", ["girona_maris7_full", "bluerov2_alpha5", "planar5"])
def test_a_period_is_its_steps_one_by_one(name: str, compiled: bool) -> None:
    robot = load_robot(name)
    rng = np.random.default_rng(0)
    model = model_of(robot)
    n_steps = 5
    step = step_function(model)
    memory, (advance,) = make_memory(
        plant_structure(model, step), (advance_plant,), compiled=compiled
    )
    arrays = arrays_of(memory)
    for array in vars(arrays).values():
        array[:] = 0.1 * rng.normal(size=array.shape)
    arrays.q[:] = q = (
        robot.configuration(joints=0.2 + robot.home) if robot.n_vehicle else robot.configuration()
    )
    decay = model.thrusters.decay(DT / n_steps)
    assign(memory, dt=DT, n_steps=n_steps, step_dt=DT / n_steps, decay=decay.T.ravel())
    tables = {
        key: getattr(arrays, key).reshape(-1, 3).T.copy() for key in ("u", "Du_Dt", "floor_normal")
    } | {"decay": decay}
    x = {key: getattr(arrays, key).copy() for key in INPUTS if key not in (*tables, "brake", "dt")}
    x |= tables | {"brake": 0.0, "dt": DT / n_steps}
    before = x["v"]
    advance(memory)
    for _ in range(n_steps):
        result = step(**x)
        x |= {key: np.array(result[f"{key}_next"]) for key in CARRIED}
    assert not np.array_equal(arrays.q, q)
    for key in CARRIED:
        np.testing.assert_array_equal(getattr(arrays, key), x[key].ravel(), err_msg=key)
    for key in ("torque", "contact"):
        np.testing.assert_array_equal(
            getattr(arrays, key), np.array(result[key]).ravel(), err_msg=key
        )
    np.testing.assert_allclose(arrays.a, (x["v"].ravel() - before) / DT, rtol=1e-12)


def _in_python(structure: Any, kernels: Any, *, compiled: bool = True) -> Any:
    return make_memory(structure, kernels, compiled=False)


@needs_compiler
def test_without_a_compiler_the_plant_moves_the_same_way(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    faults = ("thruster3:weak=0.25@0.2-0.5", "thruster5:dead@0.3")
    compiled = rows_of(plant_of(robot, *faults), robot, 200)
    monkeypatch.setattr(dynamic_plant, "make_memory", _in_python)
    walked = rows_of(plant_of(robot, *faults), robot, 200)
    assert compiled[:, -9:].any()
    np.testing.assert_allclose(walked, compiled, rtol=1e-9, atol=1e-9)


def test_the_length_of_the_control_period_may_change_on_the_way(robot: Robot) -> None:
    """Steps of the same length in still water: what is sampled once a period is the same."""
    environment = Environment(seafloor=FlatSeafloor(z=-100.0))
    start = robot.configuration()
    command = command_at(robot, 3)
    plants = [
        DynamicPlant(
            robot, start, dynamics=robot_dynamics(robot), environment=environment, max_step=1e-3
        )
        for _ in range(2)
    ]
    for dt in (0.004, 0.002, 0.006):
        plants[0].step(command, dt)
    for _ in range(12):
        plants[1].step(command, 0.001)
    np.testing.assert_allclose(plants[0].state.v, plants[1].state.v, rtol=1e-12, atol=1e-12)
    for name, value in plants[0].telemetry().items():
        np.testing.assert_allclose(value, plants[1].telemetry()[name], rtol=1e-12, err_msg=name)


def test_what_a_period_hands_out_survives_the_next(robot: Robot) -> None:
    plant = plant_of(robot, "thruster3:dead@0.01")
    plant.step(command_at(robot, 0), DT)
    state = plant.state
    told = plant.telemetry()
    copies = [np.array(value) for value in (state.q, state.v, state.a, *told.values())]
    for k in range(1, 5):
        plant.step(command_at(robot, k), DT)
    for before, after in zip(copies, (state.q, state.v, state.a, *told.values()), strict=True):
        np.testing.assert_array_equal(before, after)


def test_a_state_put_in_its_place_is_gone_on_from(robot: Robot) -> None:
    plant = plant_of(robot)
    twin = plant_of(robot)
    rows_of(plant, robot, 5)
    rows_of(twin, robot, 5)
    twin.state = dataclasses.replace(plant.state, v=plant.state.v + 0.1)
    plant.step(command_at(robot, 5), DT)
    twin.step(command_at(robot, 5), DT)
    assert np.abs(twin.state.v - plant.state.v).max() > 0.05
    twin.state.q[:] = plant.state.q
    twin.state.v[:] = plant.state.v
    plant.step(command_at(robot, 6), DT)
    twin.step(command_at(robot, 6), DT)
    np.testing.assert_array_equal(twin.state.q, plant.state.q)


def test_joints_take_the_energy_of_every_step(robot: Robot) -> None:
    plant = plant_of(robot)
    spent = 0.0
    for k in range(40):
        plant.step(command_at(robot, k), 1e-3)
        power = (
            np.abs(plant.telemetry()["torque"] * plant.state.v[robot.joint_v])
            / robot.description.joint_efficiency
        )
        spent += 1e-3 * power.sum()
    assert plant.telemetry()["joint_energy"] == pytest.approx(spent, rel=1e-12)
    assert spent > 0.0


WRONG: dict[str, Callable[[Command], dict[str, np.ndarray]]] = {
    "thrust that is no number": lambda command: {"thrust": np.r_[np.nan, command.thrust[1:]]},  # type: ignore[index]
    "endless thrust": lambda command: {"thrust": np.r_[np.inf, command.thrust[1:]]},  # type: ignore[index]
    "torque that is no number": lambda command: {"torque": np.r_[command.torque[1:], np.nan]},  # type: ignore[index]
    "thrust of other thrusters": lambda command: {"thrust": np.zeros(3)},
    "thrust of one": lambda command: {"thrust": np.zeros(1)},
    "torque of other joints": lambda command: {"torque": np.zeros(2)},
}


@pytest.mark.sampled
@pytest.mark.parametrize("case", WRONG)
def test_efforts_that_are_none_are_refused(case: str, robot: Robot) -> None:
    plant = plant_of(robot)
    command = command_at(robot, 0)
    before = plant.state
    with pytest.raises(InvalidInput, match="allowed: 8 and 7 finite numbers") as error:
        plant.step(dataclasses.replace(command, **WRONG[case](command)), DT)
    assert "\n" not in str(error.value)
    assert plant.state is before
