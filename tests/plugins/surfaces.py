"""A scene for every BSDF, texture and spectrum."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tests.plugins import files
from tests.plugins.row import Node, Row, ball, grey, matt, plate, stage

WAVES = [(400.0, 0.1), (550.0, 0.2), (600.0, 0.9), (700.0, 0.9)]  # nm, share: no smooth curve through its RGB


def on_ball(plugin: str, note: str = "", **parameters: Any) -> Row:
    return Row("bsdf", plugin, lambda mi, folder: stage(mi, thing=ball({"type": plugin, **parameters})), note)


def plates(plugin: str, note: str, *turned: float, **parameters: Any) -> Row:
    """Plates behind each other, each turned by so many degrees."""

    def make(mi: Any, folder: Path) -> Node:
        filters = {
            f"plate{k}": plate(mi, -0.5 - 0.2 * k, {"type": plugin, **parameters}, 0.8, angle)
            for k, angle in enumerate(turned)
        }
        return stage(mi, **filters)

    return Row("bsdf", plugin, make, note)


def facing(plugin: str, note: str, **parameters: Any) -> Row:
    """Two smooth plates that pass light on to each other at Brewster's angle, in crossed planes."""

    def make(mi: Any, folder: Path) -> Node:
        t, surface = mi.ScalarTransform4f(), {"type": plugin, **parameters}
        # The camera looks along +y; the first plate throws its rays up, the second one, above, along x.
        first = t.translate([0, 0, 0.6]).rotate([1, 0, 0], 90 - 56.3).scale([0.7, 1.2, 1])
        second = t.look_at(origin=[0, 0.6, 2.2], target=[0.67, 0.4, 1.75], up=[0, 1, 0]).scale(3.0)
        sky = {"sky": {"type": "constant", "radiance": grey(1.0)}}
        black = {"type": "diffuse", "reflectance": grey(0.0)}
        return stage(mi, sky, near={"type": "rectangle", "to_world": first, "bsdf": surface},
                     far={"type": "rectangle", "to_world": second, "bsdf": surface},
                     floor={"type": "rectangle", "to_world": t.scale(3), "bsdf": black})  # fmt: skip

    return Row("bsdf", plugin, make, note)


def file_bsdf(plugin: str, written: Any, name: str) -> Row:
    def make(mi: Any, folder: Path) -> Node:
        return stage(mi, thing=ball({"type": plugin, "filename": written(folder / name)}))

    return Row("bsdf", plugin, make)


def on_wall(kind: str, plugin: str, texture: Any, note: str = "") -> Row:
    """A plate with something as its reflectance."""
    return Row(kind, plugin, lambda mi, folder: stage(
        mi, thing=plate(mi, 0.0, {"type": "diffuse", "reflectance": texture(folder)}, 0.9)), note)  # fmt: skip


def bumps(mi: Any, folder: Path) -> Node:
    texture = {"type": "bitmap", "filename": files.picture(folder / "t.exr"), "raw": True}
    return stage(mi, thing=ball({"type": "bumpmap", "t": texture, "scale": 0.2, "bsdf": matt()}))


def normals(mi: Any, folder: Path) -> Node:
    texture = {"type": "bitmap", "filename": files.normals(folder / "n.exr"), "raw": True}
    return stage(mi, thing=ball({"type": "normalmap", "normalmap": texture, "bsdf": matt()}))


def vertex_colors(mi: Any, folder: Path) -> Node:
    paint = {"type": "diffuse", "reflectance": {"type": "mesh_attribute", "name": "vertex_color"}}
    return stage(mi, thing={"type": "ply", "filename": files.mesh(folder / "c.ply", colored=True), "bsdf": paint})


