"""``campaign``: run a mission many times with everything uncertain, and report."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from uvms_ocp.campaign.campaign import Campaign, kept_campaign
from uvms_ocp.campaign.manifest import FILE
from uvms_ocp.campaign.paired_comparison import compare_campaigns
from uvms_ocp.campaign.report import report_of, table_with_success
from uvms_ocp.campaign.run_metrics import metric_values, metrics_among
from uvms_ocp.campaign.sampling_design import SAMPLERS
from uvms_ocp.campaign.success_criteria import MetricBound, parse_bounds
from uvms_ocp.campaign.variations import available_parameters
from uvms_ocp.cli import options as opt, printing
from uvms_ocp.cli.exit_codes import INTERRUPTED
from uvms_ocp.cli.result_folders import default_folder, label, named_folder
from uvms_ocp.cli.run import run_and_write
from uvms_ocp.errors import InvalidInput, plain_line
from uvms_ocp.record import durable_files, output

_WHAT = (
    "A scenario as for `run` (your own file is run to load it: give only what you trust), or a"
    " campaign's folder."
)
_DEFAULT_RUNS = 100
_DPI = 110
_SHOWN = 8  # rows of a table on a terminal
_SENSITIVITY = ("figure", "parameter", "rank_correlation", "pawn", "pawn_floor")


def campaign(
    what: Annotated[str, typer.Argument(metavar="SCENARIO|DIR", help=_WHAT)],
    vary: Annotated[
        str | None,
        typer.Option(
            metavar="FILE.py",
            help="Defines `variations`, a list of Variation(NAME, DISTRIBUTION). It is run.",
        ),
    ] = None,
    runs: Annotated[
        int | None, typer.Option(metavar="N", help="Number of runs; default: 100.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", parser=named_folder, help="Folder of the campaign."),
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of all that is drawn.")] = 0,
    sampler: Annotated[
        str, typer.Option(help=f"{', '.join(SAMPLERS)}; indices: the design of Sobol' indices.")
    ] = "sobol",
    scheduler: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS", help="Dask cluster, such as tcp://host:8786; default: this machine."
        ),
    ] = None,
    workers: Annotated[
        int | None, typer.Option(metavar="N", help="Processes of this machine; default: all.")
    ] = None,
    time_limit: Annotated[
        float,
        typer.Option(
            metavar="S", help="Of a run [s]: what takes longer is stopped, and a row that says so."
        ),
    ] = 3600.0,
    records: Annotated[
        str, typer.Option(help="Whole records to keep: none, failures or all.")
    ] = "none",
    changes: opt.ScenarioOptions = opt.AS_IT_IS,
    noise: opt.Noise = None,
    duration: opt.Duration = None,
    fault: opt.Faults = None,
    force: Annotated[
        bool, typer.Option("--force", help="Run even if pre-flight finds errors.")
    ] = False,
    parameters: Annotated[
        bool, typer.Option("--parameters", help="List what can be varied, and do no more.")
    ] = False,
    report: Annotated[
        bool, typer.Option("--report", help="Write report.html and report.json of a folder.")
    ] = False,
    rerun: Annotated[
        int | None,
        typer.Option(metavar="K", help="Repeat run K of a folder, with record and scene."),
    ] = None,
    against: Annotated[
        Path | None, typer.Option(metavar="DIR2", help="Compare a folder with that of another.")
    ] = None,
    success: Annotated[
        list[str] | None,
        typer.Option(
            metavar="BOUND",
            help="In reports, what finished runs must keep: tool_position_error_m<0.01; repeatable.",
        ),
    ] = None,
    as_json: opt.Json = False,
) -> None:
    """Run a mission many times with everything uncertain, on all cores or a Dask cluster; stopped,
    it goes on where it was.

    Rows go to DIR/rows as Parquet. Of a folder: --report, --rerun K, --against DIR2.

    \f Raises `InvalidInput` where options do not fit, and `OutputError` for a report that cannot be
    written.
    """
    console = printing.console_of(stderr=as_json)
    bounds = parse_bounds(success or ())
    options = changes.chosen | opt.given_options(
        noise=noise, duration=duration, faults=tuple(fault) if fault else None
    )
    folder = Path(what)
    output: Any
    if (folder / FILE).is_file():
        if rerun is not None:
            output = _repeat(folder, rerun, out or folder / "reruns" / f"run-{rerun}", console)
        elif against is not None:
            output = compare_campaigns(folder, against, bounds)
            _print_comparison(output, console)
        else:
            output = _write_report(folder, bounds, console)
    elif report or rerun is not None or against is not None:
        raise InvalidInput(
            f"{what}: no campaign is there; --report, --rerun and --against need the folder of one"
        )
    elif parameters:
        output = _list_parameters(what, options, console)
    else:
        campaign_options = {}
        for name, value in options.items():
            campaign_options[name] = list(value) if isinstance(value, tuple) else value
        new_campaign = Campaign(
            scenario=what,
            variations=vary or (),
            runs=_DEFAULT_RUNS if runs is None else runs,
            seed=seed,
            sampler=sampler,
            options=campaign_options,
            records=records,
        )
        folder = out or default_folder(("campaign", label(what)), options)
        _require_fit(new_campaign, force, console)
        with _interruptible(folder, console):
            new_campaign.run(folder, workers=workers, scheduler=scheduler, time_limit=time_limit)
        output = _write_report(folder, bounds, console)
    if as_json:
        printing.print_json(output)


def _repeat(folder: Path, run: int, out: Path, console: Console) -> dict[str, Any]:
    past_campaign = kept_campaign(folder)
    scenario = past_campaign.scenario_of(run)
    values = [
        {"parameter": name, "value": value} for name, value in past_campaign.work.head(run).items()
    ]
    console.print(printing.table_of(f"run {run}", values, ("parameter", "value")))
    return run_and_write(scenario, out, console)


def _require_fit(new_campaign: Campaign, force: bool, console: Console) -> None:
    with printing.busy(console, "looking over the mission"):
        preflight = new_campaign.work.base().check()
    printing.require_accepted(preflight, "the mission itself", console, force=force)


def _list_parameters(what: str, options: dict[str, Any], console: Console) -> list[dict[str, str]]:
    parameters = available_parameters(opt.build_scenario(what, options)).values()
    rows = [{"parameter": p.name, "unit": p.unit, "meaning": p.meaning} for p in parameters]
    console.print(
        printing.table_of(f"what can be varied of {what}", rows, ("parameter", "unit", "meaning"))
    )
    return rows


@contextmanager
def _interruptible(folder: Path, console: Console) -> Iterator[None]:
    """Let Ctrl-C say how to go on."""
    try:
        yield
    except KeyboardInterrupt:
        text = (
            f"stopped; what is finished is in {folder}, and the same command goes on with the rest"
        )
        printing.print_line(console, text, "yellow")
        raise typer.Exit(INTERRUPTED) from None


def _write_report(folder: Path, success: Sequence[MetricBound], console: Console) -> dict[str, Any]:
    """Write report.json and report.html into the folder of a campaign, and print what matters.
    Raises `OutputError`.
    """
    from uvms_ocp.viz.campaign_report import report_page

    table = table_with_success(folder, success)
    report = report_of(folder, table, success)
    with console.status("drawing"):
        page = report_page(report, _figures(table, report))
    paths = [folder / "report.json", folder / "report.html"]
    with output.as_output_errors(folder):
        for path, text in zip(paths, (json.dumps(report, indent=1) + "\n", page), strict=True):
            durable_files.write_durably(path, text)
    _print_report(report, console)
    printing.print_paths(console, paths)
    return report


def _figures(table: Any, report: dict[str, Any]) -> dict[str, bytes]:
    from uvms_ocp.viz import campaign_figures as figures
    from uvms_ocp.viz.style import png_of

    rate = report["success"]
    success = table["success"].to_numpy(dtype=bool)
    values = {name: metric_values(table, name) for name in metrics_among(table)}
    figures_by_title = {
        "success rate": figures.figure_rate(success, (rate["lower"], rate["upper"])),
        "outcomes": figures.figure_outcomes(report["outcomes"]),
        "distributions": figures.figure_spread(values, success),
    }
    for name in ("success", "tool_position_error_m", "duration_s"):
        if any(row["figure"] == name for row in report["sensitivity"]):
            figures_by_title[f"sensitivity of {name}"] = figures.figure_sensitivity(
                report["sensitivity"], name
            )
    return {name: png_of(figure, _DPI) for name, figure in figures_by_title.items()}


def _print_report(report: dict[str, Any], console: Console) -> None:
    console.print(plain_line(f"success: {report['success_text']}"), style="bold", highlight=False)
    console.print(
        plain_line(f"counted as success: {'; '.join(report['criterion'])}"), highlight=False
    )
    if report["finished"] < report["runs"]:
        console.print(
            f"so far: {report['finished']} of {report['runs']} runs are finished", highlight=False
        )
    causes = "causes of failure, with the numbers of the run that is named"
    _print_table(console, causes, report["causes"], ("number", "outcome", "cause", "run"))
    spread = ("figure", "least", "5 %", "median", "95 %", "largest")
    _print_table(
        console, "distributions", report["distributions"], spread, len(report["distributions"])
    )
    ranked = sorted(report["sensitivity"], key=lambda row: row["pawn_floor"] - row["pawn"])
    rows = [row for row in ranked if row["figure"] in ("success", "tool_position_error_m")]
    _print_table(console, "sensitivity", rows, _SENSITIVITY)
    if not rows:
        console.print(f"sensitivity: {report['sensitivity_silent']}", highlight=False)
    worst = f"worst runs: {report['worst_first']}"
    _print_table(
        console, worst, report["worst"], ("run", "outcome", "cause", "repeat"), len(report["worst"])
    )


def _print_table(
    console: Console,
    title: str,
    rows: Sequence[dict[str, Any]],
    columns: tuple[str, ...],
    n_shown: int = _SHOWN,
) -> None:
    if rows:
        if len(rows) > n_shown:
            part = f" (the first {n_shown} of {len(rows)}; report.html has all)"
        else:
            part = ""
        console.print(printing.table_of(title + part, rows[:n_shown], columns))


def _print_comparison(comparison: dict[str, Any], console: Console) -> None:
    """Print both rates, and pairs of runs where there are any."""
    for place, text in zip(comparison["campaigns"], comparison["success_text"], strict=True):
        console.print(plain_line(f"{place}: success {text}"), highlight=False)
    if not comparison["paired"]:
        console.print(
            "not paired: other parameters, seeds, sampler or numbers of runs", highlight=False
        )
        return
    text = (
        f"of {comparison['pairs']} pairs the first alone succeeds in {comparison['first_only']},"
        " the second alone in"
    )
    text = (
        f"{text} {comparison['second_only']}; p = {comparison['p_value']:.3g} (McNemar, exact): how"
        " likely so uneven a share would be"
    )
    console.print(f"{text} of two campaigns that succeed equally often", highlight=False)
    columns = ("figure", "pairs", "mean_change", "lower", "upper", "median_change")
    title = (
        "second less first: mean over the pairs with its 95 % interval (lower, upper) by the"
        " bootstrap, and median"
    )
    _print_table(console, title, comparison["figures"], columns, len(comparison["figures"]))
