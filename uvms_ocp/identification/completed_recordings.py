"""Add channels to recordings that a fit needs: thrust from propeller commands, and channels of axes along
which the vehicle is held.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification import parameters
from uvms_ocp.identification.recording import Channel, Recording
from uvms_ocp.identification.settings import CalibrationSettings
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.thrusters import thrust_of_signals

_NOTABLE_SHARE = 1e-3  # share of commands beyond the curves from which on it is doubted
_LEVEL = (0.0, 0.0, 0.0, 1.0)  # quaternion x, y, z, w


def along_axes(recording: Recording, settings: CalibrationSettings, n_commands: int) -> Recording:
    """Add the channels that a recording lacks where the vehicle is held along some axes.

    It is level and at rest along these axes, and nothing pushes it where no commands are recorded, as
    in a decay test.
    """
    held_axes = frozenset(parameters.AXES).difference(settings.axes)
    if not held_axes:
        return recording
    longest = max(recording.channels.values(), key=lambda channel: len(channel.t))

    def constant(value: Sequence[float]) -> Channel:
        """Make a channel with the same value (k,) at all times."""
        values = np.tile(value, (len(longest.t), 1))
        return replace(longest, values=values, columns=())

    commands = "wrench" if settings.commands == "wrench" else "thrust"
    assumed = {commands: constant([0.0] * n_commands)}
    if held_axes.issuperset(("roll", "pitch")):
        assumed["attitude"] = constant(_LEVEL)
    if held_axes.issuperset(("surge", "sway", "heave")) and "position" not in recording.channels:
        assumed["linear_velocity"] = constant([0.0] * 3)
    if held_axes.issuperset(("roll", "pitch", "yaw")):
        assumed["angular_velocity"] = constant([0.0] * 3)
    return replace(recording, channels={**assumed, **recording.channels})


def with_thrust(robot: Robot, recording: Recording) -> Recording:
    """Return the recording with the steady thrust of its `propeller_commands`, by the robot's
    thrust curves.

    Without a curve -1 and 1 are a thruster's limits. Raises InvalidInput without that channel, or
    for one of other thrusters.
    """
    signals = recording.channel("propeller_commands").of(robot.thruster_names, "propeller_commands")
    n_thrusters = len(robot.thruster_names)
    if signals.values.shape[1] != n_thrusters:
        problem = (
            f"{recording.name}: propeller_commands of {signals.values.shape[1]} thrusters given"
        )
        raise InvalidInput(
            f"{problem}; allowed: {n_thrusters}, those that drive it, in the order of the robot's file"
        )
    low, high = _signal_limits(robot)
    is_beyond = (signals.values < low - 1e-6) | (signals.values > high + 1e-6)
    share = float(is_beyond.mean())
    issues = recording.issues_in_file
    if share > _NOTABLE_SHARE:
        text = (
            f"{100.0 * share:.2g} % of its numbers are beyond the thrust curves, and taken for their"
            " ends: scale, pulses of 0?"
        )
        issues = (*issues, ("propeller_commands", text))
    thrust = replace(signals, values=thrust_of_signals(robot, signals.values))
    return replace(
        recording, channels={**recording.channels, "thrust": thrust}, issues_in_file=issues
    )


def _signal_limits(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """Return the lowest and the highest command (n,) [as the thrust curves] of all thrusters."""
    low = []
    high = []
    for thruster in robot.description.thrusters:
        if thruster.curve:
            low.append(thruster.curve[0][0])
            high.append(thruster.curve[-1][0])
        else:
            low.append(-1.0)
            high.append(1.0)
    return np.array(low), np.array(high)
