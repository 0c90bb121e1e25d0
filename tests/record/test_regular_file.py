"""No reader waits for a pipe, or reads what has no end."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from uvms_ocp.errors import InvalidInput, RobotDataError
from uvms_ocp.record.array_file import read_arrays
from uvms_ocp.record.xml_file import read_xml
from uvms_ocp.record.yaml_file import read_yaml
from uvms_ocp.robot.description import read_description
from uvms_ocp.robot.shapes.obstacles import read_obstacles
from uvms_ocp.robot.urdf import read_urdf

READERS: dict[str, tuple[Callable[[Path], object], type[Exception]]] = {
    "description": (read_description, InvalidInput),
    "obstacles": (read_obstacles, InvalidInput),
    "URDF": (partial(read_urdf, free_flyer=True), RobotDataError),
    "arrays": (read_arrays, InvalidInput),
}


@pytest.mark.parametrize("reader", [read_yaml, read_xml])
def test_a_large_file_is_not_read(reader: Callable[[Path], object], tmp_path: Path) -> None:
    path = tmp_path / "a"
    with path.open("wb") as file:
        file.truncate(1 << 34)  # takes no place on the disk
    with pytest.raises(InvalidInput, match="larger than 16 MB"):
        reader(path)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes here")
@pytest.mark.parametrize("name", READERS)
def test_a_pipe_is_not_waited_for_and_a_device_not_read(name: str, tmp_path: Path) -> None:
    reader, error = READERS[name]
    os.mkfifo(tmp_path / "a")
    for path in (tmp_path / "a", tmp_path, Path("/dev/zero")):
        with pytest.raises(error, match="no file but a folder or a device"):
            reader(path)
