"""Distances of solids in machine code: against coal, against directions tried at random, and
against their own gradients.
"""

from __future__ import annotations

from itertools import product

import coal
import numpy as np
import pinocchio as pin
import pytest
from compiler import needs_compiler
from solid_pairs import KINDS, SolidPair, by_coal, height, random_pose

from uvms_ocp.robot.shapes.distance_kernels import distance_lower_bound, place_solids

PAIRS = [*product(KINDS, KINDS)]
EXACT = 1e-6  # [m]


@pytest.fixture(scope="module")
def pair() -> SolidPair:
    return SolidPair()


def sizes(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    return rng.uniform(0.03, 0.5, 3), rng.uniform(0.03, 0.5, 3)


@pytest.mark.parametrize(("first_kind", "second_kind"), PAIRS)
def test_solids_apart_are_as_far_as_coal_says(
    pair: SolidPair, first_kind: str, second_kind: str
) -> None:
    rng = np.random.default_rng(1)
    apart = 0
    while apart < 300:
        first, second = (
            KINDS[kind](size)
            for kind, size in zip((first_kind, second_kind), sizes(rng), strict=True)
        )
        X_1 = random_pose(rng, 0.0)
        X_2 = random_pose(rng, rng.choice([0.3, 1.0, 5.0]))
        expected = by_coal(first, X_1, second, X_2)
        if expected > 0.0:
            pair.take(first, second)
            assert pair.at(X_1, X_2).distance == pytest.approx(expected, abs=EXACT)
            apart += 1


@pytest.mark.slow
@pytest.mark.parametrize(("first_kind", "second_kind"), PAIRS)
def test_solids_that_overlap_part_after_their_depth_and_along_no_direction_before(
    pair: SolidPair, first_kind: str, second_kind: str
) -> None:
    """coal's own depth is that of some direction, not always of the shallowest, and at times
    none.
    """
    rng = np.random.default_rng(2)
    overlapping = 0
    while overlapping < 200:
        size_1, size_2 = sizes(rng)
        first = KINDS[first_kind](size_1)
        second = KINDS[second_kind](size_2)
        X_1 = random_pose(rng, 0.0)
        X_2 = random_pose(rng, rng.choice([1e-3, 0.1, 0.3]))
        pair.take(first, second)
        distance = pair.at(X_1, X_2)
        if distance.distance > 0.0:
            continue
        overlapping += 1
        assert distance.distance >= by_coal(first, X_1, second, X_2) - EXACT
        moved = pin.SE3(X_2.rotation, X_2.translation - distance.distance * distance.normal)
        assert by_coal(first, X_1, second, moved) == pytest.approx(0.0, abs=EXACT)
        directions = rng.normal(size=(200, 3))
        for n in directions / np.linalg.norm(directions, axis=1)[:, None]:
            reach = height(first_kind, size_1, X_1.rotation.T @ n) + height(
                second_kind, size_2, X_2.rotation.T @ n
            )
            assert distance.distance >= n @ (X_2.translation - X_1.translation) - reach - EXACT


@pytest.mark.parametrize(("first_kind", "second_kind"), PAIRS)
def test_gradients_equal_finite_differences(
    pair: SolidPair, first_kind: str, second_kind: str
) -> None:
    """Of solids apart, and, as exactly as a depth is, overlapping; but for those whose nearest
    features change in between.
    """
    rng = np.random.default_rng(3)
    right = 0
    for _ in range(100):
        pair.take(
            *(
                KINDS[kind](size)
                for kind, size in zip((first_kind, second_kind), sizes(rng), strict=True)
            )
        )
        q = np.concatenate(
            [pin.SE3ToXYZQUAT(random_pose(rng, spread)) for spread in (0.0, rng.choice([0.2, 1.0]))]
        )
        v = rng.normal(size=12)
        distance = pair.at_q(q)
        step, within = (1e-6, 1e-4) if distance.distance > 1e-3 else (2e-4, 5e-3)
        ahead, behind = (
            pair.at_q(pin.integrate(pair.model, q, sign * step * v)).distance
            for sign in (1.0, -1.0)
        )
        right += abs(distance.gradient @ v - (ahead - behind) / (2 * step)) < within
    assert right >= 97


@pytest.mark.parametrize(("first_kind", "second_kind"), PAIRS)
def test_the_same_two_solids_are_as_far_the_other_way_round(
    pair: SolidPair, first_kind: str, second_kind: str
) -> None:
    rng = np.random.default_rng(4)
    for _ in range(100):
        first, second = (
            KINDS[kind](size)
            for kind, size in zip((first_kind, second_kind), sizes(rng), strict=True)
        )
        X_1 = random_pose(rng, 0.3)
        X_2 = random_pose(rng, rng.choice([0.1, 1.0]))
        pair.take(first, second)
        forwards = pair.at(X_1, X_2)
        pair.take(second, first)
        backwards = pair.at(X_2, X_1)
        assert backwards.distance == pytest.approx(
            forwards.distance, abs=1e-10 if forwards.distance > 0.0 else 2e-7
        )
        if forwards.distance > 1e-3:
            np.testing.assert_allclose(backwards.normal, -forwards.normal, atol=2e-5)


UPRIGHT = np.eye(3)
LYING = pin.rpy.rpyToMatrix(0.0, np.pi / 2, 0.0)
BOX = coal.Box(1.0, 1.0, 1.0)
CYLINDER = coal.Cylinder(0.1, 1.0)
CAPSULE = coal.Capsule(0.1, 1.0)
BALL = coal.Sphere(0.5)
SPECIAL = {
    "boxes that touch": (BOX, BOX, UPRIGHT, (1.0, 0.0, 0.0), 0.0),
    "boxes face to face": (BOX, BOX, UPRIGHT, (1.25, 0.5, 0.0), 0.25),
    "boxes edge to edge": (BOX, BOX, UPRIGHT, (1.3, 1.4, 0.2), 0.5),
    "boxes one in the other": (BOX, BOX, UPRIGHT, (0.0, 0.0, 0.0), -1.0),
    "cylinders side by side": (CYLINDER, CYLINDER, UPRIGHT, (0.3, 0.0, 0.0), 0.1),
    "cylinders end to end": (CYLINDER, CYLINDER, UPRIGHT, (0.0, 0.0, 1.5), 0.5),
    "cylinders that touch": (CYLINDER, CYLINDER, UPRIGHT, (0.0, 0.2, 0.7), 0.0),
    "cylinders one in the other": (CYLINDER, CYLINDER, UPRIGHT, (0.0, 0.0, 0.0), -0.2),
    "cylinders that cross": (CYLINDER, CYLINDER, LYING, (0.0, 0.0, 0.0), -0.2),
    "capsules side by side": (CAPSULE, CAPSULE, UPRIGHT, (0.3, 0.0, 0.2), 0.1),
    "capsules in line": (CAPSULE, CAPSULE, UPRIGHT, (0.0, 0.0, 0.4), -0.2),
    "capsules that cross": (CAPSULE, CAPSULE, LYING, (0.0, 0.0, 0.0), -0.2),
    "a cylinder that lies on a box": (BOX, CYLINDER, LYING, (0.0, 0.0, 0.6), 0.0),
    "a cylinder in a box": (BOX, CYLINDER, UPRIGHT, (0.0, 0.0, 0.0), -0.6),
    "a ball in the middle of a cylinder": (CYLINDER, BALL, UPRIGHT, (0.0, 0.0, 0.0), -0.6),
    "a ball in the middle of a ball": (BALL, BALL, UPRIGHT, (0.0, 0.0, 0.0), -1.0),
    "a ball that touches a corner": (BOX, BALL, UPRIGHT, (0.8, 0.9, 0.5), 0.0),
    "a small box in a large floor": (
        coal.Box(40.0, 40.0, 1.0),
        BOX,
        UPRIGHT,
        (3.0, 2.0, 0.9),
        -0.1,
    ),
}


@pytest.mark.parametrize("name", SPECIAL)
def test_special_places_have_the_distance_that_one_can_see(pair: SolidPair, name: str) -> None:
    first, second, R, p, expected = SPECIAL[name]
    rng = np.random.default_rng(5)
    pair.take(first, second)
    for X in (pin.SE3.Identity(), *(random_pose(rng, 1.0) for _ in range(5))):
        assert pair.at(X, X * pin.SE3(R, np.array(p))).distance == pytest.approx(expected, abs=1e-7)


@needs_compiler
@pytest.mark.parametrize(
    ("first_kind", "second_kind"),
    [("capsule", "box"), ("cylinder", "cylinder"), ("box", "cylinder")],
)
def test_python_and_c_find_the_same_bits(
    pair: SolidPair, first_kind: str, second_kind: str
) -> None:
    slow = SolidPair(compiled=False)
    rng = np.random.default_rng(6)
    for spread in (0.02, 0.3, 1.0):
        solids = [
            KINDS[kind](size)
            for kind, size in zip((first_kind, second_kind), sizes(rng), strict=True)
        ]
        poses = random_pose(rng, 0.0), random_pose(rng, spread)
        distance = []
        for either in (pair, slow):
            either.take(*solids)
            distance.append(either.at(*poses))
        assert distance[0].distance == distance[1].distance
        np.testing.assert_array_equal(distance[0].normal, distance[1].normal)
        # Placements come from CasADi, in C and in its virtual machine.
        np.testing.assert_allclose(distance[0].gradient, distance[1].gradient, rtol=0, atol=1e-12)


def test_the_bound_by_the_direction_found_last_is_below_the_distance(pair: SolidPair) -> None:
    rng = np.random.default_rng(7)
    tight = 0
    for kinds in PAIRS:
        pair.take(*(KINDS[kind](size) for kind, size in zip(kinds, sizes(rng), strict=True)))
        q = np.concatenate([pin.SE3ToXYZQUAT(random_pose(rng, spread)) for spread in (0.0, 1.0)])
        for _ in range(20):
            pair.at_q(q)
            q = pin.integrate(pair.model, q, 0.02 * rng.normal(size=12))
            place_solids(pair.memory, q.tolist())
            bound = distance_lower_bound(pair.memory, 0)
            exact = pair.at_q(q).distance
            assert bound <= exact + 1e-9
            tight += exact - bound < 0.01
    assert tight > 200


def test_what_is_no_number_gives_no_number(pair: SolidPair) -> None:
    rng = np.random.default_rng(8)
    for kinds in PAIRS:
        pair.take(*(KINDS[kind](size) for kind, size in zip(kinds, sizes(rng), strict=True)))
        q = np.concatenate([pin.SE3ToXYZQUAT(random_pose(rng, 1.0)) for _ in range(2)])
        usual = pair.at_q(q).distance
        for wrong in (np.nan, np.inf, -np.inf):
            finite_q = q.copy()
            q[rng.integers(14)] = wrong
            assert not np.isfinite(pair.at_q(q).distance)
            q = finite_q
        assert pair.at_q(q).distance == usual
