"""``excite``: commands for a robot that is to be identified."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from uvms_ocp.cli.compiling import told_of_compiling
from uvms_ocp.cli.options import NOT_COMPLETED, folder
from uvms_ocp.cli.printing import console_of, print_paths
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.identification.calibration.settings import Settings, read_settings
from uvms_ocp.identification.calibration.subject import Subject, subject_of
from uvms_ocp.identification.calibration.variant import require_coefficients
from uvms_ocp.identification.excitation.assignment import Assignment
from uvms_ocp.identification.excitation.confines import Limits
from uvms_ocp.identification.excitation.design import Effort, designed
from uvms_ocp.identification.excitation.expected import DesignStatus
from uvms_ocp.identification.excitation.report import excitation_text
from uvms_ocp.identification.methods.output_error import Noise
from uvms_ocp.identification.methods.rollout import Rollout
from uvms_ocp.identification.models.stage import stage_of
from uvms_ocp.identification.recordings.recording import Recording
from uvms_ocp.identification.recordings.storage import write_recording
from uvms_ocp.model.thrusters import thrust_limits
from uvms_ocp.output import claimed

COMMANDS, REPORT = "excitation.csv", "report.md"
_POOL, _DURATION, _SHARE, _SLEW, _SEED = (6.0, 4.0, 2.0), 60.0, 0.5, 100.0, Effort().seed


def excite(
    settings: Annotated[Path, typer.Argument(metavar="YAML", help="What of which robot is to be learnt.")],
    out: Annotated[Path, typer.Option(metavar="DIR", parser=folder, help="Folder for the results.")],
    pool: Annotated[
        tuple[float, float, float], typer.Option(metavar="X Y Z", help="Size [m], the vehicle in its middle.")
    ] = _POOL,
    duration: Annotated[float, typer.Option(help="Of a recording [s].")] = _DURATION,
    share: Annotated[float, typer.Option(help="Of the thrusters' limits.")] = _SHARE,
    slew: Annotated[float, typer.Option(help="Largest change of thrust [N/s].")] = _SLEW,
    seed: Annotated[int, typer.Option(min=0, help="Of where the search begins.")] = _SEED,
) -> None:
    """Design thrust that shows what is to be learnt, within a pool.

    excitation.csv has what each thruster is told and when; report.md what a recording of it is expected to determine.
    """
    given = read_settings(settings)
    subject, console = subject_of(given, settings.parent), console_of()
    require_coefficients(subject)  # rather than after it was driven
    thrust = thrust_within(subject, given, share)
    limits = Limits(thrust=thrust, pool=np.outer([-0.5, 0.5], pool), hull=subject.hull_in_body(given.hull), slew=slew)
    wanted = _assignment(subject, given, limits, duration)
    with claimed(out, [COMMANDS, REPORT]) as claim:
        with console.status("designing") as status, told_of_compiling(status.update):
            found = designed(wanted, Rollout(stage_of(subject.vehicle)), Effort(seed=seed))
        text = excitation_text(found, subject.vehicle.actuators.names)
        with claim.staged() as staging:
            write_recording(Recording(name="excitation", channels={"thrust": found.commands}), staging / COMMANDS)
            (staging / REPORT).write_text(text, encoding="utf-8")
        written = claim.written()
    known = sum(one.determined for one in found.numbers)
    console.print(f"{found.status.value}; {known} of {len(found.numbers)} numbers will be determined")
    print_paths(console, written)
    if found.status is not DesignStatus.INSIDE:
        raise typer.Exit(NOT_COMPLETED)


def thrust_within(subject: Subject, given: Settings, share: float) -> np.ndarray:
    """(n_u, 2) [N] a share [-] of what thrusters can do. Raises InvalidInput for wrenches, and for no share."""
    if given.commands != "thrust":
        raise InvalidInput(f"commands: {given.commands} given; thrust alone has limits: give commands: thrust")
    if not 0.0 < share <= 1.0:
        raise InvalidInput(f"--share {share} given; allowed: more than 0, at most 1")
    return share * np.transpose(thrust_limits(subject.robot))


def _assignment(subject: Subject, given: Settings, limits: Limits, duration: float) -> Assignment:
    noise, joints = Noise(**given.noise.model_dump()), tuple(subject.robot.home.tolist())
    return Assignment(vehicle=subject.vehicle, limits=limits, duration=duration, noise=noise, joints=joints)
