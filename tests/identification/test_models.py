"""Identified vehicles obey the symbolic dynamics, and their derivatives are differences."""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from equation_error import regressor_of
from vehicles import declaration, vehicle

from uvms_ocp.identification.model import PAST, StageFunctions, Vehicle, stage_of, vehicle_dynamics
from uvms_ocp.identification.parameters import Free, Unknowns
from uvms_ocp.identification.vehicle_declaration import ActuatorModel
from uvms_ocp.robot.symbolic_dynamics import SymbolicDynamics

LEARNT = (
    "mass",
    "centre_of_mass",
    "second_moment",
    "volume",
    "centre_of_buoyancy",
    "added_mass",
    "linear_drag",
)
OTHERS = (
    *("quadratic_drag", "gain", "reverse", "lag", "dead_zone", "dead_zone_reverse", "bias"),
    *("velocity_point", "attitude_turn"),
)


def motion(dynamics: SymbolicDynamics, seed: int) -> list[np.ndarray]:
    """q, v, a, u and Du_Dt at random."""
    rng = np.random.default_rng(seed)
    model = dynamics.model
    q = pin.integrate(model, pin.neutral(model), rng.normal(size=model.nv))
    n = len(dynamics.links)
    return [q, *rng.normal(size=(2, model.nv)), rng.normal(size=(3, n)), rng.normal(size=(3, n))]


def drawn(layout: Unknowns, seed: int) -> np.ndarray:
    return layout.start + 0.4 * np.random.default_rng(seed).normal(size=len(layout.start))


@pytest.mark.parametrize("seed", range(5))
def test_the_regressor_times_the_parameters_is_the_inverse_dynamics(seed: int) -> None:
    dynamics = vehicle()
    regressor = regressor_of(dynamics)
    given = motion(dynamics, seed)
    Y = np.asarray(regressor.matrix(*given))
    tau = np.asarray(dynamics.inverse_dynamics_function()(*given)).ravel()
    np.testing.assert_allclose(Y @ regressor.phi, tau, atol=1e-10 * np.abs(tau).max())


