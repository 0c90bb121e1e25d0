"""Of axes that thrusters drive only together, the ones that weight rights are left to it: a lift that comes with
a pitch is lift.
"""

from __future__ import annotations

import numpy as np
import pytest
from tiny_robots import Tiny, robot_of

from uvms_ocp.robot.thrusters import AXES, free_motions, thruster_matrix, undriven_axes

LEVEL = tuple((x, y, 0.0, 1, -1 if x * y > 0 else 1, 0) for x in (0.2, -0.2) for y in (0.2, -0.2))
PITCH = AXES.index("pitch")


def lift_at(bow: float) -> Tiny:
    """A pair of lift thrusters so far [m] ahead of the middle, which is too far for a lift alone."""
    return Tiny(thrusters=(*LEVEL, (bow, 0.2, 0.1, 0, 0, 1), (bow, -0.2, 0.1, 0, 0, 1)))


@pytest.mark.parametrize("bow", [0.4, 0.5, 0.7, -0.7])
def test_pitch_is_left_to_weight_and_not_heave(bow: float) -> None:
    """It was heave that no thruster drove, though weight holds the pitch."""
    robot = robot_of(lift_at(bow))
    assert undriven_axes(robot) == (PITCH,)
    motion = free_motions(robot)[0][:6, 0]
    assert motion[PITCH] == 1.0
    np.testing.assert_allclose(thruster_matrix(robot).T @ motion, 0.0, atol=1e-9)
