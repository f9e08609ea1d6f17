"""What stays on a card: large parameters, their gradients, images. All is as with the scene on the CPU, bit for bit.

On a device of PyTorch's whose tensors nobody reaches but the emulated device (helpers/card.py): whoever follows the
address of one ends the process. In deterministic mode, so that gradients do not depend on the order of sums.
"""

from __future__ import annotations

import copy
from typing import Any

import card
import pytest
import sdf_grids
import small_scene
import torch
from light_scenes import texels
from small_scene import COLOUR

import torchrender as tr
from torchrender.scene.residence import staying

pytestmark = [
    pytest.mark.skipif(not card.available(), reason="this PyTorch has no devices that Python is the backend of"),
    pytest.mark.filterwarnings("ignore::torchrender.MissingTermWarning"),
]
SETTINGS: dict[str, Any] = {"spp": 4, "seed": 3}
PIXELS = torch.tensor([[r, c] for r in (1, 3, 2, 1) for c in (1, 2, 4)])
PAPER, LAMP, SKY, PAINT = "paper.reflectance.data", "lamp.emitter.radiance.data", "sky.data", "sheet.vertex_color"
LARGE = (PAPER, LAMP, SKY, PAINT)


@pytest.fixture(autouse=True)
def _deterministic():
    before = torch.are_deterministic_algorithms_enabled()
    torch.use_deterministic_algorithms(True)
    yield
    torch.use_deterministic_algorithms(before)


def described(**objects: Any) -> dict[str, Any]:
    """Large numbers of every kind on surfaces: of a BSDF, a lamp and a sky, and colours of a mesh, and small ones."""
    n = 6
    x, y = torch.meshgrid(torch.linspace(-0.9, 0.9, n), torch.linspace(-0.9, 0.9, n), indexing="ij")
    corners = torch.stack([x, y, 0.3 + 0.1 * x * y], -1).reshape(-1, 3)
    first = torch.arange(n * n).reshape(n, n)
    a, b, c, d = (m.flatten() for m in (first[:-1, :-1], first[1:, :-1], first[1:, 1:], first[:-1, 1:]))
    sheet = {
        "type": "mesh",
        "vertex_positions": corners,
        "faces": torch.cat([torch.stack([a, b, c], 1), torch.stack([a, c, d], 1)]),
        "to_world": tr.Transform.translate([-1.2, 0.2, 0]),
        "bsdf": {"type": "roughplastic", "diffuse_reflectance": {"type": "mesh_attribute", "name": "vertex_color"}},
    }
    glow = {"type": "area", "radiance": texels(5, 7, 4.0)}
    to_world = tr.Transform.translate([1.4, 0.9, 0.5]) @ tr.Transform.rotate([0, 1, 0], -60) @ tr.Transform.scale(0.4)
    given = small_scene.ball_and_wall(
        paper={"type": "diffuse", "reflectance": texels(9, 8, 0.8)},
        sky={"type": "envmap", "bitmap": texels(5, 10)["data"]},
        sheet=sheet,
        lamp={"type": "rectangle", "to_world": to_world, "emitter": glow},
        **objects,
    )
    given["ball"]["bsdf"] = {"type": "ref", "id": "paper"}
    return given


def scenes(given: dict[str, Any] | None = None, **settings: Any) -> list[tr.Scene]:
    """One on the CPU and one on the card."""
    found = []
    for place in ("cpu", card.NAME):
        scene = tr.load_dict(given or described(), **settings)
        channels = 1 if settings.get("variant") == "mono" else 3
        colours = torch.rand(36, channels, generator=torch.Generator().manual_seed(4), dtype=scene.dtype)
        scene.sheet.add_attribute("vertex_color", colours)
        found.append(scene.to(place))
    return found


def check_equal(here: list[torch.Tensor], there: list[torch.Tensor]) -> None:
    """Equal, some not zero, and the latter on the card."""
    assert len(here) == len(there) > 0
    for a, b in zip(here, there, strict=True):
        assert b.device == torch.device(card.NAME, 0)
        assert torch.equal(b.detach().to("cpu"), a.detach())
    assert all(a.abs().sum() > 0 for a in here if a.is_floating_point())


