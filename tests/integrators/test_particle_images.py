"""Images of light tracing: those of the path tracer, scene by scene; the same numbers however they are asked for."""

from __future__ import annotations

import light_scenes as ls
import pytest
import torch

import torchrender as tr
from torchrender.testing.statistics import sidak, student_p_value

SIGNIFICANCE = 0.01  # of all comparisons of SCENES together
RUNS = 16
T = tr.Transform
GLASS, FROSTED = {"type": "dielectric"}, {"type": "roughdielectric", "alpha": 0.3}
SOFT = {"type": "roughdielectric", "alpha": 0.2, "distribution": "ggx"}
MIRROR = {"type": "conductor", "eta": 0.2, "k": 3.9}
HAIR = {"type": "hair", "eumelanin": 0.2, "scale_tilt": 5.0, "azimuthal_roughness": 0.6}
HALF_MIRROR = {"type": "conductor", "eta": 1.5, "k": 2.0, "specular_reflectance": ls.RGB}
BIG_LAMP = {**ls.area(), "to_world": ls.facing_down(0.1, 1.1, 0.1) @ T.scale([1.0, 0.9, 1])}
PLATE = ls.T.translate([0, 0.45, 0]) @ T.scale([1.5, 0.05, 1.5])
# beside the view of the floor, so that light reaches it from there but it is not seen itself
SIDE = T.translate([-1.1, -0.3, 0]) @ T.rotate([0, 1, 0], 90) @ T.scale([0.9, 0.6, 1])


def filtered(rfilter: str, **more) -> dict:
    return ls.room(ls.camera(rfilter=rfilter, **more), light=ls.area())


def clipped() -> dict:
    """The near plane lets the camera see through a plate before it, the far plane hides the wall's part of the view."""
    plate = {"type": "rectangle", "to_world": T.translate([0.3, -0.2, 3.5]) @ T.scale(0.2)}
    sensor = {**ls.camera(), "near_clip": 1.0, "far_clip": 5.0}
    return ls.room(sensor, light=ls.area(), plate=plate)


def three_lights() -> dict:
    point = {**ls.point_light(), "sampling_weight": 3.0}
    lamp = ls.area()
    lamp["emitter"] = {**lamp["emitter"], "sampling_weight": 0.4}
    return ls.room(light=lamp, second=point, third=ls.ball_light())


