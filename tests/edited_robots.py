"""Robots of files that a test has changed in memory."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import yaml

from uvms_ocp.robot import load_robot
from uvms_ocp.robot.robot import Robot


def load_edited(tree: ET.ElementTree[ET.Element], data: dict[str, Any]) -> Robot:
    """Load the robot of a URDF and of the values of its hydrodynamics.yaml."""
    with TemporaryDirectory() as place:
        urdf = Path(place) / "robot.urdf"
        tree.write(urdf)
        hydrodynamics = Path(place) / "hydrodynamics.yaml"
        hydrodynamics.write_text(yaml.safe_dump(data), encoding="utf-8")
        return load_robot(urdf=urdf, hydrodynamics=hydrodynamics)
