"""Memory of one tick of the velocity layer: its layout, its first values and its arrays."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Any

import casadi as ca
import numpy as np

from uvms_ocp.codegen.kernel_layout import (
    FunctionField,
    Layout,
    Sized,
    Vector,
    assign,
    structure_of,
)
from uvms_ocp.control.velocity import (
    abort,
    ascent,
    distances,
    jerk_limit,
    levels,
    speed_limit,
    swing,
    viability,
)
from uvms_ocp.control.velocity.goals import GoalsMemory
from uvms_ocp.estimation.degraded_modes import ALTIMETER, RestrictionMemory, write_modes
from uvms_ocp.estimation.fallbacks import AltimeterMemory, LastValidMemory, Watchdog, beam_function
from uvms_ocp.mission.mission import Mission, write_mission
from uvms_ocp.mission.progress import MissionMemory, with_phases
from uvms_ocp.robot.channels import CHANNELS
from uvms_ocp.robot.dimensions import Dimensions
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.thrusters import largest_wrench
from uvms_ocp.tasks.task import Task


class TickMemory(Layout):
    """All that a tick reads and remembers."""

    mission: MissionMemory
    """Phase of the mission, and since when."""
    phase: int
    """Phase of the mission at the beginning of the tick."""
    distress: abort.AbortMemory
    """Reasons to give the mission up."""
    rule: viability.ViabilityMemory
    """Limits on positions."""
    restriction: RestrictionMemory
    """Restriction by channels that cannot be trusted."""
    speed_limit: speed_limit.SpeedLimitMemory
    """Limits on the speed."""
    sound: LastValidMemory
    """Replacement of an estimate that is not sound."""
    beam: AltimeterMemory
    """Beam of the altimeter."""
    lowest: FunctionField
    """Function of q that gives `height`."""
    height: Annotated[Vector, Sized(1)]
    """(1,) [m] z in W of the lowest of hull, joints and tools, over a floor that falls from below
    the altimeter on.
    """
    ascent: ascent.AscentMemory
    """Goal of the climb in the abort phase."""
    goals: GoalsMemory
    """Parameters of the tasks, an input of the levels."""
    nearest: distances.NearestMemory
    """Distances among the parameters of the tasks."""

    velocity_limit: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] velocity limits, infinite along axes that no thruster or motor drives."""
    reads_altitude: Annotated[list[int], Sized("n_tasks")]
    """(n_tasks,) 1 for tasks that read the altimeter."""
    lands: Annotated[list[int], Sized("n_tasks")]
    """(n_tasks,) 1 for tasks that ask for one altitude."""
    rest_altitude: Annotated[Vector, Sized("n_tasks")]
    """(n_tasks,) [m] altitude at which tasks that read the altimeter let nothing sink before the
    first echo.
    """
    rests_on: Annotated[list[list[int]], Sized("n_needed_channels", "n_quantities")]
    """(n_channels, n_quantities) 1 where a quantity is unknown without the channel."""
    channel: Annotated[list[int], Sized("n_needed_channels")]
    """(n_channels,) index of each channel of `rests_on` among all `CHANNELS`."""
    altimeter: int
    """Index of the altimeter among these channels."""
    hold_after: float
    """[s] age of the estimate from which on the robot comes to rest, `Watchdog.hold_after`."""
    stop_after: float
    """[s] age of the estimate from which on there is no thrust, `Watchdog.stop_after`."""

    t: float
    """[s] time of the tick."""
    q: Annotated[Vector, Sized("n_q")]
    """(n_q,) [m, rad] estimate; where that is not sound, the last one that was."""
    v: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] estimate; where that is not sound, the last one that was."""
    altimeter_range: float
    """[m] NaN without an echo."""
    age: float
    """[s] age of the oldest reading that the estimate rests on."""
    joint_age: float
    """[s] age of the encoders' readings."""

    # found by `before`, inputs of the levels among it
    gates: Annotated[Vector, Sized("n_tasks")]
    """(n_tasks,) external activations."""
    altitude_matters: bool
    """A task that is on reads the altimeter."""
    echo: Annotated[Vector, Sized(1)]
    """(1,) [m] range that tasks act on."""
    altitude_valid: bool
    """True where an echo supports the altitude, of now or of not too long ago."""
    echo_is_oldest: bool
    """The altimeter's reading is the oldest that is needed."""
    oldest: float
    """[s] age of the oldest reading that is needed."""
    freshness: int
    """`Freshness` of the estimate, by its code."""
    awaits_first: bool
    """No estimate has had a reading of all that it needs yet."""
    holds: bool
    """The robot comes to rest, whatever the tasks want."""
    swings: Annotated[list[int], Sized(3)]
    """(3,) rotations of the vehicle that no thruster drives, and that swing."""
    swing_memory: float
    """[s] time constant with which the mean of these is learnt."""
    lift: float
    """[N] largest upward force of all thrusters."""
    passive: Annotated[Vector, Sized(swing.N_PASSIVE)]
    """(4,) [rad, N] turn from the mean attitude, and unknown weight at the tool: see `N_PASSIVE`."""
    is_joint: Annotated[list[int], Sized("n_v")]
    """(n_v,) 1 for axes of joints."""
    faster: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] speed by which joints have lately exceeded their commands."""
    previous: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] commanded in the last tick, at full pace."""
    change: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] difference of that velocity from the one before it, without changes of
    pace, which are not to be smoothed.
    """

    # of the hierarchy
    solved: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] solution of the hierarchy."""
    usable: bool
    """The hierarchy has a solution."""
    quantities: Annotated[Vector, Sized("n_quantities")]
    """(n_quantities,) [their units] quantities as the levels function gives them."""

    # found by `after`
    reported: Annotated[Vector, Sized("n_quantities")]
    """(n_quantities,) [their units] quantities as reported, NaN where not known."""
    phase_quantities: Annotated[Vector, Sized("n_quantities")]
    """(n_quantities,) [their units] quantities that transitions read."""
    last_phase_quantities: Annotated[Vector, Sized("n_quantities")]
    """(n_quantities,) [their units] quantities that transitions read, of the last tick that did not
    hold.
    """
    why: int
    """`AbortReason` of the mission's end, as a number."""
    due: int
    """The transition of the phase that fires, or `NONE`."""
    eventful: bool
    """True where Python has to look at the mission: a phase or the mission ends."""
    jammed: Annotated[list[int], Sized("n_v")]
    """(n_v,) axes that do not move whatever is asked."""
    wanted: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] the velocity for this tick."""
    wanted_pace: float
    """Share of the hierarchy's speed, in (0, 1], that it is at."""
    near: bool
    """True where a stop from the wanted velocity could come to a limit on positions."""
    share: float
    """Share of the wanted velocity that the limits on positions leave; 0 where the robot comes to
    rest.
    """

    # the motion of the last tick
    place: Annotated[Vector, Sized("n_q")]
    """(n_q,) [m, rad] configuration as far as it is known: estimated, or along the stop since."""
    command: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] the last velocity that was taken."""
    pace: float
    """Pace of that velocity."""


def tick_memory(
    robot: Robot,
    mission: Mission,
    problem: levels.LevelsProblem,
    watchdog: Watchdog,
    dimensions: Dimensions,
    functions: Mapping[str, ca.Function],
) -> TickMemory:
    """Make a `TickMemory` at rest, before the first estimate; its monitor of aborts, echoes, limits
    and goals are still to be set up.

    dimensions: of the robot, its limits, tracks and distances, to which those of the mission come.
    functions: of these limits and distances.
    """
    tasks = mission.hierarchy.tasks
    names = problem.quantity_names
    altimeter = altimeter_of(robot, tasks)
    memory = structure_of(
        TickMemory,
        replace(
            with_phases(dimensions, mission.all_phases, len(tasks)),
            n_quantities=len(names),
            n_needed_channels=len(problem.rests_on),
            n_parameters=problem.function.size1_in("parameters"),
        ),
        look=beam_function(robot, altimeter),
        **ascent.ascent_functions(robot, mission, altimeter),
        **functions,
    )()
    write_mission(memory.mission, mission, names)
    write_modes(memory.restriction)
    memory.ascent.altitude = math.nan if mission.abort is None else mission.abort.altitude
    is_joint = np.arange(robot.n_v) >= robot.n_vehicle
    assign(
        memory.speed_limit, step=problem.step, is_joint=is_joint, has_vehicle=bool(robot.n_vehicle)
    )
    assign(
        memory,
        hold_after=watchdog.hold_after,
        stop_after=watchdog.stop_after,
        pace=1.0,
        near=True,
        awaits_first=True,
        place=robot.configuration(),
        last_phase_quantities=math.nan,
        velocity_limit=robot.limits.velocity + jerk_limit.unlimited_axes(robot),
        is_joint=is_joint,
        altimeter=[*problem.rests_on].index(ALTIMETER),
        channel=[CHANNELS.index(channel) for channel in problem.rests_on],
        rests_on=[*problem.rests_on.values()],
        reads_altitude=[task.needs_altimeter for task in tasks],
        rest_altitude=[task.rest_altitude for task in tasks],
        swings=[axis in swing.swinging_axes(robot) for axis in (3, 4, 5)],
        swing_memory=swing.memory_time(robot),
        lift=float(largest_wrench(robot)[2]) if robot.description.thrusters else 0.0,
        lands=[task.needs_altimeter and task.equality for task in tasks],
    )
    return memory


def inputs_of(tick: Any, goals: Any) -> tuple[np.ndarray, ...]:
    """Return the inputs of the levels function, in its order; tick, goals: `arrays_of` a
    `TickMemory` and of its goals.
    """
    return (
        tick.q,
        tick.v,
        tick.passive,
        tick.previous,
        tick.change,
        tick.echo,
        goals.values,
        tick.gates,
    )


def altimeter_of(robot: Robot, tasks: Sequence[Task]) -> str | None:
    """Return the frame that tasks on altitude name, or that of the robot's file."""
    for task in tasks:
        frame: str | None = getattr(task, "frame", None)
        if task.needs_altimeter and frame:
            return frame
    return robot.description.altimeter
