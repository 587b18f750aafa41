"""More formats under test: samples of a posterior, trajectories, contacts, and footage.

Each function writes valid files below a folder and returns what reads them, as in `targets`.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from egocap.body.labels import LABELS
from egocap.body.proportions import Proportions
from egocap.data.footage import Footage, FootageView, FrameTimes
from egocap.data.head_pose import HeadPoses, in_world
from egocap.data.sequence import Sequence
from egocap.data.track import load_track, save_track

FINGERPRINT = "0" * 64
_STEP = 1_700_000_000_000_000_000  # ns: EuRoC's times are since 1970


def samples(work: Path) -> list[tuple[str, Path, Any]]:
    """A posterior and the chain of an interrupted run: name, file and reader."""
    from emcee import State

    from egocap.posterior.backend import NpzBackend
    from egocap.posterior.result import Posterior, load_posterior, save_posterior

    rng, chain, result = np.random.default_rng(0), work / "chain.npz", work / "posterior.npz"
    W, S, N, K = 6, 5, 3, 2
    backend = NpzBackend(chain, FINGERPRINT)
    backend.reset(W, N)
    backend.grow(S, None)
    for _ in range(S):
        state = State(rng.random((W, N)), rng.random(W),
                      random_state=np.random.RandomState(0).get_state())  # fmt: skip
        backend.save_step(state, np.ones(W, bool))
    backend.save()
    save_posterior(result, Posterior(
        names=("a", "b", "c"), draws=rng.random((W, S, N)), log_prob=rng.random((W, S)),
        joints=rng.random((W, S, len(LABELS), 3)), modes=rng.random((K, N)),
        mode_log_mass=rng.random(K), mode_share=rng.random(K),
        laplace_joints=np.tile(np.eye(3), (len(LABELS), 1, 1)), effective=rng.random(N),
        tail_effective=rng.random(N), rhat=rng.random(N), acceptance=0.3, steps=S, burn_in=0,
        converged=True, outcome="converged", notes=(), frame=0, time=0.0, seconds=1.0, config={},
    ))  # fmt: skip
    return [
        ("chain.npz", chain, lambda path: NpzBackend(path, FINGERPRINT).get_last_sample()),
        ("posterior.npz", result, lambda path: load_posterior(path).summary()),
    ]


def live(work: Path) -> list[tuple[str, Path, Any]]:
    """A track as a short live run writes it, and one that is exported as BVH."""
    from egocap.data.bvh import bvh_text
    from egocap.data.resampling import evenly
    from egocap.track.online import PoseEstimate
    from egocap.view.live_run import LiveReport
    from egocap.view.pose_log import pose_log

    track, file, exported = (work / f"track{n}.npz" for n in ("", "-live", "-exported"))
    tracked = load_track(track)
    assert tracked.covariance is not None and tracked.confidence is not None
    assert tracked.offsets is not None
    by_frame = zip(tracked.times, tracked.angles, tracked.joints_head, tracked.covariance,
                   tracked.confidence, tracked.converged, strict=True)  # fmt: skip
    with pose_log(file) as log:
        for values in by_frame:
            log.append(PoseEstimate(*values))
        report = LiveReport(len(tracked.times), seconds=0.1)
        save_track(file, log.take(Proportions(tracked.offsets), "simulated", report))
    save_track(exported, tracked)
    return [
        (file.name, file, load_track),
        (exported.name, exported, lambda path: bvh_text(evenly(load_track(path)))),
    ]


def contacts(work: Path) -> list[tuple[str, Path, Any]]:
    """The network of foot contacts, and a track in the world with contacts."""
    from egocap.world.contact_network import FILE, load_contact_network

    track, world = load_track(work / "track.npz"), work / "track-world.npz"
    T = len(track.times)
    moved = in_world(track, HeadPoses(np.tile(np.eye(4), (T, 1, 1)), np.ones(T, bool)))
    save_track(world, replace(moved, contacts=np.full((T, 4), 0.5)))
    return [
        ("contact_network.npz", FILE, load_contact_network.__wrapped__),
        ("track-world.npz", world, load_track),
    ]


def trajectories(work: Path) -> list[tuple[str, Path, Any]]:
    """Trajectories of other programs, one of every format, and an IMU's measurements."""
    from egocap.head_pose.imu_files import read_imu
    from egocap.head_pose.trajectory_files import read_trajectory

    place = ",".join(f"t{a}_world_device" for a in "xyz")
    turn = ",".join(f"q{a}_world_device" for a in "xyzw")
    header = {
        "tum": "", "colmap": "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n",
        "euroc": "#timestamp,p_RS_R_x,p_RS_R_y,p_RS_R_z,q_RS_w,q_RS_x,q_RS_y,q_RS_z\n",
        "aria": f"tracking_timestamp_us,{place},{turn}\n",
        "arkit": "time,x,y,z,qx,qy,qz,qw\n", "openxr": "xr_time_ns,x,y,z,qx,qy,qz,qw\n",
    }  # fmt: skip
    row = {
        "tum": "{t:.3f} 0.1 0.2 1.6 0 0 0 1\n",
        "colmap": "{n} 1 0 0 0 0.1 0.2 0.3 1 left/{n:06d}.png\n1.0 2.0 -1\n",
        "euroc": "{ns},0.1,0.2,1.6,1,0,0,0\n", "aria": "{n}00000,0.1,0.2,1.6,0,0,0,1\n",
        "arkit": "{t:.3f},0.1,1.6,0.2,0,0,0,1\n", "openxr": "{ns},0.1,1.6,0.2,0,0,0,1\n",
    }  # fmt: skip
    found = []
    for form, first in header.items():
        file = work / f"{form}.{'txt' if form in ('tum', 'colmap') else 'csv'}"
        rows = [row[form].format(n=n, t=n / 30, ns=_STEP + n * 33_333_333) for n in range(1, 6)]
        file.write_text(first + "".join(rows))
        found.append((file.name, file, read_trajectory))
    imu, still = work / "imu.csv", "0.1,0.2,0.3,0.1,0.2,9.8"
    rows = [f"{n / 200:.3f},{still}\n" for n in range(120)]
    imu.write_text("timestamp_s,gx,gy,gz,ax,ay,az\n" + "".join(rows))
    return [*found, ("imu.csv", imu, read_imu)]


