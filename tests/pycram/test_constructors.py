"""Typed constructors: those of PyCRAM are written from the slots; a user's action gets one from its function."""

from __future__ import annotations

import ast
import inspect
import re
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, get_args

import pytest

import pycram
from docs.make_constructors import MODULES
from pycram import action_designators, motion_designators
from pycram.actions import action
from pycram.actions.action import TYPES as ACTIONS
from pycram.bullet_world import BulletWorld, Object
from pycram.designator import (
    ActionDesignator,
    DesignatorError,
    LocationDesignator,
    MotionDesignator,
    ObjectDesignator,
)
from pycram.motions.motion_types import TYPES as MOTIONS
from pycram.motions.slots import slot_name
from pycram.reasoning.grasping.grasps import GRASPS, GraspSide

if TYPE_CHECKING:
    from collections.abc import Iterator

REPO = Path(__file__).parents[2]


@pytest.mark.parametrize("module", MODULES)
def test_make_reference_writes_the_constructors(module: str) -> None:
    assert (REPO / "pycram" / module).read_text(encoding="utf-8") == MODULES[module]()


def test_literal_types_are_the_values_that_checks_accept() -> None:
    assert get_args(GraspSide) == tuple(GRASPS)


def test_every_motion_and_action_has_a_constructor_with_its_slots() -> None:
    for module, types in ((motion_designators, MOTIONS), (action_designators, ACTIONS)):
        for kind in types.values():
            parameters = inspect.signature(getattr(module, kind.type.replace("-", "_"))).parameters
            if kind.type == "move-arm-joints":
                assert list(parameters) == ["arms"]
                continue
            assert {slot_name(name) for name in parameters} == {slot.name for slot in kind.slots}
            for slot in kind.slots:
                assert (
                    parameters[slot.name.replace("-", "_").replace("from", "from_")].default is None
                ) != slot.required


@pytest.mark.parametrize("kind", [ObjectDesignator, LocationDesignator])
def test_type_checkers_know_the_slots_of_a_designator(kind: type[ObjectDesignator | LocationDesignator]) -> None:
    tree = ast.parse(inspect.getsource(inspect.getmodule(kind)))
    (declared,) = (node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef) and node.name == "__init__")
    assert [slot_name(each.arg) for each in declared.args.kwonlyargs] == [slot.name for slot in kind.takes.slots]


def test_slots_that_are_left_out_stay_open() -> None:
    pick_up = motion_designators.pick_up(object="a cup", from_="right")
    assert isinstance(pick_up, MotionDesignator)
    assert pick_up.description == [("type", "pick-up"), ("object", "a cup"), ("from", "right")]
    carry = action_designators.transporting(object="milk", target="island", close=False)
    assert isinstance(carry, ActionDesignator)
    assert carry.description == [("type", "transporting"), ("object", "milk"), ("target", "island"), ("close", False)]
    both = motion_designators.move_arm_joints(arms={"left": "park", "right": [0.0] * 7})
    assert both.description == [("type", "move-arm-joints"), ("left-arm", "park"), ("right-arm", [0.0] * 7)]


@pytest.fixture
def milk() -> Iterator[Object]:
    with BulletWorld() as world:
        Object("kitchen", "environment", "kitchen.urdf")
        body = Object("milk", "milk", "milk.stl", [1.3, 1, 0.95])
        world.robot = Object("pr2", "robot", "pr2.urdf", [0.65, 0.7, 0])
        yield body


def test_one_perform_takes_motions_and_actions(milk: Object) -> None:
    pycram.perform(motion_designators.move_arm_joints(arms={"left": "park", "right": "park"}))
    pycram.perform(motion_designators.pick_up(object=milk, arm="left"))
    assert [each.body for each in BulletWorld.robot.carried] == [milk]
    assert pycram.perform(action_designators.transporting(object=milk, target="island")) is milk
    assert milk.get_position()[0] < -0.6


