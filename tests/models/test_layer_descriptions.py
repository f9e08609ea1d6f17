"""How blends, masks, normal and bump maps are described: refusals, scenes without colours, files."""

from __future__ import annotations

import layer_scenes
import numpy as np
import pytest
import torch
from layer_rooms import BRUSHED, DARK, GLASS, PAINT, room, soft
from motion_scenes import at_ball, ball, black_room, scene, smooth_texture

import torchrender as tr

# --- descriptions ----------------------------------------------------------------------------------------------------


def test_errors_name_the_place():
    both = {"type": "twosided", "bsdf": PAINT}
    for bsdf, message in [
        ({"type": "blendbsdf", "a": PAINT}, "nested BSDF is missing"),
        ({"type": "mask", "opacity": 0.5}, "nested BSDF is missing"),
        ({"type": "normalmap", "bsdf": PAINT}, "'normalmap' is missing"),
        ({"type": "bumpmap", "bsdf": PAINT}, "'nested_texture' is missing"),
        (layer_scenes.normal_map(both), "stands around"),
        (layer_scenes.normal_map(layer_scenes.normal_map(PAINT)), "stands around"),
        ({"type": "twosided", "bsdf": layer_scenes.mask(PAINT)}, "two-sided"),
        ({"type": "twosided", "bsdf": layer_scenes.blend(PAINT, GLASS)}, "two-sided"),
        ({"type": "blendbsdf", "a": PAINT, "b": PAINT, "c": PAINT}, "more than 2"),
    ]:
        with pytest.raises(ValueError, match=message):
            room(bsdf)
    deep = PAINT
    for _ in range(9):
        deep = layer_scenes.blend(deep, DARK, 0.5)
    with pytest.raises(ValueError, match="nested at most 8 deep"):
        tr.render(room(deep), spp=1)
    constant = {"type": "normalmap", "normalmap": 0.5, "bsdf": PAINT}
    plain = {"type": "normalmap", "normalmap": {"type": "bitmap", "data": np.zeros((2, 2, 1))}, "bsdf": PAINT}
    for bsdf, message in [(constant, "a bitmap, in a scene without"), (plain, r"a bitmap of shape \(rows,")]:
        with pytest.raises(ValueError, match=f"ball.bsdf: field 'normalmap': expected {message}"):
            tr.render(grey_room(bsdf, "mono"), spp=1)
    with pytest.raises(ValueError, match="needs"):
        room(layer_scenes.mask(PAINT)).get_submodule("ball.bsdf").nested_bsdf = None


def test_light_tracing_needs_a_filter_for_the_derivative_of_normals():
    loaded = room(layer_scenes.normal_map(PAINT))
    parameter = loaded.train_only("ball.bsdf.normalmap.data")
    with pytest.raises(tr.NotDifferentiableError, match="box filter"):
        tr.render(loaded, spp=1, integrator=tr.ParticleTracer(max_depth=3))
    assert len(parameter) == 1


def grey_room(bsdf: dict, variant: str) -> tr.Scene:
    light = {"type": "area", "radiance": {"type": "bitmap", "data": smooth_texture(32, 64)[..., :1], "raw": True}}
    walls = {**black_room(), "emitter": light}
    return tr.load_dict(soft(scene(3, at_ball(), ball=ball(bsdf), room=walls)), variant=variant, dtype=torch.float64)