def footage(sequence: Sequence, work: Path) -> Path:
    """A sequence of footage whose pictures lie beside it; an earlier one is taken up."""
    from egocap.data.manifest import SCHEMA, Manifest
    from egocap.data.sequence_writer import SequenceWriter
    from egocap.media.pictures import PictureOptions

    folder, pictures = work / "footage", work / "pictures"
    if folder.exists():
        return folder
    T, views = len(sequence), sequence.manifest.views
    entries = []
    for name in views:
        (pictures / name).mkdir(parents=True)
        for t in range(T):
            (pictures / name / f"{t}.jpg").write_bytes(sequence.read(t, f"{name}.jpg"))
        size = sum(file.stat().st_size for file in (pictures / name).iterdir())
        entries.append(FootageView(name=name, path=str(pictures / name), bytes=size,
                                   options=PictureOptions(fps=30), sha256="0" * 64))  # fmt: skip
    time = np.arange(T) / 30.0
    both = np.repeat(time[:, None], len(views), 1)
    places = np.repeat(np.arange(T)[:, None], len(views), 1)
    times = FrameTimes(time, both, places, np.ones(places.shape, bool))
    files = {
        "rig.json": json.dumps(sequence.rig.to_dict()).encode(),
        "footage.json": Footage(views=tuple(entries)).model_dump_json().encode(),
        "times.npz": times.content(),
    }
    manifest = Manifest(
        schema_version=SCHEMA, name="footage", fps=30.0, frames=T, shard_frames=50, views=views,
        seed=0, truth=False, shards_hold_images=False, config={}, config_sha256="0" * 64,
        code_version="1",
    )  # fmt: skip
    with SequenceWriter(folder, manifest, files) as writer:
        writer.begin()
    return folder


def use_footage(folder: Path) -> None:
    """Read every frame of footage."""
    for frame in Sequence(folder):
        assert len(frame.images) == len(frame.present)
