"""Render fisheye views of posed actors in an environment, all cube faces in one atlas.

A frame: pose the vertices, draw the shadow map, draw each tile of the atlas, read colour and part
labels (in alpha) together, and resample the fisheye pixels with `cv2.remap`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache, partial

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from egocap.cameras.camera import Camera
from egocap.errors import InputError
from egocap_sim.assets.mesh import Actor
from egocap_sim.environment.place import Place
from egocap_sim.render import projection
from egocap_sim.render.batch import Batch, merge
from egocap_sim.render.contact import ContactShadows
from egocap_sim.render.fisheye import Atlas, build_atlas
from egocap_sim.render.framebuffer import AtlasBuffer, Window
from egocap_sim.render.gl import GL, Context, check_errors, pyrender
from egocap_sim.render.gpu import GpuBatch, Uniforms
from egocap_sim.render.shadow import shadow_map
from egocap_sim.render.views import Resampler, Views

NEAR, FAR = 0.01, 120.0  # metres; 24 bits of depth leave 0.2 mm at 5 m
"""The sky, 55 m around the origin, is drawn for wearers as far as a place is large."""
_SCENE = 0  # pyrender.RenderFlags.NONE
_LABELS = pyrender.RenderFlags.SEG
_SHADOW = pyrender.RenderFlags.DEPTH_ONLY


@lru_cache(maxsize=2)
def _traced(
    cameras: tuple[Camera, ...], face_size: int | None, sharpness: float
) -> tuple[Atlas, Resampler]:
    """The atlas of cameras and its resampler; cached for the next episode."""
    atlas = build_atlas(cameras, face_size, sharpness)
    return atlas, Resampler(atlas)


class _Canvas:
    """An atlas, its resampler and its framebuffer."""

    def __init__(
        self, cameras: tuple[Camera, ...], face_size: int | None, sharpness: float, samples: int
    ) -> None:
        self.atlas, self.resampler = _traced(cameras, face_size, sharpness)
        self.buffer = AtlasBuffer(self.atlas.needed, samples)


class FisheyeRenderer(pyrender.Renderer):
    """Render a rig's views of actors in an environment, in this process and thread.

    Parameters: `samples` is 0, or 4 for anti-aliased outlines at about three times the cost;
    `face_size` as in `fisheye.build_atlas`; `coarse` is the sharpness, as there, of frames
    drawn `coarsely`.
    Raises: MachineError without OpenGL, InputError for actors of the same name.
    The same inputs give the same bytes on the same driver. Close it, or use it in a `with`.
    """

    def __init__(
        self,
        rig,
        actors: Sequence[Actor],
        place: Place,
        samples: int = 0,
        face_size: int | None = None,
        coarse: float = 1.0,
    ) -> None:
        names = [a.name for a in actors]
        if len(set(names)) != len(names):
            raise InputError(f"actors need different names, got {', '.join(names)}")
        self.rig, self.place = rig, place
        self._make_canvas = partial(_Canvas, tuple(rig.cameras), face_size, samples=samples)
        self.context = Context.borrow()
        self._coarse, self._canvases = coarse, {1.0: self._make_canvas(1.0)}
        self._canvas = self._canvases[1.0]
        super().__init__(self._canvas.atlas.width, self._canvas.atlas.height)
        self._program_cache = self.context.programs
        self._uniforms = Uniforms()
        self._batches: dict[str | None, Batch] = {a.name: merge(a.meshes) for a in actors}
        if place.meshes:
            self._batches[None] = merge(place.meshes)  # last: mostly occluded by the actors
        self._gpu = {name: GpuBatch(batch) for name, batch in self._batches.items()}
        for gpu in self._gpu.values():
            gpu.primitive._add_to_context()
        self._meshes = {gpu.mesh for gpu in self._gpu.values()}  # which `delete` frees
        # Resolution on the floor similar to that of the image.
        finest = max(t.density for t in self._canvas.atlas.tiles)
        self._shadow = shadow_map(place.light.spread, fine=finest > 250)
        self._contact = ContactShadows(len(actors)) if actors and place.contact else None
        self._boxes: dict[str | None, tuple[Array, Array]] = {
            name: batch.boxes(batch.positions) for name, batch in self._batches.items()
        }
        self._posed: dict[str, Array] = {}  # current vertex positions of actors
        self._shadowing: dict[str, Array] = {}  # and those of the shadow map
        self._views: Views | None = None
        self._earlier: Views | None = None  # whose colours the next frame overwrites

    def render(
        self,
        T_world_head: Float[Array, "4 4"],
        skinning: Mapping[str, Float[Array, "B 4 4"]],
        rows: Mapping[int, slice] | None = None,
        still_m: float = 0.0,
        coarsely: bool = False,
    ) -> Views:
        """Draw all views with the head at a pose and the actors under their skinning transforms.

        With `rows`, only these rows of these views are drawn; others are undefined. The shadow
        map is reused while no vertex has moved by `still_m` metres. `coarsely` draws at lower
        sharpness, for sub-frames that are averaged. The lazy parts of the result (`parts`, `depth`,
        `surface_at`) are valid until the next call.
        Raises: InputError if an actor has no transforms, or too few.
        """
        self._require_transforms(skinning)
        self.context.make_current()
        for name in self._batches:
            if name is not None:
                positions, normals = self._batches[name].pose(np.asarray(skinning[name]))
                self._gpu[name].upload(positions, normals)
                self._boxes[name] = self._batches[name].boxes(positions)
                self._posed[name] = positions
        sharpness = self._coarse if coarsely else 1.0
        if sharpness not in self._canvases:
            self._canvases[sharpness] = self._make_canvas(sharpness)
        self._canvas = self._canvases[sharpness]
        T_world_camera = [T_world_head @ m.T_head_camera for m in self.rig.mounts]
        tiles = self._canvas.atlas.tiles
        self._clip = [
            projection.tile_projection(t, T_world_camera[t.view], NEAR, FAR) for t in tiles
        ]
        self._eyes = [T_world_camera[t.view][:3, 3] for t in tiles]
        self._windows = [self._window(i, rows) for i in range(len(tiles))]
        if self._has_moved(still_m):
            self._shadow_from_world = self._draw_shadows(T_world_head[:3, 3])
            self._shadowing = dict(self._posed)
        if self._contact is not None:
            self._contact.pose(self._posed)
        self._draw_scene(self._shadow_from_world)
        if self._earlier is not None:
            _ = self._earlier.images  # resampled, if nobody has asked for them
        atlas = self._canvas.buffer.read_color()
        check_errors()
        if self._views is not None:
            self._views.expired = True
        self._earlier, self._views = (
            self._views,
            Views(self, self.rig.cameras, self._canvas.resampler, atlas, rows),
        )
        return self._views

    def _window(self, tile: int, rows: Mapping[int, slice] | None) -> Window | None:
        """The part of a tile that is needed for rows of its view; None if empty."""
        t = self._canvas.atlas.tiles[tile]
        if rows is None:
            return t.column, t.row, t.width, t.height
        if t.view not in rows:
            return None
        extent = self._canvas.resampler.extent[tile, rows[t.view]]
        (left, _, low, _), (_, right, _, high) = extent.min(0).tolist(), extent.max(0).tolist()
        return (left, low, right - left, high - low) if right > left and high > low else None

    def _has_moved(self, still_m: float) -> bool:
        """Whether an actor has moved by `still_m` metres since the shadow map was drawn."""
        if not still_m or self._shadowing.keys() != self._posed.keys():
            return True
        return any(
            float(np.abs(positions - self._shadowing[name]).max()) >= still_m
            for name, positions in self._posed.items()
        )

    def close(self) -> None:
        """Free all resources; the renderer cannot be used afterwards. Closing twice is allowed."""
        if getattr(self, "context", None) is None:
            return
        self.context.make_current()
        for gpu in self._gpu.values():
            gpu.free()
        self._shadow.free()
        if self._contact is not None:
            self._contact.free()
        for canvas in self._canvases.values():
            canvas.buffer.free()
        self._program_cache = (
            pyrender.shader_program.ShaderProgramCache()
        )  # the context keeps its programs
        self.delete()
        self.context.release()
        del self.context

    def __enter__(self) -> FisheyeRenderer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __del__(self) -> None:
        """Do nothing: `close` frees; at exit the OpenGL library may be unloaded already."""

    def read_depth(self) -> Float[Array, "h w"]:
        """Metres along the face's z axis at every atlas pixel."""
        self._prepare_depth()
        return projection.linear_depth(self._canvas.buffer.read_depth(), NEAR, FAR)

    def read_depth_at(self, at: Int[Array, "N 2"]) -> Float[Array, "N"]:
        """Metres along the face's z axis at some atlas pixels (column, row)."""
        self._prepare_depth()
        return projection.linear_depth(self._canvas.buffer.read_depth_at(at), NEAR, FAR)

    def read_labels(self) -> Array:
        """Part labels of the atlas (h, w) uint8, not multisampled."""
        self.context.make_current()
        if not self._canvas.buffer.has_labels:
            if self._canvas.buffer.samples:
                self._draw_labels()
            else:
                self._canvas.buffer.take_labels()
        return self._canvas.buffer.labels

    def _prepare_depth(self) -> None:
        self.context.make_current()
        if self._canvas.buffer.samples and not self._canvas.buffer.has_labels:
            self._draw_labels()

    def _require_transforms(self, skinning: Mapping[str, Array]) -> None:
        for name, batch in self._batches.items():
            if name is not None and batch.n_bones and name not in skinning:
                raise InputError(f"no skinning transforms for actor '{name}'", valid=skinning)

    def _draw_shadows(self, focus: Float[Array, "3"]) -> Array:
        """Draw the shadow map; return the matrix from the world to its texture coordinates."""
        clip = projection.light_projection(self.place.light.direction, focus, self._shadow.size)
        self._shadow.begin()
        for gpu in self._gpu.values():
            program = self._program(gpu, _SHADOW)
            self._uniforms.matrix(program, "clip_from_world", clip)
            gpu.draw(gpu.casts_shadow)
        self._shadow.end(clip)
        return projection.TO_TEXTURE @ clip

    def _draw_scene(self, shadow_from_world: Array) -> None:
        light = self.place.light
        windows = [window for window in self._windows if window is not None]
        self._canvas.buffer.begin(np.sqrt(self.place.background), windows)
        self._shadow.bind(unit=1)
        for name, gpu in self._gpu.items():
            program = self._program(gpu, _SCENE)
            set_ = self._uniforms
            set_.matrix(program, "shadow_from_world", shadow_from_world)
            set_.vector(program, "to_light", -light.direction)
            set_.vector(program, "light_color", light.color)
            set_.vector(program, "sky_color", light.sky)
            set_.vector(program, "ground_color", light.ground)
            set_.vector(program, "sky_axis", light.sky_axis)
            set_.vector(program, "room", self.place.room)
            gpu.bind_textures(unit=0)
            self._draw_tiles(name, gpu, program, with_eye=True)
        if self._contact is not None and self._contact.count:
            self._draw_contact(self._contact)
        self._canvas.buffer.end()

    def _draw_contact(self, contact: ContactShadows) -> None:
        program = self._compiled("contact")
        contact.begin()
        for clip, _, _ in self._visible_tiles(*contact.boxes()):
            self._uniforms.matrix(program, "clip_from_world", clip)
            contact.draw()
        contact.end()

    def _draw_labels(self) -> None:
        self._canvas.buffer.begin_labels()
        for name, gpu in self._gpu.items():
            self._draw_tiles(name, gpu, self._program(gpu, _LABELS), with_eye=False)
        self._canvas.buffer.end_labels()

    def _draw_tiles(self, name: str | None, gpu: GpuBatch, program, *, with_eye: bool) -> None:
        for clip, eye, seen in self._visible_tiles(*self._boxes[name]):
            self._uniforms.matrix(program, "clip_from_world", clip)
            if with_eye:
                self._uniforms.vector(program, "eye", eye)
            gpu.draw(seen)

    def _visible_tiles(self, low: Array, high: Array) -> Iterator[tuple[Array, Array, Array]]:
        """Set the viewport to each tile whose frustum intersects some of the boxes (low, high).

        Yields its clip-from-world matrix, its eye, and which boxes intersect.
        """
        for tile, clip, eye, window in zip(
            self._canvas.atlas.tiles, self._clip, self._eyes, self._windows, strict=True
        ):
            if window is None:
                continue
            cropped = projection.crop_projection(clip, tile, window)
            seen = projection.intersects_frustum(cropped, low, high)
            if seen.any():
                GL.glViewport(tile.column, tile.row, tile.width, tile.height)
                GL.glScissor(*window)
                yield clip, eye, seen

    def _program(self, gpu: GpuBatch, flags: int):
        program = self._get_primitive_program(
            gpu.primitive,
            flags,
            0 if flags == _SHADOW else pyrender.constants.ProgramFlags.USE_MATERIAL,
        )
        if flags == _SCENE and self._shadow.defines:
            return self._compiled("mesh", {**program.defines, **self._shadow.defines})
        program._bind()
        return program

    def _compiled(self, name: str, defines: Mapping[str, int] | None = None):
        """The program of a pair of shaders, bound."""
        program = self._program_cache.get_program(f"{name}.vert", f"{name}.frag", defines=defines)
        if not program._in_context():
            program._add_to_context()
        program._bind()
        return program
