"""Faults of a user's own strike what sensors tell and what the plant is told, from their onset to
their end.
"""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pytest
from compiler import long_without_compiler
from own_examples import LooseCable

from uvms_ocp.errors import InvalidInput
from uvms_ocp.report import summarize
from uvms_ocp.robot.signals import Command, Readings
from uvms_ocp.scenario.cases import case1
from uvms_ocp.scenario.scenario import Scenario


def flown(**options: Any) -> Scenario:
    return case1(dt=0.02, duration=3.0, noise=True, **options)


@pytest.mark.slow
@long_without_compiler
def test_up_to_its_onset_and_without_it_a_run_is_the_same() -> None:
    sound = flown().run()
    struck = replace(flown(), faults=(LooseCable(onset=1.0),)).run()
    before = sound["t"] < 1.0
    for name in ("q", "q_estimated", "command", "thrust"):
        np.testing.assert_array_equal(struck[name][before], sound[name][before], err_msg=name)
    assert not np.array_equal(struck["q"], sound["q"])
    whole = replace(flown(), faults=(LooseCable(onset=5.0),)).run()
    np.testing.assert_array_equal(whole["q"], sound["q"])


@long_without_compiler
def test_a_dvl_that_came_loose_is_noticed_and_heard_again_after_the_end() -> None:
    alarms = replace(flown(), faults=(LooseCable(onset=1.0, end=2.0),)).run().run_meta.alarms
    told = [(alarm.t, alarm.text) for alarm in alarms if alarm.text.startswith("linear_velocity")]
    lost = next(told for told in told if told[0] > 1.0)
    again = told[-1]
    assert 1.0 < lost[0] < 2.0 <= again[0]
    assert "silent" in lost[1]
    assert again[1] == "linear_velocity good again"


@long_without_compiler
def test_thrusters_that_hear_half_give_half() -> None:
    one_tick = {"duration": 0.02}
    sound, struck = (
        replace(flown(), **one_tick, faults=f).run()
        for f in ((), (LooseCable(onset=0.0, share=0.0),))
    )
    assert np.abs(sound["thrust"][-1]).max() > 0.0
    np.testing.assert_array_equal(struck["thrust"][-1], 0.0)


@long_without_compiler
def test_own_faults_stand_beside_those_of_the_toolkit_in_record_and_report() -> None:
    scenario = flown(faults=("depth:frozen@1",))
    record = replace(
        scenario, duration=0.1, faults=(*scenario.faults, LooseCable(onset=1.0, end=2.0))
    ).run()
    assert [fault["text"] for fault in summarize(record)["faults"]] == [
        "depth:frozen@1",
        "LooseCable@1-2",
    ]


@pytest.mark.parametrize(
    "times", [{"onset": 2.0, "end": 1.0}, {"onset": -1.0}, {"onset": float("nan")}, {"onset": "1"}]
)
def test_a_fault_that_ends_before_it_begins_is_refused(times: dict[str, Any]) -> None:
    with pytest.raises(
        InvalidInput,
        match=r"faults: LooseCable with onset = .*; give a Fault, or what makes one, with times",
    ):
        replace(flown(), faults=(LooseCable(**times),))


class Odd(LooseCable):
    """One that gives a plant or a filter what they cannot take."""

    def __call__(self, scenario: Scenario) -> Any:
        return OddOfRun()


class OddOfRun:
    left: Any = None
    heard: Any = None

    def readings(self, readings: Readings, t: float) -> Any:
        return self.heard or readings

    def command(self, command: Command, t: float) -> Any:
        return self.left(command) if callable(self.left) else command


@long_without_compiler
@pytest.mark.parametrize(
    ("changed", "heard", "message"),
    [
        (lambda command: 3.0, None, "fault Odd returned float for a command; return a Command"),
        (
            lambda c: replace(c, thrust=np.zeros(3)),
            None,
            r"command of fault Odd has thrust of shape \(3,\); give 8 finite",
        ),
        (
            lambda c: replace(c, torque=None),
            None,
            "command of fault Odd has torque None; give 7 finite numbers",
        ),
        (
            lambda c: replace(c, v=c.v * np.nan),
            None,
            "command of fault Odd has v not finite; give 13 finite numbers",
        ),
        (None, 3.0, "sensors with fault Odd returned float; return Readings"),
    ],
)
def test_what_a_fault_leaves_is_looked_at(
    changed: Any, heard: Any, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(OddOfRun, "left", staticmethod(changed) if changed else None)
    monkeypatch.setattr(OddOfRun, "heard", heard)
    with pytest.raises(InvalidInput, match=message):
        replace(flown(), faults=(Odd(onset=0.0),)).run()


def test_a_scenario_takes_faults_as_the_shell_takes_them() -> None:
    text = "altimeter:frozen@0.5"
    cable = LooseCable(onset=1.0)
    sound = flown()
    (parsed,) = flown(faults=text).faults
    for requested, more in ((text, 0), ((text,), 0), ((text, cable), 1), ((parsed,), 0)):
        faults = replace(sound, faults=requested).faults
        assert len(faults) == 1 + more
        assert asdict(faults[0]) == asdict(parsed)
    with pytest.raises(InvalidInput, match="write TARGET:KIND=VALUES@ONSET-END"):
        replace(sound, faults="nonsense")
