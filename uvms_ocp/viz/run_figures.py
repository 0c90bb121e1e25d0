"""All figures of one run or plan, read from its `Record` alone.

Each ``figure_*`` returns a Matplotlib figure, or `None` where the record lacks what it shows.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, overload

from matplotlib.figure import Figure

from uvms_ocp.arguments import checked
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.ocp.plan import Plan
from uvms_ocp.record import Record
from uvms_ocp.viz.activation_figures import figure_activations
from uvms_ocp.viz.efforts import figure_efforts, figure_tracking
from uvms_ocp.viz.estimate import figure_estimate
from uvms_ocp.viz.health_figure import figure_health
from uvms_ocp.viz.motion_figures import figure_joints, figure_velocities
from uvms_ocp.viz.path import figure_path
from uvms_ocp.viz.plan_figures import plan_figures
from uvms_ocp.viz.quantity_figures import (
    figure_altitude,
    figure_errors,
    figure_misalignment,
    figure_of,
    figure_quantities,
    figure_tool_error,
)
from uvms_ocp.viz.series import require_rows
from uvms_ocp.viz.style import Figures, save_figure
from uvms_ocp.viz.tick_time import figure_tick_time

FIGURES: Mapping[str, Callable[[Record], Figure | None]] = MappingProxyType(
    {
        "errors": figure_errors,
        "misalignment": figure_misalignment,
        "altitude": figure_altitude,
        "tool_error": figure_tool_error,
        "activations": figure_activations,
        "quantities": figure_quantities,
        "velocities": figure_velocities,
        "joints": figure_joints,
        "path": figure_path,
        "efforts": figure_efforts,
        "tracking": figure_tracking,
        "estimate": figure_estimate,
        "health": figure_health,
        "tick_time": figure_tick_time,
    }
)


Format = Literal["png", "pdf", "svg"]


@checked
def write_figures(record: Record, folder: Path | str, format: Format = "png") -> tuple[Path, ...]:
    """Write every figure that the record can fill as ``folder/<name>.png``, or in another format; returns the paths written.

    Raises `InvalidInput` for a record with fewer than two rows and `OutputError` where the folder cannot be written.
    """
    require_rows(record)
    paths = (write_figure(record, name, folder, format) for name in FIGURES)
    return tuple(path for path in paths if path is not None)


def write_figure(record: Record, name: str, folder: Path | str, format: Format = "png") -> Path | None:
    """Write one of `FIGURES`; `None` where the record cannot fill it. Raises as `write_figures`."""
    figure = FIGURES[name](record)
    return None if figure is None else save_figure(figure, Path(folder) / f"{name}.{format}")


@overload
def plot(what: Plan | Record, name: str | Sequence[str], /, *names: str | Sequence[str]) -> Figure: ...
@overload
def plot(what: Plan | Record) -> Figures: ...
@checked
def plot(what: Plan | Record, *names: str | Sequence[str]) -> Figure | Figures:
    """Every figure that a run or a plan can fill, or one with a panel for each of the names.

    names: quantities such as ``T.position_error``, series such as ``thrust``, columns such as ``q.z``, or lists of them; see
    `figure_of`, which tells what it raises. Raises `InvalidInput` for what is no name.
    """
    record = what if isinstance(what, Record) else what.to_record()
    if names:
        return figure_of(record, *_each(names))
    if record.meta.kind == "plan":
        return Figures(plan_figures(record).values())
    return Figures(figure for draw in FIGURES.values() if (figure := draw(record)) is not None)


def _each(names: Sequence[str | Sequence[str]]) -> list[str]:
    """One by one. Raises `InvalidInput` for what is no name."""
    found: list[Any] = [one for name in names for one in (name if isinstance(name, tuple | list) else [name])]
    wrong = [repr(one) for one in found if not isinstance(one, str)]
    if wrong or not found:
        raise InvalidInput(f"plot of {', '.join(wrong) or 'no names'}; give names such as 'q' and 'T.position_error'")
    return found
