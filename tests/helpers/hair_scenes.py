"""A scene of thick hairs, for references; numbers and arrays alone, no torch.

They are rough along, so that Bessel functions have small arguments: of large ones Mitsuba's are up to 0.6 % away
(test_hair.py).
"""

from __future__ import annotations

import reference_scenes as rs


def _hair(start: list[float], end: list[float], radius: float, **more) -> dict:
    bsdf = {"type": "hair", "longitudinal_roughness": 0.6, **more}
    return {"type": "cylinder", "p0": start, "p1": end, "radius": radius, "bsdf": bsdf}


def _hairs() -> rs.ReferenceScene:
    """Cylinders of which light also reaches the inside, by pigments and by absorption, under a lamp and a sky."""
    dye = {"type": "bitmap", "data": rs._noise(6, 4, 4, 0.05, 0.8), "raw": True}
    return rs.ReferenceScene(
        rs._scene(
            {"type": "path", "max_depth": 5, "rr_depth": 99},
            rs._camera(),
            brown=_hair([-1.7, -0.9, 0.2], [-0.6, 1.2, 0.6], 0.35, scale_tilt=6.0),
            blond=_hair(
                [-0.7, -0.8, -0.3], [1.5, 1.0, -0.6], 0.3, eumelanin=0.2, pheomelanin=0.4, azimuthal_roughness=0.6
            ),
            dyed=_hair([0.1, -0.9, 0.6], [1.6, 0.1, 0.3], 0.25, sigma_a=dye, scale=1.5, int_ior=1.4, ext_ior=1.0),
            thin=_hair([-1.2, -0.4, 1.2], [0.9, 0.2, 1.0], 0.06, sigma_a=rs._rgb(0.1, 0.2, 0.6)),
            floor=rs._floor(0.5),
            lamp=rs._lamp(rs._rgb(8.0, 7.0, 5.0)),
            sky={"type": "constant", "radiance": rs._rgb(0.3, 0.4, 0.5)},
        ),
        (
            "brown.bsdf.longitudinal_roughness",
            "brown.bsdf.azimuthal_roughness",
            "brown.bsdf.scale_tilt",
            "blond.bsdf.eumelanin.value",
            "blond.bsdf.pheomelanin.value",
            "dyed.bsdf.sigma_a.data",
            "dyed.bsdf.eta",
            "thin.bsdf.sigma_a.value",
        ),
    )


SCENES = {"hairs": _hairs}
