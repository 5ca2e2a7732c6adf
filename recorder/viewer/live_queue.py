"""Queue of items for a viewer, bounded in number and bytes.

When it is full, the oldest transient items are dropped first, those that later records make up for: motions of bodies
and simulations (the next keyframe has the poses), events, fluents and output. Models, tasks and the contents of worlds
are dropped only when nothing else is left.
"""

from __future__ import annotations

import threading
from collections import OrderedDict, deque
from typing import TYPE_CHECKING, Final, TypeAlias

from recorder.records import Event, Fluent, Mutation, Output
from recorder.records.asset import AssetFile

if TYPE_CHECKING:
    from recorder.records import Record

Item: TypeAlias = tuple[str, bytes] | AssetFile
"""A record's topic and payload, or a file."""

_TRANSIENT: Final = frozenset({"move_body", "move_joints", "simulate", "set_realtime"})
_OVERHEAD: Final = 200  # bytes of an item in Python, about


class LiveQueue:
    """A queue that never makes its writer wait.

    Attributes:
        size: bytes of all items.
        dropped: number of records that were dropped.
    """

    def __init__(self, max_items: int = 20_000, max_bytes: int = 128 << 20) -> None:
        self._max_items = max_items
        self._max_bytes = max_bytes
        self._items: OrderedDict[int, Item] = OrderedDict()
        self._transient: deque[int] = deque()  # keys of the items that are dropped first, oldest first
        self._count = 0
        self._changed = threading.Condition()
        self._closed = False
        self.size = 0
        self.dropped = 0

    def __len__(self) -> int:
        return len(self._items)

    def put(self, item: Item, *, transient: bool) -> None:
        """Appends an item, and drops others if there are too many; does nothing after the end."""
        with self._changed:
            if self._closed:
                return
            if transient:
                self._transient.append(self._count)
            self._items[self._count] = item
            self._count += 1
            self.size += _cost(item)
            while self._items and (len(self._items) > self._max_items or self.size > self._max_bytes):
                lost = self._pop(self._transient[0] if self._transient else next(iter(self._items)))
                self.dropped += isinstance(lost, tuple)
            self._changed.notify()

    def take(self, max_items: int, max_bytes: int) -> list[Item]:
        """Waits for items, and takes the oldest until they have so many bytes; none when it has ended and is empty."""
        taken: list[Item] = []
        with self._changed:
            self._changed.wait_for(lambda: self._items or self._closed)
            size = 0
            while self._items and len(taken) < max_items and size < max_bytes:
                taken.append(self._pop(next(iter(self._items))))
                size += _cost(taken[-1])
        return taken

    def take_rest(self) -> list[Item]:
        """Ends it, and removes all items at once."""
        with self._changed:
            taken = list(self._items.values())
            self._items.clear()
            self._transient.clear()
            self.size = 0
            self.close()
        return taken

    def close(self) -> None:
        """Ends it; items can still be taken."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def _pop(self, key: int) -> Item:
        item = self._items.pop(key)
        if self._transient and self._transient[0] == key:
            self._transient.popleft()
        self.size -= _cost(item)
        return item


def is_transient(record: Record) -> bool:
    """Whether later records make up for this one."""
    if isinstance(record, Mutation):
        return record.WhichOneof("command") in _TRANSIENT
    return isinstance(record, Event | Fluent | Output)


def _cost(item: Item) -> int:
    return _OVERHEAD + len(item.content if isinstance(item, AssetFile) else item[1])
