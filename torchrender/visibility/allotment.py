"""How many samples of outlines there are by default, and how they are shared out among those of a scene.

The numbers make the derivative take about twice as long as without outlines, and follow Neyman ("On the Two Different
Aspects of the Representative Method", 1934): samples in proportion to the deviation of one over the root of what it
costs, of gradients by every vertex and by poses, of meshes under skies, above mirrors and in rooms, the interior's
samples among them. Deviations are not estimated for a scene: what is rare makes most of them, which few samples do not
meet. How much each part brings on average they do tell, and what brings hardly anything leaves its share to the others.
"""

from __future__ import annotations

from collections.abc import Mapping

SEEN, SHADOWS, REFLECTIONS = 1 / 32, 1 / 32, 1 / 64
"""Of the derivative's samples: of outlines that the camera sees; of those that lights see; of those that vertices
see."""
OF_SKIES = 1 / 64
"""... of those that lights see, where a sky is one of them: they take five times as long as of lamps."""
ALONE = 1 / 6
"""... of those that the camera sees, where there are no others."""
LEAST = 1024
"""... of each of them, in a pass: few take no time, and small pictures have as much to tell."""
COSTS = {"silhouettes": 1.0, "shadows": 2.0, "reflections": 4.0}
"""What a sample takes, about, in one of a silhouette: those of the others are paths, and choose from a tree."""
HARDLY, FEWEST = 0.02, 0.125
"""The share of all that is brought below which a part gets fewer samples, down to this share of them."""
DEEP = 3.5
"""Rays of a sample of reflections, above which paths of the image take longer, too, and shadows and reflections make
more of the noise: they get more samples, as the square of the rays, up to four times as many."""


def factors(usual: Mapping[str, float], brought: Mapping[str, float], rays: float) -> dict[str, float]:
    """By part, of the usual numbers of samples, which take about as long where paths are short.

    Args:
        usual: numbers of samples.
        brought: what a sample brings, on average without its sign.
        rays: of a sample of reflections.
    """
    everything = sum(brought.values())
    if not everything > 0:
        return dict.fromkeys(usual, 1.0)
    weights = {part: min(max(x / everything / HARDLY, FEWEST), 1.0) for part, x in brought.items()}
    takes = sum(COSTS[part] * n for part, n in usual.items())
    left = sum(COSTS[part] * n * weights[part] for part, n in usual.items())
    more, deep = min(takes / left, 2.0), min(max((rays / DEEP) ** 2, 1.0), 4.0)
    return {part: more * weight * (1.0 if part == "silhouettes" else deep) for part, weight in weights.items()}
