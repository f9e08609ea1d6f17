"""Render a gallery: one small picture for each model, and all of them on a sheet with captions.

    python scenes/gallery.py                          # 192 x 192 pixels, 256 samples, into output/gallery
    python scenes/gallery.py --size 96 --spp 32 --only plastic

A picture is the scene of `make_materials.py`, a ball on a foot on a chequered floor, and what its entry in `GALLERY`
changes in that. Every picture is written as NAME.png, the sheet as gallery.png.
"""

from __future__ import annotations

import argparse
import math
import re
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch

import torchrender as tr

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))  # the scenes are no part of the package
from scenes import make_caustics, make_materials, make_media, make_mirage
from scenes.make_materials import rgb

PASS = 64  # samples of one pass


@dataclass(frozen=True)
class Picture:
    """A picture: its caption, the material of the ball, and what else is different.

    Args:
        caption: what is written below it.
        bsdf: the BSDF of the ball and its foot.
        objects: replace objects of the scene of that name, or are added; None takes one away.
        scene: makes another scene from the size in pixels; nothing of the above applies to it.
        exposure: in stops.
        dtype: precision of the scene.
    """

    caption: str
    bsdf: dict[str, Any] = field(default_factory=lambda: {"type": "diffuse"})
    objects: dict[str, Any] = field(default_factory=dict)
    scene: Callable[[int], dict[str, Any]] | None = None
    exposure: float = 0.0
    dtype: torch.dtype = torch.float32

    @property
    def name(self) -> str:
        """The caption as the name of a file."""
        return re.sub(r"[^a-z0-9]+", "_", self.caption.lower()).strip("_")


def solids() -> dict[str, Any]:
    """What wears the material: a ball on a foot."""
    material = {"type": "ref", "id": "material"}
    at = tr.Transform.translate
    return {
        "ball": {"type": "sphere", "center": [0, 1.15, 0], "radius": 0.85, "bsdf": material},
        "foot": {
            "type": "cube",
            "to_world": at([0, 0.151, 0]).rotate([0, 1, 0], 30).scale([0.6, 0.15, 0.6]),
            "bsdf": material,
        },
    }


def stage(picture: Picture, size: int) -> dict[str, Any]:
    """The scene of a picture as a dict."""
    if picture.scene is not None:
        return picture.scene(size)
    scene = make_materials.shown(picture.bsdf, solids(), resolution=size)
    scene["integrator"] = {"type": "path", "max_depth": 16}
    scene |= picture.objects
    return {name: entry for name, entry in scene.items() if entry is not None}


def caustics(size: int) -> dict[str, Any]:
    """A wavy plate of glass under a beam, seen from the screen."""
    y, x = torch.meshgrid(torch.linspace(-1, 1, 256), torch.linspace(-1, 1, 256), indexing="ij")
    waves = torch.sin(9 * x + 3 * torch.sin(4 * y)) * torch.cos(8 * y - 2 * x) + 0.4 * torch.sin(17 * x - 13 * y + 1)
    return make_caustics.caustics(2.5e-3 * waves, colour=False, resolution=size)


def landscape(size: int) -> dict[str, Any]:
    """A height field with a painted texture."""
    y, x = torch.meshgrid(torch.linspace(-1, 1, 128), torch.linspace(-1, 1, 128), indexing="ij")
    hills = torch.sin(5 * x + 2 * torch.sin(3 * y)) * torch.cos(4 * y - x) + 0.4 * torch.sin(13 * x - 7 * y)
    heights = 0.16 * hills * (1 - x**4) * (1 - y**4)
    share = ((heights + 0.1) / 0.25).clamp(0, 1)[..., None]
    meadow, snow = torch.tensor([0.12, 0.3, 0.08]), torch.tensor([0.85, 0.85, 0.9])
    texels = {"type": "bitmap", "data": meadow + (snow - meadow) * share, "raw": True, "wrap_mode": "clamp"}
    scene = make_materials.shown({"type": "diffuse", "reflectance": texels}, resolution=size)
    scene["ball"] = {
        "type": "heightfield",
        "heights": heights,
        "to_world": tr.Transform.translate([0, 0.5, 0]).rotate([0, 1, 0], 25).rotate([1, 0, 0], -90).scale(1.5),
        "bsdf": {"type": "twosided", "bsdf": {"type": "ref", "id": "material"}},
    }
    return scene


