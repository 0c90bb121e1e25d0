"""The bound of a true error holds as often as it says, however large the estimated error is beside its doubt."""

from __future__ import annotations

import numpy as np
import pytest

from uvms_ocp.report.metrics import CHANCE, norm_bound


@pytest.mark.parametrize("told", [0.0, 0.3, 1.0, 3.0, 30.0])
@pytest.mark.parametrize("spread", [1e-3, 1.0])
def test_the_bound_holds_as_often_as_it_says(told: float, spread: float) -> None:
    rng, mean = np.random.default_rng(1), np.array([told * spread, 0.0, 0.0])
    true = np.linalg.norm(mean + spread / np.sqrt(3.0) * rng.standard_normal((100_000, 3)), axis=1)
    held = float((true <= norm_bound(told * spread, spread)).mean())
    assert held == pytest.approx(CHANCE, abs=0.01)


def test_without_doubt_the_bound_is_the_estimate() -> None:
    assert norm_bound(0.02, 0.0) == 0.02
