"""The tree of tasks: what was part of what, how each ended, and the way down to the one that failed.

A tree is the fold of task records, and nothing else: a running plan folds its records as they are made, a reader those
of a log, with this same class. So a plan sees of itself what the log will tell.
"""

from __future__ import annotations

import json
import math
import threading
from collections import deque
from typing import TYPE_CHECKING

from recorder.records import Task
from recorder.tasks.node import BY_ID, Failing, Moment, Node, State, decisive, is_dealt_with

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["Failing", "Moment", "Node", "State", "Tree", "decisive", "is_dealt_with"]

_ASKED, _STARTED, _FINISHED = Task.ASKED, Task.STARTED, Task.FINISHED


class Tree:
    """All tasks of a plan or recording. Equal to another one that tells the same, record for record.

    Any thread may look at it, with all its methods, while others add to it.

    Attributes:
        nodes: by id.
        began: id of the task in which the plan's failure began, where somebody knows more than the tasks tell; 0 if it
            began in none; None to go by the tasks.
    """

    __hash__ = None  # type: ignore[assignment]  # it grows

    def __init__(self, limit: int | None = None, size: int | None = None) -> None:
        """Makes an empty tree.

        Args:
            limit: of so many tasks; beyond it those that ended first are forgotten, each before what it is part of.
                None to keep all.
            size: of so many bytes of records; likewise.
        """
        self.began: int | None = None
        self._limit = math.inf if limit is None else limit
        self._size_limit = math.inf if size is None else size
        self._weighs = size is not None
        self._size = 0
        self._lock = threading.Lock()
        self._roots: dict[int, Node] = {}
        self._ended: deque[int] = deque()
        self.nodes: dict[int, Node] = {}

    @property
    def roots(self) -> tuple[Node, ...]:
        """The outermost tasks, in the order of their start."""
        return tuple(sorted(self._roots.values(), key=BY_ID))

    def apply(self, record: Task, size: int = 0) -> Node:
        """Takes what a record tells.

        Args:
            record: the next one; kept.
            size: its bytes, where they are known already.

        Returns:
            The task that it is about.
        """
        number, phase = record.task, record.phase
        if self._weighs and not size:
            size = record.ByteSize()
        with self._lock:
            node = self.nodes.get(number)
            if node is None:
                parent = self.nodes.get(record.parent)
                node = self.nodes[number] = Node(record, parent, record if phase == _ASKED else None)
                (self._roots if parent is None else parent.parts)[number] = node
            elif phase == _STARTED:
                node.started = record
            if phase == _FINISHED:
                node.finished = record
                self._ended.append(number)
            node.size += size
            self._size += size
            while (len(self.nodes) > self._limit or self._size > self._size_limit) and self._ended:
                self._forget(self._ended.popleft())
            return node

    def forget(self) -> None:
        """Lets go of all that has ended and isn't part of a task that still runs."""
        with self._lock:
            self._roots = {number: node for number, node in self._roots.items() if node.finished is None}
            self.nodes = {node.id: node for root in self._roots.values() for _, node in root.walk()}
            self._ended = deque(number for number in self._ended if number in self.nodes)
            self._size = sum(node.size for node in self.nodes.values())

    def _forget(self, number: int) -> None:
        node = self.nodes.pop(number, None)
        if node is None:
            return
        self._size -= node.size
        if node.parent is None:
            self._roots.pop(node.id, None)
        else:
            node.parent.parts.pop(node.id, None)
            node.parent.forgotten += 1

    def walk(self) -> Iterator[tuple[int, Node]]:
        """All tasks with their depth from 0, each before its parts; as deep as plans nest."""
        for root in self.roots:
            yield from root.walk()

    def find(self, *, kind: str | None = None, name: str | None = None, status: State | None = None) -> list[Node]:
        """The tasks that are as asked, each before its parts.

        Args:
            kind: of this kind; None for any.
            name: of this name; None for any.
            status: that are so far or ended so; None for any.
        """
        return [
            node
            for _, node in self.walk()
            if kind in (None, node.kind) and name in (None, node.name) and status in (None, node.status)
        ]

    def failure_path(self) -> list[Node]:
        """From the outermost task down to that in which the decisive failure began; empty if nothing failed."""
        if self.began is not None:
            began = self.nodes.get(self.began)
        else:
            with self._lock:
                ended = [self.nodes[number] for number in self._ended if number in self.nodes]
            began = decisive([node for node in ended if node.is_origin])
        return list(began.around())[::-1] if began is not None else []

    def text(self, depth: int | None = None, *, whole: bool = False) -> str:
        """As lines of text; see :mod:`recorder.tasks.text`.

        Args:
            depth: only so many levels.
            whole: whether to tell one by one what repeats itself.
        """
        from recorder.tasks.text import lines  # noqa: PLC0415  for looking at, not for running

        return "\n".join(lines(self, depth, whole=whole))

    def to_json(self) -> str:
        """As a JSON list of all tasks, each before its parts."""
        from recorder.tasks.text import facts  # noqa: PLC0415  for looking at, not for running

        return json.dumps(facts(self), ensure_ascii=False)

    def to_dot(self) -> str:
        """As a graph for Graphviz."""
        from recorder.tasks.picture import dot  # noqa: PLC0415  for looking at, not for running

        return dot(self)

    def to_svg(self, depth: int | None = None, *, whole: bool = False) -> str:
        """As a picture, with the times beside the tree; any browser shows it.

        Args:
            depth: only so many levels.
            whole: whether to show one by one what repeats itself.
        """
        from recorder.tasks.picture import svg  # noqa: PLC0415  for looking at, not for running

        return svg(self, depth, whole=whole)

    def __str__(self) -> str:
        return self.text()

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Tree):
            return NotImplemented
        mine, others = self.roots, other.roots
        return len(mine) == len(others) and all(one.same(twin) for one, twin in zip(mine, others, strict=True))

    def __len__(self) -> int:
        return len(self.nodes)

    def __repr__(self) -> str:
        return f"Tree({len(self)} tasks)"