# name: (scene, settings of both integrators)
SCENES = {
    "textured area": (ls.room(light=ls.area()), {}),
    "area": (ls.room(light=ls.area(radiance=3.0)), {}),
    "disk light": (ls.room(light={**ls.area(), "type": "disk"}), {}),
    "sphere light": (ls.room(light=ls.ball_light()), {}),
    "mesh light": (ls.room(light=ls.mesh_light()), {}),
    "point": (ls.room(light=ls.point_light()), {}),
    "spot": (ls.room(light=ls.spot()), {}),
    "projector": (ls.room(light=ls.projector(70)), {}),
    "sun": (ls.room(light=ls.sun()), {}),
    "lights by power": (three_lights(), {"emitter_sampling": "power"}),
    "constant": (ls.room(light={"type": "constant", "radiance": ls.RGB}), {}),
    "turned map": (ls.room(light=ls.envmap()), {}),
    "map and lamp": (ls.room(light=ls.envmap(), lamp=ls.area()), {}),
    "three lights": (three_lights(), {}),
    "roulette": (three_lights(), {"max_depth": -1, "rr_depth": 2}),
    "box filter": (filtered("box"), {}),
    "tent filter": (filtered("tent"), {}),
    "cropped film": (
        filtered("gaussian", crop_offset_x=2, crop_offset_y=3, crop_width=5, crop_height=4),
        {},
    ),
    "clipped": (clipped(), {}),
    "hidden lights": (ls.room(light=ls.area(), ball=ls.ball_light(), sky=ls.envmap()), {"hide_emitters": True}),
    "lights alone": (ls.room(light=ls.ball_light(), sky=ls.envmap()), {"max_depth": 1}),
    "direct light": (ls.room(light=ls.area()), {"max_depth": 2}),
    "interpolated normals": (ls.room(light=ls.area(), blob=ls.blob({"type": "diffuse"})), {}),
    "frosted, interpolated normals": (ls.room(light=ls.area(), blob=ls.blob(FROSTED)), {}),
    "two-sided, interpolated normals": (
        ls.room(light=ls.area(), blob=ls.blob({"type": "twosided", "brdf": {"type": "diffuse"}})),
        {},
    ),
    "frosted sphere": (
        ls.room(light=ls.area(), ball={"type": "sphere", "center": [0.3, -0.3, 0.2], "radius": 0.4, "bsdf": FROSTED}),
        {},
    ),
    "frosted slab": (ls.room(light=ls.area(), slab=ls.slab(SOFT)), {}),
    "fibres": (
        ls.room(
            light=ls.area(),
            thick={"type": "cylinder", "p0": [-0.9, -0.4, 0.4], "p1": [0.9, 0.3, 0.1], "radius": 0.3, "bsdf": HAIR},
            fine={"type": "cylinder", "p0": [-0.8, 0.5, 0.2], "p1": [0.7, -0.7, 0.4], "radius": 0.1, "bsdf": HAIR},
        ),
        # Beyond, light inside is a few percent short: rays start off the surface, and the factor by which importance
        # differs from radiance there, of both cosines, is that of the points themselves.
        {"max_depth": 2},
    ),
    "hair on a sheet": (
        ls.room(
            light=ls.area(),
            sheet={
                "type": "rectangle",
                "to_world": T.translate([0.1, -0.2, 0.3]) @ T.rotate([1, 0, 0], -40),
                "bsdf": HAIR,
            },
        ),
        {"max_depth": 4},
    ),
    "glass over the floor": (
        ls.floor_view(light=BIG_LAMP, slab={"type": "cube", "to_world": PLATE, "bsdf": GLASS}),
        {},
    ),
    "mirror beside the floor": (
        ls.floor_view(light=BIG_LAMP, mirror={"type": "rectangle", "to_world": SIDE, "bsdf": MIRROR}),
        {},
    ),
    "coloured metal": (
        ls.floor_view(light=BIG_LAMP, mirror={"type": "rectangle", "to_world": SIDE, "bsdf": HALF_MIRROR}),
        {},
    ),
    "null surface": (
        ls.floor_view(light=BIG_LAMP, slab={"type": "cube", "to_world": PLATE, "bsdf": {"type": "null"}}),
        {"max_depth": 5},
    ),
}
MONO = ("textured area", "turned map", "frosted, interpolated normals")
CASES = [(name, "rgb") for name in SCENES] + [(name, "mono") for name in MONO]


def blocks(image: torch.Tensor) -> torch.Tensor:
    """Means of the image and of its nine parts, by channel: (10 C,)."""
    planes = image.double().movedim(-1, 0)[None]
    parts = [torch.nn.functional.adaptive_avg_pool2d(planes, n).flatten() for n in (1, 3)]
    return torch.cat(parts)


def p_values(first: torch.Tensor, second: torch.Tensor) -> torch.Tensor:
    """Of equal expectations, of runs (R, N) each (Welch's test, with the cautious number of degrees of freedom).
    Roundings of single precision do not count."""
    gap = ((first.mean(0) - second.mean(0)).abs() - 1e-6 * second.mean(0).abs()).clamp_min(0)
    error = (first.var(0) / len(first) + second.var(0) / len(second)).sqrt()
    score = torch.where(gap == 0, gap, gap / error)
    return student_p_value(score, min(len(first), len(second)) - 1)


@pytest.mark.parametrize(("name", "variant"), CASES)
def test_the_image_is_that_of_the_path_tracer(name, variant):
    description, settings = SCENES[name]
    scene = tr.load_dict(description, variant=variant)
    settings = {"max_depth": 6, "rr_depth": 99, **settings}
    # light through glass and from mirrors is what the path tracer finds by chance
    spp = 256 if "slab" in description or "mirror" in description else 128
    path, light = tr.PathTracer(**settings), tr.ParticleTracer(**settings)
    expected = torch.stack([blocks(tr.render(scene, integrator=path, spp=spp, seed=i)) for i in range(RUNS)])
    found = torch.stack([blocks(tr.render(scene, integrator=light, spp=128, seed=99 + i)) for i in range(RUNS)])
    assert float(expected[:, 0].mean()) > 0.003
    p = p_values(found, expected)
    level = sidak(SIGNIFICANCE, len(CASES) * p.numel())
    worst = int(p.argmin())
    assert bool((p >= level).all()), (
        f"{name}: p = {float(p.min()):.2g} (level {level:.2g}) at {worst}: "
        f"{float(found.mean(0)[worst]):.5g}, path tracer {float(expected.mean(0)[worst]):.5g}"
    )
    # and the test sees deviations of a few per cent of the mean
    spread = (found[:, 0].var() + expected[:, 0].var()).sqrt() / RUNS**0.5
    assert float(spread) < 0.02 * float(expected[:, 0].mean()), (
        f"{name}: relative error {spread / expected[:, 0].mean()}"
    )


