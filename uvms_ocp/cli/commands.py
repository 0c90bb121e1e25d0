"""The command line: its commands, each imported when it is asked for, and its entry point."""

from __future__ import annotations

import ast
import gc
import os
import sys
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from importlib import import_module
from importlib.resources import files
from pathlib import Path
from traceback import print_exception
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from uvms_ocp.cli import compilation, json_output
from uvms_ocp.cli.exit_codes import BAD_INPUT
from uvms_ocp.errors import UvmsError, plain_line
from uvms_ocp.version import __version__

Place = str | typer.Typer
"""Definition of a command: MODULE.FUNCTION of this package, which is imported when the command is
asked for, as imports last longer than many commands; or a group of commands.
"""

_EXAMPLES = (
    (files("uvms_ocp.cli") / "examples.txt").read_text(encoding="utf-8").replace(r"\b", "\b")
)
_EXPORT = {"controller": "robots.controller"}
_PLAN = {"curve": "plan.curve", "ocp": "plan.ocp", "mission": "plan.mission"}

_TRACEBACK = "--traceback"

_VECTOR_SIZE = 3  # numbers of a vector, such as a position


class Commands(Mapping[str, Any]):
    """Commands by name, made when they are looked up."""

    def __init__(self, places: Mapping[str, Place]) -> None:
        self._places = places
        self._commands = dict[str, Any]()
        """Commands that have been built."""

    def __getitem__(self, name: str) -> Any:
        if name not in self._commands:
            self._commands[name] = _built(name, self._places[name])
        return self._commands[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)

    def summaries(self) -> list[tuple[str, str]]:
        """Return name and first paragraph of the help of all commands, without importing them."""
        return [(name, _summary(place)) for name, place in self._places.items()]


def _built(name: str, place: Place) -> Any:
    """Import and build the command of a name."""
    if isinstance(place, typer.Typer):
        return typer.main.get_group(place)
    from uvms_ocp.cli.option_groups import expand_options

    module, function = place.split(".")
    app = typer.Typer(add_completion=False, rich_markup_mode=None)
    app.command(name=name)(
        expand_options(getattr(import_module(f"uvms_ocp.cli.{module}"), function))
    )
    return typer.main.get_command(app)


def _summary(place: Place) -> str:
    """Return the first paragraph of the help of a command, read from its source."""
    if isinstance(place, typer.Typer):
        return str(place.info.help)
    module, function = place.split(".")
    source = Path(__file__).with_name(f"{module}.py").read_text(encoding="utf-8")
    functions = [node for node in ast.parse(source).body if isinstance(node, ast.FunctionDef)]
    command = next(node for node in functions if node.name == function)
    docstring = ast.get_docstring(command) or ""
    first_paragraph = docstring.partition("\n\n")[0]
    return " ".join(first_paragraph.split())


def _group(places: Mapping[str, Place], **options: Any) -> typer.Typer:
    """Make a group of commands that are imported one by one; options: those of `typer.Typer`."""

    class Group(TyperGroup):
        def __init__(self, **attributes: Any) -> None:
            super().__init__(**attributes)
            self.commands = Commands(places)  # type: ignore[assignment]

        def list_commands(self, ctx: Any) -> list[str]:
            return list(self.commands)

        def format_commands(self, ctx: Any, formatter: Any) -> None:
            with formatter.section("Commands"):
                formatter.write_dl(Commands(places).summaries())

    return typer.Typer(cls=Group, no_args_is_help=True, rich_markup_mode=None, **options)


_ALL: dict[str, Place] = {
    "run": "run.run",
    "check": "show.check",
    "mission": "show.mission",
    "campaign": "campaign.campaign",
    "compare": "show.compare_runs",
    "show": "show.show_scene",
    "estimate": "show.estimate",
    "excite": "identify.excite",
    "map": "identify.map_recording",
    "check-recording": "identify.check_recording",
    "identify": "identify.identify",
    "thruster-curve": "identify.thruster_curve",
    "list": "robots.list_all",
    "check-robot": "robots.check_robot",
    "schema": "robots.schema",
    "cache": "compilation.cache",
    "new-robot": "robots.new_robot",
    "new-mission": "robots.new_mission",
    "export": _group(_EXPORT, help="Write what runs without Python."),
    "plan": _group(_PLAN, help="Plan a motion among obstacles, or a whole mission."),
}
app = _group(
    _ALL,
    help="Task-priority planning of underwater vehicle-manipulator systems.",
    epilog=_EXAMPLES,
    pretty_exceptions_enable=False,
)


