"""The pages in docs/: every Python example runs, the table of derivatives is that of the declaration, links lead on."""

from __future__ import annotations

import re
import warnings
from pathlib import Path

import pytest

import torchrender as tr
from torchrender.scene import derivatives

DOCS = Path(__file__).resolve().parent.parent / "docs"
PAGES = sorted(DOCS.glob("*.md"))
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def examples(page: Path) -> list[str]:
    """The Python blocks of a page, each moved down so that line numbers of errors are those of the page."""
    text = page.read_text()
    return ["\n" * text.count("\n", 0, m.start(1)) + m.group(1) for m in BLOCK.finditer(text)]


def test_there_are_examples():
    assert {p.name for p in PAGES} >= {"api.md", "derivatives.md"}
    assert len(examples(DOCS / "api.md")) > 20


@pytest.mark.parametrize("page", [p for p in PAGES if examples(p)], ids=lambda p: p.stem)
def test_examples_run(page, tmp_path, monkeypatch, capsys):
    """A page is one program, run where it finds the scenes and may write."""
    (tmp_path / "scenes").symlink_to(DOCS.parent / "scenes")
    monkeypatch.chdir(tmp_path)
    namespace = {"__name__": "__main__"}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", tr.MissingTermWarning)  # the pages say in words what these say
        for block in examples(page):
            exec(compile(block, str(page), "exec"), namespace)


def test_examples_of_the_readme_run(tmp_path, monkeypatch, capsys):
    """At a lower resolution than they have."""
    (tmp_path / "scenes").symlink_to(DOCS.parent / "scenes")
    monkeypatch.chdir(tmp_path)
    load_file = tr.load_file
    monkeypatch.setattr(tr, "load_file", lambda path, **settings: load_file(path, **{"resolution": 24, **settings}))
    load_dict = tr.load_dict

    def small(description):
        scene = load_dict(description)
        for camera in scene.sensors:
            camera.film.width, camera.film.height = 32, 24
        return scene

    monkeypatch.setattr(tr, "load_dict", small)
    namespace: dict = {}
    for block in examples(DOCS.parent / "README.md"):
        exec(compile(block, "README.md", "exec"), namespace)
    # The optimisation finds the red of the wall again (albedo 0.57, 0.04, 0.04), to what 24 x 24 pixels tell.
    assert namespace["red"].detach().tolist() == pytest.approx([0.57, 0.04, 0.04], abs=0.1)
    assert (tmp_path / "ball.png").exists()


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.stem)
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", page.read_text()):
        if not target.startswith(("http://", "https://")):
            assert (page.parent / target).exists(), target


def test_table_of_derivatives_is_up_to_date():
    written = (DOCS / "derivatives.md").read_text()
    assert written == derivatives.page(), "torchrender.scene.derivatives.write_page() writes it"
    assert "| `ball" not in written and "`position`" in written and "no derivative" in written