def filled(medium: dict[str, Any], bsdf: dict[str, Any]) -> dict[str, Any]:
    """Objects of a ball that has a medium inside."""
    return {
        "integrator": {"type": "volpath", "max_depth": 256},
        "ball": {"type": "sphere", "center": [0, 1, 0], "radius": 1, "bsdf": bsdf, "interior": medium},
        "foot": None,
    }


def smoke() -> dict[str, Any]:
    """Objects of a plume of smoke in the place of the ball."""
    grid = tr.Transform.translate([-1, 0.01, -1]).scale(2)  # a little above the floor
    density = {"type": "gridvolume", "data": torch.from_numpy(make_media.smoke(48)), "to_world": grid}
    medium = {"type": "heterogeneous", "sigma_t": density, "albedo": rgb(0.85, 0.85, 0.9), "scale": 9.0}
    return {
        "integrator": {"type": "volpath", "max_depth": 64},
        "ball": {
            "type": "cube",
            "to_world": tr.Transform.translate([0, 1.01, 0]),
            "bsdf": {"type": "null"},
            "interior": medium,
        },
        "foot": None,
    }


def luneburg(voxels: int = 48) -> dict[str, Any]:
    """Objects of a ball that gathers parallel light in a point of its surface: n^2 = 2 - r^2."""
    axis = ((torch.arange(voxels) + 0.5) / voxels * 2 - 1) * 1.1
    z, y, x = torch.meshgrid(axis, axis, axis, indexing="ij")
    index = torch.sqrt((2 - x * x - y * y - z * z).clamp(min=0.2))
    grid = tr.Transform.translate([-1.1, -0.1, -1.1]).scale(2.2)
    medium = {"type": "gradientindex", "index": index, "to_world": grid}
    return {**filled(medium, {"type": "null"}), "integrator": {"type": "path", "max_depth": 8}}


def painted(size: int = 256) -> torch.Tensor:
    """Texels (size, size, 3) of coloured bands and spots."""
    centres = (torch.arange(size) + 0.5) / size * 2 * math.pi
    v, u = torch.meshgrid(centres, centres, indexing="ij")
    bands = torch.sin(8 * u + 2 * torch.sin(6 * v))
    waves = torch.sin(10 * v + 2 * torch.sin(4 * u))
    return torch.stack([0.5 + 0.35 * bands, 0.45 + 0.3 * waves, 0.5 + 0.35 * bands * waves], dim=-1)


def dents(size: int = 512) -> torch.Tensor:
    """Heights (size, size, 1) of a hammered surface, in units of the scene."""
    centres = (torch.arange(size) + 0.5) / size * 2 * math.pi
    v, u = torch.meshgrid(centres, centres, indexing="ij")
    return 0.012 * (torch.sin(14 * u + torch.sin(5 * v)) * torch.sin(9 * v + torch.sin(6 * u)))[..., None]


def weave(size: int = 512) -> torch.Tensor:
    """Normals (size, size, 3), as colours, of a basket's weave."""
    centres = (torch.arange(size) + 0.5) / size * 2 * math.pi
    v, u = torch.meshgrid(centres, centres, indexing="ij")
    over = (torch.sin(8 * u) * torch.sin(8 * v) > 0).float()
    x, y = 0.8 * torch.cos(16 * u) * over, 0.8 * torch.cos(16 * v) * (1 - over)
    normals = torch.stack([x, y, torch.ones_like(x)], dim=-1)
    return normals / torch.linalg.vector_norm(normals, dim=-1, keepdim=True) * 0.5 + 0.5


def spots(size: int = 256) -> torch.Tensor:
    """Weights (size, size, 1) of round spots with soft edges."""
    centres = (torch.arange(size) + 0.5) / size
    v, u = torch.meshgrid(centres, centres, indexing="ij")
    distance = torch.hypot((12 * u) % 1 - 0.5, (8 * v) % 1 - 0.5)
    return torch.sigmoid(40 * (0.32 - distance))[..., None]


