"""DAQP is an approximation that says so, and never worse than a refusal."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from hierarchies import random_hierarchy, reference
from hierarchy_solvers.daqp_hierarchy import Daqp

from uvms_ocp.errors import InvalidInput, NotInstalled, UvmsError
from uvms_ocp.solvers.hierarchy.level import Level
from uvms_ocp.solvers.hierarchy.solution import Status


def test_only_what_the_certificate_confirms_is_called_exact() -> None:
    statuses = set()
    for seed in range(60):
        levels = random_hierarchy(seed, 6, (6, 2, 3, 6))
        solution = Daqp().solve(levels)
        statuses.add(solution.status)
        assert solution.status.exact == (solution.certificate(levels) <= 1e-7), seed
        assert solution.level_residuals[0] < 1e-5
    assert statuses == {Status.SOLVED, Status.INEXACT}


def test_without_certification_nothing_is_called_exact() -> None:
    levels = [Level(jacobian=np.eye(2), lower=1.0, upper=1.0)]
    assert Daqp().solve(levels).status is Status.SOLVED
    assert Daqp(certified=False).solve(levels).status is Status.INEXACT


def test_levels_without_slack_are_met_within_the_tolerance() -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        J = rng.normal(size=(9, 12))
        v = rng.normal(size=12)
        levels = [
            Level(jacobian=J[:4], lower=J[:4] @ v, upper=J[:4] @ v),
            Level(jacobian=J[4:], lower=J[4:] @ v),
        ]
        assert Daqp().solve(levels).level_residuals.max() < 1e-4


def test_a_slack_is_shared_as_if_all_rows_were_of_one_length() -> None:
    """x = 1 and 3 y = 3 below x + y = 0: x = -0.8 by least squares, 0 for rows of one length."""
    above = Level(jacobian=[[1.0, 1.0]], lower=0.0, upper=0.0)
    levels = [above, Level(jacobian=[[1.0, 0.0], [0.0, 3.0]], lower=[1.0, 3.0], upper=[1.0, 3.0])]
    optimum, _ = reference(levels)
    solution = Daqp().solve(levels)
    np.testing.assert_allclose(solution.v, [0.0, 0.0], atol=1e-4)
    assert solution.level_residuals[1] > 1.5 * optimum[1]
    assert solution.status is Status.INEXACT


@pytest.mark.parametrize("nearly", [0.0, 1e-14, 1e-10, 1e-7, 1e-5])
def test_dependent_rows_give_a_finite_velocity_and_a_truthful_status(nearly: float) -> None:
    for seed in range(10):
        rng = np.random.default_rng(seed)
        J = rng.normal(size=(3, 6))
        J = np.vstack([J, J[:1] + J[1:2] + nearly * rng.normal(size=(1, 6)), np.zeros((1, 6)), J])
        b = rng.normal(size=8)
        box = Level(jacobian=np.eye(6), lower=-1.0, upper=1.0)
        levels = [
            box,
            Level(jacobian=J[:4], lower=b[:4], upper=b[:4]),
            Level(jacobian=J[4:], lower=b[4:]),
        ]
        solution = Daqp().solve(levels)
        assert np.isfinite(solution.v).all()
        if solution.status.exact:
            assert solution.certificate(levels) <= 1e-7


def test_where_daqp_gives_up_the_exact_solver_takes_over() -> None:
    rows = [Level(jacobian=[[1.0], [3.0]], lower=[0.0, 3.0], upper=[0.0, 3.0])]
    solution = Daqp().solve(rows)
    np.testing.assert_allclose(solution.v, [0.9])
    assert solution.status.exact
    assert solution.certificate(rows) < 1e-12


def test_a_missing_package_is_named_with_the_way_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "daqp", None)
    with pytest.raises(
        NotInstalled, match=r"solver Daqp needs the package daqp, .*pip install daqp"
    ):
        Daqp()
    assert issubclass(NotInstalled, UvmsError)


def test_numbers_out_of_range_are_refused() -> None:
    with pytest.raises(InvalidInput, match=r"tolerance = 0\.0; give a finite value > 0"):
        Daqp(tolerance=0.0)
