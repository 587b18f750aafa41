"""Measure speed and memory of the fisheye renderer and of stock pyrender on the same scene.

    python benchmarks/rendering.py                        # both sizes, 1 and 2 workers, the ratio
    python benchmarks/rendering.py --memory-frames 2000   # and memory over that many frames

A dressed person swings arms and legs in a furnished room. Every frame is posed, rendered with
shadows for both cameras, tested for the visibility of 18 joints a view and encoded as JPEG (quality
95, 4:4:4). The stock loop renders the same meshes with `pyrender.OffscreenRenderer`, five cube
faces a camera of the same density, and resamples them. `cpu_ms` is processor time a frame and
worker; it varies less with the load of the machine than the rate. Compare within one run.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import shlex
import sys
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
SIZES = {"1280x1024": (1280, 1024), "640x512": (640, 512)}
SWING = {
    "l_upperarm": -0.8, "r_upperarm": 0.8, "l_forearm": -0.5, "r_forearm": -0.5,
    "l_thigh": 0.5, "r_thigh": -0.5, "l_calf": 0.4, "r_calf": 0.4,
}  # fmt: skip


class BenchmarkScene:
    """Person, room, rig and the pose at a time."""

    def __init__(self, size: tuple[int, int]) -> None:
        from egocap.cameras.rig_files import load_rig
        from egocap_sim.environment.places import make_place
        from egocap_sim.human.clothing.wardrobe import make_person

        self.rig = load_rig(ROOT / "scenes/rigs/egorig1.toml").resized(*size)
        self.person = make_person(3, headgear="helmet")
        self.place = make_place("room", np.random.default_rng(3))

    def triangles(self) -> int:
        """Number of triangles of person and room."""
        return sum(len(m.faces) for m in (*self.person.actor.meshes, *self.place.meshes))

    def pose(self, seconds: float) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Head pose and skinning transforms."""
        from egocap import geometry
        from egocap_sim.core.bodies import BODIES, INDEX, PARENTS

        joints = self.person.joints
        T = np.zeros((len(BODIES), 4, 4))
        for b, (body, parent) in enumerate(zip(BODIES, PARENTS, strict=True)):
            R = geometry.axis_angle(geometry.LEFT, SWING.get(body, 0.0) * np.sin(5 * seconds))
            step = joints[b] - (joints[parent] if parent >= 0 else 0.0)
            local = geometry.rigid(R, step)
            T[b] = T[parent] @ local if parent >= 0 else local
        skinning = T @ geometry.rigid(np.eye(3), -joints)
        return T[INDEX["head"]], {self.person.actor.name: skinning}


def encode(images) -> int:
    """Bytes of the JPEG files of one frame."""
    import simplejpeg

    return sum(
        len(simplejpeg.encode_jpeg(i, quality=95, colorspace="RGB", colorsubsampling="444"))
        for i in images
    )


def render_fisheye(size: tuple[int, int], frames: int, barrier, results) -> None:
    """Render frames after all workers have rendered their first, report seconds and memory."""
    from egocap_sim.render.renderer import FisheyeRenderer

    stage = BenchmarkScene(size)
    rng = np.random.default_rng(0)
    joints = rng.uniform(0.2, 0.8, (2, 18, 2)) * size
    with FisheyeRenderer(stage.rig, [stage.person.actor], stage.place) as renderer:
        memory = []

        def frame(i: int) -> None:
            views = renderer.render(*stage.pose(i / 30))
            for v in range(2):
                views.surface_at(v, joints[v])
            encode(views.images)

        for i in range(3):
            frame(i)
        barrier.wait()
        start, busy = time.perf_counter(), time.process_time()
        for i in range(frames):
            frame(i)
            if i % 100 == 0 or i == frames - 1:
                memory.append(_resident_mb())
        results.put(_outcome(start, busy, frames, memory))


def render_stock(size: tuple[int, int], frames: int, barrier, results) -> None:
    """The same with stock pyrender: one call a cube face, new meshes of the person a frame."""
    import cv2

    from egocap_sim.render.batch import merge
    from egocap_sim.render.fisheye import build_atlas
    from egocap_sim.render.gl import pyrender

    stage = BenchmarkScene(size)
    atlas = build_atlas(stage.rig.cameras)
    face = round(2 * atlas.tiles[0].density)
    # All five faces of a cube before the camera, without a crop to the field of view.
    turns = [_turn(y, x) for y, x in ((0, 0), (90, 0), (-90, 0), (0, 90), (0, -90))]
    maps = [_five_face_map(c, turns, face) for c in stage.rig.cameras]
    scene = pyrender.Scene(ambient_light=np.full(3, 0.35))
    light = pyrender.DirectionalLight(color=np.ones(3), intensity=3.0)
    scene.add(light, pose=np.eye(4))
    for m in stage.place.meshes:
        scene.add(_stock_mesh(pyrender, m, m.vertices))
    meshes = stage.person.actor.meshes
    batches = [merge([m]) for m in meshes]
    camera = scene.add(pyrender.PerspectiveCamera(np.pi / 2, znear=0.01, zfar=60.0))
    renderer = pyrender.OffscreenRenderer(face, face)
    nodes: list = []
    flip = np.diag([1.0, -1.0, -1.0, 1.0])

    def frame(i: int) -> None:
        T_world_head, skinning = stage.pose(i / 30)
        for node in nodes:
            scene.remove_node(node)
        nodes.clear()
        for m, batch in zip(meshes, batches, strict=True):
            posed = batch.pose(skinning[stage.person.actor.name])[0][: len(m.vertices)]
            nodes.append(scene.add(_stock_mesh(pyrender, m, posed)))
        images = []
        for mount, (x, y) in zip(stage.rig.mounts, maps, strict=True):
            faces = []
            for turn in turns:
                pose = T_world_head @ mount.T_head_camera
                pose = pose @ np.block([[turn, np.zeros((3, 1))], [0, 0, 0, 1]]) @ flip
                scene.set_pose(camera, pose)
                faces.append(renderer.render(scene)[0])
            images.append(cv2.remap(np.hstack(faces), x, y, cv2.INTER_LINEAR))
        encode(images)

    frame(0)
    barrier.wait()
    start, busy = time.perf_counter(), time.process_time()
    for i in range(frames):
        frame(i)
    results.put(_outcome(start, busy, frames, [_resident_mb()]))


