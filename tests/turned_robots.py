"""Files of robots that describe the same robot otherwise: with the base frame turned about its vertical
axis.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from typing import Any

import numpy as np
import pinocchio as pin


def turn(quarters: int) -> np.ndarray:
    """Return R_NB (3, 3), of the axes of the file in those of the new one; exact."""
    R: np.ndarray = np.round(pin.rpy.rpyToMatrix(0.0, 0.0, -quarters * math.pi / 2))
    return R + 0.0


def twist_turn(quarters: int, n_v: int) -> np.ndarray:
    """Return the matrix (n_v, n_v) that turns velocities or forces of a vehicle into the new axes."""
    T = np.eye(n_v)
    T[:3, :3] = T[3:6, 3:6] = turn(quarters)
    return T


def _turn_entry(entry: dict[str, Any], name: str, R_NB: np.ndarray) -> None:
    if name in entry:
        entry[name] = (R_NB @ entry[name]).tolist()


def _turn_pose(entry: dict[str, Any], quarters: int) -> None:
    pose = entry.setdefault("pose", {})
    _turn_entry(pose, "position", turn(quarters))
    R = turn(quarters) @ pin.rpy.rpyToMatrix(*map(float, pose.get("rpy", (0.0, 0.0, 0.0))))
    pose["rpy"] = pin.rpy.matrixToRpy(R).tolist()


def _turn_hydrodynamics(data: dict[str, Any], base: str, quarters: int) -> None:
    R_NB = turn(quarters)
    if quarters % 2:
        for limits in data.get("vehicle_limits", {}).values():
            limits[0], limits[1] = limits[1], limits[0]
            limits[3], limits[4] = limits[4], limits[3]
    for water in data["links"][base].values():
        _turn_pose(water, quarters)
        _turn_entry(water, "centre_of_buoyancy", R_NB)
    for part in (*data.get("trim", []), *data["thrusters"]):
        if part.get("link", "base_link") == base:
            _turn_entry(part, "position", R_NB)
            _turn_entry(part, "direction", R_NB)


def _turn_origin(parent: ET.Element, quarters: int) -> None:
    origin = parent.find("origin")
    if origin is None:
        origin = ET.SubElement(parent, "origin")
    position = np.array(list(map(float, origin.get("xyz", "0 0 0").split())))
    rpy = map(float, origin.get("rpy", "0 0 0").split())
    R = turn(quarters) @ pin.rpy.rpyToMatrix(*rpy)
    origin.set("xyz", " ".join(map(repr, (turn(quarters) @ position).tolist())))
    origin.set("rpy", " ".join(map(repr, pin.rpy.matrixToRpy(R).tolist())))


def turn_files(root: ET.Element, data: dict[str, Any], base: str, quarters: int) -> None:
    """Turn the axes of the base link in a URDF and in the values of its hydrodynamics.yaml."""
    for link in root.findall("link"):
        if link.attrib["name"] == base:
            for part in link:
                _turn_origin(part, quarters)
    for joint in root.findall("joint"):
        parent = joint.find("parent")
        assert parent is not None
        if parent.attrib["link"] == base:
            _turn_origin(joint, quarters)
    _turn_hydrodynamics(data, base, quarters)


def configuration(q: np.ndarray, quarters: int) -> np.ndarray:
    """Return the configurations (n, n_q) of the robot whose base is turned, at the same places."""
    X_BN = pin.SE3(turn(quarters).T, np.zeros(3))
    result = np.array(np.atleast_2d(q))
    for row in result:
        row[:7] = pin.SE3ToXYZQUAT(pin.XYZQUATToSE3(row[:7]) * X_BN)
    return result
