"""Tops, bottoms and socks: their cuts, and their shells around a person."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap_sim.core.bodies import INDEX
from egocap_sim.human.body.body_chart import LEGS, TORSO, BodyChart
from egocap_sim.human.clothing.drape import drape
from egocap_sim.human.clothing.shell import ELSEWHERE, Level, Pattern, Shell, make_shell
from egocap_sim.human.clothing.skirts import Skirt

PLAIN = ("side_seams", "hems")
SHIRT = ("side_seams", "hems", "placket", "chest_pocket")
TROUSERS = ("side_seams", "hems", "front_pockets", "back_pockets")


@dataclass(frozen=True)
class Top:
    """A garment of the upper body; sleeve and hem are shares, other lengths metres."""

    sleeve: float  # 0 shoulder, 1 elbow, 2 wrist
    hem: float  # 0 crotch, 1 waist
    collar: float  # m above the ring around the base of the neck; below it if negative
    gap: float
    ease: float  # looseness of the torso
    sleeve_ease: float
    details: tuple[str, ...] = PLAIN  # of `egocap_sim.human.clothing.details`
    crumple: float = 1.0  # depth of folds
    armhole: float | None = None  # m, bare radius around the shoulder, instead of a sleeve
    opening: float | None = None  # m, half the width of an open front
    inner: str | None = None  # the top worn under an open front
    trim: str | None = None  # collar, of `TRIMS`
    skirt: Skirt | None = None  # of a dress


@dataclass(frozen=True)
class Bottom:
    """A garment of the legs."""

    leg: float  # 0 hip, 1 knee, 2 ankle
    gap: float
    ease: float  # looseness at the hem, growing from the hip
    details: tuple[str, ...] = TROUSERS
    crumple: float = 1.0


@dataclass(frozen=True)
class Trim:
    """A second layer around the neck: folded collars, ribbed necks, a hood on the shoulders."""

    width: float  # m from the garment's edge down
    gap: float  # m over the garment
    bulge: float = 0.0  # m added to the gap at the back
    notch: float | None = None  # m, half the width of the opening at the throat


TRIMS: dict[str, Trim] = {
    "rib": Trim(0.020, 0.0025),
    "collar": Trim(0.042, 0.006, notch=0.010),
    "lapel": Trim(0.055, 0.007, notch=0.05),
    "hood": Trim(0.085, 0.010, bulge=0.055, notch=0.03),
}
TOPS: dict[str, Top] = {
    "tshirt": Top(0.55, 0.22, 0.0, 0.006, 0.012, 0.016, trim="rib"),
    "print_tshirt": Top(0.6, 0.2, 0.0, 0.006, 0.016, 0.02, (*PLAIN, "motif"), trim="rib"),
    "slim_tshirt": Top(0.42, 0.45, -0.02, 0.006, 0.004, 0.004, crumple=0.6),
    "tank_top": Top(0.0, 0.35, -0.035, 0.006, 0.006, 0.004, crumple=0.7, armhole=0.095),
    "longsleeve": Top(1.92, 0.25, 0.0, 0.006, 0.010, 0.007, trim="rib"),
    "shirt": Top(1.95, 0.12, 0.022, 0.007, 0.018, 0.014, SHIRT, 1.2, trim="collar"),
    "polo": Top(0.5, 0.2, 0.016, 0.006, 0.012, 0.014, trim="collar"),
    "sweater": Top(1.95, 0.28, 0.01, 0.010, 0.020, 0.016, ("ribs",), 0.8, trim="rib"),
    "hoodie": Top(1.97, 0.22, 0.012, 0.012, 0.028, 0.024, ("ribs", "kangaroo"), 1.1, trim="hood"),
    "jacket": Top(
        1.97, 0.10, 0.02, 0.022, 0.030, 0.026, (*PLAIN, "edges"), 1.2,
        opening=0.045, inner="tshirt", trim="lapel",
    ),
    "zip_jacket": Top(
        1.97, 0.10, 0.03, 0.014, 0.034, 0.026, (*PLAIN, "zip"), 1.2, trim="rib"
    ),
    "vest": Top(
        0.0, 0.15, 0.0, 0.022, 0.026, 0.02, (*PLAIN, "edges"), 0.7,
        armhole=0.08, opening=0.035, inner="longsleeve",
    ),
    "dress": Top(
        0.35, 1.0, -0.02, 0.006, 0.006, 0.012, ("side_seams",), 0.7,
        skirt=Skirt(0.95, 0.22, 0.012),
    ),
    "summer_dress": Top(
        0.0, 1.0, -0.04, 0.006, 0.004, 0.004, ("side_seams",), 0.6,
        armhole=0.09, skirt=Skirt(1.25, 0.16, 0.010, 11),
    ),
}  # fmt: skip
BOTTOMS: dict[str, Bottom | Skirt | None] = {
    "shorts": Bottom(0.78, 0.007, 0.030),
    "tight_shorts": Bottom(0.55, 0.004, 0.0, PLAIN, 0.3),
    "slim_trousers": Bottom(1.86, 0.005, 0.003, crumple=0.8),
    "trousers": Bottom(1.96, 0.006, 0.018),
    "wide_trousers": Bottom(1.99, 0.005, 0.045, ("side_seams", "front_pockets", "pressed")),
    "leggings": Bottom(1.80, 0.004, 0.0, ("side_seams",), 0.25),
    "skirt": Skirt(0.85, 0.20, 0.010),
    "pleated_skirt": Skirt(0.62, 0.30, 0.016, 14),
    "long_skirt": Skirt(1.45, 0.14, 0.010, 8),
    "none": None,  # under a dress
}
UNDER_DRESSES = ("none", "leggings", "tight_shorts")

SOCKS: dict[str, float] = {"ankle_socks": 0.06, "crew_socks": 0.16}  # m above the ankle
LOOSE = 0.008  # m, least ease of cloth that hangs freely
NECK_RADIUS, STRAP = 0.06, 0.04  # m: ring of `BodyChart.neck`; least width of a strap
THIGH_GRIP = 0.5  # share of the thighs' skin weights that a hanging hem keeps


def fit_top(chart: BodyChart, top: Top, tucked: bool = False) -> Shell:
    """Shell of a top; if `tucked` into a skirt, it ends tight at the waist."""
    z, arm = chart.vertices[:, 2], chart.on_arm
    at_waist = tucked or top.skirt is not None
    rise = chart.waist - chart.crotch - 0.03
    hem = chart.waist - 0.02 if at_waist else chart.crotch + 0.03 + top.hem * rise
    drop = np.clip((chart.chest - z) / (chart.chest - hem), 0, 1)
    # Cloth rests on the shoulders and hangs from the chest down and along the sleeves.
    ease = top.ease * (0.25 + 0.75 * drop)
    if at_waist:
        ease = ease * np.clip((z - hem - 0.02) / 0.10, 0.05, 1)
    sleeve = top.sleeve_ease * np.clip(chart.along_arm / 0.12, 0.2, 1)
    collar_ease = np.clip((top.collar - chart.neck) / 0.08, 0.2, 1)
    free = top.ease >= LOOSE and not at_waist

    def fall(cloth: Float[Array, "N 3"]) -> Float[Array, "N 3"]:
        centre = chart.joint("pelvis")[:2] * [1, 0]
        return drape(cloth, ~arm, centre, (chart.chest - 0.02, hem), min(1.0, top.ease / 0.014))

    pattern = Pattern(
        _top_edges(chart, top),
        gap=top.gap + 0.004 * drop * ~arm * (not at_waist),  # over the waistband below
        looseness=np.where(arm, sleeve, ease * collar_ease),
        level=Level(hem, above=True, where=~arm),
        margin=_margin(max(top.ease, top.sleeve_ease)),
        span=_hips(chart),
        fall=fall if free else None,
    )
    shell = make_shell(chart, pattern)
    piece = np.where(np.isin(shell.piece, LEGS), TORSO, shell.piece)
    return replace(shell, piece=piece, weights=_let_go(shell.weights) if free else shell.weights)


def _top_edges(chart: BodyChart, top: Top) -> list[Float[Array, "N"]]:
    """Distances inside the ends of the sleeves (or the armholes), the collar and an open front."""
    if top.armhole is None:
        sleeve_end = _reach(top.sleeve, chart.elbow, chart.wrist) - chart.along_arm
        arms = np.where(chart.on_arm, sleeve_end, ELSEWHERE)
    else:
        arms = _armholes(chart, top.armhole, top.collar)
    edges = [arms, np.where(chart.piece == TORSO, top.collar - chart.neck, ELSEWHERE)]
    return edges if top.opening is None else [*edges, _open_front(chart, top.opening)]


def fit_trim(chart: BodyChart, top: Top) -> Shell:
    """Shell of the collar, ribbing or hood of a top."""
    assert top.trim is not None
    trim, torso = TRIMS[top.trim], chart.piece == TORSO
    inside = top.collar + 0.002 - chart.neck
    edges = [
        np.where(torso, inside, -ELSEWHERE),
        np.where(torso, trim.width - inside, ELSEWHERE),
    ]
    if trim.notch is not None:
        edges.append(_open_front(chart, trim.notch + 0.5 * np.clip(inside, 0, None)))
    behind = np.clip((chart.joint("neck")[0] - chart.vertices[:, 0]) / 0.06 + 0.3, 0, 1)
    middle = np.sin(np.pi * np.clip(inside / trim.width, 0, 1))
    collar_ease = np.clip(inside / 0.08, 0.2, 1)
    gap = top.gap + 0.25 * top.ease * collar_ease + trim.gap
    return make_shell(chart, Pattern(edges, gap + trim.bulge * behind * middle, rounds=4))


def _armholes(chart: BodyChart, radius: float, collar: float) -> Float[Array, "N"]:
    """Distance inside the edges around both shoulders."""
    joints = chart.body.joints[[INDEX["l_upperarm"], INDEX["r_upperarm"]]] - [0, 0, 0.01]
    away = np.min([np.linalg.norm(chart.vertices - joint, axis=1) for joint in joints], axis=0)
    # The straps keep their width on narrow shoulders and with wide collars.
    radius = min(radius, joints[0, 1] - NECK_RADIUS - max(-collar, 0) - STRAP)
    return np.where(chart.on_arm, np.minimum(-0.01 - chart.along_arm, away - radius), away - radius)


def _open_front(chart: BodyChart, half: Array | float) -> Float[Array, "N"]:
    """Distance inside the edges of a front that is open by `half` (m) on each side."""
    spine = np.array([chart.joint(b) for b in ("pelvis", "spine", "chest", "neck", "head")])
    middle = np.interp(chart.vertices[:, 2], spine[:, 2], spine[:, 0])
    front = chart.vertices[:, 0] > middle
    return np.where(front, np.abs(chart.vertices[:, 1]) - half, ELSEWHERE)


def _let_go(weights: Float[Array, "M 21"]) -> Float[Array, "M 21"]:
    """Move part of the thighs' skin weights to the pelvis."""
    loose = weights.copy()
    for thigh in (INDEX["l_thigh"], INDEX["r_thigh"]):
        loose[:, INDEX["pelvis"]] += (1 - THIGH_GRIP) * loose[:, thigh]
        loose[:, thigh] *= THIGH_GRIP
    return loose


