"""Plain Python between the actions of a sequence that is read: refused where it would come before them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from pycram.bullet_world import Object
from pycram.language import finally_, par, pursue, seq, try_in_order
from pycram.language.failures import RunsEarly

if TYPE_CHECKING:
    from pycram.bullet_world import BulletWorld

HIGHER = [0, 0, 2]
RED = [1.0, 0.0, 0.0, 1.0]


@pytest.fixture
def apple(world: BulletWorld) -> Object:
    return Object("apple", "apple", "apple.stl", [0, 0, 1], world=world)


@pytest.mark.parametrize("outer", [par, pursue])
@pytest.mark.parametrize("inner", [seq, try_in_order])
def test_a_change_that_would_come_before_the_actions_above_it_is_refused(apple: Object, outer, inner) -> None:
    def plan() -> None:
        with outer, inner as s:
            s(apple.set_position, HIGHER)
            apple.set_color(RED)

    with pytest.raises(RunsEarly, match=r"set color in the world.*s\(function\)") as caught:
        plan()
    assert caught.value.pending == ("Object.set_position",)
    assert caught.value.file == __file__
    assert apple.color != RED


def test_a_branch_of_an_outer_block_that_would_come_before_them_is_refused(apple: Object) -> None:
    done: list[str] = []

    def plan() -> None:
        with par as p, seq as s:
            s(apple.set_position, HIGHER)
            p(done.append, "early")

    with pytest.raises(RunsEarly, match="directly in the par block"):
        plan()
    assert not done


def test_what_stands_above_an_inner_block_counts_too(apple: Object) -> None:
    def plan() -> None:
        with par, seq as s:
            s(apple.set_position, HIGHER)
            with par:
                apple.set_color(RED)

    with pytest.raises(RunsEarly):
        plan()


def test_what_comes_in_its_turn_is_not_refused(apple: Object) -> None:
    with par as p, seq as s:
        p(apple.get_position)  # nothing of the sequence stands above it
        apple.set_position([0, 0, 3])
        moved = s(apple.set_position, HIGHER)
        moved.result()
        apple.set_color(RED)
        s(apple.set_position, [0, 0, 4])
        s(apple.set_color, [0, 1, 0, 1])
        with finally_(apple.set_position, [0, 0, 5]):
            apple.set_position([0, 0, 6])
    assert apple.get_position() == [0, 0, 5]
    with par, par as q:  # concurrent: nothing is promised of the order
        q(apple.set_position, HIGHER)
        apple.set_color(RED)
    with seq as s:  # this body runs as it stands
        s(apple.set_position, HIGHER)
        apple.set_color([0, 0, 1, 1])
        assert apple.get_position() == HIGHER
