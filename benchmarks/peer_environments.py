"""Make the environments of the peers, one each: ``python benchmarks/peer_environments.py FOLDER
[NAME ...]``.

The other benchmarks take that folder as ``--peers FOLDER``.
"""

from __future__ import annotations

import argparse
import subprocess
import venv
from pathlib import Path

PACKAGES = {
    # crocoddyl 3.2.1 crashes with newer versions of pin.
    "crocoddyl": ("crocoddyl==3.2.1", "pin==4.0.0", "libpinocchio==4.0.0", "mim-solvers==0.3.0"),
    "drake": ("drake==1.51.1", "pyroboplan==1.3.1"),
    "pink": (
        "pin-pink==4.4.0",
        "daqp==0.11.0",
        "quadprog==0.1.14",
        "osqp==1.1.3",
        "proxsuite==0.8.0",
        "piqp==0.7.0",
    ),
    "minsnap": ("minsnap_trajectories==0.3.0",),
}


def interpreter(folder: Path, name: str) -> Path:
    """Return the path of the interpreter of an environment."""
    return folder / name / "bin" / "python"


def make(folder: Path, name: str) -> None:
    """Install the packages of that name."""
    python = interpreter(folder, name)
    if not python.exists():
        venv.create(folder / name, with_pip=True)
    subprocess.run([str(python), "-m", "pip", "install", "--quiet", *PACKAGES[name]], check=True)


def main() -> None:
    """All environments, or those that are named."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument(
        "names", nargs="*", metavar="NAME", help=f"of {', '.join(PACKAGES)}; default: all"
    )
    arguments = parser.parse_args()
    for name in arguments.names or PACKAGES:
        if name not in PACKAGES:
            parser.error(f"unknown environment {name!r}; give some of {', '.join(PACKAGES)}")
        make(arguments.folder, name)


if __name__ == "__main__":
    main()
