"""Run a study, and print and write reports of campaigns and studies."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from uvms_ocp.campaign import STUDIES
from uvms_ocp.campaign.jobs import METRICS, metric_values
from uvms_ocp.campaign.report import Bound, report_of, table_with_success
from uvms_ocp.campaign.study import StudyResult
from uvms_ocp.cli.options import default_folder, require_taken
from uvms_ocp.cli.printing import print_json, print_line, print_paths, table_of
from uvms_ocp.errors import OutputError, plain_line
from uvms_ocp.record.durable_files import write_durably

if TYPE_CHECKING:
    from matplotlib.figure import Figure


# What a command writes and prints of a campaign.

_DPI = 110
_SHOWN = 8  # rows of a table on a terminal
_SENSITIVITY = ("figure", "parameter", "rank_correlation", "pawn", "pawn_floor")


def write_report(folder: Path, success: Sequence[Bound], console: Console) -> dict[str, Any]:
    """Write report.json and report.html into the folder of a campaign, and print what matters. Raises `OutputError`."""
    from uvms_ocp.viz.campaign_report import report_page

    table = table_with_success(folder, success)
    report = report_of(folder, table, success)
    with console.status("drawing"):
        page = report_page(report, _figures(table, report))
    paths = [folder / "report.json", folder / "report.html"]
    try:
        for path, text in zip(paths, (json.dumps(report, indent=1) + "\n", page), strict=True):
            write_durably(path, text)
    except OSError as error:
        raise OutputError(f"{folder}: cannot write the report ({error.strerror})") from error
    _print_report(report, console)
    print_paths(console, paths)
    return report


def _figures(table: Any, report: dict[str, Any]) -> dict[str, bytes]:
    from uvms_ocp.viz import campaign_report as figures

    rate = report["success"]
    good = table["success"].to_numpy(dtype=bool)
    drawn = {
        "success rate": figures.figure_rate(good, (rate["lower"], rate["upper"])),
        "outcomes": figures.figure_outcomes(report["outcomes"]),
        "distributions": figures.figure_spread({name: metric_values(table, name) for name in METRICS}, good),
    }
    for name in ("success", "tool_position_error_m", "duration_s"):
        if any(row["figure"] == name for row in report["sensitivity"]):
            drawn[f"sensitivity of {name}"] = figures.figure_sensitivity(report["sensitivity"], name)
    return {name: _png(figure) for name, figure in drawn.items()}


def _png(figure: Figure) -> bytes:
    buffer = BytesIO()
    figure.savefig(buffer, format="png", dpi=_DPI)
    return buffer.getvalue()


def _print_report(report: dict[str, Any], console: Console) -> None:
    console.print(plain_line(f"success: {report['success_text']}"), style="bold", highlight=False)
    console.print(plain_line(f"counted as success: {'; '.join(report['criterion'])}"), highlight=False)
    if report["finished"] < report["runs"]:
        console.print(f"so far: {report['finished']} of {report['runs']} runs are finished", highlight=False)
    causes = "causes of failure, with the numbers of the run that is named"
    _print_table(console, causes, report["causes"], ("number", "outcome", "cause", "run"))
    spread = ("figure", "least", "5 %", "median", "95 %", "largest")
    _print_table(console, "distributions", report["distributions"], spread, len(METRICS))
    ranked = sorted(report["sensitivity"], key=lambda row: row["pawn_floor"] - row["pawn"])
    own = [row for row in ranked if row["figure"] in ("success", "tool_position_error_m")]
    _print_table(console, "sensitivity", own, _SENSITIVITY)
    if not own:
        console.print(f"sensitivity: {report['sensitivity_silent']}", highlight=False)
    worst = f"worst runs: {report['worst_first']}"
    _print_table(console, worst, report["worst"], ("run", "outcome", "cause", "repeat"), len(report["worst"]))


def _print_table(
    console: Console, title: str, rows: Sequence[dict[str, Any]], columns: tuple[str, ...], most: int = _SHOWN
) -> None:
    if rows:
        part = f" (the first {most} of {len(rows)}; report.html has all)" if len(rows) > most else ""
        console.print(table_of(title + part, rows[:most], columns))


def print_comparison(found: dict[str, Any], console: Console) -> None:
    """Both rates, and pairs of runs where there are any."""
    for folder, text in zip(found["campaigns"], found["success_text"], strict=True):
        console.print(plain_line(f"{folder}: success {text}"), highlight=False)
    if not found["paired"]:
        console.print("not paired: other parameters, seeds, sampler or numbers of runs", highlight=False)
        return
    text = f"of {found['pairs']} pairs the first alone succeeds in {found['first_only']}, the second alone in"
    text = f"{text} {found['second_only']}; p = {found['p_value']:.3g} (McNemar, exact): how likely so uneven a share would be"
    console.print(f"{text} of two campaigns that succeed equally often", highlight=False)
    columns = ("figure", "pairs", "mean_change", "lower", "upper", "median_change")
    title = "second less first: mean over the pairs with its 95 % interval (lower, upper) by the bootstrap, and median"
    _print_table(console, title, found["figures"], columns, len(METRICS))


@contextmanager
def progress_bar(console: Console) -> Iterator[Callable[[int, int, int], None]]:
    """Done, failed, rate and time left, on one line."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(bar_width=24),
        TextColumn("{task.fields[failed]} failed, {task.fields[rate]}"),
        TimeElapsedColumn(),
        TextColumn("left:"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, disable=not console.is_terminal) as bar:
        task = bar.add_task("starting", total=None, failed=0, rate="-")

        def tell(done: int, failed: int, total: int) -> None:
            speed = bar.tasks[0].finished_speed or bar.tasks[0].speed
            rate = "-" if not speed else f"{speed:.3g} runs/s" if speed >= 1 else f"{60 * speed:.3g} runs/min"
            done_of = f"{done} of {total} runs"
            bar.update(task, description=done_of, completed=done, total=total, failed=failed, rate=rate)

        yield tell


