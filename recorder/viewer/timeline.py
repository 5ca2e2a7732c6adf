"""Lanes of tasks over time: what ran when, and how it ended.

A lane holds the tasks of one depth, one after the other; what runs side by side there has lanes of its own. When a task
ends, its beginning is told again with its outcome: later rows of a moment replace earlier ones.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import rerun as rr

from recorder.records import Task
from recorder.tasks import State
from recorder.tasks.picture import COLORS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from recorder.viewer.columns import Columns, Moment

LANES: Final = "level"  # which is what the viewer titles them with
_MOST_LOOKS: Final = 300  # names of tasks in one lane that have colours; from then on they go by their kinds
MARKS: Final = {State.FAILED: " \u2717", State.CANCELLED: " \u2013"}
_NOTHING: Final = ""


@dataclass(slots=True)
class _Lane:
    path: str
    looks: dict[str, tuple[str, State]] = field(default_factory=dict)  # label and status by state


@dataclass(slots=True)
class _Running:
    record: Task
    depth: int
    slot: int
    since: Moment


class Timeline:
    """All tasks.

    Args:
        columns: where it goes.
    """

    def __init__(self, columns: Columns) -> None:
        self._columns = columns
        self._running: dict[int, _Running] = {}
        self._busy: dict[int, dict[int, int]] = {}  # by depth: task by slot
        self._lanes: dict[tuple[int, int], _Lane] = {}

    def show(self, record: Task, now: Moment) -> None:
        """Shows a task's start or end."""
        if record.phase == Task.STARTED:
            self._start(record, now)
        elif record.phase == Task.FINISHED and record.task in self._running:
            self._end(self._running.pop(record.task), record, now)

    def _start(self, record: Task, now: Moment) -> None:
        parent = self._running.get(record.parent)
        depth = parent.depth + 1 if parent is not None else 1
        busy = self._busy.setdefault(depth, {})
        slot = next(slot for slot in range(len(busy) + 1) if slot not in busy)
        busy[slot] = record.task
        running = self._running[record.task] = _Running(record, depth, slot, now)
        self._tell(running, State.RUNNING)

    def _end(self, running: _Running, record: Task, now: Moment) -> None:
        self._tell(running, State(record.status))
        self._columns.add(self._lane(running).path, _states, now, _NOTHING)
        self._busy[running.depth].pop(running.slot, None)

    def _tell(self, running: _Running, status: State) -> None:
        lane = self._lane(running)
        record = running.record
        name = record.name if len(lane.looks) < _MOST_LOOKS else record.kind
        state = f"{name} {status.word}"
        if state not in lane.looks:
            lane.looks[state] = (name + MARKS.get(status, ""), status)
            labels, shown = zip(*lane.looks.values(), strict=True)
            colors = [_rgb(one) for one in shown]
            self._columns.fix(lane.path, rr.StateConfiguration(values=list(lane.looks), labels=labels, colors=colors))
        self._columns.add(lane.path, _states, running.since, state)

    def _lane(self, running: _Running) -> _Lane:
        key = (running.depth, running.slot)
        if key not in self._lanes:
            beside = f".{running.slot + 1}" if running.slot else ""
            self._lanes[key] = _Lane(self._columns.path(LANES, f"{running.depth}{beside}"))
        return self._lanes[key]


def _rgb(status: State) -> list[int]:
    return [*bytes.fromhex(COLORS[status].removeprefix("#"))]


def _states(rows: Sequence[tuple[Any, ...]]) -> rr.ComponentColumnList:
    return rr.StateChange.columns(state=[state for (state,) in rows])
