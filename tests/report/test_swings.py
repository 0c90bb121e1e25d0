"""A regular oscillation at the end of a run is told with its period, amplitude and growth, and is a
cause of its own.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from uvms_ocp.record.record import Record
from uvms_ocp.record.swings import SwingWatch, swing_of, swings_among
from uvms_ocp.report.end_of_run import cause_of_end
from uvms_ocp.report.metrics import swings
from uvms_ocp.report.summary import summarize

STORED = Path(__file__).parents[1] / "records" / "run_v0_1.npz"
DT = 0.02
T = np.arange(0.0, 20.0, DT)


@pytest.mark.parametrize("period", [1.1, 2.2, 4.0])
@pytest.mark.parametrize("growth", [0.9, 1.0, 1.1])
def test_period_amplitude_and_growth_are_those_of_the_oscillation(
    period: float, growth: float
) -> None:
    rng = np.random.default_rng(1)
    drift = 0.3 - 0.01 * T
    values = (
        drift
        + 0.05 * growth ** (T / period) * np.sin(2 * np.pi * T / period)
        + 1e-3 * rng.normal(size=len(T))
    )
    swing = swing_of("error", values, DT)
    assert swing is not None
    assert swing.period == pytest.approx(period, rel=0.05)
    assert swing.growth == pytest.approx(growth, abs=0.05)
    assert swing.amplitude == pytest.approx(0.05 * growth ** (T[-1] / period), rel=0.25, abs=0.01)


@pytest.mark.parametrize("kind", ["still", "decay", "noise", "step", "unknown"])
def test_what_does_not_oscillate_is_no_swing(kind: str) -> None:
    rng = np.random.default_rng(2)
    values = {
        "still": np.full(len(T), 0.2),
        "decay": np.exp(-T / 5),
        "noise": np.cumsum(rng.normal(size=len(T))),
        "step": (T > 7.0) * 1.0,
        "unknown": np.full(len(T), np.nan),
    }[kind]
    swing = swing_of("error", values, DT)
    assert swing is None or not swing.regular


def watched(amplitude: float, period: float, *, phases: int = 1) -> list[tuple[float, str]]:
    """When [s] which swing is told of while a pitch swings by this [rad] for 30 s in each of some
    phases.
    """
    watch = SwingWatch(DT, floating=True)
    swings = []
    for k in range(round(30.0 * phases / DT)):
        pitch = amplitude * np.sin(2 * np.pi * k * DT / period)
        q = np.array(
            [0.0, 0.0, 0.0, *pin.Quaternion(pin.rpy.rpyToMatrix(0.0, pitch, 0.4)).coeffs()]
        )
        errors = np.array([0.2 + pitch, np.nan])
        swings += [
            (k * DT, swing.what)
            for swing in watch.after(k * DT // 30.0, q, errors, {0: ("PC.position_error", 0.1)})
        ]
    return swings


@pytest.mark.sampled
@pytest.mark.parametrize("period", [1.5, 3.0])
def test_a_swing_is_told_of_once_a_phase_within_four_of_its_periods(period: float) -> None:
    swings = watched(0.1, period, phases=2)
    assert [channel for _, channel in swings].count("pitch") == 2
    assert [channel for _, channel in swings].count("PC.position_error") == 2
    assert swings[0][0] <= 4 * period
    assert watched(0.01, period) == []


@pytest.mark.parametrize(("speed", "swinging"), [(0.0, True), (0.05, True), (0.4, False)])
@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_an_error_that_only_falls_does_not_swing(
    speed: float, swinging: bool, noise: float
) -> None:
    """A vehicle that slows down past each of three rocks on its way comes nearer all the time."""
    rng = np.random.default_rng(4)
    values = 11.0 - speed * T + 0.2 * np.sin(2 * np.pi * T / 5.0) + noise * rng.normal(size=len(T))
    found_swings = list(swings_among({"PC.position_error": (values, 0.1)}, {}, DT))
    assert bool(found_swings) == swinging


@pytest.mark.parametrize("dt", [0.15, 3.0, 50.0])
def test_any_control_period_is_watched(dt: float) -> None:
    watch = SwingWatch(dt, floating=False)
    q = np.zeros(7)
    swings = []
    for k in range(200):
        swings += watch.after(0, q, np.array([0.3 * (-1) ** (k // 2)]), {0: ("error", 0.1)})
    assert all(swing.what == "error" for swing in swings)


def swung(amplitude: float) -> Record:
    """A stored run that does not complete, held in its last phase, with a pitch of this amplitude
    [rad].
    """
    stored = Record.load(STORED)
    n = round(20.0 / stored.run_meta.dt)
    meta = stored.run_meta.model_copy(update={"events": (), "completed": False})
    series = {name: np.repeat(values[:1], n, axis=0) for name, values in stored.series.items()}
    t = meta.dt * np.arange(n)
    quaternions = [
        pin.Quaternion(pin.rpy.rpyToMatrix(0.0, amplitude * np.sin(2 * np.pi * x / 2.2), 0.4))
        for x in t
    ]
    series["q"][:, 3:7] = [quaternion.coeffs() for quaternion in quaternions]
    return Record(series={**series, "t": t}, meta=meta)


def test_a_pitch_that_swings_is_the_cause_of_a_mission_that_does_not_end() -> None:
    record = swung(0.17)
    (swing,) = swings(record)
    assert swing.what == "pitch"
    assert swing.period == pytest.approx(2.2, rel=0.02)
    cause = cause_of_end(record)
    assert cause["kind"] == "swinging"
    assert "pitch swings by +-0.17 every 2.2 s, neither growing nor dying away" in cause["text"]
    (row,) = summarize(record)["swings"]
    assert row["what"] == "pitch"
    assert cause_of_end(swung(0.01))["kind"] != "swinging"
