"""Pages that the code itself fills: robot files, settings, series and channels, statuses, commands."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterable, Iterator, Mapping
from importlib.resources import files
from typing import Any

import numpy as np
import typer.main
from pydantic import BaseModel

import uvms_ocp
from uvms_ocp import cli
from uvms_ocp.cli.commands import app
from uvms_ocp.errors import AdvisedStatus
from uvms_ocp.identification import channel_mapping, parameters, recording, settings
from uvms_ocp.identification.vehicle_declaration import (
    ActuatorModel,
    NominalParameters,
    vehicle_declaration,
)
from uvms_ocp.record.tables import series_markdown
from uvms_ocp.robot.description import RobotDescription

_LIMIT_SIGNS = {"exclusiveMinimum": ">", "minimum": "≥", "exclusiveMaximum": "<", "maximum": "≤"}
"""Signs of limits by their keys in a JSON schema."""


def generated_pages() -> dict[str, str]:
    """Return Markdown by the name of the page: the texts in ``generated/``, with what the code says
    in their places.
    """
    command_sections = [_command(path, command) for path, command in _all_commands()]
    entries = {
        "robot_files": {"fields": _schema(RobotDescription)},
        "identification_settings": {
            "fields": _schema(settings.CalibrationSettings),
            "quantities": _quantities(),
        },
        "series": {"table": series_markdown()},
        "channels": {
            "table": _channels(),
            "mapping": _mapping(),
        },
        "statuses": {"tables": "\n\n".join(_statuses())},
        "commands": {"codes": _exit_codes(), "commands": "\n\n".join(command_sections)},
    }
    pages = {}
    for name, texts in entries.items():
        template = files("uvms_ocp.reference") / "generated" / f"{name}.md"
        pages[name] = template.read_text(encoding="utf-8").format(**texts)
    return pages


def _table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    """Write a table in Markdown."""
    lines = [_table_line(head), _table_line(("---",) * len(head))]
    for row in rows:
        lines.append(_table_line([" ".join(cell.replace("|", "\\|").split()) for cell in row]))
    return "\n".join(lines)


def _table_line(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _schema(model: type[BaseModel]) -> str:
    """Write a section for a file and one for each part that it is made of."""
    schema = model.model_json_schema()
    sections = [f"## Top level\n\n{_fields(schema)}"]
    for name, part in sorted(schema.get("$defs", {}).items()):
        sections.append(f"## {name}\n\n{_fields(part)}")
    return "\n\n".join(sections)


def _mapping() -> str:
    """Write the keys of a channel's mapping, and those of one of its parts."""
    schema = channel_mapping.ChannelMapping.model_json_schema()
    sections = [_fields(schema)]
    for name, part in schema["$defs"].items():
        sections.append(f"## {name}\n\n{_fields(part)}")
    return "\n\n".join(sections)


def _fields(part: dict[str, Any]) -> str:
    """Write the description of a part of a schema, and a table of its fields or its values."""
    text = part.get("description", "").split("\n\n")[0]
    if "properties" not in part:
        values = [f"`{value}`" for value in part.get("enum", ())]
        return f"{text}\n\nOne of: {', '.join(values)}."
    required = part.get("required", ())
    rows = []
    for name, field in part["properties"].items():
        if name in required:
            default = "needed"
        elif field.get("default") is None:
            default = "-"
        else:
            default = f"`{field['default']}`"
        rows.append((f"`{name}`", _type_of(field), default, field.get("description", "")))
    return text + "\n\n" + _table(("field", "type", "default", "meaning"), rows)


