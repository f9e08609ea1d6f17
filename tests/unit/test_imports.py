"""Who imports whom in the package, imports inside of functions included; those for type checkers alone do not count."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[2] / "torchrender"
FILES = {
    ".".join((p.parent if p.name == "__init__.py" else p.with_suffix("")).relative_to(PACKAGE.parent).parts): p
    for p in sorted(PACKAGE.rglob("*.py"))
}


def imports(node: ast.AST) -> Iterator[ast.Import | ast.ImportFrom]:
    for child in ast.iter_child_nodes(node):
        if isinstance(child, (ast.Import, ast.ImportFrom)):
            yield child
        elif isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
            for other in child.orelse:
                yield from imports(other)
        else:
            yield from imports(child)


def imported(module: str) -> set[str]:
    """The modules of the package that one of them imports."""
    folder = module if FILES[module].name == "__init__.py" else module.rpartition(".")[0]
    found: set[str] = set()
    for statement in imports(ast.parse(FILES[module].read_text())):
        if isinstance(statement, ast.Import):
            found.update(name.name for name in statement.names)
            continue
        above = folder.split(".")[: len(folder.split(".")) - statement.level + 1] if statement.level else []
        base = ".".join([*above, *([statement.module] if statement.module else [])])
        for name in statement.names:
            found.add(f"{base}.{name.name}" if f"{base}.{name.name}" in FILES else base)
    return found & FILES.keys()


GRAPH = {module: imported(module) for module in FILES}


def reachable(start: str) -> set[str]:
    found: set[str] = set()
    waiting = [start]
    while waiting:
        new = GRAPH[waiting.pop()] - found
        found |= new
        waiting += new
    return found


def test_modules_are_found():
    assert len(FILES) > 100
    assert "torchrender.scene.scene" in GRAPH["torchrender.render"]
    assert "torchrender.loaders.geometry" in GRAPH["torchrender.loaders.mesh_files"]  # inside of a function
    assert "torchrender.scene.plugin" not in GRAPH["torchrender.scene.registry"]  # for type checkers alone


def test_nothing_imports_itself_by_way_of_others():
    below = {module: reachable(module) for module in GRAPH}
    circles = {tuple(sorted(m for m in below[module] if module in below[m])) for module in GRAPH}
    assert circles == {()}


OUTER = "autograd features footprints loaders optim outputs queries render render_call surface wavefront".split()


@pytest.mark.parametrize(
    ("ring", "outer"),
    [("scene", OUTER), ("io", ["scene", *OUTER]), ("wavefront", ["features", "loaders", "outputs", "render"])],
)
def test_imports_point_inward(ring, outer):
    inside = [module for module in GRAPH if module.split(".")[1:2] == [ring]]
    wrong = {(m, name) for m in inside for name in GRAPH[m] if {*name.split(".")[1:2]} & {*outer}}
    assert inside and not wrong
