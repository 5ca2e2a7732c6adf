"""Lanes of tasks over time: each lane has successive tasks of the same depth; parallel tasks have separate lanes."""

from __future__ import annotations

from typing import TypeAlias

from recorder.records import Task

Lane: TypeAlias = tuple[int, int]  # depth of its tasks from 1, and number among the lanes of this depth from 0


class Lanes:
    """The lanes of the running tasks."""

    def __init__(self) -> None:
        self._running: dict[int, Lane] = {}
        self._taken: dict[int, set[int]] = {}  # occupied numbers of lanes, by depth

    def follow(self, record: Task) -> Lane | None:
        """Return the lane of a task at its start or end; None if it is another record."""
        if record.phase == Task.STARTED:
            parent = self._running.get(record.parent)
            depth = parent[0] + 1 if parent is not None else 1
            taken = self._taken.setdefault(depth, set())
            slot = next(slot for slot in range(len(taken) + 1) if slot not in taken)
            taken.add(slot)
            self._running[record.task] = depth, slot
            return depth, slot
        if record.phase == Task.FINISHED and (ended := self._running.pop(record.task, None)) is not None:
            self._taken[ended[0]].discard(ended[1])
            return ended
        return None
