"""What each image row needs of the atlas, against a look at all its pixels."""

from __future__ import annotations

from egocap_sim.render.fisheye import build_atlas
from egocap_sim.render.views import Resampler

from .conftest import equidistant


def test_rows_need_the_atlas_pixels_that_they_look_up():
    resampler = Resampler(build_atlas([equidistant(64, 48), equidistant(40, 56)]))
    atlas = resampler.atlas
    for t, extent in zip(atlas.tiles, resampler.extent, strict=True):
        left, top = t.column, t.row
        right, bottom = left + t.width, top + t.height
        for y, row in enumerate(atlas.lookup[t.view]):
            x0, x1, y0, y1 = extent[y]
            mine = (row >= [left, top]).all(-1) & (row <= [right - 1, bottom - 1]).all(-1)
            for at in row[mine]:
                assert x0 <= at[0] <= x1 - 1 and y0 <= at[1] <= y1 - 1
            if x1 > x0:
                assert left <= x0 and x1 <= right and top <= y0 and y1 <= bottom
