"""Roles of drawn mechanisms are right, or what is not is asked."""

from __future__ import annotations

from pathlib import Path

import pytest
from drawn_mechanisms import DrawnMechanism, drawn_mechanism

from uvms_ocp.robot.proposal import RobotProposal, propose


def wrong_roles(mechanism: DrawnMechanism, proposal: RobotProposal) -> set[str]:
    """Return links and joints whose role is another than that which was drawn."""
    robot = proposal.robot
    return (
        (set(robot.thruster_names) ^ mechanism.thrusters)
        | (set(robot.tools) ^ mechanism.tools)
        | (set(robot.joint_names) ^ mechanism.joints)
    )


def silently_wrong(mechanism: DrawnMechanism, folder: Path) -> set[str]:
    """Return links and joints of another role than drawn that no question names, itself or by its
    joint.
    """
    (folder / "robot.urdf").write_text(mechanism.text, encoding="utf-8")
    proposal = propose(folder / "robot.urdf", base="free_flyer")
    model = proposal.robot.model
    silent = set[str]()
    for name in wrong_roles(mechanism, proposal):
        names = {name}
        if model.existFrame(name):
            frame = model.frames[model.getFrameId(name)]
            names |= {model.names[frame.parentJoint], model.frames[frame.parentFrame].name}
        asked = any(other in question for question in proposal.questions for other in names)
        if not asked:
            silent.add(name)
    return silent


@pytest.mark.sampled
@pytest.mark.parametrize("seed", range(60))
def test_roles_of_drawn_mechanisms_are_right_or_asked(seed: int, tmp_path: Path) -> None:
    mechanism = drawn_mechanism(seed)
    assert not silently_wrong(mechanism, tmp_path), mechanism.kinds
