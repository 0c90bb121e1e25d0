"""Thrusters that were recorded in another order, or with another sign, are named; those that push
as they should are not.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from own_runs import driven_run, slow

from uvms_ocp.identification.mixed_thrusters import mixed_thrusters
from uvms_ocp.identification.recording import Channel, Recording
from uvms_ocp.identification.run_recordings import run_recording
from uvms_ocp.robot.thrusters import thruster_matrix

NAMES = tuple("abcdefgh")
WAYS = {
    "": np.eye(8),
    "all reversed": -np.eye(8),
    "c reversed": np.diag([1.0, 1, -1, 1, 1, 1, 1, 1]),
    "a and b exchanged": np.eye(8)[[1, 0, 2, 3, 4, 5, 6, 7]],
    "a and b exchanged and c reversed": np.eye(8)[[1, 0, 2, 3, 4, 5, 6, 7]]
    @ np.diag([1.0, 1, -1, 1, 1, 1, 1, 1]),
}


@cache
def recording() -> Recording:
    return run_recording(driven_run(duration=20.0, size=4.0), "run")


def told(way: np.ndarray) -> str:
    channel = recording().channel("thrust")
    return mixed_thrusters(
        recording(),
        Channel(t=channel.t, values=channel.values @ way.T),
        thruster_matrix(slow()),
        NAMES,
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "way"), WAYS.items(), ids=lambda one: one or "as it is" if isinstance(one, str) else ""
)
def test_what_was_done_to_the_thrusters_is_named(text: str, way: np.ndarray) -> None:
    assert set(told(way).split(" and ")) == set(text.split(" and "))


def test_thrust_that_has_nothing_to_do_with_the_motion_is_not_explained() -> None:
    channel = recording().channel("thrust")
    other = Channel(t=channel.t, values=np.random.default_rng(0).permutation(channel.values))
    assert mixed_thrusters(recording(), other, thruster_matrix(slow()), NAMES) == ""
