"""Brakes lock joints that outrun their limits unasked, whether a posture is doubted or not, and only
those; they hold while it is.
"""

from __future__ import annotations

import math

import pytest

from uvms_ocp.codegen.kernel_layout import structure_of
from uvms_ocp.control.force.overspeed import (
    OverspeedMemory,
    locks_at_overspeed,
    start_overspeed,
)

DT = 0.02
LIMIT = 0.8  # [rad/s]
VEHICLE_LIMIT = 1.0  # [m/s]
FIRST = 1  # joints come after one axis of the vehicle


def guard() -> OverspeedMemory:
    memory = structure_of(OverspeedMemory, n_joints=2)()
    memory.count = 2
    memory.limit[:] = [LIMIT, LIMIT]
    memory.vehicle_limit[0] = VEHICLE_LIMIT
    start_overspeed(memory)
    return memory


def first_lock(
    memory: OverspeedMemory, *, acceleration: float, asked: float, doubted: float, end: float = 2.0
) -> tuple[float, float]:
    """Time [s] of the first lock of a second joint that gains speed, and its speed [rad/s] then; a
    doubt lasts until `doubted` [s].
    """
    for k in range(round(end / DT)):
        t = k * DT
        rate = acceleration * t
        v = [9.0, 0.0, rate]  # a fast vehicle is no fast joint
        reference = [9.0, 0.0, asked * rate]
        if locks_at_overspeed(memory, FIRST, v, reference, t <= doubted, t):
            return t, rate
    return end, 0.0


@pytest.mark.parametrize("doubted", [-1.0, 0.0])
@pytest.mark.parametrize("acceleration", [-8.0, -1.0, 1.0, 8.0])
def test_brakes_lock_before_the_limit_is_passed(acceleration: float, doubted: float) -> None:
    memory = guard()
    _, rate = first_lock(memory, acceleration=acceleration, asked=0.0, doubted=doubted)
    assert 0.5 * LIMIT <= abs(rate) <= LIMIT
    assert memory.joint == 1


@pytest.mark.parametrize("doubted", [-1.0, 2.0])
def test_what_is_asked_for_locks_nothing(doubted: float) -> None:
    memory = guard()
    assert first_lock(memory, acceleration=1.0, asked=1.0, doubted=doubted) == (2.0, 0.0)


@pytest.mark.parametrize("late", [0, 1, 2])
def test_a_joint_that_does_what_was_asked_a_little_ago_locks_nothing(late: int) -> None:
    """What is asked may turn about in one tick, at the edge of a reach; a light arm that followed was
    locked for 32 s.
    """
    memory = guard()
    asked = [0.34 * LIMIT * (-1.0 if k % 4 else 1.0) for k in range(60)]
    for k in range(len(asked)):
        reference = [0.0, asked[k], 0.0]
        v = [0.0, asked[k - late] if k >= late else 0.0, 0.0]
        assert not locks_at_overspeed(memory, FIRST, v, reference, True, k * DT)


def test_a_joint_that_is_thrown_within_a_tick_is_not_let_go_soon() -> None:
    """It was at 5 times its limit whenever brakes let go, before they could act."""
    memory = guard()
    locks_at_overspeed(memory, FIRST, [0.0] * 3, [0.0] * 3, False, 0.0)
    assert locks_at_overspeed(memory, FIRST, [0.0, 2.0, 0.0], [0.0] * 3, False, DT)
    assert memory.lock == 32.0


def test_a_joint_that_falls_again_is_locked_for_longer() -> None:
    memory = guard()
    locks = list[float]()
    memory.before[:] = [LIMIT, 0.0]
    locked = False
    for k in range(round(120.0 / DT)):
        t = k * DT
        v = [0.0, 0.0 if locked else 1.1 * LIMIT, 0.0]
        if not locked:
            memory.before[:] = [LIMIT, 0.0]
        locked = locks_at_overspeed(memory, FIRST, v, [0.0, 0.0, 0.0], t == 0.0, t)
        if memory.joint >= 0:
            locks.append(memory.lock)
    assert locks == [0.5, 32.0, 64.0, 64.0]


@pytest.mark.parametrize("cause", ["doubt", "vehicle"])
@pytest.mark.parametrize("end", [0.2, 3.0, 20.0])
def test_a_lock_holds_as_long_as_an_encoder_is_doubted_or_a_vehicle_is_carried_off(
    end: float, cause: str
) -> None:
    """A lock of 4 s ended while an encoder drifted on, and the arm fell at 1.4 times its limit; one
    of half a second while a thruster that pushed the other way turned the vehicle, at 2.0 times.
    """
    memory = guard()
    memory.before[:] = [LIMIT, 0.0]
    locked = list[float]()
    for k in range(round(30.0 / DT)):
        t = k * DT
        rate = 1.1 * LIMIT if k == 0 else 0.0
        doubted = cause == "doubt" and t <= end
        speed = -0.7 if cause == "vehicle" and t <= end else 0.3
        if locks_at_overspeed(memory, FIRST, [speed, rate, 0.0], [0.0] * 3, doubted, t):
            locked.append(t)
    assert max(locked) == pytest.approx(end + 0.5, abs=0.35)


