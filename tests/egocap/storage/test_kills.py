"""One recording on a cluster into a store, while the server, a worker and the client are killed."""

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import time
import urllib.request

import fsspec
import pytest

from egocap.storage.copies import fetch
from egocap_sim.record.recorder import generate
from egocap_sim.scene.config import to_toml
from egocap_sim.verification.integrity import verify

pytest.importorskip("moto.server")
distributed = pytest.importorskip("distributed")
FRAMES, NAME = 60, "kills"
SERVE = """
import sys
from moto.core import DEFAULT_ACCOUNT_ID
from moto.s3.models import s3_backends
from moto.server import main

s3_backends[DEFAULT_ACCOUNT_ID]["aws"].create_bucket(sys.argv[2], "us-east-1")
main(["-H", "127.0.0.1", "-p", sys.argv[1]])
"""


def free_port():
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


class Server:
    """A server of S3 in a process of its own. What is killed has lost everything."""

    def __init__(self, port):
        self.address, self.port = f"http://127.0.0.1:{port}", port
        self.start()

    def start(self):
        command = [sys.executable, "-c", SERVE, str(self.port), NAME]
        self.process = subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        while True:
            with contextlib.suppress(OSError), urllib.request.urlopen(self.address, timeout=60):
                break
            assert self.process.poll() is None
            time.sleep(0.1)

    def kill(self):
        self.process.kill()
        self.process.wait()

    def shards(self):
        """Number of shards that the manifest on the store lists."""
        system = fsspec.filesystem("s3")
        system.invalidate_cache()
        try:
            return len(json.loads(system.cat_file(f"{NAME}/walk/manifest.json"))["shards"])
        except Exception:
            return 0


@pytest.fixture
def server(monkeypatch, tmp_path):
    server = Server(free_port())
    for name, value in {"AWS_ACCESS_KEY_ID": "a", "AWS_SECRET_ACCESS_KEY": "b",
                        "AWS_ENDPOINT_URL": server.address, "AWS_DEFAULT_REGION": "us-east-1",
                        "XDG_CACHE_HOME": str(tmp_path / "cache")}.items():  # fmt: skip
        monkeypatch.setenv(name, value)
    fsspec.filesystem("s3").clear_instance_cache()
    yield server
    server.kill()


def wait_for_more(server, process, shards):
    while server.shards() < shards:
        assert process.poll() is None, process.returncode
        time.sleep(0.05)


def test_nothing_is_lost(server, tiny_scene, tmp_path):
    scene = tiny_scene.model_copy(update={"frames": FRAMES})
    (tmp_path / "walk.toml").write_text(to_toml(scene))
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs=50
    ) as cluster:
        words = ["generate", str(tmp_path / "walk.toml"), "--out", f"s3://{NAME}/walk"]
        command = [sys.executable, "-m", "egocap_sim", *words]
        command += ["--cluster", cluster.scheduler_address]

        def run():
            return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)

        client = run()
        wait_for_more(server, client, 2)
        os.kill(next(iter(cluster.workers.values())).pid, signal.SIGKILL)
        wait_for_more(server, client, 6)
        client.kill()
        client.communicate()
        client = run()
        wait_for_more(server, client, 8)
        server.kill()
        assert client.poll() is None, "all was sent before the server was killed"
        time.sleep(1.0)
        server.start()
        _, said = client.communicate()
        assert client.returncode == 0, said
    with pytest.MonkeyPatch.context() as other:
        other.setenv("XDG_CACHE_HOME", str(tmp_path / "elsewhere"))
        path = fetch(f"s3://{NAME}/walk")
    assert verify(path).clean
    generate(scene, tmp_path / "local", workers=0)
    for name in (p.name for p in (tmp_path / "local").iterdir()):
        assert (path / name).read_bytes() == (tmp_path / "local" / name).read_bytes(), name