def texture(data: torch.Tensor) -> dict[str, Any]:
    return {"type": "bitmap", "data": data, "raw": True}


def seen_by(zoom: float = 1.0, **sensor: Any) -> Callable[[int], dict[str, Any]]:
    """A row of balls, seen by another camera."""

    def scene(size: int) -> dict[str, Any]:
        made = make_materials.shown({"type": "diffuse"}, resolution=size)
        del made["ball"]
        old = made["sensor"]
        made["sensor"] = {
            "film": old["film"],
            "to_world": old["to_world"] @ tr.Transform.scale([zoom, zoom, 1]),
            **sensor,
        }
        colours = rgb(0.6, 0.1, 0.1), rgb(0.6, 0.5, 0.1), rgb(0.1, 0.4, 0.2), rgb(0.1, 0.2, 0.6)
        for i, colour in enumerate(colours):
            bsdf = {"type": "plastic", "diffuse_reflectance": colour}
            center = [1.2 * i - 1.8, 0.5, 2.1 - 1.5 * i]
            made[f"ball{i}"] = {"type": "sphere", "center": center, "radius": 0.5, "bsdf": bsdf}
        return made

    return scene


def tubes(size: int) -> dict[str, Any]:
    """Cylinders that stand on the floor."""
    made = make_materials.shown({"type": "diffuse"}, resolution=size)
    del made["ball"]
    for i in range(5):
        bsdf = {"type": "twosided", "bsdf": {"type": "roughconductor", "material": "Cu", "alpha": 0.2}}
        x, z, height = 0.62 * i - 1.25, 0.5 * math.sin(2.2 * i), 0.7 + 0.32 * i
        made[f"tube{i}"] = {"type": "cylinder", "p0": [x, 0, z], "p1": [x, height, z], "radius": 0.3, "bsdf": bsdf}
    return made


PLASTIC = {"diffuse_reflectance": rgb(0.1, 0.3, 0.6)}
NO_SKY = {"sky": None}
NIGHT = {"sky": {"type": "constant", "radiance": rgb(0.01, 0.012, 0.02)}}

