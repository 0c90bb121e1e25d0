"""Trajectories: ``python benchmarks/trajectories.py --peers FOLDER``.

FOLDER: of `peer_environments.py`; without it the peer is left out. Writes trajectories.csv and
trajectories.md, one row per figure: problem, solver, quantity, value, target.
"""

from __future__ import annotations

from pathlib import Path

from curves.figure import FORMATS
from curves.gradients import gradient_rows
from curves.plans import CLOSED_FORMS, COAL, plan_rows
from curves.scenes import N_SCENES
from curves.shortest import LONG, SIZES, min_snap_rows, peer_rows
from peer_environments import interpreter
from recording.report import Report, Row, Table, begin, parser_of

REPEATS = 20
PROSE = """
Times of minimum snap are the least of {repeats} calls after one to warm up, for the peer too; times
of plans are of one run per scene. They are by the clock on the wall unless named otherwise. Errors
of gradients and Hessians are the largest differences from central differences, relative to the
largest entry.
"""


def main() -> None:
    """Measure everything."""
    parser = parser_of(__doc__)
    parser.add_argument("--peers", type=Path, metavar="FOLDER")
    arguments, run = begin(parser)
    if run.quick:
        repeats = 1
        longest = LONG
        scenes = 1
    else:
        repeats = REPEATS
        longest = SIZES[-1]
        scenes = N_SCENES
    rows: list[Row] = list(min_snap_rows(repeats, longest))
    peers: dict[str, str] = {}
    if arguments.peers:
        python = interpreter(arguments.peers, "minsnap")
        rows_of_peer, peers["minsnap_trajectories"] = peer_rows(python, repeats)
        rows += rows_of_peer
    rows += gradient_rows()
    rows += plan_rows(scenes, COAL)
    rows += plan_rows(scenes, CLOSED_FORMS)
    table = Table(rows=rows, columns=FORMATS)
    prose = PROSE.format(repeats=repeats)
    run.write(
        Report(name="trajectories", title="Trajectories", prose=prose, tables=[table], peers=peers)
    )


if __name__ == "__main__":
    main()
