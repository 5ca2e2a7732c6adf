"""Rooms form no circles: whoever reads one needs to know only those below it (docs/architecture.md).

Imports for type checking and inside of functions count as well: a reader follows them like any other.
"""

from __future__ import annotations

import ast
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

REPO = Path(__file__).parent.parent
PACKAGES = ("recorder", "pycram", "replay")


def modules() -> dict[str, Path]:
    found = {}
    for package in PACKAGES:
        for file in sorted((REPO / package).rglob("*.py")):
            parts = file.relative_to(REPO).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = file
    return found


def imports(file: Path, known: dict[str, Path]) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module:
            assert not node.level, f"{file}: imports are absolute"
            found |= {name if (name := f"{node.module}.{each.name}") in known else node.module for each in node.names}
        elif isinstance(node, ast.Import):
            found |= {each.name for each in node.names}
    return found & known.keys()


def room(module: str, known: dict[str, Path]) -> str:
    """The folder that a module is in; a module that is in none of them is a room of its own."""
    package, _, _ = module.rpartition(".")
    return module if known[module].name == "__init__.py" or package in PACKAGES else package


@pytest.mark.slow
def test_no_circle_between_rooms() -> None:
    known = modules()
    graph: dict[str, set[str]] = {}
    for module, file in known.items():
        here = room(module, known)
        there = {room(name, known) for name in imports(file, known)} - {here}
        graph.setdefault(here, set()).update(there)
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as circle:
        raise AssertionError(" imports ".join(reversed(circle.args[1]))) from None
