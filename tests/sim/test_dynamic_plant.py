"""Laws of the physical plant: energy, stability at coarse steps, rest, contact, joint stops."""

from __future__ import annotations

import dataclasses

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp

from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot.assembly import without_arm
from uvms_ocp.robot.description import TrimBody
from uvms_ocp.robot.dynamics import Dynamics, robot_dynamics
from uvms_ocp.robot.hydrodynamics import LinkHydrodynamics
from uvms_ocp.robot.loading import list_robots, load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import Command
from uvms_ocp.robot.spatial import quaternion_to_matrix
from uvms_ocp.robot.static_balance import with_trim
from uvms_ocp.robot.symbolic_dynamics import SymbolicDynamics
from uvms_ocp.sim.currents import Current, GustyCurrent, ShearedCurrent, UniformCurrent
from uvms_ocp.sim.dynamic_plant import DynamicPlant
from uvms_ocp.sim.dynamic_step import JointStops
from uvms_ocp.sim.environment import Environment
from uvms_ocp.sim.seafloor import FlatSeafloor
from uvms_ocp.sim.seafloor_contact import ContactModel

DEEP = Environment(seafloor=FlatSeafloor(z=-1000.0))


@pytest.fixture(scope="module", params=list_robots())
def robot(request: pytest.FixtureRequest) -> Robot:
    return load_robot(request.param)


@pytest.fixture(scope="module")
def girona() -> Robot:
    return load_robot("girona_maris7_full")


def idle(robot: Robot, torque: np.ndarray | None = None) -> Command:
    return Command(
        v=np.zeros(robot.n_v),
        thrust=np.zeros(len(robot.description.thrusters)),
        torque=np.zeros(robot.n_joints) if torque is None else torque,
    )


def plant_of(
    robot: Robot, q: np.ndarray | None = None, max_step: float = 1e-3, env: Environment = DEEP
) -> DynamicPlant:
    start = robot.configuration() if q is None else q
    return DynamicPlant(
        robot, start, dynamics=robot_dynamics(robot), environment=env, max_step=max_step
    )


def plant_with_held_joints(
    robot: Robot, q: np.ndarray | None = None, env: Environment = DEEP
) -> DynamicPlant:
    """Brakes on the joints: friction so large that they creep by less than a microradian per
    second.
    """
    symbolic = robot_dynamics(robot).symbolic
    braked = Dynamics(
        dataclasses.replace(symbolic, damping=np.repeat([0.0, 1e9], [6, robot.n_joints]))
    )
    start = robot.configuration() if q is None else q
    return DynamicPlant(robot, start, dynamics=braked, environment=env)


def let_go(plant: DynamicPlant, robot: Robot, duration: float) -> None:
    for _ in range(round(duration / 0.005)):
        plant.step(idle(robot), 0.005)


def with_velocity(plant: DynamicPlant, v: np.ndarray) -> DynamicPlant:
    plant.state = dataclasses.replace(plant.state, v=v)
    return plant


def energy(dynamics: Dynamics, plant: DynamicPlant) -> float:
    state = plant.state
    return dynamics.kinetic_energy(state.q, state.v) + dynamics.potential_energy(state.q)


def mid_range(robot: Robot) -> np.ndarray:
    lower = np.maximum(robot.limits.position_lower, -1.0)
    return (lower + np.minimum(robot.limits.position_upper, 1.0)) / 2


def rise_of_energy(robot: Robot, max_step: float, duration: float) -> float:
    """Largest rise of the energy of the unforced robot above any earlier value, without stops or
    floor [J].
    """
    free = dataclasses.replace(
        robot,
        limits=dataclasses.replace(
            robot.limits,
            position_lower=np.full(robot.n_joints, -np.inf),
            position_upper=np.full(robot.n_joints, np.inf),
        ),
    )
    rng = np.random.default_rng(5)
    q = free.configuration(joints=mid_range(robot))
    plant = with_velocity(plant_of(free, q, max_step), 0.3 * rng.normal(size=robot.n_v))
    dynamics = robot_dynamics(free)
    command = idle(free)
    lowest = energy(dynamics, plant)
    rise = 0.0
    for _ in range(round(duration / 0.02)):
        plant.step(command, 0.02)
        present = energy(dynamics, plant)
        rise = max(rise, present - lowest)
        lowest = min(lowest, present)
    return rise


@pytest.mark.slow
def test_unforced_energy_rises_by_the_error_of_the_step_alone(robot: Robot) -> None:
    coarse, fine = (rise_of_energy(robot, step, 60.0) for step in (4e-3, 1e-3))
    assert fine <= max(0.5 * coarse, 1e-6)
    assert fine < 0.05


@pytest.mark.sampled
@pytest.mark.parametrize("step", [0.02, 0.2])
def test_a_coarse_step_cannot_explode(step: float, robot: Robot) -> None:
    rng = np.random.default_rng(0)
    plant = with_velocity(plant_of(robot, max_step=step), 2.0 * rng.normal(size=robot.n_v))
    dynamics = robot_dynamics(robot)
    before = energy(dynamics, plant)
    for _ in range(round(10 / step)):
        plant.step(idle(robot), step)
        assert np.isfinite(plant.state.q).all()
    if robot.n_vehicle:  # planar5 is dry and frictionless: nothing takes energy out
        assert energy(dynamics, plant) < before


