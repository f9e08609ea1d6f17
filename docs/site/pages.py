"""The sources of the site: the pages of `docs/`, those made of the README, tutorials and the interface, in one folder.

    python docs/site/pages.py build/docs/source

Pages are written for GitHub, and read well there. Three things are different on the site: formulas (GitHub's
``$`x`$`` is MyST's role ``math``), links that leave `docs/`, and the contents. Nothing here needs Sphinx.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import re
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from contents import CHAPTERS, FROM_README, FURTHER, HOME_ENDS, PARTS
from reference import write_reference
from run_tutorials import PICTURES, PROGRAMS, RECORDS, ROOT, docstring, programs

DOCS = ROOT / "docs"
# Files of the repository that are pages of the site, by page.
ELSEWHERE = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "tutorials/quick_start.py": "tutorials/quick_start.ipynb",
    "tutorials/quick_start.ipynb": "tutorials/quick_start.ipynb",
    "LICENSE": "license.md",
}
CODE = re.compile(r"(^```.*?^```$)", re.MULTILINE | re.DOTALL)
SECTION = re.compile(r"^## +(.+?) *$", re.MULTILINE)


def target_on_site(target: str, page: Path) -> str:
    """Where a link of a page, a path in the repository, leads on the site, as a path in the site's sources."""
    path = Path(os.path.normpath(page.parent / target)).as_posix()
    if path in ELSEWHERE:
        return ELSEWHERE[path]
    if Path(path).parent.name == "tutorials" and Path(path).stem in programs():
        return f"tutorials/{Path(path).stem}.md"
    if path.startswith("docs/") and (ROOT / path).exists():
        return path.removeprefix("docs/")
    raise ValueError(f"{page}: there is no page on the site for {target}; docs/site/pages.py has a list, ELSEWHERE")


def for_site(text: str, page: Path, name: str) -> str:
    """A page as MyST reads it: its text, its path in the repository, and its name on the site."""
    here = Path(name).parent

    def link(match: re.Match[str]) -> str:
        target, anchor = match[1], match[2] or ""
        if not target or "://" in target or target.startswith("mailto:"):
            return match[0]
        to = target_on_site(target, page)
        if to == "index.md" and anchor.removeprefix("#") in FROM_README:  # a section of the README that is a page
            to, anchor = f"{anchor.removeprefix('#')}.md", ""
        return f"]({os.path.relpath(to, here)}{anchor})"

    def program(match: re.Match[str]) -> str:
        if match[1] not in programs():
            return match[0]
        return f"[{match[0]}]({os.path.relpath(f'tutorials/{match[1]}.md', here)})"

    parts = CODE.split(text)
    for i in range(0, len(parts), 2):
        prose = re.sub(r"\]\(([^)#\s]*)(#[^)\s]*)?\)", link, parts[i])
        prose = re.sub(r"(?<!\[)`tutorials/(\w+)\.py`(?!\])", program, prose)
        parts[i] = re.sub(r"\$(`[^`]+`)\$", r"{math}\1", prose)
    return "".join(parts)


def sections(text: str) -> dict[str, str]:
    """The sections of a page by their headings of the second level, without the headings; what precedes them is ''."""
    pieces = SECTION.split(text)
    return {"": pieces[0]} | {heading: body.strip("\n") for heading, body in zip(pieces[1::2], pieces[2::2])}


def contents(name: str, pages: list[str], caption: str = "") -> str:
    options = ":hidden:\n:maxdepth: 2\n" + (f":caption: {caption}\n" if caption else "")
    entries = "\n".join(os.path.relpath(page, Path(name).parent) for page in pages)
    return f"\n```{{toctree}}\n{options}\n{entries}\n```\n"


def from_readme() -> dict[str, str]:
    """The home page and those that are sections of the README."""
    readme = ROOT / "README.md"
    text = readme.read_text()
    found = sections(text)
    wanted = [HOME_ENDS, "Gallery", *(heading for _, headings in FROM_README.values() for heading in headings)]
    missing = [heading for heading in wanted if heading not in found]
    if missing:
        raise ValueError(f"README.md has no section {missing[0]!r}, which docs/site/contents.py names")
    home = text[: text.index(f"\n## {HOME_ENDS}\n") + 1]
    pages = {"index": home}
    for name, (title, headings) in FROM_README.items():
        single = len(headings) == 1
        body = "\n\n".join(found[h] if single else f"## {h}\n\n{found[h]}" for h in headings)
        pages[name] = f"# {title}\n\n{body}\n"
    pages["gallery"] = f"# Gallery\n\n{found['Gallery']}\n"
    return {name: for_site(page, Path("README.md"), f"{name}.md") for name, page in pages.items()}


def options_of(path: Path) -> list[tuple[str, str]]:
    """The options of a program, and what `--help` says of them: the calls of `add_argument` in its text."""
    found = []
    for call in ast.walk(ast.parse(path.read_text())):
        if isinstance(call, ast.Call) and isinstance(call.func, ast.Attribute) and call.func.attr == "add_argument":
            words = [k.value.value for k in call.keywords if k.arg == "help" and isinstance(k.value, ast.Constant)]
            name = call.args[0]
            if words and isinstance(name, ast.Constant):
                found.append((str(name.value), str(words[0])))
    return found


