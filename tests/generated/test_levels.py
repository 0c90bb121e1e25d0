"""Any level of numbers is taken and solved, or refused in one line."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from drawing import chosen, either, floats, integers
from hypothesis import given, settings, strategies as st
from promises import Tally

from uvms_ocp.solvers.hierarchy.active_set import LexicographicActiveSet
from uvms_ocp.solvers.hierarchy.cascade import LexicographicQp
from uvms_ocp.solvers.hierarchy.icat import Icat
from uvms_ocp.solvers.hierarchy.level import Level
from uvms_ocp.solvers.hierarchy.solution import Status

FIELDS = ("jacobian", "lower", "upper", "rate", "activation", "gate")
_number = either(floats(), chosen([0.0, 1.0, -1.0, 0.5, np.nan, np.inf, -np.inf, 1e308]))
_array = either(
    _number,
    st.lists(_number, max_size=4),
    st.lists(st.lists(_number, min_size=1, max_size=3), max_size=3),
    chosen(
        [
            None,
            "a",
            [],
            [[]],
            [["x"]],
            [[1.0], [1.0, 2.0]],
            {},
            1j,
            [None],
            np.zeros((1, 1, 1)),
            b"1",
        ]
    ),
)


@st.composite
def arguments(draw: st.DrawFn) -> dict[str, Any]:
    """Those of a level of two rows and three velocities, one to three of them anything."""
    good: dict[str, Any] = {
        "jacobian": np.arange(6.0).reshape(2, 3),
        "lower": [-1.0, 0.0],
        "upper": [1.0, 0.0],
    }
    for name in draw(st.lists(chosen(FIELDS), max_size=3)):
        good[name] = draw(_array)
    return good


@pytest.mark.slow
def test_any_arguments_make_a_level_or_are_refused_in_one_line() -> None:
    tally = Tally(bad=400)

    @settings(max_examples=900)
    @given(arguments())
    def holds(drawn: dict[str, Any]) -> None:
        level = tally.outcome(lambda: Level(**drawn))
        if level is None:
            return
        assert level.jacobian.ndim == 2
        assert np.isfinite(level.jacobian).all()
        assert (level.lower <= level.upper).all()
        assert np.isfinite(level.rate).all()
        for name in FIELDS[1:]:
            assert getattr(level, name).shape == (level.n_rows,)
        for fraction in (level.activation, level.gate):
            assert ((fraction >= 0.0) & (fraction <= 1.0)).all()

    holds()
    tally.check()


SIZES = ([1], [6, 3], [2, 0, 4], [5, 5, 1, 5])
"""Rows of levels: each shape is compiled once."""


def _levels(sizes: list[int], seed: int, dependent: bool) -> list[Level]:
    """Equalities, inequalities and gates of everyday sizes; some levels repeat the rows of the one
    above.
    """
    rng = np.random.default_rng(seed)
    levels: list[Level] = []
    for size in sizes:
        J = np.round(rng.standard_normal((size, 5)), 1)
        if dependent and levels and levels[-1].n_rows:
            J = J @ np.zeros((5, 5)) + levels[-1].jacobian[rng.integers(0, levels[-1].n_rows, size)]
        lower = np.round(rng.standard_normal(size), 1)
        width = rng.choice([0.0, 1.0, np.inf], size)
        levels.append(
            Level(jacobian=J, lower=lower, upper=lower + width, gate=rng.choice([0.0, 1.0], size))
        )
    return levels


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("solver", "usual"),
    [
        pytest.param(LexicographicActiveSet(), Status.SOLVED, id="LexicographicActiveSet"),
        pytest.param(LexicographicQp(), Status.SOLVED, id="LexicographicQp"),
        pytest.param(Icat(), Status.REGULARISED, id="Icat"),
    ],
)
def test_any_hierarchy_has_a_finite_velocity_and_a_status_that_its_residuals_bear_out(
    solver: Any, usual: Status
) -> None:
    statuses: set[Status] = set()

    @settings(max_examples=120)
    @given(chosen(SIZES), integers(10**6), st.booleans())
    def holds(sizes: list[int], seed: int, dependent: bool) -> None:
        levels = _levels(sizes, seed, dependent)
        solution = solver.solve(levels)
        statuses.add(solution.status)
        assert np.isfinite(solution.v).all()
        assert solution.status.usable
        for level, residual in zip(levels, solution.residuals, strict=True):
            rates = level.jacobian @ solution.v
            missed = (rates - np.clip(rates, level.lower, level.upper)) * (level.gate > 0.0)
            np.testing.assert_allclose(
                residual, missed, atol=1e-9 * (1.0 + np.abs(rates).max(initial=0.0))
            )

    holds()
    assert usual in statuses
