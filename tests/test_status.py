"""Every outcome that the package reports says what to do about it."""

from __future__ import annotations

import pickle

import pytest

from uvms_ocp.control.solve_workers import WorkerStatus
from uvms_ocp.errors import AdvisedStatus
from uvms_ocp.identification.experiment_design import DesignStatus
from uvms_ocp.identification.output_error import FitStatus
from uvms_ocp.ocp.plan import OcpStatus
from uvms_ocp.planning.soft_collision import PlanStatus
from uvms_ocp.solvers.hierarchy.solution import Status
from uvms_ocp.solvers.nlp.program import NlpStatus
from uvms_ocp.solvers.stage_qp import StageQpStatus

MEMBERS = [
    status
    for kind in (
        DesignStatus,
        FitStatus,
        Status,
        NlpStatus,
        OcpStatus,
        PlanStatus,
        StageQpStatus,
        WorkerStatus,
    )
    for status in kind
]


def test_every_status_is_in_the_list() -> None:
    assert set(AdvisedStatus.__subclasses__()) == {type(status) for status in MEMBERS}


@pytest.mark.parametrize("status", MEMBERS, ids=str)
def test_a_status_has_a_text_and_an_advice_of_one_line(status: AdvisedStatus) -> None:
    for text in (status.value, status.advice):
        assert text
        assert "\n" not in text


@pytest.mark.parametrize("status", MEMBERS, ids=str)
def test_a_status_is_found_by_its_value_alone(status: AdvisedStatus) -> None:
    assert type(status)(status.value) is status
    assert pickle.loads(pickle.dumps(status)) is status
