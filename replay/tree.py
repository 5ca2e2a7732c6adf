"""The tree of tasks: what was part of what, how each ended, and the way down to the one that failed."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from recorder.records import Task

if TYPE_CHECKING:
    from collections.abc import Iterator

    from replay.log import Log


@dataclass(slots=True, eq=False)
class Node:
    """A task.

    Attributes:
        started: the record of its start; of a task whose start is lost, that of its end.
        parent: the task that it is part of; None for an outermost one.
        finished: the record of its end; None if the recording ends before.
        children: tasks that are part of it, in the order of their start.
    """

    started: Task
    parent: Node | None = None
    finished: Task | None = None
    children: list[Node] = field(default_factory=list)

    @property
    def status(self) -> Task.Status:
        """How it ended; RUNNING if the recording ends before."""
        return self.finished.status if self.finished else Task.RUNNING

    @property
    def failed(self) -> bool:
        """Whether it failed."""
        return self.status == Task.FAILED

    @property
    def culprit(self) -> Node | None:
        """The part of it whose failure became its own: the last one that failed with the same error."""
        if self.failed and self.finished is not None:
            error = self.finished.failure
            for child in reversed(self.children):
                end = child.finished
                if (
                    child.failed
                    and end is not None
                    and (end.failure.type, end.failure.message)
                    == (
                        error.type,
                        error.message,
                    )
                ):
                    return child
            return next((child for child in reversed(self.children) if child.failed), None)
        return None

    @property
    def path(self) -> str:
        """Names from the outermost task down to this one."""
        names = []
        node: Node | None = self
        while node is not None:
            names.append(node.started.name)
            node = node.parent
        return "/".join(reversed(names))


@dataclass(frozen=True, slots=True)
class Tree:
    """All tasks of a recording.

    Attributes:
        roots: the outermost ones, in the order of their start.
        nodes: all by id.
    """

    roots: tuple[Node, ...]
    nodes: dict[int, Node]

    def walk(self) -> Iterator[tuple[int, Node]]:
        """All tasks with their depth from 0, each before its parts; as deep as plans nest."""
        stack = [(0, root) for root in reversed(self.roots)]
        while stack:
            depth, node = stack.pop()
            yield depth, node
            stack += [(depth + 1, child) for child in reversed(node.children)]

    def failure_path(self) -> list[Node]:
        """From the last outermost task that failed down to where it began to fail; empty if none did."""
        node = next((root for root in reversed(self.roots) if root.failed), None)
        path = []
        while node is not None:
            path.append(node)
            node = node.culprit
        return path


def tree(log: Log, stop: int | None = None) -> Tree:
    """The task tree of a recording.

    Args:
        log: the recording.
        stop: the step before which to end: the tree as it was then.
    """
    nodes: dict[int, Node] = {}
    roots: list[Node] = []
    for record in log.records(Task, stop=stop):
        if not isinstance(record, Task):
            continue
        node = nodes.get(record.task)
        if node is None:
            parent = nodes.get(record.parent)
            node = nodes[record.task] = Node(record, parent)
            (parent.children if parent is not None else roots).append(node)
        if record.phase == Task.FINISHED:
            node.finished = record
    return Tree(tuple(roots), nodes)
