"""The tree of tasks: what was part of what, how each ended, and the way down to the one that failed.

A tree is the fold of task records, and nothing else: a running plan folds its records as they are made, a reader those
of a log, with this same class. So a plan sees of itself what the log will tell.

Children stand in the order in which they were asked for, which is that of their ids.
"""

from __future__ import annotations

import json
import math
import threading
from collections import deque
from dataclasses import dataclass, field
from enum import IntEnum
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Final, Protocol, TypeVar

from recorder.records import STEPS_PER_SECOND, Task

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from recorder.records import Failure

_BY_ID: Final = attrgetter("id")
_ASKED, _STARTED, _FINISHED = Task.ASKED, Task.STARTED, Task.FINISHED


class State(IntEnum):
    """How far a task is, or how it ended; the numbers are those of the records."""

    CREATED = Task.CREATED
    RUNNING = Task.RUNNING
    SUCCEEDED = Task.SUCCEEDED
    FAILED = Task.FAILED
    CANCELLED = Task.CANCELLED

    @property
    def word(self) -> str:
        """As a word: "created", "running", "succeeded", "failed" or "cancelled"."""
        return self.name.lower()


@dataclass(frozen=True, slots=True)
class Moment:
    """A moment in both times.

    Attributes:
        wall_ns: nanoseconds since the Unix epoch.
        sim_step: steps of 1/240 s that the world had simulated.
        world: the world that was current, "" if there was none.
    """

    wall_ns: int
    sim_step: int = 0
    world: str = ""

    @property
    def sim_seconds(self) -> float:
        """Simulated time in s."""
        return self.sim_step / STEPS_PER_SECOND


def _moment(record: Task) -> Moment:
    return Moment(record.wall_time_ns, record.sim_step, record.world)


@dataclass(slots=True, eq=False)
class Node:
    """A task.

    Attributes:
        started: the record of its start; of a task that never started, that of its being asked for; of a task of
            which both are lost, that of its end.
        parent: the task that it is part of; None for an outermost one.
        asked: the record of its being asked for; None of what starts at once.
        finished: the record of its end; None if it has not ended.
        forgotten: how many of its parts the tree of a long-running plan has let go.
        size: bytes of its own records, where the tree has a limit for these.
    """

    started: Task
    parent: Node | None = None
    asked: Task | None = None
    finished: Task | None = None
    forgotten: int = 0
    size: int = 0
    _parts: dict[int, Node] = field(default_factory=dict)

    @property
    def id(self) -> int:
        """Its number: unique in its process, from 1."""
        return self.started.task

    @property
    def kind(self) -> str:
        """What sort of task: motion, process-module, block, branch, failure-handling, attempt, timeout, cleanup, ..."""
        return self.started.kind

    @property
    def name(self) -> str:
        """What people call it."""
        return self.started.name

    @property
    def attempt(self) -> int:
        """Which attempt it is, from 1; 0 if it is none."""
        return self.started.attempt

    @property
    def parameters(self) -> Mapping[str, Any]:
        """What it was given, by name, as the records tell it."""
        return {argument.name: json.loads(argument.json) for argument in self.started.parameters}

    @property
    def solution(self) -> Mapping[str, Any]:
        """How that was resolved; empty unless it was recorded."""
        resolved = self.finished.solution if self.finished is not None else ()
        return {argument.name: json.loads(argument.json) for argument in resolved}

    @property
    def status(self) -> State:
        """How far it is, or how it ended; RUNNING if the recording ends before."""
        if self.finished is not None:
            return State(self.finished.status)
        return State.CREATED if self.started.phase == Task.ASKED else State.RUNNING

    @property
    def failed(self) -> bool:
        """Whether it failed."""
        return self.finished is not None and self.finished.status == Task.FAILED

    @property
    def is_origin(self) -> bool:
        """Whether a failure began in it: it failed, and none of its parts did."""
        return self.failed and not any(child.failed for child in self.children)

    @property
    def failure(self) -> Failure | None:
        """What it failed with: type, message, data and, if it was recorded, the traceback."""
        return self.finished.failure if self.finished is not None and self.finished.HasField("failure") else None

    @property
    def created(self) -> Moment:
        """When it was asked for."""
        return _moment(self.asked or self.started)

    @property
    def start(self) -> Moment | None:
        """When it began; None if it has not."""
        return None if self.started.phase == Task.ASKED else _moment(self.started)

    @property
    def end(self) -> Moment | None:
        """When it ended; None if it has not."""
        return _moment(self.finished) if self.finished is not None else None

    @property
    def seconds(self) -> float | None:
        """How long it took by the clock, in s; None if it has not ended."""
        return self.finished.duration_ns / 1e9 if self.finished is not None else None

    @property
    def source(self) -> str:
        """The plan's line that asked for it, "file:line", "" if that isn't known."""
        record = self.asked or self.started
        return f"{record.source_file}:{record.source_line}" if record.source_file else ""

    @property
    def children(self) -> list[Node]:
        """Tasks that are part of it, in the order in which they were asked for."""
        return sorted(self._parts.values(), key=_BY_ID)

    @property
    def attempts(self) -> list[Node]:
        """Its parts that are attempts at the same thing."""
        return [child for child in self.children if child.attempt]

    @property
    def dealt_with(self) -> bool:
        """Whether a task around it ended well, or was cancelled: then its failure decided nothing."""
        return is_dealt_with(node.finished for node in self.around())

    @property
    def path(self) -> str:
        """Names from the outermost task down to this one."""
        return "/".join(reversed([node.name for node in self.around()]))

    def around(self) -> Iterator[Node]:
        """The task itself and those that it is part of, outwards."""
        node: Node | None = self
        while node is not None:
            yield node
            node = node.parent

    def walk(self) -> Iterator[tuple[int, Node]]:
        """This task and all below it with their depth from 0, each before its parts; as deep as plans nest."""
        stack = [(0, self)]
        while stack:
            depth, node = stack.pop()
            yield depth, node
            stack += [(depth + 1, child) for child in reversed(node.children)]

    def same(self, other: Node) -> bool:
        """Whether another tree tells the same of this task and of all below it, record for record."""
        mine, others = list(self.walk()), list(other.walk())
        return len(mine) == len(others) and all(
            depth == level
            and (node.asked, node.started, node.finished) == (twin.asked, twin.started, twin.finished)
            and node.forgotten == twin.forgotten
            for (depth, node), (level, twin) in zip(mine, others, strict=True)
        )

    def __repr__(self) -> str:
        return f"Node({self.id}, {self.kind} {self.name!r}, {self.status.word}, {len(self._parts)} parts)"