GALLERY = [
    # materials
    Picture("diffuse", {"type": "diffuse", "reflectance": rgb(0.7, 0.25, 0.15)}),
    Picture("bitmap", {"type": "diffuse", "reflectance": {"type": "bitmap", "data": painted(), "raw": True}}),
    Picture("conductor: silver", {"type": "conductor", "material": "Ag"}),
    Picture("roughconductor: gold", {"type": "roughconductor", "material": "Au", "alpha": 0.2}),
    Picture(
        "roughconductor: copper",
        {"type": "roughconductor", "material": "Cu", "distribution": "beckmann", "alpha": 0.35},
    ),
    Picture(
        "roughconductor: brushed",
        {"type": "roughconductor", "material": "Al", "distribution": "ggx", "alpha_u": 0.4, "alpha_v": 0.05},
    ),
    Picture("dielectric: glass", {"type": "dielectric", "int_ior": "bk7"}),
    Picture("dielectric: diamond", {"type": "dielectric", "int_ior": "diamond"}),
    Picture("roughdielectric", {"type": "roughdielectric", "alpha": 0.15}),
    Picture("thindielectric", {"type": "thindielectric"}),
    Picture("plastic", {"type": "plastic", **PLASTIC}),
    Picture("roughplastic", {"type": "roughplastic", "alpha": 0.2, **PLASTIC}),
    Picture(
        "principled: lacquered metal",
        {"type": "principled", "base_color": rgb(0.6, 0.05, 0.05), "metallic": 0.8, "roughness": 0.4, "clearcoat": 1.0},
    ),
    Picture(
        "principled: sheen",
        {"type": "principled", "base_color": rgb(0.15, 0.05, 0.3), "roughness": 0.9, "sheen": 1.0, "sheen_tint": 0.5},
    ),
    Picture(
        "principled: tinted glass",
        {"type": "principled", "base_color": rgb(0.4, 0.8, 0.6), "spec_trans": 1.0, "eta": 1.4, "roughness": 0.15},
    ),
    Picture(
        "principledthin: paper",
        {"type": "principledthin", "base_color": rgb(0.85, 0.75, 0.6), "roughness": 0.8, "diff_trans": 1.2},
    ),
    Picture(
        "redner",
        {
            "type": "redner",
            "diffuse_reflectance": rgb(0.15, 0.35, 0.2),
            "specular_reflectance": 0.15,
            "roughness": 0.02,
        },
    ),
    Picture(
        "blendbsdf: paint on metal",
        {
            "type": "blendbsdf",
            "weight": texture(spots()),
            "metal": {"type": "roughconductor", "material": "Au", "alpha": 0.15},
            "paint": {"type": "plastic", **PLASTIC},
        },
    ),
    Picture(
        "mask: a perforated sheet",
        {
            "type": "mask",
            "opacity": texture(1 - spots()),
            "sheet": {"type": "twosided", "bsdf": {"type": "roughconductor", "material": "Cu", "alpha": 0.3}},
        },
    ),
    Picture(
        "normalmap: a weave",
        {
            "type": "normalmap",
            "normalmap": texture(weave()),
            "bsdf": {"type": "roughplastic", "diffuse_reflectance": rgb(0.5, 0.3, 0.12), "alpha": 0.3},
        },
    ),
    Picture(
        "bumpmap: hammered gold",
        {
            "type": "bumpmap",
            "heights": texture(dents()),
            "bsdf": {"type": "roughconductor", "material": "Au", "alpha": 0.15},
        },
    ),
    # lights
    Picture("area light", {"type": "roughplastic", **PLASTIC}, NO_SKY, exposure=0.5),
    Picture(
        "point light",
        {"type": "roughplastic", **PLASTIC},
        {**NIGHT, "lamp": {"type": "point", "position": [-2, 3, 2.5], "intensity": rgb(20, 18, 15)}},
    ),
    Picture(
        "spot",
        {"type": "roughplastic", **PLASTIC},
        {
            **NIGHT,
            "lamp": {
                "type": "spot",
                "to_world": tr.Transform.look_at([-2.5, 4.5, 3], [0, 0.8, 0], [0, 1, 0]),
                "cutoff_angle": 20,
                "intensity": rgb(90, 80, 65),
            },
        },
    ),
    Picture(
        "projector",
        {"type": "diffuse", "reflectance": 0.8},
        {
            **NIGHT,
            "lamp": {
                "type": "projector",
                "to_world": tr.Transform.look_at([-1.5, 3, 5], [0, 0.8, 0], [0, 1, 0]),
                "irradiance": texture(painted()),
                "fov": 40,
                "scale": 60.0,
            },
        },
    ),
    Picture(
        "directional",
        {"type": "roughplastic", **PLASTIC},
        {
            "sky": {"type": "constant", "radiance": rgb(0.15, 0.2, 0.3)},
            "lamp": {"type": "directional", "direction": [1, -1.6, -0.8], "irradiance": rgb(3, 2.7, 2.2)},
        },
    ),
    Picture("environment map", {"type": "roughplastic", **PLASTIC}, {"lamp": None}),
    # cameras
    Picture("thinlens", scene=seen_by(type="thinlens", fov=30, aperture_radius=0.2, focus_distance=6.6)),
    Picture("orthographic", scene=seen_by(2.2, type="orthographic")),
    Picture("fisheye", scene=seen_by(type="fisheye", fov=150)),
    # shapes, media, light tracing
    Picture("cylinder", scene=tubes),
    Picture("heightfield", scene=landscape),
    Picture("heterogeneous: smoke", objects=smoke()),
    Picture(
        "homogeneous: wax",
        objects=filled(
            {"type": "homogeneous", "sigma_t": 6.0, "albedo": rgb(0.97, 0.9, 0.7)},
            {"type": "roughdielectric", "alpha": 0.3, "int_ior": 1.3},
        )
        | {"lamp": None},
    ),
    Picture(
        "homogeneous: juice",
        objects=filled(
            {"type": "homogeneous", "sigma_t": rgb(0.1, 0.9, 2.5), "albedo": 0.3},
            {"type": "dielectric", "int_ior": 1.33},
        ),
    ),
    Picture("ptracer: caustics of a plate", scene=caustics),
    Picture("gradientindex: Luneburg ball", objects=luneburg()),
    Picture("gradientindex: mirage", scene=lambda size: make_mirage.mirage(size, size), dtype=torch.float64),
]


