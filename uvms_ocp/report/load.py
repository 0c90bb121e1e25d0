"""What the controller has learnt of the load at the tool."""

from __future__ import annotations

from uvms_ocp.arguments import checked
from uvms_ocp.record import Record
from uvms_ocp.report.series import known


@checked
def learnt_load(record: Record) -> dict[str, float | None] | None:
    """At the end of a run: net weight [N] and mass [kg], with standard errors; `None` where nothing was to be learnt.

    The mass is `None` while it is undetermined.
    """
    if "load_weight" not in record.series:
        return None
    units = {"weight": "n", "weight_error": "n", "mass": "kg", "mass_error": "kg"}
    return {f"{name}_{unit}": known(float(record[f"load_{name}"][-1])) for name, unit in units.items()}


def load_line(load: dict[str, float | None] | None) -> str:
    """In words; load [N, kg]: a `learnt_load`. Empty where nothing was to be."""
    if load is None:
        return ""
    mass = "undetermined" if load["mass_kg"] is None else f"{load['mass_kg']:.2f} kg +- {load['mass_error_kg']:.2f}"
    return f"load at the tool: net weight {load['weight_n']:.1f} N +- {load['weight_error_n']:.1f}, mass {mass}"