# ------------------------------------------------------------------------------------------------------- exact equality
def plain(**settings) -> tr.Scene:
    """A film of more than one tile, with all kinds of lights."""
    settings = {"dtype": torch.float32, **settings}
    rfilter = settings.pop("rfilter", "gaussian")
    description = ls.room(
        {**ls.camera(rfilter=rfilter), "film": {**ls.film(rfilter=rfilter), "width": 37, "height": 21}},
        light=ls.area(),
        point=ls.point_light(),
        sky=ls.envmap(),
        slab=ls.slab(SOFT),
    )
    return tr.load_dict(description, **settings)


@pytest.fixture(autouse=True)
def keep_number_of_threads():
    threads = torch.get_num_threads()
    yield
    torch.set_num_threads(threads)


@pytest.mark.parametrize("rfilter", ["box", "tent", "gaussian"])
def test_pixels_and_crops_equal_the_whole_at_any_number_of_threads(rfilter):
    scene, light = plain(rfilter=rfilter), tr.ParticleTracer(max_depth=5)
    whole = tr.render(scene, integrator=light, spp=5, seed=2)
    assert whole.shape == (21, 37, 3)
    assert float(whole.std()) > 0
    pixels = torch.tensor([[0, 0], [20, 36], [7, 7], [3, 30], [7, 7], [15, 16], [16, 15]])
    for number in (1, 2, 3, 8):
        torch.set_num_threads(number)
        assert torch.equal(tr.render(scene, integrator=light, spp=5, seed=2), whole)
        chosen = tr.render(scene, integrator=light, spp=5, seed=2, pixels=pixels)
        assert torch.equal(chosen, whole[pixels[:, 0], pixels[:, 1]])
        crop = tr.render(scene, integrator=light, spp=5, seed=2, crop=(3, 5, 11, 20))
        assert torch.equal(crop, whole[3:14, 5:25])


def test_a_part_that_is_cropped_by_the_film_is_that_part_of_the_whole():
    whole, part = filtered("gaussian"), filtered("gaussian")
    part["camera"]["film"].update(crop_offset_x=2, crop_offset_y=3, crop_width=5, crop_height=4)
    images = [tr.render(tr.load_dict(d), integrator="ptracer", spp=9, seed=3) for d in (whole, part)]
    assert torch.equal(images[0][3:7, 2:7], images[1])


@pytest.mark.parametrize("variant", ["mono", "rgb"])
def test_packets_and_single_paths_agree(variant, monkeypatch):
    scene, light = plain(variant=variant, dtype=torch.float64), tr.ParticleTracer(max_depth=5)
    packets = tr.render(scene, integrator=light, spp=4, seed=3)
    monkeypatch.setattr(tr.backends, "PACKETS", False)
    single = tr.render(scene, integrator=light, spp=4, seed=3)
    assert float(single.mean()) > 0.01
    # the differences of libm and packets may turn a path into another one, rarely
    differs = (packets - single).abs() > 1e-7 * (1 + single.abs())
    assert float(differs.double().mean()) < 0.01


def test_single_and_double_precision_trace_the_same_light():
    """With the same random numbers: rounding turns few paths into other ones."""
    light = tr.ParticleTracer(max_depth=3)
    single, double = (
        tr.render(tr.load_dict(ls.room(light=ls.area()), dtype=d), integrator=light, spp=64, seed=3).double()
        for d in (torch.float32, torch.float64)
    )
    assert float((single - double).abs().mean()) < 2e-3 * float(double.mean())


def test_passes_are_averaged():
    from torchrender.seeds import mix

    scene = tr.load_dict(ls.room(light=ls.area()), dtype=torch.float64)
    together = tr.render(scene, integrator="ptracer", spp=3, seed=4, passes=3)
    alone = [tr.render(scene, integrator="ptracer", spp=3, seed=s) for s in (4, mix(4, 1), mix(4, 2))]
    torch.testing.assert_close(together, sum(alone) / 3, rtol=1e-12, atol=0)
    assert not torch.equal(alone[0], alone[1])


