"""Laws of a tick of the force layer: what it wants, what it remembers, and what it does where
little can be trusted.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pinocchio as pin
import pytest
from compiler import needs_compiler
from tiny_robots import TINY, robot_of

from uvms_ocp.checks import replace_unchecked
from uvms_ocp.codegen import compile_function
from uvms_ocp.codegen.kernel_layout import arrays_of, column_view, view
from uvms_ocp.control.faults.residual_filter import ResidualFilter
from uvms_ocp.control.faults.tuning import ActuatorHealthTuning
from uvms_ocp.control.faults.verdicts import ThrusterEffectiveness
from uvms_ocp.control.force.observer import ObserverLaw
from uvms_ocp.control.force.thruster_lag import thruster_lag
from uvms_ocp.control.force.tick import ForceTick
from uvms_ocp.control.force.tick_functions import (
    ForceLaws,
    ForceOutputs,
    ForceState,
    MonitorStep,
    carry_function,
    control_function,
    observe_function,
    transfer_function,
)
from uvms_ocp.control.force.velocity_law import VelocityLaw
from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot.dynamics import Dynamics, robot_dynamics
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import Command
from uvms_ocp.robot.thrusters import thruster_matrix

DT = 1 / 100
FULL = "girona_maris7_full"
ROBOTS = (FULL, "bluerov2_alpha5", "planar5")


@lru_cache
def laws(name: str = FULL) -> ForceLaws:
    return laws_of(load_robot(name))


def laws_of(robot: Robot) -> ForceLaws:
    full_share = np.ones(robot.n_v)
    return ForceLaws(
        robot=robot,
        velocity=VelocityLaw(
            dynamics=robot_dynamics(robot).symbolic, K_p=3.0 * full_share, reset=full_share, dt=DT
        ),
        lag=thruster_lag(robot, lead=4.0, dt=DT),
        lift=500.0,
        observer=ObserverLaw(bandwidth=3.0 * full_share, limit=500.0 * full_share, dt=DT),
        residual_filter=ResidualFilter(share=0.03, every=5),
    )


@lru_cache
def dynamics(name: str) -> Dynamics:
    return robot_dynamics(load_robot(name))


def scene(name: str, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """A configuration and a slow velocity."""
    robot = load_robot(name)
    rng = np.random.default_rng(seed)
    q = pin.integrate(
        robot.model, np.array(robot.configuration()), 0.3 * rng.normal(size=robot.n_v)
    )
    return q, 0.02 * rng.normal(size=robot.n_v)


def give(
    tick: ForceTick, q: np.ndarray, v: np.ndarray, command: Command, feedback: tuple[float, float]
) -> None:
    """Inputs as the velocity layer would ask; feedback: shares of the bandwidths of vehicle and joints."""
    inputs = tick.inputs
    inputs.q[:] = q
    inputs.v[:] = v
    inputs.reference[:] = command.v
    inputs.feedback[0], inputs.joint_feedback[0] = feedback
    inputs.hold[0] = command.hold
    inputs.stop[0] = command.stop
    tick.memory.brakes = command.brakes


def run(
    tick: ForceTick,
    t: float,
    *,
    joint_age: float = 0.0,
    encoders_trusted: bool = True,
    joint_rates_lost: bool = False,
) -> list[np.ndarray]:
    """The parts of `ForceOutputs` at time t."""
    memory = tick.memory
    memory.t = t
    memory.joint_age = joint_age
    memory.encoders_trusted = encoders_trusted
    memory.joint_rates_lost = joint_rates_lost
    return tick.step()


def ticked(
    tick: ForceTick, q: np.ndarray, v: np.ndarray, command: Command, *, joints: bool = True
) -> ForceOutputs:
    give(tick, q, v, command, (1.0, 1.0))
    told = run(tick, 0.0, joint_age=0.0 if joints else 1.0)
    return ForceOutputs(**dict(zip(ForceOutputs.__dataclass_fields__, told, strict=True)))


@pytest.mark.sampled
@pytest.mark.parametrize("name", ROBOTS)
def test_without_errors_the_force_is_that_of_the_model(name: str) -> None:
    """That of the motors is for a vehicle that accelerates as its thrusters push it."""
    tick = ForceTick(laws(name))
    robot = laws(name).robot
    q, v = scene(name)
    n = robot.n_vehicle
    tick.state.before[:] = v
    first = ticked(tick, q, v, Command(v=v))
    expected = dynamics(name).inverse_dynamics(q, v, np.zeros(robot.n_v))
    np.testing.assert_allclose(first.vehicle_force, expected[:n], rtol=1e-9, atol=1e-9)
    limit = robot.limits.effort
    assert (np.abs(first.torque) < limit).all()
    mean_thrust = laws(name).lag.mean(np.zeros(len(first.command)), first.command)
    wrench = thruster_matrix(robot) @ mean_thrust
    force = np.concatenate([wrench[:n], first.torque])
    acceleration = dynamics(name).forward_dynamics(q, v, force)
    np.testing.assert_allclose(acceleration[n:], 0.0, atol=1e-9)


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("measured", "lost", "share"), [(True, False, 1.0), (True, True, 0.25), (False, False, 0.25)]
)
def test_joints_keep_their_bandwidth_where_sensors_tell_their_rates(
    measured: bool, lost: bool, share: float
) -> None:
    """At a quarter of it an arm whose encoders were doubted alone fell from its posture."""
    tick = ForceTick(replace(laws(), measures_joint_rates=measured))
    robot = laws().robot
    q, v = scene(FULL)
    for k in range(800):
        give(tick, q, v, Command(v=v), (1.0, 0.25))
        run(tick, k * DT, joint_rates_lost=lost)
    np.testing.assert_allclose(tick.state.share[robot.joint_v], share, rtol=1e-3)


@pytest.mark.sampled
@pytest.mark.parametrize("name", [FULL, "planar5"])
def test_a_push_that_the_model_does_not_know_is_found_and_worked_against(name: str) -> None:
    tick = ForceTick(laws(name))
    q, _ = scene(name)
    model = dynamics(name)
    rng = np.random.default_rng(1)
    still = Command(v=np.zeros(laws(name).robot.n_v))
    push = np.minimum(0.1 * np.diag(model.mass_matrix(q)), 5.0) * rng.normal(size=len(still.v))
    v = np.zeros(len(push))
    for _ in range(1000):  # of a place where q stays as it is
        told = ticked(tick, q, v, still)
        gains = np.concatenate(
            [
                (thruster_matrix(laws(name).robot) @ tick.observed.thrust)[
                    : len(told.vehicle_force)
                ],
                told.torque,
            ]
        )
        acceleration = model.forward_dynamics(q, v, gains + push)
        v = v + DT * acceleration
    np.testing.assert_allclose(told.disturbance, push, atol=1e-3 * np.abs(push).max())
    np.testing.assert_allclose(v, 0.0, atol=1e-4)


@pytest.mark.sampled
@needs_compiler
@pytest.mark.parametrize("name", ROBOTS)
def test_compiled_and_not_a_tick_gives_the_same(name: str) -> None:
    rng = np.random.default_rng(2)
    for function in (
        carry_function(laws(name)),
        transfer_function(laws(name)),
        observe_function(laws(name)),
        control_function(laws(name)),
    ):
        compiled = compile_function(function)
        for _ in range(5):
            arguments = [rng.normal(size=function.size1_in(i)) for i in range(function.n_in())]
            expected = np.array(function(*arguments))
            np.testing.assert_allclose(
                np.array(compiled(*arguments)),
                expected,
                rtol=0,
                atol=1e-12 * np.abs(expected).max(),
            )


@pytest.mark.parametrize("name", ROBOTS[:2])
@pytest.mark.parametrize("known", [True, False])
def test_what_holds_locked_joints_is_what_held_them_whatever_their_readings_become(
    name: str, known: bool
) -> None:
    """An encoder off by half a radian was believed as brakes let go, and the arm fell from where it was.
    Unless it is the first reading: what came before was no posture.
    """
    tick = ForceTick(laws(name))
    robot = laws(name).robot
    q, _ = scene(name)
    rest = np.zeros(robot.n_v)
    displaced = q.copy()
    displaced[robot.joint_q] += 0.5

    def held(q: np.ndarray, joint_age: float) -> np.ndarray:
        give(tick, q, rest, Command(v=rest), (1.0, 1.0))
        run(tick, 0.0, joint_age=joint_age)
        return np.array(tick.memory.desired.force)[robot.n_vehicle :]

    locked = held(q, 1.0 if known else np.inf)
    tick.state.follows[0] = 0.0  # the observer has not seen the vehicle fall meanwhile
    free = held(displaced, 0.0)
    weight = dynamics(name).inverse_dynamics(displaced, rest, rest)[robot.n_vehicle :]
    assert np.abs(weight - locked).max() > 0.01 * np.abs(weight).max()
    np.testing.assert_allclose(free, locked if known else weight, rtol=1e-9, atol=1e-9)


@pytest.mark.sampled
@pytest.mark.parametrize("name", ROBOTS[:2])
def test_readings_that_come_back_under_brakes_change_nothing_though_the_disturbance_was_limited(
    name: str,
) -> None:
    """What the limit had cut off on the way there was missing on the way back."""
    limit = 0.02
    usual = laws(name)
    observer = replace(usual.observer, limit=limit * np.ones(usual.robot.n_v))
    tick = ForceTick(replace(usual, observer=observer))
    robot = usual.robot
    q, _ = scene(name)
    rest = np.zeros(robot.n_v)
    tick.state.estimate[robot.n_vehicle :] = 0.01
    estimates = []
    for away in (0.0, 0.2, 0.5, 1.0, -0.5, 0.0):
        displaced = q.copy()
        displaced[robot.joint_q] += away
        give(tick, displaced, rest, Command(v=rest), (1.0, 1.0))
        run(tick, 0.0, joint_age=1.0)
        estimates.append(tick.observed.estimate[robot.n_vehicle :].copy())
    assert np.abs(estimates).max() == limit
    np.testing.assert_allclose(estimates[-1], estimates[0], rtol=0.0, atol=1e-12)


def test_a_tick_tells_arrays_of_its_own() -> None:
    tick = ForceTick(laws())
    q, v = scene(FULL)
    first = ticked(tick, q, v, Command(v=v))
    first_outputs = {
        name: getattr(first, name).copy() for name in ForceOutputs.__dataclass_fields__
    }
    ticked(tick, q, -v, Command(v=-3.0 * v))
    for name, value in first_outputs.items():
        np.testing.assert_array_equal(getattr(first, name), value)


def busy(ticks: int = 30) -> tuple[ForceTick, np.ndarray, np.ndarray]:
    """After so many ticks that lag behind what is asked."""
    tick = ForceTick(laws())
    q, v = scene(FULL)
    for _ in range(ticks):
        ticked(tick, q, v, Command(v=2.0 * v))
    return tick, q, v


def known(tick: ForceTick) -> ForceState:
    """Now, in arrays of its own."""
    return ForceState(
        **{name: getattr(tick.observed, name).copy() for name in ForceState.__dataclass_fields__}
    )


@pytest.mark.sampled
@pytest.mark.parametrize("dt", [1 / 20, 1 / 100, 1 / 200])
def test_brakes_that_lock_ask_no_acceleration_of_thrusters(dt: float) -> None:
    """The reference of joints ends at once where brakes lock: taken for an acceleration, the
    thrusters were to bear it.
    """
    usual = laws()
    q, v = scene(FULL)
    slower = replace(
        usual,
        velocity=replace(usual.velocity, dt=dt),
        lag=thruster_lag(usual.robot, lead=4.0, dt=dt),
        observer=None,
        residual_filter=None,
    )
    tick = ForceTick(slower)
    n = usual.robot.n_vehicle
    stopped = np.concatenate([v[:n], np.zeros(usual.robot.n_joints)])
    tick.state.before[:] = v
    ticked(tick, q, v, Command(v=v))
    locked = ticked(tick, q, stopped, Command(v=stopped, brakes=True))
    expected = dynamics(FULL).inverse_dynamics(q, stopped, np.zeros(len(v)))
    np.testing.assert_allclose(locked.vehicle_force, expected[:n], rtol=1e-9, atol=1e-9)


def test_a_velocity_that_is_not_to_be_trusted_is_not_fed_back_and_changes_no_disturbance() -> None:
    commands = []
    integrals = []
    for wrong in (1.0, -100.0):
        tick, q, v = busy()
        before = known(tick)
        command = Command(v=2.0 * v, hold=True)
        commands.append(ticked(tick, q, wrong * v, command, joints=False))
        np.testing.assert_array_equal(tick.observed.estimate, before.estimate)
        assert not tick.observed.follows[0]
        integrals.append(known(tick).integral)
    np.testing.assert_array_equal(commands[0].command, commands[1].command)
    np.testing.assert_array_equal(commands[0].torque, commands[1].torque)
    np.testing.assert_array_equal(integrals[0], integrals[1])


def test_joints_that_are_not_to_be_trusted_leave_the_vehicle_as_it_is() -> None:
    tick, q, v = busy()
    n = laws().robot.n_vehicle
    ticked(tick, q, v, Command(v=2.0 * v), joints=False)
    error = arrays_of(tick.memory.desired).error
    np.testing.assert_array_equal(error[:n], v[:n])
    np.testing.assert_array_equal(error[n:], 0.0)


def test_what_a_doubted_joint_seems_to_do_as_brakes_lock_it_is_no_disturbance() -> None:
    """An encoder that ran away was taken for a force of 96 N m, which threw the arm at its release."""
    tick, q, v = busy()
    n = laws().robot.n_vehicle
    before = known(tick)
    v[n + 1] = 2.0 * laws().robot.limits.velocity[n + 1]
    give(tick, q, v, Command(v=np.zeros(len(v))), (1.0, 1.0))
    run(tick, 0.0, encoders_trusted=False)
    assert tick.memory.overspeed.joint == 1
    np.testing.assert_array_equal(tick.observed.estimate[n:], before.estimate[n:])


def test_a_stop_cuts_the_thrust_and_forgets() -> None:
    tick, q, v = busy()
    stop = Command(v=np.zeros(len(v)), hold=True, stop=True)
    told = ticked(tick, q, v, stop)
    n = laws().robot.n_vehicle
    for array in (told.command, told.vehicle_force, told.disturbance, tick.observed.integral[:n]):
        np.testing.assert_array_equal(array, 0.0)
    assert np.abs(told.torque).max() > 0.0


def test_the_monitor_hears_only_what_can_be_trusted() -> None:
    tick, q, v = busy(4)
    steps = [known(tick)]
    for command, joints in (
        (Command(v=v), True),
        (Command(v=v, hold=True), True),
        (Command(v=v), False),
    ):
        ticked(tick, q, v, command, joints=joints)
        steps.append(known(tick))
    assert [MonitorStep(int(step.watch[0])) for step in steps] == [
        MonitorStep.TAKES_IN,
        MonitorStep.DUE,
        MonitorStep.PAUSED,
        MonitorStep.PAUSED,
    ]
    for paused in steps[2:]:
        np.testing.assert_array_equal(paused.asked, steps[1].asked)
        np.testing.assert_array_equal(paused.way, steps[1].way)


def test_the_bandwidths_of_vehicle_and_joints_come_to_what_each_bears() -> None:
    tick = ForceTick(laws())
    q, v = scene(FULL)
    n = laws().robot.n_vehicle
    for k in range(1, 200):
        give(tick, q, v, Command(v=v), (0.2, 0.5))
        run(tick, 0.0)
        np.testing.assert_allclose(tick.observed.share[:n], 0.2 + 0.8 * (1.0 - DT) ** k)
        np.testing.assert_allclose(tick.observed.share[n:], 0.5 + 0.5 * (1.0 - DT) ** k)
    assert tick.observed.watch[0] == MonitorStep.PAUSED


def test_a_verdict_moves_what_a_thruster_fails_to_give_from_the_disturbance_to_the_model() -> None:
    tick, q, v = busy()
    matrix = thruster_matrix(laws().robot)
    before = known(tick)
    effectiveness = ThrusterEffectiveness(
        share=np.r_[0.0, 0.5, np.ones(6)], constant=np.r_[3.0, np.zeros(7)]
    )
    tick.memory.detection.n_vehicle = 6
    tick.memory.detection.effectiveness.share[:] = effectiveness.share
    tick.memory.detection.effectiveness.constant[:] = effectiveness.constant
    tick._adapt(tick.memory)
    acting = matrix @ effectiveness.given(before.thrust) + tick.observed.estimate[:6]
    np.testing.assert_allclose(
        acting, matrix @ before.thrust + before.estimate[:6], rtol=1e-12, atol=1e-9
    )
    for _ in range(200):
        told = ticked(tick, q, v, Command(v=2.0 * v))
    np.testing.assert_allclose(
        told.command[0], 0.0, atol=1e-6, err_msg="nothing is asked of what does not follow"
    )


def test_a_thrust_that_limits_keep_from_being_reached_is_told() -> None:
    tick = ForceTick(laws())
    q, v = scene(FULL)
    command = ticked(tick, q, v, Command(v=np.full(len(v), 50.0))).command
    limits = laws().lag
    assert tick.memory.allocation.saturated
    assert (command >= limits.lower).all()
    assert (command <= limits.upper).all()


def test_a_force_that_is_no_number_is_refused_and_what_was_known_stays() -> None:
    tick, q, v = busy(3)
    before = bytes(tick.memory.state)
    give(tick, q, np.full(len(v), np.nan), replace_unchecked(Command(v=v), hold=False), (1.0, 1.0))
    with pytest.raises(InvalidInput, match="finite"):
        run(tick, 0.0)
    assert bytes(tick.memory.state) == before


def test_whatever_is_given_what_is_told_and_remembered_is_numbers() -> None:
    tick = ForceTick(replace(laws(), search=ActuatorHealthTuning()))
    rng = np.random.default_rng(6)
    refused = 0
    q, v = scene(FULL)
    for k in range(2000):
        give(tick, q, v * rng.normal(), Command(v=v * rng.normal(), hold=k % 97 == 0), (1.0, 1.0))
        parts = (tick.inputs.q, tick.inputs.v, tick.inputs.reference, tick.inputs.feedback)
        spoilt = parts[k % 4]
        if k % 10 == 0:
            spoilt[rng.integers(len(spoilt))] = rng.choice([np.nan, np.inf, -np.inf, 1e300, -1e20])
        try:
            assert all(np.isfinite(part).all() for part in run(tick, 0.01 * k))
        except InvalidInput:
            refused += 1
        assert np.isfinite(column_view(tick.memory.state)).all()
        assert np.isfinite(view(tick.memory.detection.gone)).all()
    assert 100 < refused < 200


def test_without_joints_brakes_lock_where_the_vehicle_holds() -> None:
    """There are no encoders that could be silent."""
    robot = robot_of(TINY["no joints"])
    tick = ForceTick(laws_of(robot), compiled=False)
    still = np.zeros(robot.n_v)
    for hold in (True, False):
        ticked(tick, robot.configuration(), still, Command(v=still, hold=hold))
        assert bool(tick.memory.locks) == hold


def test_a_place_that_is_no_number_is_not_looked_at_though_no_force_depends_on_it() -> None:
    tick = ForceTick(replace(laws(), search=ActuatorHealthTuning()), compiled=False)
    q, v = scene(FULL)
    places = []
    for x in (1.0, np.nan, np.inf, 2.0):
        for _ in range(5):
            told = ticked(tick, np.r_[x, q[1:]], v, Command(v=v))
        assert tick.observed.watch[0] == MonitorStep.DUE
        assert np.isfinite(told.vehicle_force).all()
        places.append(tick.memory.detection.before[0])
    assert places == [1.0, 1.0, 1.0, 2.0]


@pytest.mark.sampled
@needs_compiler
@pytest.mark.parametrize("name", ROBOTS)
def test_in_c_and_in_python_a_tick_gives_the_same(name: str) -> None:
    """Up to rounding: what is smooth comes from CasADi, in C and in its virtual machine."""
    tuning = ActuatorHealthTuning(sample_time=0.02, window=0.4, settling=0.02)
    searching = replace(laws(name), search=tuning if laws(name).robot.n_vehicle else None)
    mine = ForceTick(searching)
    in_python = ForceTick(searching, compiled=False)
    q, v = scene(name)
    for k in range(40):
        command = Command(v=(2.0 + np.sin(k)) * v, hold=k == 20, stop=k == 30)
        for array, same in zip(
            *(step(tick, q, np.cos(k) * v, command, 0.01 * k) for tick in (mine, in_python)),
            strict=True,
        ):
            np.testing.assert_allclose(array, same, rtol=1e-9, atol=1e-9)


def step(
    tick: ForceTick, q: np.ndarray, v: np.ndarray, command: Command, t: float
) -> list[np.ndarray]:
    give(tick, q, v, command, (1.0, 0.9))
    return run(tick, t)