@pytest.mark.parametrize("dt", [0.02, 0.05])
@pytest.mark.parametrize(("mean", "noise"), [(0.0, 0.1), (0.12, 0.0), (-0.12, 0.12)])
def test_a_joint_that_seems_to_move_though_it_is_locked_stays_locked_and_is_named_once(
    mean: float, noise: float, dt: float
) -> None:
    """An encoder that drifted by 0.2 rad/s went on under the brakes; let go after half a second, the
    arm was at 1.6 times its limit.
    """
    memory = guard()
    memory.before[:] = [LIMIT, 0.0]
    locked = list[float]()
    named = list[int]()
    for k in range(round(5.0 / dt)):
        rate = 1.1 * LIMIT if k == 0 else (mean + noise * (-1.0) ** k) * LIMIT
        if locks_at_overspeed(memory, FIRST, [0.0, rate, 0.0], [0.0] * 3, False, k * dt):
            locked.append(k * dt)
        if memory.moving >= 0:
            named.append(memory.moving)
    assert max(locked) == pytest.approx(5.0 if mean else 0.5, abs=2.1 * dt)
    assert named == ([0] if mean else [])


@pytest.mark.parametrize("cause", ["readings", "vehicle"])
def test_a_quick_loop_locks_an_arm_that_falls_again_however_long_it_was_locked(cause: str) -> None:
    """Its encoder drifted on for longer than 10 s under the brakes: let go, it was never locked again."""
    memory = guard()
    memory.before[:] = [LIMIT, 0.0]
    end = 15.0
    locked = list[bool]()
    for k in range(1800):
        t = 0.01 * k
        speed = -0.7 if cause == "vehicle" and t < end else 0.0
        rate = 0.1 * LIMIT if cause == "readings" and t < end else 0.0
        if k == 0:
            rate = 1.1 * LIMIT
        if t > end + 2.0:
            rate = LIMIT * min(2.0, 4.0 * (t - end - 2.0))
        v = [speed, rate, 0.0]
        locked.append(locks_at_overspeed(memory, FIRST, v, [0.0] * 3, k == 0, t))
    assert all(locked[:1500])
    assert not any(locked[1650:1700])
    assert locked[-1]
    assert memory.lock == 32.0


@pytest.mark.parametrize("dt", [0.005, 0.02, 0.05])
@pytest.mark.parametrize("late", [0.0, 0.1, 0.2, 0.4])
@pytest.mark.parametrize("mean", [0.0, 0.12])
def test_rates_that_arrive_late_tell_no_motion_under_brakes(
    mean: float, late: float, dt: float
) -> None:
    """Those of the fall itself came 0.2 s after it, and the readings were called wrong. A joint that
    does move is known before it is let go.
    """
    memory = guard()
    memory.late = late
    memory.before[:] = [2.0 * LIMIT, 0.0]
    named = list[float]()
    locked = list[float]()
    for k in range(round(3.0 / dt)):
        t = k * dt
        rate = 2.0 * LIMIT if t <= late else mean * LIMIT
        if locks_at_overspeed(memory, FIRST, [0.0, rate, 0.0], [0.0] * 3, t == 0.0, t):
            locked.append(t)
        if memory.moving >= 0:
            named.append(t)
    assert len(named) == (mean > 0.0)
    assert max(locked) == pytest.approx(3.0 if mean else 0.5 + late, abs=2.1 * dt)


def test_a_rate_that_is_no_number_is_no_reason_to_let_go() -> None:
    memory = guard()
    memory.before[:] = [LIMIT, 0.0]
    for k in range(100):
        rate = 0.12 * LIMIT
        if k == 0:
            rate = 1.1 * LIMIT
        if k == 4:
            rate = math.nan
        locked = locks_at_overspeed(memory, FIRST, [0.0, rate, 0.0], [0.0] * 3, False, 0.05 * k)
        assert locked


@pytest.mark.parametrize("worst", [0, 1])
def test_of_joints_that_seem_to_move_though_they_are_locked_the_worst_is_named(worst: int) -> None:
    memory = guard()
    memory.before[:] = [LIMIT, 0.0]
    named = list[int]()
    for k in range(50):
        rates = [0.1 * LIMIT, 0.1 * LIMIT]
        rates[worst] = 0.3 * LIMIT
        if k == 0:
            rates = [1.1 * LIMIT, 0.0]
        locks_at_overspeed(memory, FIRST, [0.0, *rates], [0.0] * 3, False, k * DT)
        if memory.moving >= 0:
            named.append(memory.moving)
    assert named == [worst]


