"""``identify``, ``excite`` and ``check-recording``: numbers of a robot from its own recordings."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from uvms_ocp.cli.exit_codes import NOT_COMPLETED
from uvms_ocp.cli.options import Json
from uvms_ocp.cli.printing import busy, console_of, print_json, print_line, print_paths, table_of
from uvms_ocp.cli.result_folders import named_folder
from uvms_ocp.errors import InvalidInput, require_known
from uvms_ocp.identification import (
    ExperimentLimits,
    Noise,
    Rollout,
    check_data_quality,
    stage_of,
    write_recording,
)
from uvms_ocp.identification.calibration import Calibration, calibrate
from uvms_ocp.identification.calibration_robot import CalibratedRobot, calibrated_robot
from uvms_ocp.identification.channel_evidence import channel_evidence
from uvms_ocp.identification.channel_mapping import UNITS, read_mapping
from uvms_ocp.identification.experiment_design import (
    DesignSettings,
    DesignStatus,
    ExperimentTask,
    design_experiment,
)
from uvms_ocp.identification.proposed_mapping import propose_mapping
from uvms_ocp.identification.reading import read_recording
from uvms_ocp.identification.recording import (
    ASPECTS,
    CHANNEL_KINDS,
    Channel,
    Recording,
    unit_named,
)
from uvms_ocp.identification.recording_gaps import split_at_gaps
from uvms_ocp.identification.results import excitation_text, report_data, report_text
from uvms_ocp.identification.robot_variant import variant_text, whole_text
from uvms_ocp.identification.settings import CalibrationSettings, read_settings
from uvms_ocp.identification.tables import column_names, read_table
from uvms_ocp.identification.text_tables import TextFormat
from uvms_ocp.record.output import claim_folder
from uvms_ocp.robot.thrusters import curve_of_table, thrust_limits

# ``check-recording``: what is in recordings, and what is doubtful about them.

Recordings = Annotated[
    list[Path],
    typer.Argument(
        metavar="RECORDINGS...",
        help="CSV, Parquet, MCAP, rosbag2 folders or records of runs, one or more.",
    ),
]
MappingFile = Annotated[
    Path | None,
    typer.Option(
        "--mapping",
        metavar="YAML",
        help="Where the channels are in files of others; ours need none.",
    ),
]
_COLUMNS = (
    "channel",
    "columns",
    "unit",
    "frame",
    "least",
    "largest",
    "from [s]",
    "to [s]",
    "rate [Hz]",
    "missing",
    "delay [s]",
)

VARIANT = "calibrated.yaml"
WHOLE = "hydrodynamics.yaml"
IDENTIFY_REPORT = "report.md"
IDENTIFY_DATA = "report.json"
FIGURES = "figures"

COMMANDS = "excitation.csv"
EXCITE_REPORT = "report.md"
_POOL = (6.0, 4.0, 2.0)
_DURATION = 60.0
_SHARE = 0.5
_SLEW = 100.0
_SEED = DesignSettings().seed

_NEWTONS = UNITS["N"]
_VOLTAGE = "volt"  # in names of columns of voltages
_SAG = 0.1  # of a voltage, by which a supply gives way under load


def check_recording(paths: Recordings, mapping: MappingFile = None, as_json: Json = False) -> None:
    """Check recordings: channels, rates, delays, frames, and what is doubtful."""
    recordings = read_recordings(paths, mapping)
    if as_json:
        print_json({recording.name: _recording_data(recording) for recording in recordings})
        return
    console = console_of()
    for recording in recordings:
        data = _recording_data(recording)
        console.print(table_of(recording.name, data["channels"], _COLUMNS))
        rests_on = [_status_row(name, data["evidence"]) for name in recording.channels]
        console.print(table_of("how each is known", rests_on, ("channel", *ASPECTS)))
        for line in (*data["read as"], *(f"doubtful: {doubt}" for doubt in data["doubts"])):
            print_line(console, line)


def map_recording(
    path: Annotated[
        Path, typer.Argument(metavar="RECORDING", help="A file of others, or a folder of ROS 2.")
    ],
) -> None:
    """Propose a mapping of a recording of others, to be edited.

    Channels are found by names, units and frames by what values say; every guess has its evidence
    beside it. Write it to a file by `uvms-ocp map RECORDING > mapping.yaml`.
    """
    typer.echo(propose_mapping(path), nl=False)


def read_recordings(paths: list[Path], mapping: Path | None) -> list[Recording]:
    """Read all of them, by one mapping where they need one. Raises InvalidInput, NameNotFound and
    NotInstalled.
    """
    if mapping is None:
        file_mapping = None
    else:
        file_mapping = read_mapping(mapping)
    return [read_recording(path, file_mapping) for path in paths]


def _recording_data(recording: Recording) -> dict[str, Any]:
    doubts = check_data_quality(recording)
    evidence = []
    for entry in channel_evidence(recording, doubts):
        evidence.append(
            {
                "channel": entry.channel,
                "aspect": entry.aspect,
                "status": entry.status,
                "evidence": entry.evidence,
            }
        )
    return {
        "channels": [_row(name, channel) for name, channel in recording.channels.items()],
        "read as": list(recording.layout),
        "doubts": [str(doubt) for doubt in doubts],
        "evidence": evidence,
    }


def _status_row(name: str, evidence: list[dict[str, str]]) -> dict[str, str]:
    """Return the status of each aspect of one channel."""
    row = {"channel": name}
    for entry in evidence:
        if entry["channel"] == name:
            row[entry["aspect"]] = entry["status"]
    return row


def _row(name: str, channel: Channel) -> dict[str, Any]:
    kind = CHANNEL_KINDS[name]
    values = channel.values
    t = channel.t
    facts = (
        name,
        values.shape[1],
        kind.unit,
        kind.frame,
        float(values.min()),
        float(values.max()),
        float(t[0]),
        float(t[-1]),
    )
    return dict(zip(_COLUMNS, (*facts, channel.rate, channel.missing, channel.delay), strict=True))


# ``identify``: a robot's own numbers, from its own recordings.


def identify(
    settings: Annotated[
        Path, typer.Argument(metavar="YAML", help="What of which robot is to be learnt.")
    ],
    recordings: Recordings,
    out: Annotated[
        Path, typer.Option(metavar="DIR", parser=named_folder, help="Folder for the results.")
    ],
    mapping: MappingFile = None,
    profiles: Annotated[
        bool,
        typer.Option(
            "--profiles", help="Intervals without linearity; each number takes up to a search."
        ),
    ] = False,
    leave_one_out: Annotated[
        bool,
        typer.Option(
            "--leave-one-out", help="Predict every recording from the others; each takes a search."
        ),
    ] = False,
    predict: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="RECORDING",
            help="Recording to predict, on which nothing is identified; several times.",
        ),
    ] = None,
    bounds: Annotated[
        bool,
        typer.Option(
            "--bounds/--no-bounds",
            help="Fit vehicles to what is predicted, which bound predictions.",
        ),
    ] = True,
    axes: Annotated[
        list[str] | None,
        typer.Option(
            metavar="AXIS",
            help="Along which alone it moves, as in decay tests; repeat it for each.",
        ),
    ] = None,
) -> None:
    """Identify a robot from recordings: calibrated file, report and figures.

    calibrated.yaml has what was learnt, each number with its source; hydrodynamics.yaml is the
    robot's file with these in their places, for --hydrodynamics of other commands. Where the search
    does not converge, or determines nothing, neither is written. report.json has numbers and verdicts of report.md.
    """
    calibration_settings = read_settings(settings)
    if axes:
        calibration_settings = CalibrationSettings(
            **calibration_settings.model_dump(exclude_unset=True) | {"axes": axes}
        )
    subject = calibrated_robot(calibration_settings, settings.parent)
    subject.coefficients()  # or it is refused
    sections = split_at_gaps(read_recordings(recordings, mapping))
    predicted_recordings = read_recordings(predict or [], mapping)
    console = console_of()
    names = _names(len(sections), profiles, leave_one_out, predicted=bool(predicted_recordings))
    with claim_folder(out, names) as claim:
        with busy(console, "identifying") as show:
            callbacks = {
                "progress": show,
                "warn": lambda doubt: print_line(console, f"doubtful: {doubt}"),
            }
            result = calibrate(
                subject,
                calibration_settings,
                sections,
                profiled=profiles,
                leave_one_out=leave_one_out,
                predict=predicted_recordings,
                bounds=bounds,
                **callbacks,
            )
        with claim.staged() as staging:
            _write(result, [section.name for section in sections], staging)
        written = claim.written()
    n_determined = sum(number.determined for number in result.numbers)
    console.print(
        f"{result.status.value}; {n_determined} of {len(result.numbers)} numbers determined"
    )
    for line in (*result.verdicts, *result.worse_than_still, *result.disagreed):
        print_line(console, str(line))
    print_paths(console, written)
    if not result.exported.usable:
        print_line(console, f"no robot file is written: {result.exported.advice}")
        raise typer.Exit(NOT_COMPLETED)


def _names(n_sections: int, profiles: bool, leave_one_out: bool, predicted: bool) -> list[str]:
    """Return the names of the files that an identification may write."""
    figures = ["intervals"]
    for section in range(n_sections):
        figures += [f"predicted_{section}", f"residuals_{section}"]
    if profiles:
        figures.append("profiles")
    if leave_one_out:
        figures.append("left_out")
    if predicted:
        figures.append("predicted_others")
    figure_paths = [f"{FIGURES}/{name}.png" for name in figures]
    return [VARIANT, WHOLE, IDENTIFY_REPORT, IDENTIFY_DATA, *figure_paths]


def _write(result: Calibration, names: list[str], staging: Path) -> None:
    from uvms_ocp.viz.identification_figures import write_identification_figures

    if result.exported.usable:  # or nobody should fly with it
        (staging / VARIANT).write_text(variant_text(result, names), encoding="utf-8")
        (staging / WHOLE).write_text(whole_text(result, staging / VARIANT), encoding="utf-8")
    (staging / IDENTIFY_REPORT).write_text(report_text(result), encoding="utf-8")
    data = json.dumps(report_data(result), indent=2, allow_nan=False)
    (staging / IDENTIFY_DATA).write_text(data + "\n", encoding="utf-8")
    write_identification_figures(result, staging / FIGURES)


# ``excite``: commands for a robot that is to be identified.


def excite(
    settings: Annotated[
        Path, typer.Argument(metavar="YAML", help="What of which robot is to be learnt.")
    ],
    out: Annotated[
        Path, typer.Option(metavar="DIR", parser=named_folder, help="Folder for the results.")
    ],
    pool: Annotated[
        tuple[float, float, float],
        typer.Option(metavar="X Y Z", help="Size [m], the vehicle in its middle."),
    ] = _POOL,
    duration: Annotated[float, typer.Option(help="Of a recording [s].")] = _DURATION,
    share: Annotated[float, typer.Option(help="Of the thrusters' limits.")] = _SHARE,
    slew: Annotated[float, typer.Option(help="Largest change of thrust [N/s].")] = _SLEW,
    seed: Annotated[int, typer.Option(min=0, help="Of where the search begins.")] = _SEED,
) -> None:
    """Design thrust that shows what is to be learnt, within a pool.

    excitation.csv has what each thruster is told and when; report.md what a recording of it is
    expected to determine.
    """
    calibration_settings = read_settings(settings)
    subject = calibrated_robot(calibration_settings, settings.parent)
    console = console_of()
    subject.coefficients()  # or it is refused, rather than after it was driven
    thrust = thrust_within(subject, calibration_settings, share)
    limits = ExperimentLimits(
        thrust=thrust,
        pool=np.outer([-0.5, 0.5], pool),
        hull=subject.hull_in_body(calibration_settings.hull),
        slew=slew,
    )
    noise = Noise(**calibration_settings.noise.model_dump())
    joints = tuple(subject.robot.home.tolist())
    task = ExperimentTask(
        vehicle=subject.vehicle, limits=limits, duration=duration, noise=noise, joints=joints
    )
    with claim_folder(out, [COMMANDS, EXCITE_REPORT]) as claim:
        with busy(console, "designing"):
            experiment = design_experiment(
                task, Rollout(stage_of(subject.vehicle)), DesignSettings(seed=seed)
            )
        with claim.staged() as staging:
            write_recording(
                Recording(name="excitation", channels={"thrust": experiment.commands}),
                staging / COMMANDS,
            )
            (staging / EXCITE_REPORT).write_text(
                excitation_text(experiment, subject.vehicle.actuators.names), encoding="utf-8"
            )
        written = claim.written()
    n_determined = sum(number.determined for number in experiment.numbers)
    console.print(
        f"{experiment.status.value};"
        f" {n_determined} of {len(experiment.numbers)} numbers will be determined"
    )
    print_paths(console, written)
    if experiment.status is not DesignStatus.INSIDE:
        raise typer.Exit(NOT_COMPLETED)


def thrust_within(
    subject: CalibratedRobot, settings: CalibrationSettings, share: float
) -> np.ndarray:
    """Return (n_u, 2) [N], a share of what thrusters can do. Raises InvalidInput for wrenches, and
    for no share.
    """
    if settings.commands != "thrust":
        raise InvalidInput(
            f"commands: {settings.commands} given; thrust alone has limits: give commands: thrust"
        )
    if not 0.0 < share <= 1.0:
        raise InvalidInput(f"--share {share} given; allowed: more than 0, at most 1")
    return share * np.transpose(thrust_limits(subject.robot))


# ``thruster-curve``: from a bench's table to the curve of a robot file.


def thruster_curve(
    table: Annotated[
        Path,
        typer.Argument(
            metavar="TABLE", help="Table of a bench: text, .xlsx, Parquet, .mat or .npz."
        ),
    ],
    pwm: Annotated[
        str,
        typer.Option(
            metavar="COLUMN", help="What was sent: pulse widths, or shares of the largest."
        ),
    ],
    thrust: Annotated[str, typer.Option(metavar="COLUMN", help="Thrust that was measured.")],
    unit: Annotated[
        str,
        typer.Option(help=f"Of the thrust: {', '.join(_NEWTONS)}; else as its header says, or N."),
    ] = "",
    voltage: Annotated[
        str | None, typer.Option(metavar="COLUMN", help="Voltage of each measurement.")
    ] = None,
    at: Annotated[
        float | None, typer.Option(metavar="V", help="Voltage that the curve is wanted for.")
    ] = None,
    sheet: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Of a workbook; several, such as one a voltage."),
    ] = None,
) -> None:
    """Turn a table of thrust into the lines of a thruster in hydrodynamics.yaml.

    Measurements of the same signal are averaged, dead bands kept; what falls where the signal rises
    is levelled, and it is said by how much.

    \f Raises `NameNotFound` for a unit or a column that there is not, `InvalidInput` for a voltage
    without its column, and for a table of several voltages where none is chosen.
    """
    if (voltage is None) != (at is None):
        raise InvalidInput("--voltage and --at belong together: give both, or neither")
    columns = [pwm, thrust]
    if voltage:
        columns.append(voltage)
    require_known("unit", unit or "N", _NEWTONS)
    tables = [read_table(table, columns, TextFormat(sheet=name)) for name in sheet or [""]]
    unit_name = unit or unit_named(tables[0].units[1]) or tables[0].units[1] or "N"
    require_known("unit", unit_name, _NEWTONS)
    if not voltage:
        _require_one_voltage(table, sheet or [""])
    rows = np.concatenate([part.values for part in tables])
    rows = rows[np.isfinite(rows).all(axis=1)]
    forces = _NEWTONS[unit_name] * rows[:, 1]  # [N]
    voltages = rows[:, 2] if voltage else None
    curve, correction = curve_of_table(rows[:, 0], forces, voltages, at or 0.0)
    points = ", ".join(f"[{signal:.6g}, {force:.4g}]" for signal, force in curve)
    typer.echo(
        f"minimum: {min(curve[0][1], 0.0):.4g}\nmaximum: {curve[-1][1]:.4g}\ncurve: [{points}]"
    )
    stderr = console_of(stderr=True)
    layouts = [f"{table.name}: {part.layout}" for part in tables if part.layout]
    print_line(stderr, "; ".join([f"thrust in {unit_name}", *layouts]))
    if correction > 0.0:
        print_line(
            stderr, f"levelled by up to {correction:.2g} N, where thrust fell as the signal rose"
        )


def _require_one_voltage(table: Path, sheets: list[str]) -> None:
    """Check that a bench's table, if it names a voltage, was measured at one. Raises
    `InvalidInput`.
    """
    for name in column_names(table, TextFormat(sheet=sheets[0])):
        if _VOLTAGE not in name.lower():
            continue
        parts = [read_table(table, [name], TextFormat(sheet=sheet)).values for sheet in sheets]
        voltages = np.concatenate(parts)
        lowest = float(np.nanmin(voltages))
        highest = float(np.nanmax(voltages))
        if highest - lowest > _SAG * highest:
            raise InvalidInput(
                f"{table}: {name} is {lowest:g} to {highest:g}; choose one: --voltage '{name}' and --at"
                f" {lowest:g}"
            )
