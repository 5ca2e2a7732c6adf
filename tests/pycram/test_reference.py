"""Pages of docs/reference are what the code says, and what process modules declare to raise is what they may raise."""

from __future__ import annotations

from pathlib import Path

import pytest

from docs.make_reference import reference
from docs.make_tables import ATTRIBUTES, bundled, containers, objects, sizes, surfaces
from pycram.actions.action import TYPES as ACTIONS
from pycram.bullet_world import BulletWorld, Object
from pycram.foundation.failures import NoPath, Unreachable
from pycram.motions.execution import ContinuousExecution, Execution
from pycram.motions.modules import default_modules
from pycram.motions.motion_types import TYPES as MOTIONS
from tests.pycram.motions.raised import may_raise

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "designators.md"
BUNDLED = PAGE.with_name("bundled.md")
MODULES = default_modules()


def test_the_page_is_what_make_reference_writes() -> None:
    assert PAGE.read_text(encoding="utf-8") == reference()


def test_the_page_of_worlds_and_objects_is_what_make_reference_writes() -> None:
    assert PAGE.with_name("objects.md").read_text(encoding="utf-8") == objects()
    with BulletWorld() as world:
        for each in (world, Object("milk", "milk", "milk.stl")):
            assert all(hasattr(each, name) for name in ATTRIBUTES[type(each)])


def test_the_page_of_bundled_models_has_their_sizes_and_surfaces() -> None:
    page = BUNDLED.read_text(encoding="utf-8")
    assert surfaces() in page
    assert containers() in page
    assert all(f"| {' | '.join((name, *size))} |" in page for name, size in sizes().items())


@pytest.mark.long
def test_the_page_of_bundled_models_is_what_make_reference_writes() -> None:
    assert BUNDLED.read_text(encoding="utf-8") == bundled()


def _sections(title: str) -> dict[str, str]:
    """The sections of a chapter, by their titles."""
    chapter = reference().partition(f"\n## {title}\n")[2].partition("\n## ")[0]
    return {"": chapter.partition("\n### ")[0]} | dict(part.split("\n", 1) for part in chapter.split("\n### ")[1:])


def test_each_action_is_told_with_its_slots() -> None:
    sections = _sections("Actions")
    for action in ACTIONS.values():
        assert action.text.replace("``", "`") in sections[action.type]
        assert all(f"| `{slot.name}`" in sections[action.type] + sections[""] for slot in action.slots)


def test_each_motion_is_told_with_its_slots() -> None:
    sections = _sections("Motions")
    for motion in MOTIONS.values():
        for slot in motion.slots:
            assert f"| `{slot.name}`" in sections[motion.type]
            assert slot.values
            assert slot.required or slot.otherwise or motion.one_of or slot.name == "from"


@pytest.mark.parametrize("cmd", MODULES)
def test_what_modules_may_raise_is_declared_and_nothing_else(cmd: str) -> None:
    module = type(MODULES[cmd])
    at_once = may_raise(module, Execution)
    assert at_once
    assert set(module.failures) == at_once
    assert set(module.failures_in_time) == may_raise(module, ContinuousExecution) - at_once


def test_what_is_caught_and_forgotten_is_not_raised() -> None:
    """Lines are tried one after the other by which a hand is drawn back: that one isn't reached doesn't matter."""
    raised = may_raise(type(MODULES["looking"]), ContinuousExecution)
    assert NoPath in raised
    assert Unreachable not in raised  # of planning.line
