"""Rotations and rigid motions, for arrays and for expressions, at zero, at pi and in between."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

from uvms_ocp.robot import spatial

RNG = np.random.default_rng(5)
AXES = [*np.eye(3), *-np.eye(3), *(axis / np.linalg.norm(axis) for axis in RNG.normal(size=(6, 3)))]
ANGLES = [
    0.0,
    1e-12,
    1e-8,
    1e-4,
    0.05,
    0.0999,
    0.1001,
    0.2,
    1.0,
    2.0,
    3.0,
    np.pi - 1e-3,
    np.pi - 1e-7,
]
VECTORS = [angle * axis for angle in ANGLES for axis in AXES]


def symbolic(function: Callable, *arguments: np.ndarray, kind: type = ca.SX) -> list[np.ndarray]:
    """Values of a function evaluated through an expression."""
    symbols = [kind.sym(f"x{i}", *np.atleast_2d(x.T).T.shape) for i, x in enumerate(arguments)]
    result = function(*symbols)
    outputs = list(result) if isinstance(result, tuple) else [result]
    values = ca.Function("f", symbols, [ca.densify(kind(y)) for y in outputs]).call(list(arguments))
    return [np.asarray(value) for value in values]


def exp6(twist: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotation and translation after one second of a constant body twist."""
    return spatial.exp3(twist[3:]), spatial.exp6_translation(twist)


def log6(R: np.ndarray, p: np.ndarray) -> np.ndarray:
    """The body twist that takes a frame there in one second."""
    turn = spatial.log3(R)
    return spatial.column(spatial.log6_translation(turn, p), turn)


def derivative(function: Callable, x: np.ndarray) -> np.ndarray:
    symbol = ca.SX.sym("x", *np.atleast_2d(x.T).T.shape)
    return np.asarray(ca.Function("d", [symbol], [ca.jacobian(function(symbol), symbol)])(x))


@pytest.mark.parametrize("vector", VECTORS)
def test_exponentials_equal_pinocchio(vector: np.ndarray) -> None:
    twist = np.concatenate([[0.3, -0.7, 1.1], vector])
    X = pin.exp6(twist)
    R, p = exp6(twist)
    np.testing.assert_allclose(R, pin.exp3(vector), atol=1e-14)
    np.testing.assert_allclose(p, X.translation, atol=1e-13)
    for kind in (ca.SX, ca.MX):
        R_symbolic, p_symbolic = symbolic(exp6, twist, kind=kind)
        np.testing.assert_allclose(R_symbolic, R, atol=1e-15)
        np.testing.assert_allclose(p_symbolic.ravel(), p, atol=1e-15)


@pytest.mark.parametrize("vector", VECTORS)
def test_logarithms_undo_exponentials(vector: np.ndarray) -> None:
    twist = np.concatenate([[0.3, -0.7, 1.1], vector])
    R, p = exp6(twist)
    np.testing.assert_allclose(spatial.log3(R), vector, atol=1e-13)
    np.testing.assert_allclose(log6(R, p), twist, atol=1e-13)
    for kind in (ca.SX, ca.MX):
        np.testing.assert_allclose(symbolic(log6, R, p, kind=kind)[0].ravel(), twist, atol=1e-13)


@pytest.mark.parametrize("axis", AXES)
def test_the_logarithm_at_pi_is_a_half_turn_about_the_axis(axis: np.ndarray) -> None:
    R = 2 * np.outer(axis, axis) - np.eye(3)
    vector = spatial.log3(R)
    np.testing.assert_allclose(np.linalg.norm(vector), np.pi, atol=1e-12)
    np.testing.assert_allclose(abs(vector @ axis), np.pi, atol=1e-12)


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.1, 1.0, np.pi])
def test_derivatives_are_finite_and_inverse_to_each_other(angle: float, axis: np.ndarray) -> None:
    vector = angle * axis
    exp_slope = derivative(spatial.exp3, vector)
    log_slope = derivative(spatial.log3, np.asarray(spatial.exp3(vector)))
    assert np.isfinite(exp_slope).all()
    assert np.isfinite(log_slope).all()
    np.testing.assert_allclose(log_slope @ exp_slope, np.eye(3), atol=1e-9)


@pytest.mark.parametrize("vector", VECTORS)
def test_second_derivatives_are_finite(vector: np.ndarray) -> None:
    x = ca.SX.sym("x", 3)
    loop = log6(*exp6(ca.vertcat(x, x)))
    hessian = ca.Function("h", [x], [ca.hessian(ca.sumsqr(loop), x)[0]])
    np.testing.assert_allclose(hessian(vector), 4 * np.eye(3), atol=1e-6)


@pytest.mark.parametrize("vector", VECTORS)
def test_quaternions_of_either_sign_are_one_rotation(vector: np.ndarray) -> None:
    quaternion = spatial.quaternion_exp(vector)
    R = spatial.quaternion_to_matrix(quaternion)
    np.testing.assert_allclose(spatial.quaternion_to_matrix(-quaternion), R, atol=1e-15)
    np.testing.assert_allclose(spatial.quaternion_log(-quaternion), vector, atol=1e-13)
    again = spatial.matrix_to_quaternion(R)
    np.testing.assert_allclose(abs(again @ quaternion), 1.0, atol=1e-14)


def test_quaternion_products_follow_matrix_products() -> None:
    a, b = (spatial.quaternion_exp(vector) for vector in RNG.normal(size=(2, 3)))
    product = spatial.quaternion_to_matrix(spatial.quaternion_multiply(a, b))
    np.testing.assert_allclose(
        product, spatial.quaternion_to_matrix(a) @ spatial.quaternion_to_matrix(b), atol=1e-15
    )


def test_skew_matrices_multiply_like_cross_products() -> None:
    a, b = RNG.normal(size=(2, 3))
    np.testing.assert_allclose(spatial.skew(a) @ b, np.cross(a, b))
    np.testing.assert_allclose(spatial.cross(a, b), np.cross(a, b))
    np.testing.assert_allclose(symbolic(spatial.cross, a, b)[0].ravel(), np.cross(a, b))
