"""Symbolic algorithms equal Pinocchio's on every joint type."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from kinematic_trees import MODELS, built_model, function_of, random_configuration

from uvms_ocp.errors import FrameNotFound, InvalidInput
from uvms_ocp.robot.symbolic_dynamics import SymbolicDynamics
from uvms_ocp.robot.symbolic_model import SymbolicModel

EXACT = 1e-10
N_STATES = 20
STILL = ca.SX(3, 0)
"""No link is in water."""


@pytest.fixture(params=MODELS, scope="module")
def model(request: pytest.FixtureRequest) -> pin.Model:
    return MODELS[request.param]()


@pytest.fixture(scope="module")
def symbolic(model: pin.Model) -> SymbolicModel:
    return SymbolicModel(model)


def states(model: pin.Model) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    pin.seed(3)
    rng = np.random.default_rng(3)
    return [
        (random_configuration(model), rng.normal(size=model.nv), rng.normal(size=model.nv))
        for _ in range(N_STATES)
    ]


def force_of(dynamics: SymbolicDynamics) -> ca.Function:
    """Inverse dynamics without water, of q, v and a."""
    model = dynamics.model
    return function_of(
        lambda q, v, a: dynamics.inverse_dynamics(q, v, a, STILL, STILL),
        model.nq,
        model.nv,
        model.nv,
    )


def symmetric(upper: np.ndarray) -> np.ndarray:
    return np.triu(upper) + np.triu(upper, 1).T


def flat(value: ca.DM) -> np.ndarray:
    return np.asarray(value).ravel()


def test_poses_and_jacobians_equal_pinocchio(model: pin.Model, symbolic: SymbolicModel) -> None:
    data = model.createData()
    frame = model.frames[model.nframes - 1]
    pose = function_of(lambda q: symbolic.forward_kinematics(q).pose(frame.name), model.nq)
    jacobian = function_of(lambda q: symbolic.forward_kinematics(q).jacobian(frame.name), model.nq)
    for q, _, _ in states(model):
        pin.framesForwardKinematics(model, data, q)
        R, p = pose(q)
        X_WF = data.oMf[model.nframes - 1]
        np.testing.assert_allclose(R, X_WF.rotation, atol=EXACT)
        np.testing.assert_allclose(flat(p), X_WF.translation, atol=EXACT)
        J = pin.computeFrameJacobian(model, data, q, model.nframes - 1, pin.LOCAL_WORLD_ALIGNED)
        np.testing.assert_allclose(jacobian(q), J.reshape(6, model.nv), atol=EXACT)


def test_inverse_dynamics_equal_pinocchio(model: pin.Model) -> None:
    data = model.createData()
    rnea = force_of(SymbolicDynamics(model=model))
    for q, v, a in states(model):
        np.testing.assert_allclose(flat(rnea(q, v, a)), pin.rnea(model, data, q, v, a), atol=EXACT)


def test_mass_matrices_equal_pinocchio(model: pin.Model) -> None:
    data = model.createData()
    mass_matrix = function_of(SymbolicDynamics(model=model).mass_matrix, model.nq)
    for q, _, _ in states(model):
        np.testing.assert_allclose(mass_matrix(q), symmetric(pin.crba(model, data, q)), atol=EXACT)


@pytest.mark.parametrize("step", [0.0, 1e-12, 1e-6, 0.05, 0.3, 1.0, 3.0, 10.0])
def test_steps_on_the_configuration_space_equal_pinocchio(
    model: pin.Model, symbolic: SymbolicModel, step: float
) -> None:
    integrate = function_of(symbolic.integrate, model.nq, model.nv)
    for q, v, _ in states(model):
        np.testing.assert_allclose(
            flat(integrate(q, step * v)), pin.integrate(model, q, step * v), atol=EXACT
        )


def test_differences_equal_pinocchio(model: pin.Model, symbolic: SymbolicModel) -> None:
    difference = function_of(symbolic.difference, model.nq, model.nq)
    configurations = [q for q, _, _ in states(model)]
    for q0, q1 in zip(configurations[1:], configurations[:-1], strict=True):
        np.testing.assert_allclose(
            flat(difference(q0, q1)), pin.difference(model, q0, q1), atol=EXACT
        )


@pytest.mark.parametrize("step", [0.0, 1e-9, 1e-3, 0.5])
def test_a_difference_undoes_a_step(model: pin.Model, symbolic: SymbolicModel, step: float) -> None:
    integrate = function_of(symbolic.integrate, model.nq, model.nv)
    difference = function_of(symbolic.difference, model.nq, model.nq)
    for q, v, _ in states(model):
        np.testing.assert_allclose(
            flat(difference(q, integrate(q, step * v))), step * v, atol=EXACT
        )


def test_jacobians_are_the_derivative_along_steps(
    model: pin.Model, symbolic: SymbolicModel
) -> None:
    frame = model.frames[model.nframes - 1].name
    q = ca.SX.sym("q", model.nq)
    v = ca.SX.sym("v", model.nv)
    _, p = symbolic.forward_kinematics(symbolic.integrate(q, v)).pose(frame)
    along = ca.Function("along", [q, v], [ca.jacobian(p, v)])
    jacobian = function_of(lambda q: symbolic.forward_kinematics(q).jacobian(frame), model.nq)
    for configuration, _, _ in states(model):
        derivative = along(configuration, np.zeros(model.nv))
        np.testing.assert_allclose(derivative, jacobian(configuration)[:3, :], atol=EXACT)


def test_rounding_errors_of_steps_do_not_accumulate() -> None:
    model = built_model("free_flyer", "planar", "unbounded_z")
    integrate = function_of(SymbolicModel(model).integrate, model.nq, model.nv)
    q, v, _ = states(model)[0]
    stretched = q.copy()
    for unit in (slice(3, 7), slice(9, 11), slice(11, 13)):
        stretched[unit] *= 1 + 1e-5
    stepped = flat(integrate(stretched, 0.01 * v))
    for unit in (slice(3, 7), slice(9, 11), slice(11, 13)):
        assert np.linalg.norm(stepped[unit]) == pytest.approx(1.0, abs=1e-9)


def test_either_sign_of_a_quaternion_is_the_same_configuration() -> None:
    model = built_model("free_flyer", "revolute_x")
    symbolic = SymbolicModel(model)
    q, v, a = states(model)[0]
    flipped = q.copy()
    flipped[3:7] *= -1
    difference = function_of(symbolic.difference, model.nq, model.nq)
    rnea = force_of(SymbolicDynamics(model=model))
    np.testing.assert_allclose(flat(difference(q, flipped)), 0.0, atol=EXACT)
    np.testing.assert_allclose(flat(rnea(q, v, a)), flat(rnea(flipped, v, a)), atol=EXACT)


def test_added_inertia_on_every_body_enters_force_and_mass_matrix_alike() -> None:
    model = built_model("free_flyer", "revolute_unaligned", "prismatic_unaligned", "unbounded_y")
    model.gravity = pin.Motion.Zero()
    rng = np.random.default_rng(0)
    roots = rng.normal(size=(model.njoints, 6, 6))
    inertias = [
        ca.SX(Y.matrix() + root @ root.T) for Y, root in zip(model.inertias, roots, strict=True)
    ]
    dynamics = SymbolicDynamics(model=model).with_coefficients(rigid=dict(enumerate(inertias)))
    q = ca.SX.sym("q", model.nq)
    a = ca.SX.sym("a", model.nv)
    at_rest = dynamics.inverse_dynamics(q, ca.SX(model.nv, 1), a, STILL, STILL)
    force_and_product = ca.Function("both", [q, a], [at_rest, dynamics.mass_matrix(q) @ a])
    for configuration, _, acceleration in states(model):
        force, product = force_and_product(configuration, acceleration)
        np.testing.assert_allclose(flat(force), flat(product), atol=EXACT)


def test_an_unknown_frame_is_named_with_the_frames_there_are() -> None:
    symbolic = SymbolicModel(built_model("revolute_x"))
    with pytest.raises(
        FrameNotFound, match=r"unknown frame '0_revolute_x_tap'.* Did you mean '0_revolute_x_tip'"
    ):
        symbolic.forward_kinematics(ca.SX.sym("q")).pose("0_revolute_x_tap")


def test_an_unsupported_joint_is_named_with_its_type() -> None:
    model = pin.Model()
    model.addJoint(0, pin.JointModelSpherical(), pin.SE3.Identity(), "ball")
    with pytest.raises(InvalidInput, match="joint 'ball' has type Spherical; supported: FreeFlyer"):
        SymbolicModel(model)


def test_a_vector_of_the_wrong_length_is_refused() -> None:
    symbolic = SymbolicModel(built_model("free_flyer"))
    with pytest.raises(InvalidInput, match="q: shape \\(6, 1\\) given, a column of 7 rows wanted"):
        symbolic.forward_kinematics(ca.SX.sym("q", 6))


def test_matrices_are_wanted_for_every_joint() -> None:
    symbolic = SymbolicModel(built_model("free_flyer"))
    with pytest.raises(InvalidInput, match="matrices: 1 given"):
        symbolic.congruence(symbolic.local_poses(ca.SX.sym("q", 7)), [ca.DM.eye(6)])
