"""Print the size of the source: lines, files, short private functions with one use, broad excepts, repeated class names.

Run as ``make size``, or ``python tests/source_size.py --list`` for the places. Counted are the tracked Python files of the three packages, without generated code.
"""

from __future__ import annotations

import ast
import subprocess
import sys
from collections import Counter, defaultdict
from pathlib import Path

PACKAGES = ("pycram", "recorder", "replay")
GENERATED = ("log_pb2.py", "/action_designators.py", "/motion_designators.py")
SHORT = 6  # lines of a function's definition
BROAD = {"Exception", "BaseException"}


def source_files() -> list[Path]:
    """Return the files that are counted."""
    listed = subprocess.run(["git", "ls-files", *PACKAGES], capture_output=True, text=True, check=True).stdout.split()
    return [
        Path(name) for name in listed if name.endswith(".py") and not name.endswith(GENERATED) and Path(name).exists()
    ]


def short_functions_used_once(trees: dict[Path, ast.Module]) -> list[str]:
    """Return private functions and methods of at most six lines that their module mentions once."""
    found = []
    for file, tree in trees.items():
        uses = Counter(node.id for node in ast.walk(tree) if isinstance(node, ast.Name))
        uses += Counter(node.attr for node in ast.walk(tree) if isinstance(node, ast.Attribute))
        found += [
            f"{file}:{node.lineno} {node.name}"
            for node in ast.walk(tree)
            if isinstance(node, ast.FunctionDef)
            and node.name.startswith("_")
            and not node.name.endswith("__")
            and not node.decorator_list
            and (node.end_lineno or node.lineno) - node.lineno < SHORT
            and uses[node.name] == 1
        ]
    return found


def broad_excepts(trees: dict[Path, ast.Module]) -> list[str]:
    """Return handlers of all exceptions."""
    return [
        f"{file}:{node.lineno}"
        for file, tree in trees.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.ExceptHandler)
        and (node.type is None or any(isinstance(each, ast.Name) and each.id in BROAD for each in ast.walk(node.type)))
    ]


def repeated_classes(trees: dict[Path, ast.Module]) -> list[str]:
    """Return public names that more than one top-level class has."""
    places: dict[str, list[str]] = defaultdict(list)
    for file, tree in trees.items():
        for node in tree.body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(str(file))
    return [f"{name}: {', '.join(files)}" for name, files in sorted(places.items()) if len(files) > 1]


def main() -> None:
    """Print the figures."""
    files = source_files()
    texts = {file: file.read_text(encoding="utf-8") for file in files}
    trees = {file: ast.parse(text) for file, text in texts.items()}
    print(f"lines {sum(text.count(chr(10)) for text in texts.values())}")
    print(f"files {len(files)}")
    rows = {
        "short private functions with one use": short_functions_used_once(trees),
        "broad excepts": broad_excepts(trees),
        "public class names that repeat": repeated_classes(trees),
    }
    for name, places in rows.items():
        print(f"{name} {len(places)}")
        if "--list" in sys.argv:
            print("".join(f"  {place}\n" for place in places), end="")


if __name__ == "__main__":
    main()
