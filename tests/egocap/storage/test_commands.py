"""Commands with addresses in place of paths, on a server that speaks S3."""

import json
import logging
import os
import signal
import subprocess
import sys
import time

import fsspec
import pytest

from egocap import cli
from egocap.data.track import load_track
from egocap.storage.copies import Copy, fetch
from egocap_sim.scene.config import to_toml
from egocap_sim.verification.integrity import verify

moto = pytest.importorskip("moto.server")


@pytest.fixture(scope="module")
def server():
    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    server = moto.ThreadedMotoServer("127.0.0.1", port=0, verbose=False)
    server.start()
    yield server
    server.stop()


@pytest.fixture
def bucket(server, monkeypatch, tmp_path):
    """Address of an empty bucket; the environment of its user."""
    host, port = server.get_host_and_port()
    for name, value in {"AWS_ACCESS_KEY_ID": "a", "AWS_SECRET_ACCESS_KEY": "b",
                        "AWS_ENDPOINT_URL": f"http://{host}:{port}",
                        "AWS_DEFAULT_REGION": "us-east-1",
                        "XDG_CACHE_HOME": str(tmp_path / "cache")}.items():  # fmt: skip
        monkeypatch.setenv(name, value)
    fsspec.filesystem("s3").clear_instance_cache()
    fsspec.filesystem("s3").mkdir(tmp_path.name)
    return f"s3://{tmp_path.name}"


def command(*words, env=None):
    run = [sys.executable, "-m", *map(str, words)]
    return subprocess.run(run, capture_output=True, text=True, env={**os.environ, **(env or {})})


def test_a_sequence_is_made_tracked_and_scored_by_address(bucket, tiny_scene, tmp_path):
    scene = tmp_path / "tiny.toml"
    scene.write_text(to_toml(tiny_scene))
    walk, track = f"{bucket}/data/walk", f"{bucket}/walk.npz"
    made = command("egocap_sim", "generate", scene, "--workers", 0, "--out", walk)
    assert made.returncode == 0 and f"{walk}: sent" in made.stderr, made.stderr
    elsewhere = {"XDG_CACHE_HOME": str(tmp_path / "elsewhere")}
    words = ("egocap", "track", walk, f"--out={track}", "--detections", "simulated:2")
    tracked = command(*words, env=elsewhere)
    assert tracked.returncode == 0, tracked.stderr
    assert len(load_track(fetch(track)).times) == 7
    scored = command("egocap_eval", "pose", walk, "--track", track, "--json", env=elsewhere)
    assert scored.returncode == 0 and json.loads(scored.stdout), scored.stderr
    again = command("egocap_sim", "generate", scene, "--out", walk, env=elsewhere)
    assert again.returncode == 0 and "already complete" in again.stdout, again.stderr


def test_what_a_killed_client_has_sent_is_continued_on_another_machine(
    bucket, tiny_scene, tiny_sequence, tmp_path
):
    scene = tiny_scene.model_copy(update={"frames": 60})
    (tmp_path / "walk.toml").write_text(to_toml(scene))
    out = f"{bucket}/walk"
    words = [sys.executable, "-m", "egocap_sim", "generate", str(tmp_path / "walk.toml"),
             "--workers", "0", "--out", out]  # fmt: skip
    process = subprocess.Popen(words, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
    manifest = f"{tmp_path.name}/walk/manifest.json"
    system, shards = fsspec.filesystem("s3"), 0
    while process.poll() is None and shards < 2:
        system.invalidate_cache()
        if system.exists(manifest):
            shards = len(json.loads(system.cat_file(manifest))["shards"])
        time.sleep(0.05)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert shards >= 2
    elsewhere = {"XDG_CACHE_HOME": str(tmp_path / "elsewhere")}
    made = command("egocap_sim", "generate", tmp_path / "walk.toml", "--out", out, "--json",
                   env=elsewhere)  # fmt: skip
    assert made.returncode == 0, made.stderr
    assert json.loads(made.stdout)["rendered"] <= 60 - 2 * shards
    path = fetch(out)
    assert verify(path).clean
    first = json.loads((tiny_sequence / "manifest.json").read_text())["shards"][0]
    assert json.loads((path / "manifest.json").read_text())["shards"][0] == first


def test_a_server_that_is_down_at_the_end_gets_the_rest_later(bucket, server, tmp_path):
    host, port = server.get_host_and_port()
    with Copy(f"{bucket}/x").held() as copy:
        copy.path.mkdir()
        (copy.path / "a.txt").write_text("a")
        copy.send()
        server.stop()
        (copy.path / "b.txt").write_text("b")
        from threading import Timer

        again = moto.ThreadedMotoServer(host, port=port, verbose=False)
        Timer(0.5, again.start).start()
        assert copy.send_all() == 1
        assert sorted(copy.store.listing()) == ["a.txt", "b.txt"]
        again.stop()
        server.start()


def test_workers_of_a_cluster_fetch_what_they_track(bucket, tiny_sequence, monkeypatch, cluster):
    fsspec.filesystem("s3").put(str(tiny_sequence), f"{bucket}/data/walk", recursive=True)
    monkeypatch.setattr(sys, "argv", [
        "egocap", "track", f"{bucket}/data", "--cluster", cluster,
        "--detections", "simulated:2", f"--out={bucket}/tracks",
    ])  # fmt: skip
    assert cli.main() == 0
    assert len(load_track(fetch(f"{bucket}/tracks/data-walk.track.npz")).times) == 7
    assert fetch(f"{bucket}/tracks/recordings.json").is_file()


@pytest.mark.parametrize(
    ("words", "says"),
    [(("track", "s3://no-such-bucket-of-ours/walk", "--out", "x.npz"), "no such place"),
     (("track", "BUCKET/none", "--out", "x.npz"), "there is nothing there")],
)  # fmt: skip
def test_what_is_not_there_is_one_line(bucket, tmp_path, words, says):
    ran = command("egocap", *(word.replace("BUCKET", bucket) for word in words))
    assert ran.returncode == 2 and ran.stdout == ""
    assert says in ran.stderr and len(ran.stderr.splitlines()) == 1
