"""Head poses of a sequence by structure from motion: SIFT, and all frames adjusted by COLMAP.

The slow reference of the odometry. The cameras are one rig of known lenses and mounts, which gives
the scale. Source: Schoenberger and Frahm 2016; rigs as in COLMAP 4.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Int, UInt8
from numpy import ndarray as Array

from egocap.cameras.camera import Camera
from egocap.cameras.camera_set import CameraSet, SetCamera
from egocap.cameras.colmap import format_colmap
from egocap.cameras.lens_fit import exact
from egocap.cameras.rig import Rig
from egocap.data.sequence import Sequence
from egocap.data.track import Track
from egocap.errors import InputError, require
from egocap.geometry import inverse, rigid
from egocap.head_pose.config import SfmConfig
from egocap.head_pose.estimate import Advance, spread_over
from egocap.head_pose.floor import Pictured
from egocap.head_pose.map_poses import MapPoses
from egocap.head_pose.pictures import grey_frames
from egocap.head_pose.wearer import WearerMasks
from egocap.odometry.views import Motion, Views

if TYPE_CHECKING:
    import pycolmap

RIM = np.deg2rad(80.0)  # off the axis; COLMAP's solvers need rays well in front of a camera
NO_POSE = "not registered with the other frames"


def by_structure_from_motion(
    sequence: Sequence, config: SfmConfig, rig: Rig, track: Track | None, advance: Advance
) -> MapPoses:
    """Poses of the largest model that COLMAP builds. InputError where it builds none.

    The wearer is masked where a track is given; else features that keep their place in the picture
    are left out. Raises MachineError without pycolmap.
    """
    require("pycolmap", "world")
    import pycolmap

    views = Views.of(rig, config.width)
    frames = [*range(0, len(sequence) - 1, config.every), len(sequence) - 1]
    wearer = None if track is None else WearerMasks(track, views)
    pycolmap.logging.minloglevel = pycolmap.logging.Level.FATAL  # type: ignore[misc]
    with tempfile.TemporaryDirectory(prefix="egocap-sfm-") as folder:
        work = Path(folder)
        kept = _write_pictures(sequence, frames, views, wearer, work)
        _match(work, views, config, masked=wearer is not None)
        found = _map(work, lambda: advance(config.every))
    if found is None:
        raise InputError(f"{sequence.folder}: no head pose in {len(sequence)} frames: {NO_POSE}",
                         valid="pictures with texture in two views at once")  # fmt: skip
    adjusted = _adjusted(found, views)
    known, T_map_head = between(adjusted, sequence.times, config.every)
    points: Float[Array, "P 3"] = np.array([p.xyz for p in found.points3D.values()]).reshape(-1, 3)
    facts = {"method": "sfm", "adjusted": len(adjusted), "points": len(points),
             "residual_px": round(float(found.compute_mean_reprojection_error()), 3)}  # fmt: skip
    reasons = dict.fromkeys(set(range(len(sequence))) - set(known.tolist()), NO_POSE)
    return MapPoses(known, sequence.times[known], T_map_head, None, points, views, facts, reasons,
                    kept)  # fmt: skip


def _write_pictures(
    sequence: Sequence, frames: list[int], views: Views, wearer: WearerMasks | None, work: Path
) -> dict[int, Pictured]:
    """PICTURES/VIEW/FRAME.png, and under masks what is neither the wearer nor the lens's rim.

    Returns some pictures for the floor.
    """
    kept, wanted = {}, {frames[i] for i in spread_over(len(frames))}
    lens = [_within_rim(camera, mask)
            for camera, mask in zip(views.cameras, views.lens_masks, strict=True)]  # fmt: skip
    for view in range(len(views)):
        for kind in ("pictures", "masks"):
            (work / kind / str(view)).mkdir(parents=True)
    for index, images in grey_frames(sequence, views.rig, frames):
        if index in wanted:
            kept[index] = Pictured(images, Motion.none(len(views)))
        bodies = (None,) * len(views) if wearer is None else wearer.at(float(sequence.times[index]))
        for view, (image, body) in enumerate(zip(images, bodies, strict=True)):
            if image is None:
                continue
            mask = lens[view] if body is None else np.where(body, 0, lens[view]).astype(np.uint8)
            _write(work / "pictures" / str(view) / f"{index:07d}.png", image)
            _write(work / "masks" / str(view) / f"{index:07d}.png.png", mask)
    return kept


def _within_rim(camera: Camera, mask: UInt8[Array, "H W"]) -> UInt8[Array, "H W"]:
    pixels = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), -1)
    rays, _ = camera.ray(pixels.astype(float))
    return np.where(rays[..., 2] > np.cos(RIM), mask, 0).astype(np.uint8)


def _write(path: Path, image: UInt8[Array, "H W"]) -> None:
    import cv2

    path.write_bytes(cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes())


def _match(work: Path, views: Views, config: SfmConfig, masked: bool) -> None:
    """Features of all pictures, and those that agree in pictures near in time, in COLMAP's file."""
    import pycolmap

    database = work / "database.db"
    extraction = pycolmap.FeatureExtractionOptions(use_gpu=False)
    extraction.sift.max_num_features = config.features
    for view, camera in enumerate(views.cameras):
        reader = pycolmap.ImageReaderOptions(
            mask_path=work / "masks", camera_model="OPENCV_FISHEYE",
            camera_params=_parameters(camera),
        )  # fmt: skip
        pycolmap.extract_features(
            database, work / "pictures", sorted(_names(work, view)),
            camera_mode=pycolmap.CameraMode.PER_FOLDER, reader_options=reader,
            extraction_options=extraction,
        )  # fmt: skip
    with pycolmap.Database.open(database) as opened:
        pycolmap.apply_rig_config([_rig(views)], opened)
    pairing = pycolmap.SequentialPairingOptions(overlap=config.overlap, quadratic_overlap=True)
    geometry = pycolmap.TwoViewGeometryOptions(filter_stationary_matches=not masked)
    geometry.ransac.random_seed = 0
    pycolmap.match_sequential(
        database, matching_options=pycolmap.FeatureMatchingOptions(use_gpu=False),
        pairing_options=pairing, verification_options=geometry,
    )  # fmt: skip