@pytest.mark.sampled
@pytest.mark.parametrize("name", [name for name in list_robots() if load_robot(name).n_vehicle])
def test_a_trimmed_robot_with_held_joints_stays(name: str) -> None:
    robot = load_robot(name)
    dynamics = robot_dynamics(robot)
    q = robot.configuration()
    residual = dynamics.bias_force(q, np.zeros(robot.n_v))[:6]
    assert np.abs(residual[:3]).max() < 0.5
    assert np.abs(residual[3:]).max() < 0.5
    plant = plant_with_held_joints(robot)
    let_go(plant, robot, 10.0)
    assert np.linalg.norm(plant.state.q[:3]) < 0.1
    assert np.abs(plant.state.q[3:6]).max() < 0.02


@pytest.mark.slow
def test_a_robot_adrift_takes_the_velocity_of_the_current(girona: Robot) -> None:
    environment = Environment(
        seafloor=FlatSeafloor(z=-1000.0), current=UniformCurrent([0.3, -0.2, 0.0])
    )
    plant = plant_with_held_joints(girona, env=environment)
    let_go(plant, girona, 60.0)
    R = girona_rotation(plant)
    np.testing.assert_allclose(R @ plant.state.v[:3], [0.3, -0.2, 0.0], atol=0.02)


def sphere_plant(current: Current, v: np.ndarray, max_step: float) -> DynamicPlant:
    """A neutrally buoyant sphere without drag, 1 m above the floor at -40 m."""
    robot = without_arm(load_robot("bluerov2_alpha5"))
    model = robot.model.copy()
    mass = 10.0
    density = 1000.0
    model.inertias[1] = pin.Inertia(mass, np.zeros(3), 0.1 * np.eye(3))
    link = LinkHydrodynamics(
        frame="base_link",
        added_mass=mass / 2 * np.r_[np.ones(3), np.zeros(3)],
        volume=mass / density,
    )
    dynamics = Dynamics(SymbolicDynamics(model=model, links=(link,), density=density))
    q = robot.configuration(position=[0, 0, -39.0])
    environment = Environment(seafloor=FlatSeafloor(z=-40.0), current=current)
    return with_velocity(
        DynamicPlant(robot, q, dynamics=dynamics, environment=environment, max_step=max_step), v
    )


LAYER = ShearedCurrent.over_floor([0.3, 0.0, 0.0], floor_z=-40.0, thickness=5.0)


def test_a_sphere_without_drag_falls_straight_through_steady_layers() -> None:
    v = np.array([0.1, 0.05, -0.2, 0.0, 0.0, 0.0])
    plant = sphere_plant(LAYER, v, max_step=0.01)
    for _ in range(200):
        plant.step(Command(v=v, thrust=np.zeros(8), torque=np.zeros(0)), 0.01)
    np.testing.assert_allclose(plant.state.v, v, atol=1e-12)
    np.testing.assert_allclose(plant.state.q[:3], [0.2, 0.1, -39.4], atol=1e-9)


def test_a_sphere_without_drag_accelerates_as_the_water_where_it_is() -> None:
    current = GustyCurrent(base=LAYER, sigma=(0.05, 0.05, 0.1), correlation_time=2.0, seed=5)
    v = np.array([0.1, 0.0, -0.2, 0.0, 0.0, 0.0])
    dt = 2e-3
    duration = 3.0
    plant = sphere_plant(current, v, max_step=dt)
    for _ in range(round(duration / dt)):
        plant.step(Command(v=v, thrust=np.zeros(8), torque=np.zeros(0)), dt)

    def motion(t: float, x: np.ndarray) -> np.ndarray:
        h = 1e-6
        p = x[None, :3]
        u = current.velocity(p, t)
        return np.r_[x[3:], (current.velocity(p + h * u, t + h) - u)[0] / h]

    exact = solve_ivp(motion, (0.0, duration), np.r_[0.0, 0.0, -39.0, v[:3]], max_step=0.05).y[
        :, -1
    ]
    assert np.abs(exact[3:] - v[:3]).max() > 0.05
    np.testing.assert_allclose(np.r_[plant.state.q[:3], plant.state.v[:3]], exact, atol=5e-4)


@pytest.mark.sampled
@pytest.mark.parametrize("speed", [0.0, 0.2])
def test_shear_along_and_across_the_flow_pushes_a_sphere_as_in_closed_form(speed: float) -> None:
    """Water with u_x = s h and u_z = k h at height h: ``h'' = k^2 h`` along the flow, ``x'' = s k
    h`` across its gradient.
    """
    s = 0.4
    k = 0.3
    dt = 1e-3
    duration = 2.0
    rising = ShearedCurrent(
        z=[-40.0, -30.0], velocities=[[0.0, 0.0, 0.0], [10.0 * s, 0.0, 10.0 * k]]
    )
    v = np.array([0.1, 0.0, speed, 0.0, 0.0, 0.0])
    plant = sphere_plant(rising, v, max_step=dt)
    for _ in range(round(duration / dt)):
        plant.step(Command(v=v, thrust=np.zeros(8), torque=np.zeros(0)), dt)
    grown = np.sinh(k * duration)
    growth = np.cosh(k * duration) - 1.0
    v_z = k * grown + speed * (growth + 1.0)  # from 1 m above the floor
    v_x = 0.1 + s * (grown + speed / k * growth)
    np.testing.assert_allclose(plant.state.v[:3], [v_x, 0.0, v_z], atol=2e-4)
    assert v_x - 0.1 > 0.2


