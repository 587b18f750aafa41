"""Exported tracks as independent readers find them."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from egocap.body.labels import LABEL_INDEX, LABELS
from egocap.body.proportions import Proportions
from egocap.body.skeleton import DOFS, LIMITS, forward
from egocap.data.detections import Detections
from egocap.data.track import Track
from egocap.errors import InputError
from egocap.export.coco import write_coco
from egocap.export.formats import FORMATS, format_of
from egocap.geometry import axis_angle, rigid, transform

NODES = {
    "neck": "Neck", "left_shoulder": "LeftArm", "left_elbow": "LeftForeArm",
    "left_wrist": "LeftHand", "right_shoulder": "RightArm", "right_elbow": "RightForeArm",
    "right_wrist": "RightHand", "left_hip": "LeftUpLeg", "left_knee": "LeftLeg",
    "left_ankle": "LeftFoot", "right_hip": "RightUpLeg", "right_knee": "RightLeg",
    "right_ankle": "RightFoot",
}  # fmt: skip
GLTF_TO_OURS = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])  # x left, y up, z forward


@pytest.fixture(scope="module", params=["head", "world"])
def track(request):
    rng = np.random.default_rng(4)
    angles = rng.uniform(LIMITS[:, 0], LIMITS[:, 1], (9, 37))
    person = Proportions.from_lengths(1.8)
    joints = forward(person, angles)
    found = Track(
        np.arange(9) / 25, angles, joints, np.zeros(9), np.ones(9, bool), np.zeros(9), 0.001, {},
        offsets=np.array(person.offsets), covariance=np.tile(4e-4 * np.eye(3), (9, 18, 1, 1)),
    )  # fmt: skip
    if request.param == "head":
        return found
    T = rigid(axis_angle(np.array([0, 0.6, 0.8]), rng.normal(size=9)), rng.normal(size=(9, 3)))
    known = np.arange(9) != 4
    return replace(found, T_world_head=T, joints_world=transform(T, joints), in_world=known)


def expected(track):
    """Joints (T, 18, 3) in metres, NaN where the head pose has a gap."""
    if track.joints_world is None:
        return track.joints_head
    return np.where(track.in_world[:, None, None], track.joints_world, np.nan)


def test_trc_has_the_layout_of_opensim(track, tmp_path):
    FORMATS["trc"](tmp_path / "t.trc", track)
    lines = (tmp_path / "t.trc").read_text().split("\n")
    facts = dict(zip(lines[1].split("\t"), lines[2].split("\t"), strict=True))
    assert lines[0] == "PathFileType\t4\t(X/Y/Z)\tt.trc" and lines[5] == ""
    assert facts["Units"] == "mm" and float(facts["DataRate"]) == 25
    assert (facts["NumFrames"], facts["NumMarkers"]) == ("9", "18")
    assert lines[3].split("\t")[2::3] == list(LABELS)
    assert lines[4].split("\t")[2:5] == ["X1", "Y1", "Z1"]
    rows = [line.split("\t") for line in lines[6:15]]
    assert {len(row) for row in rows} == {2 + 3 * 18}
    np.testing.assert_allclose([float(row[1]) for row in rows], track.times)
    found = np.array([[float(v) if v else np.nan for v in row[2:]] for row in rows])
    x, y, z = np.moveaxis(found.reshape(9, 18, 3), -1, 0)  # forward, up, right
    np.testing.assert_allclose(np.stack([x, -z, y], -1) / 1000, expected(track), atol=1e-7)


def test_c3d_by_ezc3d(track, tmp_path):
    ezc3d = pytest.importorskip("ezc3d")
    FORMATS["c3d"](tmp_path / "t.c3d", track)
    read = ezc3d.c3d(str(tmp_path / "t.c3d"))
    point = read["parameters"]["POINT"]
    assert point["LABELS"]["value"] == list(LABELS) and point["UNITS"]["value"] == ["mm"]
    assert point["RATE"]["value"][0] == read["header"]["points"]["frame_rate"] == 25
    frame = "head" if track.joints_world is None else "world"
    assert f"joints in the {frame} frame" in point["DESCRIPTIONS"]["value"][0]
    assert read["data"]["points"].shape == (4, 18, 9)
    found = np.moveaxis(read["data"]["points"][:3], 0, -1).swapaxes(0, 1) / 1000
    np.testing.assert_allclose(found, expected(track), atol=1e-6)


def test_csv_names_frame_and_units(track, tmp_path):
    FORMATS["csv"](tmp_path / "t.csv", track)
    with (tmp_path / "t.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    frame = "head" if track.joints_world is None else "world"
    joints = expected(track)
    for i, row in enumerate(rows):
        assert float(row["time_s"]) == pytest.approx(track.times[i])
        for k, axis in enumerate("xyz"):
            text, value = row[f"{frame}_left_wrist_{axis}_m"], joints[i, 4, k]
            assert text == "" if np.isnan(value) else float(text) == pytest.approx(value, abs=1e-6)
        angle = np.rad2deg(track.angles[i, DOFS.index("right_elbow_flexion")])
        assert float(row["right_elbow_flexion_deg"]) == pytest.approx(angle, abs=1e-6)
        assert float(row["head_sigma_m"]) == pytest.approx(0.02)


@pytest.fixture(scope="module")
def gltf(track, tmp_path_factory):
    """The file by pygltflib, with its arrays."""
    pygltflib = pytest.importorskip("pygltflib")
    path = tmp_path_factory.mktemp("glb") / "t.glb"
    FORMATS["glb"](path, track)
    read = pygltflib.GLTF2().load(str(path))
    blob = read.binary_blob()

    def array(index):
        accessor = read.accessors[index]
        view = read.bufferViews[accessor.bufferView]
        dtype = {5126: "<f4", 5121: "u1", 5123: "<u2"}[accessor.componentType]
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}[accessor.type]
        count = accessor.count * width
        values = np.frombuffer(blob, dtype, count, view.byteOffset)
        return values.reshape(accessor.count, width)

    return read, array


def posed_nodes(gltf, frame):
    """Global transforms of the nodes in a frame of the animation, by glTF's rules."""
    read, array = gltf
    local = []
    for node in read.nodes:
        T = np.eye(4)
        T[:3, 3] = node.translation or (0, 0, 0)
        local.append(T)
    (animation,) = read.animations
    for channel in animation.channels:
        values = array(animation.samplers[channel.sampler].output)[frame]
        if channel.target.path == "rotation":
            local[channel.target.node][:3, :3] = Rotation.from_quat(values).as_matrix()
        else:
            local[channel.target.node][:3, 3] = values
    world, todo = {}, [(i, np.eye(4)) for i in read.scenes[0].nodes]
    while todo:
        i, above = todo.pop()
        world[i] = above @ local[i]
        todo += [(child, world[i]) for child in read.nodes[i].children or ()]
    return world


