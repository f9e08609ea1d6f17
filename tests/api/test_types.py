"""The types that editors see are those of the interface; `make lint` checks `typed_program.py` beside this file."""

from __future__ import annotations

import ast
import inspect
from pathlib import Path

import torchrender as tr
from torchrender import outputs, render_types


def test_settings_are_the_arguments_of_render():
    arguments = inspect.signature(tr.render).parameters
    assert {*render_types.RenderSettings.__annotations__} == {*arguments} - {"scene", "outputs"}


def test_outputs_have_all_names():
    tree = ast.parse(Path(render_types.__file__).read_text())
    (written,) = (node for node in ast.walk(tree) if isinstance(node, ast.ClassDef) and node.name == "Outputs")
    names = {node.target.id for node in written.body if isinstance(node, ast.AnnAssign)}
    assert names - {"_fields"} == {*outputs.OUTPUTS, outputs.FEATURES}


def test_types_are_shipped():
    assert (Path(tr.__file__).parent / "py.typed").exists()
