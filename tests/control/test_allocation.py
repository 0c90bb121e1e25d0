"""Laws of thrust allocation."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from scipy.linalg import null_space
from scipy.optimize import LinearConstraint, lsq_linear, minimize

from uvms_ocp.control.force.allocation import (
    Allocation,
    allocate_thrust,
    allocation_of,
    apply_effectiveness,
)
from uvms_ocp.control.force.minimum_power import majorizing_weight
from uvms_ocp.control.force.thruster_lag import ThrusterLag, thruster_lag
from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot.loading import list_robots, load_robot

ROBOTS = [name for name in list_robots() if load_robot(name).description.thrusters]
WRENCHES = np.random.default_rng(0).normal(size=(500, 6)) * np.geomspace(0.01, 3.0, 500)[:, None]


@pytest.fixture(params=ROBOTS, scope="module")
def allocation(request: pytest.FixtureRequest) -> Allocation:
    return allocation_of(load_robot(request.param))


@pytest.fixture(scope="module")
def wrenches(allocation: Allocation) -> np.ndarray:
    """From gentle to far beyond the limits, in the size of this robot."""
    return WRENCHES * np.linalg.norm(allocation.matrix * allocation.upper, axis=1)


def test_thrust_stays_inside_the_limits(allocation: Allocation, wrenches: np.ndarray) -> None:
    for wrench in wrenches:
        thrust = allocation.allocate(wrench).thrust
        assert (thrust >= allocation.lower).all()
        assert (thrust <= allocation.upper).all()


def test_reached_and_unreachable_add_up_to_the_wrench(
    allocation: Allocation, wrenches: np.ndarray
) -> None:
    for wrench in wrenches:
        result = allocation.allocate(wrench)
        np.testing.assert_allclose(result.reached, allocation.matrix @ result.thrust, atol=1e-9)
        np.testing.assert_allclose(
            result.reached + result.unreachable, wrench, rtol=1e-12, atol=1e-12
        )


def test_what_thrust_inside_the_limits_can_give_is_given_exactly(allocation: Allocation) -> None:
    rng = np.random.default_rng(1)
    for _ in range(500):
        wrench = allocation.matrix @ rng.uniform(allocation.lower, allocation.upper)
        result = allocation.allocate(wrench)
        np.testing.assert_allclose(result.reached, wrench, atol=1e-6)
        assert not result.saturated


def test_no_thrust_inside_the_limits_comes_closer(
    allocation: Allocation, wrenches: np.ndarray
) -> None:
    for wrench in wrenches:
        weight = allocation.wrench_weight
        cost = 0.5 * np.sum((weight * allocation.allocate(wrench).unreachable) ** 2)
        limits = (allocation.lower, allocation.upper)
        oracle = lsq_linear(
            weight[:, None] * allocation.matrix, weight * wrench, limits, method="bvls", tol=1e-15
        )
        assert cost <= oracle.cost + 1e-9 * (1.0 + np.sum((weight * wrench) ** 2))


@pytest.mark.parametrize("name", ROBOTS)
def test_what_is_given_up_costs_the_least_acceleration_in_the_norm_of_the_kinetic_energy(
    name: str,
) -> None:
    robot = load_robot(name)
    inertia = np.diag(pin.crba(robot.model, robot.model.createData(), robot.configuration()))[:6]
    constraint = (
        allocation_of(robot, compiled=False).wrench_weight ** 2 * inertia
    )  # Gauss: (F / m)^2 m, of each axis
    np.testing.assert_allclose(constraint, constraint[0], rtol=1e-12)


def test_optimality_conditions_hold(allocation: Allocation, wrenches: np.ndarray) -> None:
    for wrench in wrenches:
        result = allocation.allocate(wrench)
        push = allocation.matrix.T @ (
            allocation.wrench_weight**2 * result.unreachable
        )  # where more thrust would help
        tolerance = 1e-6 * (1.0 + np.linalg.norm(allocation.wrench_weight**2 * wrench))
        assert (push[result.thrust < allocation.upper - 1e-6] <= tolerance).all()
        assert (push[result.thrust > allocation.lower + 1e-6] >= -tolerance).all()


def test_saturated_says_that_limits_cost_wrench(
    allocation: Allocation, wrenches: np.ndarray
) -> None:
    weight = allocation.wrench_weight
    B = weight[:, None] * allocation.matrix
    for wrench in wrenches:
        result = allocation.allocate(wrench)
        weighted = weight * wrench
        without_limits = weighted - B @ np.linalg.lstsq(B, weighted, rcond=None)[0]
        lost = np.linalg.norm(weight * result.unreachable) - np.linalg.norm(without_limits)
        assert result.saturated == (lost > 1e-9 * np.linalg.norm(weighted))


def test_an_underactuated_vehicle_reports_roll_as_unreachable() -> None:
    result = allocation_of(load_robot("girona_maris7")).allocate([0.0, 0.0, 0.0, 10.0, 0.0, 0.0])
    assert result.unreachable[3] == pytest.approx(10.0, rel=1e-2)
    assert not result.saturated


def test_weights_decide_what_is_given_up_first() -> None:
    robot = load_robot("girona_maris7_full")
    wrench = np.array([0.0, 0.0, 900.0, 0.0, 200.0, 0.0])
    moment_first = allocation_of(robot, moment_weight=100.0).allocate(wrench).unreachable
    force_first = allocation_of(robot, force_weight=100.0).allocate(wrench).unreachable
    assert abs(moment_first[4]) < 1.0 < abs(force_first[4])
    assert abs(force_first[2]) < abs(moment_first[2])


@pytest.mark.parametrize(
    "bad", [[1.0] * 5, [np.nan] * 6, [np.inf, 0, 0, 0, 0, 0], np.zeros((6, 1))]
)
def test_a_bad_wrench_is_refused(allocation: Allocation, bad: object) -> None:
    with pytest.raises(InvalidInput, match="wrench"):
        allocation.allocate(bad)


def two_thrusters(**changes: object) -> Allocation:
    matrix = np.zeros((6, 2))
    matrix[0] = 1.0
    values = {
        "lower": -np.ones(2),
        "upper": np.ones(2),
        "power_factor": np.ones(2),
        "power_exponent": np.full(2, 1.5),
        "dead_zone": np.zeros(2),
    }
    return Allocation(**{"matrix": matrix, **values, **changes})


def test_bad_data_is_refused() -> None:
    for change in (
        {"lower": np.ones(2)},
        {"power_factor": np.zeros(2)},
        {"power_exponent": [0.5, 2.0]},
        {"dead_zone": [-1.0, 0.0]},
        {"upper": [1.0]},
    ):
        with pytest.raises(InvalidInput, match=next(iter(change))):
            two_thrusters(**change)


def test_no_command_lies_inside_the_dead_zone(allocation: Allocation, wrenches: np.ndarray) -> None:
    dead = with_dead_zone(allocation, 0.05)
    for wrench in wrenches:
        thrust = dead.allocate(wrench).thrust
        assert ((thrust == 0.0) | (np.abs(thrust) >= dead.dead_zone)).all()
        assert (thrust >= dead.lower).all()
        assert (thrust <= dead.upper).all()


def test_a_dead_zone_costs_little_wrench(allocation: Allocation, wrenches: np.ndarray) -> None:
    dead = with_dead_zone(allocation, 0.02)
    budget = np.linalg.norm(np.abs(dead.matrix) @ dead.dead_zone)
    for wrench in wrenches:
        best = np.linalg.norm(allocation.allocate(wrench).unreachable)
        assert np.linalg.norm(dead.allocate(wrench).unreachable) <= best + budget


def with_dead_zone(allocation: Allocation, share: float) -> Allocation:
    names = ("matrix", "lower", "upper", "power_factor", "power_exponent", "wrench_weight")
    return Allocation(
        **{name: getattr(allocation, name) for name in names}, dead_zone=share * allocation.upper
    )


@pytest.fixture(params=["equal", "unequal", "of other kinds"])
def powered(request: pytest.FixtureRequest, allocation: Allocation) -> Allocation:
    """The same layout, where some thrusters take more power than others."""
    n = len(allocation.upper)
    names = (
        "matrix",
        "lower",
        "upper",
        "power_factor",
        "power_exponent",
        "dead_zone",
        "wrench_weight",
    )
    values = {name: getattr(allocation, name) for name in names}
    if request.param != "equal":
        values["power_factor"] = allocation.power_factor * np.geomspace(0.4, 2.5, n)
    if request.param == "of other kinds":
        values["power_exponent"] = np.linspace(1.6, 2.0, n)
    return Allocation(**values)


def power(allocation: Allocation, thrust: np.ndarray) -> float:
    return float(allocation.power_factor @ np.abs(thrust) ** allocation.power_exponent)


def test_no_other_thrust_gives_the_same_wrench_for_less_power(powered: Allocation) -> None:
    free = null_space(powered.matrix)
    rng = np.random.default_rng(2)
    for size in np.linspace(0.1, 1.0, 20):
        wrench = powered.matrix @ (size * rng.uniform(powered.lower, powered.upper))
        thrust = powered.allocate(wrench).thrust
        assert power(powered, thrust) <= 1.005 * least_power(powered, thrust, free)


def test_gentle_thrust_is_within_a_ten_thousandth_of_the_least_power(powered: Allocation) -> None:
    free = null_space(powered.matrix)
    rng = np.random.default_rng(3)
    for _ in range(20):
        wrench = powered.matrix @ (0.2 * rng.uniform(powered.lower, powered.upper))
        thrust = powered.allocate(wrench).thrust
        assert power(powered, thrust) <= (1.0 + 1e-4) * least_power(powered, thrust, free)


def test_thrust_that_may_be_at_its_limits_is_within_a_thousandth_of_the_least_power(
    powered: Allocation,
) -> None:
    free = null_space(powered.matrix)
    rng = np.random.default_rng(4)
    for _ in range(30):
        thrust = powered.allocate(powered.matrix @ rng.uniform(powered.lower, powered.upper)).thrust
        assert power(powered, thrust) <= (1.0 + 1e-3) * least_power(powered, thrust, free)


def least_power(allocation: Allocation, thrust: np.ndarray, free: np.ndarray) -> float:
    """Found by SciPy among all thrust inside the limits with the same wrench."""
    if not free.size:
        return power(allocation, thrust)
    scale = power(allocation, allocation.upper)
    inside = LinearConstraint(free, allocation.lower - thrust, allocation.upper - thrust)
    oracle = minimize(
        lambda z: power(allocation, thrust + free @ z) / scale,
        np.zeros(free.shape[1]),
        method="SLSQP",
        constraints=inside,
        options={"ftol": 1e-14, "maxiter": 200},
    )
    return float(oracle.fun) * scale


def test_without_thrusters_nothing_is_reached() -> None:
    result = allocation_of(load_robot("planar5")).allocate(np.ones(6))
    assert result.thrust.shape == (0,)
    np.testing.assert_array_equal(result.unreachable, np.ones(6))


def test_parabolas_meet_the_power_at_the_largest_thrust_and_touch_it_elsewhere() -> None:
    factor = np.array([0.4, 1.0, 3.0])
    exponent = np.array([1.0, 1.5, 2.0])
    limit = np.array([40.0, 5.0, 150.0])
    curve = {"power_factor": factor, "power_exponent": exponent, "dead_zone": np.zeros(3)}
    powers = Allocation(
        matrix=np.eye(6)[:, :3], lower=-limit, upper=limit, **curve
    ).memory.left.powers
    np.testing.assert_allclose(
        powers.quadratic[:3] * limit**2, limit**exponent * factor, rtol=1e-12
    )
    for share in (0.1, 0.5, 1.0):
        thrust = share * limit
        weights = list(map(majorizing_weight, factor, exponent, limit, thrust))
        slope = factor * exponent * thrust ** (exponent - 1.0)
        np.testing.assert_allclose(2.0 * np.array(weights) * thrust, slope, rtol=1e-3)


def test_without_data_every_thruster_takes_the_same_power_at_its_larger_limit() -> None:
    robot = load_robot("bluerov2_alpha5")
    limits = [(-30.0 - i, 10.0 + 5.0 * i) for i in range(8)]
    thrusters = tuple(
        thruster.model_copy(update={"power": None, "minimum": low, "maximum": high, "curve": ()})
        for thruster, (low, high) in zip(robot.description.thrusters, limits, strict=True)
    )
    bare = replace(robot, description=robot.description.model_copy(update={"thrusters": thrusters}))
    allocation = allocation_of(bare)
    largest = np.maximum(-allocation.lower, allocation.upper)
    np.testing.assert_allclose(
        allocation.power_factor * largest**allocation.power_exponent, 1.0, rtol=1e-12
    )


def test_a_wrench_is_shared_out_by_the_same_bits_in_c_and_in_python(
    powered: Allocation, wrenches: np.ndarray
) -> None:
    dead = with_dead_zone(powered, 0.05)
    memory = type(dead.memory)()
    dead.write(memory)
    apply_effectiveness(memory)
    for wrench in wrenches[::50]:
        memory.wrench[:] = wrench.tolist()
        assert allocate_thrust(memory)
        result = dead.allocate(wrench)
        assert memory.thrust[: len(result.thrust)] == result.thrust.tolist()
        assert bool(memory.saturated) == result.saturated


@pytest.mark.parametrize("dt", [0.005, 0.05, 0.5])
def test_the_mean_thrust_of_a_tick_is_that_of_its_many_parts(dt: float) -> None:
    robot = load_robot("bluerov2_alpha5")
    n = len(robot.description.thrusters)
    rng = np.random.default_rng(3)
    thrust, command = rng.uniform(-30.0, 30.0, (2, n))
    n_parts = 2000
    part = thruster_lag(robot, lead=4.0, dt=dt / n_parts)
    course = [thrust]
    for _ in range(n_parts):
        course.append(part.after(course[-1], command))
    whole = thruster_lag(robot, lead=4.0, dt=dt)
    mean = np.trapezoid(course, axis=0) / n_parts
    np.testing.assert_allclose(whole.mean(thrust, command), mean, atol=1e-4)


def test_the_lead_over_the_lag_asks_nothing_inside_a_dead_zone() -> None:
    """And what is allocated is reached all the same."""
    rng = np.random.default_rng(0)
    n = 400
    dt = 0.02
    late = 0.2
    zone = rng.choice([0.0, 1.0, 3.0], n)
    lag = ThrusterLag(
        lower=np.full(n, -30.0),
        upper=np.full(n, 40.0),
        lead=np.full(n, 4.0),
        decay=np.full(n, np.exp(-dt / late)),
        mean_decay=np.full(n, -np.expm1(-dt / late) * late / dt),
        dead_zone=zone,
    )
    thrust = rng.uniform(-30.0, 40.0, n)
    desired = rng.uniform(-6.0, 6.0, n)
    desired = np.where(np.abs(desired) < zone, rng.choice([-1.0, 0.0, 1.0], n) * zone, desired)
    for _ in range(300):
        command = np.asarray(lag.command(thrust, desired, 1.0))
        assert ((command == 0.0) | (np.abs(command) >= zone)).all()
        assert ((command >= lag.lower) & (command <= lag.upper)).all()
        thrust = lag.after(thrust, command)
    np.testing.assert_allclose(thrust, desired, atol=1e-6)
