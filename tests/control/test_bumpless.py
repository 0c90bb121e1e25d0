"""Bumpless transfer: another share of the bandwidth changes no lasting force, at any rate of ticks,
with or without observer.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import casadi as ca
import numpy as np
import pytest
from test_force_tick import FULL, dynamics, give, laws, run, scene

from uvms_ocp.control.force.thruster_lag import thruster_lag
from uvms_ocp.control.force.tick import ForceTick
from uvms_ocp.control.force.tick_functions import ForceOutputs
from uvms_ocp.control.force.velocity_law import VelocityLaw
from uvms_ocp.robot.signals import Command

SHARES = (1.0, 0.25, 0.05)


@pytest.mark.sampled
@pytest.mark.parametrize("name", [FULL, "planar5"])
def test_each_axis_keeps_the_force_of_its_integral_at_another_share(name: str) -> None:
    velocity: VelocityLaw = laws(name).velocity
    q, v = (ca.SX(ca.DM(part)) for part in scene(name))
    n = laws(name).robot.n_v
    integral, before, share = (ca.SX.sym(part, n) for part in ("integral", "before", "share"))
    transferred = velocity.bumpless(q, v, integral, share, before)
    forces = [
        velocity.force(q, v, v, ca.SX(n, 1), i, part)
        for i, part in ((integral, before), (transferred, share))
    ]
    function = ca.Function("forces", [integral, before, share], forces)
    for first, second in pairwise(SHARES):
        for axis in range(n):
            old, new = (
                np.array(force).ravel() for force in function(np.eye(n)[axis], first, second)
            )
            at_rest = np.array(function(np.zeros(n), first, second)[0]).ravel()
            assert abs(old - at_rest)[axis] > 1e-3
            assert new[axis] == pytest.approx(old[axis], rel=1e-9, abs=1e-9)


@pytest.mark.sampled
@pytest.mark.parametrize(("dt", "observed"), [(1 / 20, False), (1 / 50, True), (1 / 200, False)])
def test_a_load_that_rests_is_borne_alike_whatever_share_the_loops_come_to(
    dt: float, observed: bool
) -> None:
    """Before, the lasting force went with the square of the share: a doubted DVL let a sixteenth of
    it be.
    """
    usual = laws("planar5")
    model = dynamics("planar5")
    q, _ = scene("planar5")
    observer = replace(usual.observer, dt=dt) if observed and usual.observer else None
    tick = ForceTick(
        replace(
            usual,
            velocity=replace(usual.velocity, dt=dt),
            lag=thruster_lag(usual.robot, lead=4.0, dt=dt),
            observer=observer,
            residual_filter=None,
        )
    )
    still = Command(v=np.zeros(usual.robot.n_v))
    load = 0.2 * np.array([1.0, -2.0, 1.0, -0.5, 0.2])  # that no joint passes its limit by
    v = np.zeros(usual.robot.n_v)
    torques = []
    for seconds, share in ((12.0, 1.0), (3.0, 0.25), (3.0, 1.0)):
        for _ in range(round(seconds / dt)):
            give(tick, q, v, still, (share, share))
            told = ForceOutputs(
                **dict(zip(ForceOutputs.__dataclass_fields__, run(tick, 0.0), strict=True))
            )
            for _ in range(max(1, round(dt / 0.005))):  # of a place where q stays as it is
                v = v + min(dt, 0.005) * model.forward_dynamics(q, v, told.torque + load)
            torques.append(told.torque)
    after = np.array(torques[round(12.0 / dt) - 1 :])
    assert np.abs(after - after[0]).max() < 0.02 * np.abs(load).max()
    assert np.abs(v).max() < 1e-3
