"""How many samples of outlines there are by default, and how they are shared out among those of a scene.

The numbers make the derivative take two to three times as long as without outlines, and follow Neyman ("On the
Two Different Aspects of the Representative Method", 1934): samples in proportion to the deviation of one over the root
of what it costs, of meshes under skies, above mirrors and in rooms. Deviations are not estimated for a scene: what is
rare makes most of them, which few samples do not meet. How much each part brings on average they do tell, and what
brings hardly anything leaves its share to the others.
"""

from __future__ import annotations

from collections.abc import Mapping

SEEN, OTHERS = 1 / 10, 1 / 24
"""Of the derivative's samples: of outlines that the camera sees; of those that lights see, and as many that vertices
see."""
ALONE = 1 / 4
"""... of those that the camera sees, where there are no others."""
COSTS = {"silhouettes": 1.0, "shadows": 2.0, "reflections": 4.0}
"""What a sample takes, about, in one of a silhouette: those of the others are paths, and choose from a tree."""
HARDLY = 0.02
"""The share of all that is brought below which a part gets fewer samples, down to a quarter."""
DEEP = 3.0
"""Rays of a sample of reflections, above which paths of the image take longer, too, and all get up to twice as many."""


def factors(usual: Mapping[str, float], brought: Mapping[str, float], rays: float) -> dict[str, float]:
    """By part, of the usual numbers of samples, which take about as long.

    Args:
        usual: numbers of samples.
        brought: what a sample brings, on average without its sign.
        rays: of a sample of reflections.
    """
    everything = sum(brought.values())
    if not everything > 0:
        return dict.fromkeys(usual, 1.0)
    weights = {part: min(max(x / everything / HARDLY, 0.25), 1.0) for part, x in brought.items()}
    takes = sum(COSTS[part] * n for part, n in usual.items())
    left = sum(COSTS[part] * n * weights[part] for part, n in usual.items())
    more = min(takes / left, 2.0) * min(max(rays / DEEP, 1.0), 2.0)
    return {part: more * weight for part, weight in weights.items()}
