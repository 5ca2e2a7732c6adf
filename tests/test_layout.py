"""Rooms form no circles: whoever reads one needs to know only those below it (docs/architecture.md).

Imports for type checking and inside of functions count as well: a reader follows them like any other.
"""

from __future__ import annotations

import ast
import sys
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

import recorder
import replay
from pycram import perform
from pycram.bullet_world import BulletWorld, Object
from pycram.motion_designators import moving

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import FrameType

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


#: Files of the stages in the drawing of docs/architecture.md.
STAGES = {
    "designator": "pycram/motions/designator.py",
    "process module": "pycram/motions/process_module.py",
    "object": "pycram/world/object.py",
    "transaction": "pycram/world/transaction.py",
    "journal": "recorder/tracing/journal.py",
    "sinks": "recorder/mcap_sink.py",
    "file": "replay/file/",
    "records": "recorder/records/",
    "fold": "recorder/records/fold.py",
    "state": "replay/state/",
    "history": "replay/history/",
    "explain": "replay/explain/",
    "restore": "replay/restore/",
}


def drawn(line: int) -> list[str]:
    """The stages of a line of the drawing, in the order in which data passes them."""
    drawing = (REPO / "docs" / "architecture.md").read_text(encoding="utf-8").split("```")[1].strip().splitlines()
    forwards = "─►" in drawing[line]
    names = [each.strip(" ─┘") for each in drawing[line].split("─►" if forwards else "◄─")]
    return [name for name in (names if forwards else names[::-1]) if name in STAGES]


def passed(act: Callable[[], object], stages: list[str]) -> list[str]:
    """The stages whose functions a call enters, in the order of their first functions."""
    seen: dict[str, None] = {}

    def follow(frame: FrameType, event: str, _: object) -> None:
        if event == "call":
            file = frame.f_code.co_filename
            seen.update(dict.fromkeys(name for name in stages if STAGES[name] in file and name not in seen))

    sys.setprofile(follow)
    try:
        act()
    finally:
        sys.setprofile(None)
    return list(seen)


def test_a_change_takes_the_way_that_the_architecture_draws(tmp_path: Path) -> None:
    with recorder.record(tmp_path / "run.mcap"), BulletWorld() as world:
        world.robot = Object("pr2", "robot", "pr2.urdf")
        motion = moving(target=[1, 0, 0])
        way = drawn(0)
        assert sorted(passed(lambda: perform(motion), way)) == sorted(way)
        assert passed(lambda: world.robot.set_position([2, 0, 0]), way) == way[2:]
    with replay.open(tmp_path / "run.mcap") as log:
        back = [name for name in drawn(2) if name != "explain"]
        assert set(passed(lambda: log.state_at("last"), back)) >= {"file", "records", "fold", "state"}
        assert "explain" in passed(log.why, drawn(2))
