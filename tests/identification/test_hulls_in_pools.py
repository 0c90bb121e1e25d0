"""The whole hull is kept inside the pool, however the vehicle is turned."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
import yaml
from driven import known, vehicle_of
from scipy.spatial.transform import Rotation

from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification.calibration_robot import calibrated_robot
from uvms_ocp.identification.experiment_design import (
    DesignSettings,
    DesignStatus,
    ExperimentTask,
    design_experiment,
)
from uvms_ocp.identification.experiment_limits import ExperimentLimits
from uvms_ocp.identification.model import stage_of
from uvms_ocp.identification.parameters import Free
from uvms_ocp.identification.results import excitation_text
from uvms_ocp.identification.rollout import Rollout
from uvms_ocp.identification.settings import CalibrationSettings

LIMITS = ExperimentLimits(
    thrust=np.outer([20.0, 20.0, 20.0, 2.0, 2.0, 2.0], [-1.0, 1.0]),
    pool=np.array([[-1.5, -1.0, -0.8], [1.5, 1.2, 0.8]]),
    hull=np.array([[-0.7, -0.2, -0.1], [0.5, 0.3, 0.2]]),
    tilt=0.5,
)


def corners(x: np.ndarray) -> np.ndarray:
    """(n, 8, 3) [m] of the hull in W, at states x (n, 7)."""
    box = np.array(list(product(*LIMITS.hull.T)))
    return np.array([one[:3] + Rotation.from_quat(one[3:7]).apply(box) for one in x])


def turned_states(n: int, size: float) -> np.ndarray:
    rng = np.random.default_rng(0)
    q = Rotation.from_euler("zyx", rng.uniform(-1, 1, size=(n, 3)) * [np.pi, 0.4, 0.4]).as_quat()
    return np.hstack([rng.uniform(-size, size, size=(n, 3)), q])


def test_corners_of_the_hull_are_inside_exactly_where_nothing_is_beyond() -> None:
    x = turned_states(300, 1.0)
    beyond = LIMITS.beyond(x, margin=0.0)[0][:, :3].any(axis=1)
    places = corners(x)
    outside = ((places < LIMITS.pool[0]) | (places > LIMITS.pool[1])).any(axis=(1, 2))
    np.testing.assert_array_equal(beyond, outside)
    assert 0.1 < outside.mean() < 0.9
    np.testing.assert_allclose(
        LIMITS.swept(x), [places.min(axis=(0, 1)), places.max(axis=(0, 1))], atol=1e-12
    )


def test_the_slope_of_what_is_beyond_is_that_of_its_value() -> None:
    x = turned_states(50, 2.0)
    along = np.random.default_rng(1).normal(size=x.shape)
    ahead, back = (LIMITS.beyond(x + e * along)[0] for e in (1e-6, -1e-6))
    found, slope = LIMITS.beyond(x)
    wanted = (ahead - back) / 2e-6
    smooth = (ahead > 0) == (back > 0)
    np.testing.assert_allclose(
        np.einsum("nik,nk->ni", slope, along)[smooth], wanted[smooth], rtol=1e-5, atol=1e-6
    )
    assert (found > 0.0).any(axis=0).all()


@pytest.mark.slow
def test_a_design_keeps_the_whole_hull_inside_and_tells_where_it_sweeps() -> None:
    auv = vehicle_of(known().with_status(added_mass=Free()))
    task = ExperimentTask(vehicle=auv, limits=LIMITS, duration=5.0)
    excitation = design_experiment(
        task, Rollout(stage_of(auv)), DesignSettings(step=0.1, knots=0.5, starts=1, iterations=15)
    )
    assert excitation.status is DesignStatus.INSIDE
    places = corners(excitation.states)
    assert (places >= LIMITS.pool[0]).all()
    assert (places <= LIMITS.pool[1]).all()
    assert f"{places[:, :, 0].min():+.2f} to {places[:, :, 0].max():+.2f}" in excitation_text(
        excitation, list("abcdef")
    )


def test_a_hull_that_does_not_fit_is_refused() -> None:
    with pytest.raises(
        InvalidInput, match=r"hull of 1.2 x 0.5 x 0.3 m in a pool of 1 x 2.2 x 1.6 m given"
    ):
        replace(LIMITS, pool=LIMITS.pool * [1 / 3, 1, 1])
    with pytest.raises(InvalidInput, match="its lowest corner, then its highest"):
        replace(LIMITS, hull=LIMITS.hull[::-1])


def test_the_hull_of_settings_is_turned_from_its_link_to_the_body() -> None:
    hull = [[-0.3, -0.2, -0.1], [0.5, 0.2, 0.1]]
    text = yaml.safe_load(
        f"{{robot: bluerov2_alpha5, arm: taken off, hull: {hull}, learn: {{lag: {{}}}}}}"
    )
    subject = calibrated_robot(CalibrationSettings.model_validate(text), Path())
    X = subject.robot.model.frames[subject.robot.model.getFrameId(subject.frame)].placement
    places = np.array([X.act(np.array(corner)) for corner in product(*np.transpose(hull))])
    np.testing.assert_allclose(
        subject.hull_in_body(hull), [places.min(axis=0), places.max(axis=0)], atol=1e-12
    )
