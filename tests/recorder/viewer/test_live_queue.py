"""The queue for a viewer: in order, bounded, and important records are dropped last."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

import pytest
from hypothesis import given, strategies as st

from recorder.records import (
    AttachBody,
    Event,
    Fluent,
    Keyframe,
    LoadBody,
    MoveBody,
    MoveJoints,
    Mutation,
    Query,
    RemoveBody,
    Simulate,
    Task,
)
from recorder.records.values import AssetFile
from recorder.viewer.live import LiveQueue, is_transient

if TYPE_CHECKING:
    from recorder.viewer.live import Item

ALL = 1_000_000


def number(item: Item) -> int:
    assert isinstance(item, tuple)
    return int(item[0])


@given(
    puts=st.lists(st.tuples(st.booleans(), st.integers(0, 3000)), max_size=80),
    max_items=st.integers(1, 30),
    max_bytes=st.integers(4000, 20_000),
)
def test_the_queue_keeps_its_bounds_and_order_and_drops_transient_items_first(
    puts: list[tuple[bool, int]], max_items: int, max_bytes: int
) -> None:
    queue = LiveQueue(max_items, max_bytes)
    for count, (transient, size) in enumerate(puts):
        before = len(queue)
        queue.put((str(count), bytes(size)), transient=transient)
        assert len(queue) <= max_items
        assert queue.size <= max_bytes
        assert 0 < len(queue) <= before + 1, "the newest stays"
    queue.close()
    left = [number(item) for item in queue.take(ALL, ALL)]
    assert queue.size == len(queue) == 0
    assert left == sorted(left), "in order"
    kept_transient = [count for count in left if puts[count][0]]
    dropped = set(range(len(puts))) - set(left)
    assert queue.dropped == len(dropped)
    if kept_transient[:-1]:  # transient ones are still there: what matters was not dropped since the first of them came
        assert all(puts[count][0] or count < kept_transient[0] for count in dropped)
        assert all(count < kept_transient[0] for count in dropped if puts[count][0]), "the oldest goes first"


def test_take_returns_the_oldest_items_within_its_bounds() -> None:
    queue = LiveQueue()
    for count in range(10):
        queue.put((str(count), bytes(1000)), transient=count % 2 == 0)
    assert [number(item) for item in queue.take(3, ALL)] == [0, 1, 2]
    assert [number(item) for item in queue.take(ALL, 2000)] == [3, 4]
    assert [number(item) for item in queue.take(ALL, ALL)] == [5, 6, 7, 8, 9]


def test_files_count_with_their_bytes() -> None:
    queue = LiveQueue(max_bytes=10_000)
    queue.put(AssetFile("robot.urdf", bytes(9_000)), transient=False)
    queue.put(("1", bytes(1_500)), transient=False)
    assert [number(item) for item in queue.take(ALL, ALL)] == [1]


def test_take_waits_for_items_and_for_the_end() -> None:
    queue = LiveQueue()
    taken: list[list[Item]] = []
    thread = threading.Thread(target=lambda: taken.extend(iter(lambda: queue.take(ALL, ALL), [])))
    thread.start()
    queue.put(("1", b""), transient=True)
    queue.close()
    thread.join(10)
    assert not thread.is_alive()
    assert taken == [[("1", b"")]]
    queue.put(("2", b""), transient=True)
    assert queue.take(ALL, ALL) == []


@pytest.mark.parametrize(
    ("record", "transient"),
    [
        (Mutation(move_body=MoveBody()), True),
        (Mutation(move_joints=MoveJoints()), True),
        (Mutation(simulate=Simulate()), True),
        (Event(), True),
        (Fluent(), True),
        (Mutation(load_body=LoadBody()), False),
        (Mutation(remove_body=RemoveBody()), False),
        (Mutation(attach_body=AttachBody()), False),
        (Task(), False),
        (Query(), False),
        (Keyframe(), False),
    ],
)
def test_records_that_later_ones_make_up_for_are_transient(record, transient: bool) -> None:
    assert is_transient(record) is transient
