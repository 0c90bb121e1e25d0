"""Tree of the links and joints of a mechanism, by the joint that carries each link."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from uvms_ocp.robot.name_words import NameWords

_ENDLESS = 100.0  # [rad] between limits that stand for none, as some exporters write 1e12


class LinkTree:
    """Tree of links and joints: links of a model by the joint that carries them."""

    def __init__(self, model: pin.Model, free_flyer: bool) -> None:
        self.model = model
        self.words = NameWords(model)
        self.carrier = 1 if free_flyer else 0
        """Joint that carries the vehicle, or 0, the world."""
        self.moving = range(self.carrier + 1, model.njoints)
        """Joints that move against the vehicle."""
        self.bodies: dict[int, list[int]] = {joint: [] for joint in range(model.njoints)}
        """Frames of the links that each joint carries."""
        self.inner = set[int]()
        """Frames of links on which another link hangs."""
        for i, frame in enumerate(model.frames):
            if frame.type == pin.FrameType.BODY:
                self.bodies[frame.parentJoint].append(i)
                self.inner.add(self.frame_above(i))

    def frame_above(self, frame: int) -> int:
        """Return the frame of the link on which a link hangs."""
        joint_frame = self.model.frames[frame].parentFrame
        return int(self.model.frames[joint_frame].parentFrame)

    def name(self, frame: int) -> str:
        """Return the name of a link by its frame."""
        return str(self.model.frames[frame].name)

    def names(self, joint: int) -> list[str]:
        """Return the names of a joint and of the link that it moves."""
        link_names = [self.name(i) for i in self.bodies[joint][:1]]
        return [str(self.model.names[joint]), *link_names]

    def children(self, joint: int) -> list[int]:
        """Return the joints that hang on a joint, without those that hang on them."""
        return [child for child in self.moving if self.model.parents[child] == joint]

    def below(self, joint: int) -> list[int]:
        """Return the joint and all that hang on it."""
        joints = [joint]
        for child in self.children(joint):
            joints += self.below(child)
        return joints

    def above(self, joint: int) -> list[int]:
        """Return the joints between the vehicle and this one."""
        parent = self.model.parents[joint]
        if parent <= self.carrier:
            return []
        return [parent, *self.above(parent)]

    def has_range(self, joint: int) -> bool:
        """Check whether a joint can move at all."""
        moving = self.model.joints[joint]
        if moving.nq != moving.nv:
            return True
        n_q = max(moving.nq, 1)  # of one that mimics, those of its leader
        q = slice(moving.idx_q, moving.idx_q + n_q)
        lower = self.model.lowerPositionLimit[q]
        upper = self.model.upperPositionLimit[q]
        return bool((lower < upper).any())

    def is_endless(self, joint: int) -> bool:
        """Check whether a joint turns about one axis without end."""
        moving = self.model.joints[joint]
        if moving.nv != 1:
            return False
        if moving.nq == 2:
            return True
        turns = bool(np.any(np.array(moving.createData().S).ravel()[3:]))
        if not turns or moving.nq != 1:
            return False
        lower = self.model.lowerPositionLimit[moving.idx_q]
        upper = self.model.upperPositionLimit[moving.idx_q]
        return bool(upper - lower > _ENDLESS)

    def is_no_tool(self, frame: int) -> bool:
        """Check whether a link is a sensor or a finger; the palm that carries fingers is
        neither.
        """
        name = self.name(frame)
        if self.words.is_called("sensor", name):
            return True
        if frame in self.inner or self.words.is_called("tip", name):
            return False
        return self.words.is_called("finger", name)

    def is_end(self, frame: int) -> bool:
        """Check that no other link is fixed to the link further out, itself or by a load cell, but
        sensors and fingers.
        """
        for i in self.bodies[self.model.frames[frame].parentJoint]:
            above = self.frame_above(i)
            while self.is_load_cell(above):
                above = self.frame_above(above)
            if not self.is_no_tool(i) and above == frame:
                return False
        return True

    def is_load_cell(self, frame: int) -> bool:
        """Check whether a link is a sensor of the forces that pass through it."""
        name = self.name(frame)
        return self.words.is_called("sensor", name) and self.words.is_called("load cell", name)

    def is_tip(self, frame: int) -> bool:
        """Check whether a link is called a tool, and neither what holds one nor a sensor."""
        name = self.name(frame)
        if self.words.is_called("mount", name) or self.words.is_called("sensor", name):
            return False
        return self.words.is_called("tip", name)

    def ends_in_tool(self, joint: int) -> bool:
        """Check whether the joint, or one that hangs on it, moves a link called a tool or a
        finger.
        """
        for k in self.below(joint):
            names = [self.name(i) for i in self.bodies[k]]
            if self.words.is_called("finger", *names):
                return True
            if any(self.is_tip(i) for i in self.bodies[k]):
                return True
        return False
