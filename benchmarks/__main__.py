"""What README claims, by the files that hold it, and the commands that measure it anew.

    python -m benchmarks                            the table, from what is recorded
    python -m benchmarks NAME ... --peers FOLDER    run these benchmarks, for minutes each;
                                                    all: every one of the table
    python -m benchmarks --into README.md           write the table there

The peers' environments: python benchmarks/peer_environments.py FOLDER
"""

from __future__ import annotations

import argparse
import csv
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent
_TABLE = re.compile(r"\| what, measured \|.*?(?=\n\n)", re.DOTALL)


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One number in a file of results."""

    where: dict[str, str]
    """Values of columns that only its row has."""
    column: str

    def read(self, script: str) -> float:
        """Raises `LookupError` unless one row alone is meant."""
        path = ROOT / "results" / f"{script}.csv"
        with path.open(encoding="utf-8", newline="") as file:
            lines = (line for line in file if not line.startswith("#"))
            rows = [row for row in csv.DictReader(lines) if self.where.items() <= row.items()]
        if len(rows) != 1:
            raise LookupError(f"{script}.csv: {len(rows)} rows with {self.where}; one is wanted")
        return float(rows[0][self.column])


def _digits(value: float) -> str:
    return f"{value:.3g}" if value < 1000.0 else f"{value:,.0f}"


@dataclass(frozen=True, kw_only=True)
class Claim:
    """Our number beside a peer's."""

    label: str
    unit: str
    script: str
    """The benchmark that measures both, one after the other, on one machine."""
    ours: Cell
    peer: str
    """Name of the peer; README tells below the table how its problem differs."""
    theirs: Cell

    def line(self) -> str:
        """A row of the table."""
        ours = f"{_digits(self.ours.read(self.script))} {self.unit}"
        theirs = f"{_digits(self.theirs.read(self.script))} {self.unit}"
        return f"| {self.label} | {ours} | {self.peer} | {theirs} | `{self.script}.md` |"


def _processor_time(**where: str) -> Cell:
    """Refer to the processor time [ms] of a row of optimal control beside its peers."""
    return Cell(where=where, column="cpu_ms")


_STAGEWISE = "Gauss-Newton, 1e-06, compiled"
CLAIMS = (
    Claim(
        label="a tick of Case 1: kinematics and solver",
        unit="us",
        script="hierarchy",
        ours=Cell(where={"problem": "whole tick", "solver": "active set in C"}, column="p50_us"),
        peer="pink with quadprog",
        theirs=Cell(
            where={"problem": "whole tick", "solver": "pink (quadprog), weights"}, column="p50_us"
        ),
    ),
    Claim(
        label="strict levels, 80 unknowns, 253 rows",
        unit="us",
        script="hierarchy",
        ours=Cell(
            where={"problem": "random, grown, n=80", "solver": "active set in C"}, column="p50_us"
        ),
        peer="LexLS",
        theirs=Cell(
            where={"problem": "random, grown, n=80", "solver": "LexLS, native"}, column="p50_us"
        ),
    ),
    Claim(
        label="minimum snap through 100 pieces",
        unit="ms",
        script="trajectories",
        ours=Cell(
            where={"problem": "min snap 100 x 3", "solver": "banded", "quantity": "time [ms]"},
            column="value",
        ),
        peer="minsnap_trajectories",
        theirs=Cell(
            where={"problem": "min snap 100 x 3", "solver": "minsnap_trajectories"}, column="value"
        ),
    ),
    Claim(
        label="optimal control without limits",
        unit="ms",
        script="ocp_peers",
        ours=_processor_time(
            problem="shooting, N = 40", solver="uvms_ocp stagewise", setting=_STAGEWISE
        ),
        peer="crocoddyl",
        theirs=_processor_time(problem="shooting, N = 40", solver="crocoddyl FDDP"),
    ),
    Claim(
        label="optimal control within hard limits",
        unit="ms",
        script="ocp_peers",
        ours=_processor_time(
            problem="limited, N = 40", solver="uvms_ocp stagewise", setting=_STAGEWISE
        ),
        peer="mim-solvers",
        theirs=_processor_time(problem="limited, N = 40", solver="mim-solvers CSQP"),
    ),
    Claim(
        label="quickest motion of an arm",
        unit="ms",
        script="ocp_peers",
        ours=_processor_time(
            problem="quickest",
            solver="uvms_ocp stagewise",
            setting="N = 20, exact, 1e-06, compiled",
        ),
        peer="Drake with SNOPT",
        theirs=_processor_time(
            problem="quickest", solver="Drake KTO", setting="SNOPT, 24 control points"
        ),
    ),
)
SCRIPTS = tuple(dict.fromkeys(claim.script for claim in CLAIMS))


def table() -> str:
    """All claims in Markdown."""
    columns = ("what, measured", "uvms_ocp", "peer", "peer's time", "in `benchmarks/results/`")
    head = f"| {' | '.join(columns)} |"
    rule = "|---" * len(columns) + "|"
    return "\n".join((head, rule, *(claim.line() for claim in CLAIMS)))


def written_into(text: str) -> str:
    """A text whose table is the one of today."""
    return _TABLE.sub(lambda match: table(), text)


def run(names: list[str], options: list[str]) -> int:
    """The exit code of the first benchmark that fails, or 0."""
    for name in SCRIPTS if names == ["all"] else names:
        words = [sys.executable, str(ROOT / f"{name}.py"), *options]
        sys.stderr.write(f"{' '.join(words[1:])}\n")
        code = subprocess.run(words, check=False).returncode
        if code:
            return code
    return 0


def main() -> int:
    """Print, run or write."""
    parser = argparse.ArgumentParser(
        "python -m benchmarks",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"all, or of {', '.join(SCRIPTS)}")
    parser.add_argument("--peers", type=Path, metavar="FOLDER", help="of the peers' environments")
    parser.add_argument("--into", type=Path, metavar="FILE", help="whose table is to be replaced")
    parser.add_argument(
        "--out",
        type=Path,
        metavar="PATH",
        help="folder of the files, instead of benchmarks/results",
    )
    parser.add_argument(
        "--quick", action="store_true", help="little work, to see that it runs; needs --out"
    )
    arguments = parser.parse_args()
    unknown = set(arguments.names) - {"all", *SCRIPTS}
    if unknown:
        parser.error(f"unknown: {', '.join(sorted(unknown))}; give all, or of {', '.join(SCRIPTS)}")
    options = []
    if arguments.peers:
        options += ["--peers", str(arguments.peers)]
    if arguments.out:
        options += ["--out", str(arguments.out)]
    if arguments.quick:
        options.append("--quick")
    if arguments.names:
        code = run(arguments.names, options)
        if code:
            return code
    if arguments.into:
        text = arguments.into.read_text(encoding="utf-8")
        arguments.into.write_text(written_into(text), encoding="utf-8")
    sys.stdout.write(f"{table()}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
