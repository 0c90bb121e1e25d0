"""Count what a robot, its sensors and its mission have: the sizes of all memory of kernels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from uvms_ocp.codegen.kernel_layout import NOT_COUNTED
from uvms_ocp.robot.channels import CHANNELS, LARGEST_OWN, Channel
from uvms_ocp.robot.robot import Robot


@dataclass(frozen=True, kw_only=True, slots=True)
class Dimensions:
    """Sizes by the names that arrays in layouts are declared with; `structure_of` reads those that
    a layout needs.

    `dimensions_of` makes it for a robot and its sensors; missions, limits and distances add theirs
    (`with_phases`, `with_guards`, ...). A layout that needs what nobody counted is refused.
    """

    n_q: int = NOT_COUNTED
    """Numbers in a configuration."""
    n_v: int = NOT_COUNTED
    """Numbers in a velocity."""
    n_vehicle: int = NOT_COUNTED
    """Of them, those of the vehicle: 6, or 0 on a fixed base."""
    n_joints: int = NOT_COUNTED
    """Of them, those of the joints."""
    n_joint_positions: int = NOT_COUNTED
    """Numbers in the joints' part of a configuration."""
    n_thrusters: int = NOT_COUNTED
    """Thrusters of the vehicle."""

    n_channels: int = len(CHANNELS)
    """Channels of sensors: the toolkit's, then a user's own."""

    n_tasks: int = NOT_COUNTED
    """Tasks of the hierarchy."""
    n_phases: int = NOT_COUNTED
    """Phases of the mission, with that of an abort."""
    n_transitions: int = NOT_COUNTED
    """Transitions of all phases."""
    n_conditions: int = NOT_COUNTED
    """Conditions of all transitions."""
    n_quantities: int = NOT_COUNTED
    """Quantities that tasks measure and conditions read, at every tick."""
    n_needed_channels: int = NOT_COUNTED
    """Channels of sensors that tasks rest on."""
    n_parameters: int = NOT_COUNTED
    """Numbers in the goals of all tasks."""
    n_tracks: int = NOT_COUNTED
    """Goals that move along a table of samples."""
    n_table: int = NOT_COUNTED
    """Room for the samples of all tables."""

    n_limits: int = NOT_COUNTED
    """Limits of positions that a stop has to keep."""
    n_positions: int = NOT_COUNTED
    """Numbers that these limit."""
    n_distances: int = NOT_COUNTED
    """Models of shapes whose distances they limit and machine code measures."""
    n_asking: int = NOT_COUNTED
    """Tasks that ask for the nearest pairs of shapes."""
    n_asked_pairs: int = NOT_COUNTED
    """Pairs that each of them asks for at most."""
    n_solids: int = NOT_COUNTED
    """Room for shapes in a model."""
    n_pairs: int = NOT_COUNTED
    """Room for pairs of shapes in a model."""
    n_axes: int = NOT_COUNTED
    """Axes of motion of that model, those that mimic another counted for themselves."""
    n_placements: int = NOT_COUNTED
    """Numbers in the placements of all joints of that model."""

    @property
    def n_joint_states(self) -> int:
        """Positions and rates of the joints."""
        return 2 * self.n_joints

    @property
    def n_commanded(self) -> int:
        """Axes of a vehicle that is free, and of the joints."""
        return 6 + self.n_joints

    @property
    def n_width(self) -> int:
        """Numbers in a reading of a sensor at most: a quaternion, or the joints."""
        return max(4, self.n_joint_positions)

    @property
    def n_own_rows(self) -> int:
        """Numbers in readings of all channels of a user's own at most."""
        return LARGEST_OWN * (self.n_channels - len(CHANNELS))

    @property
    def n_own_joint_entries(self) -> int:
        """Derivatives of these with respect to the positions of the joints."""
        return self.n_own_rows * self.n_joints

    @property
    def n_tilted(self) -> int:
        """Numbers in a configuration, and in a pose at least."""
        return max(self.n_q, 7)

    @property
    def n_twists(self) -> int:
        """Numbers in the unit twists of all axes of a model of shapes."""
        return 6 * self.n_axes


def dimensions_of(robot: Robot, own: Sequence[Channel] = ()) -> Dimensions:
    """Count what a robot has; own: channels of a user's own among its sensors."""
    return Dimensions(
        n_q=robot.n_q,
        n_v=robot.n_v,
        n_vehicle=robot.n_vehicle,
        n_joints=robot.n_joints,
        n_joint_positions=robot.joint_q.stop - robot.joint_q.start,
        n_thrusters=len(robot.description.thrusters),
        n_channels=len(CHANNELS) + len(own),
    )