def check_close(here: list[torch.Tensor], there: list[torch.Tensor]) -> None:
    """Equal but for the order of sums."""
    for a, b in zip(here, there, strict=True):
        atol = 2e-5 * float(a.detach().abs().max())
        torch.testing.assert_close(b.detach().to("cpu"), a.detach(), rtol=0, atol=atol)


def gradients(image: torch.Tensor, parameters: list[torch.Tensor]) -> list[torch.Tensor]:
    weights = torch.linspace(0.5, 1.5, image.numel(), dtype=image.dtype).reshape(image.shape).to(image.device)
    return list(torch.autograd.grad((image * weights).sum(), parameters))


def image_and_gradients(scene: tr.Scene, names: tuple[str, ...] = (*LARGE, COLOUR), **settings: Any) -> list:
    parameters = [scene.get_parameter(name) for name in names]
    scene.train_only(*names)
    image = tr.render(scene, **{**SETTINGS, **settings})
    return [image, *gradients(image, parameters)]


FROM, TO = "cpu", card.NAME  # the card
TEXELS, LIGHT, STARS, COLOURS, IMAGE = (9, 8, 3), (5, 7, 3), (5, 10, 3), (36, 3), (6, 8, 3)


@pytest.fixture
def there(device):
    """A scene on the card, all of whose numbers the host has seen; copies are counted from now on."""
    scene = scenes()[1]
    tr.render(scene, **SETTINGS)
    scene.train_only(*LARGE, COLOUR)
    card.transfers.clear()
    return scene


def change(scene: tr.Scene) -> None:
    with torch.no_grad():
        for name in LARGE:
            scene.get_parameter(name).mul_(0.9)


@pytest.mark.parametrize("settings", [{}, {"passes": 2}, {"crop": (0, 0, 6, 8)}, {"outputs": ("rgb", "alpha")}])
def test_what_is_copied(there, settings):
    """Of large tensors: what the host makes tables of, from the card, when it has changed. No image, no gradient."""
    for _ in range(2):
        change(there)
        found = tr.render(there, **SETTINGS, **settings)
        image = found if isinstance(found, torch.Tensor) else found.rgb
        weights = torch.full(IMAGE, 0.5).to(there.device)
        card.transfers.pop()
        torch.autograd.grad((image * weights).sum(), [there.get_parameter(n) for n in LARGE])
        large = [t for t in card.transfers if torch.Size(t[1]).numel() > 64]
        assert sorted(large) == sorted([(FROM, LIGHT), (FROM, STARS), (FROM, COLOURS)])
        card.transfers.clear()


def test_what_is_copied_in_forward_mode(there):
    (texels,) = [there.get_parameter(PAPER).detach()]
    tangent = texels * 0.5
    image, along = torch.func.jvp(lambda x: tr.render(there, params={PAPER: x}, **SETTINGS), (texels,), (tangent,))
    assert image.device == along.device == there.device
    assert not [t for t in card.transfers if torch.Size(t[1]).numel() > 64]


@pytest.mark.parametrize(
    ("settings", "copied"),
    [
        ({"pixels": PIXELS}, [(TO, (12, 3)), (FROM, (12, 3))]),
        ({"adaptive_grad": True}, [(FROM, IMAGE)]),
        ({"integrator": tr.ParticleTracer(max_depth=3)}, [(TO, IMAGE), (FROM, IMAGE)]),
        ({"on_interrupt": "return"}, [(TO, IMAGE), (FROM, IMAGE)]),
    ],
    ids=["pixels", "samples", "light paths", "interruptions"],
)
def test_what_does_not_stay(there, settings, copied):
    """Images and adjoints that are made on the CPU in the end; gradients stay."""
    tr.render(there, **SETTINGS, **settings).square().sum().backward()
    large = [t for t in card.transfers if t[1] in (IMAGE, (12, 3), TEXELS, LIGHT, STARS, COLOURS)]
    assert large == copied


def test_which_do():
    layout = scenes()[0].layout()
    named = {layout.slots[slot].name: alone for slot, alone in staying(layout).items()}
    assert named == {PAPER: True, LAMP: False, SKY: False, PAINT: False}


