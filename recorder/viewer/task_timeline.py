"""Tasks over time: what ran when, and how it ended.

A lane holds the tasks of one depth, one after the other; what runs side by side there has lanes of its own. When a task
ends, its beginning is sent again with its outcome: later rows of a time point replace earlier ones.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import rerun as rr

from recorder.records import Task
from recorder.tasks import State
from recorder.tasks.tree_picture import COLORS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from recorder.viewer.columns import Columns, Series, TimePoint

LANES: Final = "level"  # which is what the viewer titles them with
STATUS_MARKS: Final = {State.FAILED: " \u2717", State.CANCELLED: " \u2013"}
_MAX_NAMES: Final = 300  # that have colours of their own in a lane; from then on tasks go by their kinds


@dataclass(slots=True)
class _Lane:
    path: str
    states: Series
    labels: dict[str, tuple[str, State]] = field(default_factory=dict)  # label and status by the viewer's state


@dataclass(slots=True)
class _Running:
    record: Task
    depth: int
    slot: int
    since: TimePoint


class TaskTimeline:
    """Lanes of all tasks."""

    def __init__(self, columns: Columns) -> None:
        self._columns = columns
        self._running: dict[int, _Running] = {}
        self._slots: dict[int, set[int]] = {}  # that are taken, by depth
        self._lanes: dict[tuple[int, int], _Lane] = {}

    def show(self, record: Task, now: TimePoint) -> None:
        """Shows a task's start or end."""
        if record.phase == Task.STARTED:
            parent = self._running.get(record.parent)
            depth = parent.depth + 1 if parent is not None else 1
            taken = self._slots.setdefault(depth, set())
            slot = next(slot for slot in range(len(taken) + 1) if slot not in taken)
            taken.add(slot)
            running = self._running[record.task] = _Running(record, depth, slot, now)
            self._label(running, State.RUNNING)
        elif record.phase == Task.FINISHED and record.task in self._running:
            running = self._running.pop(record.task)
            self._label(running, State(record.status))
            self._lane(running).states.add(now, ("",))
            self._slots[running.depth].discard(running.slot)

    def _label(self, running: _Running, status: State) -> None:
        lane, record = self._lane(running), running.record
        name = record.name if len(lane.labels) < _MAX_NAMES else record.kind
        state = f"{name} {status.word}"
        if state not in lane.labels:
            lane.labels[state] = (name + STATUS_MARKS.get(status, ""), status)
            labels, statuses = zip(*lane.labels.values(), strict=True)
            colors = [[*bytes.fromhex(COLORS[status].removeprefix("#"))] for status in statuses]
            configuration = rr.StateConfiguration(values=list(lane.labels), labels=labels, colors=colors)
            self._columns.send_static(lane.path, configuration)
        lane.states.add(running.since, (state,))

    def _lane(self, running: _Running) -> _Lane:
        key = (running.depth, running.slot)
        if key not in self._lanes:
            beside = f".{running.slot + 1}" if running.slot else ""
            path = self._columns.path(LANES, f"{running.depth}{beside}")
            self._lanes[key] = _Lane(path, self._columns.series(path, _states))
        return self._lanes[key]


def _states(rows: Sequence[tuple[Any, ...]]) -> rr.ComponentColumnList:
    return rr.StateChange.columns(state=[state for (state,) in rows])
