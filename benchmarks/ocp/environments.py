"""One environment per peer, in a folder of your choice.

python benchmarks/ocp/environments.py FOLDER
"""

from __future__ import annotations

import subprocess
import sys
import venv
from pathlib import Path

# crocoddyl 3.2.1 crashes with newer versions of pin.
PEERS = {
    "crocoddyl": ("crocoddyl==3.2.1", "pin==4.0.0", "libpinocchio==4.0.0"),
    "drake": ("drake==1.51.1", "pyroboplan==1.3.1"),
}


def interpreter(folder: Path, peer: str) -> Path:
    return folder / peer / "bin" / "python"


def make(folder: Path, peer: str, packages: tuple[str, ...]) -> None:
    python = interpreter(folder, peer)
    if not python.exists():
        venv.create(folder / peer, with_pip=True)
    subprocess.run([str(python), "-m", "pip", "install", "--quiet", *packages], check=True)


if __name__ == "__main__":
    for name, wanted in PEERS.items():
        make(Path(sys.argv[1]), name, wanted)