CASES: dict[str, dict[str, Any]] = {
    "plain": {},
    "passes": {"passes": 3, "spp": 2},
    "a crop": {"crop": (1, 1, 4, 5)},
    "pixels": {"pixels": PIXELS},
    "samples": {"adaptive_grad": True, "spp_grad": 6},
    "light paths": {"integrator": tr.ParticleTracer(max_depth=3)},
    "bits": {"integrator": tr.DirectIllumination()},
    "moments": {"integrator": tr.Moment(tr.PathTracer(max_depth=3))},
    "rows": {"integrator": tr.AOV("d:depth,a:albedo", tr.PathTracer(max_depth=3))},
    "channels first": {"layout": "bchw"},
}


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_images_and_gradients(device, case):
    check_equal(*(image_and_gradients(scene, **case) for scene in scenes()))


@pytest.mark.parametrize("rfilter", ["gaussian", "tent"])
def test_filters(device, rfilter):
    given = described()
    given["sensor"]["film"]["rfilter"] = {"type": rfilter}
    check_equal(*(image_and_gradients(scene) for scene in scenes(given)))


def test_in_double_precision(device):
    check_equal(*(image_and_gradients(scene) for scene in scenes(dtype=torch.float64)))


def test_in_grey(device):
    check_equal(*(image_and_gradients(scene) for scene in scenes(variant="mono")))


def test_without_determinism(device):
    torch.use_deterministic_algorithms(False)
    here, there = (image_and_gradients(scene) for scene in scenes())
    check_equal(here[:1], there[:1])
    check_close(here, there)


def test_outputs(device):
    names = ("rgb", "alpha", "variance", "second_moment", "albedo", "roughness", "vertex_color", "shape_id", "duv_dx")
    found = []
    for scene in scenes():
        parameters = scene.train_only(PAPER, PAINT)
        outputs = tr.render(scene, outputs=names, **SETTINGS)
        shown = [outputs.rgb, outputs.albedo, outputs.vertex_color]
        found.append([*outputs, *torch.autograd.grad(sum(s.square().sum() for s in shown), parameters)])
    check_equal(*found)


def test_what_is_copied_for_edges_that_move(there):
    """No texels, which the device has: the vertices, and the adjoint of the picture, which the host weights."""
    there.train_only("sheet.vertex_positions", "ball.center")
    with torch.no_grad():
        there.get_parameter(PAPER).mul_(0.9)
    tr.render(there, visibility=True, **SETTINGS).square().sum().backward()
    assert there.statistics["visibility"]["shadows"]["rays"] > 0
    large = {t for t in card.transfers if torch.Size(t[1]).numel() > 64}
    assert large and (FROM, TEXELS) not in large and large <= {(FROM, IMAGE), (TO, IMAGE), (TO, (36, 3))}, large
    card.transfers.clear()
    outputs = tr.render(there, outputs=("albedo", "uv"), visibility=True, **SETTINGS)
    (outputs.albedo.sum() + outputs.uv.sum()).backward()
    assert there.statistics["visibility_outputs"]["outputs"]["rays"] > 0
    large = {t for t in card.transfers if torch.Size(t[1]).numel() > 64}
    assert large <= {(FROM, (6, 8, 3)), (FROM, (6, 8, 2)), (TO, (6, 8, 3)), (TO, (6, 8, 2)), (TO, (36, 3))}, large


def test_edges_that_move(device):
    names = (PAPER, COLOUR, "ball.center", "sheet.vertex_positions", "sensor.to_world")
    found = []
    for scene in scenes():
        parameters = list(scene.train_only(*names))
        outputs = tr.render(scene, outputs=("rgb", "alpha", "depth", "albedo"), visibility=True, **SETTINGS)
        seen = outputs.depth[outputs.depth.isfinite()].sum() + outputs.albedo.square().sum()
        loss = outputs.rgb.square().sum() + outputs.alpha.sum() + seen
        found.append([outputs.rgb, *torch.autograd.grad(loss, parameters)])
        assert scene.statistics["visibility"]["silhouettes"]["samples"] > 0
    check_equal(*(gradient[:1] for gradient in found))
    check_close(*found)  # the CPU's threads add in any order


