"""Equation error finds what made a recording where accelerations are good, and tells what they do
not determine.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from driven import drive, known, vehicle_of
from equation_error import LinearFit, fit_equation_error, regressor_of
from vehicles import vehicle

from uvms_ocp.errors import InvalidInput, NameNotFound
from uvms_ocp.identification.model import Vehicle, stage_of
from uvms_ocp.identification.segments import PreparedRecording

ASKED = (
    "linear drag surge-surge",
    "linear drag sway-sway",
    "added mass surge-surge",
    "added mass heave-heave",
    "displaced mass",
)


@cache
def still_known() -> Vehicle:
    return vehicle_of(known().with_start(lag=np.array([0.3]), velocity_delay=np.array([1e-4])))


@cache
def prepared() -> PreparedRecording:
    auv = still_known()
    return PreparedRecording.of(drive(stage_of(auv), np.zeros(0), seed=4, t_end=60.0), auv)


def fit(*names: str) -> LinearFit:
    return fit_equation_error(still_known(), [prepared()], names, window=0.3)


def test_what_made_a_recording_is_found_again() -> None:
    regressor = regressor_of(vehicle())
    found = fit(*ASKED)
    wanted = np.array([regressor.phi[regressor.names.index(name)] for name in ASKED])
    np.testing.assert_allclose(found.phi, wanted, rtol=0.12)
    assert (found.explained[:3] > 0.9).all()


@pytest.mark.slow
def test_what_acts_nearly_alike_is_told_as_the_weakest_combination() -> None:
    """Mass is nearly the sum of the added masses of all axes."""
    found = fit(
        "mass",
        "added mass surge-surge",
        "added mass sway-sway",
        "added mass heave-heave",
        "displaced mass",
    )
    assert found.condition > 5.0 * fit(*ASKED).condition
    assert "mass" in {name for name, _ in found.weakest}


def test_mistakes_are_named() -> None:
    with pytest.raises(NameNotFound, match="unknown parameter 'mas'"):
        fit("mas")
    auv = still_known()
    armed = Vehicle(
        dynamics=vehicle(n_joints=1),
        shared=auv.shared,
        per_recording=auv.per_recording,
        actuators=auv.actuators,
    )
    with pytest.raises(InvalidInput, match="vehicle with joints"):
        fit_equation_error(armed, [prepared()], ["mass"])
