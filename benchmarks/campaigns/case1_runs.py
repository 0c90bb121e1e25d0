"""Case 1 in water that nobody knows, for campaigns."""

from __future__ import annotations

import math

from uvms_ocp.campaign import Choice, LogNormal, Normal, Uniform, Variation
from uvms_ocp.scenario.cases.case1 import case1
from uvms_ocp.scenario.scenario import Scenario

VARIATIONS = (
    Variation("water.drag", Uniform(0.5, 1.5)),
    Variation("water.added_mass", LogNormal(1.0, 0.15)),
    Variation("current.speed", Uniform(0.0, 0.2)),
    Variation("current.heading", Uniform(-math.pi, math.pi)),
    Variation("current.gusts", Uniform(0.0, 0.03)),
    Variation("payload.mass", Uniform(0.0, 1.0)),
    Variation("thrusters.time_constant", LogNormal(1.0, 0.2)),
    Variation("sensors.noise", LogNormal(1.0, 0.3)),
    Variation(
        "sensors.unmodelled_delay", Choice((0.0, 0.02))
    ),  # none, or a tick that the estimator does not know of
    Variation("start.x", Normal(0.0, 0.3)),
    Variation("start.y", Normal(0.0, 0.3)),
    Variation("start.yaw", Normal(0.0, 0.2)),
)


def noisy_case1() -> Scenario:
    """Make Case 1 with the noise, rates and delays of its sensors."""
    return case1(noise=True, dt=0.02)


def brief_case1() -> Scenario:
    """The beginning of it, on the kinematic plant."""
    return case1(noise=True, dt=0.02, plant="kinematic", duration=0.4)


BRIEF = tuple(
    variation for variation in VARIATIONS if variation.name.startswith(("sensors", "start"))
)