def test_edges_beside_what_stays(device):
    """In both modes: lights are trained that show texels of the card, which their edges do not move."""
    names, found = (SKY, LAMP, "ball.center", "sheet.vertex_positions"), []
    for scene in scenes():
        found.append(image_and_gradients(scene, names, visibility=True))
        scene.train_only()
        values = {name: scene.get_parameter(name).detach() for name in names}

        def image(params: dict[str, torch.Tensor], scene: tr.Scene = scene) -> torch.Tensor:
            return tr.render(scene, params=params, visibility=True, **SETTINGS)

        found[-1].extend(torch.func.jvp(image, (values,), ({n: 0.5 * v for n, v in values.items()},)))
    check_close(*found)


def test_grids_and_fields(device):
    """Their numbers are the host's, too, which makes trees of them, and again where they change or move."""
    paper = {"type": "ref", "id": "paper"}
    place = tr.Transform.translate([0.1, -0.6, 0.9]) @ tr.Transform.scale(0.8)
    grid = sdf_grids.shape(sdf_grids.dented((5, 6, 7), 0.02).float(), to_world=place, bsdf=paper)
    heights = 0.1 * torch.rand(9, 8, generator=torch.Generator().manual_seed(5))
    to_world = tr.Transform.translate([-0.7, -0.7, 0.6]) @ tr.Transform.scale(0.5)
    field = {"type": "heightfield", "heights": heights, "to_world": to_world, "bsdf": paper}
    names, bigger = ("grid.grid", "field.heights", "grid.to_world", PAPER), torch.tensor([1.1, 1.1, 1.1, 1.0])[:, None]
    found = []
    for scene in scenes(described(grid=grid, field=field)):
        first = image_and_gradients(scene, names, visibility=False)
        with torch.no_grad():
            scene.get_parameter("grid.grid").add_(0.01), scene.get_parameter("field.heights").mul_(1.2)
            second = tr.render(scene, **SETTINGS)
            for name in ("grid.to_world", "field.to_world"):
                scene.get_parameter(name).mul_(bigger.to(scene.device))
        found.append([*first, second, *image_and_gradients(scene, names, visibility=False)])
        assert torch.equal(found[-1][6].detach(), tr.render(copy.deepcopy(scene), **SETTINGS).detach())
    check_equal(*found)
    assert not torch.equal(found[0][0], found[0][5])


def test_voxels(device):
    fog = {"type": "gridvolume", "data": torch.rand(5, 6, 4, 1, generator=torch.Generator().manual_seed(2)) * 3}
    box = {
        "type": "sphere",
        "radius": 0.7,
        "center": [0, 0, 1.2],
        "bsdf": {"type": "null"},
        "interior": {"type": "heterogeneous", "sigma_t": fog, "albedo": 0.7},
    }
    found = []
    for scene in scenes(described(fog=box)):
        (name,) = [n for n, _ in scene.named_parameters() if n.endswith("sigma_t.data")]
        found.append(image_and_gradients(scene, (name, PAPER), integrator=tr.VolumetricPathTracer(max_depth=4)))
    check_equal(*found)


def test_forward_mode_and_functions(device):
    names = (*LARGE, COLOUR)
    found = []
    for scene in scenes():
        values = tuple(scene.get_parameter(n).detach() for n in names)
        generator = torch.Generator().manual_seed(5)
        tangents = tuple(torch.rand(v.shape, generator=generator).to(v.device) for v in values)

        def image(*given, scene=scene):
            return tr.render(scene, params=dict(zip(names, given, strict=True)), passes=2, **SETTINGS)

        value, along = torch.func.jvp(image, values, tangents)
        pulled = torch.func.grad(lambda *given, image=image: image(*given).square().sum(), argnums=(0, 1))(*values)

        def albedo(texels, scene=scene):
            return tr.render(scene, params={PAPER: texels}, outputs=("albedo",), **SETTINGS).albedo

        found.append([value, along, *pulled, *torch.func.jvp(albedo, values[:1], tangents[:1])])
    check_equal(*found)


