"""One registry of kinematic trees: every symbolic algorithm is tested on each."""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import distribution

import casadi as ca
import numpy as np
import pinocchio as pin

from uvms_ocp.robot.loading import list_robots, load_robot

_SKEWED = np.array([1.0, -2.0, 3.0]) / np.sqrt(14.0)

_TYPES: dict[str, Callable[[], pin.JointModel]] = {
    "free_flyer": pin.JointModelFreeFlyer,
    "planar": pin.JointModelPlanar,
    "revolute_x": pin.JointModelRX,
    "revolute_y": pin.JointModelRY,
    "revolute_z": pin.JointModelRZ,
    "revolute_unaligned": lambda: pin.JointModelRevoluteUnaligned(_SKEWED),
    "unbounded_x": pin.JointModelRUBX,
    "unbounded_y": pin.JointModelRUBY,
    "unbounded_z": pin.JointModelRUBZ,
    "prismatic_x": pin.JointModelPX,
    "prismatic_y": pin.JointModelPY,
    "prismatic_z": pin.JointModelPZ,
    "prismatic_unaligned": lambda: pin.JointModelPrismaticUnaligned(_SKEWED),
}

_ARMS = {
    "panda": "panda_description/urdf/panda.urdf",
    "kinova": "kinova_description/robots/kinova.urdf",
    "ur5": "ur_description/urdf/ur5_robot.urdf",
}


def function_of(expression: Callable[..., ca.SX | tuple[ca.SX, ...]], *sizes: int) -> ca.Function:
    """The expression as a function of columns of these sizes."""
    columns = [ca.SX.sym(f"x{k}", size) for k, size in enumerate(sizes)]
    values = expression(*columns)
    return ca.Function(
        "f",
        columns,
        [ca.densify(value) for value in (values if isinstance(values, tuple) else (values,))],
    )


def built_model(*joint_types: str, branch_at: int | None = None) -> pin.Model:
    """A random tree; the joint ``branch_at`` starts a second branch at the root."""
    pin.seed(7)
    model = pin.Model()
    for index, joint_type in enumerate(joint_types):
        parent = 1 if index == branch_at else index
        name = f"{index}_{joint_type}"
        joint = model.addJoint(parent, _TYPES[joint_type](), pin.SE3.Random(), name)
        model.appendBodyToJoint(joint, pin.Inertia.Random(), pin.SE3.Random())
        model.addFrame(pin.Frame(f"{name}_tip", joint, 0, pin.SE3.Random(), pin.FrameType.OP_FRAME))
    model.armature = np.linspace(0.0, 0.3, model.nv)
    return model


def continuous_unaligned() -> pin.Model:
    """A continuous joint with a skewed axis, which Pinocchio builds from URDF only."""
    return pin.buildModelFromXML(
        """<robot name="spinner"><link name="base"/>
        <link name="blade"><inertial><origin xyz="0.1 0.2 0.3"/><mass value="1.5"/>
        <inertia ixx="0.3" iyy="0.4" izz="0.5" ixy="0.01" ixz="0.02" iyz="0.03"/></inertial></link>
        <joint name="spin" type="continuous"><parent link="base"/><child link="blade"/>
        <origin xyz="0.3 0.2 0.1" rpy="0.1 0.2 0.3"/><axis xyz="1 2 -1"/></joint></robot>"""
    )


def arm(name: str) -> pin.Model:
    """An industrial arm of example-robot-data."""
    files = distribution("example-robot-data").files or []
    path = next(file for file in files if str(file).endswith(_ARMS[name]))
    return pin.buildModelFromUrdf(str(path.locate()))


MODELS: dict[str, Callable[[], pin.Model]] = {
    **{name: lambda name=name: built_model(name, name) for name in _TYPES},
    "continuous_unaligned": continuous_unaligned,
    "every_type_in_a_chain": lambda: built_model(*_TYPES),
    "two_branches": lambda: built_model(
        "free_flyer", "revolute_unaligned", "prismatic_x", "revolute_z", branch_at=3
    ),
    **{name: lambda name=name: arm(name) for name in _ARMS},
    **{name: lambda name=name: load_robot(name).model for name in list_robots()},
}


def random_configuration(model: pin.Model) -> np.ndarray:
    """A configuration anywhere within the limits, within +-3 where there are none."""
    lower = np.maximum(model.lowerPositionLimit, -3.0)
    upper = np.minimum(model.upperPositionLimit, 3.0)
    return pin.randomConfiguration(model, lower, upper)
