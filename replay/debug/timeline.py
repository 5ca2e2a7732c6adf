"""What the steps of a recording are part of, read once: to which step a command of the debugger leads.

A step's level is the innermost task that encloses it; the start and the end of a task are on the level around it. So
``next`` goes from the start of a task to its end, as a debugger of programs goes over a call.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import defaultdict
from typing import TYPE_CHECKING, TypeAlias

from recorder.records import Envelope, Event, Keyframe, Output, Run, Task

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from recorder.records import Record
    from replay.file.record_reader import RecordReader

Site: TypeAlias = "tuple[str, int]"  # a file and a line


class Timeline:
    """The steps of a recording.

    Args:
        log: the recording.

    Attributes:
        steps: how many there are.
        paths: names of tasks from the outside in, by the steps of their starts.
        kinds: kinds of tasks, by the same.
        failures: steps at which something failed.
        events: steps of events, by their names.
    """

    def __init__(self, log: RecordReader) -> None:
        self.steps = len(log)
        self.paths: dict[int, tuple[str, ...]] = {}
        self.kinds: dict[int, str] = {}
        self.failures: list[int] = []
        self.events: dict[str, list[int]] = defaultdict(list)
        self._levels = [0] * self.steps
        self._parents: dict[int, int] = {}
        self._names: dict[int, tuple[str, ...]] = {0: ()}
        self._ends: dict[int, int] = {}
        self._stacks: list[tuple[Site, ...]] = [()] * self.steps
        self._lines: dict[Site, list[int]] = defaultdict(list)
        task_stacks: dict[int, tuple[Site, ...]] = {}
        latest: dict[str, tuple[Site, ...]] = {}  # by thread or branch
        for record in log.records():
            self._note(record)
            own = _own_stack(record)
            stack = own or task_stacks.get(record.task, ())
            if isinstance(record, Task) and record.phase in (Task.STARTED, Task.ASKED):
                task_stacks[record.task] = stack
            self._stacks[record.seq] = stack
            before = latest.get(record.thread, ())
            again = bool(own) and not isinstance(record, Output)  # what a line prints comes with its other records
            for depth, site in enumerate(stack):
                if before[: depth + 1] != stack[: depth + 1] or (again and depth == len(stack) - 1):
                    hits = self._lines[site]
                    if hits[-1:] != [record.seq]:
                        hits.append(record.seq)
            latest[record.thread] = stack

    def _note(self, record: Record) -> None:
        self._levels[record.seq] = record.task
        if isinstance(record, Task):
            self._levels[record.seq] = record.parent
            self._parents[record.task] = record.parent
            if record.phase == Task.STARTED:
                names = (*self._names.get(record.parent, ()), record.name)
                self._names[record.task] = self.paths[record.seq] = names
                self.kinds[record.seq] = record.kind
            elif record.phase != Task.ASKED:
                self._ends[record.task] = record.seq
        if isinstance(record, Event):
            self.events[record.name].append(record.seq)
        if "failure" in record.DESCRIPTOR.fields_by_name and record.HasField("failure"):
            self.failures.append(record.seq)

    # --- where commands lead ----------------------------------------------------------------------------------------

    def following(self, step: int) -> int:
        """Return the next step on the level of a step, or on one around it; the last step if there is none."""
        around = {self._levels[step], *self._around(self._levels[step])}
        return next((at for at in range(step + 1, self.steps) if self._levels[at] in around), self.steps - 1)

    def preceding(self, step: int) -> int:
        """Return the step before on the level of a step, or on one around it; the first step if there is none."""
        around = {self._levels[step], *self._around(self._levels[step])}
        return next((at for at in range(step - 1, -1, -1) if self._levels[at] in around), 0)

    def end(self, step: int) -> int:
        """Return the end of the task that a step is in; the last step if it is in none, or that has no end."""
        return self._ends.get(self._levels[step], self.steps - 1)

    def onwards(self, step: int) -> int:
        """Return the next step at a later line of the same file, on the level of a step; or on one around it."""
        site, level = self.site(step), self._levels[step]
        around = {level, *self._around(level)}
        for at in range(step + 1, self.steps):
            if self._levels[at] in around:
                file, line = self.site(at)
                if self._levels[at] != level or (file == site[0] and line > site[1]):
                    return at
        return self.steps - 1

    def _around(self, task: int) -> Iterator[int]:
        while task:
            task = self._parents.get(task, 0)
            yield task

    # --- lines ------------------------------------------------------------------------------------------------------

    def site(self, step: int) -> Site:
        """Return the plan's line that led to a step; ("", 0) if none is known."""
        return self._stacks[step][-1] if self._stacks[step] else ("", 0)

    def stack(self, step: int) -> Sequence[Site]:
        """Return the plan's lines that led to a step, outermost first."""
        return self._stacks[step]

    @property
    def files(self) -> set[str]:
        """The plan's files."""
        return {file for file, _ in self._lines}

    def line(self, file: str, number: int) -> tuple[int, list[int]]:
        """Return the first line of a file from one on that led to a record, and the steps at which it was come to.

        That is the first record of each execution of the line; of a line that calls a function again and again, without
        a record of another line between, only the first.
        """
        numbers = sorted(line for named, line in self._lines if named == file)
        at = bisect_left(numbers, number)
        return (numbers[at], self._lines[file, numbers[at]]) if at < len(numbers) else (0, [])


def first_after(steps: Sequence[int], step: int) -> int | None:
    """Return the first of some steps, in their order, after one."""
    at = bisect_right(steps, step)
    return steps[at] if at < len(steps) else None


def last_before(steps: Sequence[int], step: int) -> int | None:
    """Return the last of some steps, in their order, before one."""
    at = bisect_left(steps, step)
    return steps[at - 1] if at else None


def _own_stack(record: Record) -> tuple[Site, ...]:
    if isinstance(record, Run | Keyframe | Envelope) or not record.source_file:
        return ()
    callers = () if isinstance(record, Output) else record.callers
    file = record.source_file
    return (*((caller.file or file, caller.line) for caller in callers), (file, record.source_line))