def test_glb_animation_puts_every_joint_where_the_track_has_it(track, gltf):
    read, array = gltf
    names = {node.name: i for i, node in enumerate(read.nodes)}
    joints = track.joints_head if track.joints_world is None else track.joints_world
    (clock,) = {sampler.input for sampler in read.animations[0].samplers}
    np.testing.assert_allclose(array(clock)[:, 0], track.times, atol=1e-6)
    for frame in (0, 4, 8):
        world = posed_nodes(gltf, frame)
        for label, name in NODES.items():
            place = GLTF_TO_OURS @ world[names[name]][:3, 3]
            np.testing.assert_allclose(place, joints[frame, LABEL_INDEX[label]], atol=1e-5)


def test_glb_figure_is_skinned_to_the_bones(track, gltf):
    """The rest pose is left unchanged by the skin, and a hand moves with its wrist."""
    read, array = gltf
    (primitive,) = read.meshes[0].primitives
    vertices, bones = (array(getattr(primitive.attributes, a)) for a in ("POSITION", "JOINTS_0"))
    weights = array(primitive.attributes.WEIGHTS_0)
    np.testing.assert_allclose(weights.sum(1), 1)
    inverse = array(read.skins[0].inverseBindMatrices).reshape(-1, 4, 4).swapaxes(1, 2)
    assert array(primitive.indices).max() == len(vertices) - 1
    joints = track.joints_head if track.joints_world is None else track.joints_world
    world = posed_nodes(gltf, 3)
    for side in ("Left", "Right"):
        bone = [n.name for n in read.nodes].index(f"{side}Hand")
        mine = vertices[bones[:, 0] == bone]
        posed = (world[bone] @ inverse[bone])[:3] @ np.c_[mine, np.ones(len(mine))].T
        ends = [LABEL_INDEX[f"{side.lower()}_{part}"] for part in ("wrist", "hand")]
        middle = joints[3, ends].mean(0)
        np.testing.assert_allclose(GLTF_TO_OURS @ posed.mean(1), middle, atol=2e-3)


def test_glb_triangles_face_outwards(gltf):
    read, array = gltf
    (primitive,) = read.meshes[0].primitives
    vertices, normals = (array(getattr(primitive.attributes, a)) for a in ("POSITION", "NORMAL"))
    a, b, c = vertices[array(primitive.indices).reshape(-1, 3)].swapaxes(0, 1)
    first = normals[array(primitive.indices).reshape(-1, 3)[:, 0]]
    assert (np.einsum("fi,fi->f", np.cross(b - a, c - a), first) > 0).mean() > 0.99
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-6)


def test_another_reader_opens_the_glb(track, tmp_path):
    trimesh = pytest.importorskip("trimesh")
    FORMATS["glb"](tmp_path / "t.glb", track)
    scene = trimesh.load(tmp_path / "t.glb")
    (mesh,) = scene.geometry.values()
    height = mesh.bounds[1, 1] - mesh.bounds[0, 1]
    assert 1.5 < height < 1.9  # y up, metres, at rest


