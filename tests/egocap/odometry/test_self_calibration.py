"""Corrections of a rig from pictures of a box: planted errors of calibration and shutter."""

from dataclasses import replace

import numpy as np
import pytest

from egocap.geometry import exponential, inverse, rigid
from egocap.odometry import self_calibration
from egocap.odometry.config import OdometryConfig
from egocap.odometry.finish import finish
from egocap.odometry.odometry import Odometry
from egocap.odometry.ray_kernel import linearised, logarithm
from egocap.odometry.self_calibration import (
    NOISES_PX,
    PARAMETERS,
    Correction,
    RigSearch,
    corrected,
    find_correction,
)
from egocap.odometry.views import Motion, Views
from tests.egocap.odometry.box_world import BoxWorld, apart, small_rig, walk

WORLD, VIEWS = BoxWorld(texel=0.1), Views.of(small_rig(), 320)
CONFIG = OdometryConfig(width=320, corners=120)
FRAMES, BANDS, STEPS = 48, 16, 64  # of the walk; of a picture's rows; of poses from frame to frame
READOUT = BANDS * 2 / STEPS / 30  # s
TOLERANT = replace(CONFIG, noise_px=NOISES_PX[0])


@pytest.fixture(scope="module")
def fine():
    """Poses of a walk, `STEPS` a frame."""
    return walk((FRAMES + 1) * STEPS, turn=1.2, fps=30.0 * STEPS)


@pytest.fixture(scope="module")
def still(fine):
    """Pictures whose rows are taken at once."""
    return [WORLD.pictures(VIEWS.rig, T) for T in fine[STEPS::STEPS]]


@pytest.fixture(scope="module")
def rolling(fine):
    """Pictures of a rolling shutter."""
    rows = STEPS * np.arange(1, FRAMES + 1)[:, None] + 2 * np.arange(BANDS) + 1 - BANDS
    return [WORLD.rolling(VIEWS.rig, fine[row]) for row in rows]


def follow(views, pictures, config):
    odometry = Odometry(views, config)
    found = [odometry.add(i, i / 30.0, own) for i, own in enumerate(pictures)]
    return odometry, sum(f.T_world_head is not None for f in found)


def path_error(fine, odometry):
    """Largest distance [m] from the true path, the first poses aligned."""
    result = finish(odometry.map, odometry.views)
    distance, _ = apart(fine[STEPS * (result.frame + 1)], result.T_map_head)
    return distance.max()


def turn_between_views(rig, true):
    """Angle [degrees] by which the views are wrongly turned to each other."""
    T, T_true = (inverse(r.T_head_camera[0]) @ r.T_head_camera[1] for r in (rig, true))
    return np.degrees(np.linalg.norm(logarithm(T_true[:3, :3].T @ T[:3, :3])))


def miscalibrated():
    """The rig with its right view turned by 0.4 degrees, and both centres and lengths wrong."""
    values = np.zeros((2, len(PARAMETERS)))
    values[1, :3] = np.deg2rad([0.3, -0.2, 0.2])
    values[:, 6] = 0.003, -0.002
    values[:, 7:9] = [0.6, -0.4], [-0.5, 0.3]
    return corrected(VIEWS, values)


def test_a_miscalibrated_rig_is_corrected(fine, still):
    wrong = miscalibrated()
    before, _ = follow(wrong, still, CONFIG)
    odometry, _ = follow(wrong, still, TOLERANT)
    correction = find_correction(odometry.map, wrong).correction
    assert correction is not None
    for found, true, given in zip(
        correction.views.cameras, VIEWS.cameras, wrong.cameras, strict=True
    ):
        off = np.abs(np.subtract(found.centre, true.centre))
        assert (off < 0.4 * np.abs(np.subtract(given.centre, true.centre)) + 0.1).all()
    assert turn_between_views(correction.views.rig, VIEWS.rig) < 0.1
    after, posed = follow(correction.views, still, CONFIG)
    assert posed == FRAMES
    assert path_error(fine, after) < 0.3 * path_error(fine, before)


def test_frames_between_keyframes_count_where_the_head_moves_little(monkeypatch):
    """As that of somebody who sits. How far the cameras are apart stays as given."""
    t = np.arange(90) / 30.0
    turns = np.stack([0.06 * np.sin(3.0 * t), 0.10 * np.sin(2.0 * t), 0.30 * np.sin(1.5 * t)], -1)
    poses = rigid(exponential(turns), [0.0, 0.0, 1.2] + 0.2 * turns)
    wrong = miscalibrated()
    odometry, _ = follow(wrong, [WORLD.pictures(VIEWS.rig, T) for T in poses], TOLERANT)
    found = find_correction(odometry.map, wrong).correction
    rig = found.views.rig
    assert turn_between_views(rig, VIEWS.rig) < 0.1 * turn_between_views(wrong.rig, VIEWS.rig)
    between = [np.linalg.norm(np.diff(r.T_head_camera[:, :3, 3], axis=0)) for r in (rig, wrong.rig)]
    assert between[0] == pytest.approx(between[1], abs=1e-5)
    monkeypatch.setattr(self_calibration, "FRAMES", len(odometry.map.keyframes))
    assert 3 <= len(odometry.map.keyframes) < 10
    alone = find_correction(odometry.map, wrong).correction
    assert np.median(found.std / alone.std) < 0.5


def test_a_rolling_shutter_is_found_and_its_path_is_right(fine, rolling):
    odometry, _ = follow(VIEWS, rolling, TOLERANT)
    correction = find_correction(odometry.map, VIEWS).correction
    assert correction is not None
    assert correction.values[:, -1] == pytest.approx([READOUT] * 2, abs=0.0015)
    assert correction.facts()["left"]["readout_ms"] == pytest.approx(1e3 * READOUT, abs=1.5)
    before, _ = follow(VIEWS, rolling, CONFIG)
    after, posed = follow(correction.views, rolling, CONFIG)
    assert posed == FRAMES
    assert path_error(fine, after) < 0.4 * path_error(fine, before)


