"""The tree of tasks: which task was part of which, how each ended, and the path down to the one that failed.

A tree is the fold of task records, and nothing else. A running plan folds its records as they are made, a reader those
of a log, with the same class. So the tree of a running plan is that of its log.
"""

from __future__ import annotations

import json
import math
import threading
from collections import deque
from typing import TYPE_CHECKING, cast

from recorder.records import Task
from recorder.tasks import rendering
from recorder.tasks.node import BY_ID, Node, PackedTask, State, decisive, walk

if TYPE_CHECKING:
    from collections.abc import Iterator

    from recorder.records import Output

_ASKED, _STARTED, _FINISHED = Task.ASKED, Task.STARTED, Task.FINISHED


class Tree:
    """All tasks of a plan or recording; trees of the same records are equal.

    Any thread may use all methods while others add to it.

    Args:
        limit: number of tasks; beyond it those that ended first are forgotten, children before parents. None for all.
        size: bytes of records; likewise.
        unpacked: number of tasks whose records stay parsed; further records are packed: less memory, more time.
    """

    __hash__ = None  # type: ignore[assignment]  # it grows

    def __init__(self, limit: int | None = None, size: int | None = None, unpacked: float = math.inf) -> None:
        #: Id of the task in which the plan's failure began, where it is known from elsewhere; 0 if it began in none;
        #: None to go by the tasks.
        self.began: int | None = None
        #: Lines that the plan printed or logged, by the id of the task, where they are known: a running plan's are not.
        self.output: dict[int, list[Output]] = {}
        self._limit = math.inf if limit is None else limit
        self._size_limit = math.inf if size is None else size
        self._weighs = size is not None
        self._unpacked = unpacked
        self._size = 0
        self._lock = threading.Lock()
        self._roots: dict[int, Node] = {}
        self._ended: deque[int] = deque()
        self.nodes: dict[int, Node] = {}  # by id

    @property
    def roots(self) -> tuple[Node, ...]:
        """The outermost tasks, in the order of their start."""
        return tuple(sorted(self._roots.values(), key=BY_ID))

    def apply(self, record: Task, size: int = 0) -> Node:
        """Adds the next record, which is kept, and returns its task; ``size`` is its bytes, where they are known."""
        number, phase, above = record.task, record.phase, record.parent
        if self._weighs and not size:
            size = record.ByteSize()
        if len(self.nodes) >= self._unpacked:
            record = cast("Task", PackedTask(record))
        with self._lock:
            node = self.nodes.get(number)
            if node is None:
                parent = self.nodes.get(above)
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
        """Drops all that has ended and isn't part of a task that still runs."""
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
        """All tasks with their depth from 0, each before its children."""
        return walk(self.roots)

    def find(self, *, kind: str | None = None, name: str | None = None, status: State | None = None) -> list[Node]:
        """The tasks of a kind, name and status (None for any), each before its children."""
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

    def lines(self, depth: int | None = None, *, whole: bool = False) -> Iterator[str]:
        """Lines of text; see :func:`recorder.tasks.rendering.rows`."""
        return rendering.lines(self, depth, whole=whole)

    def text(self, depth: int | None = None, *, whole: bool = False) -> str:
        """The same in one string."""
        return "\n".join(self.lines(depth, whole=whole))

    def facts(self, depth: int | None = None) -> Iterator[dict[str, object]]:
        """All tasks down to a depth as data for JSON, each before its children."""
        return rendering.facts(self, depth)

    def to_json(self) -> str:
        """The same as JSON."""
        return json.dumps(list(self.facts()), ensure_ascii=False)

    def to_dot(self) -> str:
        """A graph for Graphviz."""
        return rendering.dot(self)

    def to_svg(self, depth: int | None = None, *, whole: bool = False) -> str:
        """A picture of the tree with its times, as an SVG document; see :func:`recorder.tasks.rendering.rows`."""
        return rendering.svg(self, depth, whole=whole)

    def __str__(self) -> str:
        return self.text()

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Tree):
            return NotImplemented
        own, others = (
            [(depth, node.asked, node.started, node.finished, node.forgotten) for depth, node in tree.walk()]
            for tree in (self, other)
        )
        return own == others

    def __len__(self) -> int:
        return len(self.nodes)

    def __repr__(self) -> str:
        return f"Tree({len(self)} tasks)"