def _type_of(field: dict[str, Any]) -> str:
    if "$ref" in field:
        name = field["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    if "anyOf" in field:
        return " or ".join(_type_of(item) for item in field["anyOf"] if item.get("type") != "null")
    if "enum" in field or "const" in field:
        return ", ".join(f"`{value}`" for value in field.get("enum", [field.get("const")]))
    if field.get("type") == "array":
        return _list_type(field)
    if isinstance(field.get("additionalProperties"), dict):
        return f"by name: {_type_of(field['additionalProperties'])}"
    name = str(field.get("type", "any"))
    limits = []
    for key, sign in _LIMIT_SIGNS.items():
        if key in field:
            limits.append(f"{sign} {field[key]:g}")
    if limits:
        return f"{name}, {' and '.join(limits)}"
    return name


def _list_type(field: dict[str, Any]) -> str:
    if "items" in field:
        item = field["items"]
    else:
        item = next(iter(field.get("prefixItems") or ()), {})
    item_type = _type_of(item or {})
    if field.get("maxItems"):
        return f"list of {field['maxItems']} {item_type}"
    return f"list of {item_type}"


def _channels() -> str:
    rows = []
    for name, kind in recording.CHANNEL_KINDS.items():
        columns = ", ".join(kind.columns) or "one for each"
        between_samples = "a command, held" if kind.command else "measured, interpolated"
        rows.append((f"`{name}`", columns, kind.unit, kind.frame or "-", between_samples))
    return _table(("channel", "columns", "unit", "frame", "between samples"), rows)


def _quantities() -> str:
    rows = []
    for name, quantity in _learnable_quantities().items():
        coordinates = [coordinate for coordinate in quantity.coordinates.names if coordinate]
        rows.append((f"`{name}`", quantity.unit, ", ".join(coordinates) or "-"))
    return _table(("quantity", "unit", "coordinates, for `free`"), rows)


def _learnable_quantities() -> Mapping[str, parameters.Quantity]:
    """Return the quantities of any vehicle that can be learnt; coordinates of actuators are their
    names.
    """
    start = NominalParameters(
        mass=1.0,
        centre_of_mass=np.zeros(3),
        inertia=np.eye(3),
        volume=1.0,
        centre_of_buoyancy=np.zeros(3),
        added_mass=np.eye(6),
        linear_drag=np.eye(6),
        quadratic_drag=np.eye(6),
    )
    hull = np.array([-np.ones(3), np.ones(3)])
    actuators = ActuatorModel(names=("thrusters",))
    return vehicle_declaration(start, hull, actuators).quantities


def _statuses() -> Iterator[str]:
    """Yield a table for each kind of outcome of a solver, a plan or a fit.

    A kind is known once its module is imported: all are.
    """
    for module in pkgutil.walk_packages(uvms_ocp.__path__, "uvms_ocp."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
    for kind in sorted(AdvisedStatus.__subclasses__(), key=lambda kind: kind.__module__):
        rows = [(f"`{status.value}`", status.advice) for status in kind]
        table = _table(("status", "what to do"), rows)
        yield f"## {kind.__name__}\n\nCode: `{kind.__module__}.{kind.__name__}`.\n\n{table}"


def _exit_codes() -> str:
    """Return what the package of commands says of its exit codes, in one line."""
    _, _, text = (cli.__doc__ or "").partition("Exit codes: ")
    return " ".join(text.split())


def _all_commands() -> Iterator[tuple[tuple[str, ...], Any]]:
    return _commands_of(("uvms-ocp",), typer.main.get_command(app))


def _commands_of(path: tuple[str, ...], command: Any) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield a command with the words that call it, or the commands of a group, one after the
    other.
    """
    if not hasattr(command, "commands"):
        yield path, command
        return
    for name, member in command.commands.items():
        yield from _commands_of((*path, name), member)


def _command(path: tuple[str, ...], command: Any) -> str:
    """Write the section of a command: how it is called, its help, a table of its parameters."""
    usage = list(path)
    if any(_is_option(parameter) for parameter in command.params):
        usage.append("[OPTIONS]")
    rows = []
    for parameter in command.params:
        rows.append((_parameter_text(parameter), str(getattr(parameter, "help", "") or "")))
        if not _is_option(parameter):
            usage.append(_placeholder(parameter))
    help_text, _, _ = (command.help or "").partition("\f")
    table = _table(("name", "meaning"), rows) if rows else ""
    return f"## {' '.join(path)}\n\n    {' '.join(usage)}\n\n{help_text}\n\n{table}"


def _is_option(parameter: Any) -> bool:
    return bool(parameter.param_type_name == "option")


def _placeholder(parameter: Any) -> str:
    """Return what stands for the value of a parameter, such as FOLDER."""
    return str(parameter.metavar or parameter.name.upper())


def _parameter_text(parameter: Any) -> str:
    if not _is_option(parameter):
        return f"`{_placeholder(parameter)}`"
    names = ", ".join([*parameter.opts, *parameter.secondary_opts])
    if getattr(parameter, "is_flag", False):
        return f"`{names}`"
    return f"`{names} {_placeholder(parameter)}`"
