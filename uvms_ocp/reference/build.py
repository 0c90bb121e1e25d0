"""Build the reference: pages of all packages by pdoc, pages of theory, and tables with formulas and
links.
"""

from __future__ import annotations

import ast
import importlib
import importlib.util
import inspect
import json
import pkgutil
import re
import sys
import warnings
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import typer.main
from pydantic import BaseModel

import uvms_ocp
from uvms_ocp import cli
from uvms_ocp.cli.commands import app
from uvms_ocp.errors import AdvisedStatus, InvalidInput, NameNotFound, OutputError
from uvms_ocp.identification import channel_mapping, parameters, recording, settings
from uvms_ocp.record.tables import series_markdown
from uvms_ocp.robot.description import RobotDescription

_APART = ("robots", "templates", "reference", "cli")
CITED = re.compile(r"`(uvms_ocp(?:\.\w+)+)`")
"""A name in full, as docstrings and pages write it."""

_DISPLAY = re.compile(r"\$\$(.+?)\$\$", re.DOTALL)
_INLINE = re.compile(r"(?<![\\$\w])\$([^$\n]+?)\$(?!\w)")
_ASSETS = files("uvms_ocp.reference") / "assets"
Contents = dict[str, list[tuple[str, str]]]
"""By heading, addresses and titles of pages."""

ORDER = (
    *("notation", "motion", "thrusters", "tasks", "hierarchy", "tick", "missions", "force"),
    *("estimation", "trajectories", "collision", "optimal_control"),
)
"""Order of the pages of theory, which build on those before."""
GUIDE = (
    *("commands_by_example", "your_robot", "your_parts", "python", "your_task"),
    *("campaigns", "your_variation", "mission_plans", "plans_by_optimal_control", "faults"),
    *("recordings", "limitations"),
)
"""Pages on how to use it, in their order."""
_PRIVATE = re.compile(r'<a href="[^"]*#_[^"]*">(.*?)</a>', re.DOTALL)
_MOST_FAULTS = 20  # that are told


# Pages generated from the code: robot files, settings, series of a record, commands.


def generated_pages() -> dict[str, str]:
    """Markdown by the name of the page: the texts in ``generated/``, with what the code says in its
    places.
    """
    codes = " ".join((cli.__doc__ or "").partition("Exit codes: ")[2].split())
    commands = _all(("uvms-ocp",), typer.main.get_command(app))
    entries = {
        "robot_files": {"fields": _schema(RobotDescription)},
        "identification_settings": {
            "fields": _schema(settings.CalibrationSettings),
            "quantities": _quantities(),
        },
        "series": {"table": series_markdown()},
        "channels": {
            "table": _channels(),
            "mapping": _fields(channel_mapping.ChannelMapping.model_json_schema()),
        },
        "statuses": {"tables": "\n\n".join(_statuses())},
        "commands": {
            "codes": codes,
            "commands": "\n\n".join(_command(path, command) for path, command in commands),
        },
    }
    return {
        name: text.format(**entries[name])
        for name, text in _pages_of("generated", [*entries]).items()
    }


def _table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    plain = [[" ".join(cell.replace("|", "\\|").split()) for cell in row] for row in rows]
    return "\n".join(
        "| " + " | ".join(cells) + " |" for cells in (head, ("---",) * len(head), *plain)
    )


