"""An axis that reaches without end leaves no collision unseen: "cannot tell" counts as near, in
every check of a plan.
"""

from __future__ import annotations

from pathlib import Path

import coal
import numpy as np
import pytest

from uvms_ocp.planning.conservative_advancement import check_clearance
from uvms_ocp.planning.distances import CoalDistances
from uvms_ocp.planning.planned_axes import coordinates
from uvms_ocp.planning.rrt_connect import edge_reach
from uvms_ocp.planning.scene import CollisionScene, collision_scene
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.shapes.obstacles import obstacle
from uvms_ocp.trajectories.polynomial import PiecewisePolynomial

URDF = """<robot name="crane">
<link name="base_link"/><link name="boom"/>
<link name="trolley"><inertial><mass value="1"/>
<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
<collision><geometry><sphere radius="0.05"/></geometry></collision></link>
<joint name="turn" type="revolute"><parent link="base_link"/><child link="boom"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" velocity="1" effort="1"/></joint>
<joint name="slide" type="prismatic"><parent link="boom"/><child link="trolley"/><axis xyz="1 0 0"/>
<limit lower="-1e20" upper="1e20" velocity="1" effort="1"/></joint>
</robot>"""


@pytest.fixture
def scene(tmp_path: Path) -> CollisionScene:
    """A trolley on a boom, and a small ball 1 m ahead of the middle of its turn."""
    (tmp_path / "crane.urdf").write_text(URDF)
    robot = load_robot(urdf=tmp_path / "crane.urdf", base="fixed")
    ball = obstacle("ball", coal.Sphere(0.01), [np.cos(0.25), np.sin(0.25), 0.0])
    return collision_scene(coordinates(robot, reference=robot.configuration()), [ball])


def turn_at(radius: float) -> PiecewisePolynomial:
    """From -1 to 1 rad in 1 s with the trolley at rest."""
    return PiecewisePolynomial(
        breaks=np.array([0.0, 1.0]), coefficients=np.array([[[-1.0, radius]], [[2.0, 0.0]]])
    )


def test_a_collision_between_samples_is_not_certified_away(scene: CollisionScene) -> None:
    through = PiecewisePolynomial(
        breaks=np.array([0.0, 1.0]), coefficients=np.array([[[0.25, 0.0]], [[0.0, 2.0]]])
    )
    for trajectory in (turn_at(1.0), through):
        assert not check_clearance(CoalDistances(scene), trajectory, per_piece=2).collision_free


def test_a_turn_of_unknown_reach_is_undecided_at_worst_and_standing_still_is_free(
    scene: CollisionScene,
) -> None:
    far = check_clearance(CoalDistances(scene), turn_at(0.3), per_piece=2, shortest=1e-2)
    assert far.undecided
    assert not far.collision_free
    still = PiecewisePolynomial(
        breaks=np.array([0.0, 1.0]), coefficients=np.array([[[-1.0, 1.0]], [[0.0, 0.0]]])
    )
    assert check_clearance(CoalDistances(scene), still).collision_free


def test_pairs_that_an_endless_axis_may_have_brought_near_are_looked_at_again(
    scene: CollisionScene,
) -> None:
    distances = CoalDistances(scene)
    threshold = np.full(scene.n_pairs, 0.1)
    assert distances.near(np.array([[-1.0, 1.0]]), threshold).pair.size == 0
    assert distances.near(np.array([[-1.0, 1.0]]), threshold).pair.size == 0
    assert distances.near(np.array([[0.25, 1.0]]), threshold).pair.size == 1


def test_an_edge_of_unknown_reach_is_not_free(scene: CollisionScene) -> None:
    distances = CoalDistances(scene)
    assert edge_reach(distances, np.array([-1.0, 1.0]), np.array([1.0, 1.0]), 0.0) < 0.7
    assert edge_reach(distances, np.array([-1.0, 2.0]), np.array([-1.0, 3.0]), 0.0) == 1.0
