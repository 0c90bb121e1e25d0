"""One fault of every kind of every family, without times: a new kind is tested by being listed."""

from __future__ import annotations

from uvms_ocp.robot.signals import CHANNELS
from uvms_ocp.sim.faults import FAMILIES, target_of

VALUES = {
    "frozen": "",
    "lost": "",
    "nan": "",
    "spikes": "=3,0.3",
    "bias": "=0.25",
    "drift": "=0.25",
    "late": "=0.07",
    "stuck": "=0.4",
    "ahead": "=2.5",
}
SENSORS = {
    channel: [f"{channel}:{kind}{values}" for kind, values in VALUES.items()]
    for channel in CHANNELS
}
"""By channel."""
ENCODERS = [
    f"joint3_{what}:{kind}{VALUES[kind]}"
    for what in ("position", "velocity")
    for kind in FAMILIES["encoder"]
]
THRUSTERS = [
    "thruster3:dead",
    "thruster3:stuck",
    "thruster3:stuck=20",
    "thruster3:weak=0.25",
    "thruster3:reversed",
]
MACHINE = [*THRUSTERS, "joint2:jam", "payload:mass=2", "payload:mass=2,0.0005", "payload1:mass=2"]
WATER = ["current:step=1,0.5,0", "current:step=0.2,0,-1"]
ALL = [*(text for texts in SENSORS.values() for text in texts), *ENCODERS, *MACHINE, *WATER]


def listed() -> set[tuple[str, str]]:
    """Families and kinds that are tested."""
    parts = [text.partition("=")[0].split(":") for text in ALL]
    return {(target_of(target).family, kind) for target, kind in parts}