def girona_rotation(plant: DynamicPlant) -> np.ndarray:
    return np.asarray(quaternion_to_matrix(plant.state.q[3:7]))


def test_a_heavy_robot_lands_on_its_skid_and_rests(girona: Robot) -> None:
    ballast = TrimBody(name="ballast", position=(0.0, 0.0, -0.3), mass=10.0, volume=0.0)
    heavy = with_trim(girona, [ballast])
    floor = Environment(seafloor=FlatSeafloor(z=-10.0))
    plant = plant_with_held_joints(heavy, heavy.configuration(position=[0, 0, -9.0]), floor)
    let_go(plant, heavy, 20.0)
    depth = -10.0 + 0.5 - plant.state.q[2]
    contact = plant.telemetry()["contact"]
    assert 0 < depth < 0.01
    assert np.abs(plant.state.v).max() < 1e-3
    assert contact.sum() == pytest.approx(10.0 * 9.81, rel=0.02)


def test_friction_holds_a_landed_robot_in_a_current(girona: Robot) -> None:
    heavy = with_trim(
        girona, [TrimBody(name="ballast", position=(0.0, 0.0, -0.3), mass=10.0, volume=0.0)]
    )
    environment = Environment(
        seafloor=FlatSeafloor(z=-10.0), current=UniformCurrent([0.2, 0.0, 0.0])
    )
    plant = plant_with_held_joints(heavy, heavy.configuration(position=[0, 0, -9.503]), environment)
    let_go(plant, heavy, 10.0)
    assert np.abs(plant.state.v[:3]).max() < 0.005


def test_a_joint_driven_into_its_stop_stays_there(girona: Robot) -> None:
    plant = plant_of(girona)
    torque = np.zeros(7)
    torque[3] = 60.0
    deepest = 0.0
    for _ in range(1000):
        plant.step(idle(girona, torque), 0.005)
        deepest = max(deepest, plant.state.q[10] - girona.limits.position_upper[3])
    stiffness = JointStops().stiffness(girona)[3]
    assert 0 < deepest < 0.1
    assert plant.state.q[10] - girona.limits.position_upper[3] == pytest.approx(
        60.0 / stiffness, rel=0.5
    )
    assert abs(plant.state.v[9]) < 0.05


def test_motors_give_no_more_than_their_limit(girona: Robot) -> None:
    plant = plant_of(girona)
    plant.step(idle(girona, np.full(7, 1e6)), 0.005)
    np.testing.assert_array_equal(plant.telemetry()["torque"], girona.limits.effort)


def test_a_command_without_thrust_is_refused(girona: Robot) -> None:
    with pytest.raises(
        InvalidInput, match="needs thrust and torque; wrap the controller in a DynamicController"
    ):
        plant_of(girona).step(Command(v=np.zeros(13)), 0.005)


@pytest.mark.parametrize("max_step", [0.0, -1.0, float("nan")])
def test_an_impossible_step_is_refused(max_step: float, girona: Robot) -> None:
    with pytest.raises(InvalidInput, match="max_step"):
        plant_of(girona, max_step=max_step)


@pytest.mark.parametrize("depth", [-1.0, 0.0, 0.002])
def test_the_slope_of_contact_is_that_of_its_force_and_nothing_above_the_floor(
    depth: float,
) -> None:
    v = ca.SX.sym("v", 3)
    normal = ca.SX([0.0, 0.6, 0.8])
    dt = 1e-3
    force, slope = ContactModel().force(ca.SX(depth), v, normal, ca.SX(dt))
    sinking = ca.DM([0.0, -0.006, -0.008])
    jacobians = ca.Function("contact", [v], [slope, ca.jacobian(force, v)])(sinking)
    normal_part = [float(normal.T @ matrix @ normal) for matrix in jacobians]
    assert normal_part[0] == pytest.approx(-normal_part[1], abs=1e-9)


@pytest.mark.parametrize("depth", [1e-4, 0.1])
def test_the_floor_holds_back_nothing_that_leaves_it(depth: float) -> None:
    """The damper would pull; a spring and damper in series with a floor that only pushes let go."""
    v = ca.SX.sym("v", 3)
    normal = ca.SX([0.0, 0.6, 0.8])
    force, slope = ContactModel().force(ca.SX(depth), v, normal, ca.SX(1e-3))
    for part in ca.Function("contact", [v], [force, slope])(ca.DM([0.3, 1.2, 1.6])):
        np.testing.assert_array_equal(np.array(part), 0.0)
