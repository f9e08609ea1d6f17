"""Noise removed from rendered images by Intel's Open Image Denoise, which is installed apart."""

from __future__ import annotations

import importlib
from types import ModuleType

import torch

from .errors import describe

QUALITIES = ("default", "fast", "balanced", "high")


def library() -> ModuleType:
    """The module that binds Open Image Denoise; ImportError says how it is installed."""
    try:
        return importlib.import_module("pyoidn")
    except ImportError as error:
        raise ImportError(
            f"denoising needs Open Image Denoise, which is not installed ({error}): pip install pyoidn"
        ) from error


def denoise(
    image: torch.Tensor,
    *,
    albedo: torch.Tensor | None = None,
    normal: torch.Tensor | None = None,
    clean: bool = False,
    quality: str = "high",
) -> torch.Tensor:
    """`image` with less noise, by Open Image Denoise (``pip install pyoidn``), whose network was trained on renderings.

    Albedo and normals of what is seen keep edges and textures sharp::

        found = tr.render(scene, spp=16, outputs=("rgb", "albedo", "shading_normal"))
        smooth = tr.denoise(found.rgb, albedo=found.albedo, normal=found.shading_normal)

    The result is biased, as that of every denoiser, and carries no derivative. ``tr.reattach(smooth, found.rgb)`` has
    its values and the derivative of the noisy image: a loss then compares without noise, and gradients flow as ever.

    Args:
        image: linear radiance (H, W, C) or (B, H, W, C), C = 1 or 3.
        albedo: of the same shape, from 0 to 1.
        normal: (H, W, 3) or (B, H, W, 3), from -1 to 1; only together with `albedo`.
        clean: albedo and normals have no noise, as with many samples or pinholes without depth of field.
        quality: ``"high"``, ``"balanced"`` or ``"fast"``.

    Returns:
        A tensor like `image`.

    Raises:
        ImportError: Open Image Denoise is not installed.
        TypeError, ValueError: naming the argument, what was expected and what came.
    """
    if not isinstance(image, torch.Tensor) or not image.is_floating_point():
        raise TypeError(f"denoise: image: expected a floating-point tensor (H, W, C), got {describe(image)}")
    if image.ndim not in (3, 4) or image.shape[-1] not in (1, 3) or 0 in image.shape:
        raise ValueError(f"denoise: image: expected shape (H, W, C) or (B, H, W, C), C = 1 or 3, got {describe(image)}")
    if quality not in QUALITIES:
        raise ValueError(f"denoise: quality: expected one of {', '.join(QUALITIES)}, got {quality!r}")
    if normal is not None and albedo is None:
        raise ValueError("denoise: normal: only together with albedo")
    guides = {"albedo": _guide("albedo", albedo, image), "normal": _guide("normal", normal, image)}
    run = library().denoise
    with torch.no_grad():
        images = image.detach() if image.ndim == 4 else image.detach()[None]
        results = []
        for i, one in enumerate(images):
            given = {name: _rgb(guide[i]) for name, guide in guides.items() if guide is not None}
            results.append(run(_rgb(one), **given, hdr=True, clean_aux=clean, quality=quality))
        smooth = torch.stack(results)[..., : image.shape[-1]].to(image)
    return smooth if image.ndim == 4 else smooth[0]


def _guide(name: str, guide: torch.Tensor | None, image: torch.Tensor) -> torch.Tensor | None:
    """As a batch, checked."""
    if guide is None:
        return None
    channels = (1, 3) if name == "albedo" else (3,)
    if not isinstance(guide, torch.Tensor) or not guide.is_floating_point():
        raise TypeError(f"denoise: {name}: expected a floating-point tensor, got {describe(guide)}")
    if guide.shape[:-1] != image.shape[:-1] or guide.shape[-1] not in channels:
        size = tuple(image.shape[:-1])
        raise ValueError(f"denoise: {name}: expected {size} pixels of {channels[-1]} channels, got {describe(guide)}")
    return guide.detach() if guide.ndim == 4 else guide.detach()[None]


def _rgb(image: torch.Tensor) -> torch.Tensor:
    """(H, W, 3), finite, in single precision."""
    return torch.nan_to_num(image.float(), posinf=65504.0, neginf=-65504.0).expand(*image.shape[:2], 3).contiguous()