def test_usd_skeleton_moves_as_the_track_does(track, tmp_path):
    """By OpenUSD: joints, units, rate, and a skin that follows the wrists."""
    pytest.importorskip("pxr")
    from pxr import Usd, UsdGeom, UsdSkel

    FORMATS["usda"](tmp_path / "t.usda", track)
    stage = Usd.Stage.Open(str(tmp_path / "t.usda"))
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1 and UsdGeom.GetStageUpAxis(stage) == "Y"
    assert stage.GetTimeCodesPerSecond() == 25 and stage.GetEndTimeCode() == 8
    cache, root = UsdSkel.Cache(), UsdSkel.Root(stage.GetDefaultPrim())
    assert cache.Populate(root, Usd.PrimDefaultPredicate)
    query = cache.GetSkelQuery(UsdSkel.Skeleton.Get(stage, "/Figure/Skeleton"))
    skin = cache.GetSkinningQuery(stage.GetPrimAtPath("/Figure/Body"))
    names = [str(path).split("/")[-1] for path in query.GetJointOrder()]
    joints = track.joints_head if track.joints_world is None else track.joints_world
    mesh = UsdGeom.Mesh.Get(stage, "/Figure/Body")
    bones = np.array(mesh.GetPrim().GetAttribute("primvars:skel:jointIndices").Get())
    for frame in (0, 4, 8):
        world = np.array(query.ComputeJointSkelTransforms(frame))[:, 3, :3]
        for label, name in NODES.items():
            place = GLTF_TO_OURS @ world[names.index(name)]
            np.testing.assert_allclose(place, joints[frame, LABEL_INDEX[label]], atol=1e-4)
        points = mesh.GetPointsAttr().Get()
        assert skin.ComputeSkinnedPoints(query.ComputeSkinningTransforms(frame), points, frame)
        hand = np.array(points)[bones == names.index("LeftHand")].mean(0)
        middle = joints[frame, [LABEL_INDEX["left_wrist"], LABEL_INDEX["left_hand"]]].mean(0)
        np.testing.assert_allclose(GLTF_TO_OURS @ hand, middle, atol=2e-3)
    assert set(mesh.GetFaceVertexCountsAttr().Get()) == {3}


@pytest.mark.parametrize("name", ["glb", "usda"])
def test_a_track_without_skeleton_is_refused(track, tmp_path, name):
    with pytest.raises(InputError, match="skeleton"):
        FORMATS[name](tmp_path / f"t.{name}", replace(track, offsets=None))
    assert not list(tmp_path.iterdir())


def test_coco_results_number_images_as_the_sequence_does(tmp_path):
    rng = np.random.default_rng(2)
    valid = rng.random((4, 2, 18)) < 0.7
    valid[1, 0] = False  # an image without detections
    points = rng.uniform(0, 600, (4, 2, 18, 2))
    sigma, confidence = np.full((4, 2, 18), 2.0), rng.random((4, 2, 18))
    found = Detections(np.arange(4) / 30, points, sigma, confidence, valid, "a test")
    write_coco(tmp_path / "d.json", found)
    results = json.loads((tmp_path / "d.json").read_text())
    assert [r["image_id"] for r in results] == [1, 2, 4, 5, 6, 7, 8]
    for result in results:
        t, v = divmod(result["image_id"] - 1, 2)
        x, y, score = np.array(result["keypoints"]).reshape(18, 3).T
        np.testing.assert_allclose(np.stack([x, y], -1)[valid[t, v]], points[t, v][valid[t, v]],
                                   atol=1e-3)  # fmt: skip
        assert ((score > 0) == valid[t, v]).all() and not x[~valid[t, v]].any()
        assert result["score"] == pytest.approx(confidence[t, v][valid[t, v]].mean(), abs=1e-3)


@pytest.mark.parametrize(
    ("name", "told"),
    [("a.bvh", "bvh"), ("a.GLB", "glb"), ("a.npz", "npz"), ("a.track.npz", "npz"),
     ("a.smpl.npz", "smpl"), ("A.SMPL.NPZ", "smpl")],
)  # fmt: skip
def test_name_tells_the_format(name, told):
    assert format_of(Path(name)) == told


@pytest.mark.parametrize("name", ["a-smpl.npz", "a.smplx.npz", "AMASS_a.npz"])
def test_name_that_may_mean_a_body_model_is_asked_about(name):
    with pytest.raises(InputError, match=r"\.smpl\.npz; --format smpl"):
        format_of(Path(name))


@pytest.mark.parametrize("name", ["a", "a.pkl", "a.smpl"])
def test_other_names_are_told_the_suffixes(name):
    with pytest.raises(InputError, match=r"trc, csv, npz, smpl\.npz"):
        format_of(Path(name))
