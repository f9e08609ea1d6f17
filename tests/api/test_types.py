"""The types that editors see are those of the interface; `make lint` checks `typed_program.py` beside this file."""

from __future__ import annotations

import ast
import inspect
from pathlib import Path
from typing import get_args

import pytest

import torchrender as tr
from torchrender import image, integrators, interruption, outputs, render_arguments, render_types, typing
from torchrender.scene import ranges
from torchrender.scene.scene import VARIANTS


def test_settings_are_the_arguments_of_render():
    arguments = inspect.signature(tr.render).parameters
    assert {*render_types.RenderSettings.__annotations__} == {*arguments} - {"scene", "outputs"}


def test_outputs_have_all_names():
    tree = ast.parse(Path(render_types.__file__).read_text())
    (written,) = (node for node in ast.walk(tree) if isinstance(node, ast.ClassDef) and node.name == "Outputs")
    names = {node.target.id for node in written.body if isinstance(node, ast.AnnAssign)}
    assert names - {"_fields"} == {*outputs.OUTPUTS, outputs.FEATURES}


def test_renderers_take_what_render_takes():
    wanted = {*render_types.RenderSettings.__annotations__} - {"params"}
    assert {*render_types.RendererSettings.__annotations__} == wanted
    for settings in ({"spp": 4, "on_interrupt": "raise"}, {"sampler": "sobol"}):
        tr.Renderer(tr.load_dict({"type": "scene"}), **settings)
    with pytest.raises(TypeError, match="Renderer: unknown argument 'params'"):
        tr.Renderer(tr.load_dict({"type": "scene"}), params={})


def test_words_are_those_that_are_accepted():
    """What editors offer, and what is refused otherwise."""
    words = {
        render_types.OutputName: (*outputs.OUTPUTS, outputs.FEATURES),
        render_types.IntegratorName: integrators.TYPES,
        render_types.LayoutName: render_arguments.LAYOUTS,
        render_types.RangeMode: ranges.MODES,
        render_types.SamplerName: tr.SAMPLERS,
        render_types.InterruptMode: interruption.MODES,
        typing.VariantName: VARIANTS,
        image.TonemapName: image.TONEMAPS,
    }
    for literal, accepted in words.items():
        assert sorted(get_args(literal)) == sorted(accepted), literal
    for mode in get_args(typing.Unsupported):
        tr.load_dict({"type": "scene"}, unsupported=mode)


def test_loaders_have_types_at_run_time():
    for function in (tr.load_dict, tr.load_file):
        assert get_args(inspect.signature(function, eval_str=True).parameters["variant"].annotation) == VARIANTS


def test_types_are_shipped():
    assert (Path(tr.__file__).parent / "py.typed").exists()