def _parameters(camera: Camera) -> str:
    """Of COLMAP's OPENCV_FISHEYE, as in its cameras.txt."""
    text, _ = format_colmap(CameraSet((SetCamera("view", exact(camera)),)))
    return ",".join(text.split()[-8:])


def _names(work: Path, view: int) -> Iterator[str]:
    for path in (work / "pictures" / str(view)).iterdir():
        yield f"{view}/{path.name}"


def _rig(views: Views) -> pycolmap.RigConfig:
    """The rig, with the first camera as its frame."""
    import pycolmap

    T_rig_head = views.T_camera_head[0]
    cameras = [pycolmap.RigConfigCamera(ref_sensor=True, image_prefix="0/")]
    for view in range(1, len(views)):
        T = views.T_camera_head[view] @ inverse(T_rig_head)
        cameras.append(pycolmap.RigConfigCamera(
            ref_sensor=False, image_prefix=f"{view}/", cam_from_rig=pycolmap.Rigid3d(T[:3])
        ))  # fmt: skip
    return pycolmap.RigConfig(cameras=cameras)


def _map(work: Path, advance: Callable[[], None]) -> pycolmap.Reconstruction | None:
    """The model with the most frames, lenses and mounts held; None where there is none."""
    import pycolmap

    options = pycolmap.IncrementalPipelineOptions(
        ba_refine_focal_length=False, ba_refine_extra_params=False,
        ba_refine_sensor_from_rig=False, extract_colors=False, random_seed=0,
    )  # fmt: skip
    (work / "models").mkdir()
    models: dict[int, Any] = pycolmap.incremental_mapping(
        work / "database.db", work / "pictures", work / "models", options=options,
        next_image_callback=advance,
    )  # fmt: skip
    return max(models.values(), key=lambda model: model.num_reg_frames(), default=None)


def _adjusted(found: pycolmap.Reconstruction, views: Views) -> dict[int, Float[Array, "4 4"]]:
    """T_map_head of the frames of a model."""
    poses = {}
    for image in found.images.values():
        if image.has_pose:
            T = image.frame.rig_from_world
            T_map_rig = inverse(rigid(T.rotation.matrix(), np.array(T.translation)))
            poses[int(Path(image.name).stem)] = T_map_rig @ views.T_camera_head[0]
    return poses


def between(
    poses: dict[int, Float[Array, "4 4"]], times: Float[Array, "T"], every: int
) -> tuple[Int[Array, "N"], Float[Array, "N 4 4"]]:
    """Frames with a pose, and those between two poses that are `every` frames apart, by splines."""
    from scipy.interpolate import CubicSpline
    from scipy.spatial.transform import Rotation, RotationSpline

    frames, found = np.array(sorted(poses)), []
    for stretch in np.split(frames, np.flatnonzero(np.diff(frames) > every) + 1):
        known = np.stack([poses[int(f)] for f in stretch])
        rows = np.arange(stretch[0], stretch[-1] + 1)
        if len(stretch) > 1:
            turn = RotationSpline(times[stretch], Rotation.from_matrix(known[:, :3, :3]))
            place = CubicSpline(times[stretch], known[:, :3, 3])
            known = rigid(turn(times[rows]).as_matrix(), place(times[rows]))
        found.append((rows, known))
    return np.concatenate([r for r, _ in found]), np.concatenate([T for _, T in found])
