"""A renderer that stands where others stand beside torchrender, for tests of the benchmarks."""

from __future__ import annotations

from types import SimpleNamespace

import fresh_python
import pytest

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

    def load_moved(self, direction):
        assert len(direction) == 3 and len(self.parameters) == 1
        return {{"loaded": True}}

    def derivative(self, seed, settings, seeds):
        if settings["guiding"] == "grid":
            raise ValueError("no grid of %d" % seeds)
        seconds = 0.25 if settings["guiding"] == "octree" else 1.0
        return {{"derivative": 1.0 + 0.1 * (seed % 2), "seconds": seconds / settings["sppi"]}}

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


@pytest.fixture
def forks(monkeypatch):
    """Processes that measure something are forks of one that has torch: seconds less for each of them."""
    from bench import fresh

    monkeypatch.setattr(fresh, "subprocess", SimpleNamespace(run=fresh_python.interpreter))
