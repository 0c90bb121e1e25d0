"""What the estimator promises and keeps: ``python benchmarks/navigation.py``.

Writes navigation.csv (consistency), navigation_delays.csv, navigation_mission.csv,
navigation_time.csv and navigation.md.
"""

from __future__ import annotations

from dataclasses import dataclass

from estimation.consistency import DELAYS, SPECS, TOGETHER, consistency, late
from estimation.delays import LEVEL, WITH, WITHOUT, delay_table
from estimation.mission import by_part, mission_table, time_table
from recording.report import Report, Table, begin, parser_of
from recording.rows import column

from uvms_ocp.robot.loading import load_robot

PROSE = """
{seeds} truths drawn from the filter's own process model, {duration:g} s each. *NEES* is the squared
error of a part of the state, *NIS* the squared innovation of a channel, both over their own
covariance and per degree of freedom: they should be one. Errors count at times apart by their
correlation time; *least* and *most* hold {together:.0%} for all rows of a table together. Inside:
{inside} of {rows} with readings in time, {late_inside} of {rows} with all of them late.

Delays: root mean square errors of the same truths with a channel late, over those with none
({largest:.2f} at most for position, attitude and altitude with an accelerometer and one channel
late). These truths are slower, above a floor with a slope of {slope:g}: how a rougher one goes on
since a late echo nobody can know. Without an accelerometer nothing tells what the vehicle did since
the newest reading of its velocity: {bound:.0f} mm/s after {dvl:g} s of the driving jerk, which is
the bound of any filter.

Mission: Case 1 with default sensors and noise, whose vehicle is not driven by white jerk; *ratio*
is the mean squared error over the mean variance. One row per seed in `navigation_mission.csv`; here
root mean squares over all seeds.

Time of a tick, of the processor: the whole estimator, readings in and measurement out, and its core
in C alone.
"""
FIGURES = {"of": "", "mean": ".3f", "least": ".3f", "most": ".3f", "n": "", "inside": ""}


@dataclass(frozen=True, kw_only=True, slots=True)
class _Size:
    """How much is drawn and flown."""

    seeds: int
    duration: float
    """[s] of a truth."""
    delay_seeds: int
    delay_duration: float
    """[s] of a truth whose readings are late."""
    missions: int
    plant: str
    mission_duration: float
    """[s]"""
    ticks: int
    """Ticks whose time is taken."""


_FULL = _Size(
    seeds=50,
    duration=20.0,
    delay_seeds=20,
    delay_duration=16.0,
    missions=20,
    plant="dynamic",
    mission_duration=120.0,
    ticks=20_000,
)
_QUICK = _Size(
    seeds=2,
    duration=6.0,
    delay_seeds=2,
    delay_duration=9.0,
    missions=1,
    plant="kinematic",
    mission_duration=2.0,
    ticks=400,
)


def main() -> None:
    """Draw truths, delay readings, fly a mission, and take the time."""
    _, run = begin(parser_of(__doc__))
    size = _QUICK if run.quick else _FULL
    seeds = size.seeds
    duration = size.duration
    robot = load_robot("girona_maris7")
    in_time = consistency(robot, SPECS, seeds=seeds, duration=duration)
    all_late = consistency(robot, late(SPECS, DELAYS), seeds=seeds, duration=duration)
    delays = list[dict[str, object]]()
    for specs in (WITH, WITHOUT):
        seeds_of_delays = range(size.delay_seeds)
        delays += delay_table(robot, specs, seeds=seeds_of_delays, duration=size.delay_duration)
    missions = mission_table(size.missions, plant=size.plant, duration=size.mission_duration)
    times = time_table(robot, ticks=size.ticks)
    one_late = delays[1 : len(DELAYS) + 1]
    ratios = list[float]()
    for name in ("position", "attitude", "altitude"):
        ratios += [float(str(ratio)) for ratio in column(one_late, name)]
    prose = PROSE.format(
        seeds=seeds,
        duration=duration,
        together=TOGETHER,
        inside=_inside(in_time),
        late_inside=_inside(all_late),
        rows=len(in_time),
        largest=max(ratios),
        dvl=DELAYS["linear_velocity"],
        slope=LEVEL.floor_roughness,
        bound=1e3 * LEVEL.jerk * (DELAYS["linear_velocity"] ** 3 / 3) ** 0.5,
    )
    tables = [
        Table(rows=in_time, columns=FIGURES),
        Table(rows=all_late, columns=FIGURES),
        Table(
            rows=delays, columns=dict.fromkeys(delays[0], ".3g") | {"late": "", "accelerometer": ""}
        ),
        Table(
            rows=by_part(missions),
            columns={"of": "", "rms": ".3g", "spread": ".3g", "ratio": ".3g"},
        ),
        Table(rows=times, columns=dict.fromkeys(times[0], ".1f") | {"sensors": ""}),
    ]
    readings = [{"readings": "in time", **row} for row in in_time]
    readings += [{"readings": "late", **row} for row in all_late]
    data = {
        "navigation": readings,
        "navigation_delays": delays,
        "navigation_mission": missions,
        "navigation_time": times,
    }
    run.write(Report(name="navigation", title="Navigation", prose=prose, tables=tables, data=data))


def _inside(rows: list[dict[str, object]]) -> int:
    return sum(bool(row["inside"]) for row in rows)


if __name__ == "__main__":
    main()
