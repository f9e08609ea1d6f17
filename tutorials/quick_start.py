# %% [markdown]
# # Quick start
#
# torchrender is a path tracer that is a PyTorch layer: a scene is an `nn.Module`, an image is a tensor with a
# `grad_fn`, and whatever you know about training works on pictures. This page takes ten minutes: load a scene, render
# it, look at it, differentiate it, and recover a colour and a texture from a picture. It exists twice, as a script
# (`python tutorials/quick_start.py`) and as a notebook (`tutorials/quick_start.ipynb`).

# %%
import sys
from pathlib import Path

import kornia
import torch
import torch.nn.functional as F

import torchrender as tr

# `python tutorials/quick_start.py --small` does the same in a few seconds.
small = "--small" in sys.argv
height, width, steps = (48, 64, 50) if small else (192, 256, 80)
folder = Path("output/quick_start")

# %% [markdown]
# ## A scene
#
# Scenes come from nested dicts, from Mitsuba's XML (`tr.load_file("scene.xml")`), or from glTF, OBJ, PLY and STL files.
# Values are numbers, lists, arrays or tensors. Shapes are the natural ones: a texture is `(H, W, C)`, vertices are
# `(V, 3)`.

# %%
v, u = torch.meshgrid(torch.linspace(0, 1, 24), torch.linspace(0, 1, 24), indexing="ij")
rings = 0.5 + 0.5 * torch.cos(20 * torch.hypot(u - 0.5, v - 0.5))[..., None]
carpet = rings * torch.tensor([0.15, 0.35, 0.6]) + (1 - rings) * torch.tensor([0.9, 0.75, 0.45])  # (24, 24, 3)

scene = tr.load_dict(
    {
        "type": "scene",
        "camera": {
            "type": "perspective",
            "fov": 42,
            "to_world": tr.Transform.look_at(origin=[0, 3.5, 5.5], target=[0, 0.3, 0], up=[0, 1, 0]),
            "film": {"type": "hdrfilm", "width": width, "height": height},
        },
        "integrator": {"type": "path", "max_depth": 6},
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": [0.5, 0.55, 0.6]}},
        "lamp": {
            "type": "rectangle",
            "to_world": tr.Transform.look_at([-2, 5, 2], [0, 0, 0], [0, 0, 1]),
            "emitter": {"type": "area", "radiance": 6.0},
        },
        "floor": {
            "type": "rectangle",
            "to_world": tr.Transform.rotate([1, 0, 0], -90).scale(1.9),
            "bsdf": {"type": "diffuse", "reflectance": {"type": "bitmap", "data": carpet, "raw": True}},
        },
        "ball": {
            "type": "sphere",
            "center": [-0.9, 0.8, 0],
            "radius": 0.8,
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.8, 0.25, 0.1]}},
        },
        "glass": {
            "type": "sphere",
            "center": [1.0, 0.7, 0.4],
            "radius": 0.7,
            "bsdf": {"type": "dielectric", "int_ior": 1.5},
        },
    }
)

# %% [markdown]
# Every continuous quantity is a parameter with a dotted name. Printing the scene lists them, with the derivatives that
# each of them has.

# %%
print(scene)

# %% [markdown]
# ## An image
#
# `tr.render` returns linear radiance as an ordinary tensor `(H, W, 3)`. `spp` is the number of samples a pixel: four
# times as many halve the noise. The same `seed` gives the same image, bit for bit; without one, torch's default
# generator is asked, so `torch.manual_seed` governs it.

# %%
with torch.no_grad():
    target = tr.render(scene, spp=256, seed=0)
print(target.shape, target.dtype)
tr.show(target)

# %% [markdown]
# ## A gradient
#
# Nothing requires a gradient until you ask for it. `train_only` takes names or patterns and returns the parameters, for
# an optimiser, say. The render is then part of the graph.

# %%
(colour,) = scene.train_only("ball.bsdf.reflectance.value")
image = tr.render(scene, spp=16, seed=1)
print(type(image.grad_fn).__name__)
image.mean().backward()
print("d(mean of the image) / d(colour of the ball) =", colour.grad)

# %% [markdown]
# `scene.train_only` is a convenience for `requires_grad_()`; `scene.get_parameter(name)`, `scene.named_parameters()`,
# `scene.state_dict()`, `copy.deepcopy(scene)` and the rest of `nn.Module` are there as well.
#
# With forward-mode differentiation the question is the other way round: how does *every pixel* react to one parameter?
# Red is where the image gets brighter if the ball reflects more: the ball, its image in the glass, the floor around.


# %%
def picture(reflectance):
    return tr.render(scene, spp=64, seed=2, params={"ball.bsdf.reflectance.value": reflectance})


_, derivative = torch.func.jvp(picture, (colour.detach(),), (torch.ones(3),))
tr.show(derivative.mean(-1, keepdim=True) * torch.tensor([1.0, 0.3, 0.2]))

# %% [markdown]
# `params=` replaces parameters by any tensors for one call, and gradients flow into them. They may come out of a neural
# network: see `neural_texture.py`.
#
# ## An optimisation
#
# Now we forget the colour of the ball and the texture of the floor, and recover both from the picture. Three things
# make it work as it should:
#
# * **A new seed in every step.** The noise of different steps then averages out.
# * **A squared error.** Image and derivative come from independent samples (`seed_grad` is a hash of `seed`), so its
#   gradient is unbiased, however noisy the image: few samples a pixel are enough.
# * **A little regularisation** for texels that hardly anybody sees. Losses for images come from torch and kornia;
#   `layout="chw"` and `"bchw"` give the layout that kornia wants.

