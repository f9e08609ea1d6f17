"""Marks the tests that exercise the native renderer, which are run again at every instruction set (``-m core``)."""

from __future__ import annotations

import pytest

# Modules whose subject is Python alone, or which already start processes at several instruction sets.
PYTHON_ONLY = {
    "test_backends",
    "test_bench",
    "test_bench_parts",
    "test_bsdf_references",
    "test_cameras",
    "test_bsdfs",  # one direction at a time, whatever the instruction set
    "test_caustics_mesh",
    "test_colmap",
    "test_constraints",
    "test_docs",
    "test_endurance",  # takes long, and its subject is what is kept between calls
    "test_errors_render",
    "test_errors_scene",
    "test_fuzz_files",
    "test_geometry_files",
    "test_gltf",
    "test_heightfield_surface",
    "test_instances",
    "test_io",
    "test_layer_autograd",
    "test_layer_display",
    "test_layer_module",
    "test_layer_processes",
    "test_lens_rays",
    "test_make_caustics",
    "test_make_media",
    "test_media",  # takes long; images of media at every instruction set: test_media_invariants
    "test_media_integrator",
    "test_media_scenes",
    "test_migration_pages",
    "test_motion_derivatives",  # takes long; other derivatives are tested at every instruction set
    "test_names",
    "test_numeric_facts",
    "test_optim",
    "test_optim_scene",
    "test_optim_smoothing",
    "test_parameters",
    "test_particle_analytic",  # closed forms of what the images of test_particle_images have in all instruction sets
    "test_particle_errors",
    "test_particle_oracle",
    "test_pixels",
    "test_project",
    "test_queries",
    "test_reported",
    "test_sampler_numbers",
    "test_save",
    "test_scene_editing",
    "test_scene_loading",
    "test_scene_refused_edits",
    "test_serialized",
    "test_spectra",
    "test_substitutes",
    "test_testing",
    "test_tutorial_capture",
    "test_torch_bsdf",
    "test_tutorial_caustics",
    "test_tutorial_media",
    "test_tutorials",
    "test_wavefront",
    "test_xml",
}


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if item.path.stem not in PYTHON_ONLY:
            item.add_marker(pytest.mark.core)


FAKE_SERVER = """
import sys
sys.path.insert(0, {folder!r})
from serving import serve


class Server:
    version, import_seconds = "0.0", 0.01

    def __init__(self, threads):
        self.spp = 0

    def load(self, spp, **arguments):
        self.parameters, self.arguments = arguments["parameters"], arguments["arguments"]
        return {{"loaded": True}}

    def forward(self, seed):
        if seed == 666:
            raise ValueError("no seed 666")
        return {{"forward": 0.5}}

    def step(self, seed):
        return {{"forward": 0.5, "backward": 1.5}}

    def image(self, seed, spp, file):
        import numpy as np

        np.save(file, np.full((16, 16, 3), 0.3 + 0.01 * (seed % 2), np.float32))
        return {{"seconds": 0.5}}

    def iteration(self, seed, views, spp, spp_grad, passes):
        return {{"forward": 0.5, "backward": 1.5, "bad image": 3, "bad gradient": 0}}

    def load_caustics(self, folder, front):
        import json
        import pathlib

        scene = json.loads((pathlib.Path(folder) / "scene.json").read_text())
        assert scene["type"] == "scene" and scene["lens"] is None and len(front) == 4
        return {{"loaded": True}}

    def caustics(self, seed, spp, spp_grad):
        return {{"forward": 0.5, "backward": 1.5, "loss": 2.0, "bad image": 1, "bad gradient": 0}}

    def loss_gradient(self, seed, values, file, **arguments):
        import numpy as np

        np.save(file, np.full_like(np.load(values), np.nan))
        return {{"seconds": 0.6}}

    def gradient(self, seed, spp, file=None):
        if file:  # of the volume that the scene has
            import numpy as np

            x, y, z, channels = np.fromfile(self.arguments["density"], "<i4", 4, offset=8)
            np.savez(file, np.full((z, y, x, channels), 1e-3 * (1 + seed % 2)))
        return {{"sums": [1.0 + 0.1 * (seed % 2)] * len(self.parameters), "seconds": 2.0}}


serve(Server)
"""


@pytest.fixture
def fake_peer(tmp_path, monkeypatch):
    """A renderer that takes the place of Mitsuba: it always needs 0.5 s for an image and 1.5 s for a gradient,
    which has no meaning."""
    import dataclasses

    from bench import peers

    server = tmp_path / "fake_server.py"
    server.write_text(FAKE_SERVER.format(folder=str(peers.FOLDER)))
    monkeypatch.setitem(peers.KNOWN, "mitsuba", dataclasses.replace(peers.KNOWN["mitsuba"], server=str(server)))
