"""Weight, size and time unit of a robot, of which tolerances in newtons, newton metres, metres and seconds are
shares: they mean the same to a toy of ten grams and to a machine of ten tonnes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

if TYPE_CHECKING:
    from uvms_ocp.robot.robot import Robot

_GRAVITY = 9.81  # [m/s2] of a weight as a unit, which a model without gravity has, too
_WATER_DENSITY = 1000.0  # [kg/m3]
_LIGHTEST = 1e-9  # [kg] mass of a robot without any


def weight(model: pin.Model) -> float:
    """Return the weight [N] of all moving bodies in air on Earth, whatever gravity the model has."""
    return _GRAVITY * mass(model)


def size(model: pin.Model) -> float:
    """Return the side [m] of a cube of water that is as heavy as all moving bodies, such as 0.25 m for
    15 kg. A fixed base does not count.
    """
    return float(np.cbrt(mass(model) / _WATER_DENSITY))


def time_unit(model: pin.Model) -> float:
    """Return the root of the robot's size over gravity [s], such as 0.16 s for 15 kg: by Froude's
    similarity motions of a robot and of larger ones of its make last as many of these.
    """
    return float(np.sqrt(size(model) / _GRAVITY))


def joint_units(robot: Robot) -> np.ndarray:
    """Return the units (n_joints,) of joints in which their motions compare: 1 rad for one that turns,
    the size [m] of the robot for one that slides.
    """
    units = np.ones(robot.n_joints)
    for joint in robot.joints:
        if joint.slides:
            units[joint.idx_v - robot.n_vehicle] = size(robot.model)
    return units


def joint_strength(robot: Robot) -> np.ndarray:
    """Return the load (n_joints,) [N m or N] that joints are built for: the effort of their motors, and
    at least the weight of the robot with its size as the lever.
    """
    by_weight = weight(robot.model) * size(robot.model) / joint_units(robot)
    effort = np.asarray(robot.limits.effort)
    return np.maximum(by_weight, np.where(np.isfinite(effort), effort, 0.0))


def mass(model: pin.Model) -> float:
    """Return the mass [kg] of all moving bodies, never 0."""
    masses = [float(inertia.mass) for inertia in model.inertias[1:]]
    return max(sum(masses), _LIGHTEST)
