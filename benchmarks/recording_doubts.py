"""What is found of recordings that were spoiled: ``python benchmarks/recording_doubts.py``.

Recordings of drawn vehicles are sound; of each, one thing after the other is spoiled by a drawn
amount, and looked at as `check-recording` and `identify` do. What goes wrong stands in
``spoiled/kinds.py``, every doubt in ``spoiled/doubts.py``. Writes recording_doubts.csv and
recording_doubts.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from recording.report import Report, Row, Table, begin, parser_of
from spoiled.doubts import DOUBTS, Doubt, doubt_of
from spoiled.kinds import KINDS
from spoiled.sound import DURATION, sound

from uvms_ocp.identification.calibration import check_settings
from uvms_ocp.identification.data_quality import check_data_quality
from uvms_ocp.identification.recording import Recording
from uvms_ocp.identification.settings import CalibrationSettings, calibrated_robot

ROBOTS = 10
"""Sound recordings."""
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
_Found = set[tuple[str, Doubt]]


def doubts(one: Recording, issues: Callable[[Recording], Sequence[tuple[str, str]]]) -> _Found:
    """Channels with the kinds of doubts about them."""
    return {(name, doubt_of(text)) for name, text in issues(one)}


def checker() -> Callable[[Recording], Sequence[tuple[str, str]]]:
    """All that is looked at before a fit."""
    settings = CalibrationSettings.model_validate({**SETTINGS, "learn": {"added_mass": {}}})
    subject = calibrated_robot(settings, Path())
    return lambda one: [
        (x.channel, x.problem)
        for x in (*check_data_quality(one), *check_settings(subject, settings, one))
    ]


def by_doubt(rows: Sequence[Row], before: Sequence[_Found]) -> list[Row]:
    """What each doubt misses, and where it is raised for nothing."""
    found = list[Row]()
    for doubt in (one for one in DOUBTS if not one.stated):
        meant = [row for row in rows if doubt.says in row["meant"]]
        others = [row for row in rows if doubt.says not in row["meant"]]
        missed = [row for row in meant if doubt.says not in row["about"]]
        found.append(
            {
                "doubt about": doubt.looks_for,
                "n": len(meant),
                "missed [%]": _share(len(missed), len(meant)),
                "found by none [%]": _share(sum(not row["found"] for row in missed), len(meant)),
                "sound [%]": _share(
                    sum(any(one is doubt for _, one in each) for each in before), len(before)
                ),
                "others, same channel [%]": _share(
                    sum(doubt.says in row["about"] for row in others), len(others)
                ),
                "others, false [%]": _share(
                    sum(doubt.says in row["elsewhere"] for row in others), len(others)
                ),
            }
        )
    return found


def by_kind(rows: Sequence[Row]) -> list[Row]:
    """What is found of each kind."""
    return [
        {
            "spoiled": kind.group,
            "how": kind.how,
            "n": len(own),
            "found [%]": _share(sum(row["found"] for row in own), len(own)),
            "doubts beside it": float(np.mean([len(row["elsewhere"]) for row in own])),
        }
        for kind in KINDS
        if (own := [row for row in rows if row["how"] == kind.how])
    ]


def _share(n: int, of: int) -> float:
    return 100.0 * n / max(of, 1)


def main() -> None:
    """Spoil and look."""
    _, run = begin(parser_of(__doc__))
    rng = np.random.default_rng(0)
    rows = list[Row]()
    issues = checker()
    good = sound(rng, 1 if run.quick else ROBOTS)
    before = [doubts(one, issues) for one in good]
    for known, one in zip(before, good, strict=True):
        for kind in KINDS:
            new = doubts(kind.spoil(one, rng), issues) - known
            there = (kind.channel, *_PARTNERS.get(kind.channel, ()))
            about = sorted(doubt.says for name, doubt in new if name in there)
            elsewhere = sorted(doubt.says for name, doubt in new if name not in there)
            rows.append(
                {
                    "recording": one.name,
                    "spoiled": kind.group,
                    "how": kind.how,
                    "channel": kind.channel,
                    "meant": kind.meant,
                    "found": bool(about),
                    "about": about,
                    "elsewhere": elsewhere,
                }
            )
    found = _share(sum(row["found"] for row in rows), len(rows))
    prose = PROSE.format(
        sound=len(good),
        duration=DURATION,
        n=len(rows),
        kinds=len(KINDS),
        found=found,
        missed=100.0 - found,
        false=_share(sum(bool(one) for one in before), len(before)),
        others=_share(
            sum(len(row["elsewhere"]) for row in rows),
            sum(len(row["about"] + row["elsewhere"]) for row in rows),
        ),
        stated=sum(one.stated for one in DOUBTS),
        statements="; ".join(one.looks_for for one in DOUBTS if one.stated),
    )
    form = {"spoiled": "", "how": "", "n": "", "found [%]": ".0f", "doubts beside it": ".2f"}
    kept = dict.fromkeys(("missed [%]", "found by none [%]", "sound [%]"), ".0f")
    rates = {
        "doubt about": "",
        "n": "",
        **kept,
        **dict.fromkeys(("others, same channel [%]", "others, false [%]"), ".1f"),
    }
    name = "recording_doubts"
    title = "Doubts about spoiled recordings"
    tables = [
        Table(rows=by_kind(rows), columns=form),
        Table(rows=by_doubt(rows, before), columns=rates),
    ]
    lists = ("meant", "about", "elsewhere")
    data = [
        {key: "; ".join(value) if key in lists else value for key, value in row.items()}
        for row in rows
    ]
    run.write(Report(name=name, title=title, prose=prose, tables=tables, data={name: data}))


if __name__ == "__main__":
    main()
