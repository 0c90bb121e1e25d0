"""Laws of the filter of a load, on disturbances made up for it: what it may know, and when it
forgets.
"""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from uvms_ocp.control.force.observer import ObserverLaw
from uvms_ocp.control.load_filter import (
    LASTING_FORCE,
    LEAST_ACCELERATION,
    MASS,
    WEIGHT,
    LoadFilter,
    LoadLearning,
    LoadSample,
)
from uvms_ocp.control.payload import ForceResponse
from uvms_ocp.errors import InvalidInput

SETTINGS = LoadLearning()
HEAVIEST = 200.0
LIMIT = np.array([200.0, 200.0, 200.0, 100.0, 100.0, 40.0])
BANDWIDTH = np.full(6, 3.0)
RNG = np.random.default_rng(0)
SLOPES = RNG.normal(size=(6, 3)) * [[40.0]] * 3 + [[30.0, 20.0, 10.0]]
WEIGHT_COLUMN = np.array([0.0, 0.1, -1.0, 0.3, 0.8, 0.9])


def look(
    *,
    weight: float,
    mass: float = 0.0,
    flow: np.ndarray | float = 0.0,
    turn: float = 0.0,
    acceleration: float = 0.0,
) -> LoadSample:
    """At what a load and a current do exactly; turn: of the column of the weight, as the arm
    moves.
    """
    column = WEIGHT_COLUMN + turn * np.array([0.0, 0.0, 0.0, -0.3, 0.5, -0.4])
    resists = acceleration * np.array([-1.0, 0.5, 0.1, 0.2, 0.3, -0.5])
    drag = SLOPES @ np.broadcast_to(flow, 3)
    return LoadSample(
        disturbance=weight * column + mass * resists + drag,
        weight=column[:, None],
        mass=resists[:, None],
        drag=np.zeros(6),
        slopes=SLOPES,
        velocity=np.zeros((3, 1)),
        usable=np.ones(6, dtype=bool),
    )


def fed(looks: list[LoadSample], settings: LoadLearning = SETTINGS) -> LoadFilter:
    load_filter = LoadFilter(settings, LIMIT, BANDWIDTH, heaviest=HEAVIEST)
    for sample in looks:
        load_filter.update(sample)
    return load_filter


def test_a_weight_is_told_from_a_current_by_its_arm() -> None:
    flow = np.array([0.2, -0.1, 0.05])
    load_filter = fed([look(weight=20.0, flow=flow, turn=np.sin(0.05 * k)) for k in range(300)])
    assert abs(load_filter.x[WEIGHT] - 20.0) < 2.0 * load_filter.error(WEIGHT) < 3.0
    np.testing.assert_allclose(load_filter.x[load_filter.current], flow, atol=0.03)


def test_at_rest_the_mass_stays_as_unknown_as_it_was() -> None:
    load_filter = fed([look(weight=20.0)] * 300)
    assert load_filter.error(MASS) == pytest.approx(HEAVIEST / 9.81)
    assert load_filter.x[MASS] == 0.0


def test_accelerations_below_the_least_are_noise() -> None:
    small = 0.5 * LEAST_ACCELERATION
    load_filter = fed(
        [look(weight=20.0, mass=2.0, acceleration=small * (-1.0) ** k) for k in range(300)]
    )
    assert load_filter.error(MASS) == pytest.approx(HEAVIEST / 9.81)


def test_accelerations_tell_the_mass() -> None:
    load_filter = fed(
        [look(weight=20.0, mass=2.0, acceleration=np.sin(0.3 * k)) for k in range(300)]
    )
    assert abs(load_filter.x[MASS] - 2.0) < 2.0 * load_filter.error(MASS) < 1.0


def test_loads_of_two_tools_are_told_apart_by_their_arms() -> None:
    """Of which one alone accelerates: the mass of the other stays unknown."""
    load_filter = LoadFilter(SETTINGS, LIMIT, BANDWIDTH, 2, heaviest=HEAVIEST)
    for k in range(300):
        first = look(weight=20.0, mass=2.0, acceleration=np.sin(0.3 * k))
        second = look(weight=0.0, turn=1.5)
        disturbance = first.disturbance - 8.0 * second.weight[:, 0]
        weight = np.hstack([first.weight, second.weight])
        mass = np.hstack([first.mass, second.mass])
        load_filter.update(
            replace(
                first, disturbance=disturbance, weight=weight, mass=mass, velocity=np.zeros((3, 2))
            )
        )
    for place, true in enumerate((20.0, 2.0, -8.0)):
        assert abs(load_filter.x[place] - true) < 2.0 * load_filter.error(place) < 4.0
    assert load_filter.error(3) == pytest.approx(HEAVIEST / 9.81)


