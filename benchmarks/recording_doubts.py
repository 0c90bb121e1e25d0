"""What is found of recordings that were spoiled: ``python benchmarks/recording_doubts.py``.

Recordings of drawn vehicles are sound; of each, one thing after the other is spoiled by a drawn
amount, and looked at as `check-recording` and `identify` do. Then drawn pairs of things are spoiled
at once. What goes wrong stands in ``spoiled/kinds.py``, every doubt in ``spoiled/doubts.py``.
Writes recording_doubts.csv, recording_doubts_pairs.csv and recording_doubts.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from recording.report import Report, Row, Table, begin, parser_of
from recording.rows import column, rows_where
from spoiled.doubts import DOUBTS, Doubt, doubt_of
from spoiled.kinds import KINDS, Kind
from spoiled.sound import DURATION, sound

from uvms_ocp.identification.calibration_robot import calibrated_robot
from uvms_ocp.identification.data_quality import check_data_quality
from uvms_ocp.identification.recording import Recording
from uvms_ocp.identification.settings import CalibrationSettings
from uvms_ocp.identification.settings_checks import check_settings

ROBOTS = 10
"""Sound recordings."""
PAIRS = 400
"""Recordings that two things are spoiled of, unless ``--pairs`` says how many."""
SETTINGS = {
    "robot": "bluerov2_alpha5",
    "arm": "taken off",
    "hull": [[-0.25, -0.2, -0.15], [0.25, 0.2, 0.15]],
}
PROSE = """
{sound} sound recordings of {duration:g} s of drawn vehicles with an arm, driven by random steps of
thrust, and {n} spoiled ones, each by one of {kinds} kinds. A spoiled one is found where a doubt is
about the channel that is wrong, or about the one that it is compared with, and the sound recording
has none like it. {found:.1f} % are found, {missed:.1f} % missed. Of the sound recordings
{false:.1f} % raise a doubt, and {others:.1f} % of the doubts about spoiled ones are about channels
that are sound.

In the second table, by doubt: of the spoiled recordings that it is meant to find those that it
misses, and those of them that no other doubt finds either; of the sound ones those about which it
is raised; and of those that are spoiled in another way, those where it is raised about the channel
that is wrong (the same fault by another name, or one that follows from it), and about channels that
are sound, which alone is false. {stated} more doubts state what a file, or the settings of a fit,
say themselves: {statements}.

