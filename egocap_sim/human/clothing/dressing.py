"""Dress a body: skin, clothes, shoes and hair, each without the faces that outer layers hide."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from scipy.spatial import KDTree

from egocap_sim.assets.mesh import Mesh
from egocap_sim.human.body.body_chart import BodyChart
from egocap_sim.human.body.skin import IRISES, rgb, skin_mesh, skin_texture
from egocap_sim.human.body.skinning import Worn
from egocap_sim.human.clothing.accessories import ACCESSORIES
from egocap_sim.human.clothing.details import Marks
from egocap_sim.human.clothing.fabric import PALETTE, TILE_M, Fabric, fabric_texture, one_color
from egocap_sim.human.clothing.garments import (
    BOTTOMS,
    SOCKS,
    TOPS,
    Bottom,
    Top,
    fit_bottom,
    fit_socks,
    fit_top,
    fit_trim,
)
from egocap_sim.human.clothing.hair import HAIR_COLORS, HAIRCUTS, make_hair
from egocap_sim.human.clothing.outfit import BAREFOOT, NO_SOCKS, Outfit
from egocap_sim.human.clothing.shell import Shell
from egocap_sim.human.clothing.shoes import SHOES, make_shoes, shoe_texture
from egocap_sim.human.clothing.skirts import Skirt, make_skirt
from egocap_sim.human.clothing.tailoring import Cloth, sew

UNDER_TROUSERS = 1.9  # least `Bottom.leg` of trousers that cover the shoe's collar
Rng = np.random.Generator
Mask = Bool[Array, "N"]  # of the skin's vertices


def dress(
    chart: BodyChart, outfit: Outfit, tone: float, headgear: str | None, rng: Rng
) -> list[Mesh]:
    """All meshes of a person except headgear, under which hair is flattened."""
    hair, hair_color = HAIRCUTS[outfit.hair], rgb(HAIR_COLORS[outfit.hair_color])
    male = chart.body.phenotype.gender < 0.5
    beard = float(np.clip(rng.uniform(-0.8, 0.8), 0, 0.75)) * male
    skin = skin_texture(tone, hair_color, str(rng.choice(IRISES)), rng, beard)
    worn = _upper(chart, outfit, rng)
    lower = _lower(chart, outfit, worn[0].hidden, rng)
    worn += [*lower, *_feet(chart, outfit, _union(chart, lower), rng)]
    if hair is not None:
        worn += make_hair(chart, hair, hair_color, headgear, rng)
    for kind, fits in ACCESSORIES.items():
        if (name := getattr(outfit, kind)) != "none":
            worn.append(fits[name](chart, rng))
    return [skin_mesh(chart.body, skin, _union(chart, worn)), *(w.mesh for w in worn)]


def _union(chart: BodyChart, worn: Iterable[Worn]) -> Mask:
    return np.any([np.zeros(len(chart.vertices), bool), *(w.hidden for w in worn)], axis=0)


def _upper(chart: BodyChart, outfit: Outfit, rng: Rng) -> list[Worn]:
    """The top, its inner layer, its collar and its skirt."""
    top, second = TOPS[outfit.top], outfit.top_fabric.colors[1]
    tucked = isinstance(BOTTOMS[outfit.bottom], Skirt)
    shell = fit_top(chart, top, tucked)
    marks = _marks(chart, rgb(PALETTE[second]))
    cloth = _cloth(top, outfit.top_fabric, marks, rng)
    worn = [sew("top", shell, chart.body, cloth)]
    if top.inner is not None:
        under = replace(TOPS[top.inner], hem=min(1.0, top.hem + 0.12), trim=None)
        inner = fit_top(chart, under, tucked)
        inner = replace(inner, faces=_shown(inner, chart, shell.covered))
        plain = _cloth(under, one_color("plain", second), marks, rng)
        worn.append(sew("inner", inner, chart.body, plain))
    if top.trim is not None:
        collar = replace(fit_trim(chart, top), covered=shell.covered)
        if len(collar.faces):
            worn.append(sew("collar", collar, chart.body, replace(cloth, details=(), crumple=0.3)))
    if top.skirt is not None:
        skirt = make_skirt(chart, top.skirt, chart.waist + 0.012, top.gap + 0.012)
        worn.append(sew("skirt", skirt, chart.body, replace(cloth, details=("hems",))))
    return worn


def _shown(inner: Shell, chart: BodyChart, covered: Mask) -> Array:
    """Triangles of inner cloth over skin that the outer layer leaves visible."""
    _, near = KDTree(chart.vertices).query(inner.skin)
    return inner.faces[~covered[near].take(inner.faces.T).all(0)]


def _lower(chart: BodyChart, outfit: Outfit, under_top: Mask, rng: Rng) -> list[Worn]:
    """Trousers, shorts or a skirt."""
    bottom = BOTTOMS[outfit.bottom]
    if bottom is None:
        return []
    marks = _marks(chart, rgb(PALETTE[outfit.shoe_color]))
    if isinstance(bottom, Skirt):
        shell = make_skirt(chart, bottom, chart.waist + 0.02, TOPS[outfit.top].gap + 0.012)
        fabric = fabric_texture(outfit.bottom_fabric, rng)
        cloth = Cloth(fabric, TILE_M, rng, 0.8, ("hems", "belt"), marks)
    else:
        shell = fit_bottom(chart, bottom, under_top)
        cloth = _cloth(bottom, outfit.bottom_fabric, marks, rng)
    return [sew("bottom", shell, chart.body, cloth)]


def _feet(chart: BodyChart, outfit: Outfit, under_bottom: Mask, rng: Rng) -> list[Worn]:
    """Shoes and socks."""
    if outfit.shoes == BAREFOOT:
        return []
    leather = fabric_texture(one_color("plain", outfit.shoe_color), rng)
    shoe, bottom = SHOES[outfit.shoes], BOTTOMS[outfit.bottom]
    if isinstance(bottom, Bottom) and bottom.leg > UNDER_TROUSERS:
        shoe = replace(
            shoe, collar=min(shoe.collar, 0.02)
        )  # a higher collar would pass through the cloth at the heel
    texture = shoe_texture(leather, rgb(PALETTE[outfit.sole_color]), shoe.laced)
    worn = [make_shoes(chart.body, shoe, texture)]
    if outfit.socks != NO_SOCKS:
        socks = fit_socks(chart, SOCKS[outfit.socks], worn[0].hidden | under_bottom)
        wool = fabric_texture(one_color("knit", outfit.sock_color), rng)
        if len(socks.faces):  # boots and trousers may hide them completely
            worn.append(sew("socks", socks, chart.body, Cloth(wool, TILE_M, rng, 0.2, ("ribs",))))
    return worn


def _cloth(garment: Top | Bottom, fabric: Fabric, marks: Marks, rng: Rng) -> Cloth:
    """Fabric, folds and painted details of a garment."""
    dyed = {"denim": ("faded",), "gradient": ("gradient",)}.get(fabric.pattern, ())
    details = (*dyed, *garment.details)
    crumple = garment.crumple * (0.6 + 0.8 * fabric.wear)
    return Cloth(fabric_texture(fabric, rng), TILE_M, rng, crumple, details, marks)


def _marks(chart: BodyChart, accent: Float[Array, "3"]) -> Marks:
    """Positions of details; `accent` is the sRGB colour (0 to 1) of belts and prints."""
    red, green, blue = (float(255 * c) for c in accent)
    return Marks(
        crotch=chart.crotch,
        waist=chart.waist,
        chest=chart.chest,
        neck=float(chart.joint("l_clavicle")[2]),
        elbow=-chart.elbow,
        knee=-chart.knee,
        accent=(red, green, blue),
    )