def _show_version(is_set: bool) -> None:
    """Print the version and end."""
    if is_set:
        sys.stdout.write(f"uvms-ocp {__version__}\n")
        raise typer.Exit


@app.callback()
def common(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version."),
    ] = False,
    traceback: Annotated[
        bool,
        typer.Option(
            _TRACEBACK, help="Print where an error comes from, not its line alone; anywhere."
        ),
    ] = False,
) -> None:
    """Task-priority planning of underwater vehicle-manipulator systems."""


def expand_vectors(app: typer.Typer, words: Sequence[str]) -> list[str]:
    """Split vectors that are written with commas, such as ``--position -3,1,2``: return the words of
    a command line with their numbers one by one, as the parser takes them.
    """
    command: Any = typer.main.get_command(app)
    for word in words:
        if word in getattr(command, "commands", ()):
            command = command.commands[word]
    vector_options = set[str]()
    for parameter in command.params:
        if parameter.nargs == _VECTOR_SIZE:
            vector_options.update(parameter.opts)
    return list(_split_vectors(words, vector_options))


def _split_vectors(words: Sequence[str], vector_options: Collection[str]) -> Iterator[str]:
    """Yield the words of a command line; the vector after one of the `vector_options` as one word for
    each number.
    """
    previous = ""
    for word in words:
        name, separator, value = word.partition("=")
        if separator and name in vector_options:
            yield from (name, *value.split(","))
        elif previous in vector_options and word.count(",") == _VECTOR_SIZE - 1:
            yield from word.split(",")
        else:
            yield word
        previous = word


def main() -> None:
    """Run the command line: the entry point of the console script."""
    if sys.stdout is None:  # closed by the caller
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115 - for as long as the process lives
    # With Python's own threshold the garbage collector takes a tenth of the time of imports and
    # expressions.
    gc.set_threshold(200_000)
    words = [word for word in sys.argv[1:] if word != _TRACEBACK]
    if "--json" in words:
        stdout_guard: AbstractContextManager[None] = json_output.json_alone_on_stdout()
    else:
        stdout_guard = nullcontext()
    try:
        with compilation.warned_behind_errors(), stdout_guard:
            try:
                app(expand_vectors(app, words))
            finally:
                sys.stdout.flush()  # here, where a full disk can still be told
    except BrokenPipeError:  # of a reader that has seen enough
        _drop_stdout()
        sys.exit(1)
    except (Exception, SystemExit) as error:
        if isinstance(error, UvmsError | OSError):
            text = str(error)
        else:
            text = _failure_of_own_code(error)
        if isinstance(error, MemoryError):
            text = (
                f"out of memory ({error}): give less at a time, such as shorter recordings or fewer"
                " rows"
            )
        if not text:
            if isinstance(error.__context__, KeyboardInterrupt):
                print(str(error.__context__) or "stopped by hand", file=sys.stderr)
            raise
        _drop_stdout()
        if _TRACEBACK in sys.argv:
            print_exception(error)
        from uvms_ocp.cli.printing import console_of

        console_of(stderr=True).print(
            plain_line(f"error: {text}"), style="red", highlight=False, soft_wrap=True
        )
        sys.exit(BAD_INPUT)


def _failure_of_own_code(error: BaseException) -> str:
    """Describe an error that the user's own code raised; empty where it did not."""
    own_code = sys.modules.get("uvms_ocp.scenario.own_code")
    if own_code is None:
        return ""
    return str(own_code.own_failure(error))


def _drop_stdout() -> None:
    """Drop what cannot be written any more, so that it is not tried again at the end."""
    with suppress(OSError, ValueError):
        sys.stdout.flush()
        return
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
