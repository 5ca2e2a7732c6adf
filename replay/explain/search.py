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

    def __init__(self, log: Log, wanted: Filter) -> None:
        self._log = log
        self._wanted = wanted
        self._tasks: set[int] = set()
        self._known = 0  # tasks are known up to this step

    def matches(self, start: int, stop: int) -> Iterator[tuple[Record, str]]:
        """Yield the matching records with their lines."""
        if self._wanted.task is not None:
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
        wanted = self._wanted.task or ""
        if wanted.isdecimal():
            return task.task == int(wanted) or task.parent in self._tasks
        return wanted.casefold() in task.name.casefold() or task.parent in self._tasks

    def _line(self, record: Record) -> str | None:
        wanted = self._wanted
        if wanted.kinds and kind_of(record) not in wanted.kinds:
            return None
        if wanted.world is not None and record.world != wanted.world:
            return None
        if wanted.task is not None and record.task not in self._tasks:
            return None
        if wanted.body is not None and not mentions(record, wanted.body):
            return None
        line = wording.line(record)
        return line if wanted.text is None or wanted.text.casefold() in line.casefold() else None
