from __future__ import annotations

import numpy as np
import pytest

from egocap.errors import FileError
from egocap_sim.core.bodies import BODIES, INDEX, PARENT
from egocap_sim.motion import load_clip
from egocap_sim.motion.clips.skeleton_names import map_joints, read_name_map

TRUNK = ("pelvis", "spine", "chest", "neck", "head")


def rig_names(trunk: str, limbs: str, form: str, sides: str) -> dict[str, str]:
    """Joint names of all bodies; `form` places SIDE and LIMB."""
    names = dict(zip(TRUNK, trunk.split(), strict=True))
    words = dict(zip(("l_", "r_"), sides.split(), strict=True))
    parts = ("clavicle", "upperarm", "forearm", "hand", "thigh", "calf", "foot", "toe")
    for s, side in words.items():
        for part, limb in zip(parts, limbs.split(), strict=True):
            names[s + part] = form.replace("SIDE", side).replace("LIMB", limb)
    return names


LR = "Left Right"
TOOLS = {
    "CMU": rig_names("Hips Spine Spine1 Neck Head",
                     "Shoulder Arm ForeArm Hand UpLeg Leg Foot ToeBase", "SIDELIMB", LR),
    "Mixamo": rig_names("mixamorig:Hips mixamorig:Spine1 mixamorig:Spine2 mixamorig:Neck "
                        "mixamorig:Head",
                        "Shoulder Arm ForeArm Hand UpLeg Leg Foot ToeBase",
                        "mixamorig:SIDELIMB", LR),
    "LAFAN1": rig_names("Hips Spine1 Spine2 Neck Head",
                        "Shoulder Arm ForeArm Hand UpLeg Leg Foot Toe", "SIDELIMB", LR),
    "iClone": rig_names("CC_Base_Hip CC_Base_Spine01 CC_Base_Spine02 CC_Base_NeckTwist01 "
                        "CC_Base_Head",
                        "Clavicle Upperarm Forearm Hand Thigh Calf Foot ToeBase",
                        "CC_Base_SIDE_LIMB", "L R"),
    "Rokoko": rig_names("Hips Spine2 Spine4 Neck Head",
                        "Shoulder Arm ForeArm Hand Thigh Shin Foot Toe", "SIDELIMB", LR),
    "Xsens": rig_names("Hips Chest2 Chest4 Neck Head",
                       "Collar Shoulder Elbow Wrist Hip Knee Ankle Toe", "SIDELIMB", LR),
    "Xsens MVN": rig_names("Pelvis L3 T8 Neck Head",
                           "Shoulder UpperArm ForeArm Hand UpperLeg LowerLeg Foot Toe",
                           "SIDELIMB", LR),
    "plain": rig_names("Hips Spine Chest Neck Head",
                       "Shoulder UpperArm LowerArm Hand UpperLeg LowerLeg Foot Toes",
                       "LIMB_SIDE", "L R"),
    "SMPL": rig_names("Pelvis Spine2 Spine3 Neck Head",
                      "Collar Shoulder Elbow Wrist Hip Knee Ankle Foot", "SIDE_LIMB", "L R"),
    "Biped": rig_names("Bip01 Spine Spine1 Neck Head",
                       "Clavicle UpperArm Forearm Hand Thigh Calf Foot Toe0",
                       "Bip01 SIDE LIMB", "L R"),
    "old Hips/Collar/UpArm": rig_names("Hips Spine Chest Neck Head",
                                       "Collar UpArm LowArm Hand UpLeg LowLeg Foot Toe",
                                       "SIDELIMB", LR),
    "AdvancedSkeleton": rig_names("Root_M Spine1_M Chest_M Neck_M Head_M",
                                  "Scapula Shoulder Elbow Wrist Hip Knee Ankle Toes",
                                  "LIMB_SIDE", "L R"),
    "Poser": rig_names("hip abdomen chest neck head",
                       "Collar Shldr ForeArm Hand Thigh Shin Foot Toe", "SIDELIMB", "l r"),
    "Unreal": rig_names("pelvis spine_01 spine_03 neck_01 head",
                        "clavicle upperarm lowerarm hand thigh calf foot ball",
                        "LIMB_SIDE", "l r"),
}  # fmt: skip


