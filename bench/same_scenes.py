"""The scenes whose pictures and derivatives two states of torchrender are to have in common: those of the tests.

Tables of scenes are taken from the modules that have them, by their names. What both states have to know is the public
interface alone; this module is imported by either.
"""

from __future__ import annotations

import copy
import importlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import torchrender as tr

SIZE = 10  # pixels along a side of films that are larger
BOTH = ("rgb", "mono")


@dataclass(frozen=True)
class Case:
    """A scene, as a function that makes its dict, and how it is rendered."""

    name: str
    make: Callable[[], dict[str, Any]]
    variants: tuple[str, ...] = ("rgb",)
    settings: dict[str, Any] = field(default_factory=dict)  # of `tr.render`
    integrator: Callable[[], Any] | None = None  # none: the scene's own
    others: bool = False  # with all other integrators, too
    sensors: int = 1  # a picture of the first ones together


class NotFound(RuntimeError):
    """A module of the tests has no such table of scenes."""


def table(module: str, name: str = "SCENES") -> Any:
    """What a module of the tests has under a name; NotFound says what is wrong."""
    try:
        return getattr(importlib.import_module(module), name)
    except Exception as error:  # anything may happen in another state's module
        raise NotFound(f"{module}.{name}: {type(error).__name__}: {error}") from error


def small(scene: dict[str, Any]) -> dict[str, Any]:
    """A reference scene with a small film, which is oblong where nothing speaks against it."""
    scene = copy.deepcopy(scene)
    film = scene["sensor"]["film"]
    if "crop_width" in film:
        film.update(width=14, height=12, crop_offset_x=2, crop_offset_y=1, crop_width=SIZE, crop_height=8)
    else:
        film.update(width=SIZE, height=8)
    return scene


def with_integrator(objects: dict[str, Any]) -> dict[str, Any]:
    return {"type": "scene", "integrator": {"type": "volpath", "max_depth": 8, "rr_depth": 4}, **objects}


def _models() -> Iterator[Case]:
    for name, make in table("oracle.scenes").items():
        yield Case(f"models/{name}", make, BOTH, others=True)
    for name, make in table("reference_scenes", "CAMERAS").items():
        yield Case(f"cameras/{name}", lambda make=make: small(make().scene), BOTH)
    for module in ("layer_scenes", "brushed_scenes", "hair_scenes"):
        for name, make in table(module).items():
            yield Case(f"{module.partition('_')[0]}/{name}", lambda make=make: small(make().scene), BOTH, others=True)
    yield Case("small/ball_and_wall", table("small_scene", "ball_and_wall"), BOTH)


def _motion() -> Iterator[Case]:
    for name, make in table("motion_scenes").items():
        yield Case(f"motion/{name}", make, BOTH, others=True)


def _media() -> Iterator[Case]:
    for name, make in table("media_scenes").items():
        yield Case(f"media/{name}", lambda make=make: small(make().scene), BOTH)
    cloud, layers, stacks = (table("media_objects", name) for name in ("cloud", "layers", "STACKS"))
    yield Case("media/lines", lambda: with_integrator(cloud()), BOTH, sensors=3)
    for name, stack in stacks.items():
        make = lambda stack=stack: with_integrator(layers(*stack, size=4))  # noqa: E731
        yield Case(f"media/stack {name}", make, BOTH, sensors=2)
    room, fog = table("light_scenes", "floor_view"), table("test_lights", "FOG")
    for name, (lamp, _) in table("test_lights", "IN_FOG").items():
        yield Case(f"media/{name} in fog", lambda lamp=lamp: with_integrator(room(lamp=lamp, fog=fog)), BOTH)
    ball, furnaces = table("media_objects", "ball"), table("test_media", "FURNACES")
    lines, lights = (
        table("media_objects", "cameras")(*table("media_objects", "lines")(2, 12), 4),
        table("media_objects", "LIGHTS"),
    )
    for name, medium in furnaces.items():
        kind = "heterogeneous" if "grid" in name else "homogeneous"
        for light in ("point", "constant"):
            objects = {**lines, "ball": ball({**medium, "albedo": 0.9}, kind), "light": lights[light][0]}
            yield Case(f"media/{name}, {light}", partial(with_integrator, objects), BOTH, sensors=2)


