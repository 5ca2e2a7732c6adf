"""What waits for a viewer, bounded in number and bytes.

When it is full, the oldest of what later records make up for goes first: where bodies were moved to and what was
simulated (the next keyframe says where they are), events and fluents. Models, tasks and what is in a world at all are
dropped only when nothing else is left.
"""

from __future__ import annotations

import threading
from collections import OrderedDict, deque
from typing import TYPE_CHECKING, Final, TypeAlias

from recorder.records import Event, Fluent, Mutation
from recorder.records.asset import AssetFile

if TYPE_CHECKING:
    from recorder.records import Record

Item: TypeAlias = tuple[str, bytes] | AssetFile
"""A record's topic and payload, or a file."""

_PASSING: Final = frozenset({"move_body", "move_joints", "simulate", "set_realtime"})
_OVERHEAD: Final = 200  # bytes that Python needs for an item, about


class Backlog:
    """A queue that never makes its writer wait.

    Args:
        most_items: bound on the number of items.
        most_bytes: bound on their bytes.

    Attributes:
        dropped: how many records there was no room for.
    """

    def __init__(self, most_items: int = 20_000, most_bytes: int = 128 << 20) -> None:
        self._most_items = most_items
        self._most_bytes = most_bytes
        self._items: OrderedDict[int, Item] = OrderedDict()
        self._passing: deque[int] = deque()  # keys of the items that go first, oldest first
        self._bytes = 0
        self._count = 0
        self._changed = threading.Condition()
        self._closed = False
        self.dropped = 0

    def __len__(self) -> int:
        return len(self._items)

    @property
    def size(self) -> int:
        """How many bytes wait."""
        return self._bytes

    def put(self, item: Item, *, passing: bool) -> None:
        """Takes an item, and drops others if there are too many; nothing is taken any more after the end.

        Args:
            item: the item.
            passing: whether later ones make up for it.
        """
        with self._changed:
            if self._closed:
                return
            if passing:
                self._passing.append(self._count)
            self._items[self._count] = item
            self._count += 1
            self._bytes += _cost(item)
            while self._items and (len(self._items) > self._most_items or self._bytes > self._most_bytes):
                lost = self._pop(self._passing[0] if self._passing else next(iter(self._items)))
                self.dropped += isinstance(lost, tuple)
            self._changed.notify()

    def take(self, most_items: int, most_bytes: int) -> list[Item]:
        """Waits for items.

        Args:
            most_items: at most so many.
            most_bytes: no more when they are so many bytes.

        Returns:
            The oldest, in order; none when the backlog has ended and all have been taken.
        """
        taken: list[Item] = []
        with self._changed:
            self._changed.wait_for(lambda: self._items or self._closed)
            size = 0
            while self._items and len(taken) < most_items and size < most_bytes:
                taken.append(self._pop(next(iter(self._items))))
                size += _cost(taken[-1])
        return taken

    def rest(self) -> list[Item]:
        """Takes everything at once and ends it."""
        with self._changed:
            taken = list(self._items.values())
            self.clear()
        return taken

    def close(self) -> None:
        """Ends it: what is there can still be taken."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def clear(self) -> None:
        """Ends it and drops everything."""
        with self._changed:
            self._items.clear()
            self._passing.clear()
            self._bytes = 0
            self.close()

    def _pop(self, key: int) -> Item:
        item = self._items.pop(key)
        if self._passing and self._passing[0] == key:
            self._passing.popleft()
        self._bytes -= _cost(item)
        return item


def is_passing(record: Record) -> bool:
    """Whether later records make up for one.

    Args:
        record: any.
    """
    if isinstance(record, Mutation):
        return record.WhichOneof("command") in _PASSING
    return isinstance(record, Event | Fluent)


def _cost(item: Item) -> int:
    return _OVERHEAD + len(item.content if isinstance(item, AssetFile) else item[1])
