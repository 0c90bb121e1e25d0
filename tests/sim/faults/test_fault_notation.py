"""Faults as values and as text are the same, and what is no fault is refused in one line."""

from __future__ import annotations

import math

import pytest
from fault_registry import ALL, listed
from hypothesis import given, settings, strategies as st

from uvms_ocp.errors import InvalidInput, NameNotFound, UvmsError
from uvms_ocp.sim import Fault, parse_fault
from uvms_ocp.sim.faults import FAMILIES, parse_faults

SAME = settings(derandomize=True, database=None, deadline=None)
"""In every run, from a folder that cannot be written, on a slow machine."""
TIMES = st.floats(0.0, 80_000.0)
NUMBERS = st.floats(-1e6, 1e6)


def test_every_kind_of_every_family_is_listed() -> None:
    assert listed() == {(family, kind) for family, kinds in FAMILIES.items() for kind in kinds}


@pytest.mark.parametrize("text", ALL)
@pytest.mark.parametrize("when", ["@0", "@8", "@1e-07-2.5", "@12.25-12.5"])
def test_printing_and_parsing_are_inverse(text: str, when: str) -> None:
    fault = parse_fault(text + when)
    assert str(fault) == text + when
    assert parse_fault(str(fault)) == fault


@SAME
@given(
    offset=st.lists(NUMBERS, min_size=1, max_size=4),
    onset=TIMES,
    lasts=st.one_of(st.none(), st.floats(1e-3, 1e3)),
)
def test_no_number_is_lost_on_the_way_through_text(
    offset: list[float], onset: float, lasts: float | None
) -> None:
    end = math.inf if lasts is None else onset + lasts
    fault = Fault(target="position", kind="bias", values=tuple(offset), onset=onset, end=end)
    assert parse_fault(str(fault)) == fault


def test_short_forms_mean_the_same() -> None:
    assert parse_fault("altimeter:frozen@8") == Fault(
        target="altimeter_range", kind="frozen", onset=8
    )
    assert parse_fault(" depth:lost ") == Fault(target="depth", kind="lost")
    assert parse_faults(["depth:lost", Fault(target="joint2", kind="jam")]) == (
        parse_fault("depth:lost@0"),
        parse_fault("joint2:jam@0"),
    )


def test_a_fault_is_there_from_its_onset_until_before_its_end() -> None:
    fault = parse_fault("depth:lost@1-2")
    assert [fault.active(t) for t in (0.0, 0.999, 1.0, 1.5, 1.999, 2.0, 9.0)] == [
        False,
        False,
        *[True] * 3,
        False,
        False,
    ]
    assert parse_fault("depth:lost@1").active(1e6)
    assert fault.active(0.1 + 0.2 + 0.7 - 1e-12)  # rounding


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("altimetr:frozen@8", "Did you mean 'altimeter'?"),
        ("thrustr3:dead@20", "Did you mean 'thruster3'?"),
        ("joint3_positon:frozen", "Did you mean 'joint3_position'?"),
        ("thruster3_position:frozen", "unknown target of a fault"),
        ("thruster0:dead", "unknown target of a fault"),
        ("altimeter:frosen@8", "Did you mean 'frozen'?"),
        ("thruster3:jam", "unknown fault of thruster3 'jam'; known: dead, stuck, weak, reversed"),
        ("joint3_position:lost", "unknown fault of joint3_position 'lost'"),
        ("altimeter", "write TARGET:KIND=VALUES@ONSET-END, such as altimeter:frozen@8"),
        ("altimeter:frozen@", "write TARGET:KIND=VALUES@ONSET-END"),
        ("altimeter:frozen@8-", "write TARGET:KIND=VALUES@ONSET-END"),
        ("altimeter:bias=1,,2@8", "write TARGET:KIND=VALUES@ONSET-END"),
        ("altimeter:bias=nan@8", "write TARGET:KIND=VALUES@ONSET-END"),
        ("altimeter:bias=１@8", "write TARGET:KIND=VALUES@ONSET-END"),
        ("x" * 1000, "write TARGET:KIND=VALUES@ONSET-END"),
        ("altimeter:frozen=1@8", "altimeter_range:frozen with 1 values; give none"),
        (
            "depth:spikes=1",
            "give size [unit of the channel], more than 0 to 1e+06; share of the readings [-]",
        ),
        (
            "depth:spikes=1,1.5",
            "depth:spikes with the value 1.5; give share of the readings [-], more than 0 to 1",
        ),
        ("depth:late=0", "give extra delay [s], more than 0 to 1000"),
        ("thruster3:weak=1", "give share [-], 0 to less than 1"),
        (
            "payload:mass",
            (
                "give mass [kg], more than 0 to 10000; displaced volume [m3], 0 to 10, the first 1"
                " of them"
            ),
        ),
        ("current:step=1,0", "current:step with 2 values; give velocity in W [m/s], -10 to 10"),
        ("depth:lost@-1", "onset of depth:lost = -1 s; give 0 to 86400 s"),
        (
            "depth:lost@2-1",
            "depth:lost with onset = 2 s, end = 1 s; give an end after the onset, within a day",
        ),
    ],
)
def test_what_is_no_fault_is_refused_in_one_line(text: str, told: str) -> None:
    with pytest.raises(UvmsError) as error:
        parse_fault(text)
    assert told in str(error.value)
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 500


def test_values_that_are_no_numbers_are_refused() -> None:
    for values in ((math.nan,), (math.inf,)):
        with pytest.raises(InvalidInput, match="bias"):
            Fault(target="depth", kind="bias", values=values)
    with pytest.raises(InvalidInput):
        Fault(target="depth", kind="lost", onset=math.nan)
    with pytest.raises(NameNotFound):
        Fault(target="depth", kind="nonsense")


@SAME
@given(text=st.text(alphabet="altimeter:frozenbias=@-0123456789.,eE+ \n", max_size=40))
def test_any_text_is_a_fault_or_refused_in_one_line(text: str) -> None:
    try:
        fault = parse_fault(text)
    except UvmsError as error:
        lines = str(error).splitlines()
    else:
        lines = [str(fault)]
        assert parse_fault(lines[0]) == fault
    assert len(lines) == 1
