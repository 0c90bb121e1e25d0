"""Pages generated from the code: robot files, settings, series of a record, commands."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import typer.main

from uvms_ocp.cli.commands import app
from uvms_ocp.identification.parameters import ActuatorModel, NominalParameters, Quantity, vehicle_declaration
from uvms_ocp.identification.reading import ChannelMapping
from uvms_ocp.identification.recording import CHANNEL_KINDS, ChannelKind
from uvms_ocp.identification.settings import CalibrationSettings
from uvms_ocp.record.tables import series_markdown
from uvms_ocp.robot.description import RobotDescription


def generated_pages() -> dict[str, str]:
    """Markdown by the name of the page."""
    made = {"robot_files": _robot_files, "identification_settings": _settings, "series": _series, "channels": _channels}
    return {name: page() for name, page in (made | {"commands": _commands}).items()}


def _table(head: tuple[str, ...], rows: Iterator[tuple[str, ...]]) -> str:
    lines = ["| " + " | ".join(cells) + " |" for cells in (head, ("---",) * len(head), *map(_cells, rows))]
    return "\n".join(lines)


def _cells(row: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(" ".join(cell.replace("|", "\\|").split()) for cell in row)


def _series() -> str:
    return (
        "# Series of a record\n\nThe arrays of a `uvms_ocp.record.record.Record`, by name. The first axis of each is time; "
        "shapes say what follows. Quantities of tasks are there by their names too, such as `T.position_error`.\n\n"
        f"{series_markdown()}\n"
    )


def _channels() -> str:
    rows = (
        (f"`{name}`", ", ".join(kind.columns) or "one for each", kind.unit, kind.frame or "-", _taken(kind))
        for name, kind in CHANNEL_KINDS.items()
    )
    text = _fields(ChannelMapping.model_json_schema())
    return (
        "# Channels of a recording\n\nWhat a `uvms_ocp.identification.recording.Recording` may have, each with times "
        "of its own.\n\n"
        + _table(("channel", "columns", "unit", "frame", "between samples"), rows)
        + f"\n\n## A channel in a mapping\n\n{text}\n"
    )


def _taken(kind: ChannelKind) -> str:
    return "a command, held" if kind.command else "measured, interpolated"


def _robot_files() -> str:
    schema = RobotDescription.model_json_schema()
    parts = [f"## {name}\n\n{_fields(part)}" for name, part in sorted(schema.get("$defs", {}).items())]
    return (
        "# Robot files\n\nA robot is a URDF and a YAML file, whose top level is described first; "
        "`uvms-ocp check-robot` looks over both, `uvms-ocp schema` prints this as JSON schema. "
        "The code that reads it: `uvms_ocp.robot.description.RobotDescription`.\n\n"
        + "\n\n".join(["## Top level\n\n" + _fields(schema), *parts])
        + "\n"
    )


def _settings() -> str:
    schema = CalibrationSettings.model_json_schema()
    parts = [f"## {name}\n\n{_fields(part)}" for name, part in sorted(schema["$defs"].items())]
    units = (
        (f"`{name}`", one.unit, ", ".join(filter(None, one.coordinates.names)) or "-")
        for name, one in _learnable().items()
    )
    return (
        "# Settings of identification\n\nA YAML file that says what of which robot is to be learnt: `uvms-ocp excite` and "
        "`uvms-ocp identify` take it. The code that reads it: `uvms_ocp.identification.settings.CalibrationSettings`.\n\n"
        + "\n\n".join(["## Top level\n\n" + _fields(schema), *parts])
        + "\n\n## What may be learnt\n\n"
        + _table(("quantity", "unit", "coordinates, for `free`"), units)
        + "\n"
    )


def _learnable() -> Mapping[str, Quantity]:
    """Of any vehicle: of actuators that have names of their own, coordinates are those."""
    own, axes = np.eye(3), np.eye(6)
    start = NominalParameters(
        mass=1.0,
        centre_of_mass=np.zeros(3),
        inertia=own,
        volume=1.0,
        centre_of_buoyancy=np.zeros(3),
        added_mass=axes,
        linear_drag=axes,
        quadratic_drag=axes,
    )
    return vehicle_declaration(
        start, np.array([-np.ones(3), np.ones(3)]), ActuatorModel(names=("thrusters",))
    ).quantities


def _fields(part: dict[str, Any]) -> str:
    text = part.get("description", "").split("\n\n")[0]
    if "properties" not in part:
        return f"{text}\n\nOne of: {', '.join(f'`{value}`' for value in part.get('enum', ()))}."
    needed = set(part.get("required", ()))
    rows = (
        (f"`{name}`", _type_of(field), "needed" if name in needed else _default(field), field.get("description", ""))
        for name, field in part["properties"].items()
    )
    return text + "\n\n" + _table(("field", "type", "default", "meaning"), rows)


def _default(field: dict[str, Any]) -> str:
    return f"`{field['default']}`" if field.get("default") is not None else "-"


def _type_of(field: dict[str, Any]) -> str:
    if "$ref" in field:
        name = field["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    if "anyOf" in field:
        return " or ".join(_type_of(item) for item in field["anyOf"] if item.get("type") != "null")
    if "enum" in field or "const" in field:
        return ", ".join(f"`{value}`" for value in field.get("enum", [field.get("const")]))
    if field.get("type") == "array":
        items = field.get("items", (field.get("prefixItems") or [{}])[0])
        return f"list of {field.get('maxItems', '') or ''} {_type_of(items or {})}".replace("  ", " ")
    if isinstance(field.get("additionalProperties"), dict):
        return f"by name: {_type_of(field['additionalProperties'])}"
    return str(field.get("type", "any")) + _range_of(field)


def _range_of(field: dict[str, Any]) -> str:
    signs = {"exclusiveMinimum": ">", "minimum": "≥", "exclusiveMaximum": "<", "maximum": "≤"}
    limits = [f"{sign} {field[key]:g}" for key, sign in signs.items() if key in field]
    return f", {' and '.join(limits)}" if limits else ""


def _commands() -> str:
    root = typer.main.get_command(app)
    text = "\n\n".join(_command(path, command) for path, command in _all(("uvms-ocp",), root))
    return f"# Commands\n\nExit codes: {_exit_codes()}\n\n{text}\n"


def _exit_codes() -> str:
    from uvms_ocp.cli import commands as cli

    return " ".join((cli.__doc__ or "").partition("Exit codes: ")[2].split())


def _all(path: tuple[str, ...], command: Any) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Commands, those of groups after one another."""
    if not hasattr(command, "commands"):
        yield path, command
        return
    for name, part in command.commands.items():
        yield from _all((*path, name), part)


def _command(path: tuple[str, ...], command: Any) -> str:
    arguments = [_value_of(parameter) for parameter in command.params if not _is_option(parameter)]
    options = ["[OPTIONS]"] if len(arguments) < len(command.params) else []
    text = (command.help or "").partition("\f")[0]
    rows = ((_name_of(parameter), str(getattr(parameter, "help", "") or "")) for parameter in command.params)
    table = _table(("name", "meaning"), rows) if command.params else ""
    return f"## {' '.join(path)}\n\n    {' '.join((*path, *options, *arguments))}\n\n{text}\n\n{table}"


def _is_option(parameter: Any) -> bool:
    return bool(parameter.opts[0].startswith("-"))


def _value_of(parameter: Any) -> str:
    return str(parameter.metavar or parameter.name.upper())


def _name_of(parameter: Any) -> str:
    if not _is_option(parameter):
        return f"`{_value_of(parameter)}`"
    value = "" if getattr(parameter, "is_flag", False) else f" {_value_of(parameter)}"
    return f"`{', '.join([*parameter.opts, *parameter.secondary_opts])}{value}`"
