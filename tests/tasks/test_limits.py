"""Laws of bounds on velocity, of numbers and of expressions."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from uvms_ocp.tasks.approach_speed import stopping_speed

DT = 0.005
RNG = np.random.default_rng(3)
DISTANCES = np.concatenate([[-1.0, 0.0, 1e-9, np.inf], RNG.uniform(0.0, 3.0, 40)])
DECELERATIONS = np.concatenate([[0.0, np.inf, 1e-3, 0.5], RNG.uniform(0.05, 20.0, 40)])


def test_a_stopping_speed_of_numbers_is_that_of_expressions() -> None:
    distance = ca.SX.sym("distance")
    deceleration = ca.SX.sym("deceleration")
    speed = stopping_speed(distance, deceleration=deceleration, dt=DT)
    function = ca.Function("speed", [distance, deceleration], [speed])
    symbolic = [float(function(x, a)) for x, a in zip(DISTANCES, DECELERATIONS, strict=True)]
    numbers = stopping_speed(DISTANCES, deceleration=DECELERATIONS, dt=DT)
    np.testing.assert_allclose(numbers, symbolic, rtol=1e-14)


@pytest.mark.parametrize("deceleration", [0.1, 1.0, 15.0])
def test_a_stop_from_the_stopping_speed_ends_at_the_limit_at_most(deceleration: float) -> None:
    for distance in np.linspace(0.0, 2.0, 21):
        speed = float(stopping_speed(distance, deceleration=deceleration, dt=DT))
        travelled = 0.0
        while speed > 0.0:
            travelled += speed * DT
            speed -= deceleration * DT
        assert travelled <= distance + 1e-12
        assert travelled > 0.9 * distance - 1e-2


def test_beyond_the_limit_there_is_no_speed_towards_it() -> None:
    assert stopping_speed(np.array([-0.5, 0.0]), deceleration=1.0, dt=DT).tolist() == [0.0, 0.0]