In the third table, of {pairs} recordings two things of different kinds are spoiled at once, both
drawn: by the group of the first and how many of the two are found, each as above. Of none of the
two is anything said in {silent:.1f} %; those stand below it.
"""
_PARTNERS: Mapping[str, tuple[str, ...]] = {
    "linear_velocity": ("position", "attitude"),
    "position": ("linear_velocity",),
    "attitude": ("angular_velocity", "linear_velocity", "specific_force", "position"),
    "angular_velocity": ("attitude",),
    "specific_force": ("attitude",),
    "joint_positions": ("joint_velocities",),
    "joint_velocities": ("joint_positions",),
}
_Doubts = set[tuple[str, Doubt]]


def doubts(
    recording: Recording, issues: Callable[[Recording], Sequence[tuple[str, str]]]
) -> _Doubts:
    """Channels with the kinds of doubts about them."""
    return {(name, doubt_of(text)) for name, text in issues(recording)}


def checker() -> Callable[[Recording], Sequence[tuple[str, str]]]:
    """All that is looked at before a fit."""
    settings = CalibrationSettings.model_validate({**SETTINGS, "learn": {"added_mass": {}}})
    subject = calibrated_robot(settings, Path())

    def issues(recording: Recording) -> list[tuple[str, str]]:
        problems = [*check_data_quality(recording), *check_settings(subject, settings, recording)]
        return [(issue.channel, issue.problem) for issue in problems]

    return issues


def by_doubt(rows: Sequence[Row], before: Sequence[_Doubts]) -> list[Row]:
    """Count what each doubt misses, and where it is raised for nothing."""
    return [_row_of_doubt(doubt, rows, before) for doubt in DOUBTS if not doubt.stated]


def _row_of_doubt(doubt: Doubt, rows: Sequence[Row], before: Sequence[_Doubts]) -> Row:
    """Count what a doubt misses of what it is meant to find, and where else it is raised."""
    n_meant = 0
    n_missed = 0
    n_found_by_none = 0
    n_same_channel = 0
    n_elsewhere = 0
    for row in rows:
        is_raised = doubt.says in row["about"]
        if doubt.says in row["meant"]:
            n_meant += 1
            n_missed += not is_raised
            n_found_by_none += not is_raised and not row["found"]
        else:
            n_same_channel += is_raised
            n_elsewhere += doubt.says in row["elsewhere"]
    n_others = len(rows) - n_meant
    n_sound = 0
    for doubts_about_recording in before:
        n_sound += any(raised is doubt for _, raised in doubts_about_recording)
    return {
        "doubt about": doubt.looks_for,
        "n": n_meant,
        "missed [%]": _share(n_missed, n_meant),
        "found by none [%]": _share(n_found_by_none, n_meant),
        "sound [%]": _share(n_sound, len(before)),
        "others, same channel [%]": _share(n_same_channel, n_others),
        "others, false [%]": _share(n_elsewhere, n_others),
    }


def by_kind(rows: Sequence[Row]) -> list[Row]:
    """Count what is found of each kind."""
    table = list[Row]()
    for kind in KINDS:
        spoiled = rows_where(rows, "how", kind.how)
        if not spoiled:
            continue
        n_elsewhere = sum(map(len, column(spoiled, "elsewhere")))
        table.append(
            {
                "spoiled": kind.group,
                "how": kind.how,
                "n": len(spoiled),
                "found [%]": _share(sum(column(spoiled, "found")), len(spoiled)),
                "doubts beside it": n_elsewhere / len(spoiled),
            }
        )
    return table


def _share(n: int, of: int) -> float:
    return 100.0 * n / max(of, 1)


def spoiled_pairs(
    n: int,
    recordings: Sequence[Recording],
    before: Sequence[_Doubts],
    issues: Callable[[Recording], Sequence[tuple[str, str]]],
    rng: np.random.Generator,
) -> list[Row]:
    """Spoil two things at once n times, both and the recording drawn; one row for each."""
    rows = list[Row]()
    while len(rows) < n:
        k = int(rng.integers(len(recordings)))
        first, second = (KINDS[i] for i in rng.choice(len(KINDS), 2, replace=False))
        try:
            spoiled = second.spoil(first.spoil(recordings[k], rng), rng)
        except KeyError:  # the first has left out a channel that the second spoils
            continue
        raised = doubts(spoiled, issues) - before[k]
        found = [_row_of(recordings[k], kind, raised)["found"] for kind in (first, second)]
        rows.append(
            {
                "recording": recordings[k].name,
                "first": f"{first.group}: {first.how}",
                "second": f"{second.group}: {second.how}",
                "group": first.group,
                "n_found": sum(found),
                "raised": "; ".join(sorted({doubt.says for _, doubt in raised})),
            }
        )
    return rows


def by_group(pairs: Sequence[Row]) -> list[Row]:
    """Count, by the group of the first, how many things of a pair are found."""
    table = list[Row]()
    for group in dict.fromkeys(column(pairs, "group")):
        rows = rows_where(pairs, "group", group)
        counts = column(rows, "n_found")
        table.append(
            {
                "first of a pair": group,
                "n": len(rows),
                "both [%]": _share(counts.count(2), len(rows)),
                "one [%]": _share(counts.count(1), len(rows)),
                "none [%]": _share(counts.count(0), len(rows)),
                "silent": sum(not row["raised"] for row in rows),
            }
        )
    return table


def main() -> None:
    """Spoil and look."""
    parser = parser_of(__doc__)
    parser.add_argument("--pairs", type=int, default=PAIRS, metavar="N", help="pairs of faults")
    options, run = begin(parser)
    rng = np.random.default_rng(0)
    issues = checker()
    recordings = sound(rng, 1 if run.quick else ROBOTS)
    before = [doubts(recording, issues) for recording in recordings]
    rows = list[Row]()
    for recording, doubts_before in zip(recordings, before, strict=True):
        for kind in KINDS:
            raised = doubts(kind.spoil(recording, rng), issues) - doubts_before
            rows.append(_row_of(recording, kind, raised))
    n_pairs = 4 if run.quick else options.pairs
    pairs = spoiled_pairs(n_pairs, recordings, before, issues, rng)
    silent = [row for row in pairs if not row["raised"]]
    name = "recording_doubts"
    by_kind_columns = {
        "spoiled": "",
        "how": "",
        "n": "",
        "found [%]": ".0f",
        "doubts beside it": ".2f",
    }
    by_doubt_columns = {
        "doubt about": "",
        "n": "",
        "missed [%]": ".0f",
        "found by none [%]": ".0f",
        "sound [%]": ".0f",
        "others, same channel [%]": ".1f",
        "others, false [%]": ".1f",
    }
    by_group_columns = {
        "first of a pair": "",
        "n": "",
        "both [%]": ".1f",
        "one [%]": ".1f",
        "none [%]": ".1f",
        "silent": "",
    }
    tables = [
        Table(rows=by_kind(rows), columns=by_kind_columns),
        Table(rows=by_doubt(rows, before), columns=by_doubt_columns),
        Table(rows=by_group(pairs), columns=by_group_columns),
    ]
    if silent:
        tables.append(Table(rows=silent, columns={"recording": "", "first": "", "second": ""}))
    run.write(
        Report(
            name=name,
            title="Doubts about spoiled recordings",
            prose=_prose(rows, before, pairs),
            tables=tables,
            data={name: list(map(_with_joined_lists, rows)), f"{name}_pairs": pairs},
        )
    )


def _row_of(recording: Recording, kind: Kind, raised: _Doubts) -> Row:
    """Sort the doubts that a spoiled recording raises and the sound one does not, by whether they
    are about the channel that is wrong.
    """
    channels = (kind.channel, *_PARTNERS.get(kind.channel, ()))
    about = []
    elsewhere = []
    for name, doubt in raised:
        if name in channels:
            about.append(doubt.says)
        else:
            elsewhere.append(doubt.says)
    return {
        "recording": recording.name,
        "spoiled": kind.group,
        "how": kind.how,
        "channel": kind.channel,
        "meant": kind.meant,
        "found": bool(about),
        "about": sorted(about),
        "elsewhere": sorted(elsewhere),
    }


def _prose(rows: Sequence[Row], before: Sequence[_Doubts], pairs: Sequence[Row]) -> str:
    found_share = _share(sum(column(rows, "found")), len(rows))
    n_about = sum(map(len, column(rows, "about")))
    n_elsewhere = sum(map(len, column(rows, "elsewhere")))
    n_doubted_sound = sum(map(bool, before))
    stated = [doubt.looks_for for doubt in DOUBTS if doubt.stated]
    return PROSE.format(
        sound=len(before),
        duration=DURATION,
        n=len(rows),
        kinds=len(KINDS),
        found=found_share,
        missed=100.0 - found_share,
        false=_share(n_doubted_sound, len(before)),
        others=_share(n_elsewhere, n_about + n_elsewhere),
        stated=len(stated),
        statements="; ".join(stated),
        pairs=len(pairs),
        silent=_share(sum(not row["raised"] for row in pairs), len(pairs)),
    )


def _with_joined_lists(row: Row) -> Row:
    """Return a row whose lists are texts, as a file has them."""
    joined = dict(row)
    for name in ("meant", "about", "elsewhere"):
        joined[name] = "; ".join(row[name])
    return joined


if __name__ == "__main__":
    main()
