# %% [markdown]
# # torchrender in five minutes
#
# torchrender is a path tracer that is a PyTorch layer. This page installs it, renders a picture, and recovers two
# colours from the picture alone. It runs on the processor: no GPU is needed.

# %% [markdown]
# ## Installing
#
# The package is called `torch-pathtracer`, what is imported `torchrender`. As long as it is not on PyPI,
# `%pip install git+https://github.com/torchrender/torchrender` compiles it, which takes some minutes.

# %%
# %pip install -q torch-pathtracer

# %% [markdown]
# ## A picture
#
# A scene is an `nn.Module`, made of a nested dict or of a file. Here are a ball and a floor, under a lamp and a dim
# sky. `tr.render` returns linear radiance as an ordinary tensor, `(height, width, 3)`; `spp` is the number of samples
# a pixel.

# %%
import torch

import torchrender as tr

scene = tr.load_dict(
    {
        "type": "scene",
        "camera": {
            "type": "perspective",
            "fov": 35,
            "to_world": tr.Transform.look_at(origin=[0, 1.6, 5], target=[0, 0.8, 0], up=[0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 80, "height": 60},
        },
        "integrator": {"type": "path", "max_depth": 4},
        "sky": {"type": "constant", "radiance": 0.3},
        "lamp": {
            "type": "rectangle",
            "to_world": tr.Transform.look_at([2, 4, 3], [0, 0.5, 0], [0, 1, 0]).scale(0.6),
            "emitter": {"type": "area", "radiance": 15.0},
        },
        "floor": {
            "type": "rectangle",
            "to_world": tr.Transform.rotate([1, 0, 0], -90).scale(5),
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.2, 0.4, 0.6]}},
        },
        "ball": {
            "type": "sphere",
            "center": [0, 1, 0],
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.8, 0.3, 0.1]}},
        },
    }
)
with torch.no_grad():
    target = tr.render(scene, spp=128, seed=0)
tr.show(target)

# %% [markdown]
# ## What made it?
#
# Now both colours are forgotten: ball and floor are grey. Every number of a scene is a parameter with a name;
# `scene.train_only` returns those to be found, and the picture is part of PyTorch's graph. A new `seed` in every step
# lets the noise of the pictures average out.

# %%
names = ["ball.bsdf.reflectance.value", "floor.bsdf.reflectance.value"]
truth = {name: scene.get_parameter(name).tolist() for name in names}
colours = scene.train_only(*names)
with torch.no_grad():
    for colour in colours:
        colour.fill_(0.5)
    start = tr.render(scene, spp=64, seed=1)

steps = 40
optimiser = torch.optim.Adam(colours, lr=0.05)
schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
for step in tr.progress(range(steps)):
    optimiser.zero_grad()
    loss = (tr.render(scene, spp=8, seed=10 + step) - target).square().mean()
    loss.backward()
    optimiser.step()
    schedule.step()
    with torch.no_grad():
        for colour in colours:
            colour.clamp_(0, 1)

with torch.no_grad():
    result = tr.render(scene, spp=64, seed=2)
tr.show([start, result, target])  # where it began, what was found, what was given
found = dict(zip(names, [colour.tolist() for colour in colours]))
for name in names:
    print(name, [f"{x:.3f}" for x in found[name]], "true:", [f"{x:.3f}" for x in truth[name]])

# %% [markdown]
# ## Where to go from here
#
# * [The quick start](https://github.com/torchrender/torchrender/blob/main/tutorials/quick_start.ipynb) has textures,
#   batches of cameras, depth and normals, editing and saving.
# * [The other tutorials](https://github.com/torchrender/torchrender/blob/main/docs/quick_start.md) recover shapes,
#   lights, cameras, glass, smoke and more.
