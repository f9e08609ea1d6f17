"""Modules of the tests, imported by another torchrender than the one that they test.

What renders their scenes may be older: names that it does not have are stood in for by objects that do nothing, so that
the scenes of a module can be had although the tests beside them cannot run. Modules are found by their names, in
whichever folder below the tests' they are.
"""

from __future__ import annotations

import ast
import importlib.abc
import importlib.machinery
import importlib.util
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any


class Missing:
    """Stands in for what cannot be imported: calls, attributes and entries are such objects, too; there are none."""

    def __init__(self, *_: Any, **__: Any) -> None:
        pass

    def __getattr__(self, name: str) -> Missing:
        if name.startswith("__"):
            raise AttributeError(name)
        return self

    def __call__(self, *_: Any, **__: Any) -> Missing:
        return self

    def __getitem__(self, _: Any) -> Missing:
        return self

    def __iter__(self) -> Iterator[Any]:
        return iter(())

    def __bool__(self) -> bool:
        return False


def tolerant(source: str | bytes, path: str) -> CodeType:
    """A module's code in which every import at its top level may fail; what it would bind is then `Missing`."""
    tree = ast.parse(source, path)
    body: list[ast.stmt] = []
    for node in tree.body:
        if isinstance(node, (ast.Import, ast.ImportFrom)) and getattr(node, "module", "") != "__future__":
            body += [guarded(node, alias) for alias in node.names]
        else:
            body.append(node)
    tree.body = body
    return compile(tree, path, "exec")


def guarded(node: ast.Import | ast.ImportFrom, alias: ast.alias) -> ast.stmt:
    """The import of one of a statement's names, which may fail."""
    name = alias.asname or alias.name.partition(".")[0]
    text = f"try: pass\nexcept ImportError:\n from bench.from_tests import Missing\n {name} = Missing()"
    (statement,) = ast.parse(text).body
    one = ast.Import([alias])
    if isinstance(node, ast.ImportFrom):
        one = ast.ImportFrom(node.module, [alias], node.level)
    statement.body = [one]
    return ast.fix_missing_locations(ast.copy_location(statement, node))


class _Loader(importlib.machinery.SourceFileLoader):
    def get_code(self, fullname: str) -> CodeType:
        """Always from the source: what Python keeps compiled is not this code."""
        return tolerant(Path(self.path).read_bytes(), self.path)


class Finder(importlib.abc.MetaPathFinder):
    """Finds the modules and packages below a folder of tests, in any folder that is not a package itself."""

    def __init__(self, folder: Path) -> None:
        self.places: dict[str, Path] = {}
        for file in sorted(folder.rglob("*.py")):
            if (file.parent / "__init__.py").exists():
                if file.name != "__init__.py" or (file.parent.parent / "__init__.py").exists():
                    continue
                file = file.parent
            self.places.setdefault(file.stem, file)

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        *parents, name = fullname.split(".")
        place = self.places.get(name)
        if parents:
            if parents[0] not in self.places:
                return None
            place = next((p for p in (Path(path[0]) / name, Path(path[0]) / f"{name}.py") if p.exists()), None)
        if place is None:
            return None
        if place.is_dir():
            file, inside = place / "__init__.py", [str(place)]
        else:
            file, inside = place, None
        loader = _Loader(fullname, str(file))
        return importlib.util.spec_from_file_location(fullname, file, loader=loader, submodule_search_locations=inside)


def use(folder: Path) -> Finder:
    """Let modules below a folder be imported, before any others of their names."""
    finder = Finder(folder)
    sys.meta_path.insert(0, finder)
    return finder
