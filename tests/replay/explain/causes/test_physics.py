"""What physics moved, and what let it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from replay.explain import causes as kinds
from replay.explain.causes.case import CausingChange
from tests.replay.explain.causes.explaining import WITH_PR2, line_of, words

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from replay.explain.why import Why


SHELF = """
    shelf = Object("shelf", "environment", "plane.urdf", [0, 0, 1])
    milk = Object("milk", "milk", "milk.stl", [0, 0, 1.11])
    assert world.settle()
    {change}
    world.simulate(1)
    raise PlanFailure(f"{{milk.name}} isn't on the shelf")
"""


@pytest.mark.parametrize(
    ("change", "how"),
    [
        ("shelf.remove()", "removed"),
        ("milk.set_position([0, 0, 1.8])", "command"),
        ("shelf.attach(milk); milk.set_position([0, 0, 2]); shelf.detach(milk)", "detached"),
    ],
)
def test_what_let_an_object_fall_is_the_change_before(
    explained: Callable[..., Why], tmp_path: Path, change: str, how: str
) -> None:
    why = explained(SHELF.format(change=change))
    fell = next(cause for cause in why.causes if isinstance(cause, kinds.Physics))
    assert (fell.body, fell.how) == ("milk", "fell")
    assert fell.fall > 0.5
    assert [each.how for each in fell.lets] == [how]
    assert fell.lets[0].line.number == line_of(tmp_path, change)
    assert {fell.lets[0].step, why.step} <= set(fell.steps)


def test_an_object_that_settled_is_no_cause(explained: Callable[..., Why]) -> None:
    why = explained(SHELF.format(change="pass"))
    assert [cause.kind for cause in why.causes] == ["raised"]


def test_an_obstacle_that_settled_was_put_there_by_its_load(explained: Callable[..., Why], tmp_path: Path) -> None:
    why = explained(
        WITH_PR2
        + """
        pot = Object("pot", "pot", "pot.stl", [2, 0, 0.069])
        world.settle()
        milk.set_position([7, 1, 0.1])
        world.settle()
        perform(type="moving", target=[2, 0, 0])
        """
    )
    (cause,) = why.causes
    assert (cause.kind, cause.body, cause.change.how) == ("in-the-way", "pot", "load")
    assert cause.change.line.number == line_of(tmp_path, "pot = ")


def test_what_let_go_of_an_object_tells_how_it_turned(
    explained: Callable[..., Why], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    why = explained("""
        milk = Object("milk", "milk", "milk.stl", [0, 0, 0.6])
        shelf = Object("shelf", "environment", "plane.urdf", [0, 0, 0.45])
        shelf.attach(milk)
        milk.set_position_and_orientation([0, 0, 0.5], [0.3, 0, 0, 0.95])  # a corner of it is inside of the shelf
        shelf.detach(milk)
        world.simulate(0.3)
        raise PlanFailure("where is the milk")
    """)
    threw = next(cause for cause in why.causes if isinstance(cause, kinds.Physics))
    assert threw.spin > 1
    text = words(tmp_path, capsys)
    assert f"it left its hold at step {threw.lets[0].step} while turning at {threw.spin:.0f} rad/s" in text


def test_what_was_dragged_by_hand_is_told_as_blame_tells_it() -> None:
    assert str(CausingChange(7, "milk", how="hand")) == "milk was dragged by hand in the window"
