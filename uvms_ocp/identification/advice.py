"""Advise what to do about a combination that recordings leave open: which motion shows it, or what
has to be measured.

A motion shows a number by the force that comes of it: added mass by accelerations, drag by speeds,
two of them apart by two speeds, what holds it upright by tilts. What enters every force alike no
motion shows: a scale does, or a gauge of thrust.
"""

from __future__ import annotations

from collections.abc import Sequence

from uvms_ocp.identification import uncertainty

_SHARES = 3  # largest shares of a combination for which there is advice
_DRAGS = frozenset({"linear_drag", "quadratic_drag"})
_BODY = frozenset({"mass", "second_moment"})
_DRIVEN = frozenset({"added_mass", "volume"}) | _DRAGS | _BODY

_SCALE = "forces and what they move grow alike: measure a thrust against a gauge, or give gain or mass a prior"
_WEIGHED = "no motion in water tells a body from the water that it moves: weigh it, and give its {body} a prior"
_NET = "only the net weight shows: weigh the vehicle in air, and give its mass a prior"
_EDGES = (
    "command steps, and record faster than the lag: only how they begin tells it from the delay"
)
_SPEEDS = "drive {axes} at two speeds that differ much, and keep each for some seconds"
_MOTIONS = {
    "mass": "weigh the vehicle, and give its mass a prior",
    "centre_of_mass": "tilt it {tilt} and let it go: swings show where its weight is",
    "second_moment": "swing it in roll and pitch and turn it to and fro in yaw, with changing speed",
    "volume": "let it rise or sink without thrust, or weigh it under water",
    "centre_of_buoyancy": "tilt it {tilt}, and hold it there or let it go",
    "added_mass": "drive {axes} to and fro: steps of a second or two, one way and the other",
    "linear_drag": "drive {axes} slowly, and keep each speed for some seconds",
    "quadratic_drag": "drive {axes} fast, and keep each speed for some seconds",
    "gain": "drive actuator {entry} ahead with much of its force",
    "reverse": "drive actuator {entry} astern with much of its force",
    "dead_zone": "drive actuator {entry} ahead with small commands that rise slowly from zero",
    "dead_zone_reverse": "drive actuator {entry} astern with small commands that rise slowly from zero",
    "lag": "command steps: what follows late shows the lag",
    "delay": "command steps: when they begin to show tells the delay",
    "bias": "leave it without commands for some seconds, free in {entry}",
    "velocity_point": "turn it fast: the sensor shows how far it is from the centre",
    "attitude_turn": "roll it, then pitch it: what the sensor shows of each tells how it is turned",
    "velocity_delay": "change speeds suddenly: when the sensor shows it tells its delay",
}
"""The motion, or the measurement, that determines a quantity."""
_TILTS = {
    "x": "in pitch",
    "y": "in roll",
    "z": "far in roll and pitch",
}
"""The tilt that shows a coordinate of a point."""


def advice(direction: uncertainty.UnidentifiableDirection) -> str:
    """Name the motion or measurement that would determine a combination, such as ``drive yaw fast``."""
    shares = [name.partition(" ")[::2] for name, _ in direction.shares[:_SHARES]]
    special = _of_all(shares)
    if special is not None:
        return special
    motions = [_motion(_MOTIONS[quantity], entry) for quantity, entry in shares]
    return "; ".join(dict.fromkeys(motions))


def _of_all(shares: Sequence[tuple[str, str]]) -> str | None:
    """Return the advice for numbers of which only a combination is undetermined; `None` where that of
    the single numbers serves.
    """
    quantities = frozenset(quantity for quantity, _ in shares)
    entries = {entry for _, entry in shares}
    if quantities == _DRAGS and len(entries) == 1:
        return _motion(_SPEEDS, entries.pop())
    if "added_mass" in quantities and len(quantities) > 1 and quantities <= _BODY | {"added_mass"}:
        return _WEIGHED.format(body=" and ".join(sorted(quantities & _BODY)))
    if (
        "gain" in quantities
        and quantities & _DRIVEN
        and quantities <= _DRIVEN | {"gain", "reverse"}
    ):
        return _SCALE
    if quantities == {"mass", "volume"}:
        return _NET
    if quantities == {"lag", "delay"}:
        return _EDGES
    return None


def _motion(text: str, entry: str) -> str:
    """Write a motion for the axes of an entry."""
    axes = entry.replace(" from ", "-").split("-")
    if len(axes) == 1:
        driven = axes[0]
    else:
        driven = f"{' and '.join(axes)} together"
    return text.format(entry=entry, axes=driven, tilt=_TILTS.get(entry, "every way"))