def _statuses() -> Iterator[str]:
    """Yield tables of every outcome of a solver, a plan or a fit, whose class is known once all
    modules are.
    """
    for module in pkgutil.walk_packages(uvms_ocp.__path__, "uvms_ocp."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
    for kind in sorted(AdvisedStatus.__subclasses__(), key=lambda kind: kind.__module__):
        rows = _table(
            ("status", "what to do"), ((f"`{status.value}`", status.advice) for status in kind)
        )
        yield f"## {kind.__name__}\n\nCode: `{kind.__module__}.{kind.__name__}`.\n\n{rows}"


def _channels() -> str:
    interpolation = {True: "a command, held", False: "measured, interpolated"}
    rows = (
        (
            f"`{name}`",
            ", ".join(kind.columns) or "one for each",
            kind.unit,
            kind.frame or "-",
            interpolation[kind.command],
        )
        for name, kind in recording.CHANNEL_KINDS.items()
    )
    return _table(("channel", "columns", "unit", "frame", "between samples"), rows)


def _schema(model: type[BaseModel]) -> str:
    schema = model.model_json_schema()
    parts = {"Top level": schema, **dict(sorted(schema.get("$defs", {}).items()))}
    return "\n\n".join(f"## {name}\n\n{_fields(part)}" for name, part in parts.items())


def _quantities() -> str:
    units = (
        (f"`{name}`", quantity.unit, ", ".join(filter(None, quantity.coordinates.names)) or "-")
        for name, quantity in _learnable().items()
    )
    return _table(("quantity", "unit", "coordinates, for `free`"), units)


def _learnable() -> Mapping[str, parameters.Quantity]:
    """Quantities of any vehicle that can be learnt; coordinates of actuators are their names."""
    body: dict[str, Any] = {"mass": 1.0, "centre_of_mass": np.zeros(3), "inertia": np.eye(3)}
    water: dict[str, Any] = dict.fromkeys(
        ("added_mass", "linear_drag", "quadratic_drag"), np.eye(6)
    )
    start = parameters.NominalParameters(
        **body, **water, volume=1.0, centre_of_buoyancy=np.zeros(3)
    )
    actuators = parameters.ActuatorModel(names=("thrusters",))
    return parameters.vehicle_declaration(
        start, np.array([-np.ones(3), np.ones(3)]), actuators
    ).quantities


def _fields(part: dict[str, Any]) -> str:
    text = part.get("description", "").split("\n\n")[0]
    if "properties" not in part:
        return f"{text}\n\nOne of: {', '.join(f'`{value}`' for value in part.get('enum', ()))}."
    needed = set(part.get("required", ()))
    rows = []
    for name, field in part["properties"].items():
        default = f"`{field['default']}`" if field.get("default") is not None else "-"
        requirement = "needed" if name in needed else default
        rows.append(
            (
                f"`{name}`",
                _type_of(field),
                requirement,
                " ".join(field.get("description", "").split()),
            )
        )
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
        items = field.get("items", (field.get("prefixItems") or [{}])[0])
        return f"list of {field.get('maxItems', '') or ''} {_type_of(items or {})}".replace(
            "  ", " "
        )
    if isinstance(field.get("additionalProperties"), dict):
        return f"by name: {_type_of(field['additionalProperties'])}"
    signs = {"exclusiveMinimum": ">", "minimum": "≥", "exclusiveMaximum": "<", "maximum": "≤"}
    limits = [f"{sign} {field[key]:g}" for key, sign in signs.items() if key in field]
    return str(field.get("type", "any")) + (f", {' and '.join(limits)}" if limits else "")


def _all(path: tuple[str, ...], command: Any) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Commands, those of groups after one another."""
    if not hasattr(command, "commands"):
        yield path, command
        return
    for name, part in command.commands.items():
        yield from _all((*path, name), part)


def _command(path: tuple[str, ...], command: Any) -> str:
    arguments = [
        _value_of(parameter)
        for parameter in command.params
        if parameter.param_type_name != "option"
    ]
    options = ["[OPTIONS]"] if len(arguments) < len(command.params) else []
    text = (command.help or "").partition("\f")[0]
    rows = (
        (_name_of(parameter), str(getattr(parameter, "help", "") or ""))
        for parameter in command.params
    )
    if command.params:
        table = _table(("name", "meaning"), rows)
    else:
        table = ""
    return (
        f"## {' '.join(path)}\n\n    {' '.join((*path, *options, *arguments))}\n\n{text}\n\n{table}"
    )


def _value_of(parameter: Any) -> str:
    return str(parameter.metavar or parameter.name.upper())


def _name_of(parameter: Any) -> str:
    if parameter.param_type_name != "option":
        return f"`{_value_of(parameter)}`"
    if getattr(parameter, "is_flag", False):
        value = ""
    else:
        value = f" {_value_of(parameter)}"
    return f"`{', '.join([*parameter.opts, *parameter.secondary_opts])}{value}`"


# Which modules the reference documents: rooms with what they export, and what docstrings and theory
# refer to.

ROOT = Path(__file__).resolve().parents[1]


def exported_names(init: Path) -> tuple[str, ...]:
    """The names that a room passes on, by ``from x import Y as Y`` in its ``__init__.py`` or the
    stub beside it.
    """
    texts = [
        path.read_text(encoding="utf-8")
        for path in (init, init.with_suffix(".pyi"))
        if path.exists()
    ]
    imports = (
        node
        for text in texts
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.ImportFrom)
    )
    return tuple(
        alias.name for node in imports for alias in node.names if alias.asname == alias.name
    )


def documented_modules(pages: str) -> tuple[str, ...]:
    """Rooms that export something, and all modules that their docstrings, those of the modules so
    found, and `pages` refer to.

    Each room gets its exports as ``__all__``, which is how the generator knows them.
    """
    modules: dict[str, None] = {}
    for init in sorted(ROOT.rglob("__init__.py")):
        parts = init.parent.relative_to(ROOT).parts
        names = exported_names(init)
        if names and not set(_APART) & set(parts):
            room = importlib.import_module(".".join(("uvms_ocp", *parts)))
            # Loaded here, where the room loads them when asked.
            exports = {name: getattr(room, name) for name in names}
            public = [name for name, value in exports.items() if not inspect.ismodule(value)]
            vars(room).update(exports, __all__=public)
            modules[room.__name__] = None
    waiting = [*modules, *_modules_of(pages)]
    while waiting:
        module = waiting.pop()
        modules[module] = None
        cited = _modules_of(inspect.getsource(importlib.import_module(module)))
        waiting += [name for name in cited if name not in modules]
    return tuple(sorted(modules))


def _modules_of(text: str) -> list[str]:
    return [place_of(name)[0].__name__ for name in CITED.findall(text)]


def place_of(name: str) -> tuple[ModuleType, str]:
    """Return the module of a name in full, and the name within it.

    Raises `NameNotFound` where there is no such name.
    """
    parts = name.split(".")
    n_parts = len(parts)
    while not _is_module(".".join(parts[:n_parts])):
        n_parts -= 1
    module_name = ".".join(parts[:n_parts])
    module = importlib.import_module(module_name)
    value: object = module
    for part in parts[n_parts:]:
        fields = getattr(value, "__annotations__", {})
        if not hasattr(value, part) and part not in fields:
            allowed = [key for key in dir(value) if key[0] != "_"]
            raise NameNotFound(f"name in {module_name}", part, allowed)
        value = getattr(value, part, None)
    return module, ".".join(parts[n_parts:])


def _is_module(name: str) -> bool:
    try:
        return importlib.util.find_spec(name) is not None
    except ModuleNotFoundError:
        return False


def address_of(name: str, modules: Collection[str]) -> str:
    """Address of a name in the reference, from its top folder: on the page of its module. Raises
    `NameNotFound`.
    """
    module, qualified_name = place_of(name)
    if module.__name__ in modules:
        page = f"{module.__name__.replace('.', '/')}.html"
    else:
        page = "index.html"
    if qualified_name:
        return f"{page}#{qualified_name}"
    return page


# From Markdown to pages: formulas become MathML, names in full become links to their documentation.


def body_of(text: str, modules: Collection[str]) -> str:
    """The HTML of a page in Markdown. Raises `NameNotFound` for a name that is cited and is not
    there.
    """
    from pdoc.render_helpers import to_html

    formulas: list[str] = []
    for pattern, display in ((_DISPLAY, "block"), (_INLINE, "inline")):
        text = pattern.sub(lambda match, style=display: _mark(formulas, match[1], style), text)  # type: ignore[misc]
    text = CITED.sub(
        lambda f: f"[`{f[1].removeprefix('uvms_ocp.')}`]({address_of(f[1], modules)})", text
    )
    # Links between pages, which sites of sources follow too.
    linked = re.sub(r"\((\w+)\.md\)", r"(\1.html)", text)
    html = str(to_html(linked))
    return re.sub(r"formula(\d+)mark", lambda match: formulas[int(match[1])], html)


def _mark(formulas: list[str], latex: str, display: str) -> str:
    """Keep a formula out of the way of Markdown, which takes underscores for its own."""
    from latex2mathml.converter import convert

    formulas.append(convert(latex.strip(), display=display))
    return f"formula{len(formulas) - 1}mark"


def page_of(title: str, body: str, contents: Contents) -> str:
    """A whole page in the look of those that the generator makes."""
    from pdoc.render import env

    page, css = (
        (_ASSETS / name).read_text(encoding="utf-8") for name in ("page.html.jinja2", "page.css")
    )
    return str(env.from_string(page).render(title=title, body=body, contents=contents, css=css))


def title_of(text: str) -> str:
    """The first heading of a page in Markdown."""
    return text.splitlines()[0].lstrip("# ").strip()


# The whole reference: pages of all rooms by pdoc, pages of theory and tables, and one that leads to
# all of them.


def theory_pages() -> dict[str, str]:
    """Markdown of all pages of theory by name, in their order."""
    return _pages_of("theory", ORDER)


def guide_pages() -> dict[str, str]:
    """Markdown of all pages on how to use it by name, in their order."""
    return _pages_of("guide", GUIDE)


def _pages_of(folder: str, names: Sequence[str]) -> dict[str, str]:
    return {
        name: (files("uvms_ocp.reference") / folder / f"{name}.md").read_text(encoding="utf-8")
        for name in names
    }


def build_reference(folder: Path | str) -> Path:
    """Write the reference into a folder, which it makes; returns its first page.

    Raises `InvalidInput` where the generator is not installed, where it warns, `NameNotFound` for
    names that are cited and are not there, and `OutputError` where the folder cannot be written.
    """
    try:
        import latex2mathml.converter  # noqa: F401 - only whether it is there
        import pdoc.render
    except ImportError as error:
        raise InvalidInput(
            f'{error.name} is not installed; run: pip install "uvms-ocp[reference]"'
        ) from error
    folder = Path(folder)
    written = {
        "Guide": guide_pages(),
        "Theory": theory_pages(),
        "Files and commands": generated_pages(),
    }
    modules = documented_modules(
        "\n".join(text for pages in written.values() for text in pages.values())
    )
    pdoc.render.configure(docformat="markdown", show_source=True, search=True)
    try:
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            pdoc.pdoc(*_asked_for(modules), output_directory=folder)
        for path in folder.rglob(
            "*.html"
        ):  # classes name their private bases, which have no place to lead to
            text = _PRIVATE.sub(r"\1", path.read_text(encoding="utf-8"))
            path.write_text(text.replace("PydanticUndefined", "needed"), encoding="utf-8")
        _write_pages(folder, written, modules)
    except OSError as error:
        raise OutputError(
            f"{folder}: cannot be written ({error}); choose another folder"
        ) from error
    warning_lines = [str(item.message).splitlines()[0] for item in warned]
    if warning_lines:
        raise InvalidInput(
            f"the reference has {len(warning_lines)} faults:"
            f" {'; '.join(warning_lines[:_MOST_FAULTS])}"
        )
    return folder / "index.html"


def _asked_for(modules: tuple[str, ...]) -> Iterator[str]:
    """Yield all but those that share their name with what their room exports: they come with the
    room.
    """
    for name in modules:
        room, _, leaf = name.rpartition(".")
        if room not in modules or leaf not in getattr(sys.modules[room], "__all__", ()):
            yield name


def _write_pages(
    folder: Path, written: dict[str, dict[str, str]], modules: tuple[str, ...]
) -> None:
    contents: Contents = {
        heading: [(f"{name}.html", title_of(text)) for name, text in pages.items()]
        for heading, pages in written.items()
    }
    contents["Python"] = [
        (f"{name.replace('.', '/')}.html", name.removeprefix("uvms_ocp.")) for name in modules
    ]
    texts = {name: text for pages in written.values() for name, text in pages.items()}
    search_index = [(f"{name}.html", title_of(text), text) for name, text in texts.items()]
    (folder / "pages.js").write_text(
        f"window.pages = {json.dumps(search_index)};\n", encoding="utf-8"
    )
    for name, text in texts.items():
        (folder / f"{name}.html").write_text(
            page_of(title_of(text), body_of(text, modules), contents), encoding="utf-8"
        )
    first_page = (files("uvms_ocp.reference") / "theory" / "first_page.md").read_text(
        encoding="utf-8"
    )
    (folder / "index.html").write_text(
        page_of("uvms_ocp", body_of(first_page, modules), contents), encoding="utf-8"
    )
