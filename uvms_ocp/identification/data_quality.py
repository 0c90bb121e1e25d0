"""Check the quality of a recording by what must hold for any vehicle: velocity is the rate of pose,
what is at rest is held up against gravity, and motion follows commands.
"""

from __future__ import annotations

from dataclasses import replace

from uvms_ocp.identification import sample_checks as checks
from uvms_ocp.identification.command_checks import of_commands
from uvms_ocp.identification.joint_checks import of_joints
from uvms_ocp.identification.rate_checks import PARTNER, of_rates
from uvms_ocp.identification.recording import CHANNEL_KINDS, Recording
from uvms_ocp.identification.sample_checks import QualityIssue as QualityIssue
from uvms_ocp.record.row_files import forget


def check_data_quality(recording: Recording) -> tuple[QualityIssue, ...]:
    """Check a recording for inconsistent clocks, frames, units and thrusters; returns one issue for
    each.
    """
    issues = [*recording.issues_in_file, *checks.of_samples(recording)]
    # All else would follow from degrees that are taken for radians.
    wrong = {name for name, text in recording.issues_in_file if "rad: in deg?" in text}
    sound = {}
    for name, channel in recording.channels.items():
        has_times = CHANNEL_KINDS[name].command or checks.has_times(channel)
        if has_times and name not in wrong:
            sound[name] = channel
    remaining = replace(recording, channels=sound)
    for check in (checks.of_poses, of_rates, of_joints, checks.of_gravity, checks.of_stuck):
        issues += check(remaining)
        forget(channel.values for channel in sound.values())
    # By other axes no vehicle follows its commands.
    has_other_axes = any(name in PARTNER and "its axes fit" in text for name, text in issues)
    if not has_other_axes:
        issues += of_commands(remaining)
        forget(channel.values for channel in sound.values())
    return tuple(QualityIssue(channel=name, problem=text) for name, text in issues)
