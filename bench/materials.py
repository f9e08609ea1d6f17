"""Materials: forward and backward time of every BSDF in one and the same scene, and whether all programs agree.

The scene is that of `scenes/make_materials.py`: a ball of the material on a chequered floor, under a sky and a lamp;
the last row has all materials that every program knows at once. Differentiated are the material's parameters and the
colour of the floor, of the mean square of the picture. Paths have 6 segments, none ends earlier by chance.

Before a material is timed, `--seeds` pictures and gradients of every program with `--check-spp` samples are compared:
pictures by the means of their blocks, gradients of mean(image * weight) by their sums over a parameter's entries. Where
gradients disagree, finite differences of this renderer's pictures are shown beside them.
"""

from __future__ import annotations

import argparse
import tempfile
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

import torchrender as tr
from scenes import make_materials
from scenes.make_materials import rgb

from .arguments import natural, peer_argument, positive
from .measured import Measured, rounds
from .ours import Ours
from .peers import KNOWN, Peer, PeerError, Peers
from .report import Result, Table
from .serving import weight_of

BLOCK = 16  # pixels along a side
CHANGE = 0.01  # of a parameter, for finite differences
DISAGREE = 5.0  # errors from which on finite differences tell who is right
ROUNDING = 1e-4  # of a block's mean: where there is no noise, single precision is left


@dataclass(frozen=True)
class Material:
    """A BSDF and the names of its differentiated parameters; `ours`: no other program has it."""

    bsdf: Mapping[str, Any]
    parameters: tuple[str, ...]
    ours: bool = False


_PLASTIC = {"diffuse_reflectance": rgb(0.7, 0.3, 0.2), "specular_reflectance": rgb(0.9, 0.8, 0.7)}
_PLASTIC_PARAMETERS = ("diffuse_reflectance.value", "specular_reflectance.value")
_GLASS = {"specular_reflectance": rgb(0.9, 0.8, 0.7), "specular_transmittance": rgb(0.7, 0.8, 0.9)}
_GLASS_PARAMETERS = ("specular_reflectance.value", "specular_transmittance.value")
_METAL = {"material": "Au", "specular_reflectance": rgb(0.9, 0.9, 0.8)}
_METAL_PARAMETERS = ("specular_reflectance.value", "alpha.value")
_PAINT = {"base_color": rgb(0.7, 0.3, 0.2), "roughness": 0.3}


def _waves(size: int = 64) -> np.ndarray:
    """Normals (size, size, 3), as colours, of waves."""
    v, u = np.meshgrid(*2 * [2 * np.pi * (np.arange(size) + 0.5) / size], indexing="ij")
    n = np.stack([0.4 * np.sin(4 * u), 0.4 * np.cos(3 * v), np.ones_like(u)], axis=-1)
    return (n / np.linalg.norm(n, axis=-1, keepdims=True) / 2 + 0.5).astype(np.float32)


_WAVES = _waves()

