"""Two versions compute the same numbers where all bits are the same, whatever the numbers are
called.
"""

from __future__ import annotations

import numpy as np
import pytest
import same_numbers
from same_numbers import find, is_clock, judged

pytestmark = pytest.mark.slow

GOLDEN = {"q": np.array([[1.0, -4.0], [np.nan, 2.0]]), "active": np.array([0, 1, 1])}


def test_equal_arrays_have_the_same_bits() -> None:
    verdict = judged(GOLDEN, {name: array.copy() for name, array in GOLDEN.items()})
    assert verdict.difference == 0.0
    assert verdict.text == "same bits (2 arrays)"


def test_a_difference_is_relative_to_the_largest_value_of_its_array() -> None:
    shifted = GOLDEN["q"] + np.array([[1e-9, 0.0], [0.0, 0.0]])
    assert judged(GOLDEN, GOLDEN | {"q": shifted}).difference == pytest.approx(1e-9 / 4.0, rel=1e-6)


@pytest.mark.parametrize(
    "changed",
    [
        {"active": np.array([0, 1, 2])},
        {"active": np.array([0.0, 1.0, 2.0])},
        {"q": np.array([[1.0, -4.0], [3.0, 2.0]])},
        {"q": GOLDEN["q"][:1]},
    ],
)
def test_nothing_tolerates_other_counts_shapes_or_what_is_no_number(
    changed: dict[str, np.ndarray],
) -> None:
    assert judged(GOLDEN, GOLDEN | changed).difference == np.inf


def test_what_is_missing_differs_and_what_is_new_does_not() -> None:
    verdict = judged(GOLDEN, {"q": GOLDEN["q"]})
    assert (verdict.difference, verdict.text.endswith("active is missing")) == (np.inf, True)
    verdict = judged(GOLDEN, GOLDEN | {"more": np.zeros(1)})
    assert (verdict.difference, verdict.text.endswith("new: more")) == (0.0, True)


def test_a_column_with_another_name_is_found_by_its_bits() -> None:
    verdict = judged(GOLDEN, {"configuration": GOLDEN["q"], "active": GOLDEN["active"]})
    assert (verdict.difference, verdict.text.endswith("q is now configuration")) == (0.0, True)


def test_names_are_replaced_word_by_word_in_columns_and_sources(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(same_numbers.RENAMED, "q", "configuration")
    golden = {"report/q/max": np.array(2.0), "controller.c": np.array("double q[3], q0[3];")}
    computed = {
        "report/configuration/max": np.array(2.0 + 1e-15),
        "controller.c": np.array("double configuration[3], q0[3];"),
    }
    verdict = judged(golden, computed)
    assert 0.0 < verdict.difference < 1e-15
    assert "missing" not in verdict.text


def test_a_class_is_found_wherever_it_is_defined() -> None:
    assert find("NlpOptions").__name__ == "NlpOptions"
    with pytest.raises(
        LookupError, match="NoSuchClass is defined in no module; give --renamed NoSuchClass=NEW"
    ):
        find("NoSuchClass")


def test_times_of_computation_are_left_out() -> None:
    assert all(map(is_clock, ("tick_time", "report/tick_us/max", "wall_s", "solve_time")))
    assert not any(map(is_clock, ("t", "status", "report/duration_s", "q_estimated")))