def test_a_fall_long_after_another_is_a_new_one() -> None:
    memory = guard()
    memory.before[:] = [LIMIT, 0.0]
    for t in (0.0, 20.0, 40.0):
        assert locks_at_overspeed(memory, FIRST, [0.0, 1.1 * LIMIT, 0.0], [0.0] * 3, False, t)
        assert memory.lock == 0.5


@pytest.mark.parametrize("doubted", [False, True])
def test_a_quick_loop_catches_an_arm_whose_posture_is_sound(doubted: bool) -> None:
    """At 200 Hz it does, and learns the load that made it fall: locked, it never would."""
    memory = guard()
    locks = list[bool]()
    for k in range(400):
        rate = 1.1 * LIMIT * min(1.0, max(0.0, 0.1 * (k - 200)))
        fast = [0.0, rate, 0.0]
        locks.append(locks_at_overspeed(memory, FIRST, fast, [0.0] * 3, doubted, 0.005 * k))
    assert any(locks) == doubted


@pytest.mark.parametrize("dt", [0.005, 0.01, 0.05])
@pytest.mark.parametrize(("size", "half_swing"), [(0.17, 0.05), (0.2, 0.15), (0.24, 0.1)])
def test_a_joint_that_a_loop_shakes_is_locked_by_quick_loops_too(
    size: float, half_swing: float, dt: float
) -> None:
    """An encoder that had drifted by a radian had a loop of 100 Hz shake an arm at 2.1 times its limit
    for as long as it drifted.
    """
    memory = guard()
    locked = list[float]()
    for k in range(round(1.0 / dt)):
        t = k * dt
        rate = size * LIMIT * (1.0 if int(t / half_swing + 1e-6) % 2 else -1.0)
        v = [0.0, 0.0, 0.1 * LIMIT + rate]
        if locks_at_overspeed(memory, FIRST, v, [0.0, 0.0, 0.1 * LIMIT], False, t):
            locked.append(t)
            if memory.joint >= 0:
                assert memory.joint == 1
                assert memory.shaking
                assert memory.lock == 0.5
    assert locked[0] <= 3.0 * half_swing + dt


@pytest.mark.parametrize(("size", "half_swing"), [(0.1, 0.05), (0.6, 0.3)])
def test_noise_and_slow_swings_are_no_shaking(size: float, half_swing: float) -> None:
    memory = guard()
    locks_at_overspeed(memory, FIRST, [0.0] * 3, [0.0] * 3, False, -0.01)
    for k in range(500):
        t = 0.01 * k
        rate = size * LIMIT * math.sin(math.pi * t / half_swing)
        assert not locks_at_overspeed(memory, FIRST, [0.0, rate, 0.0], [0.0] * 3, False, t)


@pytest.mark.parametrize("dt", [0.005, 0.01])
def test_an_arm_that_is_thrown_is_locked_in_the_tick_in_which_it_is_seen(dt: float) -> None:
    """One of 0.5 kg was at 2.5 times its limit two ticks after it came into the hand, at 100 Hz."""
    memory = guard()
    rates = [0.0] * 200 + [0.6 * LIMIT, 1.2 * LIMIT, 1.8 * LIMIT]
    for k, rate in enumerate(rates):
        if locks_at_overspeed(memory, FIRST, [0.0, rate, 0.0], [0.0] * 3, False, dt * k):
            break
    assert rate == 0.6 * LIMIT


def test_a_quick_loop_that_does_not_catch_an_arm_soon_locks_it() -> None:
    """A load of 1.2 kg that nobody knew of threw an arm about at 19 times its limit, at 60 Hz."""
    memory = guard()
    for k in range(200):
        rate = LIMIT * min(2.0, max(0.0, 0.1 * (k - 100)))
        fast = [0.0, rate, 0.0]
        if locks_at_overspeed(memory, FIRST, fast, [0.0] * 3, False, 0.01 * k):
            break
    assert 1.1 * LIMIT <= rate <= 1.25 * LIMIT
    assert memory.joint == 0


def test_an_arm_that_steadies_its_vehicle_is_left_to_a_quick_loop() -> None:
    """A lock began anew whenever a load of 4 kg let go, and no tool of six thrusters came to its
    target.
    """
    memory = guard()
    memory.steadies = True
    for k in range(200):
        rate = 2.5 * LIMIT if 100 <= k < 125 else 0.0
        assert not locks_at_overspeed(memory, FIRST, [0.0, rate, 0.0], [0.0] * 3, False, 0.01 * k)