def test_views_of_different_times_are_followed_where_the_times_are_known(fine):
    """The right view is late by 8 ms in the first half, early in the second."""
    late = np.where(np.arange(FRAMES) < FRAMES // 2, 16, -16)  # steps
    pictures = [
        tuple(WORLD.picture(VIEWS.rig, v, fine[(i + 1) * STEPS + v * late[i]]) for v in range(2))
        for i in range(FRAMES)
    ]
    found = []
    for told in (False, True):
        odometry = Odometry(VIEWS, CONFIG)
        for i, own in enumerate(pictures):
            seconds = np.array([0.0, late[i] / STEPS / 30]) if told else None
            odometry.add(i, i / 30.0, own, (), seconds)
        found.append(path_error(fine, odometry))
    assert found[1] < min(0.01, 0.4 * found[0])


def test_an_exact_rig_stays_as_it_is(still):
    """Its errors are known to be smaller than before; the rig's mean pose and size are its own."""
    odometry, _ = follow(VIEWS, still, TOLERANT)
    found, before = find_correction(odometry.map, VIEWS), RigSearch.fruitless(VIEWS)
    assert found.correction is None
    left, unknown = (np.sqrt(np.diag(s.covariance)).reshape(2, -1) for s in (found, before))
    assert (left < unknown + 1e-9).all() and np.median(left / unknown) < 0.2
    both = np.eye(len(PARAMETERS))[:3]  # the views are mounted alike
    together = np.concatenate([both, both], axis=1)
    assert np.abs(together @ before.covariance @ together.T).max() < 1e-9


def test_a_correction_fits_pictures_of_any_size():
    """Found at the working size, given back for the pictures' own."""
    full = VIEWS.rig.resized(640, 512)
    wrong = miscalibrated()
    values = np.zeros((2, len(PARAMETERS)))
    values[:, 6:9] = [0.01, 2.0, -1.0]
    found = Correction(corrected(wrong, values), values, values).rig(full)
    for camera, before in zip(found.cameras, full.cameras, strict=True):
        assert np.subtract(camera.centre, before.centre) == pytest.approx([4.0, -2.0])
        assert camera.affine[0][0] == pytest.approx(1.01 * before.affine[0][0])


def test_a_point_behind_all_that_see_it_tells_nothing(still):
    wrong = miscalibrated()
    odometry, _ = follow(wrong, still, TOLERANT)
    before = find_correction(odometry.map, wrong).correction
    frames = [odometry.map.frames[k] for k in odometry.map.keyframes]
    seen = np.concatenate([np.unique(frame.seen.point) for frame in frames])
    point = int(np.argmax(np.bincount(seen)))
    centre = np.mean([frame.t for frame in frames], axis=0)
    odometry.map.points[point] = centre - 1e3 * (odometry.map.points[point] - centre)
    after = find_correction(odometry.map, wrong).correction
    assert before is not None and after is not None
    assert (np.abs(after.values - before.values) < 3.0 * before.std + 1e-9).all()


def test_too_few_keyframes_tell_nothing(still):
    odometry, _ = follow(miscalibrated(), still[:8], TOLERANT)
    found = find_correction(odometry.map, VIEWS)
    assert found.correction is None
    np.testing.assert_array_equal(found.covariance, RigSearch.fruitless(VIEWS).covariance)


def test_points_and_sights_move_with_the_head(rng):
    """A point seen later lies on the ray as moved into the frame."""
    views = Views(VIEWS.rig, (0.0, 0.004), (0.02, 0.01))
    motion = Motion(np.array([0.5, -1.0, 2.0, 1.5, 0.2, -0.3]), np.array([0.003, -0.002]))
    points = rng.normal(size=(50, 3)) + [2.0, 0.0, -1.5]
    for v in range(2):
        pixels, valid = views.project_moving(v, points, motion)
        for _ in range(3):
            delay = views.delay(v, pixels, motion)
            pixels, valid = views.project(v, views.later(points, delay, motion))
        assert valid.sum() > 20
        assert np.ptp(delay[valid]) > 0.003
        rays, _ = views.rays(v, pixels[valid])
        centre, ray = views.sights(np.full(len(rays), v), rays, delay[valid], motion.twist)
        away = points[valid] - centre
        assert np.abs(np.cross(away, ray)).max() < 1e-5


def test_derivatives_of_residuals_by_centre_and_ray(rng):
    R, t, X = exponential(rng.normal(size=(1, 3))), rng.normal(size=(1, 3)), rng.normal(size=(5, 3))
    X = X + 4.0
    o, inv_sigma, none = 0.1 * rng.normal(size=(5, 3)), np.full(5, 100.0), np.zeros(5, int)
    away = (X - t) @ R[0] - o
    b = away / np.linalg.norm(away, axis=1, keepdims=True)
    at = np.arange(5)
    r, *_, J_centre, J_ray = linearised(R, t, X, none, at, o, b, inv_sigma)
    assert np.abs(r).max() < 1e-10
    for i in range(3):
        h = 1e-6 * np.eye(3)[i]
        by_centre = linearised(R, t, X, none, at, o + h, b, inv_sigma)[0] / 1e-6
        assert by_centre == pytest.approx(J_centre[:, :, i], abs=1e-3)
        turned = b + h - (b @ h)[:, None] * b  # stays of unit length
        by_ray = linearised(R, t, X, none, at, o, turned, inv_sigma)[0] / 1e-6
        assert by_ray == pytest.approx(J_ray[:, :, i], abs=1e-2)
