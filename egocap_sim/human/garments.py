"""The wardrobe's cuts: tops and bottoms as shells around a person."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap_sim.bodies import INDEX
from egocap_sim.human.anny_model import BareBody
from egocap_sim.human.chart import LEFT_ARM, LEFT_LEG, RIGHT_ARM, RIGHT_LEG, TORSO, Chart
from egocap_sim.human.details import Marks
from egocap_sim.human.shell import ELSEWHERE, Cut, Level, Shell, make_shell


@dataclass(frozen=True)
class Top:
    """A garment of the upper body; lengths are shares, cloth distances metres."""

    sleeve: float  # 0 shoulder, 1 elbow, 2 wrist
    hem: float  # 0 crotch, 1 waist
    collar: float  # m above the ring around the base of the neck; below it if negative
    gap: float
    ease: float  # looseness of the torso
    sleeve_ease: float
    details: tuple[str, ...] = ("side_seams", "hems")  # of `egocap_sim.human.details`
    crumple: float = 1.0  # depth of folds


@dataclass(frozen=True)
class Bottom:
    """A garment of the legs."""

    leg: float  # 0 hip, 1 knee, 2 ankle
    gap: float
    ease: float  # looseness at the hem, growing from the hip
    details: tuple[str, ...] = ("side_seams", "hems", "front_pockets", "back_pockets")
    crumple: float = 1.0


SHIRT = ("side_seams", "hems", "placket", "chest_pocket")
TOPS: dict[str, Top] = {
    "tshirt": Top(0.55, 0.22, 0.0, 0.006, 0.012, 0.016),
    "print_tshirt": Top(0.6, 0.2, 0.0, 0.006, 0.016, 0.02, ("side_seams", "hems", "motif")),
    "slim_tshirt": Top(0.42, 0.45, -0.02, 0.006, 0.004, 0.004, crumple=0.6),
    "tank_top": Top(0.12, 0.35, -0.035, 0.006, 0.006, 0.004, crumple=0.7),
    "longsleeve": Top(1.92, 0.25, 0.0, 0.006, 0.010, 0.007),
    "shirt": Top(1.95, 0.12, 0.035, 0.007, 0.018, 0.014, SHIRT, 1.2),
    "sweater": Top(1.95, 0.28, 0.01, 0.010, 0.020, 0.016, ("ribs",), 0.8),
    "hoodie": Top(1.97, 0.22, 0.045, 0.012, 0.028, 0.024, ("ribs", "kangaroo"), 1.1),
    "jacket": Top(1.97, 0.10, 0.05, 0.014, 0.034, 0.026, ("side_seams", "hems", "zip"), 1.2),
}
BOTTOMS: dict[str, Bottom] = {
    "shorts": Bottom(0.78, 0.007, 0.030),
    "tight_shorts": Bottom(0.55, 0.004, 0.0, ("side_seams", "hems"), 0.3),
    "slim_trousers": Bottom(1.86, 0.005, 0.003, crumple=0.8),
    "trousers": Bottom(1.96, 0.006, 0.018),
    "wide_trousers": Bottom(1.99, 0.005, 0.045, ("side_seams", "front_pockets", "pressed")),
    "leggings": Bottom(1.80, 0.004, 0.0, ("side_seams",), 0.25),
}

SOCKS: dict[str, float] = {"ankle_socks": 0.06, "crew_socks": 0.16}  # m above the ankle


@dataclass(frozen=True, eq=False)
class Fitted:
    """A garment on a person: its cloth and the skin it hides."""

    shell: Shell
    covered: Bool[Array, "N"]


def fit_top(body: BareBody, chart: Chart, top: Top) -> Fitted:
    """Put a top on a person."""
    z = body.vertices[:, 2]
    crotch, waist, chest = _levels(body)
    hem = crotch + 0.03 + top.hem * (waist - crotch - 0.03)
    arm = np.isin(chart.piece, (LEFT_ARM, RIGHT_ARM))
    cut = Cut(
        [
            np.where(arm, _along(top.sleeve, chart.elbow, chart.wrist) - chart.arm, ELSEWHERE),
            np.where(chart.piece == TORSO, top.collar - chart.neck, ELSEWHERE),
        ],
        Level(hem, above=True, where=~arm),
        margin=_margin(max(top.ease, top.sleeve_ease)),
    )
    drop = np.clip((chest - z) / (chest - hem), 0, 1)
    # Shoulders carry the cloth; it falls freely from the chest down and along the sleeves.
    ease = top.ease * (0.25 + 0.75 * drop)
    sleeve = top.sleeve_ease * np.clip(chart.arm / 0.12, 0.2, 1)
    collar_ease = np.clip((top.collar - chart.neck) / 0.08, 0.2, 1)
    looseness = np.where(arm, sleeve, ease * collar_ease)
    gap = top.gap + 0.004 * drop * ~arm  # over the waistband below
    shell = make_shell(body, chart, cut, gap, looseness, _hips(body, chart))
    legs = np.isin(shell.piece, (LEFT_LEG, RIGHT_LEG))
    return Fitted(
        replace(shell, piece=np.where(legs, TORSO, shell.piece)), cut.covered(body.vertices)
    )


def fit_bottom(body: BareBody, chart: Chart, bottom: Bottom, buried: Bool[Array, "N"]) -> Fitted:
    """Put trousers or shorts on a person; `buried` is what the top hides of them."""
    z = body.vertices[:, 2]
    waist = _levels(body)[1]
    leg = np.isin(chart.piece, (LEFT_LEG, RIGHT_LEG))
    arm = np.isin(chart.piece, (LEFT_ARM, RIGHT_ARM))
    length = _along(bottom.leg, chart.knee, chart.ankle)
    cut = Cut(
        [
            np.where(arm, -ELSEWHERE, ELSEWHERE),
            np.where(leg, length - chart.leg, ELSEWHERE),
        ],
        Level(waist, above=False, where=~arm),
        margin=_margin(bottom.ease),
    )
    looseness = bottom.ease * np.where(leg, np.clip(chart.leg / length, 0.05, 1), 0.05)
    gap = np.full(len(z), bottom.gap)
    shell = make_shell(body, chart, cut, gap, looseness, _hips(body, chart), buried)
    return Fitted(shell, cut.covered(body.vertices))


def fit_socks(body: BareBody, chart: Chart, rise: float, buried: Bool[Array, "N"]) -> Fitted:
    """Put socks on a person; `buried` is what shoes and trousers hide of them."""
    leg = np.isin(chart.piece, (LEFT_LEG, RIGHT_LEG))
    cut = Cut([np.where(leg, chart.leg - (chart.ankle - rise), -ELSEWHERE)], margin=0.012)
    gap = np.full(len(leg), 0.0025)
    shell = make_shell(body, chart, cut, gap, 0 * gap, buried=buried, rounds=4)
    return Fitted(shell, cut.covered(body.vertices))


def _margin(ease: float) -> float:
    """How deep (m) under its hems skin can be seen: less under tight cloth."""
    return 0.02 + 0.8 * ease


def _hips(body: BareBody, chart: Chart) -> Float[Array, "N"]:
    """1 from the crotch to the waist and 0 elsewhere: where cloth spans from leg to leg."""
    z = body.vertices[:, 2]
    crotch, waist, _ = _levels(body)
    rise = np.clip((z - crotch + 0.05) / 0.08, 0, 1) * np.clip((waist + 0.1 - z) / 0.1, 0, 1)
    return np.where(np.isin(chart.piece, (LEFT_ARM, RIGHT_ARM)), 0.0, rise)


def marks(body: BareBody, chart: Chart, accent: Float[Array, "3"]) -> Marks:
    """Where details go on a person; `accent` is the sRGB colour (0 to 1) of belts and prints."""
    crotch, waist, chest = _levels(body)
    return Marks(
        crotch=crotch,
        waist=waist,
        chest=chest,
        neck=float(body.joints[INDEX["l_clavicle"], 2]),
        elbow=-chart.elbow,
        knee=-chart.knee,
        accent=tuple(float(255 * c) for c in accent),
    )


def _levels(body: BareBody) -> tuple[float, float, float]:
    """Heights (m) of the crotch, the waist and the chest."""
    joints = body.joints[:, 2]
    middle = (np.abs(body.vertices[:, 1]) < 0.02) & (body.vertices[:, 2] > 0.3 * body.height_m)
    crotch = float(body.vertices[middle, 2].min())
    waist = float(joints[INDEX["spine"]] + 0.02 * body.height_m / 1.75)
    return crotch, waist, float(joints[INDEX["chest"]] + 0.10)


def _along(share: float, first: float, second: float) -> float:
    """Metres along a limb from a share: 1 is its first joint below the root, 2 the second."""
    return float(np.interp(share, [0, 1, 2], [0, first, second]))