def _light() -> Iterator[Case]:
    for name, (scene, settings) in table("test_particle_images").items():
        integrator = partial(tr.ParticleTracer, **{"max_depth": 4, **settings})
        yield Case(f"light/{name}", partial(copy.deepcopy, scene), BOTH, {}, integrator, others=True)
    for name, (make, _, depth) in table("test_particle_oracle").items():
        integrator = partial(tr.ParticleTracer, max_depth=depth, rr_depth=99)
        yield Case(f"light chains/{name}", make, BOTH, {"correlated": True}, integrator)
    for name, (make, _) in table("test_particle_derivatives", "PATHWISE").items():
        yield Case(f"light moves/{name}", make, BOTH, {}, partial(tr.ParticleTracer, max_depth=3, rr_depth=99))


def _degenerate() -> Iterator[Case]:
    """Triangles without area, seen and lighting."""
    meshes, sky, floor, camera = (table("degenerate_scenes", n) for n in ("DEGENERATE", "SKY", "FLOOR", "camera"))

    def make(vertices: Any, faces: Any, emitter: Any) -> dict[str, Any]:
        mesh = tr.Mesh(vertices, faces, emitter=emitter, vertex_texcoords=[[0.5, 0.5]] * len(vertices))
        return {"type": "scene", "camera": camera(), "sky": sky, "floor": {**floor}, "mesh": mesh}

    for name, mesh in meshes.items():
        for what, emitter in {"": None, ", emitting": {"type": "area", "radiance": 2.0}}.items():
            yield Case(f"degenerate/{name}{what}", partial(make, *mesh, emitter), BOTH)


def _outputs() -> Iterator[Case]:
    surfaces = table("test_outputs_derivatives", "SURFACES")
    film = {"type": "hdrfilm", "width": 6, "height": 5, "rfilter": {"type": "gaussian"}}
    open_sky = {"type": "scene", "sky": {"type": "constant"}}
    for name, make in surfaces.items():
        camera = {"type": "perspective", "fov": 35, "near_clip": 0.5, "film": film}
        camera["to_world"] = tr.Transform.look_at([0.5, 0.3, 4], [0.1, 0, 0])
        yield Case(
            f"outputs/{name}", lambda make=make, camera=camera: {**open_sky, "camera": camera, "wall": make()}, BOTH
        )


def _materials() -> Iterator[Case]:
    from scenes import make_caustics, make_materials

    materials = table("bench.materials", "MATERIALS")
    for name, material in materials.items():
        yield Case(f"materials/{name}", partial(make_materials.shown, material.bsdf, resolution=SIZE, spp=4), BOTH)
    heights = table("bench.caustics", "waves")
    yield Case("materials/plate", lambda: make_caustics.caustics(heights(12), resolution=SIZE, spp=4), BOTH)


CALLS: dict[str, dict[str, Any]] = {
    "correlated": {"correlated": True},
    "adaptive": {"adaptive_grad": True, "spp_grad": 8},
    "passes": {"passes": 3},
    "stratified": {"sampler": "stratified"},
    "sobol": {"sampler": "sobol", "spp_grad": 8},
    "crop": {"crop": (1, 2, 4, 5)},
    "pixels": {"pixels": [[3, 1], [0, 0], [3, 1], [5, 7]]},
    "chw": {"layout": "bchw"},
}


def _calls() -> Iterator[Case]:
    """Kinds of calls, of some scenes."""
    models, media = table("oracle.scenes"), table("media_scenes")
    makes = {name: models[name] for name in ("moving", "glass", "layers", "splits", "film")}
    makes["media smooth"] = lambda: small(media["smooth"]().scene)
    for call, settings in CALLS.items():
        for name, make in makes.items():
            yield Case(f"calls/{call}, {name}", make, settings=settings)


# By what the names of their scenes begin with.
GROUPS: dict[tuple[str, ...], Callable[[], Iterator[Case]]] = {
    ("models", "cameras", "layer", "brushed", "small"): _models,
    ("motion",): _motion,
    ("media",): _media,
    ("light", "light chains", "light moves"): _light,
    ("degenerate",): _degenerate,
    ("outputs",): _outputs,
    ("materials",): _materials,
    ("calls",): _calls,
}


def cases(only: str) -> tuple[list[Case], list[str]]:
    """Those whose name contains `only`, and what could not be found."""
    found: list[Case] = []
    lost: list[str] = []
    beginning, slash, _ = only.partition("/")
    for names, group in GROUPS.items():
        if slash and not any(name.endswith(beginning) for name in names):
            continue
        try:
            found += group()
        except NotFound as error:
            lost.append(str(error))
    return [case for case in found if only.lower() in case.name.lower()], lost
