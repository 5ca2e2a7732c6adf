"""The task tree of a recording: the same classes that a running plan sees of itself (:mod:`recorder.tasks`)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from recorder.records import Output, Task
from recorder.tasks import Tree
from replay.explain.root_cause import root_cause, uncaught_failure

if TYPE_CHECKING:
    from replay.file.record_reader import RecordReader


def tree(log: RecordReader, stop: int | None = None) -> Tree:
    """Return the task tree of a recording, as it was before a step if one is given."""
    folded = Tree()
    for record in log.records((Task, Output), stop=stop):
        if isinstance(record, Output):
            folded.output.setdefault(record.task, []).append(record)
        elif isinstance(record, Task):
            folded.apply(record)
    if stop is None and uncaught_failure(log) is not None:
        cause = root_cause(log)  # the plan's own failure is more specific than those of its tasks
        folded.began = cause.task.id if cause is not None and cause.task is not None else 0
    return folded
