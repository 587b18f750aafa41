"""The formats under test: a valid file of each, and what reads it.

A reader also uses what it has read, as far as a command would before its own work begins.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from egocap.body.gaussians import GaussianBody
from egocap.body.proportions import Proportions
from egocap.cameras.camera_files import load_camera
from egocap.cameras.rig import Rig
from egocap.cameras.rig_files import load_rig
from egocap.data.dataset import Dataset, EpisodeEntry, episode_name, load_dataset
from egocap.data.detections import load_detections, save_detections
from egocap.data.head_pose import in_world, read_head_poses
from egocap.data.sequence import Sequence
from egocap.data.track import load_track, save_track
from egocap_eval.fuzz import result_targets, work_targets
from egocap_eval.fuzz.calibration_targets import calibrations

Load = Callable[[Path], Any]


@dataclass(frozen=True)
class Target:
    """One format. `load` gets the path of a mutated copy of `file`.

    With `folder`, the whole of it is copied, and `load` gets that copy.
    """

    name: str
    file: Path
    load: Load
    folder: Path | None = None


def make_targets(sequence: Path, work: Path) -> list[Target]:
    """Write a valid file of every format below `work`, from a short recording with depth."""
    work.mkdir(parents=True, exist_ok=True)
    made = [make(Sequence(sequence), work) for make in (
        _cameras, _bodies, _results, _predictions, _clips, _scenes, _weights, _recordings,
        _samples,
    )]  # fmt: skip
    return [target for group in made for target in group]


def make_target(sequence: Path, name: str, work: Path) -> Target:
    """The target of this name, with the valid files of all of them below `work`."""
    return next(target for target in make_targets(sequence, work) if target.name == name)


def _cameras(sequence: Sequence, work: Path) -> list[Target]:
    from egocap_sim.core.resources import builtin_file

    rig = work / "rig.json"
    shutil.copy(sequence.folder / "rig.json", rig)
    camera = work / "camera.json"
    camera.write_text(json.dumps(json.loads(rig.read_text())["mounts"][0]["camera"]))
    ocam = work / "ocam.txt"
    ocam.write_text("5 -215.1 0 1.56e-3 -1.5e-7 2.1e-9\n3 310.0 200.1 -10.5\n256.4 320.2\n"
                    "1.0 1e-4 -1e-4\n512 640\n")  # fmt: skip
    toml = shutil.copy(builtin_file("rig", "egorig1"), work / "rig.toml")
    return [
        Target("rig.json", rig, lambda path: _use_rig(load_rig(path))),
        Target("rig.toml", Path(toml), lambda path: _use_rig(load_rig(path))),
        Target("camera.json", camera, load_camera),
        Target("ocam.txt", ocam, load_camera),
    ]


def _use_rig(rig: Rig) -> None:
    """Project and cast rays, as every stage does."""
    points = np.array([[0.1, 0.2, -0.4], [0.3, -0.2, -1.2], [0.0, 0.0, -1.6]])
    pixels, jacobian, valid = rig.project_jacobian(points)
    assert np.isfinite(pixels[valid]).all() and np.isfinite(jacobian[valid]).all()
    origins, rays, seen = rig.rays(np.nan_to_num(pixels))
    assert np.isfinite(origins).all() and np.isfinite(rays[seen]).all()


def _bodies(sequence: Sequence, work: Path) -> list[Target]:
    from egocap.pose.motion_network import FILE as NETWORK
    from egocap.pose.motion_network import load_motion_network
    from egocap.pose.motion_prior import FILE as MOTION
    from egocap.pose.motion_prior import load_motion_prior
    from egocap.pose.pose_prior import FILE as POSTURE
    from egocap.pose.pose_prior import load_posture

    gaussians = work / "gaussians.json"
    GaussianBody.from_proportions(sequence.body).save(gaussians)
    return [
        Target("body.json", sequence.folder / "body.json", Proportions.load),
        Target("gaussians.json", gaussians, GaussianBody.load),
        Target("posture.json", POSTURE, load_posture.__wrapped__),
        Target("motion_prior.npz", MOTION, load_motion_prior.__wrapped__),
        Target("motion_network.npz", NETWORK, load_motion_network.__wrapped__),
    ]


def _results(sequence: Sequence, work: Path) -> list[Target]:
    from egocap.detect.sources import synthetic_detections
    from egocap.track.tracker import Tracker
    from egocap_eval.harness.check import load_baseline

    detections, track, poses = (work / f"{n}.npz" for n in ("detections", "track", "head_pose"))
    found = synthetic_detections(sequence)
    save_detections(detections, found)
    save_track(track, Tracker(sequence.rig, sequence.body).track(found))
    truth = sequence.truth
    np.savez(poses, time=truth.time, T_world_head=truth.T_world_head)
    baseline = work / "baseline.json"
    numbers = {"a": {"value": 1.0, "tolerance": 0.1, "better": "lower", "unit": "mm"}}
    baseline.write_text(json.dumps({"schema": 1, "command": "c", "result": {"numbers": numbers}}))
    tracked = load_track(track)
    return [
        Target("detections.npz", detections, load_detections),
        Target("track.npz", track, load_track),
        Target("head_pose.npz", poses,
               lambda path: in_world(tracked, read_head_poses(path, tracked.times))),
        Target("baseline.json", baseline, load_baseline),
    ]  # fmt: skip


def _predictions(sequence: Sequence, work: Path) -> list[Target]:
    from egocap.evaluation.predictions import Predictions, load_predictions, save_predictions

    truth = sequence.truth
    found = np.ones(truth.joints_head.shape[:2], bool)
    predictions = Predictions(truth.joints_head, found, "head", "m", times=truth.time)
    targets = []
    for suffix in (".npz", ".jsonl"):
        file = work / f"predictions{suffix}"
        save_predictions(file, predictions)
        targets.append(Target(file.name, file, load_predictions))
    return targets


def _clips(sequence: Sequence, work: Path) -> list[Target]:
    from egocap.data.bvh import write_bvh
    from egocap_sim.core.bodies import BODIES
    from egocap_sim.motion.clips.load import load_clip
    from egocap_sim.motion.clips.npz import read_npz_clip
    from egocap_sim.motion.clips.skeleton_names import read_name_map

    bvh, npz, names = work / "clip.bvh", work / "clip.npz", work / "names.toml"
    write_bvh(bvh, load_track(work / "track.npz"))
    rng = np.random.default_rng(0)
    quat = np.tile([1.0, 0.0, 0.0, 0.0], (3, len(BODIES), 1))
    np.savez(npz, joints=np.array(BODIES), pos=rng.random((3, len(BODIES), 3)), quat=quat, fps=30.0)
    names.write_text("".join(f'{body} = "{body}"\n' for body in BODIES[:6]))
    return [
        Target("clip.bvh", bvh, load_clip),
        Target("clip.npz", npz, read_npz_clip),
        Target("names.toml", names, read_name_map),
    ]


def _scenes(sequence: Sequence, work: Path) -> list[Target]:
    from egocap_eval.harness.suite import FOLDER, load_suite
    from egocap_sim.scene.config import load_scene

    suite = work / "suite.toml"
    lines = (FOLDER / "quick.toml").read_text().splitlines(keepends=True)
    suite.write_text("".join(line for line in lines if not line.startswith("rows_file")))
    scene = Path(shutil.copy(sequence.folder / "scene.toml", work / "scene.toml"))
    return [
        Target("suite.toml", suite, load_suite),
        Target("scene.toml", scene, load_scene),
    ]


def _weights(sequence: Sequence, work: Path) -> list[Target]:
    import torch

    from egocap.detect.network import build_network, config_named
    from egocap.detect.train.checkpoint import restore_checkpoint, save_checkpoint
    from egocap.detect.weights import load_weights, save_weights
    from egocap_sim.environment.texture_folder import read_picture

    network = build_network(config_named("tiny"))
    weights, run, picture = work / "weights.safetensors", work / "run", work / "texture.jpg"
    save_weights(weights, network)
    run.mkdir(exist_ok=True)
    training = network, network, torch.optim.AdamW(network.parameters())
    saved = save_checkpoint(run, *training, {"step": 1})
    picture.write_bytes(sequence.read(0, f"{sequence.manifest.views[0]}.jpg"))
    return [
        Target("weights.safetensors", weights, load_weights),
        Target("checkpoint.pt", saved, lambda f: restore_checkpoint(f, *training), run),
        Target("picture.jpg", picture, read_picture),
    ]


def _recordings(sequence: Sequence, work: Path) -> list[Target]:
    folder = sequence.folder
    episodes = work / "episodes"
    episodes.mkdir(exist_ok=True)
    index = episodes / "episodes.json"
    entry = EpisodeEntry(index=0, name=episode_name(0), frames=3, seed=0, bytes=9, sha256="0" * 64)
    data = Dataset(schema_version=1, name="a", frames=3, parts=[3], seed=0, config={"a": 1},
                   config_sha256="0" * 64, code_version="1", episodes=[entry])  # fmt: skip
    index.write_text(data.model_dump_json())
    inside = ("manifest.json", "rig.json", "body.json", "truth.npz", "scene.toml",
              "shard-00000.tar")  # fmt: skip
    return [
        *(Target(f"sequence/{name}", folder / name, _use_sequence, folder) for name in inside),
        Target("episodes.json", index, load_dataset, episodes),
    ]


def _samples(sequence: Sequence, work: Path) -> list[Target]:
    made: list[Iterable[tuple[Any, ...]]] = [
        result_targets.samples(work), result_targets.live(work), result_targets.contacts(work),
        result_targets.trajectories(work), calibrations(sequence, work),
        work_targets.training(sequence, work), work_targets.results(work),
        work_targets.datasets(sequence, work), work_targets.stores(sequence, work),
    ]  # fmt: skip
    folder = result_targets.footage(sequence, work)
    return [
        *(Target(*parts) for group in made for parts in group),
        *(Target(f"footage/{name}", folder / name, result_targets.use_footage, folder)
          for name in ("footage.json", "times.npz")),
    ]  # fmt: skip


def _use_sequence(folder: Path) -> None:
    """Verify a recording; then read what it holds, whatever the verification said."""
    from egocap_sim.verification.integrity import verify

    verify(folder)
    sequence = Sequence(folder)
    for read in (lambda: sequence.truth, lambda: sequence.body, lambda: _use_rig(sequence.rig),
                 lambda: sequence.frame(0)):  # fmt: skip
        read()
