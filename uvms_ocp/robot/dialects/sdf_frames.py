"""Frames of SDF: poses that name the frame they are relative to, and what each frame is fixed to."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot.urdf_elements import Element, quoted, to_floats

_SHORTEST = 1e-9  # norm of a quaternion


def read_pose(element: Element | None, where: str) -> pin.SE3:
    """Return the pose that a <pose> states, the identity without one. Raises `InvalidInput`."""
    if element is None or not (element.text or "").strip():
        return pin.SE3.Identity()
    numbers = np.array(to_floats(" ".join((element.text or "").split())))
    is_quaternion = element.get("rotation_format") == "quat_xyzw"
    if numbers.size != (7 if is_quaternion else 6) or not np.isfinite(numbers).all():
        raise InvalidInput(
            f"{where} <pose>: given {quoted(' '.join((element.text or '').split()))}; allowed: x y z"
            " roll pitch yaw, or x y z and a quaternion x y z w with its rotation_format"
        )
    if not is_quaternion:
        angles = numbers[3:]
        if element.get("degrees", "").lower() in ("true", "1"):
            angles = np.deg2rad(angles)
        return pin.SE3(pin.rpy.rpyToMatrix(angles), numbers[:3])
    norm = float(np.linalg.norm(numbers[3:]))
    if norm < _SHORTEST:
        raise InvalidInput(f"{where} <pose>: a quaternion of length 0; allowed: length 1")
    return pin.SE3(pin.Quaternion(numbers[3:] / norm).matrix(), numbers[:3])


def relative_to(pose: Element | None) -> str:
    """Return the frame that a <pose> names, "" for none."""
    if pose is None:
        return ""
    return pose.get("relative_to") or pose.get("frame") or ""  # `frame` up to SDF 1.6


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PlacedFrame:
    """A frame as the file states it."""

    above: str
    """Frame that its pose is relative to."""
    X: pin.SE3
    """Pose of this frame in the frame `above`."""
    attached_to: str | None
    """Frame that it is fixed to; `None` for a link, which is fixed to itself."""


@dataclass(kw_only=True, slots=True)
class FrameGraph:
    """All frames of a model by their full names."""

    top: str
    """Frame of the whole model, in which the others are placed."""
    frames: dict[str, PlacedFrame] = field(default_factory=dict)

    def placement(self, name: str) -> pin.SE3:
        """Return the pose of a frame in the model. Raises `InvalidInput` for frames that are not
        there or form a loop.
        """
        X = pin.SE3.Identity()
        passed = set[str]()
        while name != self.top:
            frame = self._frame(name)
            if name in passed:
                raise InvalidInput(f"frame {name!r} is placed relative to itself")
            passed.add(name)
            X = frame.X * X
            name = frame.above
        return X

    def link_of(self, name: str) -> str:
        """Return the link that a frame is fixed to. Raises `InvalidInput` as `placement` does."""
        passed = set[str]()
        while True:
            frame = self._frame(name)
            if frame.attached_to is None:
                return name
            if name in passed:
                raise InvalidInput(f"frame {name!r} is attached to itself")
            passed.add(name)
            name = frame.attached_to

    def _frame(self, name: str) -> PlacedFrame:
        """Return a frame by its name; the name of a model stands for the model's frame."""
        if name in self.frames:
            return self.frames[name]
        model_frame = f"{name}::__model__"
        if model_frame in self.frames:
            return PlacedFrame(above=model_frame, X=pin.SE3.Identity(), attached_to=model_frame)
        raise InvalidInput(f"frame {name!r} is not in the file")
