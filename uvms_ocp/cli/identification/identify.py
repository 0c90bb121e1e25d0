"""``identify``: a robot's own numbers, from its own recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from uvms_ocp.cli.compiling import told_of_compiling
from uvms_ocp.cli.identification.recordings import MappingFile, Recordings, read_recordings
from uvms_ocp.cli.options import NOT_COMPLETED, folder
from uvms_ocp.cli.printing import console_of, print_line, print_paths
from uvms_ocp.identification.calibration.fitting import Calibration, calibrated
from uvms_ocp.identification.calibration.report import report_text
from uvms_ocp.identification.calibration.settings import read_settings
from uvms_ocp.identification.calibration.subject import subject_of
from uvms_ocp.identification.calibration.variant import require_coefficients, variant_text, whole_text
from uvms_ocp.identification.recordings.silences import parted
from uvms_ocp.output import claimed

VARIANT, WHOLE, REPORT, FIGURES = "calibrated.yaml", "hydrodynamics.yaml", "report.md", "figures"


def identify(
    settings: Annotated[Path, typer.Argument(metavar="YAML", help="What of which robot is to be learnt.")],
    recordings: Recordings,
    out: Annotated[Path, typer.Option(metavar="DIR", parser=folder, help="Folder for the results.")],
    mapping: MappingFile = None,
    profiles: Annotated[
        bool,
        typer.Option("--profiles", help="Intervals without linearity; each number takes up to a search."),
    ] = False,
    leave_one_out: Annotated[
        bool,
        typer.Option("--leave-one-out", help="Predict every recording by what the others tell; each takes a search."),
    ] = False,
) -> None:
    """Identify a robot from recordings: calibrated file, report and figures.

    calibrated.yaml has what was learnt, each number with its source; hydrodynamics.yaml is the robot's file with these in
    their places, for --hydrodynamics of other commands. Where the search does not converge neither is written.
    """
    given = read_settings(settings)
    subject = subject_of(given, settings.parent)
    require_coefficients(subject)
    found = parted(read_recordings(recordings, mapping))
    console = console_of()
    with claimed(out, _names(len(found), profiles, leave_one_out)) as claim:
        with console.status("identifying") as status, told_of_compiling(status.update):
            voices = {"tell": status.update, "warn": lambda doubt: print_line(console, f"doubtful: {doubt}")}
            result = calibrated(subject, given, found, profiled=profiles, leave_one_out=leave_one_out, **voices)
        with claim.staged() as staging:
            _write(result, [one.name for one in found], staging)
        written = claim.written()
    known = sum(one.determined for one in result.numbers)
    console.print(f"{result.estimate.status.value}; {known} of {len(result.numbers)} numbers determined")
    print_paths(console, written)
    if not result.flown.usable:
        print_line(console, f"no robot file is written: {result.flown.estimate.status.advice}")
        raise typer.Exit(NOT_COMPLETED)


def _names(n: int, profiles: bool, leave_one_out: bool) -> list[str]:
    pictures = ["intervals", *(f"{kind}_{k}" for k in range(n) for kind in ("predicted", "residuals"))]
    pictures += [name for name, wanted in (("profiles", profiles), ("left_out", leave_one_out)) if wanted]
    return [VARIANT, WHOLE, REPORT, *(f"{FIGURES}/{name}.png" for name in pictures)]


def _write(result: Calibration, names: list[str], staging: Path) -> None:
    from uvms_ocp.viz.calibration.figures import write_identification_figures

    if result.flown.usable:  # or nobody should fly with it
        (staging / VARIANT).write_text(variant_text(result, names), encoding="utf-8")
        (staging / WHOLE).write_text(whole_text(result, staging / VARIANT), encoding="utf-8")
    (staging / REPORT).write_text(report_text(result), encoding="utf-8")
    write_identification_figures(result, staging / FIGURES)
