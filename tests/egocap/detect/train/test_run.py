"""Runs by command: from sequences to a file of weights, and what is refused."""

import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from egocap.cli import main
from egocap.detect.network import build_network, config_named
from egocap.detect.train.checkpoint import save_run_weights
from egocap.detect.train.config import RunConfig
from egocap.detect.train.run import split
from egocap.detect.weights import load_weights, open_weights
from egocap.errors import InputError


def egocap(*words, monkeypatch):
    monkeypatch.setattr("sys.argv", ["egocap", *map(str, words)])
    return main()


def test_command_trains_and_writes_weights(tiny_sequence, tmp_path, monkeypatch, capsys):
    out = tmp_path / "run"
    words = ["train", tiny_sequence, "--out", out, "--config", "tiny", "--steps", 2, "--batch", 2]
    assert egocap(*words, "--held-out", 0, "--json", monkeypatch=monkeypatch) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["finished"] and summary["steps"] == 2 and summary["views"] == 4
    weights = open_weights(summary["weights"])
    assert weights.config["name"] == "tiny" and weights.training["views"] == 14
    assert load_weights(summary["weights"]).config.name == "tiny"

    written = (out / "detector.safetensors").read_bytes()
    assert egocap(*words, "--held-out", 0, "--resume", monkeypatch=monkeypatch) == 0
    assert "2 steps" in capsys.readouterr().out
    assert (out / "detector.safetensors").read_bytes() == written

    assert egocap(*words, monkeypatch=monkeypatch) == 2
    assert "holds a run already" in capsys.readouterr().err
    words[words.index("--batch") + 1] = 3
    assert egocap(*words, "--resume", monkeypatch=monkeypatch) == 2
    assert "another network, seed or batch" in capsys.readouterr().err


def test_weights_tell_what_they_began_from(tiny_sequence, tiny_file, tmp_path, monkeypatch):
    words = ["train", tiny_sequence, tiny_sequence, "--shares", 1, 3, "--start", tiny_file]
    words += ["--out", tmp_path, "--config", "tiny", "--steps", 1, "--batch", 2, "--held-out", 0]
    assert egocap(*words, monkeypatch=monkeypatch) == 0
    training = open_weights(tmp_path / "detector.safetensors").training
    assert training["shares"] == [1, 3]
    assert training["start"]["sha256"] == open_weights(tiny_file).sha256


@pytest.mark.parametrize("name", ["final.safetensors", "checkpoint.pt"])
def test_damaged_initial_weights_are_refused(tiny_sequence, tmp_path, name, monkeypatch, capsys):
    network = build_network(config_named("tiny"))
    with torch.no_grad():
        network.heat.bias[3] = torch.nan
    save_run_weights(tmp_path, network, None)
    torch.save({"network": {}, "average": [1], "optimiser": {}, "state": {}, "config": "{}"},
               tmp_path / "checkpoint.pt")  # fmt: skip
    words = ["train", tiny_sequence, "--config", "tiny", "--out", tmp_path / "run"]
    assert egocap(*words, "--start", tmp_path / name, monkeypatch=monkeypatch) == 2
    err = capsys.readouterr().err
    assert name in err and len(err.splitlines()) == 1, err


def test_start_of_another_network_is_refused(
    tiny_sequence, tiny_file, tmp_path, monkeypatch, capsys
):
    words = ["train", tiny_sequence, "--out", tmp_path / "run", "--start", tiny_file]
    assert egocap(*words, monkeypatch=monkeypatch) == 2
    assert "another network" in capsys.readouterr().err


def test_nothing_to_train_on():
    with pytest.raises(InputError, match="no footage"):
        RunConfig(Path("out"))
    with pytest.raises(InputError, match=r"0 to 0\.5"):
        RunConfig(Path("out"), (Path("data"),), held_out=0.9)


@pytest.mark.parametrize("shares", [(1.0,), (1.0, 0.0), (1.0, 2.0, 3.0)])
def test_a_share_above_zero_for_each_folder(shares):
    with pytest.raises(InputError, match="one above 0 for each"):
        RunConfig(Path("out"), (Path("a"), Path("b")), shares=shares)


def test_split_shares_no_sequence():
    folders = [Path(f"s{i}") for i in range(25)]
    kept, held_out = split(folders, 0.08)
    assert len(held_out) == 3 and not set(kept) & set(held_out)
    assert sorted(kept + held_out) == sorted(folders)
    assert split(folders, 0.0) == (folders, [])


def test_a_rig_alone_is_referred_to_the_simulator(tiny_sequence, tmp_path, monkeypatch, capsys):
    rig = Path(__file__).parents[4] / "scenes/rigs/egorig1.toml"
    words = ["train", "--rig", rig, "--out", tmp_path / "run"]
    for footage in ([], [tiny_sequence]):
        assert egocap(*words, *footage, monkeypatch=monkeypatch) == 2
        assert "egocap-eval train --rig" in capsys.readouterr().err


PROGRAM = """
import atexit, os, sys
from pathlib import Path
from egocap.cli import main

def names():
    return [(task / "comm").read_text().strip() for task in Path("/proc/self/task").iterdir()]

def tell():
    os.write(2, f"\\nthreads left: {names()}\\n".encode())  # at once: other processes write, too

atexit.register(tell)
sys.exit(main())
"""


def torchrun(sequence, out, *options):
    """A start of two steps of the tiny network, which lists the threads left at its end."""
    program = out.parent / "train.py"
    program.write_text(PROGRAM)
    words = [sys.executable, "-m", "torch.distributed.run", *options]
    words += [str(program), "train", str(sequence), "--out", str(out), "--config", "tiny"]
    words += ["--steps", "2", "--batch", "2", "--held-out", "0", "--json"]
    environment = os.environ | {"OMP_NUM_THREADS": "1", "CUDA_VISIBLE_DEVICES": ""}
    return subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                            env=environment)  # fmt: skip


def test_two_processes_train_one_network(tiny_sequence, tmp_path):
    out = tmp_path / "run"
    with torchrun(tiny_sequence, out, "--standalone", "--nproc-per-node", "2") as started:
        printed, said = started.communicate()
    assert started.returncode == 0, said
    left = [line for line in said.splitlines() if line.startswith("threads left:")]
    assert len(left) == 2 and "gloo" not in "".join(left)  # they would need Python after its end
    assert json.loads(printed)["views"] == 2 * 2 * 2  # one process prints
    assert open_weights(out / "detector.safetensors").training["views_seen"] == 2 * 2 * 2


def test_two_machines_train_one_network(tiny_sequence, tmp_path):
    """As two machines that share a folder, each with its own torchrun, on this one's loopback."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    out = tmp_path / "run"
    options = ["--nnodes", "2", "--nproc-per-node", "1", "--master-addr", "127.0.0.1",
               "--master-port", str(port)]  # fmt: skip
    nodes = [torchrun(tiny_sequence, out, *options, "--node-rank", str(i)) for i in (0, 1)]
    ended = [node.communicate() for node in nodes]
    assert [node.returncode for node in nodes] == [0, 0], ended
    assert json.loads(ended[0][0])["views"] == 2 * 2 * 2
    assert not ended[1][0]  # the first machine's first process prints
    assert open_weights(out / "detector.safetensors").training["views_seen"] == 2 * 2 * 2
