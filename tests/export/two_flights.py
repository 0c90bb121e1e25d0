"""Two robots whose exports are linked into one program, and the C of each that flies it."""

from __future__ import annotations

import subprocess
from pathlib import Path

from tiny_robots import TINY, robot_of, scenario_of

from uvms_ocp.scenario.scenario import Scenario

ROBOTS = {"first": "no joints", "second": "an endless joint"}
"""Robot of each flight."""
GENERATED = ("controller", "initial", "functions", "solver")
"""Files of an export that are its controller."""
_UNIT = """#define main replay_{flight}
#include "{export}_replay.c"
#undef main
int fly_{flight}(const char *recorded);
int fly_{flight}(const char *recorded) {{
  char program[] = "replay", file[512];
  char *words[] = {{program, file, 0}};
  strcpy(file, recorded);
  return replay_{flight}(2, words);
}}
"""


def scenario_of_flight(flight: str) -> Scenario:
    """Half a second of a small robot; kinematic, as that compiles in little time."""
    return scenario_of(robot_of(TINY[ROBOTS[flight]]), "kinematic", duration=0.5)


def write_unit(folder: Path, flight: str, export: str) -> None:
    """Write the file that replays an export, by its name, as a function of the flight."""
    (folder / f"{flight}.c").write_text(_UNIT.format(flight=flight, export=export))


def run(folder: Path, *words: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [str(word) for word in words], cwd=folder, capture_output=True, text=True, timeout=300.0
    )