def measure(work, size: tuple[int, int], workers: int, frames: int) -> dict:
    """Run `workers` processes at once; frames a second of all, and memory of the largest."""
    os.environ |= {"LP_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    spawn = multiprocessing.get_context("spawn")
    barrier, results = spawn.Barrier(workers), spawn.Queue()
    processes = [
        spawn.Process(target=work, args=(size, frames, barrier, results)) for _ in range(workers)
    ]
    for p in processes:
        p.start()
    found = [results.get(timeout=900) for _ in processes]
    for p in processes:
        p.join()
    rate = workers * frames / max(f["seconds"] for f in found)
    cpu = float(np.mean([f["cpu_ms"] for f in found]))
    memory = max((f["memory_mb"] for f in found), key=max)
    return {"fps": round(rate, 2), "cpu_ms": round(cpu, 1), "memory_mb": memory}


def main() -> None:
    """Measure, and print a table or JSON."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--frames", type=int, default=60, help="0 measures memory alone")
    parser.add_argument("--stock-frames", type=int, default=6, help="0 leaves stock pyrender out")
    parser.add_argument("--memory-frames", type=int, default=0)
    parser.add_argument("--size", choices=SIZES, action="append")
    parser.add_argument("--workers", type=int, action="append")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--out", type=Path, help="file for the result with command and machine")
    args = parser.parse_args()
    rows = []
    for name in args.size or SIZES:
        for workers in (args.workers or [1, 2]) if args.frames else []:
            row = {"size": name, "workers": workers}
            row |= measure(render_fisheye, SIZES[name], workers, args.frames)
            if args.stock_frames:
                other = measure(render_stock, SIZES[name], workers, args.stock_frames)
                row |= {"stock_fps": other["fps"], "stock_cpu_ms": other["cpu_ms"]}
                row["ratio"] = round(row["fps"] / other["fps"], 2)
                row["cpu_ratio"] = round(other["cpu_ms"] / row["cpu_ms"], 2)
            rows.append(row)
            if not args.json:
                print({k: v for k, v in row.items() if k != "memory_mb"}, flush=True)
    result: dict = {"rows": rows}
    if args.memory_frames:
        size = SIZES[(args.size or [*SIZES])[0]]
        result["memory"] = measure(render_fisheye, size, 1, args.memory_frames)
    if args.out:
        from egocap_eval.harness.result_file import save_result

        save_result(
            args.out, result, shlex.join(["python", "benchmarks/rendering.py", *sys.argv[1:]])
        )
    print(json.dumps(result) if args.json else result.get("memory", ""))


def _outcome(start: float, busy: float, frames: int, memory: list[float]) -> dict:
    return {
        "seconds": time.perf_counter() - start,
        "cpu_ms": (time.process_time() - busy) / frames * 1e3,
        "memory_mb": memory,
    }


def _resident_mb() -> float:
    return round(int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6, 1)


def _turn(yaw: float, pitch: float) -> np.ndarray:
    """Camera-from-face rotation, degrees: yaw about y (right), pitch about x (up)."""
    from egocap.geometry import axis_angle

    y = axis_angle(np.array([0.0, 1.0, 0.0]), np.radians(yaw))
    return y @ axis_angle(np.array([1.0, 0.0, 0.0]), np.radians(pitch))


def _five_face_map(camera, turns, face: int):
    x, y = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays, valid = camera.ray(np.stack([x, y], -1).astype(float))
    which = np.argmax(np.stack([rays @ t[:, 2] for t in turns], -1), -1)
    at = np.full((*valid.shape, 2), -9.0, np.float32)
    for i, t in enumerate(turns):
        mine = valid & (which == i)
        out = rays[mine] @ t
        at[mine] = (out[:, :2] / out[:, 2:] * 0.5 + 0.5) * face - 0.5
        at[mine] = np.clip(at[mine], 0, face - 1) + [i * face, 0]
    return at[..., 0], at[..., 1]


def _stock_mesh(pyrender, mesh, vertices):
    from egocap_sim.render.batch import vertex_normals

    texture = pyrender.Texture(source=np.ascontiguousarray(mesh.texture), source_channels="RGB")
    material = pyrender.MetallicRoughnessMaterial(
        baseColorTexture=texture, metallicFactor=0.0, doubleSided=mesh.double_sided
    )
    return pyrender.Mesh([
        pyrender.Primitive(
            positions=vertices, normals=vertex_normals(vertices, mesh.faces),
            texcoord_0=mesh.uv.astype(np.float32), indices=mesh.faces, material=material,
        )
    ])  # fmt: skip


if __name__ == "__main__":
    main()
