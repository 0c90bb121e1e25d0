"""Run the filter and the health monitor over a recording, and compare its readings with the filter's
predictions.

For a run with the sensors of the robot's file, the estimate equals that of the run to the last bit.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from uvms_ocp.checks import checked, checked_dataclass
from uvms_ocp.identification.recording import Recording
from uvms_ocp.record.display import SmallTable, TableDisplay, cell
from uvms_ocp.record.meta_values import AlarmMeta
from uvms_ocp.record.record import Record
from uvms_ocp.record.recorder import Recorder
from uvms_ocp.report.summary import sensor_health
from uvms_ocp.robot import Command, Robot, SensorSpecs, StateEstimate
from uvms_ocp.robot.signals import robot_sensors, with_sensors
from uvms_ocp.scenario.log_expectations import expectations_of_log
from uvms_ocp.scenario.recorded_filter import RecordedFilter
from uvms_ocp.scenario.recorded_readings import (
    faulty_readings,
    readings_of_log,
    readings_of_run,
)
from uvms_ocp.scenario.run_metadata import meta_without_mission
from uvms_ocp.sim import Fault, injected_faults
from uvms_ocp.types import Period


@checked_dataclass(eq=False, repr=False)
class RecordedEstimate(TableDisplay):
    """Estimate over a recording, and how well each channel agrees with it."""

    record: Record
    """The estimate and its standard deviations, in the series of a run, beside the truth where the
    recording has it; ``innovation`` (n, n_channels): squared innovation over its covariance and its
    degrees of freedom, NaN where nothing was compared.
    """
    channels: tuple[Mapping[str, Any], ...]
    """A row for each channel; `estimate_recording` describes its columns."""
    same: bool | None = None
    """True where the estimate equals the one that the run recorded, to the last bit; `None` for a
    recording without an estimate.
    """

    def _table(self) -> SmallTable:
        rows = []
        for channel in self.channels:
            rows.append(tuple(cell(value) for value in channel.values()))
        head = tuple(self.channels[0])
        return SmallTable(title=self.record.meta.scenario, head=head, rows=tuple(rows))


@checked
def estimate_recording(
    recording: Record | Recording,
    robot: Robot,
    *,
    specs: SensorSpecs | None = None,
    dt: Period = 1 / 200,
    faults: tuple[Fault, ...] = (),
    folder: Path | str | None = None,
) -> RecordedEstimate:
    """Estimate the robot's motion from the readings of a recording, as the loop of `Scenario.run`
    does.

    recording: record of a run with noisy sensors, whose commands the filter gets too; or a
    recording by other software, without commands, whose newest readings the filter gets at every
    tick of dt [s]. specs: sensors to expect, by default those of the robot's file; of a recording by
    other software with the rates, delays and noise that it has itself. faults: faults of sensors, applied to the readings.
    folder: new folder, to which rows are written in place of memory.

    Columns of each channel: number of ``readings`` that arrived, their mean delay ``delay_s``, how
    many the filter ``compared`` with its prediction and how many of these it ``refused``; ``ratio``
    of the median size of innovations to the expected one, 1 where sensor, noise and motion are as
    expected; ``sigma`` [unit of the channel] that is expected, and ``proposed_sigma``, which would
    explain the innovations if the sensor caused all of them; then the columns of `sensor_health`.

    Raises `InvalidInput` for a record without readings, for channels that do not fit the robot, and
    for other faults.
    """
    expected = specs or robot_sensors(robot.description)
    tuning = None
    run = None
    if isinstance(recording, Recording):
        title = f"estimate of {recording.name}"
        if specs is None:
            expectations = expectations_of_log(recording, robot, expected, dt)
            expected = expectations.specs
            tuning = expectations.tuning
        arrivals, n_ticks, dt = readings_of_log(recording, robot, expected, dt)
    else:
        run = recording
        title = f"estimate of {run.meta.scenario}"
        arrivals, n_ticks, dt = readings_of_run(run, robot, expected.own)
    absent = [name for name in expected.present if name not in arrivals]
    expected = with_sensors(expected, dict.fromkeys(absent))
    arrivals |= faulty_readings(arrivals, robot, faults, dt, expected.own)
    filtering = RecordedFilter(robot, expected, arrivals, tuning)
    recorder = Recorder(folder=None if folder is None else Path(folder))
    for tick in range(n_ticks):
        t = tick * dt
        filtered = filtering.advance(tick, t, _command_before(run, tick))
        row = _estimate_columns(t, filtered.estimate)
        row["innovation"] = filtered.innovation
        row["refused"] = filtered.refused
        recorder.append(row)
    series = recorder.series()
    meta = meta_without_mission(
        robot,
        title,
        "recording",
        dt=dt,
        channels=filtering.channels,
        alarms=tuple(AlarmMeta(t=t, text=text) for t, text in filtering.monitor.alarms),
        faults=tuple(injected_faults.fault_meta(fault) for fault in faults),
        plant="recorded",
        completed=True,
    )
    if run is None:
        record = Record(series=series, meta=meta)
        is_same = None
    else:
        record = Record(series=series | {"q": run["q"], "v": run["v"]}, meta=meta)
        names = ("q_estimated", "v_estimated")
        is_same = all(np.array_equal(run[name], series[name]) for name in names)
    rows = []
    agreement = filtering.agreement(series["innovation"], series["refused"])
    for agreement_row, health_row in zip(agreement, sensor_health(record), strict=True):
        rows.append({**agreement_row, **health_row})
    return RecordedEstimate(record=record, channels=tuple(rows), same=is_same)


def _command_before(run: Record | None, tick: int) -> Command | None:
    """Return the command that a run gave in the tick before this one; `None` for none."""
    if run is None or tick == 0:
        return None
    return Command(v=run.series["command"][tick - 1], brakes=bool(run.series["brakes"][tick - 1]))


def _estimate_columns(t: float, estimate: StateEstimate) -> dict[str, Any]:
    """Return the estimate of a tick in the columns of a record."""
    health = [channel_health.trust for channel_health in estimate.health]
    return {
        "t": t,
        "q_estimated": estimate.q,
        "v_estimated": estimate.v,
        "q_std": estimate.std,
        "altimeter_range": estimate.altimeter_range,
        "altimeter_std": estimate.altimeter_std,
        "health": np.array(health, dtype=np.int8),
    }