MATERIALS = {
    "diffuse": Material({"type": "diffuse", "reflectance": rgb(0.7, 0.3, 0.2)}, ("reflectance.value",)),
    "conductor": Material({"type": "conductor", **_METAL}, ("specular_reflectance.value",)),
    "roughconductor, ggx": Material(
        {"type": "roughconductor", "distribution": "ggx", "alpha": 0.2, **_METAL}, _METAL_PARAMETERS
    ),
    "roughconductor, beckmann": Material(
        {"type": "roughconductor", "distribution": "beckmann", "alpha": 0.2, **_METAL}, _METAL_PARAMETERS
    ),
    "dielectric": Material({"type": "dielectric", **_GLASS}, _GLASS_PARAMETERS),
    "thindielectric": Material({"type": "thindielectric", **_GLASS}, _GLASS_PARAMETERS),
    "roughdielectric, ggx": Material(
        {"type": "roughdielectric", "distribution": "ggx", "alpha": 0.2, **_GLASS}, (*_GLASS_PARAMETERS, "alpha.value")
    ),
    "roughdielectric, beckmann": Material(
        {"type": "roughdielectric", "distribution": "beckmann", "alpha": 0.2, **_GLASS},
        (*_GLASS_PARAMETERS, "alpha.value"),
    ),
    "plastic": Material({"type": "plastic", **_PLASTIC}, _PLASTIC_PARAMETERS),
    "roughplastic, ggx": Material(
        {"type": "roughplastic", "distribution": "ggx", "alpha": 0.2, **_PLASTIC}, (*_PLASTIC_PARAMETERS, "alpha")
    ),
    "roughplastic, beckmann": Material(
        {"type": "roughplastic", "distribution": "beckmann", "alpha": 0.2, **_PLASTIC}, (*_PLASTIC_PARAMETERS, "alpha")
    ),
    "principled": Material(
        {"type": "principled", "metallic": 0.3, "specular": 0.6, **_PAINT},
        ("base_color.value", "roughness.value", "metallic.value"),
    ),
    "principled, all lobes": Material(
        {
            "type": "principled",
            "metallic": 0.2,
            "spec_trans": 0.4,
            "eta": 1.4,
            "clearcoat": 0.6,
            "sheen": 0.5,
            **_PAINT,
        },
        ("base_color.value", "roughness.value", "metallic.value", "spec_trans.value", "clearcoat.value", "sheen.value"),
    ),
    "principledthin": Material(
        {"type": "principledthin", "spec_trans": 0.4, "diff_trans": 0.6, "eta": 1.4, **_PAINT},
        ("base_color.value", "roughness.value", "spec_trans.value", "diff_trans.value"),
    ),
    "roughconductor, brushed": Material(
        {"type": "roughconductor", "distribution": "ggx", "alpha_u": 0.3, "alpha_v": 0.1, **_METAL},
        ("specular_reflectance.value", "alpha_u.value", "alpha_v.value"),
    ),
    "blendbsdf": Material(
        {
            "type": "blendbsdf",
            "weight": 0.4,
            "bsdf_0": {"type": "diffuse", "reflectance": rgb(0.7, 0.3, 0.2)},
            "bsdf_1": {"type": "roughconductor", "distribution": "ggx", "alpha": 0.2, **_METAL},
        },
        ("weight.value", "bsdf_0.reflectance.value", "bsdf_1.alpha.value"),
    ),
    "mask": Material(
        {
            "type": "mask",
            "opacity": 0.7,
            "nested_bsdf": {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": rgb(0.7, 0.3, 0.2)}},
        },
        ("nested_bsdf.brdf_0.reflectance.value",),
    ),
    "normalmap": Material(
        {
            "type": "normalmap",
            "normalmap": {"type": "bitmap", "data": _WAVES, "raw": True},
            "nested_bsdf": {"type": "diffuse", "reflectance": rgb(0.7, 0.3, 0.2)},
        },
        ("nested_bsdf.reflectance.value", "normalmap.data"),
    ),
    "redner": Material(
        {"type": "redner", "diffuse_reflectance": rgb(0.6, 0.3, 0.2), "specular_reflectance": 0.3, "roughness": 0.2},
        ("diffuse_reflectance.value", "specular_reflectance.value", "roughness.value"),
        ours=True,
    ),
}
ALL = "all of them"


@dataclass(frozen=True)
class Case:
    """A scene to be measured: its name, its dict, what it is differentiated by, and whether peers know it."""

    name: str
    scene: dict[str, Any]
    parameters: tuple[str, ...]
    ours: bool = False


def cases(options: argparse.Namespace) -> list[Case]:
    """The scenes that `--only` leaves; ends the program if there are none."""
    size = {"resolution": options.resolution, "spp": options.spp}
    found = [
        Case(
            name,
            make_materials.shown(material.bsdf, **size),
            (*(f"material.{parameter}" for parameter in material.parameters), make_materials.FLOOR),
            material.ours,
        )
        for name, material in MATERIALS.items()
    ]
    # Names of objects: the words of the table without what a name cannot have.
    shared = {name.replace(", ", "_").replace(" ", "_"): m for name, m in MATERIALS.items() if not m.ours}
    scene = make_materials.together({name: material.bsdf for name, material in shared.items()}, **size)
    parameters = [f"{name}.{parameter}" for name, material in shared.items() for parameter in material.parameters]
    found.append(Case(ALL, scene, (*parameters, make_materials.FLOOR)))
    chosen = [case for case in found if options.only.lower() in case.name.lower()]
    if not chosen:
        raise SystemExit(f"--only: no material's name contains {options.only!r}: {', '.join(c.name for c in found)}")
    return chosen


def add_arguments(parser: argparse.ArgumentParser) -> None:
    peer_argument(parser)
    parser.add_argument("--seeds", type=natural, default=8, help="of the check; 0: none (default %(default)s)")
    parser.add_argument("--check-spp", type=positive, default=64, help="samples of the check (default %(default)s)")


class Loaded:
    """A case in this renderer and in the peers that know it, in a ``with`` block."""

    def __init__(self, case: Case, peers: list[Peer], options: argparse.Namespace) -> None:
        self.case, self.options = case, options
        self.notes: list[str] = []  # which peer did not know it
        self.peers = [peer for peer in peers if peer.ourselves or not case.ours]
        scene = tr.load_dict(case.scene)
        path = tr.PathTracer(max_depth=make_materials.MAX_DEPTH, rr_depth=100)
        self.ours = Ours(scene, case.parameters, options.spp, **{"integrator": path, **dict(options.renderer)})

    def __enter__(self) -> Loaded:
        self.folder = tempfile.TemporaryDirectory(prefix="bench-")
        path = Path(self.folder.name) / "scene.xml"
        integrator = {"type": "prb", "max_depth": make_materials.MAX_DEPTH, "rr_depth": 100}
        if self.peers:
            self.ours.scene.save(path)
        for peer in list(self.peers):
            try:
                peer.ask(
                    "load",
                    path=str(path),
                    arguments={},
                    parameters=list(self.case.parameters),
                    resolution=None,  # the file says it
                    spp=self.options.spp,
                    arrays=None,
                    integrator=integrator,
                )
            except PeerError as error:
                if not peer.ourselves:
                    raise
                self.peers.remove(peer)  # the material is new
                self.notes.append(f"{self.case.name}: {error}")
        return self

    def __exit__(self, *_: object) -> None:
        self.folder.cleanup()

    def image(self, peer: Peer | None, seed: int) -> np.ndarray:
        """A picture (H, W, 3) of a program, None being this one."""
        if peer is None:
            return self.ours.image(seed, self.options.check_spp)[0]
        file = str(Path(self.folder.name) / "image.npy")
        peer.ask("image", seed=seed, spp=self.options.check_spp, file=file)
        return np.load(file)[..., :3]

    def gradient(self, peer: Peer | None, seed: int) -> list[float]:
        """The sums of all parameters' gradients."""
        if peer is None:
            return [float(values.sum()) for values in self.ours.gradient(seed, self.options.check_spp)[0]]
        return peer.ask("gradient", seed=seed, spp=self.options.check_spp)["sums"]

    def finite_difference(self, name: str, seeds: Sequence[int]) -> float:
        """What the gradient's sum is according to this renderer's pictures, with common random numbers."""
        value = self.ours.scene.get_parameter(name).detach()
        found = []
        for seed in seeds:
            ends = []
            for change in (CHANGE, -CHANGE):
                with torch.no_grad():
                    image = self.ours.renderer(seed=seed, spp=self.options.check_spp, params={name: value + change})
                weight = weight_of(*image.shape[:2], np)
                ends.append(float((image.double().numpy() * weight).mean()))
            found.append((ends[0] - ends[1]) / (2 * CHANGE))
        return float(np.mean(found))


def block_means(image: np.ndarray, block: int = BLOCK) -> np.ndarray:
    """The means of a picture's blocks (rows, columns, 3), of `block` pixels along a side; what is left over is cut off.

    A picture smaller than a block is one.
    """
    height, width = image.shape[:2]
    block = min(block, height, width)
    rows, columns = height // block, width // block
    cut = image[: rows * block, : columns * block].astype(np.float64)
    return cut.reshape(rows, block, columns, block, -1).mean((1, 3))


def z_scores(first: np.ndarray, second: np.ndarray, rounding: float = 0.0) -> np.ndarray:
    """Differences of two means in units of their error, for samples (n, ...) of each; nan where both are constant.

    `rounding` is an error relative to the mean that is there without any noise.
    """
    error = first.var(0, ddof=1) / len(first) + second.var(0, ddof=1) / len(second)
    error = error + (rounding * np.abs(first.mean(0))) ** 2
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(error > 0, (first.mean(0) - second.mean(0)) / np.sqrt(error), np.nan)


def image_rows(loaded: Loaded, peers: list[Peer]) -> dict[str, Any]:
    """How well the pictures agree: a row."""
    seeds = range(max(2, loaded.options.seeds))
    ours = np.stack([block_means(loaded.image(None, seed)) for seed in seeds])
    row: dict[str, Any] = {"material": loaded.case.name, "mean of the picture": float(ours.mean())}
    for peer in peers:
        theirs = np.stack([block_means(loaded.image(peer, seed)) for seed in seeds])
        z = z_scores(ours, theirs, ROUNDING)
        row[f"{peer.title}: difference of the means %"] = float(100 * abs(theirs.mean() / ours.mean() - 1))
        row[f"{peer.title}: blocks, root mean square of z"] = float(np.sqrt(np.nanmean(z**2)))
        row[f"{peer.title}: blocks, largest z"] = float(np.nanmax(np.abs(z)))
    return row


def gradient_rows(loaded: Loaded, peers: list[Peer]) -> list[dict[str, Any]]:
    """How well the gradients agree: a row for each parameter."""
    seeds = range(max(2, loaded.options.seeds))
    ours = np.array([loaded.gradient(None, seed) for seed in seeds])
    rows = [
        {"material": loaded.case.name, "parameter": name, "gradient": float(value)}
        for name, value in zip(loaded.case.parameters, ours.mean(0), strict=True)
    ]
    for peer in peers:
        theirs = np.array([loaded.gradient(peer, seed) for seed in seeds])
        for row, mean, z in zip(rows, theirs.mean(0), z_scores(ours, theirs), strict=True):
            row[f"{peer.title} gradient"] = float(mean)
            row[f"{peer.title} z"] = None if np.isnan(z) else float(z)
            if abs(z) > DISAGREE and "finite difference" not in row:
                row["finite difference"] = loaded.finite_difference(row["parameter"], seeds[:2])
    return rows


def time_row(loaded: Loaded) -> dict[str, Any]:
    """Seconds of a material and ratios of them: a row."""

    def run_ours(seed: int) -> dict[str, float]:
        loaded.ours.forward(seed)  # what ran before has emptied the caches
        return {"image": loaded.ours.forward(seed)["forward"], **loaded.ours.step(seed)}

    programs = {"": run_ours}
    for peer in loaded.peers:

        def run(seed: int, peer: Peer = peer) -> dict[str, float]:
            peer.ask("forward", seed=seed)
            return {"image": peer.ask("forward", seed=seed)["forward"], **peer.ask("step", seed=seed)}

        programs[f"{peer.title} "] = run
    found = rounds(programs, loaded.options)
    row: dict[str, Any] = {"material": loaded.case.name}
    for who, times in found.items():
        times["sum"] = [a + b for a, b in zip(times["forward"], times["backward"], strict=True)]
        row |= {f"{who}{name} s": Measured.of(times[name]) for name in ("image", "forward", "backward", "sum")}
    for who, times in found.items():
        if who:
            for name in ("image", "sum"):
                ratios = [a / b for a, b in zip(times[name], found[""][name], strict=True)]
                row[f"{who}/ ours, {name}"] = Measured.of(ratios)
    return row


def run(options: argparse.Namespace) -> Result:
    torch.set_num_threads(options.threads)
    # Of light that would come through where nothing does; here something does, and the derivative lacks nothing.
    warnings.filterwarnings("ignore", category=tr.MissingTermWarning)
    chosen = cases(options)
    images, gradients, times, unknown = [], [], [], []
    with Peers(options.peer, options.threads, options.renderer) as peers:
        for peer in peers:
            if KNOWN[peer.name].reads_arrays:
                raise PeerError(f"{peer.title} has one material only")
        versions = {peer.key: peer.version for peer in peers}
        for case in chosen:
            with Loaded(case, peers, options) as loaded:
                if options.seeds and loaded.peers:
                    images.append(image_rows(loaded, loaded.peers))
                    gradients += gradient_rows(loaded, loaded.peers)
                times.append(time_row(loaded))
                unknown += loaded.notes
        who = [""] + [f"{peer.title} " for peer in peers]
    size = f"{options.resolution}x{options.resolution}"
    notes = [
        "Image: without derivatives (torch.no_grad). Sum: forward and backward. Ratios are medians of those of the "
        "rounds.",
        *unknown,
    ]
    plot = {"kind": "bars", "columns": [f"{name}sum s" for name in who], "y": "forward and backward, s"}
    title = (
        f"Materials, {size}, {options.spp} spp, depth {make_materials.MAX_DEPTH}, {options.threads} threads, medians "
        f"of {options.rounds} alternating rounds"
    )
    tables = [Table(title, ["material"], times, notes, plot, part="time")]
    if images:
        compared = f"{size}, {options.check_spp} spp, {max(2, options.seeds)} seeds"
        notes = ["z of equal means has a root mean square of about 1."]
        tables.append(Table(f"Pictures, {compared}", ["material"], images, notes, part="images"))
        notes = ["Sums over a parameter's entries of the gradient of mean(image * weight)."]
        labels = ["material", "parameter"]
        tables.append(Table(f"Gradients, {compared}", labels, gradients, notes, part="gradients"))
    return Result(tables, versions)
