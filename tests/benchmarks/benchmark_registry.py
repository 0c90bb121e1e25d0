"""Every benchmark: what it is called with and which files it writes. A new one is tested by being
listed.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

ROOT = Path(__file__).parents[2]
SCRIPTS = ROOT / "benchmarks"
TOOLS = ("__main__", "peer_environments", "same_numbers")
"""Scripts beside the benchmarks, which record nothing."""


@dataclass(frozen=True, kw_only=True)
class Benchmark:
    """A script, its quick form and its files."""

    script: str
    files: tuple[str, ...]
    """Names of the CSV files; the report has that of the first."""
    option: str = ""
    """Before the folder that it needs, if any, or alone."""
    variable: str = ""
    """Of the environment, with that folder."""
    packages: tuple[str, ...] = ()
    """That are not installed for tests."""

    @property
    def missing(self) -> str:
        """Why it cannot run here; empty where it can."""
        left_out = [package for package in self.packages if find_spec(package) is None]
        if left_out:
            return 'needs pip install "uvms-ocp[mutation]"'
        if not self.variable or os.environ.get(self.variable):
            return ""
        return f"needs a folder: set {self.variable}"

    def words(self, out: Path) -> list[str]:
        """The command line below the interpreter."""
        folder = [word for word in (self.option, os.environ.get(self.variable, "")) if word]
        return [str(SCRIPTS / f"{self.script}.py"), *folder, "--quick", "--out", str(out)]

    def __str__(self) -> str:
        return f"{self.script}{self.option}"


ALONE = tuple(
    Benchmark(script=script, files=(script,))
    for script in (
        "actuator_faults",
        "bluerov_reach",
        "calls",
        "campaign_case1",
        "campaign_overhead",
        "campaign_resume",
        "drawn_exports",
        "drawn_files",
        "drawn_robots",
        "exported_controller",
        "faults",
        "gates",
        "growth",
        "hierarchy",
        "identification_excitation",
        "identification_sensors",
        "identification_simulated",
        "nmpc_levels",
        "notebooks",
        "ocp_missions",
        "ocp_peers",
        "ocp_random_reach",
        "ocp_reach",
        "ocp_scenes",
        "ocp_truth",
        "patrol",
        "payloads",
        "random_missions",
        "recording_doubts",
        "shell",
        "simulation",
        "table2",
        "trajectories",
        "viability",
    )
)
BENCHMARKS = (
    *ALONE,
    Benchmark(script="faults", files=("drawn_faults",), option="--drawn"),
    Benchmark(script="first_answer", files=("first_answer", "first_answer_planners")),
    Benchmark(script="install", files=("install", "install_packages")),
    Benchmark(script="mutation", files=("mutation",), packages=("cosmic_ray", "pytest_cov")),
    Benchmark(
        script="navigation",
        files=("navigation", "navigation_delays", "navigation_mission", "navigation_time"),
    ),
    Benchmark(script="nmpc", files=("nmpc", "nmpc_ticks")),
    Benchmark(script="ocp_priorities", files=("ocp_priorities", "ocp_toys")),
    Benchmark(
        script="hinsdale_replay", files=("hinsdale_replay",), variable="UVMS_OCP_POOL_RECORDINGS"
    ),
    Benchmark(
        script="identification_hinsdale",
        files=("identification_hinsdale", "identification_hinsdale_swings"),
        variable="UVMS_OCP_POOL_RECORDINGS",
    ),
    Benchmark(
        script="identification_tauv",
        files=("identification_tauv",),
        variable="UVMS_OCP_DRIVEN_RECORDINGS",
    ),
    *(
        Benchmark(script=script, files=(script,), option="--peers", variable="UVMS_OCP_PEERS")
        for script in ("hierarchy", "ocp_peers", "trajectories")
    ),
)
"""`UVMS_OCP_POOL_RECORDINGS`, `UVMS_OCP_DRIVEN_RECORDINGS`: folders of recordings.
`UVMS_OCP_PEERS`: folder of `peer_environments.py`."""
