"""Laws of piecewise polynomials."""

from pathlib import Path

import numpy as np
import pytest

from uvms_ocp.errors import InvalidInput, OutputError
from uvms_ocp.trajectories.polynomial import PiecewisePolynomial, concatenate


@pytest.fixture
def curve() -> PiecewisePolynomial:
    rng = np.random.default_rng(1)
    return PiecewisePolynomial(breaks=[1.0, 1.5, 4.0, 4.1], coefficients=rng.normal(size=(8, 3, 2)))


def test_a_curve_is_a_reference_of_value_and_rate(curve: PiecewisePolynomial) -> None:
    for t in (1.0, 1.2, 3.3, 4.1):
        value, rate = curve(t)
        np.testing.assert_allclose(value, curve.evaluate(t), rtol=1e-12)
        np.testing.assert_allclose(rate, curve.evaluate(t, 1), rtol=1e-12)


def test_before_the_start_and_after_the_end_the_curve_rests_at_its_ends(
    curve: PiecewisePolynomial,
) -> None:
    for t, end in ((0.0, 1.0), (9.0, 4.1)):
        value, rate = curve(t)
        np.testing.assert_array_equal(value, curve(end)[0])
        np.testing.assert_array_equal(rate, 0.0)


@pytest.mark.parametrize("order", [1, 2, 3, 4, 5])
def test_each_derivative_is_the_difference_quotient_of_the_one_before(
    curve: PiecewisePolynomial, order: int
) -> None:
    t = np.array([1.2, 2.0, 3.7])
    h = 1e-5
    quotient = (curve.evaluate(t + h, order - 1) - curve.evaluate(t - h, order - 1)) / (2 * h)
    np.testing.assert_allclose(curve.derivative(order).evaluate(t), quotient, rtol=1e-6, atol=1e-5)
    np.testing.assert_allclose(
        curve.evaluate(t, order), curve.derivative(order).evaluate(t), rtol=1e-10
    )


def test_a_derivative_beyond_the_degree_is_zero(curve: PiecewisePolynomial) -> None:
    np.testing.assert_array_equal(curve.evaluate([1.1, 2.0], 8), 0.0)
    assert curve.derivative(9).degree == 0


def test_samples_include_both_ends(curve: PiecewisePolynomial) -> None:
    times, values = curve.sample(0.3, derivatives=2)
    assert (times[0], times[-1]) == (curve.start, curve.end)
    assert values.shape == (times.size, 3, 2)


def test_the_peak_is_no_less_than_any_sample_and_is_attained(curve: PiecewisePolynomial) -> None:
    t = np.linspace(curve.start, curve.end, 20001)
    for d in range(4):
        sampled_peak = np.abs(curve.evaluate(t, d)).max(axis=0)
        assert (curve.peak(d) >= sampled_peak * (1 - 1e-9)).all()
        np.testing.assert_allclose(curve.peak(d), sampled_peak, rtol=1e-2)


def test_slowing_down_divides_the_nth_derivative_by_the_nth_power(
    curve: PiecewisePolynomial,
) -> None:
    slow = curve.scaled(2.0)
    assert slow.duration == pytest.approx(2.0 * curve.duration)
    for d in range(5):
        np.testing.assert_allclose(slow.peak(d), curve.peak(d) / 2.0**d, rtol=1e-9)


def test_concatenation_plays_one_curve_after_the_other(curve: PiecewisePolynomial) -> None:
    line = PiecewisePolynomial(breaks=[7.0, 9.0], coefficients=np.ones((2, 1, 2)))
    joined = concatenate([curve, line])
    assert joined.duration == pytest.approx(curve.duration + 2.0)
    np.testing.assert_allclose(joined.evaluate(curve.end + 1.0), line.evaluate(8.0))
    np.testing.assert_allclose(joined.evaluate(2.0), curve.evaluate(2.0))


def test_numpy_export_is_lossless_and_csv_holds_the_samples(
    curve: PiecewisePolynomial, tmp_path: Path
) -> None:
    curve.to_numpy(tmp_path / "c.npz")
    again = PiecewisePolynomial.from_numpy(tmp_path / "c.npz")
    np.testing.assert_array_equal(again.coefficients, curve.coefficients)
    curve.to_csv(tmp_path / "c.csv", 0.5, derivatives=1)
    assert (tmp_path / "c.csv").read_text().splitlines()[
        0
    ] == "t,d0_axis0,d0_axis1,d1_axis0,d1_axis1"
    rows = np.loadtxt(tmp_path / "c.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(rows[:, 1:3], curve.evaluate(rows[:, 0]), rtol=1e-12, atol=1e-12)


def test_bad_input_is_refused_with_the_offending_index(
    curve: PiecewisePolynomial, tmp_path: Path
) -> None:
    with pytest.raises(InvalidInput, match="break 2 is"):
        PiecewisePolynomial(breaks=[0.0, 2.0, 1.0], coefficients=np.zeros((2, 2, 1)))
    with pytest.raises(InvalidInput, match="piece 1 are not finite"):
        PiecewisePolynomial(breaks=[0.0, 1.0, 2.0], coefficients=[[[0.0], [np.nan]]])
    with pytest.raises(InvalidInput, match="allowed is"):
        PiecewisePolynomial(breaks=[0.0, 1.0], coefficients=np.zeros((2, 3, 1)))
    with pytest.raises(InvalidInput, match="curve 1 has 1 axes"):
        concatenate([curve, curve.axes([0])])
    with pytest.raises(InvalidInput, match=r"period = 0\.0; give a number > 0"):
        curve.sample(0.0)
    with pytest.raises(InvalidInput, match=r"factor = -1\.0; give a number > 0"):
        curve.scaled(-1.0)
    with pytest.raises(OutputError, match="cannot write"):
        curve.to_csv(tmp_path / "missing" / "c.csv", 0.5)


def test_curves_cannot_be_changed(curve: PiecewisePolynomial) -> None:
    with pytest.raises(ValueError, match="read-only"):
        curve.coefficients[0, 0, 0] = 1.0
