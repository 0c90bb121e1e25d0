"""Laws of Level and of stacking."""

import re

import numpy as np
import pytest

from uvms_ocp.errors import InvalidInput
from uvms_ocp.solvers.hierarchy.level import Level, stack


def test_omitted_fields_are_neutral() -> None:
    level = Level(jacobian=np.ones((2, 3)))
    assert np.all(level.lower == -np.inf)
    assert np.all(level.upper == np.inf)
    assert np.all(level.rate == 0.0)
    assert np.all(level.activation == 0.0)
    assert np.all(level.gate == 1.0)


def test_rate_is_zero_clipped_into_the_bounds_and_activated_there() -> None:
    level = Level(
        jacobian=np.ones((4, 2)), lower=[0.5, -1.0, -2.0, 0.0], upper=[1.0, 1.0, -1.5, 0.0]
    )
    np.testing.assert_array_equal(level.rate, [0.5, 0.0, -1.5, 0.0])
    np.testing.assert_array_equal(level.activation, [1.0, 0.0, 1.0, 1.0])


def test_arrays_are_copied_and_read_only() -> None:
    J = np.ones((1, 2))
    level = Level(jacobian=J, lower=0.0)
    J[0, 0] = 5.0
    assert level.jacobian[0, 0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        level.lower[0] = 1.0


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"jacobian": np.ones(3)}, "jacobian has shape (3,); give (m, n)"),
        ({"jacobian": np.full((1, 2), np.nan)}, "jacobian contains NaN"),
        ({"jacobian": np.full((1, 2), np.inf)}, "jacobian contains an infinite value"),
        ({"jacobian": "no"}, "jacobian is not numeric"),
        (
            {"jacobian": np.ones((2, 2)), "lower": [0.0, 0.0, 0.0]},
            "lower has shape (3,); give a scalar or (2,)",
        ),
        (
            {"jacobian": np.ones((2, 2)), "lower": [1.0, 2.0], "upper": 1.5},
            "lower[1] = 2 and upper[1] = 1.5",
        ),
        ({"jacobian": np.ones((1, 2)), "lower": np.inf}, "infinity only outwards"),
        ({"jacobian": np.ones((1, 2)), "rate": np.inf}, "rate contains an infinite value"),
        (
            {"jacobian": np.ones((1, 2)), "gate": 1.5},
            "gate spans [1.5, 1.5]; give values in [0, 1]",
        ),
        ({"jacobian": np.ones((1, 2)), "activation": -0.1}, "activation spans"),
    ],
)
def test_a_wrong_field_is_named_with_its_level(fields: dict, message: str) -> None:
    with pytest.raises(InvalidInput, match=re.escape(message)) as caught:
        Level(name="altitude", **fields)
    assert str(caught.value).startswith("level 'altitude': ")


def test_stacking_needs_levels_of_one_width() -> None:
    with pytest.raises(InvalidInput, match="levels is empty"):
        stack([])
    with pytest.raises(
        InvalidInput, match=r"level 'b': jacobian \(number 1\) has 3 columns; the first level has 2"
    ):
        stack([Level(jacobian=np.ones((1, 2))), Level(jacobian=np.ones((1, 3)), name="b")])
