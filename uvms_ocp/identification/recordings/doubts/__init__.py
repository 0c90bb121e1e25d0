"""In: a recording. Out: what is doubtful about it, found by what must hold whatever the vehicle.

Velocity is the rate of position, what is at rest is held up against gravity, and motion follows its command. Axes are looked
for among all 48 ways to swap and turn them; a way is told where it explains much more than the axes as they are, so that axes
in which nothing moved raise no doubt.
"""

from __future__ import annotations

from dataclasses import replace

from uvms_ocp.identification.recordings.doubts.commands import of_commands
from uvms_ocp.identification.recordings.doubts.doubt import Doubt as Doubt
from uvms_ocp.identification.recordings.doubts.gravity import of_gravity
from uvms_ocp.identification.recordings.doubts.joint_rates import of_joints
from uvms_ocp.identification.recordings.doubts.rates import of_rates
from uvms_ocp.identification.recordings.doubts.samples import has_times, of_poses, of_samples
from uvms_ocp.identification.recordings.doubts.stuck import of_stuck
from uvms_ocp.identification.recordings.recording import KINDS, Recording


def doubts(recording: Recording) -> tuple[Doubt, ...]:
    """Everything that is doubtful about a recording."""
    sound = {name: one for name, one in recording.channels.items() if KINDS[name].command or has_times(one)}
    others = replace(recording, channels=sound)
    found = [*recording.known_doubts, *of_samples(recording)]
    found += [
        each for kind in (of_poses, of_rates, of_joints, of_gravity, of_stuck, of_commands) for each in kind(others)
    ]
    return tuple(Doubt(channel=name, problem=text) for name, text in found)