@pytest.mark.parametrize("seed", range(5))
def test_the_regressor_tells_what_other_parameters_change_in_a_tree(seed: int) -> None:
    dynamics = vehicle(n_joints=2)
    layout = Unknowns(declaration().with_status(**dict.fromkeys(LEARNT, Free())))
    values = layout.values(ca.SX(ca.DM(drawn(layout, seed))))
    other = vehicle_dynamics(dynamics, values)
    given = motion(dynamics, seed)
    change = np.asarray(
        other.inverse_dynamics_function()(*given) - dynamics.inverse_dynamics_function()(*given)
    )
    wet = {k: np.asarray(ca.DM(v)) for k, v in values.items()}
    regressor = regressor_of(dynamics)
    phi = regressor.phi.copy()
    phi[[0, -4]] = float(wet["mass"][0, 0]), dynamics.density * float(wet["volume"][0, 0])
    phi[1:4], phi[-3:] = (
        phi[0] * wet["centre_of_mass"].ravel(),
        phi[-4] * wet["centre_of_buoyancy"].ravel(),
    )
    about_centre = np.trace(wet["second_moment"]) * np.eye(3) - wet["second_moment"]
    I_O = pin.Inertia(phi[0], phi[1:4] / phi[0], about_centre).matrix()[3:, 3:]
    phi[4:10] = I_O[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    phi[10:31] = wet["added_mass"][np.tril_indices(6)]
    phi[31:67], phi[67:103] = wet["linear_drag"].ravel(), wet["quadratic_drag"].ravel()
    told = np.asarray(regressor.matrix(*given)) @ (phi - regressor.phi)
    np.testing.assert_allclose(told, change.ravel(), atol=1e-10 * np.abs(change).max())


def test_a_vehicle_that_is_known_has_the_dynamics_of_its_model() -> None:
    dynamics = vehicle(n_joints=1)
    given = motion(vehicle(n_joints=1), 7)
    same = vehicle_dynamics(dynamics, Unknowns(declaration()).values(ca.SX(0, 1)))
    for term in ("inverse_dynamics", "potential_energy", "mass_matrix"):
        ours = same.function(term)
        own = dynamics.function(term)
        inputs = given[: own.n_in()]
        np.testing.assert_allclose(
            np.asarray(ours(*inputs)), np.asarray(own(*inputs)), rtol=1e-12, atol=1e-10
        )


@cache
def built(
    *,
    n_joints: int = 0,
    actuators: ActuatorModel | None = None,
    learnt: tuple[str, ...] = (*LEARNT, *OTHERS),
) -> tuple[Vehicle, StageFunctions]:
    known = declaration(actuators=actuators).with_status(**dict.fromkeys(learnt, Free()))
    known = known.with_status(
        current=Free(), wrench_offset=Free(), attitude_offset=Free(), rate_bias=Free()
    )
    per_recording = Unknowns(known, per_recording=True)
    one = Vehicle(
        dynamics=vehicle(n_joints),
        shared=Unknowns(known),
        per_recording=per_recording,
        actuators=actuators or ActuatorModel(dead_zone=0.5),
    )
    return one, stage_of(one)


def point(one: Vehicle, stage: StageFunctions, seed: int) -> list[np.ndarray]:
    """x, u, joints, p and h at random."""
    rng = np.random.default_rng(seed)
    x = np.concatenate(
        [
            motion(one.dynamics, seed)[0][:7],
            0.3 * rng.normal(size=6),
            5.0 * rng.normal(size=stage.n_u),
        ]
    )
    p = np.concatenate([one.shared.start, one.per_recording.start]) + 0.1 * rng.normal(
        size=stage.n_p
    )
    return [
        x,
        5.0 * rng.normal(size=stage.n_u),
        0.3 * rng.normal(size=3 * stage.n_j),
        p,
        np.array(0.05),
    ]


@pytest.mark.slow
@pytest.mark.parametrize("n_joints", [0, 1])
def test_slopes_of_a_step_are_differences(n_joints: int) -> None:
    one, stage = built(n_joints=n_joints)
    given = point(one, stage, 1)
    slopes = [np.asarray(slope) for slope in stage.slope(*given)]
    step = 1e-6
    for which, slope in zip((0, 3, 1), slopes, strict=True):
        for k in range(slope.shape[1]):
            ends = []
            for sign in (1, -1):
                moved = [value.copy() for value in given]
                moved[which][k] += sign * step
                ends.append(np.asarray(stage.step(*moved)).ravel())
            np.testing.assert_allclose(
                slope[:, k], (ends[0] - ends[1]) / (2 * step), atol=2e-7 * (1 + np.abs(slope).max())
            )


@pytest.mark.slow
def test_a_short_step_has_the_acceleration_of_forward_dynamics() -> None:
    one, stage = built()
    x, u, joints, p, _ = point(one, stage, 2)
    h = 1e-6
    values = one.values(ca.SX(ca.DM(p)))
    dynamics = vehicle_dynamics(one.dynamics, values)
    wrench = x[13:] + np.asarray(ca.DM(values["bias"] + values["wrench_offset"])).ravel()
    still = np.asarray(ca.DM(values["current"])), np.zeros((3, 1))
    a = np.asarray(dynamics.function("forward_dynamics")(x[:7], x[7:13], wrench, *still)).ravel()
    after = np.asarray(stage.step(x, u, joints, p, h)).ravel()
    np.testing.assert_allclose((after[7:13] - x[7:13]) / h, a, atol=1e-3 * np.abs(a).max())


def test_steps_converge_with_the_square_of_their_length() -> None:
    one, stage = built()
    x, u, joints, p, _ = point(one, stage, 3)

    def after(n: int) -> np.ndarray:
        state = x
        for _ in range(n):
            state = np.asarray(stage.step(state, u, joints, p, 0.4 / n)).ravel()
        return state

    coarse = after(8)
    fine = after(16)
    exact = after(256)
    assert np.linalg.norm(coarse - exact) > 3.3 * np.linalg.norm(fine - exact)


@pytest.mark.slow
@pytest.mark.parametrize(("whole", "beyond"), [(False, 3.0), (True, 4.0)])
def test_an_actuator_gives_nothing_well_inside_its_dead_zone_and_less_or_all_beyond_it(
    whole: bool, beyond: float
) -> None:
    auv, stage = built(actuators=ActuatorModel(dead_zone=1.0, lag=1e-3, whole_beyond=whole))
    p = np.concatenate([auv.shared.start, auv.per_recording.start])
    still = np.array([0, 0, 0, 0, 0, 0, 1.0, *np.zeros(12)])
    given = np.asarray(stage.step(still, [0.2, 4.0, -4.0, 0, 0, 0], np.zeros(0), p, 0.1)).ravel()[
        13:
    ]
    np.testing.assert_allclose(given, [0.0, beyond, -beyond, 0, 0, 0], atol=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("whole", [False, True])
def test_the_edge_of_a_dead_zone_that_is_known_is_where_it_is(whole: bool) -> None:
    auv, _ = built(
        actuators=ActuatorModel(dead_zone=1.0, lag=1e-3, whole_beyond=whole), learnt=("mass",)
    )
    stage = stage_of(auv, sharp=True)
    u = np.array([0.9, 1.1, -0.9, -1.1, 0.0, 2.0])
    thrust = np.asarray(
        stage.begun(
            np.outer(u, np.ones(PAST)), np.concatenate([auv.shared.start, auv.per_recording.start])
        )[0]
    ).ravel()
    np.testing.assert_allclose(
        thrust, np.where(np.abs(u) > 1.0, u - (not whole) * np.sign(u), 0.0), atol=1e-3
    )


def test_the_point_at_which_velocity_is_measured_moves_with_the_vehicle() -> None:
    auv, stage = built()
    x, _, _, p, _ = point(auv, stage, 4)
    at = np.asarray(ca.DM(auv.values(ca.SX(ca.DM(p)))["velocity_point"])).ravel()
    seen = np.asarray(stage.outputs(x, p)[0]).ravel()
    np.testing.assert_allclose(seen[:3], x[7:10] + np.cross(x[10:13], at), atol=1e-14)


def test_a_sensor_of_attitude_that_sits_turned_sees_the_motion_in_its_own_frame() -> None:
    auv, stage = built()
    x, _, _, p, _ = point(auv, stage, 5)
    values = auv.values(ca.SX(ca.DM(p)))
    R_BS = pin.exp3(np.asarray(ca.DM(values["attitude_turn"] + values["attitude_offset"])).ravel())
    R_WB = pin.Quaternion(x[3:7]).toRotationMatrix()
    seen = np.asarray(stage.outputs(x, p)[0]).ravel()
    bias = np.asarray(ca.DM(values["rate_bias"])).ravel()
    np.testing.assert_allclose(seen[3:6], R_BS.T @ x[10:13] + bias, atol=1e-14)
    np.testing.assert_allclose(seen[6:], (R_WB @ R_BS).T @ [0, 0, 1], atol=1e-14)