def masked_sun(mi: Any, folder: Path) -> Node:
    """Half of the light of a point lamp passes the mask; a shadow ray that it stops would miss that."""
    lamp = {"lamp": {"type": "point", "position": [0, -1.0, 3.5], "intensity": grey(20.0)}}
    t = mi.ScalarTransform4f().translate([0, -0.5, 2.0]).scale(1.5)
    screen = {"type": "rectangle", "to_world": t, "bsdf": {"type": "mask", "opacity": 0.5, "bsdf": matt()}}
    return stage(mi, lamp, screen=screen)


POLISHED: Node = {"type": "roughconductor", "alpha": 0.1, "material": "none"}
BSDFS = [
    on_ball("blendbsdf", weight=0.5, a=matt(), b=POLISHED),
    Row("bsdf", "bumpmap", bumps),
    plates("circular", "alone", 0),
    plates("circular", "two in a row", 0, 0),
    on_ball("conductor", "ideal mirror", material="none"),
    on_ball("conductor", "gold", material="Au"),
    on_ball("dielectric"),
    facing("dielectric", "two at Brewster's angle", int_ior=1.5),
    on_ball("diffuse", reflectance=grey(0.7)),
    on_ball("hair"),
    on_ball("mask", opacity=0.5, bsdf=matt()),
    Row("bsdf", "mask", masked_sun, "before a point lamp"),
    file_bsdf("measured", files.measured, "m.bsdf"),
    file_bsdf("measured_polarized", files.measured_polarized, "m.pbsdf"),
    Row("bsdf", "normalmap", normals),
    plates("null", "", 0),
    on_ball("plastic", diffuse_reflectance=grey(0.5)),
    plates("polarizer", "alone", 0),
    plates("polarizer", "two in parallel", 0, 0),
    plates("polarizer", "two crossed", 0, 90),
    plates("polarizer", "not polarising", 0, 0, polarizing=False),
    on_ball("pplastic", diffuse_reflectance=grey(0.5)),
    on_ball("principled", base_color=grey(0.6), metallic=0.5, roughness=0.3),
    on_ball("principled", "with everything", base_color=grey(0.6), roughness=0.3, spec_trans=0.5, clearcoat=0.5,
            sheen=0.3, anisotropic=0.5, spec_tint=0.3, flatness=0.2),
    plates("principledthin", "", 30, base_color=grey(0.7), roughness=0.3, spec_trans=0.5, diff_trans=0.6),
    plates("retarder", "alone", 0),
    on_ball("roughconductor", material="Cr", alpha=0.2),
    on_ball("roughdielectric", alpha=0.2),
    on_ball("roughplastic", alpha=0.2, diffuse_reflectance=grey(0.5)),
    plates("thindielectric", "", 0),
    plates("twosided", "", 30, bsdf=matt()),
]  # fmt: skip
TEXTURES = [
    on_wall("texture", "bitmap", lambda folder: {"type": "bitmap", "filename": files.picture(folder / "t.exr")}),
    on_wall("texture", "checkerboard", lambda folder: {"type": "checkerboard", "color0": grey(0.2)}),
    Row("texture", "mesh_attribute", vertex_colors),
    on_wall("texture", "volume", lambda folder: {
        "type": "volume", "volume": {"type": "gridvolume", "filename": files.volume(folder / "g.vol")}}),
    on_wall("spectrum", "uniform", lambda folder: {"type": "uniform", "value": 0.5}),
    on_wall("spectrum", "srgb", lambda folder: grey(0.5), "as `rgb`"),
    on_wall("spectrum", "rawconstant", lambda folder: {"type": "rawconstant", "value": 0.5}),
    on_wall("spectrum", "irregular", lambda folder: {"type": "spectrum", "value": WAVES}, "as a `spectrum` of pairs"),
    on_wall("spectrum", "irregular", lambda folder: {
        "type": "irregular", "wavelengths": "400, 550, 600, 700", "values": "0.1, 0.2, 0.9, 0.9"}),
    on_wall("spectrum", "regular", lambda folder: {
        "type": "regular", "wavelength_min": 400.0, "wavelength_max": 700.0, "values": "0.1, 0.2, 0.9, 0.9"}),
]  # fmt: skip
