"""Sphinx's configuration. `make docs` writes the sources of the site (pages.py) and builds them with it."""

from __future__ import annotations

import importlib.metadata
import re
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))
from inventories import write_inventories

import torchrender

project = "torchrender"
author = "torchrender authors"
release = version = torchrender.__version__
copyright = author

SITE = Path(__file__).parent
BUILD = Path(__file__).resolve().parents[2] / "build" / "docs"

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx.ext.intersphinx",
    "sphinx.ext.mathjax",
    "sphinx_copybutton",
]
html_theme = "furo"
html_title = "torchrender"
html_static_path = [str(SITE / "static")]
html_css_files = ["site.css"]
html_favicon = str(SITE / "static" / "icon.svg")
html_show_sourcelink = False
html_copy_source = False
templates_path: list[str] = []

# Markdown, with the headings' names and the blocks of formulas that GitHub has.
myst_heading_anchors = 4
myst_fence_as_directive = ["math"]
myst_enable_extensions = ["attrs_inline"]
nb_execution_mode = "off"  # notebooks are kept with their outputs
suppress_warnings = ["mystnb.unknown_mime_type"]

# Docstrings: `name` is a link where it names something, and code elsewhere.
default_role = "py:obj"
autodoc_typehints = "signature"
autodoc_member_order = "bysource"
autodoc_default_options = {"exclude-members": "forward, extra_repr"}
napoleon_numpy_docstring = False
napoleon_use_rtype = False
python_maximum_signature_line_length = 100
autosummary_generate = False
nitpicky = True
# Aliases of types are explained in torchrender.typing; T is a type variable; the rest is other packages'.
ALIASES = r".*(Like|Name|Names|Mode|Settings|Images?|Outputs|Dict|T)"
OTHERS = r"((tqdm|trimesh|PIL|types|torchrender\.scene\.context|torchrender\.library|torch\.distributed)\b|[\w.]+\[).*"
nitpick_ignore_regex = [("py:obj", r".*"), ("py:class", ALIASES), ("py:class", OTHERS)]

# The network is not needed: names that signatures have are in two small inventories of our own.
intersphinx_mapping = write_inventories(BUILD / "inventories")

# One file with MathJax and its fonts, from a package, so that pages need nobody's server.
mathjax_path = "tex-svg.js"
html_static_path.append(
    str(next(f for f in importlib.metadata.files("sphinx-mathjax-offline") or () if f.name == "tex-svg.js").locate())
)

# Methods that take or give what only the renderer has are not for users.
OWN = re.compile(r"\b(Context|Field|Layout|Model|NativeScene|Limits|Slot|Sensor)\b")


def skip_own(_app: Any, _what: str, _name: str, member: Any, skip: bool, _options: Any) -> bool | None:
    function = getattr(member, "fget", None) or getattr(member, "__func__", member)
    annotations = getattr(function, "__annotations__", {})
    return True if any(OWN.search(str(a)) for a in annotations.values()) else skip or None


def setup(app: Any) -> None:
    app.connect("autodoc-skip-member", skip_own)
