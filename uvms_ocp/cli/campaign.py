"""``campaign``: run a mission many times with everything uncertain, and report."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from uvms_ocp.campaign import STUDIES
from uvms_ocp.campaign.campaign import Campaign, kept_campaign
from uvms_ocp.campaign.distributions import SAMPLERS
from uvms_ocp.campaign.report import Bound, compare_campaigns, parse_bounds
from uvms_ocp.campaign.store import FILE
from uvms_ocp.campaign.variations import available_parameters
from uvms_ocp.cli.campaign_output import interruptible, make_study, print_comparison, progress_bar, write_report
from uvms_ocp.cli.options import (
    CurrentVelocity,
    Duration,
    Faults,
    Hydrodynamics,
    Json,
    Noise,
    PlantName,
    RobotName,
    Seabed,
    build_scenario,
    default_folder,
    folder,
    given,
    label,
)
from uvms_ocp.cli.printing import console_of, print_json, require_accepted, show_compilation, table_of
from uvms_ocp.cli.run import run_and_write
from uvms_ocp.errors import InvalidInput

_WHAT = "A scenario as for `run` (your own file is run to load it: give only what you trust), a study, or a campaign's folder."


def campaign(
    what: Annotated[str, typer.Argument(metavar="SCENARIO|DIR", help=_WHAT)],
    vary: Annotated[
        str | None,
        typer.Option(
            metavar="FILE.py", help="Defines `variations`, a list of Variation(NAME, DISTRIBUTION). It is run."
        ),
    ] = None,
    runs: Annotated[int | None, typer.Option(metavar="N", help="Number of runs; default: 100.")] = None,
    out: Annotated[Path | None, typer.Option(metavar="DIR", parser=folder, help="Folder of the campaign.")] = None,
    seed: Annotated[int, typer.Option(help="Seed of all that is drawn.")] = 0,
    sampler: Annotated[
        str, typer.Option(help=f"{', '.join(SAMPLERS)}; indices: the design of Sobol' indices.")
    ] = "sobol",
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Dask cluster, such as tcp://host:8786; default: this machine."),
    ] = None,
    workers: Annotated[int | None, typer.Option(metavar="N", help="Processes of this machine; default: all.")] = None,
    time_limit: Annotated[
        float, typer.Option(metavar="S", help="Of a run [s]: what takes longer is stopped, and a row that says so.")
    ] = 3600.0,
    records: Annotated[str, typer.Option(help="Whole records to keep: none, failures or all.")] = "none",
    robot: RobotName = None,
    hydrodynamics: Hydrodynamics = None,
    plant: PlantName = None,
    current: CurrentVelocity = None,
    seabed: Seabed = None,
    noise: Noise = None,
    duration: Duration = None,
    fault: Faults = None,
    force: Annotated[bool, typer.Option("--force", help="Run even if pre-flight finds errors.")] = False,
    parameters: Annotated[bool, typer.Option("--parameters", help="List what can be varied, and do no more.")] = False,
    report: Annotated[bool, typer.Option("--report", help="Write report.html and report.json of a folder.")] = False,
    rerun: Annotated[
        int | None, typer.Option(metavar="K", help="Repeat run K of a folder, with record and scene.")
    ] = None,
    against: Annotated[Path | None, typer.Option(metavar="DIR2", help="Compare a folder with that of another.")] = None,
    success: Annotated[
        list[str] | None,
        typer.Option(
            metavar="BOUND", help="In reports, what finished runs must keep: tool_position_error_m<0.01; repeatable."
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Run a mission many times with everything uncertain, on all cores or a Dask cluster; stopped, it goes on where it was.

    Rows go to DIR/rows as Parquet. Of a folder: --report, --rerun K, --against DIR2.

    \f
    Raises `InvalidInput` where options do not fit.
    """
    console, bounds = console_of(stderr=as_json), parse_bounds(success or ())
    if (Path(what) / FILE).is_file():
        _look(Path(what), rerun, against, out, bounds, console, as_json)
        return
    if report or rerun is not None or against is not None:
        raise InvalidInput(f"{what}: no campaign is there; --report, --rerun and --against need the folder of one")
    cluster = {"workers": workers, "scheduler": scheduler, "time_limit": time_limit}
    if what in STUDIES:
        chosen = given(n=runs, seed=seed or None, plant=plant, force=force or None)
        make_study(what, chosen, console, out=out, cluster=cluster, as_json=as_json)
        return
    options = given(robot=robot, hydrodynamics=hydrodynamics, plant=plant, current=current, seabed=seabed)
    options |= given(noise=noise, duration=duration, faults=tuple(fault) if fault else None)
    if parameters:
        _list_parameters(what, options, console, as_json)
        return
    target = out or default_folder(("campaign", label(what)), options)
    wanted = Campaign(
        scenario=what,
        variations=vary or (),
        runs=100 if runs is None else runs,
        seed=seed,
        sampler=sampler,
        options={name: list(value) if isinstance(value, tuple) else value for name, value in options.items()},
        records=records,
    )
    _require_fit(wanted, force, console)
    _make(wanted, target, cluster, console)
    found = write_report(target, bounds, console)
    if as_json:
        print_json(found)


def _make(wanted: Campaign, target: Path, cluster: dict[str, Any], console: Console) -> None:
    with interruptible(target, console), progress_bar(console) as tell:
        wanted.run(target, progress=tell, **cluster)


def _look(
    folder: Path,
    rerun: int | None,
    against: Path | None,
    out: Path | None,
    bounds: tuple[Bound, ...],
    console: Console,
    as_json: bool,
) -> None:
    if rerun is not None:
        _repeat(folder, rerun, out or folder / "reruns" / f"run-{rerun}", console, as_json)
        return
    if against is not None:
        found = compare_campaigns(folder, against, bounds)
        print_comparison(found, console)
    else:
        found = write_report(folder, bounds, console)
    if as_json:
        print_json(found)


def _repeat(folder: Path, run: int, out: Path, console: Console, as_json: bool) -> None:
    kept = kept_campaign(folder)
    scenario = kept.scenario_of(run)
    values = [{"parameter": name, "value": value} for name, value in kept.work.head(run).items()]
    console.print(table_of(f"run {run}", values, ("parameter", "value")))
    found = run_and_write(scenario, out, console)
    if as_json:
        print_json(found)


def _require_fit(wanted: Campaign, force: bool, console: Console) -> None:
    with console.status("looking over the mission") as status, show_compilation(status.update):
        preflight = wanted.work.base().check()
    require_accepted(preflight, "the mission itself", console, force=force)


def _list_parameters(what: str, options: dict[str, Any], console: Console, as_json: bool) -> None:
    known = available_parameters(build_scenario(what, options)).values()
    rows = [{"parameter": p.name, "unit": p.unit, "meaning": p.meaning} for p in known]
    if as_json:
        print_json(rows)
    else:
        console.print(table_of(f"what can be varied of {what}", rows, ("parameter", "unit", "meaning")))
