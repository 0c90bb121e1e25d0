"""Tell in a bar how far a run is, its phase and what that waits for."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from uvms_ocp.errors import plain_line
from uvms_ocp.progress import progress_bar
from uvms_ocp.robot import Command
from uvms_ocp.sim.loop import Progress

if TYPE_CHECKING:
    from uvms_ocp.scenario.scenario import MissionController, Scenario

_EVERY = 40  # ticks between two looks at the mission
_SILENT = 2.0  # [s] that a run may take without a bar
_WIDTH = 60  # letters, whatever the phase is called


@contextmanager
def run_bar(scenario: Scenario, controller: MissionController, progress: Progress | None) -> Iterator[Progress | None]:
    """Inside what is yielded is told every tick: `progress` if given, or else a bar where somebody looks."""
    form = "{elapsed} |{bar}| {desc}"
    with progress_bar(shown=progress is None, total=scenario.duration, delay=_SILENT, bar_format=form) as bar:

        def show(t: float, command: Command) -> None:
            if round(t / scenario.dt) % _EVERY == 0:
                phase = scenario.mission.all_phases[controller.kinematic.state.phase]
                text = plain_line(f"{phase.name} {phase.title}: {controller.kinematic.pending()}", _WIDTH)
                bar.set_description_str(text.ljust(_WIDTH), refresh=False)
                bar.update(t - bar.n)

        yield progress if bar.disable else show