def test_another_load_is_learnt_as_if_nothing_had_been_known() -> None:
    load_filter = fed([look(weight=0.0)] * 200)
    before = load_filter.error(WEIGHT)
    for _ in range(10):
        load_filter.update(look(weight=30.0))
    assert load_filter.error(WEIGHT) > 10.0 * before
    for _ in range(200):
        load_filter.update(look(weight=30.0))
    assert abs(load_filter.x[WEIGHT] - 30.0) < 3.0


def test_an_axis_that_tells_nothing_is_not_listened_to() -> None:
    true = look(weight=20.0)
    usable = np.array([True, True, True, True, True, False])
    wrong = replace(true, disturbance=np.where(usable, true.disturbance, -50.0), usable=usable)
    assert abs(fed([wrong] * 200).x[WEIGHT] - 20.0) < 0.5


def test_standard_errors_do_not_fall_below_what_the_model_lacks_for_long() -> None:
    """On one axis alone a force of the model's and a weight look the same."""
    lone = np.array([False, False, True, False, False, False])
    load_filter = fed([replace(look(weight=20.0), usable=lone)] * 600)
    assert load_filter.error(WEIGHT) > LASTING_FORCE * LIMIT[2]


def test_a_covariance_stays_one() -> None:
    load_filter = fed(
        [
            look(weight=20.0, mass=2.0, acceleration=np.sin(0.3 * k), turn=np.sin(0.1 * k))
            for k in range(500)
        ]
    )
    np.testing.assert_allclose(
        load_filter.P, load_filter.P.T, atol=1e-9 * np.abs(load_filter.P).max()
    )
    assert np.linalg.eigvalsh(load_filter.P).min() > 0.0


@pytest.mark.parametrize("bandwidth", [0.3, 1.0])
def test_noise_of_a_slow_observer_counts_as_many_looks_as_it_is_alike_for(bandwidth: float) -> None:
    """By the integral of the correlation of what comes out of the observer, where white noise goes
    in.
    """
    dt = 0.005
    force = ca.SX.sym("force")
    before = ForceResponse(estimate=ca.SX.sym("estimate"), innovation=ca.SX.sym("innovation"))
    law = ObserverLaw(bandwidth=np.array([bandwidth]), limit=np.ones(1), dt=dt)
    after = law.response(before, ca.SX(1.0), force, ca.SX(1.0))
    tick = ca.Function(
        "tick", [before.estimate, before.innovation, force], [after.estimate, after.innovation]
    )
    state = (0.0, 0.0)
    pulse = []
    for k in range(round(15.0 / bandwidth / dt)):
        state = tick(*state, float(k == 0))
        pulse.append(float(state[0]))
    alike = dt * np.sum(pulse) ** 2 / np.sum(np.square(pulse))
    load_filter = LoadFilter(SETTINGS, LIMIT, np.full(6, bandwidth), heaviest=HEAVIEST)
    np.testing.assert_allclose(load_filter._colour * SETTINGS.period, alike, rtol=0.02)


@pytest.mark.parametrize(
    ("name", "value"), [("period", 0.0), ("mass", np.inf), ("drag", 1.5), ("weight", -1.0)]
)
def test_settings_that_cannot_be_are_refused(name: str, value: float) -> None:
    with pytest.raises(InvalidInput, match=f"LoadLearning: {name} = {value}; give a number "):
        LoadLearning(**{name: value})


@pytest.mark.parametrize("limit", [0.0, 1e-15, np.inf])
def test_axes_that_bear_no_force_or_any_are_refused(limit: float) -> None:
    with pytest.raises(InvalidInput, match=r"axes \[5\] of 6"):
        LoadFilter(SETTINGS, np.array([*LIMIT[:5], limit]), BANDWIDTH, heaviest=HEAVIEST)


@pytest.mark.parametrize("length", [0.1, 0.2, 5.0])
def test_a_load_of_a_scaled_robot_is_learnt_as_that_of_the_robot(length: float) -> None:
    """A toy was taken to carry up to 200 N, whatever it lifts."""
    unit = length**3 * np.array([1.0, 1.0, 1.0, length, length, length])
    learnt = []
    for size in (np.ones(6), unit):
        forces = size[0]
        load_filter = LoadFilter(SETTINGS, LIMIT * size, BANDWIDTH, heaviest=HEAVIEST * forces)
        for k in range(60):
            sample = look(weight=20.0, mass=2.0, acceleration=np.sin(0.3 * k))
            load_filter.update(
                replace(
                    sample,
                    disturbance=sample.disturbance * size,
                    weight=sample.weight * size[:, None] / forces,
                    mass=sample.mass * size[:, None] / forces,
                    slopes=np.zeros((6, 3)),
                )
            )
        learnt.append([load_filter.x[WEIGHT] / forces, load_filter.error(WEIGHT) / forces])
        learnt[-1] += [load_filter.x[MASS] / forces, load_filter.error(MASS) / forces]
    assert learnt[1] == pytest.approx(learnt[0], rel=1e-6)
