"""Dress a body: skin, clothes, shoes and hair, the inner ones without what the outer ones hide."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Bool
from numpy import ndarray as Array

from egocap_sim.assets.mesh import Mesh
from egocap_sim.human.body.anny_model import BareBody
from egocap_sim.human.body.body_chart import Chart, make_chart
from egocap_sim.human.body.skin import IRISES, rgb, skin_mesh, skin_texture
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
    levels,
    marks,
)
from egocap_sim.human.clothing.hair import HAIR_COLORS, HAIRCUTS, make_hair
from egocap_sim.human.clothing.outfit import BAREFOOT, NO_SOCKS, Outfit
from egocap_sim.human.clothing.sewing import sew
from egocap_sim.human.clothing.shoes import SHOES, make_shoes, shoe_texture
from egocap_sim.human.clothing.skirts import Skirt, make_skirt, under_skirt
from egocap_sim.human.clothing.tailoring import Cloth

UNDER_TROUSERS = 1.9  # length of trousers (`Bottom.leg`) from which shoes are worn under them


def dress(
    body: BareBody, clothes: Outfit, tone: float, headgear: str | None, rng: np.random.Generator
) -> list[Mesh]:
    """Everything drawn of a person but the headgear; hair is flattened under it."""
    chart = make_chart(body)
    hair_color = rgb(HAIR_COLORS[clothes.hair_color])
    male = body.phenotype.gender < 0.5
    beard = float(np.clip(rng.uniform(-0.8, 0.8), 0, 0.75)) * male
    skin = skin_texture(tone, hair_color, str(rng.choice(IRISES)), rng, beard)
    meshes, hidden, under_top = _upper(body, chart, clothes, rng)
    lower, under_bottom = _lower(body, chart, clothes, under_top, rng)
    meshes += lower
    hidden |= under_bottom
    feet, in_shoes = _feet(body, chart, clothes, under_bottom, rng)
    meshes += feet
    hidden |= in_shoes
    hair, under_hair = make_hair(body, chart, HAIRCUTS[clothes.hair], hair_color, headgear, rng)
    meshes += hair
    hidden |= under_hair
    for kind, fits in ACCESSORIES.items():
        if (name := getattr(clothes, kind)) != "none":
            worn, under = fits[name](body, chart, rng)
            meshes.append(worn)
            hidden |= under
    return [skin_mesh(body, skin, hidden), *meshes]


def _upper(
    body: BareBody, chart: Chart, clothes: Outfit, rng: np.random.Generator
) -> tuple[list[Mesh], Bool[Array, "N"], Bool[Array, "N"]]:
    """The top, what it is worn over, its collar and its skirt; hidden skin, and hidden trousers."""
    top = TOPS[clothes.top]
    tucked = isinstance(BOTTOMS[clothes.bottom], Skirt)
    fitted = fit_top(body, chart, top, tucked)
    places = marks(body, chart, rgb(PALETTE[clothes.top_fabric.colors[1]]))
    cloth = _cloth(top, clothes.top_fabric, places, rng)
    meshes = [sew("top", fitted.shell, body, cloth)]
    hidden = fitted.covered.copy()
    if top.inner is not None:
        under = replace(TOPS[top.inner], hem=min(1.0, top.hem + 0.12), trim=None)
        inner = fit_top(body, chart, under, tucked)
        shown = _shown(inner.shell.faces, inner.shell.skin, body, fitted.covered)
        shirt = one_color("plain", clothes.top_fabric.colors[1])
        plain = _cloth(under, shirt, places, rng)
        meshes.append(sew("inner", replace(inner.shell, faces=shown), body, plain))
        hidden |= inner.covered
    if top.trim is not None:
        collar = fit_trim(body, chart, top)
        if len(collar.faces):
            edge = replace(cloth, details=(), crumple=0.3)
            meshes.append(sew("collar", collar, body, edge))
    if top.skirt is not None:
        waist = levels(body)[1]
        skirt = make_skirt(body, chart, top.skirt, waist + 0.012, top.gap + 0.012)
        meshes.append(sew("skirt", skirt, body, replace(cloth, details=("hems",))))
        hidden |= under_skirt(body, chart, skirt)
    return meshes, hidden, fitted.covered


def _shown(faces: Array, skin: Array, body: BareBody, covered: Bool[Array, "N"]) -> Array:
    """The triangles of inner cloth that lie over skin not `covered` by the outer one."""
    from scipy.spatial import KDTree

    _, near = KDTree(body.vertices).query(skin)
    return faces[~covered[near].take(faces.T).all(0)]


def _lower(
    body: BareBody, chart: Chart, clothes: Outfit, under_top: Array, rng: np.random.Generator
) -> tuple[list[Mesh], Bool[Array, "N"]]:
    """Trousers, shorts or a skirt, and the skin they hide."""
    bottom = BOTTOMS[clothes.bottom]
    if bottom is None:
        return [], np.zeros(len(body.vertices), bool)
    places = marks(body, chart, rgb(PALETTE[clothes.shoe_color]))
    if isinstance(bottom, Skirt):
        top = TOPS[clothes.top]
        shell = make_skirt(body, chart, bottom, levels(body)[1] + 0.02, top.gap + 0.012)
        cloth = Cloth(fabric_texture(clothes.bottom_fabric, rng), TILE_M, rng, 0.8,
                      ("hems", "belt"), places)  # fmt: skip
        return [sew("bottom", shell, body, cloth)], under_skirt(body, chart, shell)
    fitted = fit_bottom(body, chart, bottom, under_top)
    cloth = _cloth(bottom, clothes.bottom_fabric, places, rng)
    return [sew("bottom", fitted.shell, body, cloth)], fitted.covered


def _feet(
    body: BareBody, chart: Chart, clothes: Outfit, under_bottom: Array, rng: np.random.Generator
) -> tuple[list[Mesh], Bool[Array, "N"]]:
    """Shoes and socks, and the skin they hide."""
    if clothes.shoes == BAREFOOT:
        return [], np.zeros(len(body.vertices), bool)
    leather = fabric_texture(one_color("plain", clothes.shoe_color), rng)
    shoe, bottom = SHOES[clothes.shoes], BOTTOMS[clothes.bottom]
    if isinstance(bottom, Bottom) and bottom.leg > UNDER_TROUSERS:
        shoe = replace(shoe, collar=min(shoe.collar, 0.02))  # or it would stand out at the heel
    texture = shoe_texture(leather, rgb(PALETTE[clothes.sole_color]), shoe.laced)
    shoes, hidden = make_shoes(body, shoe, texture)
    meshes = [shoes]
    if clothes.socks != NO_SOCKS:
        socks = fit_socks(body, chart, SOCKS[clothes.socks], hidden | under_bottom)
        wool = fabric_texture(one_color("knit", clothes.sock_color), rng)
        if len(socks.shell.faces):  # boots and trousers may hide them whole
            cloth = Cloth(wool, TILE_M, rng, 0.2, ("ribs",))
            meshes.append(sew("socks", socks.shell, body, cloth))
            hidden = hidden | socks.covered
    return meshes, hidden


def _cloth(garment: Top | Bottom, fabric: Fabric, places: Marks, rng: np.random.Generator) -> Cloth:
    """Fabric and finish of a garment: jeans are faded, gradients run down it."""
    dyed = {"denim": ("faded",), "gradient": ("gradient",)}.get(fabric.pattern, ())
    details = (*dyed, *garment.details)
    crumple = garment.crumple * (0.6 + 0.8 * fabric.wear)
    return Cloth(fabric_texture(fabric, rng), TILE_M, rng, crumple, details, places)
