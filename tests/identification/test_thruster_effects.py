"""A thruster that gives less than it is commanded is named, with its share; sound ones are not."""

from __future__ import annotations

import re

import numpy as np
import pytest
from own_runs import driven_run, slow

from uvms_ocp.identification.run_recordings import run_recording
from uvms_ocp.identification.thruster_effects import estimated_effects, weak_thrusters
from uvms_ocp.robot.thrusters import thruster_matrix

DEAD = 2


@pytest.mark.slow
@pytest.mark.parametrize("faults", [(), (f"thruster{DEAD + 1}:dead",)])
def test_shares_of_thrusters_are_those_of_the_run(faults: tuple[str, ...]) -> None:
    recording = run_recording(driven_run(duration=30.0, size=4.0, faults=faults), "run")
    thrust = recording.channel("thrust")
    B = thruster_matrix(slow())
    names = slow().thruster_names
    effects = estimated_effects(recording, thrust, B)
    assert effects is not None
    expected = np.ones(len(names))
    expected[DEAD] = 0.0 if faults else 1.0
    np.testing.assert_allclose(effects.shares, expected, atol=0.15)
    given, doubts = weak_thrusters(recording, thrust, B, names)
    np.testing.assert_array_equal(given, np.where(expected > 0.0, 1.0, 0.0))
    assert [re.findall(r"(\S+) gives .*: dead\?", text) for text in doubts] == [
        [names[k]] for k in np.flatnonzero(given == 0.0)
    ]


@pytest.mark.slow
def test_thrust_that_has_nothing_to_do_with_the_motion_shows_no_thruster() -> None:
    recording = run_recording(driven_run(duration=30.0, size=4.0), "run")
    thrust = recording.channel("thrust")
    shuffled = np.random.default_rng(0).permutation(thrust.values)
    given, doubts = weak_thrusters(
        recording,
        type(thrust)(t=thrust.t, values=shuffled),
        thruster_matrix(slow()),
        slow().thruster_names,
    )
    assert (given == 1.0).all()
    assert doubts == ()
