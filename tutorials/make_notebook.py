"""Make notebooks from quick_start.py and colab.py and run them, so that their pictures are inside.

    make notebook                            # installs Jupyter's kernel into .venv first
    python tutorials/make_notebook.py        # where it is installed

The script is the source: cells begin with `# %%`, and cells of text with `# %% [markdown]`, their lines being comments.
So is the line `# %pip install`, a command in the notebook, which is not run here.
"""

from __future__ import annotations

import base64
import io
import tempfile
from pathlib import Path
from typing import Any

SCRIPTS = [Path(__file__).resolve().parent / f"{name}.py" for name in ("quick_start", "colab")]
TEXT = "# %% [markdown]"
INSTALL = "%pip "
# A page of pictures with Monte Carlo noise is several megabytes in PNG.
JPEG_QUALITY = 85


def cells(source: str) -> list[tuple[str, str]]:
    """The cells of a script: pairs of kind (``"markdown"`` or ``"code"``) and content, without empty ends."""
    found: list[tuple[str, list[str]]] = []
    for line in source.splitlines():
        if line.startswith("# %%"):
            found.append(("markdown" if line.strip() == TEXT else "code", []))
        elif found:
            kind, lines = found[-1]
            is_comment = kind == "markdown" or line.startswith(f"# {INSTALL}")
            lines.append(line.removeprefix("#").removeprefix(" ") if is_comment else line)
        elif line.strip():
            raise ValueError(f"a script for a notebook begins with a cell (# %%), got {line!r}")
    return [(kind, "\n".join(lines).strip("\n")) for kind, lines in found]


def jpeg(png: str) -> str:
    """A picture as base64 text, PNG in and JPEG out."""
    from PIL import Image

    out = io.BytesIO()
    Image.open(io.BytesIO(base64.b64decode(png))).convert("RGB").save(out, "JPEG", quality=JPEG_QUALITY)
    return base64.b64encode(out.getvalue()).decode()


def tidy(output: dict[str, Any]) -> dict[str, Any] | None:
    """An output as it is kept: pictures as JPEG; progress bars and other words on standard error are left out."""
    if output["output_type"] == "stream" and output["name"] == "stderr":
        return None
    data = output.get("data", {})
    if "application/vnd.jupyter.widget-view+json" in data:
        return None
    if "image/png" in data:
        output["data"] = {"image/jpeg": jpeg(data["image/png"])}
    return output


def make(script: Path) -> Path:
    """Make the notebook of a script and run it; returns its path."""
    import nbformat
    from nbclient import NotebookClient

    notebook = nbformat.v4.new_notebook()
    for number, (kind, text) in enumerate(cells(script.read_text())):
        make_cell = nbformat.v4.new_markdown_cell if kind == "markdown" else nbformat.v4.new_code_cell
        notebook.cells.append(make_cell(text, id=f"cell-{number}"))  # ids by number, so that a new run changes little
    notebook.metadata["kernelspec"] = {"name": "python3", "display_name": "Python 3", "language": "python"}
    installs = {cell.id: cell.source for cell in notebook.cells if cell.source.startswith(INSTALL)}
    for cell in notebook.cells:
        cell.source = "" if cell.id in installs else cell.source
    with tempfile.TemporaryDirectory() as folder:  # what the script writes is not kept
        NotebookClient(notebook, timeout=600, record_timing=False, resources={"metadata": {"path": folder}}).execute()
    for cell in notebook.cells:
        cell.source = installs.get(cell.id, cell.source)
        cell.metadata.clear()
        if cell.cell_type == "code":
            cell.outputs = [o for o in map(tidy, cell.outputs) if o is not None]
    # Which patch version of Python ran it is of no interest.
    notebook.metadata.pop("language_info", None)
    nbformat.validate(notebook)
    path = script.with_suffix(".ipynb")
    nbformat.write(notebook, path)
    return path


if __name__ == "__main__":
    for made in map(make, SCRIPTS):
        print(f"{made.name}: {made.stat().st_size / 1000:.0f} kB")
