"""One tick of the whole controller as one kernel."""

from __future__ import annotations

from typing import Annotated

from uvms_ocp.control.export.interface import ControllerInputs, ControllerOutputs
from uvms_ocp.control.navigation.watchdog import Freshness
from uvms_ocp.control.velocity.tick.kernels import after, before
from uvms_ocp.control.velocity.tick.layout import TickMemory
from uvms_ocp.functions.kernels.layout import Layout, Sized, Vector
from uvms_ocp.functions.kernels.smooth import Smooth
from uvms_ocp.mission.progress import is_over


class Controller(Layout):
    """All that a controller remembers."""

    tick: TickMemory
    """Of the velocities."""
    solve: Smooth
    """Levels and solver: inputs of the levels, active set -> v, active set, report, residual, quantities, activity."""
    active_set: Annotated[Vector, Sized("n_rows")]
    """(n_rows,) of the tick before."""
    found_set: Annotated[Vector, Sized("n_rows")]
    """(n_rows,) of this one."""
    report: Annotated[Vector, Sized(2)]
    """(2,) code of the solver's `Status`, and iterations."""
    usable: Annotated[list[int], Sized("n_statuses")]
    """(n_statuses,) which of them have a velocity to use."""


def control(c: Controller, given: ControllerInputs, told: ControllerOutputs) -> None:
    """One tick."""
    m = c.tick
    _take_in(m, given)
    before(m)
    told.phase = m.mission.phase
    _solve(c, told)
    after(m)
    _tell(m, told)


def _take_in(m: TickMemory, given: ControllerInputs) -> None:
    m.t = given.t
    for i in range(len(m.q)):
        m.q[i] = given.q[i]
    for i in range(len(m.v)):
        m.v[i] = given.v[i]
    m.altimeter_range = given.altimeter_range
    m.age = given.age
    m.joint_age = given.joint_age
    for k in range(len(m.restriction.level)):
        m.restriction.level[k] = given.trust[k]
        m.restriction.since[k] = given.since[k]


def _solve(c: Controller, told: ControllerOutputs) -> None:
    m, found = c.tick, c.found_set
    v, echo, goals = m.v, m.echo, m.goals.values
    c.solve(
        m.q,
        v,
        m.previous,
        m.change,
        echo,
        goals,
        m.gates,
        c.active_set,
        m.solved,
        found,
        c.report,
        None,
        m.quantities,
        None,
    )
    for i in range(len(c.active_set)):
        c.active_set[i] = c.found_set[i]
    told.status = int(c.report[0])
    m.usable = c.usable[told.status] != 0


def _tell(m: TickMemory, told: ControllerOutputs) -> None:
    blind = m.freshness != Freshness.FRESH or m.restriction.blind
    told.hold = blind
    told.stop = m.freshness == Freshness.LOST or (m.restriction.ended and not m.restriction.climbs)
    told.brakes = m.restriction.joints_held
    told.finished = is_over(m.mission)
    told.freshness = m.freshness
    told.viable_share = m.share
    for i in range(len(m.command)):
        told.v[i] = m.command[i]
    for i in range(len(m.reported)):
        told.quantities[i] = m.reported[i]
