"""Texts of the files of an exported controller in C, and the names in them."""

from __future__ import annotations

import ast
import hashlib
import inspect
import re
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from string import Template

from uvms_ocp.checks import replace_with_symbols
from uvms_ocp.codegen.c_text import EXACT
from uvms_ocp.codegen.kernel_layout import Layout
from uvms_ocp.codegen.kernels import CLibrary, number
from uvms_ocp.control.velocity.levels import numbers_of
from uvms_ocp.errors import plain_line
from uvms_ocp.export.names import functions_in, structures_in, with_prefix
from uvms_ocp.export.tick import ControllerInputs, ControllerOutputs
from uvms_ocp.robot.robot import Robot
from uvms_ocp.tasks.task import Task

NUMBERS = "controller_numbers"

SOURCES = ("controller.h", "controller.c", "initial.c", "functions.c", "solver.c")
"""Files that are compiled, each name behind that of the export."""
FILES = (*SOURCES, "replay.c", "recorded.bin")
"""Files of an export whose names begin with its own."""
COMMON_FILES = ("CMakeLists.txt", "README.md")
"""Files that have one name in every export, as other programs look for them."""
_PLACEHOLDER = re.compile("(NAME|SYMBOL)_")  # in templates: prefix of what users read, of symbols
_DIGEST = "DIGEST"  # in symbols, until the content of all sources is known
_DIGEST_LENGTH = 12  # hexadecimal digits


def symbol_prefix(name: str) -> str:
    """Return the text before all symbols of the export of that name, until `with_digest`."""
    return f"{name}_{_DIGEST}_"


def file_names(name: str) -> dict[str, str]:
    """Return the files of the export of that name, by what they are called without it."""
    return {file: f"{name}_{file}" for file in FILES} | {file: file for file in COMMON_FILES}


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ControllerNames:
    """Names of the export, and of the controller's phases, statuses, quantities and channels."""

    export: str
    """Name before every identifier, followed by a ``_``."""
    phases: tuple[str, ...]
    """Phases in the order of `ControllerOutputs.phase`."""
    statuses: tuple[str, ...]
    """Statuses in the order of `ControllerOutputs.status`."""
    quantities: tuple[str, ...]
    """Quantities in the order of `ControllerOutputs.quantities`."""
    channels: tuple[str, ...]
    """Channels in the order of `ControllerInputs.trust`."""

    @property
    def prefix(self) -> str:
        """Text before every type and macro."""
        return f"{self.export}_"

    @property
    def symbol_prefix(self) -> str:
        """Text before all that linkers see, until `with_digest`."""
        return symbol_prefix(self.export)

    def texts(self) -> dict[str, list[str]]:
        """Return the names by their arrays in C, as far as they can stand in a text there; never
        empty.
        """
        texts = dict[str, list[str]]()
        for name in ("phases", "statuses", "quantities", "channels"):
            plain_texts = [_plain(text) for text in getattr(self, name)]
            texts[f"{self.prefix}CONTROLLER_{name.upper()}"] = plain_texts or [""]
        return texts


@dataclass(frozen=True, kw_only=True, slots=True)
class NamedSources:
    """Texts of a `CLibrary` and a solver with the name of the export before all that other files
    can see.
    """

    types: str
    """Structures."""
    kernels: str
    """Kernels, after types and declarations."""
    functions: str
    """CasADi functions, a file of its own."""
    numbers: str
    """Definition of their numbers, in another file."""
    declarations: str
    """Declarations of these functions, and of the solver."""
    initial: str
    """Code that initialises the memory."""
    solver: str
    """The solver, a file of its own."""

    @classmethod
    def of(cls, library: CLibrary, solver: str, names: ControllerNames) -> NamedSources:
        """Name the texts: structures where kernels use them, functions where they are defined."""
        prefix = names.symbol_prefix
        structures = structures_in(library.types)
        kernels = functions_in(library.kernels)
        of_types = with_prefix(library.kernels, names.prefix, structures)
        defined = functions_in(library.functions) | functions_in(solver)
        declared = functions_in(library.declarations)
        written = {name for name in defined | declared if not name.startswith("casadi_")}
        # CasADi gives what all its functions share the name of their file.
        functions = {*written, "functions_", "numbers"}
        return cls(
            types=with_prefix(library.types, names.prefix, structures),
            kernels=with_prefix(of_types, prefix, kernels),
            functions=with_prefix(library.functions, prefix, functions),
            numbers=with_prefix(library.numbers, prefix, functions),
            declarations=with_prefix(library.declarations, prefix, functions),
            initial=with_prefix(library.initial, prefix, functions),
            solver=with_prefix(solver, prefix, functions),
        )


def header(sources: NamedSources, names: ControllerNames, memory: str) -> str:
    """Return controller.h; memory: name of the structure of all that the controller remembers."""
    declarations = list[str]()
    for name, texts in names.texts().items():
        declarations.append(f"extern const char *const {name}[{len(texts)}];")
    return Template(template("controller.h", names.export)).substitute(
        types=sources.types,
        memory=f"{names.prefix}{memory}",
        inputs=_documented(ControllerInputs, names.prefix),
        outputs=_documented(ControllerOutputs, names.prefix),
        names="\n".join(declarations),
    )


