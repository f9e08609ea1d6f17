"""Texture footprints: how fast texture coordinates change from pixel to pixel, for filters of textures and caches.

The ray through a pixel's centre (of a lens: through the lens' centre) is a function of the place on the film, and so
are the texture coordinates of the point where it meets the surface it is known to hit, extended beyond its edges. The
derivatives are those of autograd, which also differentiates them once more, by everything that rays and surfaces
depend on. They are what ray differentials are (Igehy, "Tracing Ray Differentials", SIGGRAPH 1999) for a whole pixel.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch

from .render_call import RenderCall
from .scene.scene import Scene
from .transform import on_cpu
from .wavefront.world import World


@on_cpu
def footprints(
    scene: Scene, call: RenderCall, names: Sequence[str], params: Sequence[torch.Tensor]
) -> dict[str, torch.Tensor]:
    """The outputs ``duv_dx`` and ``duv_dy``, those of `names`, of the sensor of a `call`.

    Args:
        params: a tensor for each of the layout's slots.

    Returns:
        (H, W, 2), or (N, 2) for a list of pixels: derivatives of u and v by the place on the film, in pixels to the
        right and down; 0 where nothing is hit.
    """
    world = World(scene, call.layout, call.native, params, moving=True)
    centre = _centres(call).to(world.dtype)

    def coordinates(positions: torch.Tensor) -> torch.Tensor:
        """Constant where nothing is hit."""
        middle = torch.full_like(positions, 0.5)
        rays = world.camera_rays(call.config["sensor"], call.config["film_size"], positions, middle)
        return world.first_hits(rays, call.config["hide_emitters"]).uv

    # By reverse mode, which may stand inside of either mode; a row depends on its own position alone.
    uv, pull, *_ = torch.func.vjp(coordinates, centre)
    du, dv = (pull(torch.eye(2, dtype=uv.dtype)[k].expand_as(uv))[0] for k in range(2))
    found = {"duv_dx": (du[:, 0], dv[:, 0]), "duv_dy": (du[:, 1], dv[:, 1])}
    return {n: torch.stack(both, dim=1).reshape(*call.size, 2) for n, both in found.items() if n in names}


def _centres(call: RenderCall) -> torch.Tensor:
    """The places on the film (N, 2), x and y, of the centres of the pixels that are wanted."""
    y0, x0, height, width = call.config["crop"]
    if call.pixels is not None:
        pixels = torch.as_tensor(call.pixels)
    else:
        pixels = torch.cartesian_prod(torch.arange(height), torch.arange(width))
    return pixels.flip(1) + torch.tensor([x0 + 0.5, y0 + 0.5], dtype=torch.float64)
