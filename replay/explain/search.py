"""Picks records: by kind, task, body, world and text."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from recorder.records import Task
from replay.explain import wording
from replay.state.json_data import kind_of, mentions

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    from recorder.records import Record
    from replay.file.log import Log


@dataclass(frozen=True, slots=True)
class Filter:
    """A filter; a record must match all that is given.

    Attributes:
        kinds: names of kinds ("task", "mutation", ...); empty for all.
        task: id of a task, or part of its name; its subtasks match too.
        body: name of a body that records must be about.
        world: name of the world that they are about.
        text: what their line must contain, ignoring case.
    """

    kinds: Collection[str] = ()
    task: str | None = None
    body: str | None = None
    world: str | None = None
    text: str | None = None


class Search:
    """A search through a recording from front to end, which can go on when the recording has grown."""

    def __init__(self, log: Log, criteria: Filter) -> None:
        self._log = log
        self._criteria = criteria
        self._tasks: set[int] = set()
        self._known = 0  # tasks are known up to this step

    def matches(self, start: int, stop: int) -> Iterator[tuple[Record, str]]:
        """Yield the matching records with their lines."""
        if self._criteria.task is not None:
            self._learn_tasks(stop)
        for record in self._log.records(start=start, stop=stop):
            line = self._line(record)
            if line is not None:
                yield record, line

    def _learn_tasks(self, stop: int) -> None:
        for record in self._log.records(Task, self._known, stop):
            if record.phase == Task.STARTED and self._is_of_task(record):
                self._tasks.add(record.task)
        self._known = stop

    def _is_of_task(self, task: Task) -> bool:
        pattern = self._criteria.task or ""
        if pattern.isdecimal():
            return task.task == int(pattern) or task.parent in self._tasks
        return pattern.casefold() in task.name.casefold() or task.parent in self._tasks

    def _line(self, record: Record) -> str | None:
        criteria = self._criteria
        if criteria.kinds and kind_of(record) not in criteria.kinds:
            return None
        if criteria.world is not None and record.world != criteria.world:
            return None
        if criteria.task is not None and record.task not in self._tasks:
            return None
        if criteria.body is not None and not mentions(record, criteria.body):
            return None
        line = wording.line(record)
        return line if criteria.text is None or criteria.text.casefold() in line.casefold() else None
