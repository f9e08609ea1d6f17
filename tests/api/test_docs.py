"""The pages in docs/: every Python example runs, the table of derivatives is that of the declaration, links lead on."""

from __future__ import annotations

import re
import warnings
from pathlib import Path

import pytest

import torchrender as tr
from torchrender.scene import derivatives, registry

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
CHAPTERS = sorted((DOCS / "api").glob("*.md"))
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def name_of(page: Path) -> str:
    return str(page.relative_to(ROOT))


def examples(page: Path) -> list[str]:
    """The Python blocks of a page, each moved down so that line numbers of errors are those of the page.

    Those that import Mitsuba are run by `python -m bench verification`.
    """
    text = page.read_text()
    found = [m for m in BLOCK.finditer(text) if "\nimport mitsuba " not in "\n" + m.group(1)]
    return ["\n" * text.count("\n", 0, m.start(1)) + m.group(1) for m in found]


def test_there_are_examples():
    assert {p.name for p in PAGES} >= {"api.md", "derivatives.md", "theory.md", "glossary.md"}
    assert sum(len(examples(page)) for page in CHAPTERS) > 40


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_pages_are_short_enough_to_find_things_in(page):
    assert page.read_text().count("\n") <= 450


@pytest.mark.parametrize("page", [p for p in PAGES if examples(p)], ids=name_of)
def test_examples_run(page, tmp_path, monkeypatch, capsys):
    """A page is one program, run where it finds the scenes and may write; chapters go on from their index."""
    (tmp_path / "scenes").symlink_to(DOCS.parent / "scenes")
    monkeypatch.chdir(tmp_path)
    namespace = {"__name__": "__main__"}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", tr.MissingTermWarning)  # the pages themselves say what these say
        for part in (DOCS / "api.md", page) if page in CHAPTERS else (page,):
            for block in examples(part):
                exec(compile(block, str(part), "exec"), namespace)


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


def test_the_readme_misses_nothing_that_is_there():
    """No kind of shape, material or light that dicts have stands in the list of what is missing."""
    missing = (ROOT / "README.md").read_text().partition("## What is not there yet")[2].partition("\n## ")[0]
    assert "Second derivatives" in missing
    kinds = {kind for kind, category in registry.scene_types().items() if category in ("shape", "bsdf", "emitter")}
    words = {word.lower().removesuffix("s") for word in re.findall(r"[A-Za-z]{5,}", re.sub(r"`[^`]*`", "", missing))}
    words.discard("instance")  # there are copies; what is missing are true ones
    assert not {word for word in words if any(kind.endswith(word) for kind in kinds)}


def prose(page: Path) -> str:
    """A page without its code, in which brackets mean other things."""
    return re.sub(r"^```.*?^```$|`[^`\n]*`", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)


def anchors(page: Path) -> set[str]:
    """The names that a page's headings can be linked by, as GitHub makes them."""
    text = re.sub(r"^```.*?^```$", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
    found: dict[str, int] = {}
    for heading in re.findall(r"^#{1,6} +(.+?) *$", text, re.MULTILINE):
        name = re.sub(r"[^\w\- ]", "", re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).lower()).replace(" ", "-")
        found[name] = found.get(name, -1) + 1
    return {f"{name}-{i}" if i else name for name, count in found.items() for i in range(count + 1)}


LINKING = [*(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")), *PAGES]


@pytest.mark.parametrize("page", LINKING, ids=name_of)
def test_links_lead_somewhere(page):
    """To files of the checkout, and to headings that are there."""
    for target, anchor in re.findall(r"\]\(([^)#\s]*)#?([^)\s]*)\)", prose(page)):
        if target.startswith(("http://", "https://")):
            continue
        to = (page.parent / target).resolve() if target else page
        assert to.exists() and to.is_relative_to(ROOT), target
        if anchor:
            assert to.suffix == ".md" and anchor in anchors(to), f"{target}#{anchor}"


def test_every_page_is_linked():
    """From the README, the index of the interface or another page."""
    linked = set()
    for page in LINKING:
        linked |= {(page.parent / target).resolve() for target in re.findall(r"\]\(([^)#\s]+)", prose(page))}
    assert not [name_of(page) for page in PAGES if page not in linked]


@pytest.mark.parametrize("page", [DOCS / "theory.md", *sorted((DOCS / "theory").glob("*.md"))], ids=name_of)
def test_theory_names_files_that_exist(page):
    named = re.findall(r"^\*Files:\*(.*?)\n\n", page.read_text() + "\n\n", re.MULTILINE | re.DOTALL)
    files = [name for paragraph in named for name in re.findall(r"`([\w./]+)`", paragraph)]
    assert files
    assert not [name for name in files if not (ROOT / "csrc" / name).exists() and not (ROOT / name).exists()]


def test_glossary_has_names_of_the_code():
    rows = [row.split("|") for row in (DOCS / "glossary.md").read_text().splitlines()]
    cells = re.sub(r"\$`[^`]*`\$", "", "".join(row[2] for row in rows if len(row) == 6))  # without formulas
    names = {name.removeprefix("tr.") for name in re.findall(r"`([^`]+)`", cells)}
    sources = [p for folder in ("csrc", "torchrender") for p in (ROOT / folder).rglob("*")]
    code = "\n".join(p.read_text() for p in sources if p.suffix in (".h", ".cpp", ".py"))

    def known(name: str) -> bool:
        if "/" in name:
            return (ROOT / name).exists() or (ROOT / "csrc" / name).exists()
        return re.search(r"\b" + r"\w+".join(re.escape(part) for part in name.removesuffix("()").split("...")), code)

    assert len(names) > 80
    assert not {name for name in names if not known(name)}


def test_table_of_derivatives_is_up_to_date():
    written = (DOCS / "derivatives.md").read_text()
    assert written == derivatives.page(), "torchrender.scene.derivatives.write_page() writes it"
    assert "| `ball" not in written and "`position`" in written and "no derivative" in written
