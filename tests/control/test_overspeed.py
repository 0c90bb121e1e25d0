"""Brakes lock joints that outrun their limits unasked while their posture is doubtful, and only
those.
"""

from __future__ import annotations

import pytest

from uvms_ocp.codegen.kernel_layout import structure_of
from uvms_ocp.control.force.overspeed import (
    OverspeedMemory,
    locks_at_overspeed,
    start_overspeed,
)

DT = 0.02
LIMIT = 0.8  # [rad/s]
FIRST = 1  # joints come after one axis of the vehicle


def guard() -> OverspeedMemory:
    memory = structure_of(OverspeedMemory, n_joints=2)()
    memory.count = 2
    memory.limit[:] = [LIMIT, LIMIT]
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
        v = [9.0, 0.0, rate]
        reference = [0.0, 0.0, asked * rate]
        if locks_at_overspeed(memory, FIRST, v, reference, t <= doubted, t):
            return t, rate
    return end, 0.0


@pytest.mark.parametrize("acceleration", [-8.0, -1.0, 1.0, 8.0])
def test_brakes_lock_before_the_limit_is_passed(acceleration: float) -> None:
    memory = guard()
    _, rate = first_lock(memory, acceleration=acceleration, asked=0.0, doubted=0.0)
    assert 0.5 * LIMIT <= abs(rate) <= LIMIT
    assert memory.joint == 1


@pytest.mark.parametrize(("asked", "doubted"), [(1.0, 0.0), (0.0, -1.0)])
def test_what_is_asked_for_or_never_was_doubted_locks_nothing(asked: float, doubted: float) -> None:
    memory = guard()
    assert first_lock(memory, acceleration=1.0, asked=asked, doubted=doubted) == (2.0, 0.0)


def test_a_joint_that_falls_again_is_locked_for_longer() -> None:
    memory = guard()
    locks = list[float]()
    for k in range(round(60.0 / DT)):
        t = k * DT
        locks_at_overspeed(memory, FIRST, [0.0, 2.0, 0.0], [0.0, 0.0, 0.0], t == 0.0, t)
        if memory.joint >= 0:
            locks.append(memory.lock)
    assert locks == [0.5, 4.0, 32.0, 64.0]


def test_a_doubt_is_forgotten() -> None:
    memory = guard()
    locks_at_overspeed(memory, FIRST, [0.0] * 3, [0.0] * 3, True, 0.0)
    assert not locks_at_overspeed(memory, FIRST, [0.0, 2.0, 0.0], [0.0] * 3, False, 11.0)
