"""Make quick_start.ipynb from quick_start.py and run it, so that its pictures are inside.

    make notebook                            # installs Jupyter's kernel into .venv first
    python tutorials/make_notebook.py        # where it is installed

The script is the source: cells begin with `# %%`, and cells of text with `# %% [markdown]`, their lines being comments.
"""

from __future__ import annotations

import base64
import io
import tempfile
from pathlib import Path
from typing import Any

SCRIPT = Path(__file__).resolve().parent / "quick_start.py"
NOTEBOOK = SCRIPT.with_suffix(".ipynb")
TEXT = "# %% [markdown]"
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
            lines.append(line.removeprefix("#").removeprefix(" ") if kind == "markdown" else line)
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


def main() -> None:
    import nbformat
    from nbclient import NotebookClient

    notebook = nbformat.v4.new_notebook()
    for number, (kind, text) in enumerate(cells(SCRIPT.read_text())):
        make = nbformat.v4.new_markdown_cell if kind == "markdown" else nbformat.v4.new_code_cell
        notebook.cells.append(make(text, id=f"cell-{number}"))  # ids by number, so that a new run changes little
    notebook.metadata["kernelspec"] = {"name": "python3", "display_name": "Python 3", "language": "python"}
    with tempfile.TemporaryDirectory() as folder:  # what the script writes is not kept
        NotebookClient(notebook, timeout=600, record_timing=False, resources={"metadata": {"path": folder}}).execute()
    for cell in notebook.cells:
        cell.metadata.clear()
        if cell.cell_type == "code":
            cell.outputs = [o for o in map(tidy, cell.outputs) if o is not None]
    # Which patch version of Python ran it is of no interest.
    notebook.metadata.pop("language_info", None)
    nbformat.validate(notebook)
    nbformat.write(notebook, NOTEBOOK)
    print(f"{NOTEBOOK.name}: {NOTEBOOK.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
