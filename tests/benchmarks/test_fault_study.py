"""The study of faults: its table says all, its cases cross all, and its judge goes by the truth."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from compiler import long_without_compiler
from recording.rows import column, known_values, rows_where
from studies.fault_study import by_kind, faults, nominal, run_faults
from studies.fault_table import GUSTY, KINDS, PAIR, PHASES, SIZES, STILL
from studies.fault_truth import (
    arm_height,
    astray,
    contact_outside_landing,
    is_named,
    joint_excess,
    passes_rates,
    rate_share,
)

from uvms_ocp.errors import NameNotFound
from uvms_ocp.record.record import Record
from uvms_ocp.robot.signals import SensorSpecs
from uvms_ocp.scenario.cases.case1 import case1
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.sim.faults import parse_faults

QUICK = {"plant": "kinematic", "dt": 0.05, "duration": 60.0}

pytestmark = [
    pytest.mark.filterwarnings(
        "ignore::DeprecationWarning", "ignore::ResourceWarning", "ignore::FutureWarning"
    ),
    pytest.mark.slow,
]


@pytest.fixture(scope="module", name="scenario")
def _scenario() -> Scenario:
    return case1(plant="kinematic", dt=0.05)


@pytest.fixture(scope="module", name="record")
def _record(scenario: Scenario) -> Record:
    return scenario.run()


def test_every_channel_that_robots_have_by_default_fails_in_seven_ways() -> None:
    channels = SensorSpecs().present.keys()
    assert set(SIZES) >= channels
    for channel in channels:
        for word in ("frozen", "lost", "nan", "spikes", "bias", "drift", "late"):
            assert f"{channel} {word}" in KINDS
    assert len(KINDS) >= 30


@pytest.mark.parametrize("name", KINDS)
def test_every_kind_can_befall_the_mission(name: str, scenario: Scenario) -> None:
    faults_of_kind = KINDS[name].faults(12.3)
    assert {fault.onset for fault in faults_of_kind} == {12.3}
    assert case1(noise=True, faults=faults_of_kind).faults == faults_of_kind


def test_the_cases_cross_kinds_phases_and_seeds() -> None:
    cases = faults().cases
    assert len({repr(case) for case in cases}) == len(cases) == 20 * len(KINDS) + 200 + 2 * 100
    crossed = {(case["kind"], case["phase"], case["seed"]) for case in cases}
    assert crossed >= set(product(KINDS, PHASES, range(5)))


def test_pairs_are_two_kinds_each_with_its_phase_and_the_same_every_time() -> None:
    pairs = rows_where(faults(n=1, fault_free=0).cases, "kind", PAIR)
    assert pairs == rows_where(faults(n=2, fault_free=3).cases, "kind", PAIR)
    assert all(len(set(case["pair"])) == len(case["phase"].split()) == 2 for case in pairs)
    kinds = set().union(*column(pairs, "pair"))
    assert kinds >= set(list(KINDS)[:10])
    assert len(set(column(pairs, "seed"))) == len(pairs) == 200


def test_an_unknown_kind_or_phase_is_named() -> None:
    with pytest.raises(NameNotFound, match="Did you mean 'thruster dead'"):
        faults(kinds=["thruster deed"])
    with pytest.raises(NameNotFound, match="one of phases 'E'"):
        faults(phases=["E"])


@long_without_compiler
def test_faults_set_in_in_the_middle_of_the_phases_of_a_sound_run() -> None:
    middles = nominal("kinematic", 0.05).middles
    record = case1(noise=True, plant="kinematic", dt=0.05).run()
    for phase, t in middles.items():
        row = int(np.searchsorted(record["t"], t))
        assert record.meta.phases[record["phase"][row]].name == phase
    assert tuple(middles) == PHASES


@long_without_compiler
def test_rows_are_judged_and_summed_up_by_kind() -> None:
    study = faults(
        n=1, fault_free=1, pairs=1, kinds=["joint 2 jammed", "position bias"], phases=["A"], **QUICK
    )
    result = study.run()
    jammed, biased, pair, *sound = result.cases
    assert (pair["kind"], pair["phase"], pair["named"]) == (PAIR, "A A", True)
    faults_of_pair = {part.partition("@")[0] for part in pair["faults"].split()}
    assert faults_of_pair == {"joint2:jam", "position:bias=5,0,0"}
    assert column(sound, "kind") == [STILL, GUSTY]
    for row in sound:
        assert (row["end"], row["alarms_before"], row["faults"]) == ("completed", 0, "")
        assert row["astray_m"] < 0.1
        assert 0.0 < row["tool_bound_m"] < 0.05
    assert biased["astray_m"] < 1.0, (
        "fixes that jump by 5 m are refused, and it climbs by less than 1 m"
    )
    assert all(seconds >= 0.0 for seconds in known_values(result.cases, "to_detect_s"))
    kinds = ["joint 2 jammed", "position bias", PAIR, STILL, GUSTY]
    assert column(result.table, "kind") == kinds
    assert result.table[0]["completed"] == (jammed["end"] == "completed")
    assert set(column(result.table, "runs")) == {1}


def test_a_run_that_raises_is_a_row(monkeypatch: pytest.MonkeyPatch) -> None:
    def raising(*_: object, **__: object) -> Record:
        raise FloatingPointError("overflow\nof all")

    (case,) = faults(n=1, fault_free=0, kinds=["joint 2 jammed"], phases=["A"], **QUICK).cases
    usual = run_faults(case)
    monkeypatch.setattr(Scenario, "run", raising)
    row = run_faults(case)
    assert (row["end"], row["cause"], row["passed"]) == (
        "error",
        "FloatingPointError: overflow of all",
        False,
    )
    assert row.keys() == usual.keys()
    assert by_kind([usual, row])[0]["runs"] == 2


def sunk(record: Record, rows: slice, depth: float) -> Record:
    """The record with a vehicle that is lower than it was."""
    q = record["q"].copy()
    q[rows, 2] = -40.0 + 0.5 - depth  # its skid is half a metre below its origin
    q[rows, 3:7] = (0.0, 0.0, 0.0, 1.0)
    return Record(series={**record.series, "q": q}, meta=record.meta)


def in_phase(record: Record, name: str) -> np.ndarray:
    names = [phase.name for phase in record.meta.phases]
    return np.flatnonzero(record["phase"] == names.index(name))


def test_contact_on_the_way_is_none_of_the_landing(scenario: Scenario, record: Record) -> None:
    first = int(in_phase(record, "A")[10])
    touching = sunk(record, slice(first, first + 20), 0.03)
    contact = contact_outside_landing(scenario, touching)
    assert contact.seconds == pytest.approx(20 * scenario.dt)
    assert contact.depth == pytest.approx(0.03, abs=1e-3)
    assert not contact.at_the_end
    assert contact_outside_landing(scenario, touching, 0.05).seconds == 0.0


def test_contact_that_the_mission_goes_on_from_is_its_landing(
    scenario: Scenario, record: Record
) -> None:
    touch = int(in_phase(record, "C")[-3])
    assert contact_outside_landing(scenario, sunk(record, slice(touch, None), 0.03)).seconds == 0.0


def beginning_of(record: Record, n: int) -> Record:
    """The first rows of a record."""
    series = {name: values[:n] for name, values in record.series.items()}
    return Record(series=series, meta=record.meta)


def test_pushing_into_the_floor_without_landing_is_contact_at_the_end(
    scenario: Scenario, record: Record
) -> None:
    cut = int(in_phase(record, "C")[-1])
    short = beginning_of(record, cut)
    contact = contact_outside_landing(scenario, sunk(short, slice(cut - 30, None), 0.03))
    assert contact.at_the_end
    assert contact.seconds == pytest.approx(30 * scenario.dt)


def test_what_is_no_number_is_as_bad_as_can_be(scenario: Scenario, record: Record) -> None:
    q = record["q"][:20].copy()
    q[5:] = np.nan
    broken = Record(series={**beginning_of(record, 20).series, "q": q}, meta=record.meta)
    assert joint_excess(scenario.robot, q) == np.inf
    assert arm_height(scenario, q) == -np.inf
    assert astray(record["q"][:, :3], q) == np.inf
    contact = contact_outside_landing(scenario, broken)
    assert contact.at_the_end
    assert contact.depth == np.inf


def test_excess_and_distance_are_those_of_the_truth(scenario: Scenario, record: Record) -> None:
    q = record["q"].copy()
    joints = scenario.robot.joint_q
    q[7, joints] = scenario.robot.limits.position_upper + np.linspace(
        0.0, 0.03, scenario.robot.n_joints
    )
    assert joint_excess(scenario.robot, q) == pytest.approx(0.03)
    assert joint_excess(scenario.robot, record["q"]) == 0.0
    limits = scenario.robot.limits.velocity
    v = 0.1 * np.tile(limits, (5, 1))
    v[3, scenario.robot.joint_v.start] = -1.3 * limits[scenario.robot.joint_v.start]
    assert rate_share(scenario.robot, v) == pytest.approx(1.3)
    q[20, :3] += [0.0, 0.0, 50.0]
    assert astray(record["q"][:, :3], q) == pytest.approx(50.0, abs=0.5)


@pytest.mark.parametrize(
    ("share", "t", "passes"),
    [(1.01, 5.0, False), (1.05, 5.0, True), (1.1, 8.3, False), (1.3, 8.3, True)],
)
def test_rates_may_pass_their_limits_by_more_as_a_fault_begins(
    share: float, t: float, passes: bool, scenario: Scenario, record: Record
) -> None:
    v = 0.0 * record["v"]
    joint = scenario.robot.joint_v.start
    v[np.searchsorted(record["t"], t), joint] = share * scenario.robot.limits.velocity[joint]
    moved = Record(series={**record.series, "v": v}, meta=record.meta)
    assert passes_rates(scenario.robot, moved, [8.0]) is passes


@pytest.mark.parametrize(
    ("faults_", "text", "named"),
    [
        (["altimeter:frozen"], "altimeter: frozen since 8.1 s", True),
        (["linear_velocity:lost"], "linear velocity is lost", True),
        (["linear_velocity:lost"], "angular_velocity is lost", False),
        (["thruster3:dead"], "thruster horizontal_stern_port is taken out", True),
        (["thruster3:dead", "thruster6:dead"], "thruster3 is taken out", False),
        (["joint3_position:frozen"], "joint_positions: joint 3 frozen", True),
        (["joint2:jam"], "joint2 does not move", True),
        (["current:step=1,0,0"], "the disturbance is too large", True),
        (["altimeter:frozen"], "measurements are 0.60 s old: holding", False),
    ],
)
def test_a_cause_is_named_by_any_of_its_names(
    faults_: list[str], text: str, named: bool, scenario: Scenario
) -> None:
    assert is_named(parse_faults(faults_), scenario.robot, ["", text]) is named