def test_training(device):
    found = []
    for scene in scenes():
        (paper,) = scene.train_only(PAPER)
        optimizer = torch.optim.Adam([paper], lr=0.05)
        for seed in range(3):
            optimizer.zero_grad()
            tr.render(scene, spp=2, seed=seed).square().mean().backward()
            optimizer.step()
        found.append([paper, paper.grad])
        assert scene.updates["scenes"] == 1
    check_equal(*found)


def test_what_has_changed_is_seen(device):
    here, there = scenes()
    for change in (0.5, 0.7):
        check_equal([tr.render(here, **SETTINGS)], [tr.render(there, **SETTINGS)])
        for scene in (here, there):
            with torch.no_grad():
                for name in LARGE:
                    scene.get_parameter(name).mul_(change)
    check_equal([tr.render(here, **SETTINGS)], [tr.render(there, **SETTINGS)])
    for scene in (here, there):
        scene["paper"].reflectance = texels(8, 9, 0.9, seed=3)
    check_equal([tr.render(here, **SETTINGS)], [tr.render(there, **SETTINGS)])


def test_a_change_before_the_derivative_is_an_error(device):
    """As on the CPU: the derivative would be that of other numbers."""
    for scene in scenes():
        (paper,) = scene.train_only(PAPER)
        loss = tr.render(scene, **SETTINGS).sum()
        with torch.no_grad():
            paper.mul_(0.5)
        with pytest.raises(RuntimeError, match="modified by an inplace operation"):
            loss.backward()


@pytest.mark.parametrize("name", LARGE)
def test_numbers_that_are_not_finite_are_named(device, name):
    _, there = scenes()
    tr.render(there, **SETTINGS)
    with torch.no_grad():
        there.get_parameter(name)[1] = float("nan")
    for _ in range(2):
        with pytest.raises(ValueError, match=f"^{name.replace('.', '[.]')}: "):
            tr.render(there, **SETTINGS)
    with torch.no_grad():
        there.get_parameter(name)[1] = 0.5
    assert tr.render(there, **SETTINGS).to("cpu").isfinite().all()


def test_ranges(device):
    _, there = scenes()
    with torch.no_grad():
        there.get_parameter(PAPER).mul_(3)
    with pytest.raises(ValueError, match=rf"^render: {PAPER}: .* is outside of \[0, 1\]"):
        tr.render(there, range="raise", **SETTINGS)


def test_tensors_of_the_cpu_in_its_place(device):
    """One that `params` gives may lie on the CPU; its gradient does, too."""
    found = []
    for scene in scenes():
        given = texels(7, 7, 0.6)["data"].requires_grad_(True)
        image = tr.render(scene, params={PAPER: given}, **SETTINGS)
        assert image.device == scene.device
        found.append([*gradients(image, [given]), *image_and_gradients(scene, (PAPER,))])
    assert torch.equal(found[0][0], found[1][0])
    check_equal(found[0][1:], found[1][1:])


@pytest.mark.parametrize("order", [("emulated", "tree"), ("tree", "emulated")], ids=" then ".join)
def test_another_device_for_the_derivative(device, order):
    """What computes may be chosen anew at any time."""
    found = []
    for scene in scenes():
        parameters = list(scene.train_only(*LARGE))
        device(order[0])
        outputs = tr.render(scene, outputs=("rgb", "albedo"), **SETTINGS)
        device(order[1])
        loss = outputs.rgb.square().sum() + outputs.albedo.sum()
        found.append([outputs.rgb, *torch.autograd.grad(loss, parameters)])
    check_equal(*found)


def test_an_interrupted_rendering(device):
    """What comes back of one is as large as all of it, and has its derivative."""
    _, there = scenes()
    (paper,) = there.train_only(PAPER)
    image = tr.render(there, on_interrupt="return", **SETTINGS)
    assert image.device == there.device
    here, _ = scenes()
    (own,) = here.train_only(PAPER)
    expected = tr.render(here, on_interrupt="return", **SETTINGS)
    check_equal([expected, *gradients(expected, [own])], [image, *gradients(image, [paper])])
