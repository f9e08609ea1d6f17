"""A ball under a grey sky, as a newcomer writes it, and what a rendering says."""

import warnings

import torchrender as tr


def objects(**more):
    return {
        "type": "scene",
        "camera": {
            "type": "perspective",
            "fov": 40,
            "to_world": tr.Transform.look_at([0, 0, 4], [0, 0, 0]),
            "film": {"type": "hdrfilm", "width": 12, "height": 8},
        },
        "ball": {"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.5] * 3}}},
        "sky": {"type": "constant"},
        **more,
    }


def make(**more):
    return tr.load_dict(objects(**more))


def said(scene, **settings):
    """The warnings of a rendering."""
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        tr.render(scene, spp=1, seed=0, **settings)
    return [str(w.message) for w in found]
