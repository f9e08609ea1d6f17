"""Outputs of first hits on the emulated device: bit for bit those of the CPU in one tree; derivatives are close."""

from __future__ import annotations

import light_scenes
import pytest
import reference_scenes
import torch
from emulated import check_close, check_transposed, differentiable, materials, scene_of_materials

import torchrender as tr
from torchrender.first_hit_call import FIRST_HIT_OUTPUTS, IDENTIFIERS

pytestmark = pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning")
NAMES = ("rgb", *FIRST_HIT_OUTPUTS)
SMOOTH = tuple(name for name in FIRST_HIT_OUTPUTS if name not in IDENTIFIERS)
SETTINGS = {"integrator": tr.PathTracer(max_depth=2), "spp": 3, "seed": 3}


def check_same(device, scene: tr.Scene, names: tuple[str, ...] = NAMES, **settings) -> tuple[torch.Tensor, ...]:
    settings = {**SETTINGS, **settings}
    device("tree")
    expected = tr.render(scene, outputs=names, **settings)
    device("emulated")
    found = tr.render(scene, outputs=names, **settings)
    for name, a, b in zip(names, found, expected, strict=True):
        assert torch.equal(a, b), f"{name}: {(a != b).double().mean():.3%} differ"
    return found


def shown(outputs: tuple[torch.Tensor, ...], names: tuple[str, ...]) -> dict[str, torch.Tensor]:
    """Outputs without the infinite distances of what is not hit."""
    return {n: torch.where(o.isfinite(), o, 0.0) for n, o in zip(names, outputs, strict=True)}


def gradients(scene: tr.Scene, parameters: dict[str, torch.nn.Parameter], names=SMOOTH, **settings):
    settings = {**SETTINGS, "visibility": False, **settings}
    outputs = shown(tr.render(scene, outputs=names, **settings), names)
    loss = sum((o * torch.linspace(0.5, 1.5, o.numel()).reshape(o.shape)).sum() for o in outputs.values())
    found = torch.autograd.grad(loss, list(parameters.values()), allow_unused=True)
    return {n: torch.zeros_like(p) if g is None else g for (n, p), g in zip(parameters.items(), found, strict=True)}


def check_same_gradients(device, scene: tr.Scene, **settings) -> None:
    chosen = differentiable(scene)
    device("tree")
    expected = gradients(scene, chosen, **settings)
    device("emulated")
    check_close(gradients(scene, chosen, **settings), expected)


SINGLE = ("bitmaps", "mesh", "cylinders", "film", *sorted(reference_scenes.CAMERAS))


@pytest.mark.parametrize(("name", "dtype"), [*((name, torch.float32) for name in SINGLE), ("bitmaps", torch.float64)])
def test_outputs_and_gradients_are_those_of_the_cpu(device, name, dtype):
    scene = tr.load_dict({**reference_scenes.SCENES, **reference_scenes.CAMERAS}[name]().scene, dtype=dtype)
    found = dict(zip(NAMES, check_same(device, scene, spp=2), strict=True))
    assert float(found["depth"].isfinite().double().mean()) > 0 and int(found["shape_id"].max()) >= 0
    check_same_gradients(device, scene, spp=2)


def test_every_material(device):
    """What outputs show of BSDFs, below all that wraps them."""
    scene = scene_of_materials(materials(), 24)
    names = ("albedo", "specular_reflectance", "roughness", "material_id")
    found = check_same(device, scene, names)
    assert len(found[-1].unique()) > 20
    check_same_gradients(device, scene, names=names[:3])


@pytest.mark.parametrize(
    "settings",
    [
        {"crop": (3, 2, 5, 6)},
        {"pixels": torch.tensor([[7, 9], [0, 0], [7, 9], [3, 4], [3, 5]])},
        {"passes": 2, "sampler": "independent"},
        {"integrator": tr.PathTracer(max_depth=0, hide_emitters=True)},
        {"spp": 70},
    ],
)
@pytest.mark.parametrize("rfilter", ["box", "lanczos"])
def test_settings(device, rfilter, settings):
    film = {"type": "hdrfilm", "width": 12, "height": 10, "rfilter": {"type": rfilter}}
    objects = light_scenes.room(lamp=light_scenes.area(), ball=light_scenes.ball_light())
    camera = next(name for name, value in objects.items() if isinstance(value, dict) and "film" in value)
    scene = tr.load_dict({**objects, camera: {**objects[camera], "film": film}})
    check_same(device, scene, **settings)
    check_same_gradients(device, scene, **settings)


def test_colours_of_meshes(device):
    vertices = torch.tensor([[-1.0, -1, 0], [1, -1, 0], [0, 1, 0]])
    colours = {"vertex_color": torch.eye(3)}
    mesh = tr.Mesh(vertices=vertices, faces=torch.tensor([[0, 1, 2]]), attributes=colours)
    scene = tr.load_dict({"type": "scene", "camera": light_scenes.camera(), "mesh": mesh, "sky": {"type": "constant"}})
    names = ("rgb", "vertex_color")
    assert float(check_same(device, scene, names)[1].max()) > 0.3
    check_same_gradients(device, scene, names=names[1:])


def test_integrators(device):
    """Those around another one: averages over all samples, which are zero where nothing is hit."""
    scene = tr.load_dict(reference_scenes.SCENES["mesh"]().scene)
    aovs = "d:depth,p:position,n:sh_normal,a:albedo,i:shape_index,u:duv_dx"
    for integrator in (tr.AOV(aovs, tr.PathTracer(max_depth=2)), tr.AOV(aovs), tr.Depth()):
        images = []
        for name in ("tree", "emulated"):
            device(name)
            images.append(tr.render(scene, integrator=integrator, spp=2, seed=1))
        assert torch.equal(*images) and float(images[0].abs().max()) > 0


def test_forward_mode(device):
    """Tangents are the CPU's, and <J t, w> = <t, J^T w> with the same samples."""
    scene = tr.load_dict(reference_scenes.SCENES["mesh"]().scene)
    chosen = differentiable(scene)
    scene.train_only()
    generator = torch.Generator().manual_seed(1)
    values = tuple(p.detach() for p in chosen.values())
    tangents = tuple(torch.randn(v.shape, generator=generator) for v in values)

    def outputs(*given: torch.Tensor) -> torch.Tensor:
        params = dict(zip(chosen, given, strict=True))
        found = tr.render(scene, params=params, outputs=SMOOTH, visibility=False, seed_grad=5, **SETTINGS)
        return torch.cat([o.flatten() for o in shown(found, SMOOTH).values()])

    found = {}
    for name in ("tree", "emulated"):
        device(name)
        found[name] = torch.func.jvp(outputs, values, tangents)[1]
    check_close({"tangent": found["emulated"]}, {"tangent": found["tree"]})
    check_transposed(outputs, values, tangents, found["emulated"], generator)


def test_deterministic_algorithms(device, request):
    scene = tr.load_dict(reference_scenes.SCENES["mesh"]().scene)
    chosen = differentiable(scene)
    plain = gradients(scene, chosen)
    request.addfinalizer(lambda: torch.use_deterministic_algorithms(False))
    torch.use_deterministic_algorithms(True)
    first, again = gradients(scene, chosen), gradients(scene, chosen)
    assert all(torch.equal(first[name], again[name]) for name in first)
    check_close(first, plain)
