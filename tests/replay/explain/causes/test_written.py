"""A property or a check of the plan failed: the change that wrote the compared value, and what isn't its cause."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

import replay
from replay.explain import causes as kinds, why_report
from tests.replay.explain.causes.explaining import line_of

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from replay.explain.why import Why

PLAN = """
    from pycram import monitored
    milk = Object("milk", "milk", "milk.stl", [0, 0, 0.095])
    cup = Object("cup", "cup", "cup.stl", [2, 0, 0.05])
    def shift(thing, offset):
        x, y, z = thing.get_position()
        thing.set_position([x, y + offset, z])
    {move}
    world.settle()
    {check}
"""


def written(why: Why) -> list[tuple[str, str, int]]:
    found = [each for each in why.causes if isinstance(each, kinds.Written)]
    return [(each.body, each.part, each.change.line.number) for each in found]


@pytest.mark.parametrize(
    ("move", "check", "part"),
    [
        ("shift(milk, 1)", "assert milk.get_position()[1] < 0.5", "y"),
        ("shift(milk, 1)", "x, y, z = milk.get_position()\n    if y > 0.5:\n        raise PlanFailure('too far')", "y"),
        ("with monitored('always milk.y < 0.5'):\n        shift(milk, 1)", "pass", "y"),
        (
            "shift(milk, 1)",
            (
                "ends = {'milk': milk.get_position()}\n    world.exit()\n    for name, (x, y, z) in ends.items():\n"
                "        assert y < 0.5"
            ),
            "y",
        ),
    ],
    ids=["assert", "raise", "property", "assert after the world"],
)
def test_the_compared_coordinate_leads_to_its_last_command(
    explained: Callable[..., Why], tmp_path: Path, move: str, check: str, part: str
) -> None:
    why = explained(PLAN.format(move=move, check=check))
    assert written(why) == [("milk", part, line_of(tmp_path, "thing.set_position"))]
    assert not any(isinstance(each, kinds.Physics) for each in why.causes)  # the fall left y as it was
    assert "no cause was found" not in "\n".join(why_report.lines(why))
    assert why.sources[0].number == line_of(tmp_path, "thing.set_position")


def test_a_property_of_a_joint_leads_to_the_last_command_of_the_joint(
    explained: Callable[..., Why], tmp_path: Path
) -> None:
    move = """with monitored('always panda.panda_joint1 < 0.2'):
        Object("panda", "robot", "panda.urdf", [5, 0, 0]).set_joint_position("panda_joint1", 0.3)"""
    why = explained(PLAN.format(move=move, check="pass"))
    assert written(why) == [("panda", "panda_joint1", line_of(tmp_path, "set_joint_position"))]


@pytest.mark.parametrize(
    "check",
    [
        "assert panda.get_joint_position('panda_joint1') < 0.2",
        (
            "joint = 'panda_joint1'\n    def is_turned(arm):\n        return arm.get_joint_positions()[joint] > 0.2\n"
            "    if is_turned(panda):\n        raise PlanFailure('turned')"
        ),
    ],
    ids=["one joint", "in a function"],
)
def test_a_check_of_a_joint_leads_to_its_last_command_and_moves_it_elsewhere(
    explained: Callable[..., Why], tmp_path: Path, check: str
) -> None:
    move = """panda = Object("panda", "robot", "panda.urdf", [5, 0, 0])
    panda.set_joint_position("panda_joint1", 0.3)"""
    explained(PLAN.format(move=move, check=check))
    with replay.open(tmp_path / "x.mcap") as log:
        why = log.why()
        assert written(why) == [("panda", "panda_joint1", line_of(tmp_path, 'set_joint_position("'))]
        back, *others = [*why.causes[0].trials(why.case)]
    assert back.settings == ("panda.panda_joint1=0.0",)
    assert [each.settings for each in others] == [(f"panda.panda_joint1={end}",) for end in (-2.8973, 2.8973)]


def test_a_fall_that_changes_the_compared_height_is_the_cause(explained: Callable[..., Why]) -> None:
    why = explained(PLAN.format(move="milk.set_position([0, 1, 0.4])", check="assert milk.get_position()[2] > 0.3"))
    assert not written(why)
    assert [each.body for each in why.causes if isinstance(each, kinds.Physics)] == ["milk"]


@pytest.mark.parametrize(
    ("move", "line", "how"),
    [
        ("shift(cup, 1)", "thing.set_position", "command"),
        ("bowl = Object('bowl', 'bowl', 'bowl.stl', [2, 0, 0.2])\n    bowl.attach(cup)\n    bowl.detach(cup)", "detach", "detached"),
    ],
    ids=["moved", "put down"],
)  # fmt: skip
def test_an_object_that_only_others_moved_past_leads_to_their_line(
    explained: Callable[..., Why], tmp_path: Path, move: str, line: str, how: str
) -> None:
    why = explained(PLAN.format(move=move, check="assert milk.get_position()[1] > 0.5"))
    (cause,) = (each for each in why.causes if isinstance(each, kinds.Written))
    assert (cause.change.how, [(each.body, each.how) for each in cause.others]) == ("load", [("cup", how)])
    assert cause.others[0].line.number == line_of(tmp_path, line)


def test_only_coordinates_that_fail_are_compared(explained: Callable[..., Why]) -> None:
    check = "at, by = milk.get_position(), cup.get_position()\n    assert abs(at[0]) < 0.1 and abs(at[1] - by[1]) < 0.1"
    why = explained(
        PLAN.format(move="shift(milk, 1)", check=check + "\n    for thing in (milk, cup):\n        shift(thing, 2)")
    )
    assert [(body, part) for body, part, _ in written(why)] == [("milk", "y"), ("cup", "y")]
    assert not any(each.text.startswith("for thing") for each in why.sources)  # the plan never came there


def test_a_loop_that_never_ran_leads_to_its_line(explained: Callable[..., Why], tmp_path: Path) -> None:
    loop = "from pycram import perform\n    def never_called():\n        perform(parking())\n    for thing in []:\n        perform(looking(object=thing))"
    why = explained(PLAN.format(move=loop, check="assert milk.get_position()[1] > 0.5\n    perform(parking())"))
    sources = [each for each in why_report.lines(why) if "no record shows that it ran" in each]
    assert [each.split()[1] for each in sources] == ["perform(looking(object=thing))"]
    assert line_of(tmp_path, "for thing") in [each.number for each in why.sources]


def test_only_a_command_is_taken_back_and_the_check_itself_is_no_second_cause(
    explained: Callable[..., Why], tmp_path: Path
) -> None:
    explained(PLAN.format(move="shift(milk, 1)", check="assert milk.get_position()[1] < 0.5"))
    with replay.open(tmp_path / "x.mcap") as log:
        why = log.why()
        (cause,) = why.causes
        taken_back = [*cause.trials(why.case)]
    assert (taken_back[0].answers, taken_back[0].step) == (("set_position(object=milk)=skip",), cause.change.step - 1)
    assert [each.words.partition(" (")[0] for each in taken_back] == [
        "milk isn't moved",
        "milk is at [0, 0, 0.095]",
        "milk is put back",
        "milk is at [0, 0.4, 0.097]",
    ]  # the third place is on the other side of the bound
    assert {each.step for each in taken_back[1::2]} == {why.step - 1}  # just before the check
    assert all(each.compares for each in taken_back)  # a former value that fails as well refutes nothing
