"""White noise passes the test of whiteness as often as its level says; what is correlated does
not.
"""

from __future__ import annotations

import numpy as np
import pytest

from uvms_ocp.identification.estimates import Noise
from uvms_ocp.identification.predictor import Predicted
from uvms_ocp.identification.whiteness import (
    CHANNELS,
    LEVEL,
    ljung_box,
    whiteness,
)

SEEDS = 400


def coloured(rng: np.random.Generator, n: int, share: float) -> np.ndarray:
    series = rng.normal(size=n)
    for k in range(1, n):
        series[k] += share * series[k - 1]
    return series


def test_white_noise_fails_as_often_as_the_level_says() -> None:
    rng = np.random.default_rng(0)
    p = [ljung_box(rng.normal(size=300))[0] for _ in range(SEEDS)]
    spread = np.sqrt(LEVEL * (1.0 - LEVEL) / SEEDS)
    assert np.mean(np.array(p) < LEVEL) == pytest.approx(LEVEL, abs=3.0 * spread)
    assert np.mean(p) == pytest.approx(0.5, abs=0.05)


def test_what_is_correlated_fails() -> None:
    rng = np.random.default_rng(1)
    assert all(ljung_box(coloured(rng, 300, 0.5))[0] < 1e-3 for _ in range(50))


def test_the_statistic_is_that_of_ljung_and_box() -> None:
    from scipy.stats import chi2

    residual = np.array([1.0, -2.0, 0.5, 3.0, -1.0, 0.0, 2.0, -1.5, 1.0, 0.5])
    x = residual - residual.mean()
    rho = [x[k:] @ x[:-k] / (x @ x) for k in (1, 2)]
    p, statistic = ljung_box(residual, 2)
    np.testing.assert_allclose(statistic, [1.0, *rho])
    assert p == pytest.approx(chi2.sf(10 * 12 * (rho[0] ** 2 / 9 + rho[1] ** 2 / 8), 2))


def test_each_channel_is_told_by_itself_with_its_size() -> None:
    rng = np.random.default_rng(2)
    n = 500
    seen = [sigma * rng.normal(size=(n, 3)) for sigma in (0.2, 0.3, 0.1)]
    seen[1][:, 2] = 0.3 * coloured(rng, n, 0.9)
    seen[2][:, 1] = 0.0
    left = Predicted(
        t=(0.1 * np.arange(n),) * 3, rows=(np.zeros((n, 3)),) * 3, measured=tuple(seen)
    )
    tests = {
        test.channel: test for test in whiteness(left, Noise(velocity=0.1, rate=0.3, vertical=0.1))
    }
    assert set(tests) == set(CHANNELS) - {"vertical y"}
    assert tests["surge"].size == pytest.approx(2.0, rel=0.1)
    assert tests["vertical z"].size == pytest.approx(1.0, rel=0.1)
    assert tests["sway"].interval == pytest.approx(0.1)
    assert not tests["yaw"].white
    assert tests["yaw"].inflation > 5.0
    assert sum(each.white for each in tests.values()) >= 6
