"""Distances of solids in machine code: against coal, against directions tried at random, and against their own gradients."""

from __future__ import annotations

from itertools import product

import numpy as np
import pinocchio as pin
import pytest
from solid_pairs import KINDS, SolidPair, by_coal, height, random_pose

PAIRS = [*product(KINDS, KINDS)]
EXACT = 1e-6  # [m]


@pytest.fixture(scope="module")
def pair() -> SolidPair:
    return SolidPair()


def sizes(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    return rng.uniform(0.03, 0.5, 3), rng.uniform(0.03, 0.5, 3)


@pytest.mark.parametrize(("one", "other"), PAIRS)
def test_solids_apart_are_as_far_as_coal_says(pair: SolidPair, one: str, other: str) -> None:
    rng, apart = np.random.default_rng(1), 0
    while apart < 300:
        first, second = (KINDS[kind](size) for kind, size in zip((one, other), sizes(rng), strict=True))
        X_1, X_2 = random_pose(rng, 0.0), random_pose(rng, rng.choice([0.3, 1.0, 5.0]))
        expected = by_coal(first, X_1, second, X_2)
        if expected > 0.0:
            pair.take(first, second)
            assert pair.at(X_1, X_2).distance == pytest.approx(expected, abs=EXACT)
            apart += 1


@pytest.mark.parametrize(("one", "other"), PAIRS)
def test_solids_that_overlap_part_after_their_depth_and_along_no_direction_before(
    pair: SolidPair, one: str, other: str
) -> None:
    """coal's own depth is that of some direction, not always of the shallowest, and at times none."""
    rng, overlapping = np.random.default_rng(2), 0
    while overlapping < 200:
        size_1, size_2 = sizes(rng)
        first, second = KINDS[one](size_1), KINDS[other](size_2)
        X_1, X_2 = random_pose(rng, 0.0), random_pose(rng, rng.choice([1e-3, 0.1, 0.3]))
        pair.take(first, second)
        found = pair.at(X_1, X_2)
        if found.distance > 0.0:
            continue
        overlapping += 1
        assert found.distance >= by_coal(first, X_1, second, X_2) - EXACT
        moved = pin.SE3(X_2.rotation, X_2.translation - found.distance * found.normal)
        assert by_coal(first, X_1, second, moved) == pytest.approx(0.0, abs=EXACT)
        directions = rng.normal(size=(200, 3))
        for n in directions / np.linalg.norm(directions, axis=1)[:, None]:
            reach = height(one, size_1, X_1.rotation.T @ n) + height(other, size_2, X_2.rotation.T @ n)
            assert found.distance >= n @ (X_2.translation - X_1.translation) - reach - EXACT
