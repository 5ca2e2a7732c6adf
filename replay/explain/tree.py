"""The task tree of a recording: the same classes that a running plan sees of itself (:mod:`recorder.tasks`)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from recorder.records import Task
from recorder.tasks import Node, State, Tree
from replay.explain.root_cause import root_cause, uncaught

if TYPE_CHECKING:
    from replay.file.log import Log

__all__ = ["Node", "State", "Tree", "tree"]


def tree(log: Log, stop: int | None = None) -> Tree:
    """The task tree of a recording.

    Args:
        log: the recording.
        stop: the step before which to end: the tree as it was then.
    """
    found = Tree()
    for record in log.records(Task, stop=stop):
        if isinstance(record, Task):
            found.apply(record)
    if stop is None and uncaught(log) is not None:
        broken = root_cause(log)  # what the plan failed with tells more than its tasks do
        found.began = broken.task.started.task if broken is not None and broken.task is not None else 0
    return found
