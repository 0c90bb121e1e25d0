"""Faults on the command line: told in the report and on the screen, refused in one line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import called

from uvms_ocp.cli.result_folders import default_folder
from uvms_ocp.sim.faults import parse_faults


@pytest.mark.slow
def test_faults_have_a_line_each_and_a_folder_of_their_own(tmp_path: Path) -> None:
    faults = ("--fault", "altimeter:frozen@0.1", "--fault", "joint2:jam@0.05-0.1")
    process = called(
        "run", "case1", "--plant", "kinematic", "--duration", "0.2", *faults, "--json", cwd=tmp_path
    )
    assert process.returncode == 3, process.stderr
    assert "fault from 0.1 s: altimeter_range:frozen@0.1" in process.stderr
    assert "fault from 0.05 s to 0.1 s: joint2:jam@0.05-0.1" in process.stderr
    assert [fault["target"] for fault in json.loads(process.stdout)["faults"]] == [
        "altimeter_range",
        "joint2",
    ]
    (folder,) = (tmp_path / "uvms_runs").iterdir()
    assert (
        folder.name
        == "case1-kinematic-active_set-duration0.2-altimeter_range_frozen_0p1-joint2_jam_0p05to0p1"
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--fault", "altimetre:frozen@8"], "Did you mean 'altimeter'?"),
        (["--fault", "altimeter:frosen@8"], "Did you mean 'frozen'?"),
        (
            ["--fault", "altimeter"],
            "write TARGET:KIND=VALUES@ONSET-END, such as altimeter:frozen@8",
        ),
        (["--fault", "thruster9:dead@8"], "the robot has 8 thrusters; give one of them, from 1"),
        (
            ["--plant", "kinematic", "--fault", "thruster3:dead"],
            "the kinematic plant has no thrusters",
        ),
        (["--fault", "thruster3:weak=2"], "give share [-], 0 to less than 1"),
    ],
)
def test_a_fault_that_cannot_be_gets_one_line_and_exit_code_2(
    arguments: list[str], message: str, tmp_path: Path
) -> None:
    process = called("run", "case1", *arguments, cwd=tmp_path)
    assert process.returncode == 2
    assert message in process.stderr
    assert len(process.stderr.strip().splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def test_different_faults_have_different_folders() -> None:
    texts = (
        "position:stuck=1@2",
        "position:stuck=1,2,0@0",
        "position:stuck=-1@2",
        "position:stuck=1@0-2",
        "position:lost@12",
    )
    assert len(
        {default_folder(("case1",), {"faults": parse_faults([text])}) for text in texts}
    ) == len(texts)
