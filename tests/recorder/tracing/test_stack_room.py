"""Before a record that must be complete, the stack is checked for room."""

from __future__ import annotations

import sys
import traceback
from typing import TYPE_CHECKING

import pytest
from greenlet import greenlet

from recorder.tracing import context
from recorder.tracing.context import require_stack_room

if TYPE_CHECKING:
    from collections.abc import Callable


def calls(number: int, function: Callable[[], object]) -> object:
    return calls(number - 1, function) if number else function()


def succeeds_at(depth: int) -> bool:
    try:
        calls(depth, lambda: require_stack_room(100))
    except RecursionError:
        return False
    return True


def goes_on_at(depth: int) -> bool:
    """Whether there really are 100 frames."""
    try:
        calls(depth, lambda: calls(100, int))
    except RecursionError:
        return False
    return True


def test_what_is_granted_is_there() -> None:
    limit = sys.getrecursionlimit()
    depths = range(0, limit, 10)
    granted = [succeeds_at(depth) for depth in depths]
    assert {True, False} == set(granted)
    for depth, room in zip(depths, granted, strict=True):
        assert not room or goes_on_at(depth)
    refused = depths[granted.index(False)]
    assert not goes_on_at(refused + 10)  # nor is it refused without need


def test_a_greenlet_has_no_more_room_than_where_it_begins(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(context, "_outside", 0)

    def begin() -> object:
        context.greenlets_begin()
        return greenlet(lambda: require_stack_room(100)).switch()

    calls(20, begin)
    with pytest.raises(RecursionError):
        calls(sys.getrecursionlimit() - 120, begin)


def test_the_frames_that_were_tried_are_not_in_the_traceback() -> None:
    with pytest.raises(RecursionError) as raised:
        calls(sys.getrecursionlimit() - 120, lambda: require_stack_room(100))
    assert traceback.extract_tb(raised.value.__traceback__)[-1].name == "require_stack_room"
