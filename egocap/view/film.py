"""A film in the layout of the viewer: the motion in space, beside it the views above a curve.

In: a sequence and a track of it. Out: an H.264 file. The truth of a simulated sequence is grey.
"""

from __future__ import annotations

from collections.abc import Callable
from math import ceil
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array
from scipy.spatial import KDTree

from egocap.data.input_checks import require_same_times
from egocap.data.sequence import Sequence, largest_reduction
from egocap.data.track import Track
from egocap.detect.input_images import ahead
from egocap.geometry import transform
from egocap.view.skeleton import (
    BACKGROUND,
    draw_in_space,
    draw_in_world,
    draw_views,
    panel_widths,
)
from egocap.view.video import VideoFile

FILM_HZ = 15.0
HEIGHT, CURVE_HEIGHT = 840, 120
"""Of the film, and of its curve, pixels."""
_LINE, _TEXT, _NOW = (150, 150, 150), (200, 200, 200), (240, 228, 66)
_MARGIN = 18  # pixels of the curve's title, and below it
_WAY_S, _FAR_M, _SPACING_M = 30.0, 8.0, 0.05
"""What a picture shows, as little of a long recording as of a short one: the way of the last
seconds, and surroundings to a distance, of which every visit adds points: one in each cube."""


def write_film(
    path: Path,
    sequence: Sequence,
    track: Track,
    on_frames: Callable[[int], None] = lambda count: None,
    points: Float[Array, "P 3"] | None = None,
) -> None:
    """Write the film, as long as the footage, at a rate of `FILM_HZ` or little more.

    A track in the world walks over its floor, among `points` of the surroundings. A thread decodes
    and draws ahead of the encoder. Raises InputError for a track of other frames than the
    sequence's, and as VideoFile.
    """
    require_same_times(track.times, sequence.times, "the track")
    step = max(1, int(sequence.manifest.fps / FILM_HZ + 0.05))
    rows = range(0, len(sequence), step)
    pictures = FilmPictures(sequence, track, points)
    drawn = ahead(iter(rows), pictures.draw)
    with VideoFile(path, sequence.manifest.fps / step) as film:
        for index, image in zip(rows, drawn, strict=True):
            film.add(image, float(track.times[index] - track.times[0]))
            on_frames(min(step, len(sequence) - index))


class FilmPictures:
    """The pictures of a film."""

    def __init__(
        self, sequence: Sequence, track: Track, points: Float[Array, "P 3"] | None = None
    ) -> None:
        self._sequence, self._track = sequence, track
        self._points = KDTree(_thinned(np.zeros((0, 3)) if points is None else points))
        self._truth = sequence.truth.joints_head if sequence.manifest.truth else None
        rig, count = sequence.rig, len(sequence.rig.cameras)
        columns = 1 if count <= 2 else 2
        height = (HEIGHT - CURVE_HEIGHT) // ceil(count / columns) // 2 * 2
        widths = panel_widths(rig, height)
        self._panels = []
        for v, width in enumerate(widths):
            row, column = divmod(v, columns)
            top, left = row * height, HEIGHT + column * max(widths)
            self._panels.append(np.s_[top : top + height, left : left + width])
        self._reductions = [largest_reduction(c, c.height / height) for c in rig.cameras]
        shape = HEIGHT, HEIGHT + columns * max(widths), 3
        self._blank = np.full(shape, BACKGROUND, np.uint8)
        self._draw_curve(self._blank[-CURVE_HEIGHT:, HEIGHT:])

    def draw(self, index: int) -> UInt8[Array, "h w 3"]:
        """One picture, RGB."""
        canvas = self._blank.copy()
        joints, confidence = self._track.joints_head[index], self._confidence[index]
        grey = () if self._truth is None else (self._truth[index],)
        images = [self._sequence.picture(index, v, r) for v, r in enumerate(self._reductions)]
        rig = self._sequence.rig
        panels = [canvas[panel] for panel in self._panels]
        draw_views(panels, images, joints, confidence, rig, grey)
        self._draw_space(canvas[:, :HEIGHT], index, grey)
        curve = canvas[-CURVE_HEIGHT + _MARGIN :, HEIGHT:]
        now = round(index / max(len(self._sequence) - 1, 1) * (curve.shape[1] - 1))
        curve[:, max(now - 1, 0) : now + 1] = _NOW
        return canvas

    def _draw_space(
        self, canvas: UInt8[Array, "S S 3"], index: int, grey: tuple[Float[Array, "18 3"], ...]
    ) -> None:
        """The motion relative to the head, or in the world where all of it is there."""
        track, confidence = self._track, self._confidence[index]
        if track.T_world_head is None or track.joints_world is None:
            return draw_in_space(canvas, track.joints_head[index], confidence, grey)
        T = track.T_world_head[index]
        first = int(np.searchsorted(track.times, track.times[index] - _WAY_S))
        way = track.T_world_head[first : index + 1, :3, 3]
        near = self._points.query_ball_point(way[-1], _FAR_M)
        points = self._points.data[np.array(near, int)]
        stands = np.zeros(2, bool) if track.standing is None else track.standing[index]
        draw_in_world(canvas, track.joints_world[index], confidence, way, points,
                      stands, tuple(transform(T, other) for other in grey))  # fmt: skip

    @property
    def _confidence(self) -> Float[Array, "T 18"]:
        """1 where the track states none."""
        found = self._track.confidence
        return np.ones(self._track.joints_head.shape[:2]) if found is None else found

    def _draw_curve(self, canvas: UInt8[Array, "h w 3"]) -> None:
        """The mean error if the truth is known, else the least confidence, over time."""
        import cv2

        if self._truth is None:
            values, title, top = 100 * self._confidence.min(1), "least confidence, %", 100.0
        else:
            apart = np.linalg.norm(self._track.joints_head - self._truth, axis=-1)
            values, title = 1000 * apart.mean(1), "mean error, mm"
            top = max(float(values.max()), 1e-6)
        x = np.linspace(0, canvas.shape[1] - 1, len(values))
        y = CURVE_HEIGHT - 2 - values / top * (CURVE_HEIGHT - 2 * _MARGIN)
        line = np.rint(16 * np.stack([x, y], -1)).astype(np.int32)
        cv2.polylines(canvas, [line], False, _LINE, 1, cv2.LINE_AA, 4)
        cv2.putText(canvas, f"{title}, up to {top:.0f}", (6, _MARGIN - 5),
                    cv2.FONT_HERSHEY_SIMPLEX, 0.42, _TEXT, 1, cv2.LINE_AA)  # fmt: skip


def _thinned(points: Float[Array, "P 3"]) -> Float[Array, "Q 3"]:
    """One point of each cube."""
    _, kept = np.unique(np.floor(points / _SPACING_M).astype(int), axis=0, return_index=True)
    return points[kept]
