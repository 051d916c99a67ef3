"""Contracts of all feature parametrisations, and properties of single ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from contracts import CAMERA, FEATURES, FIRST_POSE, LATER_POSE, PIXELS, ParametrisationContract, view_at

from gyrocal_ros.config.declare import Setting
from gyrocal_ros.model.camera import project
from gyrocal_ros.model.features import PARAMETRISATIONS
from gyrocal_ros.model.features.base import anchors_at, no_anchors, points_in_camera, points_in_world
from gyrocal_ros.model.features.inverse_depth import AnchoredInverseDepth
from gyrocal_ros.model.features.rays import cross_std, ray_covariances, ray_points


@pytest.mark.parametrize('form', PARAMETRISATIONS.values(), ids=PARAMETRISATIONS)
class TestEachParametrisation(ParametrisationContract):
    pass


def test_the_table_and_the_setting_agree() -> None:
    about: Setting = FEATURES.__dataclass_fields__['parametrisation'].metadata['setting']
    assert set(about.choices) == set(PARAMETRISATIONS)
    assert all(form.name == name for name, form in PARAMETRISATIONS.items())
    assert FEATURES.parametrisation == 'inverse_depth'


def test_only_the_form_of_the_paper_has_a_motion_gate() -> None:
    assert [name for name, form in PARAMETRISATIONS.items() if form.needs_motion_gate] == ['camera_frame']


def test_transforms_to_the_camera_and_back_are_inverse() -> None:
    view = view_at(LATER_POSE)
    points_w = np.array([[1.0, -0.5, 2.6], [0.2, 0.3, 2.1]])
    points_c, _, _ = points_in_camera(view, points_w)
    np.testing.assert_allclose(points_in_world(view, points_c)[0], points_w, atol=1e-12)
    np.testing.assert_allclose(points_c, (points_w - view.p_wc) @ view.R_wc, atol=1e-12)


def test_rays_have_their_range_in_every_quadrant() -> None:
    """The paper's arctangents would lose the quadrant left of and above the image centre."""
    corners = np.array([[10.0, 10.0], [630.0, 10.0], [10.0, 470.0], [630.0, 470.0]])
    points_c = ray_points(CAMERA, corners, 5.0)
    np.testing.assert_allclose(np.linalg.norm(points_c, axis=1), 5.0)
    np.testing.assert_allclose(project(CAMERA, points_c), corners, atol=1e-9)
    np.testing.assert_array_equal(np.sign(points_c[:, :2]), [[-1, -1], [1, -1], [-1, 1], [1, 1]])


def test_ray_noise_has_the_axes_of_the_paper() -> None:
    points_c = ray_points(CAMERA, PIXELS, 5.0)
    for point, covariance in zip(points_c, ray_covariances(points_c, 0.0125, 100.0), strict=True):
        variances, axes = np.linalg.eigh(covariance)
        np.testing.assert_allclose(variances, [0.0125**2, 0.0125**2, 100.0**2], rtol=1e-6)
        assert abs(axes[:, 2] @ point) == pytest.approx(5.0)


def test_cross_noise_agrees_with_the_paper() -> None:
    """It is 1.25 cm for d = 5 m, f = 200 px, and 0.5 px of tracking and calibration error together."""
    camera = replace(CAMERA, fx_px=200.0, fy_px=200.0)
    config = replace(FEATURES, prior_depth_m=5.0, calibration_noise_px=0.3)
    assert cross_std(camera, 0.4, config) == pytest.approx(0.0125)


def test_without_parallax_the_pixel_does_not_depend_on_inverse_depth() -> None:
    form, view = AnchoredInverseDepth(), view_at(FIRST_POSE)
    new = form.initialise(view, PIXELS, 0.4, FEATURES)
    prediction = form.predict(view, new.parameters, new.anchors)
    np.testing.assert_allclose(prediction.by_feature[:, :, 2], 0.0, atol=1e-10)


def test_a_nonpositive_inverse_depth_is_far_away() -> None:
    anchors = anchors_at(np.eye(3)[None], np.zeros((1, 3)))
    for inverse_depth in (0.0, -0.3):
        point, by_parameters = AnchoredInverseDepth().world(np.array([[0.1, 0.2, inverse_depth]]), anchors)
        assert np.isfinite(point).all() and np.isfinite(by_parameters).all()
        assert point[0, 2] >= 1000.0


def test_anchors_are_joined_and_selected_by_rows() -> None:
    one = anchors_at(np.eye(3)[None], np.array([[1.0, 2.0, 3.0]]))
    both = no_anchors(2).joined(one)
    assert no_anchors(0).joined(one) is one
    assert both.R_wc.shape == (3, 3, 3) and both.p_wc.shape == (3, 3)
    np.testing.assert_array_equal(both[np.array([2])].p_wc, one.p_wc)
    np.testing.assert_array_equal(both[np.arange(1, 3)].R_wc[1], np.eye(3))
