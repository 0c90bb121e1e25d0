"""The regularised solver in C is [Gao2022] eq. (27) as NumPy has it, whatever the rows."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from compiler import needs_compiler

from uvms_ocp.solvers.hierarchy.core import STATUSES, external_core
from uvms_ocp.solvers.hierarchy.icat import Icat
from uvms_ocp.solvers.hierarchy.level import Level, row_slices
from uvms_ocp.solvers.hierarchy.solution import Status

Problem = tuple[np.ndarray, np.ndarray, np.ndarray, tuple[int, ...]]
SHARP = Icat(damping=1e-8, threshold=1e-4)


def _problems(count: int, structures: list[tuple[int, tuple[int, ...]]]) -> Iterator[Problem]:
    """With dependent rows, and activations of 0, 1 and between."""
    rng = np.random.default_rng(0)
    for k in range(count):
        n, sizes = structures[k % len(structures)]
        J = rng.standard_normal((sum(sizes), n))
        for r in range(1, len(J)):
            if rng.random() < 0.2:
                J[r] = J[rng.integers(0, r)] * rng.choice([1.0, -2.0, 0.0])
        kind = rng.integers(0, 3, len(J))
        yield (
            J,
            rng.standard_normal(len(J)),
            np.select([kind == 0, kind == 1], [0.0, 1.0], rng.random(len(J))),
            sizes,
        )


def _given(J: np.ndarray, rate: np.ndarray, activation: np.ndarray) -> list[np.ndarray]:
    """What a core is called with."""
    return [
        J,
        -np.ones(len(J)),
        np.ones(len(J)),
        rate,
        activation,
        np.ones(len(J)),
        np.zeros(len(J)),
    ]


def _as_printed(
    J: np.ndarray, rate: np.ndarray, activation: np.ndarray, sizes: tuple[int, ...]
) -> np.ndarray:
    """Eq. (27) term by term."""
    solver = Icat()
    v = np.zeros(J.shape[1])
    Q = np.eye(J.shape[1])

    def P(X: np.ndarray, A: np.ndarray, Q: np.ndarray) -> np.ndarray:
        free = np.eye(len(Q)) - Q
        M = X.T @ A @ A @ X + X.T @ (np.eye(len(A)) - A) @ A @ X + solver.weight * free.T @ free
        U, s, _ = np.linalg.svd(M)
        bell = np.where(s < solver.threshold, 0.5 * np.cos(np.pi * s / solver.threshold) + 0.5, 0.0)
        return np.asarray(U @ np.diag(s / (s * s + solver.damping * bell)) @ U.T @ X.T @ A @ A)

    for rows in row_slices(sizes):
        X = J[rows] @ Q
        A = np.diag(activation[rows])
        same = np.eye(len(Q))
        W = X @ P(X, A, Q)
        v = (same - Q @ P(X, A, same) @ W @ J[rows]) @ v + Q @ P(X, A, same) @ W @ rate[rows]
        Q = Q @ (same - P(X, A, same) @ X)
    return v


def test_in_numpy_it_is_the_printed_equation() -> None:
    for J, rate, activation, sizes in _problems(
        50, [(5, (2, 3, 1)), (9, (3, 6, 4)), (13, (6, 6, 3, 1))]
    ):
        expected = _as_printed(J, rate, activation, sizes)
        velocity = Icat().velocity(J, rate, activation, sizes)
        np.testing.assert_allclose(
            velocity, expected, rtol=0, atol=1e-9 * max(1.0, np.abs(expected).max())
        )


STRUCTURES = [
    (1, (1,)),
    (2, (3, 0, 1)),
    (5, (2, 3, 1)),
    (9, (3, 6, 4)),
    (13, (6, 6, 3, 1, 2, 4)),
    (34, (34, 6, 12, 1, 34)),
]


@pytest.mark.sampled
@needs_compiler
@pytest.mark.parametrize("structure", STRUCTURES, ids=[f"n={n}" for n, _ in STRUCTURES])
@pytest.mark.parametrize("solver", [Icat(), SHARP], ids=["usual", "sharp"])
def test_in_c_it_finds_what_numpy_finds(
    solver: Icat, structure: tuple[int, tuple[int, ...]]
) -> None:
    """To the rounding of both: with the least damping, a change of an eigenvalue is one of up to 1
    / damping.
    """
    core = external_core(solver.core_source(*structure))
    assert core is not None
    for J, rate, activation, sizes in _problems(60, [structure]):
        arguments = _given(J, rate, activation)
        v, _, report, residual = (np.array(x).ravel() for x in core(*arguments))
        expected, _, _, missed = solver.in_python(J.shape[1], sizes)(*arguments)
        size = max(1.0, np.abs(expected).max())
        np.testing.assert_allclose(
            v, expected, rtol=0, atol=(1e-12 if solver is not SHARP else 1e-9) * size
        )
        np.testing.assert_allclose(residual, missed, rtol=0, atol=1e-8 * size)
        assert STATUSES[int(report[0])] is Status.REGULARISED


@needs_compiler
@pytest.mark.parametrize("kind", ["graded", "repeated", "zero", "tiny", "tridiagonal"])
def test_in_c_special_matrices_are_made_diagonal_too(kind: str) -> None:
    n = 8
    rng = np.random.default_rng(1)
    J = {
        "graded": np.diag(10.0 ** -np.arange(n)),
        "repeated": np.ones((n, n)),
        "zero": np.zeros((n, n)),
        "tiny": 1e-70 * rng.standard_normal((n, n)),
        "tridiagonal": np.eye(n) + 0.5 * np.eye(n, k=1),
    }[kind]
    levels = [
        Level(jacobian=J, rate=np.arange(n, dtype=float), activation=1.0),
        Level(jacobian=np.eye(n), rate=1.0, activation=0.5),
    ]
    solution, expected = (Icat(compiled=compiled).solve(levels) for compiled in (True, False))
    assert solution.status is expected.status is Status.REGULARISED
    np.testing.assert_allclose(
        solution.v, expected.v, rtol=0, atol=1e-11 * max(1.0, np.abs(expected.v).max())
    )


@needs_compiler
@pytest.mark.parametrize("scale", [np.nan, np.inf, 1e200, 1e14])
def test_in_c_what_is_invalid_is_that_in_numpy(scale: float) -> None:
    J = np.diag(np.full(3, scale)) if np.isfinite(scale) else np.full((3, 3), scale)
    arguments = _given(J, np.array([1.0, -1.0, 1e250]), np.ones(3))
    core = external_core(Icat().core_source(3, (3,)))
    assert core is not None
    for in_c, in_numpy in zip(core(*arguments), Icat().in_python(3, (3,))(*arguments), strict=True):
        np.testing.assert_allclose(np.array(in_c).ravel(), in_numpy, rtol=1e-9)


@needs_compiler
@pytest.mark.parametrize("activation", [1e200, -1e200, np.nan])
@pytest.mark.parametrize("J", [np.diag([1.0, 2.0, 3.0]), np.zeros((3, 3))], ids=["rows", "no rows"])
def test_an_activation_that_is_none_is_invalid_in_both(J: np.ndarray, activation: float) -> None:
    arguments = _given(J, np.ones(3), np.array([1.0, activation, 1.0]))
    core = external_core(Icat().core_source(3, (3,)))
    assert core is not None
    for v, _, (code, _), _ in (
        [np.array(result).ravel() for result in core(*arguments)],
        Icat().in_python(3, (3,))(*arguments),
    ):
        assert STATUSES[int(code)] is Status.INVALID_INPUT
        np.testing.assert_array_equal(v, np.zeros(3))


def test_numbers_of_one_solver_are_not_those_of_another() -> None:
    level = Level(jacobian=[[0.05]], lower=1.0, upper=1.0, rate=1.0)
    (damped,), (little,) = (Icat(damping=d, threshold=0.01).solve([level]).v for d in (1e-2, 1e-8))
    assert 0.0 < damped < 0.1 * little