# %%
names = ["ball.bsdf.reflectance.value", "floor.bsdf.reflectance.data"]
truth = {name: scene.get_parameter(name).detach().clone() for name in names}
parameters = scene.train_only(*names)
with torch.no_grad():
    for parameter in parameters:
        parameter.fill_(0.5)  # an edit in place: the next render sees it
    start = tr.render(scene, spp=64, seed=3)

optimiser = torch.optim.Adam(parameters, lr=0.05, betas=(0.8, 0.95))
schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
bar = tr.progress(range(steps), desc="optimising")
for step in bar:
    optimiser.zero_grad()
    image = tr.render(scene, spp=8, seed=100 + step)
    smoothness = kornia.losses.total_variation(parameters[1].movedim(-1, 0)[None], reduction="mean").mean()
    loss = F.mse_loss(image, target) + 2e-4 * smoothness
    loss.backward()
    optimiser.step()
    schedule.step()
    with torch.no_grad():
        for parameter in parameters:
            parameter.clamp_(0, 1)
    bar.set_postfix(loss=f"{loss.item():.3g}")

with torch.no_grad():
    result = tr.render(scene, spp=64, seed=4)
tr.show([start, result, target])

# %% [markdown]
# From left to right: where we started, what we found, and the picture that was given.

# %%
found_colour, found_texture = (parameter.detach() for parameter in parameters)
colour_error = float((found_colour - truth[names[0]]).abs().max())
texture_error = float((found_texture - truth[names[1]]).square().mean().sqrt())
print("colour of the ball:", [round(x, 3) for x in found_colour.tolist()], "true:", [0.8, 0.25, 0.1])
print(f"texture of the floor: root mean square error {texture_error:.3f}, from {(truth[names[1]] - 0.5).std():.3f}")

# %% [markdown]
# ## Several cameras
#
# A camera is a module of the scene like any other. A list of them gives a batch. Cameras also come from OpenCV's
# matrices (`tr.PerspectiveCamera.from_opencv(K, R, t, (H, W))`) and OpenGL's (`.from_opengl`).

# %%
for i, x in enumerate([-4.0, 4.0]):
    scene[f"side{i}"] = tr.PerspectiveCamera.look_at([x, 2.5, 3.0], [0, 0.4, 0], fov=40, size=(height, width))

renderer = tr.Renderer(scene, integrator=tr.PathTracer(max_depth=8), spp=64)  # an nn.Module with the settings inside
with torch.no_grad():
    batch = renderer(sensor=[1, 2], seed=5, layout="bchw")
print(batch.shape)
tr.show([view.movedim(0, -1) for view in batch])

# %% [markdown]
# ## More than colours
#
# `outputs=` asks for depth, position, normals, texture coordinates, albedo, identifiers of shapes, alpha or the
# variance of the image, and returns a named tuple. What is continuous is differentiable.

# %%
with torch.no_grad():
    out = tr.render(scene, spp=32, seed=6, outputs=("depth", "shading_normal", "albedo"))
print({name: tuple(value.shape) for name, value in out._asdict().items()}, "depth of the sky:", out.depth[0, 0].item())
nearness = (5 / out.depth).pow(3)[..., None].expand(-1, -1, 3)
tr.show([nearness, (0.5 + 0.5 * out.shading_normal).pow(2.2), out.albedo])

# %% [markdown]
# ## Editing
#
# Scenes change by assignment: add, replace or delete objects, give a texture another size. There is no `update()`.

# %%
scene["cube"] = {
    "type": "cube",
    "to_world": tr.Transform.translate([0.0, 0.25, 0.9]).rotate([0, 1, 0], 20).scale(0.25),
    "bsdf": {"type": "conductor", "material": "Au"},
}
with torch.no_grad():
    edited = tr.render(scene, spp=128, seed=7)
tr.show(edited)

# %% [markdown]
# ## Saving
#
# EXR and PFM keep the numbers, PNG and JPEG are tone-mapped for looking at. A scene is saved as any module.

# %%
folder.mkdir(parents=True, exist_ok=True)
tr.io.write_image(folder / "result.exr", result)
tr.io.write_image(folder / "result.png", result)
tr.io.write_image(folder / "target.png", target)
torch.save(scene.state_dict(), folder / "scene.pt")
print(sorted(path.name for path in folder.iterdir()))

# %% [markdown]
# ## Where to go from here
#
# * `cornell_box.py`: fifteen albedos from one picture; `textured_monkey.py`: a texture of 512 x 512 texels, coarse to
#   fine.
# * `neural_texture.py`: the texture is the output of a network.
# * `camera_calibration.py`: pose, field of view and principal point of a camera from one photograph.
# * `glass_ball.py`: an index of refraction from what is seen in a ball of glass.
# * `docs/api.md`: everything, with an example each; `docs/derivatives.md`: what is differentiable.
# * `docs/from_mitsuba.md` and `docs/from_redner_and_pytorch3d.md`: what is called how, for people who come from there.
