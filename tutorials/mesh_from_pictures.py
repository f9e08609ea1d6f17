"""A sphere becomes a monkey: find the surface of an object from pictures of it.

    python tutorials/mesh_from_pictures.py            # 16 pictures of 128 x 128 pixels, 200 steps, then finer
    python tutorials/mesh_from_pictures.py --demo     # the same, smaller

Sixteen cameras photograph Blender's monkey under a sky and a lamp, and say for every pixel how much of it the monkey
covers (alpha). We know cameras, lights and the colour of the material, and begin with a sphere of 20480 triangles. What
moves it is shading, inside of the outlines, and the outlines themselves: the derivative by the vertices contains how
silhouettes sweep over pixels, in the picture and in alpha.

Each vertex knows little, and steps along its own derivative would crumple the surface. So the optimiser moves
``u = (I + lambda L) vertices`` in place of the vertices: large, smooth steps (Nicolet and others 2021). Then every
triangle is divided into four, and the finer mesh goes on where the coarse one ends.

Pictures that nobody has used for the fit, and points on both surfaces, say how good the result is.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import torch
import trimesh
from checkpoints import Checkpoint
from command_line import at_least_one, given, reported
from meshes import cameras, chamfer, directions, points_outside, subdivide, turntable, write_ply
from pictures import save, save_curves

import torchrender as tr

MONKEY = Path(__file__).resolve().parent.parent / "scenes" / "meshes" / "monkey.ply"
VERTICES = "object.vertex_positions"
DISTANCE, FOV = 4.5, 36.0  # of the cameras, which look at the origin


def make_scene(vertices: torch.Tensor, faces: torch.Tensor) -> tr.Scene:
    """An object (V, 3), (F, 3) of grey clay under a sky and a lamp."""
    clay = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": 0.6}}
    mesh = tr.Mesh(vertices, faces, bsdf=clay)
    mesh.compute_normals()  # smooth, and they follow the vertices
    return tr.load_dict(
        {
            "type": "scene",
            "object": mesh,
            "sky": {"type": "constant", "radiance": 0.4},
            "lamp": {"type": "point", "position": [3.0, 4.0, 5.0], "intensity": 60.0},
        }
    )


def monkey() -> tuple[torch.Tensor, torch.Tensor]:
    """Vertices (V, 3) and faces (F, 3) of the monkey, whose file has vertices several times where texture has seams."""
    mesh = trimesh.load(MONKEY, process=False)
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    return torch.from_numpy(mesh.vertices.copy()).float(), torch.from_numpy(mesh.faces.copy()).long()


def strip(images: torch.Tensor) -> torch.Tensor:
    """Up to eight of the pictures (N, H, W, 3) beside each other."""
    return torch.cat(list(images[:8]), dim=1)


def overlap(found: torch.Tensor, true: torch.Tensor) -> float:
    """Intersection over union of masks, pixels of which more than half is covered."""
    found, true = found > 0.5, true > 0.5
    return float((found & true).sum() / (found | true).sum())


def run(
    folder: Path,
    *,
    subdivisions: int = 5,
    resolution: int = 128,
    view_count: int = 16,
    spp: int = 8,
    iterations: int = 200,
    finer_iterations: int = 60,
    target_spp: int = 64,
    rate: float = 0.1,
    smoothness: float = 20.0,
    points: int = 50_000,
    save_every: int = 20,
    restart: bool = False,
) -> dict[str, float]:
    """The whole program; returns chamfer distance and IoU of the sphere, of the coarse and of the fine mesh.

    Args:
        folder: where pictures, meshes and the checkpoint go.
        subdivisions: of an icosahedron, which make the sphere: 20 * 4 ** subdivisions triangles.
        resolution: pixels along either side of a picture.
        view_count: pictures that are given; half as many others judge the result.
        spp: samples a pixel of the rendered pictures, and of their derivative.
        iterations, finer_iterations: steps of the optimiser with the sphere's triangles, and with four times as many.
        target_spp: samples a pixel of the given pictures.
        rate: how far u moves in the first steps, at most; it falls to a tenth.
        smoothness: lambda of the large steps.
        points: on either surface, between which distances are measured.
        save_every: iterations after which pictures and checkpoint are written.
        restart: begin anew, whatever checkpoint there is.
    """
    folder.mkdir(parents=True, exist_ok=True)
    settings: dict[str, Any] = {
        "subdivisions": subdivisions,
        "resolution": resolution,
        "views": view_count,
        "samples": [spp, target_spp],
        "iterations": [iterations, finer_iterations],
        "rate": rate,
        "smoothness": smoothness,
    }
    checkpoint = Checkpoint(folder / "checkpoint.pt", settings, restart)
    state = checkpoint.load()
    # Light that goes from the object to itself is left out, of the given pictures, too.
    settings_of_all = {"integrator": tr.DirectIllumination(), "outputs": ("rgb", "alpha"), "sampler": "sobol"}
    places = DISTANCE * directions(view_count), DISTANCE * directions(max(1, view_count // 2), turned=1.0)
    views, others = (cameras(place, resolution, FOV) for place in places)

    true = monkey()
    with torch.no_grad():
        truth = tr.Renderer(make_scene(*true), spp=target_spp, **settings_of_all)
        target = truth(sensor=views, seed=1_000_000)
        masks = truth(sensor=others, seed=1_000_001).alpha
    true_points = points_outside(*true, points, torch.cat(places))
    save(strip(target.rgb), folder, "target")

    def judge(vertices: torch.Tensor, faces: torch.Tensor) -> dict[str, float]:
        with torch.no_grad():
            scene = make_scene(vertices, faces)
            alpha = tr.render(scene, sensor=others, spp=target_spp, seed=1_000_002, **settings_of_all).alpha
        found = points_outside(vertices, faces, points, torch.cat(places))
        return {"chamfer": chamfer(found, true_points), "IoU": overlap(alpha, masks)}

    sphere = trimesh.creation.icosphere(subdivisions)
    generator = torch.Generator().manual_seed(0)  # all chance in the loop comes from here
    curves: dict[str, list[float]] = {"loss": []}
    first, finer = 0, False
    if state is None:
        vertices, faces = torch.from_numpy(sphere.vertices.copy()).float(), torch.from_numpy(sphere.faces.copy()).long()
        judged = {"sphere": judge(vertices, faces)}
    else:
        vertices, faces, judged = state["vertices"], state["faces"], state["judged"]
        first, finer, curves = state["iteration"], state["finer"], state["curves"]
    # A neighbour on the finer mesh is half as far away: four times lambda is as smooth.
    smoothing = tr.optim.MeshSmoothing(len(vertices), faces, smoothness * (4 if finer else 1))
    u = torch.nn.Parameter(smoothing.to_differential(vertices) if state is None else state["u"])
    # One length for the steps of all vertices: Adam's own for each entry would make the surface rough again.
    optimiser = tr.optim.UniformAdam([u], lr=rate)
    total = iterations + finer_iterations
    if state is not None:
        checkpoint.restore(state, total, optimiser, generator)
    scene = make_scene(vertices, faces)
    renderer = tr.Renderer(scene, spp=spp, **settings_of_all)

    bar = tr.progress(range(first, total), desc="mesh", initial=first, total=total)
    for iteration in bar:
        if iteration >= iterations and not finer:
            vertices = smoothing.from_differential(u.detach())
            judged["coarse"] = judge(vertices, faces)
            write_ply(folder / "coarse.ply", vertices, faces)
            count = len(faces)
            vertices, faces = subdivide(vertices, faces)
            smoothing = tr.optim.MeshSmoothing(len(vertices), faces, 4 * smoothness)
            u, finer = torch.nn.Parameter(smoothing.to_differential(vertices)), True
            optimiser = tr.optim.UniformAdam([u], lr=rate)
            scene = make_scene(vertices, faces)
            renderer = tr.Renderer(scene, spp=spp, **settings_of_all)
            print(
                f"step {iteration}: {count} triangles become {len(faces)}. The state of the optimiser is dropped: its "
                "moments belong to vertices that are no more"
            )
        part = (iteration - iterations) / finer_iterations if finer else iteration / iterations
        for group in optimiser.param_groups:
            group["lr"] = rate * (0.25 if finer else 1.0) * 0.1**part
        optimiser.zero_grad()
        # Picture and derivative come from independent samples, which makes the gradient of the squared error unbiased.
        out = renderer(sensor=views, seed=generator, params={VERTICES: smoothing.from_differential(u)})
        loss = (out.rgb - target.rgb).square().mean() + (out.alpha - target.alpha).square().mean()
        loss.backward()
        optimiser.step()
        curves["loss"].append(loss.item())
        bar.set_postfix(loss=f"{loss.item():.3g}", triangles=len(faces))

        done = iteration + 1
        if done % save_every == 0 or done == total:
            save(strip(out.rgb.detach()), folder, "progress")
            save_curves(curves, folder / "loss.png", f"Mesh from {view_count} pictures")
            checkpoint.save(
                iteration=done,
                vertices=vertices,
                faces=faces,
                finer=finer,
                u=u.detach(),
                optimiser=optimiser.state_dict(),
                random=generator.get_state(),
                curves=curves,
                judged=judged,
            )
            scene.rebuild()  # as in a process that begins here: an interrupted run finds the same bits

    vertices = smoothing.from_differential(u.detach())
    judged["result"] = judge(vertices, faces)
    write_ply(folder / "result.ply", vertices, faces)
    rows = [turntable(make_scene(*mesh), resolution) for mesh in ((vertices, faces), true)]
    save(torch.cat(rows), folder, "turntable")
    for name, values in judged.items():
        apart, iou = values["chamfer"], values["IoU"]
        print(f"{name:>8}: chamfer distance {100 * apart:.3f} % of the diagonal, IoU of new masks {iou:.4f}")
    return {f"{name} {key}": value for name, values in judged.items() for key, value in values.items()}


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--demo", action="store_true", help="5120 triangles, 64 x 64 pixels, fewer steps")
    parser.add_argument("--iterations", type=at_least_one, help="steps with the sphere's triangles (default 200)")
    parser.add_argument("--views", type=at_least_one, default=16, help="pictures that are given (default 16)")
    parser.add_argument("--resolution", type=at_least_one, help="pixels along a side of a picture (default 128)")
    parser.add_argument("--restart", action="store_true", help="begin anew where a checkpoint is found")
    parser.add_argument("--output", type=Path, default=Path("output/mesh_from_pictures"), help="folder for the results")
    options = parser.parse_args(argv)
    settings: dict[str, Any] = {"view_count": options.views}
    if options.demo:
        settings |= {"subdivisions": 4, "smoothness": 5.0, "resolution": 64, "iterations": 80, "finer_iterations": 20}
    settings |= given(options, "iterations", "resolution")
    with reported(parser, "results", options.output):
        run(options.output, restart=options.restart, **settings)


if __name__ == "__main__":
    main()
