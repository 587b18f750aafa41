"""Recognise a skeleton's naming convention and map its joints to the 21 simulated bodies.

Limbs and head are found by name, with one row of `CONVENTIONS` per convention. The trunk is found
by structure, since tools number the spine differently: the pelvis joins the thighs, the chest joins
the arms, the spine is the middle joint between, the neck the first joint above the chest. Missing
clavicles, toes, spine or neck are left out of the map; `load` fills them from the neighbours.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from egocap.errors import FileError
from egocap.schema import read_toml
from egocap_sim.core.bodies import BODIES, PARENT

LIMBS = ("clavicle", "upperarm", "forearm", "hand", "thigh", "calf", "foot", "toe")
OPTIONAL = frozenset(
    {"spine", "chest", "neck", "l_clavicle", "r_clavicle", "l_toe", "r_toe", "pelvis"}
)
MANDATORY = tuple(b for b in BODIES if b not in OPTIONAL)

CONVENTIONS: dict[str, tuple[str, ...]] = {
    # stems of LIMBS in that order, alternatives by '|'; sides and prefixes are handled below
    "CMU / Mixamo / LAFAN1": (
        "shoulder", "arm", "forearm", "hand", "upleg", "leg", "foot", "toebase|toe"),
    "Rokoko": ("shoulder", "arm", "forearm", "hand", "thigh", "shin", "foot", "toe|toebase"),
    "iClone CC_Base / Biped": (
        "clavicle", "upperarm", "forearm", "hand", "thigh", "calf", "foot", "toebase|toe0|toe"),
    "Unreal": ("clavicle", "upperarm", "lowerarm", "hand", "thigh", "calf", "foot", "ball"),
    "Xsens (joints)": (
        "collar|clavicle|scapula", "shoulder", "elbow", "wrist", "hip", "knee", "ankle",
        "toe|toebase|toes"),
    "Xsens MVN (segments)": (
        "shoulder", "upperarm", "forearm", "hand", "upperleg", "lowerleg", "foot", "toe"),
    "plain": (
        "clavicle|collar|shoulder", "upperarm|uparm", "lowerarm|forearm|lowarm", "hand|wrist",
        "upperleg|thigh|upleg", "lowerleg|calf|shin|lowleg", "foot|ankle", "toes|toe|toebase"),
    "Poser / DAZ": (
        "collar", "shldr|shldrbend", "forearm|forearmbend", "hand", "thigh|thighbend", "shin",
        "foot", "toe"),
    "SMPL": ("collar", "shoulder", "elbow", "wrist", "hip", "knee", "ankle", "foot"),
}  # fmt: skip

_PREFIX = re.compile(r"^(ccbase|mixamorig\d*|bip0*\d+|jointbip|character\d*|rlbone|joint|def)")


def normal(name: str) -> str:
    """A joint name without namespace, tool prefix, separators and case."""
    bare = re.sub(r"[\s_\-.]", "", name.rsplit(":", 1)[-1].rsplit("|", 1)[-1]).lower()
    return _PREFIX.sub("", bare) or bare


def map_joints(
    names: Sequence[str],
    parents: Sequence[int],
    *,
    where: str | Path,
    given: Mapping[str, str] | None = None,
) -> dict[str, int]:
    """Joint index of each of the 21 bodies that the skeleton has.

    `given` (body -> joint name) overrides recognised joints. Raises FileError, with the missing
    bodies and the joints of the file, if a mandatory body is not found.
    """
    given = _check_given(given or {}, names, where)
    found = max((_limbs(names, row) for row in CONVENTIONS.values()), key=_score)
    found |= {body: list(names).index(joint) for body, joint in given.items()}
    missing = [b for b in MANDATORY if b not in found]
    if missing:
        hips = "no hips: " if {"l_thigh", "r_thigh"} <= set(missing) else ""
        raise FileError(
            where,
            f"{hips}no joint recognised for {', '.join(missing)} among the joints "
            f"{_few(names)}; name them in a map ('body = \"joint\"' in TOML)",
            valid="naming of " + ", ".join(CONVENTIONS),
        )
    for body, joint in _trunk(found, parents).items():
        found.setdefault(body, joint)
    _check_tree(found, names, parents, where)
    return {b: found[b] for b in BODIES if b in found}


def read_name_map(path: str | Path) -> dict[str, str]:
    """Read a TOML name map (`body = "JointName"`, one line per body)."""
    table = read_toml(path)
    for body, joint in table.items():
        if body not in BODIES:
            raise FileError(path, "is not a body", key=body, valid=BODIES)
        if not isinstance(joint, str):
            raise FileError(path, f"is {joint!r}", key=body, valid='a joint name in "quotes"')
    return table


def _check_given(
    given: Mapping[str, str], names: Sequence[str], where: str | Path
) -> Mapping[str, str]:
    for body, joint in given.items():
        if body not in BODIES:
            raise FileError(where, "the name map has an unknown body", key=body, valid=BODIES)
        if joint not in names:
            raise FileError(
                where, f"the name map has the unknown joint '{joint}'", key=body, valid=_few(names)
            )
    return given


def _few(names: Iterable[str], most: int = 40) -> str:
    names = list(names)
    return ", ".join(names[:most]) + (
        f", and {len(names) - most} more" if len(names) > most else ""
    )


def _limbs(names: Sequence[str], row: Sequence[str]) -> dict[str, int]:
    """Limbs and head under one convention; the first joint in file order takes a name."""
    index: dict[str, int] = {}
    for i, name in enumerate(names):
        index.setdefault(normal(name), i)
    head = index.get("head", index.get("headm"))
    found = {} if head is None else {"head": head}
    for side, word in (("l", "left"), ("r", "right")):
        for limb, stems in zip(LIMBS, row, strict=True):
            for stem in stems.split("|"):
                for form in (word + stem, side + stem, stem + side, stem + word):
                    if form in index:
                        found.setdefault(f"{side}_{limb}", index[form])
    return found


def _score(found: Mapping[str, int]) -> tuple[int, int]:
    return sum(b in found for b in MANDATORY), len(set(found.values()))


def _chain(joint: int, parents: Sequence[int]) -> list[int]:
    """The joint and its ancestors, root last."""
    chain = [joint]
    while parents[chain[-1]] >= 0:
        chain.append(parents[chain[-1]])
    return chain


def _trunk(found: Mapping[str, int], parents: Sequence[int]) -> dict[str, int]:
    def common(a: int, b: int) -> int:
        above = set(_chain(a, parents))
        return next((j for j in _chain(b, parents) if j in above), -1)

    def between(low: int, high: int) -> list[int]:
        """Joints above `low` up to and without `high`, in that order."""
        chain = _chain(high, parents)[1:]
        return chain[: chain.index(low)][::-1] if low in chain else []

    trunk = {"pelvis": found.get("pelvis", common(found["l_thigh"], found["r_thigh"]))}
    chest = found.get("chest", common(found["l_upperarm"], found["r_upperarm"]))
    waist = common(trunk["pelvis"], chest)
    if chest not in (trunk["pelvis"], waist):
        trunk["chest"] = chest
        spine = between(waist, chest)
        if spine:
            trunk["spine"] = spine[len(spine) // 2]
    neck = [j for j in between(chest, found["head"]) if j != chest]
    if neck:
        trunk["neck"] = neck[0]
    return {body: joint for body, joint in trunk.items() if joint >= 0}


def _check_tree(
    found: Mapping[str, int], names: Sequence[str], parents: Sequence[int], where: str | Path
) -> None:
    """Raise FileError unless the joints of each limb descend from one another."""
    for body, joint in found.items():
        if body[2:] in ("forearm", "hand", "calf", "foot", "toe"):
            parent = PARENT[body]
            if joint == found[parent] or found[parent] not in _chain(joint, parents):
                raise FileError(
                    where,
                    f"joint '{names[joint]}' ({body}) is no descendant of "
                    f"'{names[found[parent]]}' ({parent}); give a name map",
                )
