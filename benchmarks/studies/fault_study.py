"""Case 1 with everything going wrong that can: every kind of fault in every phase, judged by the
truth.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from recording.rows import column, known_values, rows_where

from studies import fault_truth as truth
from studies.fault_table import (
    ASTRAY,
    FLOOR,
    GUSTS,
    GUSTY,
    JOINTS,
    KINDS,
    PAIR,
    PHASES,
    REACH,
    STILL,
    FaultKind,
)
from studies.study import Study
from uvms_ocp.campaign.jobs import Row
from uvms_ocp.checks import checked
from uvms_ocp.errors import NameNotFound
from uvms_ocp.record.record import Record
from uvms_ocp.report.end_of_run import cause_of_end
from uvms_ocp.report.metrics import error_bound
from uvms_ocp.report.summary import summarize
from uvms_ocp.scenario.cases.case1 import case1
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.sim.currents import GustyCurrent
from uvms_ocp.sim.faults import Fault
from uvms_ocp.types import AtLeastOne, Count, Period

_COMPLETED = "completed"
_ERROR = "error"


@checked
def faults(
    *,
    n: AtLeastOne = 5,
    seed: Count = 0,
    fault_free: Count = 100,
    pairs: Count = 200,
    kinds: Sequence[str] = tuple(KINDS),
    phases: Sequence[str] = PHASES,
    plant: str = "dynamic",
    dt: Period = 1 / 200,
    duration: Period = 120.0,
) -> Study:
    """All `kinds` of `KINDS` that set in in each of the `phases`, with the n seeds `seed`, `seed` +
    1, ...

    fault_free: runs without faults in still water, and as many in gusts. pairs: runs with two
    faults, whose kinds and phases are drawn. Sensors are noisy. dt [s]: control period; duration
    [s] of a run at most. Raises `NameNotFound` for an unknown kind or phase.
    """
    _check_names("one of kinds", kinds, KINDS)
    _check_names("one of phases", phases, PHASES)
    common = {"plant": plant, "dt": dt, "duration": duration}
    cases = list[dict[str, Any]]()
    for kind in kinds:
        for phase in phases:
            for k in range(n):
                cases.append({"kind": kind, "phase": phase, "seed": seed + k, **common})
    rng = np.random.default_rng(seed)
    n_pairs = pairs if len(kinds) > 1 else 0
    for k in range(n_pairs):
        pair = rng.choice(list(kinds), 2, replace=False).tolist()
        phase = " ".join(rng.choice(list(phases), 2).tolist())
        cases.append({"kind": PAIR, "phase": phase, "pair": pair, "seed": seed + k, **common})
    for kind in (STILL, GUSTY):
        for k in range(fault_free):
            cases.append({"kind": kind, "phase": "", "seed": seed + k, **common})
    return Study(
        name="faults",
        title=f"Case 1 with {len(kinds)} kinds of faults",
        cases=cases,
        run_case=run_faults,
        summarize=by_kind,
    )


def _check_names(argument: str, names: Sequence[str], allowed: Collection[str]) -> None:
    for name in names:
        if name not in allowed:
            raise NameNotFound(argument, name, allowed)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Nominal:
    """Path and phases of a run without faults and gusts."""

    way: np.ndarray
    """(m, 3) [m] of the vehicle."""
    middles: dict[str, float]
    """[s] by phase."""


@lru_cache(maxsize=4)
def nominal(plant: str, dt: float) -> Nominal:
    """The run of seed 0 on this plant; dt [s]: control period."""
    record = case1(noise=True, plant=plant, dt=dt).run()
    times = [0.0, *(event.t for event in record.run_meta.events)]
    middles = {}
    for name, begin, end in zip(PHASES, times, times[1:], strict=False):
        middles[name] = round(0.5 * (begin + end), 1)
    return Nominal(way=record["q"][::_EVERY, :3].copy(), middles=middles)


_EVERY = 10  # rows between two points of the way


def run_faults(case: dict[str, Any]) -> Row:
    """One run, and what truly became of it; one that raises is a row too."""
    usual = nominal(case["plant"], case["dt"])
    names = case.get("pair", [case["kind"]])
    fault_kinds = [KINDS[name] for name in names if name in KINDS]
    onsets = [usual.middles[phase] for phase in case["phase"].split()]
    injected: tuple[Fault, ...] = ()
    joints = 0.0
    floor = 0.0
    for fault_kind, onset in zip(fault_kinds, onsets, strict=True):
        injected += fault_kind.faults(onset)
        joints += fault_kind.joints
        floor += fault_kind.floor
    kind = FaultKind(name=case["kind"], texts=(), joints=joints, floor=floor)
    current = None
    if case["kind"] == GUSTY:
        current = GustyCurrent(sigma=GUSTS, seed=case["seed"])
    scenario = case1(
        noise=True,
        seed=case["seed"],
        plant=case["plant"],
        dt=case["dt"],
        duration=case["duration"],
        faults=injected,
        current=current,
    )
    head = {name: case[name] for name in ("kind", "phase", "seed")}
    head |= {"faults": " ".join(map(str, injected)), "onset_s": min(onsets, default=None)}
    try:
        record = scenario.run()
    except Exception as error:  # whatever it is: the study has to tell
        text = " ".join(f"{type(error).__name__}: {error}".split())
        return {**head, **dict.fromkeys(_COLUMNS), "end": _ERROR, "cause": text, "passed": False}
    return {**head, **_judged(scenario, record, kind, usual)}


_COLUMNS = (
    "end",
    "end_s",
    "cause",
    "alarms_before",
    "alarm_s",
    "alarm",
    "to_detect_s",
    "named",
    "contact_s",
    "contact_m",
    "ends_in_contact",
    "arm_m",
    "joints_rad",
    "rate_share",
    "rates_named",
    "astray_m",
    "tool_m",
    "tool_bound_m",
    "passed",
)


def _judged(scenario: Scenario, record: Record, kind: FaultKind, usual: Nominal) -> Row:
    cause = cause_of_end(record)
    contact = truth.contact_outside_landing(scenario, record, kind.floor)
    alarms = _alarms(scenario.toolkit_faults, scenario, record, cause["text"], kind.name == PAIR)
    joints = truth.joint_excess(scenario.robot, record["q"])
    way = truth.astray(usual.way, record["q"])
    completed = record.run_meta.completed
    rates = truth.rate_share(scenario.robot, record["v"])
    arm = truth.arm_height(scenario, record["q"])
    onsets = [fault.onset for fault in scenario.toolkit_faults]
    passes = truth.passes_rates(scenario.robot, record, onsets)
    rates_named = not passes or bool(summarize(record)["passed_rates"])
    tool_error = None
    tool_bound = None
    if completed:
        tool_error = record.run_meta.true_quantity("T.position_error")
        tool_bound = error_bound(record, "T.position_error")
    harmless = (
        not contact.at_the_end
        and joints <= JOINTS + kind.joints
        and way <= ASTRAY
        and arm >= -FLOOR - kind.floor - REACH * kind.joints
        and rates_named
    )
    values = {
        "end": _COMPLETED if completed else cause["kind"],
        "end_s": float(record["t"][-1]),
        "cause": cause["text"],
        **alarms,
        "contact_s": contact.seconds,
        "contact_m": contact.depth,
        "ends_in_contact": contact.at_the_end,
        "arm_m": arm,
        "joints_rad": joints,
        "rate_share": rates,
        "rates_named": rates_named,
        "astray_m": way,
        "tool_m": tool_error,
        "tool_bound_m": tool_bound,
        "passed": harmless and (completed or bool(alarms["named"])),
    }
    return {name: values[name] for name in _COLUMNS}


def _alarms(
    faults: Sequence[Fault], scenario: Scenario, record: Record, cause: str, pair: bool
) -> Row:
    """Sort the alarms of a run: those before the onset are false ones. Of a pair of faults, one
    ends what would show the other.
    """
    alarms = record.run_meta.alarms
    onset = min((fault.onset for fault in faults), default=np.inf)
    after = [alarm for alarm in alarms if alarm.t >= onset]
    row: dict[str, Any] = {
        "alarms_before": len(alarms) - len(after),
        "alarm_s": None,
        "alarm": alarms[0].text if alarms else "",
        "to_detect_s": None,
        "named": None,
    }
    if after:
        row["alarm_s"] = after[0].t
        row["alarm"] = after[0].text
        row["to_detect_s"] = after[0].t - onset
    if faults:
        texts = [cause]
        texts += [alarm.text for alarm in alarms]
        named = []
        for fault in faults:
            if fault.onset <= record["t"][-1]:
                named.append(truth.is_named([fault], scenario.robot, texts))
        if pair:
            row["named"] = any(named)
        else:
            row["named"] = all(named)
    return row


def by_kind(rows: Sequence[Row]) -> list[Row]:
    """One row per kind: how its runs ended, the worst of what truly happened, and how soon it was
    noticed.
    """
    kinds = dict.fromkeys(column(rows, "kind"))
    return [_sum(kind, rows_where(rows, "kind", kind)) for kind in kinds]


def _sum(kind: str, rows: Sequence[Row]) -> Row:
    ends = Counter(column(rows, "end"))
    failures = [f"{end} {number}" for end, number in ends.items() if end != _COMPLETED]
    noticed = known_values(rows, "to_detect_s")
    median_to_detect = None
    if noticed:
        median_to_detect = float(np.median(noticed))
    not_named = 0
    for row in rows:
        if row["faults"] and row["end"] != _COMPLETED and not row["named"]:
            not_named += 1
    largest = {}
    for name in ("contact_m", "joints_rad", "rate_share", "astray_m", "tool_m"):
        largest[f"largest_{name}"] = max(known_values(rows, name), default=None)
    return {
        "kind": kind,
        "runs": len(rows),
        "completed": ends[_COMPLETED],
        "other_ends": ", ".join(failures),
        "not_named": not_named,
        "false_alarms": sum(known_values(rows, "alarms_before")),
        "noticed": len(noticed),
        "median_to_detect_s": median_to_detect,
        "end_in_contact": sum(map(bool, column(rows, "ends_in_contact"))),
        **largest,
        "least_arm_m": min(known_values(rows, "arm_m"), default=None),
        "passed": sum(map(bool, column(rows, "passed"))),
    }