def joints(names: dict[str, str]) -> tuple[list[str], list[int]]:
    bodies = [b for b in BODIES if b in names]
    parents = []
    for body in bodies:
        up = PARENT.get(body)
        while up is not None and up not in names:
            up = PARENT.get(up)
        parents.append(bodies.index(up) if up is not None else -1)
    return [names[b] for b in bodies], parents


@pytest.mark.parametrize("tool", TOOLS)
def test_every_convention_maps_all_bodies(tool: str) -> None:
    names, parents = joints(TOOLS[tool])
    found = map_joints(names, parents, where="x.bvh")
    assert {b: names[j] for b, j in found.items()} == TOOLS[tool]


@pytest.mark.parametrize("tool", ["Mixamo", "Xsens"])
def test_a_file_of_that_convention_loads(tool: str, active, bvh_file, rig) -> None:
    clip = load_clip(bvh_file(active, rig(TOOLS[tool])))
    moved = clip.positions - clip.positions[:, :1]
    np.testing.assert_allclose(moved, active.positions - active.positions[:, :1], atol=2e-3)


def test_optional_bodies_may_be_missing(active, bvh_file, rig) -> None:
    lacking = ("spine", "neck", "l_clavicle", "r_clavicle", "l_toe", "r_toe")
    names = {b: n for b, n in TOOLS["plain"].items() if b not in lacking}
    clip = load_clip(bvh_file(active, rig(names)))
    assert np.isfinite(clip.positions).all() and np.isfinite(clip.rotations).all()
    moved = clip.positions - clip.positions[:, :1] - (active.positions - active.positions[:, :1])
    legs = [INDEX[s + b] for s in ("l_", "r_") for b in ("thigh", "calf", "foot")]
    assert np.abs(moved[:, legs]).max() < 2e-3
    assert np.abs(moved).max() < 0.15  # without a spine joint its bend is lost
    foot = clip.rotations[:, INDEX["l_foot"]] - active.rotations[:, INDEX["l_foot"]]
    assert np.abs(foot).max() < 0.25


def test_missing_bodies_and_found_joints_are_named() -> None:
    names, parents = joints(TOOLS["plain"])
    names[names.index("Hand_L")] = "Banana"
    with pytest.raises(FileError, match=r"l_hand.*Banana") as e:
        map_joints(names, parents, where="x.bvh")
    assert "x.bvh" in str(e.value)


def test_no_hips() -> None:
    with pytest.raises(FileError, match="no hips"):
        map_joints(["jaw", "brow"], [-1, 0], where="face.bvh")


def test_a_map_replaces_recognition(tmp_path) -> None:
    names, parents = joints({b: f"J{i}" for i, b in enumerate(BODIES)})
    path = tmp_path / "names.toml"
    path.write_text("\n".join(f'{b} = "J{i}"' for i, b in enumerate(BODIES)))
    found = map_joints(names, parents, where="x.bvh", given=read_name_map(path))
    assert len(found) == 21


@pytest.mark.parametrize(
    ("text", "says"),
    [('l_hoof = "J"', "l_clavicle"), ("l_hand = 3", "joint name"), ("l_hand =", "TOML")],
)
def test_bad_maps(tmp_path, text: str, says: str) -> None:
    path = tmp_path / "names.toml"
    path.write_text(text)
    with pytest.raises(FileError, match=says):
        read_name_map(path)


def test_map_to_a_joint_that_is_not_there() -> None:
    names, parents = joints(TOOLS["CMU"])
    with pytest.raises(FileError, match=r"Paw.*LeftHand"):
        map_joints(names, parents, where="x.bvh", given={"l_hand": "Paw"})


def test_limbs_must_be_connected() -> None:
    names, parents = joints(TOOLS["CMU"])
    parents[names.index("LeftHand")] = names.index("Head")
    with pytest.raises(FileError, match="is no descendant of"):
        map_joints(names, parents, where="x.bvh")