def fit_bottom(chart: BodyChart, bottom: Bottom, buried: Bool[Array, "N"]) -> Shell:
    """Shell of trousers or shorts; `buried` marks skin under the top."""
    arm, leg = chart.on_arm, chart.on_leg
    length = _reach(bottom.leg, chart.knee, chart.ankle)
    pattern = Pattern(
        [
            np.where(arm, -ELSEWHERE, ELSEWHERE),
            np.where(leg, length - chart.along_leg, ELSEWHERE),
        ],
        gap=np.full(len(leg), bottom.gap),
        looseness=bottom.ease * np.where(leg, np.clip(chart.along_leg / length, 0.05, 1), 0.05),
        level=Level(chart.waist, above=False, where=~arm),
        margin=_margin(bottom.ease),
        span=_hips(chart),
    )
    return make_shell(chart, pattern, buried)


def fit_socks(chart: BodyChart, rise: float, buried: Bool[Array, "N"]) -> Shell:
    """Shell of socks; `buried` marks skin under shoes and trousers."""
    leg = chart.on_leg
    edge = np.where(leg, chart.along_leg - (chart.ankle - rise), -ELSEWHERE)
    pattern = Pattern([edge], np.full(len(leg), 0.0025), margin=0.012, rounds=4)
    return make_shell(chart, pattern, buried)


def _margin(ease: float) -> float:
    """Depth (m) to which skin is visible under hems: less under tight cloth."""
    return 0.02 + 0.8 * ease


def _hips(chart: BodyChart) -> Float[Array, "N"]:
    """1 from the crotch to the waist, where cloth bridges the legs, and 0 elsewhere."""
    z = chart.vertices[:, 2]
    above, below = (z - chart.crotch + 0.05) / 0.08, (chart.waist + 0.1 - z) / 0.1
    return np.where(chart.on_arm, 0.0, np.clip(above, 0, 1) * np.clip(below, 0, 1))


def _reach(share: float, first: float, second: float) -> float:
    """Metres along a limb from a share: 1 at its middle joint, 2 at its end joint."""
    return float(np.interp(share, [0, 1, 2], [0, first, second]))
