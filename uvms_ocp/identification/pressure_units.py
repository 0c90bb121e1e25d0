"""Depths of pressures: which unit a pressure is in, whether the air's weight is in it, and the offset
and scale that make a height of it.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from uvms_ocp.identification.recording import CHANNEL_TABLE

PRESSURE_UNITS: Mapping[str, float] = CHANNEL_TABLE["units"]["bar"]
"""[bar] size of each unit."""
AIR = 1.01325
"""[bar] pressure of air at sea level."""
PRESSURE = 700.0
"""[mbar] Pressure of air where people are; more than any height of a vehicle in water [m]."""
METRES = 10.197
"""[m] height of fresh water with the pressure of a bar; of salt water it is 2.5 % less."""

_THINNEST_AIR = 0.6  # [bar] where people dive: lakes at 4,000 m
_DENSEST_AIR = 1.08  # [bar]
_AIR_ERROR = 0.03  # share of the air at sea level within which a pressure begins in air
_LARGE = 3e4  # [mbar] pressure at which no usual vehicle works: 300 m deep
TWO_UNITS = (1.1e4, _LARGE)
"""Sizes of pressures that may be mbar, 100 to 300 m deep, or Pa of a gauge, 1 to 3 m deep."""
_AT_BEGIN = 0.05  # share of all samples that show where a recording begins


@dataclass(frozen=True, kw_only=True, slots=True)
class PressureReading:
    """A pressure, read in one unit."""

    unit: str
    """Name, as in `PRESSURE_UNITS`."""
    air: float
    """[unit] pressure at the surface; 0 of a gauge."""
    evidence: str
    """Evidence for the pressure at the surface, or that there is none, in words."""

    def keys(self, sign: float = 1.0) -> str:
        """Write offset and scale for the last of three columns, which has the sign of the mapping."""
        scale = -METRES * PRESSURE_UNITS[self.unit]
        offset = -sign * self.air
        return f"offset: [0, 0, {offset:.10g}], scale: [1, 1, {sign * scale:.6g}]"


def read_in(unit: str, pressures: np.ndarray) -> PressureReading:
    """Read pressures (n,) [unit] in a known unit: of a gauge, or with the pressure of air that they
    begin with.
    """
    lowest = float(pressures.min()) * PRESSURE_UNITS[unit]  # [bar]
    if lowest < _THINNEST_AIR:
        return PressureReading(unit=unit, air=0.0, evidence="without air, as it is below it")
    begins_in_air = lowest < _DENSEST_AIR
    if lowest < AIR and begins_in_air:
        air = float(pressures.min())
        return PressureReading(
            unit=unit,
            air=air,
            evidence="the least is the air's, which is thinner than at sea level",
        )
    air = AIR / PRESSURE_UNITS[unit]
    return PressureReading(unit=unit, air=air, evidence="air as at sea level, which is assumed")


def unit_by_size(pressures: np.ndarray) -> str:
    """Return the unit in which pressures (n,) [any] begin with the pressure of air at sea level, or
    of thinner air where one unit alone allows it; empty where none does.
    """
    n_first = max(3, round(_AT_BEGIN * len(pressures)))
    first = float(np.median(pressures[:n_first]))
    lowest = float(pressures.min())
    is_in_air = {}
    for unit, bar in PRESSURE_UNITS.items():
        is_in_air[unit] = _THINNEST_AIR < lowest * bar < _DENSEST_AIR
        if abs(first * bar / AIR - 1.0) < _AIR_ERROR:
            return unit
    possible = [unit for unit, is_possible in is_in_air.items() if is_possible]
    factors = {PRESSURE_UNITS[unit] for unit in possible}
    return possible[0] if len(factors) == 1 else ""


def likely_unit(pressures: np.ndarray) -> str:
    """Return the unit of pressures (n,) [any] that are too large for metres, by where they begin, or
    the one that is usual for their size.
    """
    return unit_by_size(pressures) or ("mbar" if pressures.min() < _LARGE else "Pa")


def unit_by_rate(factor: float, closeness: float) -> str:
    """Return the unit that changes by a factor [unit/m] with depth, within a share; empty for none."""
    for unit, bar in PRESSURE_UNITS.items():
        if abs(factor * METRES * bar - 1.0) < closeness:
            return unit
    return ""


def told_by_name(name: str) -> tuple[bool, str]:
    """Return whether the name of a column is that of a pressure, and the unit in it; empty for none."""
    words = re.split(r"[^a-z0-9]+", re.sub(r"([a-z])([A-Z])", r"\1_\2", name).lower())
    units = {unit.lower(): unit for unit in PRESSURE_UNITS}
    unit = units.get(words[-1], "")
    is_pressure = bool(unit) or any(word.startswith("press") for word in words)
    return is_pressure, unit