def test_an_action_of_ones_own_has_its_constructor(milk: Object) -> None:
    @action("looking-twice")
    def look_twice(object: Object, times: int = 2, aside: str | None = None) -> list[object]:  # noqa: A002
        """Look at an object."""
        return [object.name, times, aside]

    try:
        assert inspect.signature(look_twice.designator).parameters.keys() == {"object", "times", "aside"}
        designator = look_twice.designator(milk, times=3)
        assert designator.description == [("type", "looking-twice"), ("object", milk), ("times", 3)]
        assert pycram.perform(designator) == ["milk", 3, None]
        with pytest.raises(DesignatorError, match="object"):
            pycram.perform(look_twice.designator(times=3))
    finally:
        del ACTIONS["looking-twice"]


# --- what a type checker says ----------------------------------------------------------------------------------------

WRONG = """\
from pycram import perform
from pycram.actions import action
from pycram.action_designators import transprting
from pycram.action_designators import transporting
from pycram.bullet_world import BulletWorld, Object
from pycram.motion_designators import looking, move_arm_joints, pick_up

from pycram.designator import LocationDesignator, ObjectDesignator

milk = Object("milk", "milk", "milk.stl")
LocationDesignator(onn=milk)
LocationDesignator(on=3)
LocationDesignator(on="island", side="top")
ObjectDesignator(kind="milk")
perform(pick_up(object=milk, grasp="bottom"))
perform(transporting(object=milk, target=milk, grasp="bottom"))
BulletWorld.robot = "pr2"
BulletWorld.robot.descripton
perform(pick_up(objekt=milk))
perform(pick_up(object="milk"))
perform(pick_up(object=milk, arm=1))
perform(pick_up(arm="left"))
perform(move_arm_joints(arms={"left": 0.5}))
perform(transporting(object=milk, target=3))
perform(milk)
perform(looking())
perform(looking(target=[1, 0, 1], object=milk))


@action("tidying-up")
def tidy(object: Object, box: str = "box") -> Object:
    return object


tidy.designator(object=milk, box=3)
tidy.designator()
perform(tidy.designator(milk))
perform(pick_up(object=milk, arm="left", grasp="front"))
perform(looking(target=milk))
perform(transporting(object="milk", target=[-0.8, 1, 0.93]))
perform(transporting(object=milk, target=milk, place=LocationDesignator(reachable_for=milk, arm=None)))
LocationDesignator([("on", milk)], side=("left", milk), near=[0, 1], for_=ObjectDesignator(type="milk"))
LocationDesignator(on=[milk, "island"], in_=None)
BulletWorld.robot = milk
BulletWorld.current_bullet_world.robot.description.arms

from pycram.designator import MotionDesignator
from pycram.process_module import ProcessModule, Resources, register


class Waving(ProcessModule):
    def _execute(self, designator: MotionDesignator) -> int:
        return len(designator.reference())

    def resources(self, designator: MotionDesignator) -> Resources:
        return Resources(moves={"left-arm"})


register("pr2", "simulated", {"waving": Waving()})
"""


def plans() -> Iterator[tuple[str, str]]:
    """Yield name and source of the plans of each page: its blocks, which continue one another."""
    for page in (REPO / "README.md", *(REPO / "docs").rglob("*.md")):
        blocks = re.findall(r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
        if any("pycram" in block for block in blocks):
            yield f"{page.stem.lower()}_page.py", "\n".join(blocks)


@pytest.mark.costly
@pytest.mark.slow
def test_mypy_accepts_the_demos_and_pages_and_finds_what_is_wrong(tmp_path: Path) -> None:
    sources = {**dict(plans()), "wrong.py": WRONG}
    for name, source in sources.items():
        (tmp_path / name).write_text(source, encoding="utf-8")
    (tmp_path / "mypy.ini").write_text("[mypy]\n", encoding="utf-8")
    demos = [str(file) for file in sorted((REPO / "demos").glob("*.py"))]
    options = ["--config-file", "mypy.ini", "--cache-dir", "cache", "--disable-error-code", "name-defined"]  # excerpts
    command = [sys.executable, "-m", "mypy", *options, *sources, *demos]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    errors = [line for line in ended.stdout.splitlines() if ": error: " in line]
    assert not [line for line in errors if not line.startswith("wrong.py:")], ended.stdout
    found = {int(line.split(":")[1]): line for line in errors}
    lines = WRONG.splitlines()
    assert sorted(found) == [3, *range(11, 28), 35, 36], ended.stdout
    assert 'maybe "transporting"' in found[3]
    assert 'did you mean "object"?' in found[lines.index("perform(pick_up(objekt=milk))") + 1]