def source(
    sources: NamedSources,
    names: ControllerNames,
    kernel: str,
    numbers: list[float],
    places: Mapping[str, int],
) -> str:
    """Return controller.c, whose tick is the `kernel` of that name."""
    definitions = list[str]()
    for name, texts in names.texts().items():
        quoted = ", ".join(f'"{text}"' for text in texts)
        definitions.append(f"const char *const {name}[] = {{{quoted}}};")
    parameters = list[str]()
    for name, k in places.items():
        parameters.append(f'{{"{_plain(name)}", {names.symbol_prefix}{NUMBERS} + {k}}}, ')
    return Template(template("controller.c", names.export)).substitute(
        exact=EXACT,
        declarations=sources.declarations,
        kernels=sources.kernels,
        kernel=kernel,
        names="\n".join(definitions),
        values=", ".join(number(value) or "0" for value in numbers),
        parameters="".join(parameters),
    )


def initial(sources: NamedSources, names: ControllerNames) -> str:
    """Return initial.c: what is remembered at first, and the numbers of `functions.c`.

    A file of its own, as compilers that see megabytes of it look for what follows from them for
    minutes.
    """
    return Template(template("initial.c", names.export)).substitute(
        exact=EXACT,
        declarations=sources.declarations,
        numbers=sources.numbers,
        value=sources.initial,
    )


def task_numbers(tasks: Sequence[Task], robot: Robot) -> tuple[list[float], dict[str, int]]:
    """Return the numbers of all tasks [as their fields] in the order of their rows, with the two
    that `with_numbers` appends.

    And, by ``task.field``, the places of those that may be changed in C, as rows alone depend on
    them: safety rules beside the rows are compiled with the others.
    """
    numbers = list[float]()
    places = dict[str, int]()
    for task in tasks:
        for name in numbers_of(task):
            if _of_rows_alone(task, robot, name):
                places[f"{task.name}.{name}"] = len(numbers)
            numbers.append(getattr(task, name))
    return [*numbers, 0.0, 1.0], places


def _of_rows_alone(task: Task, robot: Robot, name: str) -> bool:
    """Check that a number of a task enters its rows alone: its rest altitude and position limit are
    the same for another value.
    """
    changed = replace_with_symbols(task, **{name: getattr(task, name) + 1.0})
    return _rules(task, robot) == _rules(changed, robot)


def _rules(task: Task, robot: Robot) -> tuple[object, object]:
    """Return the rest altitude of a task and the lower end of its position limit, where it has
    them.
    """
    limit = task.position_limit(robot)
    return task.rest_altitude, limit and limit.lower


def template(file: str, name: str) -> str:
    """Return a template of the export with its name put in; other places may be left to be
    filled.
    """
    text = files("uvms_ocp.export").joinpath("templates", file).read_text(encoding="utf-8")
    prefixes = {"NAME": f"{name}_", "SYMBOL": symbol_prefix(name)}
    return _PLACEHOLDER.sub(lambda placeholder: prefixes[placeholder[1]], text)


def with_digest(texts: Mapping[str, str], name: str) -> dict[str, str]:
    """Return the texts of the files of an export with a digest of all `SOURCES` in every symbol.

    What is compiled with a header is linked to the controller of that header, or not at all: of
    archives and shared libraries that have one symbol a linker takes the first without a word.
    """
    content = "".join(texts[file] for file in SOURCES)
    digest = hashlib.sha256(content.encode()).hexdigest()[:_DIGEST_LENGTH]
    placeholder = re.compile(rf"\b{symbol_prefix(name)}")
    return {file: placeholder.sub(f"{name}_{digest}_", text) for file, text in texts.items()}


def table(names: Sequence[str]) -> str:
    """Return rows of a table in Markdown: place and name."""
    return "\n".join(f"| {place} | {literal(name)} |" for place, name in enumerate(names))


def literal(name: str) -> str:
    """Return a name as code in Markdown, in tables too, with no letter that would end it."""
    return f"`{re.sub('[`|]', '.', plain_line(name))}`"


def _plain(name: str) -> str:
    """Return a name without letters that would end a string, a comment or a cell of a table."""
    return "".join(c for c in plain_line(name) if c.isascii() and c not in '"\\?*/|')


def _documented(layout: type[Layout], prefix: str) -> str:
    """Return a comment with the docstrings of a layout and of its fields."""
    lines = [f"/* {prefix}{layout.__name__}: {inspect.cleandoc(layout.__doc__ or '')}"]
    for name, text in field_docs(layout).items():
        prefixed = text.replace("CONTROLLER_", f"{prefix}CONTROLLER_")
        lines.append(f"   {name}: {prefixed}")
    return "\n".join([*lines, "*/"])


def field_docs(layout: type[Layout]) -> Mapping[str, str]:
    """Return the docstring of each field of a layout, or of the next one that has one.

    From the source, as Python keeps docstrings of classes and functions alone; in exported C they
    are the comments, so that no text is written twice.
    """
    (definition,) = ast.parse(textwrap.dedent(inspect.getsource(layout))).body
    body = list[ast.stmt]()
    if isinstance(definition, ast.ClassDef):
        body = definition.body
    texts = dict[str, str]()
    waiting = list[str]()
    for node in body:
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            waiting.append(node.target.id)
        elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and waiting:
            texts |= dict.fromkeys(waiting, inspect.cleandoc(str(node.value.value)))
            waiting.clear()
    return texts