def records() -> dict[str, dict[str, str]]:
    return json.loads(RECORDS.read_text()) if RECORDS.exists() else {}


def duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 100 else f"{seconds / 60:.0f} minutes"


def tutorial_title(name: str) -> str:
    return docstring(PROGRAMS / f"{name}.py").splitlines()[0].rstrip(".")


def picture(name: str) -> str:
    return f"../images/tutorials/{name}.jpg" if (PICTURES / f"{name}.jpg").exists() else ""


def tutorial_page(name: str) -> str:
    """A tutorial: what it says of itself, its picture, what it printed and how long it took, options, its text."""
    path = PROGRAMS / f"{name}.py"
    title, _, words = docstring(path).partition("\n")
    page = [f"# {title.rstrip('.')}", words.strip("\n")]
    if picture(name):
        page.append(f"![Pictures that the tutorial {name} made]({picture(name)})")
    record = records().get(name)
    if record:
        seconds = duration(float(record["seconds"]))
        told = f"`{record['command']}` takes {seconds} of a core ({record['date']}), half of it on two, and prints:"
        page.append(f"## A run\n\n{told}\n\n```text\n{record['printed'].strip()}\n```")
    rows = [f"| `{option}` | {words.replace('%%', '%').replace('|', '/')} |" for option, words in options_of(path)]
    if rows:
        page.append("## Options\n\n| option | |\n|---|---|\n" + "\n".join(rows))
    page.append(f"## The program\n\n`tutorials/{name}.py`:\n\n````python\n{path.read_text().strip()}\n````")
    return "\n\n".join(page) + "\n"


def tutorial_index() -> str:
    rows = []
    for name in programs():
        image = f"![]({picture(name)}){{width=320px}}" if picture(name) else ""
        record = records().get(name)
        seconds = duration(float(record["seconds"])) if record else ""
        rows.append(f"| [{tutorial_title(name)}]({name}.md) | {seconds} | {image} |")
    return (
        "# Tutorials\n\nEach is a program that recovers something from pictures, prints what it found beside the truth,"
        " and writes its pictures into `output/`. [What is unknown in each, and what is shown on the way]"
        "(../quick_start.md#the-other-tutorials), is a table of the quick start. Times are of one core, for the "
        "command on the page of the tutorial, most of which are smaller runs (`--demo`); two cores take half.\n\n"
        "| tutorial | time | pictures |\n|---|---|---|\n" + "\n".join(rows) + "\n"
    )


def pages() -> dict[str, Callable[[], str]]:
    """Every page by its name on the site, and what makes its text; those of the reference and notebooks apart."""
    made: dict[str, Callable[[], str]] = {}
    for path in sorted(DOCS.rglob("*.md")):
        name = path.relative_to(DOCS).with_suffix("").as_posix()
        made[name] = lambda path=path, name=name: for_site(path.read_text(), path.relative_to(ROOT), f"{name}.md")
    for name, text in from_readme().items():
        made[name] = lambda text=text: text
    for source, name in (("CONTRIBUTING.md", "contributing"), ("CHANGELOG.md", "changelog")):
        made[name] = lambda s=source, n=name: for_site((ROOT / s).read_text(), Path(s), f"{n}.md")
    made["license"] = lambda: f"---\norphan: true\n---\n\n# Licence\n\n```text\n{(ROOT / 'LICENSE').read_text()}\n```\n"
    for name in programs():
        made[f"tutorials/{name}"] = lambda name=name: tutorial_page(name)
    made["tutorials/index"] = tutorial_index
    return made


def stage(folder: Path) -> list[str]:
    """Write all sources of the site into `folder`, which is made anew; returns the names of the pages."""
    if folder.exists():
        shutil.rmtree(folder)
    made = pages()
    references = write_reference(folder / "reference")
    generated = {f"reference/{name}" for name in references} | {"tutorials/quick_start"}
    listed = {page for part in PARTS.values() for page in part} | {p for below in CHAPTERS.values() for p in below}
    below = dict(CHAPTERS) | {"tutorials/index": [f"tutorials/{name}" for name in programs()]}
    known = {*made, *generated}
    under = {page for chapter in below.values() for page in chapter} | generated
    rest = sorted(known - listed - under - {"index", "license"})
    menu = {caption: [page for page in part if page in known] for caption, part in PARTS.items()}
    if rest:
        menu[FURTHER] = rest
    for name, make in made.items():
        text = make()
        if name == "index":
            text += "".join(contents(name, part, caption) for caption, part in menu.items())
        elif name in below:
            text += contents(name, below[name])
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / f"{name}.md").write_text(text)
    shutil.copytree(DOCS / "images", folder / "images")
    shutil.copyfile(PROGRAMS / "quick_start.ipynb", folder / "tutorials" / "quick_start.ipynb")
    return sorted(known)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="what is written; what was there is removed")
    print(f"{len(stage(parser.parse_args().folder))} pages")
