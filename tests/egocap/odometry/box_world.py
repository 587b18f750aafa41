"""Exact pictures of the inside of a textured box, for any camera: an oracle without a renderer."""

import numpy as np

from egocap.cameras.camera import Camera
from egocap.cameras.rig import Mount, Rig, camera_rotation
from egocap.geometry import inverse, rigid

LOW, HIGH = np.array([-4.0, -3.5, 0.0]), np.array([4.5, 3.0, 3.0])  # m
TEXEL = 0.05  # m


def small_rig(width=320, height=256):
    """EgoRig1's mounting at a small size."""
    focal = width / np.pi
    camera = Camera("equidistant", width, height, ((width - 1) / 2, (height - 1) / 2),
                    ((focal, 0.0), (0.0, focal)), max_angle=np.pi / 2)  # fmt: skip
    R = camera_rotation(90.0)
    return Rig("box", tuple(
        Mount(name, camera, rigid(R, np.array([0.37, y, 0.14])))
        for name, y in (("left", 0.175), ("right", -0.175))
    ))  # fmt: skip


class BoxWorld:
    """A room whose faces carry smooth random texture."""

    def __init__(self, seed=0, contrast=60.0, scale=1.0, texel=TEXEL):
        rng = np.random.default_rng(seed)
        side = int(12.0 / TEXEL)
        self.low, self.high, self.texel = scale * LOW, scale * HIGH, scale * texel
        self.texture = 128.0 + contrast * rng.normal(size=(6, side, side)).clip(-2, 2)

    def picture(self, rig, view, T_world_head, rows=slice(None)):
        """Grey picture of one view, 8 bits, or some of its rows."""
        mount = rig.mounts[view]
        camera = mount.camera
        pixels = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), -1)[rows]
        rays, valid = camera.ray(pixels.astype(float))
        T = T_world_head @ mount.T_head_camera
        d = rays.reshape(-1, 3) @ T[:3, :3].T
        values = self._seen(T[:3, 3], d).reshape(valid.shape)
        return np.where(valid, values, 0.0).round().clip(0, 255).astype(np.uint8)

    def pictures(self, rig, T_world_head):
        return tuple(self.picture(rig, v, T_world_head) for v in range(len(rig.mounts)))

    def rolling(self, rig, poses):
        """Pictures of all views whose bands of rows, from the top, are taken at these poses."""
        edges = np.linspace(0, rig.cameras[0].height, len(poses) + 1).round().astype(int)
        return tuple(
            np.vstack([self.picture(rig, v, T, slice(a, b))
                       for T, a, b in zip(poses, edges, edges[1:], strict=False)])
            for v in range(len(rig.mounts))
        )  # fmt: skip

    def _seen(self, origin, d):
        with np.errstate(divide="ignore", invalid="ignore"):
            reach = np.where(d > 0, (self.high - origin) / d, (self.low - origin) / d)
        axis = np.nanargmin(np.where(np.isfinite(reach), reach, np.inf), axis=1)
        rows = np.arange(len(d))
        points = origin + reach[rows, axis, None] * d
        face = 2 * axis + (d[rows, axis] > 0)
        others = np.array([[1, 2], [0, 2], [0, 1]])[axis]
        u, v = (np.take_along_axis(points - self.low, others, 1) / self.texel).T
        return self._texture(face, u, v)

    def _texture(self, face, u, v):
        """Smoothly interpolated texture (smoothstep), so that pictures have derivatives."""
        side = self.texture.shape[1]
        i, j = np.floor(v).astype(int), np.floor(u).astype(int)
        b, a = v - i, u - j
        b, a = b * b * (3 - 2 * b), a * a * (3 - 2 * a)
        i, j = i % (side - 1), j % (side - 1)
        t = self.texture
        top = (1 - a) * t[face, i, j] + a * t[face, i, j + 1]
        bottom = (1 - a) * t[face, i + 1, j] + a * t[face, i + 1, j + 1]
        return (1 - b) * top + b * bottom


def walk(frames, speed=0.9, turn=0.5, fps=30.0):
    """T_world_head of a head that walks a curve, bobs and sways."""
    t = np.arange(frames) / fps
    yaw = turn * t
    nod = 0.08 * np.sin(6.0 * t)
    x = np.cumsum(np.cos(yaw)) * speed / fps - 1.5
    y = np.cumsum(np.sin(yaw)) * speed / fps - 1.0
    z = 1.62 + 0.02 * np.sin(12.0 * t)
    c, s = np.cos(yaw), np.sin(yaw)
    cn, sn = np.cos(nod), np.sin(nod)
    o, i = np.zeros_like(t), np.ones_like(t)
    Rz = np.stack([np.stack([c, -s, o], -1), np.stack([s, c, o], -1), np.stack([o, o, i], -1)], 1)
    Ry = np.stack(
        [np.stack([cn, o, sn], -1), np.stack([o, i, o], -1), np.stack([-sn, o, cn], -1)], 1
    )
    return rigid(Rz @ Ry, np.stack([x, y, z], -1))


def apart(true, found):
    """Distances [m] and angles [rad] between poses, the first ones aligned."""
    off = inverse(true) @ (true[0] @ inverse(found[0])) @ found
    angle = np.arccos(np.clip((np.trace(off[:, :3, :3], axis1=1, axis2=2) - 1) / 2, -1, 1))
    return np.linalg.norm(off[:, :3, 3], axis=1), angle
