"""The command line: its commands and its entry point."""

from __future__ import annotations

import os
import sys
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from typing import Annotated

import typer

from uvms_ocp.cli import campaign, identify, plan, robots, run, show
from uvms_ocp.cli.options import BAD_INPUT, expand_options
from uvms_ocp.cli.printing import console_of, warned_behind_errors
from uvms_ocp.errors import UvmsError, plain_line
from uvms_ocp.version import __version__

# Options of three numbers, written with commas as others write them: ``--position -3,1,2``.

_SIZE = 3


def expand_vectors(app: typer.Typer, words: Sequence[str]) -> list[str]:
    """The words of a command line with every such option followed by its numbers one by one, as the parser takes them."""
    return list(_spread(words, set(_vectors(typer.main.get_command(app)))))


def _vectors(command: object) -> Iterator[str]:
    """Options of a command, and of those below it, that take three values."""
    for parameter in getattr(command, "params", ()):
        if parameter.nargs == _SIZE:
            yield from parameter.opts
    for below in getattr(command, "commands", {}).values():
        yield from _vectors(below)


def _spread(words: Sequence[str], vectors: Collection[str]) -> Iterator[str]:
    before = ""
    for word in words:
        name, equals, value = word.partition("=")
        if equals and name in vectors:
            yield from (name, *value.split(","))
        elif before in vectors and word.count(",") == _SIZE - 1:
            yield from word.split(",")
        else:
            yield word
        before = word


# Command line: `run`, `check`, `mission`, `compare`, `campaign`, `show`, `plan`, `list`, `check-robot`, `schema`, `new-robot`,
# `new-mission`, `excite`, `check-recording`, `identify`, `export`.
#
# Exit codes: 0 done, 1 internal error, 2 bad input or refused by pre-flight, 3 mission not completed or no plan free of
# collision.

_EXAMPLES = """Examples:

\b
  uvms-ocp run                                  the paper's Case 1, in water
  uvms-ocp run --noise --fault thruster3:dead@20
  uvms-ocp show uvms_runs/case1-dynamic-active_set   in the browser
  uvms-ocp show girona_maris7                   a robot, with sliders
  uvms-ocp plan ocp --tool 12.2 37.4 -39.5 --position 11 37 -38.5
  uvms-ocp compare RUN OTHER
  uvms-ocp check-robot my.urdf --hydrodynamics my.yaml

Completion in your shell: uvms-ocp --install-completion
"""
app = typer.Typer(
    help="Task-priority planning of underwater vehicle-manipulator systems.",
    no_args_is_help=True,
    epilog=_EXAMPLES,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
app.command(name="run")(expand_options(run.run))
app.command(name="check")(expand_options(show.check))
app.command(name="mission")(expand_options(show.mission))
app.command(name="campaign")(expand_options(campaign.campaign))
app.command(name="compare")(show.compare_runs)
app.command(name="show")(expand_options(show.show_scene))
app.command(name="excite")(identify.excite)
app.command(name="check-recording")(identify.check_recording)
app.command(name="identify")(identify.identify)
app.command(name="list")(robots.list_all)
app.command(name="check-robot")(expand_options(robots.check_robot))
app.command(name="schema")(robots.schema)
app.command(name="new-robot")(expand_options(robots.new_robot))
app.command(name="new-mission")(expand_options(robots.new_mission))

export_app = typer.Typer(help="Write what runs without Python.", no_args_is_help=True)
export_app.command(name="controller")(expand_options(robots.controller))
app.add_typer(export_app, name="export")
app.add_typer(plan.app, name="plan")


def _show_version(wanted: bool) -> None:
    if wanted:
        sys.stdout.write(f"uvms-ocp {__version__}\n")
        raise typer.Exit


@app.callback()
def common(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Task-priority planning of underwater vehicle-manipulator systems."""


def main() -> None:
    """Entry point of the console script."""
    if sys.stdout is None:  # closed by the caller
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115 - for as long as the process lives
    try:
        with warned_behind_errors():
            try:
                app(expand_vectors(app, sys.argv[1:]))
            finally:
                sys.stdout.flush()  # here, where a full disk can still be told
    except BrokenPipeError:  # of a reader that has seen enough
        _drop_stdout()
        sys.exit(1)
    except (UvmsError, OSError) as error:
        _drop_stdout()
        text = plain_line(f"error: {error}")
        console_of(stderr=True).print(text, style="red", highlight=False, soft_wrap=True)
        sys.exit(BAD_INPUT)


def _drop_stdout() -> None:
    """Drop what cannot be written any more, so that it is not tried again at the end."""
    with suppress(OSError, ValueError):
        sys.stdout.flush()
        return
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
