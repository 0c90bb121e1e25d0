"""No change of trust, in any channel, changes the reference by more than the acceleration limits
allow, at any rate of ticks.
"""

from __future__ import annotations

import math
from itertools import pairwise

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

from uvms_ocp.codegen.kernel_layout import assign, doubles, structure_of
from uvms_ocp.control.velocity.speed_limit import SpeedLimitMemory, limit_speed
from uvms_ocp.estimation.degraded_modes import DEGRADED_MODES, RestrictionMemory
from uvms_ocp.estimation.fallbacks import AltimeterMemory
from uvms_ocp.robot.signals import CHANNELS, ChannelHealth, StateEstimate, Trust
from uvms_ocp.scenario.cases.case1 import case1

EVERY = 0.6  # [s] between two changes
FAILURES = [frozenset({channel}) for channel in CHANNELS] + [
    mode.without for mode in DEGRADED_MODES if len(mode.without) > 1
]


@pytest.mark.slow
@pytest.mark.parametrize("dt", [1 / 20, 1 / 50, 1 / 200])
def test_the_reference_brakes_and_goes_on_within_its_acceleration_limits(dt: float) -> None:
    scenario = case1(plant="kinematic", dt=dt)
    control = scenario.kinematic_controller()
    robot = scenario.robot
    limits = robot.limits.acceleration * dt
    q = scenario.start.copy()
    commands = [np.zeros(robot.n_v)]
    moved = 0
    levels = [
        (lost, trust) for lost in FAILURES for trust in (Trust.SUSPECT, Trust.LOST, Trust.GOOD)
    ]
    begun = [0.0]
    for k in range(round(EVERY * len(levels) / dt)):
        t = k * dt
        lost, trust = levels[min(int(t / EVERY + 1e-9), len(levels) - 1)]
        if t - begun[-1] >= EVERY - 1e-9:
            begun.append(t)
        trusts = dict.fromkeys(CHANNELS, Trust.GOOD) | dict.fromkeys(lost, trust)
        health = tuple(
            ChannelHealth(channel=channel, trust=level, since=begun[-1])
            for channel, level in trusts.items()
        )
        echo = q[2] + 40.0
        if trusts["altimeter_range"] is Trust.LOST:
            echo = math.nan
        command = control(
            StateEstimate(q=q, v=commands[-1], altimeter_range=echo, health=health), t
        )
        commands.append(command.v.copy())
        q = pin.integrate(robot.model, q, command.v * dt)
        moved += np.abs(command.v).max() > 0.01
    assert moved > 0.3 * len(commands)
    for before, after in pairwise(commands):
        assert (np.abs(after - before) <= limits * (1 + 1e-6) + 1e-9).all()


@pytest.mark.parametrize("altimeter", [False, True])
def test_without_descent_neither_vehicle_nor_altimeter_sinks_in_any_attitude_and_nothing_else_changes(
    altimeter: bool,
) -> None:
    rng = np.random.default_rng(7)
    zero = doubles(np.zeros(6))
    lifted = 0
    limits = structure_of(SpeedLimitMemory, n_v=6)()
    less = structure_of(RestrictionMemory)()
    beam = structure_of(AltimeterMemory, n_v=6, look=ca.Function("look", [], []))()
    assign(limits, step=np.full(6, 1e3), has_vehicle=True)
    assign(less, speed=1.0, no_descent=True)
    for _ in range(50):
        q = rng.normal(size=7)
        q[3:] /= np.linalg.norm(q[3:])
        R = pin.Quaternion(*q[[6, 3, 4, 5]]).matrix()
        jacobian = np.concatenate([R[2], rng.normal(size=3)])
        desired = rng.normal(size=6)
        assign(beam, exists=altimeter, height_jacobian=jacobian)
        v = doubles(desired)
        assert limit_speed(limits, less, beam, doubles(q), zero, 1.0, v) == 1.0
        sinks = max(0.0, -R[2] @ desired[:3])
        if altimeter:
            sinks = max(sinks, -(jacobian @ desired))
        np.testing.assert_allclose(
            R @ v[:3], R @ desired[:3] + [0.0, 0.0, sinks], rtol=0, atol=1e-12
        )
        np.testing.assert_array_equal(v[3:], desired[3:])
        lifted += sinks > 0.0
    assert 10 < lifted < 50