def render(picture: Picture, size: int, spp: int) -> torch.Tensor:
    """A picture (size, size, 3), tone mapped."""
    scene = tr.load_dict(stage(picture, size), dtype=picture.dtype)
    with torch.no_grad():
        image = tr.render(scene, spp=min(spp, PASS), passes=math.ceil(spp / PASS), seed=0)
    return tr.tonemap(image, picture.exposure)


def sheet(images: list[torch.Tensor], captions: list[str], columns: int) -> np.ndarray:
    """Pictures of one size (size, size, 3) in rows, each with its caption below: (H, W, 3), 8 bits."""
    from PIL import Image, ImageDraw, ImageFont

    size = images[0].shape[0]
    line, gap = max(12, size // 9), max(2, size // 32)
    font = ImageFont.load_default(0.62 * line)
    rows = -(-len(images) // columns)
    paper = Image.new("RGB", (columns * (size + gap) + gap, rows * (size + line + gap) + gap), "white")
    draw = ImageDraw.Draw(paper)
    for i, (image, caption) in enumerate(zip(images, captions, strict=True)):
        x, y = gap + i % columns * (size + gap), gap + i // columns * (size + line + gap)
        paper.paste(Image.fromarray((255 * image.numpy() + 0.5).astype(np.uint8)), (x, y))
        draw.text((x + size / 2, y + size + line / 2), caption, fill="black", font=font, anchor="mm")
    return np.array(paper)


def run(folder: Path, *, size: int = 192, spp: int = 256, only: str = "", columns: int = 6) -> list[str]:
    """Write the pictures and the sheet; returns the names of the pictures.

    Args:
        folder: where they go.
        size: pixels along either side of a picture.
        spp: samples a pixel, in passes of 64.
        only: only pictures whose caption contains this.
        columns: pictures in a row of the sheet.

    Raises:
        ValueError: if no caption contains `only`.
    """
    chosen = [picture for picture in GALLERY if only.lower() in picture.caption.lower()]
    if not chosen:
        raise ValueError(f"no caption contains {only!r}: {'; '.join(picture.caption for picture in GALLERY)}")
    folder.mkdir(parents=True, exist_ok=True)
    images = []
    for picture in tr.progress(chosen, desc="gallery"):
        images.append(render(picture, size, spp))
        tr.io.write_image(folder / f"{picture.name}.png", images[-1], raw=True)
    paper = sheet(images, [picture.caption for picture in chosen], min(columns, len(chosen)))
    tr.io.write_image(folder / "gallery.png", torch.from_numpy(paper).float() / 255, raw=True)
    return [picture.name for picture in chosen]


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--size", type=int, default=192, help="pixels along a side of a picture (default 192)")
    parser.add_argument("--spp", type=int, default=256, help="samples a pixel (default 256)")
    parser.add_argument("--only", default="", help="only pictures whose caption contains this")
    parser.add_argument("--columns", type=int, default=6, help="pictures in a row of the sheet (default 6)")
    parser.add_argument("--output", type=Path, default=Path("output/gallery"), help="folder for the pictures")
    options = parser.parse_args(argv)
    if min(options.size, options.spp, options.columns) < 1:
        parser.error("--size, --spp and --columns: expected at least 1")
    start = time.perf_counter()
    try:
        names = run(options.output, size=options.size, spp=options.spp, only=options.only, columns=options.columns)
    except ValueError as error:
        parser.error(str(error))
    seconds = time.perf_counter() - start
    print(f"{len(names)} pictures and the sheet gallery.png are in {options.output}; {seconds:.1f} s")


if __name__ == "__main__":
    main()