def test_layouts_and_batches_of_sensors():
    description = ls.room(light=ls.area(), other={**ls.camera(), "fov": 40})
    scene = tr.load_dict(description)
    first, second = (tr.render(scene, integrator="ptracer", spp=3, seed=4, sensor=i) for i in (0, 1))
    assert not torch.equal(first, second)
    both = tr.render(scene, integrator="ptracer", spp=3, seed=4, sensor=[1, 0])
    assert torch.equal(both, torch.stack([second, first]))
    chw = tr.render(scene, integrator="ptracer", spp=3, seed=4, layout="bchw", sensor=[0, 1])
    assert torch.equal(chw, torch.stack([first, second]).movedim(-1, 1))
    assert torch.equal(tr.render(scene, integrator="ptracer", spp=3, seed=4, layout="chw"), first.movedim(-1, 0))


def test_a_camera_that_is_not_in_the_scene():
    scene = tr.load_dict(ls.room(light=ls.area()))
    own = scene.sensors[0]
    other = tr.PerspectiveCamera(fov=50, to_world=own.to_world.detach().clone(), film=own.film)
    runs = [
        torch.stack([blocks(tr.render(scene, integrator="ptracer", spp=64, seed=i, sensor=s)) for i in range(RUNS)])
        for s in (0, other)
    ]
    assert float(p_values(*runs).min()) >= sidak(0.001, runs[0].shape[1])


def test_the_integrator_may_come_with_the_scene():
    description = ls.room(light=ls.area())
    description["integrator"] = {"type": "ptracer", "max_depth": 3}
    scene = tr.load_dict(description)
    assert isinstance(scene.integrator, tr.ParticleTracer)
    expected = tr.render(scene, integrator=tr.ParticleTracer(max_depth=3), spp=3, seed=4)
    assert torch.equal(tr.render(scene, spp=3, seed=4), expected)


# ------------------------------------------------------------------------------------------------------------- settings
def test_depths():
    scene = tr.load_dict(ls.room(light=ls.ball_light()))

    def image(depth: int, hide: bool = False) -> torch.Tensor:
        light = tr.ParticleTracer(max_depth=depth, rr_depth=99, hide_emitters=hide)
        return tr.render(scene, integrator=light, spp=32, seed=4)

    zero, seen, direct, all_light = (image(d) for d in (0, 1, 2, -1))
    assert float(zero.abs().max()) == 0
    assert float(image(1, hide=True).abs().max()) == 0
    # the same paths, which end later: what comes is added
    assert float((direct - seen).min()) >= -1e-6
    assert float((all_light - direct).min()) >= -1e-6
    assert float(seen.sum()) > 0
    assert float(direct.sum()) > float(seen.sum())
    assert float(all_light.sum()) > 1.005 * float(direct.sum())


@pytest.mark.parametrize("sampler", ["stratified", "sobol"])
def test_samplers_have_the_same_expectation_and_less_noise(sampler):
    scene, light = tr.load_dict(ls.room(light=ls.area())), tr.ParticleTracer(max_depth=3)
    runs = {
        kind: torch.stack(
            [blocks(tr.render(scene, integrator=light, spp=64, seed=i, sampler=kind)) for i in range(RUNS)]
        )
        for kind in ("independent", sampler)
    }
    assert float(p_values(runs[sampler], runs["independent"]).min()) >= sidak(0.001, runs[sampler].shape[1])
    # of equal variances a ratio of sums over 27 entries of 15 degrees of freedom each is below 0.7 in less than 1 of
    # 1000 cases even if only five of them are independent
    ratio = runs[sampler][:, 3:].var(0).sum() / runs["independent"][:, 3:].var(0).sum()
    assert float(ratio) < 0.7


def test_variance_falls_with_the_number_of_paths():
    """Ratio of variances of 16 times as many paths. Of the log of such a ratio the standard deviation is at most 0.29
    (2 sqrt(1 / dof)) if the entries of an image were one only; the bounds are 3.3 of those: level 0.001."""
    scene, light = tr.load_dict(ls.room(light=ls.area())), tr.ParticleTracer(max_depth=3)
    few, many = (
        torch.stack([tr.render(scene, integrator=light, spp=n, seed=i) for i in range(48)]).var(0).sum()
        for n in (4, 64)
    )
    assert 16 / 2.6 < float(few / many) < 16 * 2.6
