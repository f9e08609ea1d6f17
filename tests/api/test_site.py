"""The sources of the site of the documentation: complete, in its contents, and what the verification page is run by."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from bench import verification
from docs.site import contents, pages, reference, run_tutorials

OPTIONAL = {"installation", "many_machines"}  # pages that a checkout may lack


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("site") / "source"
    pages.stage(folder)
    return folder


def sources(site: Path) -> set[str]:
    found = [p for p in site.rglob("*") if p.suffix in (".md", ".rst", ".ipynb")]
    return {p.relative_to(site).with_suffix("").as_posix() for p in found}


def test_every_page_is_in_the_contents(site):
    listed = set()
    for path in [*site.rglob("*.md"), *site.rglob("*.rst")]:
        for block in re.findall(r"(?:```\{toctree\}|\.\. toctree::)\n(.*?)(?:```|\Z)", path.read_text(), re.DOTALL):
            entries = [line.strip() for line in block.splitlines() if line.strip() and not line.strip().startswith(":")]
            base = path.parent.relative_to(site)
            listed |= {Path(*(base / entry).parts).as_posix() for entry in entries}
    listed = {str(Path(site / name).resolve().relative_to(site.resolve())) for name in listed}
    assert sources(site) - listed == {"index", "license"}
    assert listed <= sources(site)


def test_the_contents_name_pages_that_exist(site):
    named = {page for part in contents.PARTS.values() for page in part}
    assert named - sources(site) <= OPTIONAL


def test_every_tutorial_has_a_page_with_its_program(site):
    found = {p.stem for p in (pages.ROOT / "tutorials").glob("*.py") if '__name__ == "__main__"' in p.read_text()}
    assert {name for name in found if not name.startswith("make_")} == set(run_tutorials.programs())
    for name in run_tutorials.programs():
        text = (site / "tutorials" / f"{name}.md").read_text()
        assert (pages.ROOT / "tutorials" / f"{name}.py").read_text().strip() in text
        assert "--output" in text and f"]({name}.md)" in (site / "tutorials" / "index.md").read_text()


def test_runs_of_tutorials_are_kept_with_their_pictures():
    records = json.loads(run_tutorials.RECORDS.read_text())
    assert len(records) >= 5 and set(records) <= set(run_tutorials.programs())
    for name, record in records.items():
        assert record["command"].startswith(f"python tutorials/{name}.py") and float(record["seconds"]) > 0
        shown = run_tutorials.RUNS.get(name, run_tutorials.Run()).rows
        assert record["printed"].strip() and (run_tutorials.PICTURES / f"{name}.jpg").exists() == bool(shown)
    assert set(run_tutorials.RUNS) <= set(run_tutorials.programs())


def test_rows_of_pictures_are_of_equal_width(tmp_path):
    image = pytest.importorskip("PIL.Image")
    for name, size, colour in (("a", (100, 50), "red"), ("b", (200, 200), "blue"), ("wide", (600, 100), "green")):
        image.new("RGB", size, colour).save(tmp_path / f"{name}.png")
    sheet = run_tutorials.joined(tmp_path, ("a b", "wide"))
    assert sheet.width == run_tutorials.WIDTH  # the lower row is wider than that where it is 256 pixels high
    upper = (sheet.width - 8) / 3
    assert sheet.height == pytest.approx(upper + sheet.width / 6, abs=1)
    assert sheet.getpixel((round(2 * upper) - 4, 4)) == (255, 0, 0)
    assert sheet.getpixel((round(2 * upper) + 12, round(upper) - 4)) == (0, 0, 255)
    assert sheet.getpixel((sheet.width - 2, sheet.height - 4)) == (0, 128, 0)

    sheet = run_tutorials.joined(tmp_path, ("wide", "b"))  # which is narrower than the row above
    y = round(sheet.width / 6) + 9
    assert sheet.getpixel((0, y)) == (255, 255, 255) and sheet.getpixel((sheet.width // 2, y)) == (0, 0, 255)


def test_every_public_name_is_in_the_reference_once():
    described = [name for names in reference.described().values() for name in names]
    assert len(described) == len(set(described))
    modules = {name for name in reference.public_names() if name in reference.MODULES}
    shown = {name.removeprefix("torchrender.").split(".")[-1] for name in described}
    assert set(reference.public_names()) - modules <= shown
    assert modules <= set(reference.described())


def test_formulas_and_links_are_those_of_the_site(site):
    theory = (site / "theory.md").read_text()
    assert "$`" not in theory and "{math}`x_0" in theory and "```math" in theory
    assert "](spectral.md)" in (site / "features.md").read_text()
    assert "](docs/" not in (site / "index.md").read_text()
    with pytest.raises(ValueError, match=r"no page on the site for \.\./setup\.py"):
        pages.for_site("[x](../setup.py)", Path("docs/x.md"), "x.md")


def test_programs_for_mitsuba_have_their_output():
    found = verification.programs()
    assert len(found) == 7
    for program, output in found:
        compile(program, "verification.md", "exec")
        assert program.count("print(") and output.strip()


@pytest.mark.parametrize(
    ("printed", "alike"),
    [("a 1.01 b", True), ("a 1.05 b", False), ("b 1.0 a", False), ("a 1.0 b 2", False), ("a 1e0 b", True)],
)
def test_outputs_are_compared_but_for_noise(printed, alike):
    assert verification.alike(printed, "a 1.0 b") is alike
