"""The one table of the study `faults`: every kind, its sizes, how long it lasts, and what its run
may miss because of it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from uvms_ocp.sim.faults import Fault, parse_fault

BURST = 1.0
"""[s] that readings are no numbers."""
SPIKED = 0.1
"""Share of the readings that are spikes."""
REACH = 1.0
"""[m] of the arm, by which wrong encoders bring it lower."""
AHEAD = 5.0
"""[s] by which clocks are ahead."""
PHASES = ("A", "B", "C", "D")
"""Phases of Case 1; faults set in in the middle of each, by the times of a run without faults."""
STILL = "none, in still water"
GUSTY = "none, in gusts"
"""Kinds of the runs without faults."""
PAIR = "two faults"
"""Kind of the runs with two, drawn each with its phase."""
GUSTS = 0.05
"""[m/s] standard deviation of the gusts in those."""
# What no run may exceed
JOINTS = 2e-3  # [rad] beyond a joint limit
ASTRAY = 5.0  # [m] from the way of a run without faults
FLOOR = 0.05  # [m] of arm and tool below the floor
# Shares of its limit that a joint's true velocity may come to
RATES = 1.02
NEW_RATES = 1.2  # soon after the onset of a fault
NEW = 0.5  # [s] after the onset of a fault that is soon


@dataclass(frozen=True, kw_only=True, slots=True)
class Sizes:
    """Sizes of the faults of one channel."""

    spikes: float
    """[unit of the channel]"""
    bias: tuple[float, ...]
    """[unit of the channel] of each component, or of all."""
    late: float
    """[s]"""
    drift: tuple[float, ...]
    """[unit of the channel per s] of each component, or of all."""
    joints: float = 0.0
    """[rad] by which joint limits are widened under the bias, which no other channel can show."""
    floor: float = 0.0
    """[m] by which the floor is lowered under the bias, which no other channel can show."""


SIZES: Mapping[str, Sizes] = {
    "position": Sizes(spikes=50.0, bias=(5.0, 0.0, 0.0), late=1.5, drift=(0.05, 0.0, 0.0)),
    "depth": Sizes(spikes=50.0, bias=(2.0,), late=0.5, drift=(0.03,)),
    "attitude": Sizes(spikes=1.0, bias=(0.0, 0.0, 0.2), late=0.2, drift=(0.0, 0.0, 0.01)),
    "angular_velocity": Sizes(spikes=2.0, bias=(0.0, 0.0, 0.1), late=0.05, drift=(0.0, 0.0, 0.002)),
    "linear_velocity": Sizes(spikes=5.0, bias=(0.3, 0.0, 0.0), late=0.3, drift=(0.006, 0.0, 0.0)),
    "joint_positions": Sizes(spikes=1.0, bias=(0.05,), late=0.05, drift=(0.004,), joints=0.05),
    "altimeter_range": Sizes(spikes=20.0, bias=(0.5,), late=0.2, drift=(0.02,), floor=0.5),
}
"""Sizes of faults by channel."""
CLOCKS = ("attitude", "linear_velocity", "joint_positions")
"""Channels whose clock is ahead, one at a time."""
OTHERS: Mapping[str, tuple[str, ...]] = {
    "altimeter stuck at 100 m": ("altimeter:stuck=100",),
    "one encoder frozen": ("joint3_position:frozen",),
    "thruster dead": ("thruster3:dead",),
    "vertical thruster dead": ("thruster5:dead",),
    "two thrusters dead": ("thruster3:dead", "thruster6:dead"),
    "thruster stuck": ("thruster3:stuck",),
    "vertical thruster stuck": ("thruster5:stuck",),
    "thruster weak": ("thruster3:weak=0.3",),
    "thruster reversed": ("thruster3:reversed",),
    "vertical thruster reversed": ("thruster5:reversed",),
    "joint 2 jammed": ("joint2:jam",),
    "joint 4 jammed": ("joint4:jam",),
    "current of 1 m/s": ("current:step=1,0,0",),
    "current of 1 m/s downwards": ("current:step=0,0,-1",),
    "payload of 2 kg": ("payload:mass=2",),
}
"""What does not repeat from channel to channel."""


@dataclass(frozen=True, kw_only=True, slots=True)
class FaultKind:
    """One line of the table."""

    name: str
    texts: tuple[str, ...]
    """Faults without their times."""
    lasts: float | None = None
    """[s]; `None`: to the end of the run."""
    joints: float = 0.0
    """[rad] by which joint limits are widened."""
    floor: float = 0.0
    """[m] by which the floor is lowered."""

    def faults(self, onset: float) -> tuple[Fault, ...]:
        """Make the faults with their times, from onset [s]."""
        until = "" if self.lasts is None else f"-{onset + self.lasts!r}"
        return tuple(parse_fault(f"{text}@{onset!r}{until}") for text in self.texts)


def _of_channel(channel: str, sizes: Sizes) -> tuple[FaultKind, ...]:
    bias = ",".join(f"{value:g}" for value in sizes.bias)
    drift = ",".join(f"{value:g}" for value in sizes.drift)
    endless = {
        "frozen": "frozen",
        "lost": "lost",
        "spikes": f"spikes={sizes.spikes:g},{SPIKED:g}",
        "late": f"late={sizes.late:g}",
    }
    kinds = [
        FaultKind(name=f"{channel} {word}", texts=(f"{channel}:{text}",))
        for word, text in endless.items()
    ]
    return (
        *kinds,
        FaultKind(name=f"{channel} nan", texts=(f"{channel}:nan",), lasts=BURST),
        FaultKind(
            name=f"{channel} bias",
            texts=(f"{channel}:bias={bias}",),
            joints=sizes.joints,
            floor=sizes.floor,
        ),
        FaultKind(
            name=f"{channel} drift",
            texts=(f"{channel}:drift={drift}",),
            joints=8.0 * sizes.joints,
            floor=sizes.floor,
        ),
    )


def _all_kinds() -> Iterator[FaultKind]:
    for channel, sizes in SIZES.items():
        yield from _of_channel(channel, sizes)
    for channel in CLOCKS:
        yield FaultKind(name=f"{channel} clock ahead", texts=(f"{channel}:ahead={AHEAD:g}",))
    for name, texts in OTHERS.items():
        yield FaultKind(name=name, texts=texts)


KINDS: Mapping[str, FaultKind] = {kind.name: kind for kind in _all_kinds()}
"""All kinds by name."""
