"""What a camera sees, in PyTorch: rays through places on the film, and the surfaces that they meet."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import torch

from .queries import Hits, find_hits
from .scene.camera_rays import Rays
from .surface import SurfacePoints
from .wavefront.path import OFFSET
from .wavefront.sensors import SENSORS
from .wavefront.world import World

if TYPE_CHECKING:
    from .autograd import RenderCall
    from .scene.scene import Scene


class View:
    """The camera of a `call`, in the scene with these tensors, one for each of the layout's slots.

    Rays and the points where they meet surfaces are attached to the tensors, as often as autograd is asked to.
    """

    def __init__(self, scene: Scene, call: RenderCall, params: Sequence[torch.Tensor]) -> None:
        self.scene, self.size = scene, call.config["film_size"]
        self.world = World(scene, call.wanted.layout, call.native, params, moving=True)
        self.record = self.world.records["sensor"][call.config["sensor"]]
        # The camera looks through shapes that emit.
        self.emitter = self.world.shape_field("emitter") if call.config["hide_emitters"] else None

    def rays(self, positions: torch.Tensor, lens: torch.Tensor) -> Rays:
        """Through places on the film (N, 2), x and y in pixels, from places on the lens (N, 2) in the unit square."""
        return SENSORS[self.record.type](self.world, self.record, self.size, positions, lens)

    def hits(self, rays: Rays) -> Hits:
        """What rays hit first, without derivatives."""
        origins, directions, limits = (r.detach() for r in rays)
        start = torch.zeros_like(limits)
        while True:
            o = origins + directions * start[:, None]
            hits = find_hits(self.scene, self.world.layout, self.world.plain, o, directions, limits - start)
            hits = hits._replace(t=start + hits.t, shape_id=hits.shape_id.long(), prim_id=hits.prim_id.long())
            if self.emitter is None:
                return hits
            lit = hits.valid & (self.emitter[hits.shape_id] >= 0)
            if not bool(lit.any()):
                return hits
            behind = hits.position.abs().amax(1)
            start = torch.where(lit, hits.t + (1 + behind) * OFFSET, start)

    def meet(self, rays: Rays, hits: Hits) -> SurfacePoints:
        """Where rays meet what they have hit, all of them, extended beyond its edges."""
        origins, directions, _ = rays
        return self.world.surfaces.meet(hits.shape_id, hits.prim_id, origins, directions, hits.t)