class Failing(Protocol):
    """A task that failed, in whatever form it is kept."""

    @property
    def dealt_with(self) -> bool:
        """Whether a task around it ended, and didn't fail."""


_Failing = TypeVar("_Failing", bound=Failing)


def is_dealt_with(ends: Iterable[Task | None]) -> bool:
    """Whether a failure decided nothing, by how it and the tasks around it ended.

    Args:
        ends: the records of their ends; None of what has not ended.
    """
    return any(end is not None and end.status != Task.FAILED for end in ends)


def decisive(origins: Sequence[_Failing]) -> _Failing | None:
    """The failure that tells how a plan fares: the last that nothing around it dealt with, else the last.

    Args:
        origins: the tasks in which failures began, in the order of their ends.
    """
    return next((task for task in reversed(origins) if not task.dealt_with), origins[-1] if origins else None)


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
        return tuple(sorted(self._roots.values(), key=_BY_ID))

    def apply(self, record: Task) -> Node:
        """Takes what a record tells.

        Args:
            record: the next one; kept.

        Returns:
            The task that it is about.
        """
        number, phase = record.task, record.phase
        size = record.ByteSize() if self._weighs else 0
        with self._lock:
            node = self.nodes.get(number)
            if node is None:
                parent = self.nodes.get(record.parent)
                node = self.nodes[number] = Node(record, parent, record if phase == _ASKED else None)
                (self._roots if parent is None else parent._parts)[number] = node  # noqa: SLF001  one module
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
            node.parent._parts.pop(node.id, None)  # noqa: SLF001  one module
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
        """As lines of text; see :mod:`recorder.task_text`.

        Args:
            depth: only so many levels.
            whole: whether to tell one by one what repeats itself.
        """
        from recorder.task_text import lines  # noqa: PLC0415  for looking at, not for running

        return "\n".join(lines(self, depth, whole=whole))

    def to_json(self) -> str:
        """As a JSON list of all tasks, each before its parts."""
        from recorder.task_text import facts  # noqa: PLC0415  for looking at, not for running

        return json.dumps(facts(self), ensure_ascii=False)

    def to_dot(self) -> str:
        """As a graph for Graphviz."""
        from recorder.task_picture import dot  # noqa: PLC0415  for looking at, not for running

        return dot(self)

    def to_svg(self, depth: int | None = None, *, whole: bool = False) -> str:
        """As a picture, with the times beside the tree; any browser shows it.

        Args:
            depth: only so many levels.
            whole: whether to show one by one what repeats itself.
        """
        from recorder.task_picture import svg  # noqa: PLC0415  for looking at, not for running

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
