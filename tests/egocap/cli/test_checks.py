"""Files that a command needs late are refused at its start, in one line."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from egocap.data.sequence import Sequence
from tests.egocap.cli.test_cli import complaint


@pytest.fixture
def bad(tmp_path, tiny_sequence, monkeypatch):
    """Files to refuse in the current folder; no sequence is read, imported or detected."""

    def late(*args, **options):
        raise AssertionError("the file was refused too late")

    for name in ("egocap.cli.tracking.detections_from", "egocap.cli.showing.detections_from",
                 "egocap.motion_capture.capture.import_footage",
                 "egocap.adaptation.adapt.track_footage"):  # fmt: skip
        monkeypatch.setattr(name, late)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bad.json").write_text("{")
    (tmp_path / "bad.npz").write_bytes(b"PK\x03\x04")
    (tmp_path / "bad.safetensors").write_bytes(b"\0" * 64)
    times = np.arange(3) / 30.0
    far = np.tile(np.eye(4), (3, 1, 1))
    far[:, 0, 3] = 1e9
    np.savez("far.npz", time=times, T_world_head=far)
    Sequence(tiny_sequence).rig.to_json(tmp_path / "rig.json")
    shutil.copytree(tiny_sequence, "LONG")
    manifest = json.loads(Path("LONG/manifest.json").read_text())
    Path("LONG/manifest.json").write_text(json.dumps(manifest | {"fps": 0.5}))  # 7 frames, 12 s
    Path("tracked").mkdir()
    Path("tracked/sequence").symlink_to(tmp_path / "LONG")


@pytest.mark.parametrize(
    ("words", "says"),
    [("track SEQ --out o.npz --head-pose bad.npz", "bad.npz: not a whole npz archive"),
     ("track SEQ --out o.npz --head-pose far.npz", "1e+09 m from the origin (valid: up to 100,000"),
     ("track SEQ --out o.npz --body bad.json", "bad.json, line 1: not JSON"),
     ("track SEQ --out o.npz --rig bad.json", "bad.json, line 1: not JSON"),
     ("posterior SEQ --frame 2 --out o.npz --checkpoint bad.npz", "bad.npz: not a whole npz"),
     ("posterior SEQ --frame 2 --out o.npz --checkpoint far.npz", "far.npz: not a chain"),
     ("posterior SEQ --frame 2 --out o.npz --body bad.json", "bad.json, line 1: not JSON"),
     ("posterior SEQ --frame 7 --out o.npz", "no frame 7 in SEQ (valid: 0 to 6)"),
     ("posterior SEQ --frame 2 --out o.npz --page p.pdf", "--page p.pdf"),
     ("mocap a b --rig rig.json --out o --head-pose bad.npz", "bad.npz: not a whole npz"),
     ("mocap a b --rig rig.json --out o --head-pose far.npz", "1e+09 m from the origin"),
     ("mocap a b --rig rig.json --out o --weights bad.safetensors", "bad.safetensors: "),
     ("mocap a b --rig rig.json --out o --weights none.safetensors", "no such file"),
     ("mocap a b --rig rig.json --out o --body bad.json", "bad.json, line 1: not JSON"),
     ("adapt LONG --out o --weights bad.safetensors", "bad.safetensors: "),
     ("adapt LONG --out o --body bad.json", "bad.json, line 1: not JSON"),
     ("adapt LONG --out o --body fit", "--body fit"),
     ("adapt LONG none --out o", "none: no such folder"),
     ("adapt LONG SEQ --out o", "footage of 0.2 s (valid: 10 s or more)"),
     ("adapt LONG tracked --out o", "detections.npz: no such file")],
)  # fmt: skip
def test_bad_files_are_refused_before_the_work(egocap, bad, tiny_sequence, tmp_path, words, says):
    if words.startswith("adapt"):
        pytest.importorskip("torch")
    (tmp_path / "SEQ").symlink_to(tiny_sequence)
    assert says in complaint(egocap(*words.split()))
    assert not (tmp_path / "o.npz").exists() and not (tmp_path / "o").exists()
