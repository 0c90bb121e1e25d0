"""Check the quality of a recording by what holds for any vehicle: velocity is the rate of pose, what
is at rest is held up against gravity, and motion follows commands.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from uvms_ocp.checks import checked, checked_dataclass
from uvms_ocp.identification.column_scale_checks import of_columns
from uvms_ocp.identification.command_checks import of_commands
from uvms_ocp.identification.euler_orders import of_order
from uvms_ocp.identification.gravity_checks import of_gravity
from uvms_ocp.identification.joint_checks import of_joints
from uvms_ocp.identification.mounting_checks import of_mounting
from uvms_ocp.identification.rate_checks import PARTNER, of_rates
from uvms_ocp.identification.recording import CHANNEL_KINDS, Recording
from uvms_ocp.identification.resolution_checks import of_resolution
from uvms_ocp.identification.sample_checks import has_times, of_poses, of_samples
from uvms_ocp.identification.sender_checks import of_senders
from uvms_ocp.identification.shared_motion_checks import of_shared_motion
from uvms_ocp.identification.stuck_checks import of_stuck
from uvms_ocp.identification.stuck_column_checks import of_stuck_columns
from uvms_ocp.identification.turning_checks import of_foreign_turns, of_turning
from uvms_ocp.record.row_files import forget

_SAID_BETTER = (
    (": a pressure in", "read as m"),
    ("a depth of the other sign", "above a surface at 0: z down"),
)
"""Pairs of parts of doubts about the same error, of which the second has more evidence."""
_OF_JUMPS = (" samples, all others ", "are exactly zero", " and back ", "differ: two sensors?")
"""Parts of doubts about samples to which a channel jumps, after which no other sender is looked for."""
_MOTION_CHANNELS = {"position", "attitude", "linear_velocity", "angular_velocity", "specific_force"}
"""Channels whose doubts keep a mounting from being estimated."""


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
    """Check a recording for inconsistent clocks, frames, units and thrusters; return an issue for each."""
    issues = [*recording.issues_in_file, *of_samples(recording)]
    # All else would follow from degrees that are taken for radians.
    wrong = {name for name, text in recording.issues_in_file if "rad: in deg?" in text}
    # No check knows which of two senders a sample is of.
    jumping = {name for name, text in issues if any(part in text for part in _OF_JUMPS)}
    mixed = list(of_senders(recording, jumping))
    issues += mixed
    n_of_samples = len(issues)
    wrong |= {name for name, _ in mixed}
    sound = {}
    for name, channel in recording.channels.items():
        is_timed = CHANNEL_KINDS[name].command or has_times(channel)
        if is_timed and name not in wrong:
            sound[name] = channel
    # First each column, then its channel: axes and clocks of one with a unit of its own say nothing.
    column_doubts = list(of_columns(replace(recording, channels=sound)))
    issues += column_doubts
    forget(channel.values for channel in sound.values())
    for name, _ in column_doubts:
        sound.pop(name, None)
    remaining = replace(recording, channels=sound)
    if not any(name in _MOTION_CHANNELS for name, _ in issues):
        misread = list(of_order(remaining)) or list(of_foreign_turns(remaining))
        # A gyro that stops turns otherwise than the attitude, too.
        if misread and any((*of_stuck(remaining), *of_stuck_columns(remaining))):
            misread = []
        issues += misread
        if misread:  # as all else would follow from it
            sound.pop("attitude")
            remaining = replace(recording, channels=sound)
    for check in (of_poses, of_rates, of_joints, of_gravity, of_stuck):
        issues += check(remaining)
        forget(channel.values for channel in sound.values())
    # What is read in another unit has other steps.
    resized = {name for name, text in issues[n_of_samples:]}
    resized |= {name for name, text in issues if "is it in" in text}
    coarse = [doubt for doubt in of_resolution(remaining) if doubt[0] not in resized]
    # By wrong axes no vehicle follows its commands, and no column is that of its axis.
    has_wrong_axes = any(name in PARTNER and "its axes fit" in text for name, text in issues)
    if not has_wrong_axes:
        issues += of_stuck_columns(remaining)
        # What else is wrong with these would be taken for a scale, or for a place.
        doubted = {name for name, _ in issues}
        if not doubted & _MOTION_CHANNELS:
            foreign = list(of_shared_motion(remaining))
            issues += foreign
            if not foreign:
                issues += of_mounting(remaining)
                issues += of_turning(remaining)
        issues += of_commands(remaining)
        forget(channel.values for channel in sound.values())
    issues += coarse
    distinct = _without_repetitions(issues)
    return tuple(QualityIssue(channel=name, problem=text) for name, text in distinct)


def _without_repetitions(issues: Sequence[tuple[str, str]]) -> Iterator[tuple[str, str]]:
    """Yield channels and texts, without those of which another text of the channel has more
    evidence.
    """
    for name, text in issues:
        texts_of_channel = [candidate for channel, candidate in issues if channel == name]
        is_said_better = False
        for part, better in _SAID_BETTER:
            has_better = any(better in candidate for candidate in texts_of_channel)
            is_said_better |= part in text and has_better
        if not is_said_better:
            yield name, text