@pytest.mark.parametrize("integrator", [None, tr.ParticleTracer(max_depth=3)], ids=["path", "particles"])
@pytest.mark.parametrize("kind", ["normalmap", "bumpmap"])
def test_without_colours_normals_turn_alike(kind, integrator):
    """A grey scene is the same in one channel and in three, image and gradients of all maps; so are nested normals."""
    metal = {"type": "roughconductor", "alpha": 0.6, "distribution": "ggx", "eta": 1.5, "k": 2.0}
    bsdf = {"normalmap": layer_scenes.normal_map(metal), "bumpmap": layer_scenes.bump_map(metal, 0.1)}[kind]
    name = "ball.bsdf." + {"normalmap": "normalmap.data", "bumpmap": "nested_texture.data"}[kind]
    alpha = "ball.bsdf.nested_bsdf.alpha.value"
    found = []
    for variant in ("mono", "rgb"):
        loaded = grey_room(bsdf, variant)
        values = [loaded.get_parameter(n).detach().clone().requires_grad_() for n in (name, alpha)]
        params = dict(zip((name, alpha), values, strict=True))
        image = tr.render(loaded, spp=8 if integrator is None else 512, seed=3, params=params, integrator=integrator)
        found.append([image[..., :1], *torch.autograd.grad((image.mean(-1) ** 2).sum(), values)])

        def f(*tensors, loaded=loaded):
            given = dict(zip((name, alpha), tensors, strict=True))
            return tr.render(loaded, spp=64, seed=5, params=given, integrator=integrator)

        result = tr.testing.dot_product_test(f, [v.detach() for v in values], rtol=1e-9)
        assert result and result.forward != 0, result.message
    for one, three in zip(*found, strict=True):
        torch.testing.assert_close(one, three, rtol=1e-9, atol=1e-12)
        assert float(one.detach().abs().max()) > 1e-3
    assert found[0][1].shape == (12, 16, 3) if kind == "normalmap" else (48, 64, 1)


def test_normals_keep_three_channels_when_colours_go(tmp_path):
    """Assigned maps, those of objects from another scene and saved scenes; colours of the same file turn grey."""
    image = torch.rand(4, 4, 3, generator=torch.Generator().manual_seed(1))
    bsdf = tr.NormalMap(normalmap={"type": "bitmap", "data": image, "raw": True}, bsdf=PAINT)
    made = tr.load_dict(
        {"type": "scene", "camera": {"type": "perspective"}, "ball": {"type": "sphere", "bsdf": bsdf}}, variant="mono"
    )
    assert (
        torch.equal(made.ball.bsdf.normalmap.data, image) and made.ball.bsdf.nested_bsdf.reflectance.value.numel() == 1
    )
    made.ball.bsdf.normalmap = {"type": "bitmap", "data": image.flip(0), "raw": True}
    assert torch.equal(made.ball.bsdf.normalmap.data, image.flip(0))
    made.save(tmp_path / "scene.xml")
    again = tr.load_file(tmp_path / "scene.xml", variant="mono")
    assert torch.equal(again.ball.bsdf.normalmap.data, image.flip(0))


def test_one_image_is_not_both_normals_and_colours_without_colours():
    ref = {"type": "ref", "id": "map"}
    turned = {"type": "normalmap", "normalmap": ref, "bsdf": {"type": "diffuse", "reflectance": ref}}
    image = {"type": "bitmap", "data": layer_scenes.normals(), "raw": True}
    description = scene(2, at_ball(), map=image, ball=ball(turned), room=black_room())
    assert tr.render(tr.load_dict(description), spp=1).isfinite().all()
    with pytest.raises(ValueError, match=r"ball\.bsdf"):
        tr.render(tr.load_dict(description, variant="mono"), spp=1)


def test_texels_are_read_raw():
    texels = smooth_texture(4, 4).float()
    loaded = room({"type": "normalmap", "normalmap": {"type": "bitmap", "data": texels}, "bsdf": PAINT})
    assert torch.equal(loaded.get_parameter("ball.bsdf.normalmap.data"), texels)


def test_saved_and_loaded_again(tmp_path):
    both = {"type": "twosided", "bsdf": layer_scenes.blend(PAINT, layer_scenes.bump_map(BRUSHED, 0.1, scale=0.7))}
    loaded = room(
        layer_scenes.mask(both, 0.8),
        lamp={
            "type": "sphere",
            "center": [0, 3, 0],
            "radius": 0.2,
            "bsdf": layer_scenes.normal_map(DARK, flip_invalid_normals=False),
        },
    )
    loaded.save(tmp_path / "scene.xml")
    again = tr.load_file(tmp_path / "scene.xml")
    assert {n: tuple(p.shape) for n, p in again.named_parameters()} == {
        n: tuple(p.shape) for n, p in loaded.named_parameters()
    }
    assert torch.equal(tr.render(again, spp=4, seed=1), tr.render(loaded, spp=4, seed=1))
