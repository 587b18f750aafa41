"""Rendered markers against `camera.project`.

Glowing balls before black, 8 pixels in radius, at random directions to 88 degrees off the axis.
The centroid of the rendered grey values is compared with two projections: the area centroid of the
ball's outline (720 points of it through `camera.project`), and the ball's centre. Limits: 0.25
pixels without anti-aliasing, 0.1 pixels with 4 samples.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from egocap.cameras.camera import Camera
from egocap.cameras.camera_files import load_camera
from egocap_sim.assets import textures
from egocap_sim.assets.primitives import ball

from .conftest import looking_forward, place_of

RADIUS_PX = 8.0
LIMIT = {0: 0.25, 4: 0.10}


def _cameras() -> dict[str, Camera]:
    polynomial = [-210.0, 0.0, 1.5e-3, -1.6e-6, 4.8e-9]
    return {
        "equidistant": Camera(
            "equidistant", 640, 512, (319.5, 255.5), ((203.7, 0.0), (0.0, 203.7)),
            max_angle=np.pi / 2,
        ),
        "kannala_brandt": Camera(
            "kannala_brandt", 640, 512, (316.1, 259.2), ((197.5, 0.0), (0.0, 199.0)),
            (0.03, -0.008, 0.002, -0.0004), max_angle=np.radians(92),
        ),
        "ocam": Camera(
            "ocam", 640, 512, (322.0, 253.7), ((1.0, 2e-4), (-3e-4, 1.0)), tuple(polynomial),
            max_angle=np.radians(92),
        ),
    }  # fmt: skip


@pytest.mark.parametrize("samples", [0, 4])
@pytest.mark.parametrize("name", ["equidistant", "kannala_brandt", "ocam"])
def test_markers_land_where_the_camera_projects_them(gl, name, samples):
    outline, centre = _errors(gl, _cameras()[name], samples)
    assert len(outline) > 60
    assert outline.max() < LIMIT[samples]
    # Near the rim a ball's picture is no disc; its centre is not its centroid to the last digit.
    assert centre.max() < LIMIT[samples] + 0.03


def test_markers_land_right_for_a_real_lens(gl, shared_calibration):
    camera = load_camera(shared_calibration)
    outline, _ = _errors(gl, camera, samples=4)
    assert len(outline) > 60 and outline.max() < LIMIT[4]


@pytest.fixture
def shared_calibration():
    from pathlib import Path

    path = Path(__file__).parents[4] / "shared/calibrations/camera_front_left.json"
    if not path.exists():
        pytest.skip("no ../shared/calibrations here")
    return path


def _errors(gl, camera: Camera, samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Pixels between rendered centroid and outline centroid, and centre, of every marker."""
    R_world_camera = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    white = replace(textures.even(1.0), glows=True)
    markers = list(_markers(camera, np.random.default_rng(0)))
    balls = [ball("marker", R_world_camera @ p, (r, r, r), white, rings=24) for p, r, _ in markers]
    with gl.FisheyeRenderer(looking_forward(camera), [], place_of(*balls), samples=samples) as it:
        image = it.render(np.eye(4), {}).images[0][..., 1].astype(float)
    errors = []
    for p, _, outline in markers:
        (x0, y0), (x1, y1) = np.floor(outline.min(0)) - 2, np.ceil(outline.max(0)) + 3
        y, x = np.mgrid[int(y0) : int(y1), int(x0) : int(x1)]
        weight = image[y, x]
        found = np.array([(weight * x).sum(), (weight * y).sum()]) / weight.sum()
        errors.append(
            [np.linalg.norm(found - c) for c in (_centroid(outline), camera.project(p)[0])]
        )
    return tuple(np.array(errors).T)


def _markers(camera: Camera, rng: np.random.Generator, count: int = 80):
    """Balls that keep clear of each other and of the image's border: centre, radius, outline."""
    radius = RADIUS_PX / 203.7 * 640 / camera.width
    largest = min(np.radians(88), camera.max_angle - 1.1 * radius)
    taken: list[np.ndarray] = []
    for _ in range(4000):
        angle, turn = np.arccos(rng.uniform(np.cos(largest), 1.0)), rng.uniform(0, 2 * np.pi)
        axis = np.array([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)])
        if len(taken) == count or any(axis @ t > np.cos(2.6 * radius) for t in taken):
            continue
        outline, valid = camera.project(_tangent_circle(axis, radius))
        border = np.array([camera.width, camera.height]) - 4
        if not valid.all() or outline.min() < 3 or (outline > border).any():
            continue
        taken.append(axis)
        distance = rng.uniform(0.5, 3.0)
        yield axis * distance, np.sin(radius) * distance, outline


def _tangent_circle(axis: np.ndarray, angle: float) -> np.ndarray:
    side = np.cross(axis, [0.1, 1.0, 0.0] if abs(axis[1]) < 0.9 else [1.0, 0.1, 0.0])
    side /= np.linalg.norm(side)
    t = np.linspace(0, 2 * np.pi, 720, endpoint=False)[:, None]
    ring = np.cos(t) * side + np.sin(t) * np.cross(axis, side)
    return np.cos(angle) * axis + np.sin(angle) * ring


def _centroid(polygon: np.ndarray) -> np.ndarray:
    """Area centroid by the shoelace formula."""
    following = np.roll(polygon, -1, axis=0)
    cross = polygon[:, 0] * following[:, 1] - following[:, 0] * polygon[:, 1]
    return ((polygon + following) * cross[:, None]).sum(0) / (3 * cross.sum())
