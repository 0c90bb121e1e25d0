"""An arm that fell by a load that nobody knew of does not fall again when brakes let it go: the vehicle
bears the load meanwhile, and weighs it.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pinocchio as pin
import pytest
from compiler import long_without_compiler
from test_doubted_encoders import ONSET, hover
from test_force_tick import laws_of

from uvms_ocp.control.force.tick import ForceTick, _weigh_load
from uvms_ocp.control.force.tick_functions import (
    ForceInputs,
    ForceLaws,
    ForceState,
    column_places,
    weigh_function,
)
from uvms_ocp.control.payload import tool_function
from uvms_ocp.robot.dynamics import robot_dynamics
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.sim.currents import UniformCurrent

ROBOTS = ("girona_maris7_full", "bluerov2_alpha5", "bluerov2_two_alpha5")
WEIGHT = 40.0  # [N]


@lru_cache
def laws(name: str) -> ForceLaws:
    return laws_of(load_robot(name))


def weigh(name: str, q: np.ndarray, estimate: np.ndarray) -> tuple[np.ndarray, float]:
    """Disturbance of joints (n_joints,) [N m] by a load, and the share that it explains."""
    dimensions = laws(name).dimensions
    columns = []
    for kind, values in ((ForceInputs, {"q": q}), (ForceState, {"estimate": estimate})):
        places = column_places(kind, dimensions)
        column = np.zeros(max(place.stop for place in places.values()) + 1)
        for field, value in values.items():
            column[places[field]] = value
        columns.append(column)
    function = weigh_function(laws(name))
    for k in range(2):
        columns[k] = columns[k][: function.size1_in(k)]
    weighed, explained = function(*columns)
    robot = laws(name).robot
    return np.array(weighed).ravel()[robot.n_vehicle :], float(explained)


def posture(name: str, seed: int) -> np.ndarray:
    """A vehicle that tilts by up to half a radian, and any posture of its arms."""
    robot = load_robot(name)
    rng = np.random.default_rng(seed)
    step = np.concatenate([rng.normal(size=3), rng.uniform(-0.3, 0.3, 3)])
    step = np.concatenate([step, rng.uniform(-1.0, 1.0, robot.n_joints)])
    return np.asarray(pin.integrate(robot.model, robot.configuration(), step))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", ROBOTS)
def test_a_load_is_known_by_what_the_vehicle_bears(name: str, seed: int) -> None:
    """A current that pushes sideways, and turns the vehicle about the vertical, is no weight."""
    robot = load_robot(name)
    q = posture(name, seed)
    forces = np.array(
        tool_function(robot_dynamics(robot).symbolic, robot.tools)(q, np.zeros(robot.n_v))[0]
    )
    R = pin.Quaternion(q[3:7]).matrix()
    push = np.concatenate([R.T @ [15.0, -20.0, 0.0], R.T @ [0.0, 0.0, 5.0]])
    for tool, force in zip(robot.tools, forces.T, strict=True):
        known = np.full(robot.n_joints, 0.7)
        estimate = np.concatenate([WEIGHT * force[:6] + push, known])
        weighed, explained = weigh(name, q, estimate)
        carriers = robot.model.supports[robot.model.frames[robot.frame_id(tool)].parentJoint]
        carries = np.zeros(robot.n_joints, bool)
        for joint in carriers:
            if joint > 1:
                carries[robot.model.joints[joint].idx_v - robot.n_vehicle] = True
        np.testing.assert_allclose(weighed[carries], WEIGHT * force[6:][carries], atol=1e-6)
        np.testing.assert_array_equal(weighed[~carries], known[~carries])
        assert explained > 0.999


@pytest.mark.parametrize("name", ROBOTS)
def test_what_no_weight_at_a_tool_makes_is_not_explained(name: str) -> None:
    """A moment alone, as of an arm that is elsewhere, or a vehicle that is too light."""
    robot = load_robot(name)
    q = posture(name, 0)
    q[3:7] = [0.0, 0.0, 0.0, 1.0]
    for disturbance in ([0.0, 0.0, 0.0, 10.0, -10.0, 0.0], [30.0, 0.0, 0.0, 0.0, 0.0, 8.0]):
        estimate = np.concatenate([disturbance, np.zeros(robot.n_joints)])
        assert weigh(name, q, estimate)[1] < 0.7


@pytest.mark.parametrize(
    ("sideways", "is_load"), [(0.0, True), (1.5, True), (2.5, False), (15.0, False)]
)
@pytest.mark.parametrize("name", ROBOTS)
def test_what_a_current_lifts_a_tilted_vehicle_by_is_no_load(
    name: str, sideways: float, is_load: bool
) -> None:
    """Of 92 N that pushed it sideways 6 N lifted it, which a load at its tool explained."""
    robot = load_robot(name)
    q = posture(name, 2)
    force = np.array(
        tool_function(robot_dynamics(robot).symbolic, robot.tools)(q, np.zeros(robot.n_v))[0]
    )[:, 0]
    push = pin.Quaternion(q[3:7]).matrix().T @ [0.0, -sideways * WEIGHT, 0.0]
    estimate = np.concatenate([WEIGHT * force[:3] + push, WEIGHT * force[3:6]])
    explained = weigh(name, q, np.concatenate([estimate, np.zeros(robot.n_joints)]))[1]
    assert (explained > 0.7) == is_load


@pytest.mark.slow
@long_without_compiler
@pytest.mark.parametrize("speed", [0.5, 0.6])
def test_an_arm_that_a_current_threw_is_not_thrown_by_what_the_current_lifts(speed: float) -> None:
    """Its brakes let it go at 16 times its velocity limit. The current itself throws it in a tick, as at
    the start.
    """
    scenario = hover("bluerov2_alpha5", 0.05, "", rates=None, end=8.0, ahead=3.0)
    current = UniformCurrent([-speed, 0.1, 0.0])
    environment = replace(scenario.environment, current=current)
    record = replace(scenario, environment=environment).run()
    rates = np.abs(record["v"][:, 6:]) / scenario.robot.limits.velocity[6:]
    assert rates.max() <= 1.2


@pytest.mark.sampled
@pytest.mark.parametrize("speed", [0.0, 0.4, 0.6, -0.9])
def test_no_arm_is_let_go_while_its_vehicle_is_carried_off(speed: float) -> None:
    """Its load was weighed, and brakes let go, though they were to last as long as that."""
    robot = load_robot("bluerov2_alpha5")
    q = posture(robot.name, 1)
    force = np.array(
        tool_function(robot_dynamics(robot).symbolic, robot.tools)(q, np.zeros(robot.n_v))[0]
    )[:, 0]
    joint = int(np.argmax(np.abs(force[6:])))
    memory = ForceTick(laws(robot.name)).memory
    memory.inputs.q[:] = q
    memory.inputs.v[0] = speed * robot.limits.velocity[0]
    memory.state.estimate[:6] = WEIGHT * force[:6]
    memory.encoders_trusted = True
    memory.fallen = joint
    memory.fell_upwards = bool(force[6 + joint] > 0.0)
    memory.overspeed.locked_at = 0.0
    memory.overspeed.locked_until = 32.0
    memory.t = 5.0
    _weigh_load(memory)
    is_carried_off = abs(speed) > 0.5
    assert memory.overspeed.locked_until == (32.0 if is_carried_off else memory.t)
    assert memory.fallen == -1


@pytest.mark.slow
@long_without_compiler
@pytest.mark.parametrize(
    ("dt", "load"), [(0.05, "6,0.0005"), (0.05, "4,0.0005"), (0.02, "8,0.0005")]
)
def test_an_arm_that_fell_by_its_load_does_not_fall_again(dt: float, load: str) -> None:
    """It fell at 29.7 times its velocity limit as brakes let go of it after half a second."""
    scenario = hover("girona_maris7_full", dt, f"payload:mass={load}", rates=None)
    record = scenario.run()
    rates = np.abs(record["v"][:, 6:]) / scenario.robot.limits.velocity[6:]
    soon = (record["t"] >= ONSET) & (record["t"] <= ONSET + 0.5)
    assert rates[soon].max() <= 1.2
    assert rates[~soon].max() <= 1.02