# A study from the command line: its cases are runs of a campaign, and its table is printed.

INTERRUPTED = 130


def make_study(
    name: str,
    options: Mapping[str, Any],
    console: Console,
    *,
    out: Path | None,
    cluster: Mapping[str, Any] | None = None,
    as_json: bool = False,
) -> None:
    """Run what is not finished of a study, write report.json and runs.csv beside its rows, and print its table.

    Raises what `Study.run` raises, `InvalidInput` for options that it does not have, and `OutputError` where it cannot write.
    """
    require_taken(name, STUDIES[name], options)
    folder = out or default_folder((name,), {key: value for key, value in options.items() if key != "force"})
    study = STUDIES[name](**options)
    with interruptible(folder, console), progress_bar(console) as tell:
        result = study.run(folder, progress=tell, **(cluster or {}))
    try:
        write_durably(folder / "report.json", json.dumps(result.to_dict(), indent=2) + "\n")
        result.write_csv(folder / "runs.csv")
    except OSError as error:
        raise OutputError(f"{folder}: cannot write the table ({error.strerror})") from error
    _print_study(result, console)
    print_paths(console, [folder])
    if as_json:
        print_json(result.to_dict())


@contextmanager
def interruptible(folder: Path, console: Console) -> Iterator[None]:
    """Ctrl-C says how to go on."""
    try:
        yield
    except KeyboardInterrupt:
        text = f"stopped; what is finished is in {folder}, and the same command goes on with the rest"
        print_line(console, text, "yellow")
        raise typer.Exit(INTERRUPTED) from None


def _print_study(result: StudyResult, console: Console) -> None:
    rows = result.table
    if len(rows) == 1:  # one wide row reads better downwards
        rows = tuple({"figure": name, "value": value} for name, value in rows[0].items())
    console.print(table_of(result.title, rows, tuple(rows[0])))
