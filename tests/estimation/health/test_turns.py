"""Gyro and attitude turn apart: which of the two is blamed, and when an attitude that is refused is
believed.
"""

from __future__ import annotations

import ctypes
import math
from typing import Any

import pytest

from uvms_ocp.codegen.kernel_layout import structure_of
from uvms_ocp.codegen.kernels import bind_kernels
from uvms_ocp.estimation.health.redundancy import (
    RateAgainstAttitude,
    TurnCulprit,
    compare_turns,
    is_estimate_turning,
    update_rate,
)

DT = 0.01  # [s]
STEP = 0.2  # [rad], [rad/s]


def _heading(angle: float) -> Any:
    return (ctypes.c_double * 4)(0.0, 0.0, math.sin(0.5 * angle), math.cos(0.5 * angle))


def _about_z(value: float) -> Any:
    return (ctypes.c_double * 3)(0.0, 0.0, value)


class TurnComparison:
    """Gyro and attitude about z, read at the same ticks."""

    def __init__(self) -> None:
        structure = structure_of(RateAgainstAttitude)
        self.memory = structure()
        self.memory.tolerance = 0.05
        self.memory.slow_tolerance = 0.01
        self.memory.t = self.memory.step_t = self.memory.disagreed_t = -math.inf
        self.memory.turn[3] = 1.0
        self._update, self._compare, self._is_turning = bind_kernels(
            (update_rate, compare_turns, is_estimate_turning), (structure,)
        )

    def read(self, rate: float, heading: float, t: float) -> None:
        self._update(self.memory, _about_z(rate), t)
        self._compare(self.memory, _heading(heading), t)

    def is_believed(self, heading: float, offset: float, t: float, *, is_first: bool) -> bool:
        """The verdict on an attitude that is off the estimate by the offset [rad]."""
        return bool(self._is_turning(self.memory, _heading(heading), _about_z(offset), t, is_first))


@pytest.mark.parametrize("silent_from", [0.0, 1.0])
def test_an_attitude_that_is_refused_while_the_gyro_is_silent_is_not_believed_when_it_is_back(
    silent_from: float,
) -> None:
    """One was passed on to the filter at once, by whatever it was off."""
    turns = TurnComparison()
    refused = 0
    for k in range(800):
        t = k * DT
        is_silent = silent_from <= t < silent_from + 4.0
        if not is_silent:
            turns.read(0.0, STEP, t)
        if t >= 0.5:
            assert not turns.is_believed(STEP, STEP, t, is_first=refused == 0)
            refused += 1


def test_an_estimate_that_turns_away_is_found_after_a_silence_of_the_gyro() -> None:
    turns = TurnComparison()
    believed = [0.0]
    for k in range(800):
        t = k * DT
        if not 1.0 <= t < 4.0:
            turns.read(0.0, STEP, t)
        if t >= 2.5 and turns.is_believed(STEP, 0.1 * t, t, is_first=t < 2.5 + DT):
            believed.append(t)
    assert 4.0 < believed[1] < 6.0


@pytest.mark.parametrize("silence", [math.inf, 3.0])
def test_what_a_gyro_reads_first_is_no_step_of_it(silence: float) -> None:
    """An attitude that drifts is as likely: a gyro that begins, or is back, while the vehicle turns
    was taken for one that had jumped.
    """
    turns = TurnComparison()
    begin = 0.0
    if silence < math.inf:
        begin = 4.0 + silence
        for k in range(400):
            turns.read(0.0, 0.0, k * DT)
    for k in range(180):
        turns.read(STEP, 1.5 * STEP * k * DT, begin + k * DT)
    assert turns.memory.disagreed_t > begin
    assert turns.memory.culprit == TurnCulprit.UNKNOWN


@pytest.mark.parametrize("first", list(TurnCulprit)[1:])
def test_a_fault_soon_after_one_of_the_other_sensor_has_its_own_culprit(
    first: TurnCulprit,
) -> None:
    """Within 2 s it was blamed on the one before, for as long as it lasted."""
    turns = TurnComparison()
    blamed: dict[float, int] = {}
    for k in range(1200):
        t = k * DT
        if first == TurnCulprit.GYRO:
            rate = STEP if 3.0 <= t < 4.0 else 0.0
            heading = STEP if t >= 5.6 else 0.0
        else:
            heading = STEP if t >= 3.0 else 0.0
            rate = STEP if t >= 5.6 else 0.0
        turns.read(rate, heading, t)
        if turns.memory.quick_rate > 0.0:
            blamed[t] = turns.memory.culprit
    other = TurnCulprit.GYRO if first == TurnCulprit.ATTITUDE else TurnCulprit.ATTITUDE
    assert {culprit for t, culprit in blamed.items() if t < 5.6} == {first}
    assert {culprit for t, culprit in blamed.items() if t > 5.6} == {other}


def test_a_gyro_that_stays_wrong_is_blamed_for_as_long() -> None:
    turns = TurnComparison()
    blamed = set()
    for k in range(1200):
        t = k * DT
        turns.read(STEP if t >= 2.0 else 0.0, 0.0, t)
        if turns.memory.quick_rate > 0.0:
            blamed.add(turns.memory.culprit)
    assert blamed == {TurnCulprit.GYRO}
