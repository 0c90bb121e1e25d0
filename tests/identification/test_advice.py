"""What recordings leave open is answered with the motion that shows it, and that motion does."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
import pytest
from driven import SIZE, drive, known, vehicle_of

from uvms_ocp.identification.advice import advice
from uvms_ocp.identification.estimates import Noise
from uvms_ocp.identification.model import Vehicle, stage_of
from uvms_ocp.identification.output_error import OutputErrorProblem
from uvms_ocp.identification.parameters import Free
from uvms_ocp.identification.rollout import Rollout
from uvms_ocp.identification.segments import PreparedRecording
from uvms_ocp.identification.uncertainty import UnidentifiableDirection, unidentifiable_directions


def combination(*names: str) -> UnidentifiableDirection:
    return UnidentifiableDirection(sigma=1.0, shares=tuple((name, 0.5) for name in names))


@cache
def problem() -> tuple[Vehicle, Rollout]:
    free = Free(only=("surge", "yaw"))
    auv = vehicle_of(
        known().with_status(added_mass=free, quadratic_drag=free, gain=Free(only=("heave",)))
    )
    return auv, Rollout(stage_of(auv))


def left(size: Sequence[float]) -> tuple[UnidentifiableDirection, ...]:
    auv, rollout = problem()
    recording = drive(
        rollout.stage,
        np.concatenate([auv.shared.start, auv.per_recording.start]),
        seed=0,
        noise=0.005,
        size=size,
    )
    error = OutputErrorProblem(
        auv, PreparedRecording.of(recording, auv).segments(0.1, 10.0), Noise(), rollout
    )
    return unidentifiable_directions(auv, error.solve(error.start(), iterations=3))


@pytest.mark.slow
def test_what_did_not_move_is_to_be_driven_and_then_is_known() -> None:
    # Its swing at the begin moves surge by 1 cm/s: enough for its drag within 30 %, or not.
    worst, second = [advice(one) for one in left((0.0, 0.0, 4.0, 0.0, 0.0, 0.0))][:2]
    assert worst.startswith("drive yaw fast")
    assert second.startswith("drive yaw to and fro")
    (text,) = (advice(one) for one in left((1.0, 0.0, 10.0, 0.0, 0.0, 0.0)))
    assert text.startswith("drive yaw fast")
    (text,) = (advice(one) for one in left((12.0, 12.0, 0.0, 0.8, 0.8, 3.0)))
    assert text.startswith("drive actuator heave ahead")
    assert not left(SIZE)


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (("linear_drag surge", "quadratic_drag surge"), "drive surge at two speeds"),
        (("added_mass heave", "mass"), "no motion in water tells"),
        (("gain T1", "added_mass yaw", "quadratic_drag yaw"), "measure a thrust"),
        (("mass", "volume"), "net weight"),
        (("lag", "delay"), "record faster"),
        (("centre_of_buoyancy x",), "in pitch"),
        (("quadratic_drag surge from pitch",), "surge and pitch together"),
        (("linear_drag pitch-surge",), "pitch and surge together"),
        (("reverse T3", "dead_zone T2"), "actuator T3 astern"),
        (
            ("gain T4", "reverse T5"),
            "actuator T4 ahead with much of its force; drive actuator T5 astern",
        ),
    ],
)
def test_what_is_open_together_has_advice_of_its_own(names: tuple[str, ...], words: str) -> None:
    assert words in advice(combination(*names))


def test_there_is_advice_for_everything_that_recordings_share() -> None:
    for name, quantity in known().quantities.items():
        if not quantity.per_recording:
            for coordinate in quantity.coordinates.names:
                assert len(advice(combination(f"{name} {coordinate}".strip()))) > 10
