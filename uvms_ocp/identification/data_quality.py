"""Check the quality of a recording by what must hold for any vehicle: velocity is the rate of pose,
what is at rest is held up against gravity, and motion follows commands.
"""

from __future__ import annotations

from dataclasses import replace

from uvms_ocp.checks import checked, checked_dataclass
from uvms_ocp.identification.command_checks import of_commands
from uvms_ocp.identification.gravity_checks import of_gravity
from uvms_ocp.identification.joint_checks import of_joints
from uvms_ocp.identification.rate_checks import PARTNER, of_rates
from uvms_ocp.identification.recording import CHANNEL_KINDS, Recording
from uvms_ocp.identification.sample_checks import has_times, of_poses, of_samples
from uvms_ocp.identification.stuck_checks import of_stuck
from uvms_ocp.identification.stuck_column_checks import of_stuck_columns
from uvms_ocp.record.row_files import forget


@checked_dataclass()
class QualityIssue:
    """A doubt about one channel of a recording."""

    channel: str
    """Name of the channel, as in `CHANNEL_KINDS`."""
    problem: str
    """Evidence against it, and what may be the cause or the cure."""

    def __str__(self) -> str:
        return f"{self.channel}: {self.problem}"


@checked
def check_data_quality(recording: Recording) -> tuple[QualityIssue, ...]:
    """Check a recording for inconsistent clocks, frames, units and thrusters; returns one issue for
    each.
    """
    issues = [*recording.issues_in_file, *of_samples(recording)]
    # All else would follow from degrees that are taken for radians.
    wrong = {name for name, text in recording.issues_in_file if "rad: in deg?" in text}
    sound = {}
    for name, channel in recording.channels.items():
        is_timed = CHANNEL_KINDS[name].command or has_times(channel)
        if is_timed and name not in wrong:
            sound[name] = channel
    remaining = replace(recording, channels=sound)
    for check in (of_poses, of_rates, of_joints, of_gravity, of_stuck):
        issues += check(remaining)
        forget(channel.values for channel in sound.values())
    # By other axes no vehicle follows its commands, and no column is that of its axis.
    has_other_axes = any(name in PARTNER and "its axes fit" in text for name, text in issues)
    if not has_other_axes:
        issues += of_stuck_columns(remaining)
        issues += of_commands(remaining)
        forget(channel.values for channel in sound.values())
    return tuple(QualityIssue(channel=name, problem=text) for name, text in issues)
