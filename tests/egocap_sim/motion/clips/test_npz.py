from __future__ import annotations

import io
import zipfile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from egocap.errors import FileError
from egocap_sim.core.bodies import BODIES
from egocap_sim.motion.clips.npz import read_npz_clip

SHORT = {"clavicle": "clav", "upperarm": "arm", "forearm": "fore"}


def arrays(T: int = 4) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    q = Rotation.random(T * 21, random_state=1).as_quat()[:, [3, 0, 1, 2]]
    names = [b if b[1] != "_" else b[0] + SHORT.get(b[2:], b[2:]) for b in BODIES]
    return {
        "joints": np.array(names), "pos": rng.normal(size=(T, 21, 3)),
        "quat": q.reshape(T, 21, 4), "fps": np.array(60.0),
    }  # fmt: skip


def test_names_and_order_are_ours(tmp_path) -> None:
    data = arrays()
    order = np.random.default_rng(3).permutation(21)
    np.savez(tmp_path / "a.npz", joints=data["joints"][order], pos=data["pos"][:, order],
             quat=data["quat"][:, order], fps=data["fps"])  # fmt: skip
    p, R, fps = read_npz_clip(tmp_path / "a.npz")
    np.testing.assert_allclose(p, data["pos"])
    expected = Rotation.from_quat(data["quat"][2, 7, [1, 2, 3, 0]]).as_matrix()
    np.testing.assert_allclose(R[2, 7], expected, atol=1e-12)
    assert fps == 60.0


@pytest.mark.parametrize(
    ("key", "value", "says"),
    [
        ("pos", np.zeros((4, 20, 3)), "key 'pos'"),
        ("pos", np.full((4, 21, 3), np.nan), "not finite"),
        ("quat", np.zeros((4, 21, 4)), "length one"),
        ("quat", np.zeros((3, 21, 4)), "shape"),
        ("fps", np.array(0.0), "key 'fps'"),
        ("fps", np.array([1.0, 2.0]), "key 'fps'"),
        ("joints", np.array(["paw"] * 21), "unknown joints paw"),
        ("joints", np.array([1] * 21), "text"),
        ("pos", np.array([None]), "plain arrays"),
    ],
)
def test_defects_name_the_key(tmp_path, key: str, value: np.ndarray, says: str) -> None:
    np.savez(tmp_path / "a.npz", **(arrays() | {key: value}))
    with pytest.raises(FileError, match=says):
        read_npz_clip(tmp_path / "a.npz")


@pytest.mark.parametrize("key", ["joints", "pos", "quat", "fps"])
def test_missing_keys(tmp_path, key: str) -> None:
    np.savez(tmp_path / "a.npz", **{k: v for k, v in arrays().items() if k != key})
    with pytest.raises(FileError, match=f"'{key}'.*missing"):
        read_npz_clip(tmp_path / "a.npz")


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_damage_is_an_error_or_harmless(data: st.DataObject, tmp_path_factory) -> None:
    path = tmp_path_factory.getbasetemp() / "damaged.npz"
    np.savez_compressed(path, **arrays())
    raw = bytearray(path.read_bytes())
    if data.draw(st.booleans()):
        raw = raw[: data.draw(st.integers(0, len(raw) - 1))]
    else:
        for _ in range(3):
            raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(raw)
    try:
        p, _, _ = read_npz_clip(path)
    except FileError:
        return
    assert p.shape == (4, 21, 3)


def test_not_an_archive(tmp_path) -> None:
    np.save(tmp_path / "a.npy", np.zeros(3))
    (tmp_path / "a.npy").rename(tmp_path / "a.npz")
    with pytest.raises(FileError):
        read_npz_clip(tmp_path / "a.npz")


@pytest.mark.parametrize("damaged", [b"NUMPY", b"}"])
def test_damaged_array_header(tmp_path, damaged: bytes) -> None:
    data = io.BytesIO()
    np.save(data, arrays()["pos"])
    raw = data.getvalue().replace(damaged, b"(" * len(damaged), 1)
    np.savez(tmp_path / "a.npz", **{k: v for k, v in arrays().items() if k != "pos"})
    with zipfile.ZipFile(tmp_path / "a.npz", "a") as archive:
        archive.writestr("pos.npy", raw)
    with pytest.raises(FileError, match="plain arrays"):
        read_npz_clip(tmp_path / "a.npz")
