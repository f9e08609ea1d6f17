"""Render scenes of the tests with Mitsuba 3.9.1 into files of `tests/data`.

Those of `tests/helpers/reference_scenes.py` go into `references.npz` and `camera_references.npz`, those of
`tests/helpers/{layer,brushed,hair,media}_scenes.py` into files of their own.

Run in Mitsuba's own environment (needs mitsuba and numpy only):

    mitsuba-env/bin/python bench/make_references.py [scene ...]

Stored per scene: `NAME.mean`, `NAME.var`: block means of the image and the variance of that mean over independent
runs; `NAME.grad.PARAMETER`, `NAME.gradvar.PARAMETER`: derivative of mean(image * weight) by each entry, likewise, and
`NAME.gradsum.PARAMETER`: the sum over all entries and its variance. Environment maps are stored without padding.
"""

from __future__ import annotations

import sys
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tests" / "helpers"))

import brushed_scenes  # noqa: E402
import hair_scenes  # noqa: E402
import layer_scenes  # noqa: E402
import media_scenes  # noqa: E402
import reference_scenes as rs  # noqa: E402

FILES = {
    "references.npz": rs.SCENES,
    "layer_references.npz": layer_scenes.SCENES,
    "camera_references.npz": rs.CAMERAS,
    "brushed_references.npz": brushed_scenes.SCENES,
    "hair_references.npz": hair_scenes.SCENES,
    "media_references.npz": media_scenes.SCENES,
}
RUNS = 16
SPP, GRADIENT_SPP = 1024, 512


def to_mitsuba(value, key: str = ""):
    """The dictionary with NumPy arrays replaced by Mitsuba's types."""
    if isinstance(value, dict):
        value = {name: to_mitsuba(entry, name) for name, entry in value.items()}
        if value.get("type") == "envmap":
            value["bitmap"] = mi.Bitmap(np.ascontiguousarray(value.pop("data")))
        elif value.get("type") in ("bitmap", "gridvolume"):
            value["data"] = mi.TensorXf(value["data"])
        return value
    if key == "to_world":
        return mi.ScalarTransform4f(value)
    if key == "to_uv":
        return mi.ScalarTransform3f(value)
    return value


def unpadded(gradient: np.ndarray) -> np.ndarray:
    """Gradient of an environment map without its two wrap-around columns (H, W + 2, 3) -> (H, W, 3)."""
    inner = gradient[:, 1:-1].copy()
    inner[:, -1] += gradient[:, 0]
    inner[:, 0] += gradient[:, -1]
    return inner


def blocks(image: np.ndarray) -> np.ndarray:
    """Means over BLOCK x BLOCK pixels of (H, W, C)."""
    height, width, channels = image.shape
    return image.reshape(height // rs.BLOCK, rs.BLOCK, width // rs.BLOCK, rs.BLOCK, channels).mean((1, 3))


def mean_and_variance(samples: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Mean over independent runs, and the variance of that mean."""
    stack = np.stack(samples).astype(np.float64)
    return stack.mean(0), stack.var(0, ddof=1) / len(stack)


def gradients(scene, description, integrator, weight, seed: int) -> dict[str, np.ndarray]:
    params = mi.traverse(scene)
    # where a texture could be, Mitsuba has one, but for the pigments of hair
    spellings = {n: (n, f"{n}.value", n.removesuffix(".value")) for n in description.gradients}
    keys = {n: next(key for key in spellings[n] if key in params) for n in description.gradients}
    params.keep(list(keys.values()))  # hair with pigments has a sigma_a that is None, which no derivative passes
    leaves = {}
    for name, key in keys.items():
        value = type(params[key])(dr.detach(params[key]))
        dr.enable_grad(value)
        params[key] = leaves[name] = value
    params.update()
    image = mi.render(
        scene, params, integrator=integrator, spp=16, spp_grad=GRADIENT_SPP, seed=seed, seed_grad=seed + 10_000
    )
    dr.backward(dr.mean(image * weight, axis=None))
    result = {}
    for name in description.gradients:
        # Of what was put in: an environment map keeps a copy with wrap-around columns of its own.
        gradient = np.array(dr.grad(leaves[name]), dtype=np.float64)
        if gradient.ndim < 3:  # colours come as (3, 1), single numbers as (1,)
            gradient = gradient.ravel()
        is_environment = description.scene[name.partition(".")[0]].get("type") == "envmap" and name.endswith(".data")
        result[name] = unpadded(gradient) if is_environment else gradient
    return result


def make(name: str, description: rs.ReferenceScene) -> dict[str, np.ndarray]:
    scene = mi.load_dict(to_mitsuba(description.scene), optimize=False)
    images = [blocks(np.array(mi.render(scene, spp=SPP, seed=run + 1))[..., :3]) for run in range(RUNS)]
    mean, variance = mean_and_variance(images)
    result = {f"{name}.mean": mean, f"{name}.var": variance}
    settings = dict(description.scene["integrator"])
    kind = "prbvolpath" if settings.pop("type").startswith("volpath") else "prb"
    if description.gradients:
        integrator = mi.load_dict({"type": kind, **settings})
        film = description.scene["sensor"]["film"]
        height, width = film.get("crop_height", film["height"]), film.get("crop_width", film["width"])
        weight = mi.TensorXf(rs.weight(height, width).astype(np.float32))
        runs = [gradients(scene, description, integrator, weight, 1000 + run) for run in range(RUNS)]
        for parameter in description.gradients:
            mean, variance = mean_and_variance([run[parameter] for run in runs])
            result[f"{name}.grad.{parameter}"], result[f"{name}.gradvar.{parameter}"] = mean, variance
            total = mean_and_variance([run[parameter].sum() for run in runs])
            result[f"{name}.gradsum.{parameter}"] = np.array(total)
    return result


def main() -> None:
    mi.set_variant("llvm_ad_rgb")
    rs.write_twisted_mesh(rs.DATA / "twisted.ply")
    brushed_scenes.write_sheet(brushed_scenes.SHEET)
    for file, scenes in FILES.items():
        target = rs.DATA / file
        stored = dict(np.load(target)) if target.exists() else {}
        for name, describe in scenes.items():
            if sys.argv[1:] and name not in sys.argv[1:]:
                continue
            stored = {key: value for key, value in stored.items() if not key.startswith(f"{name}.")}
            made = make(name, describe())
            stored.update({key: value.astype(np.float32) for key, value in made.items()})
            mean, variance = made[f"{name}.mean"], made[f"{name}.var"]
            error = np.sqrt(variance).mean() / mean.mean()
            print(f"{name}: mean {mean.mean():.4f}, mean relative error {error:.2e}", flush=True)
            np.savez_compressed(target, **stored)


if __name__ == "__main__":
    main()
