"""The tree of tasks: which task was part of which, how each ended, and the path down to the one that failed.

A tree is the fold of task records, and nothing else. A running plan folds its records as they are made, a reader those
of a log, with the same class. So the tree of a running plan is that of its log. The children of a task are in the order
in which they were requested, which is that of their ids.
"""

from __future__ import annotations

import json
import math
import threading
from collections import deque
from dataclasses import dataclass, field
from enum import Enum, IntEnum
from functools import lru_cache
from operator import attrgetter
from typing import TYPE_CHECKING, Any, cast

from recorder.records import STEPS_PER_SECOND, Task, argument_values
from recorder.tasks import rendering

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from recorder.records import Decision, Failure, Output, Plain, Query


_ASKED, _STARTED, _FINISHED = Task.ASKED, Task.STARTED, Task.FINISHED  # looked up once


class State(IntEnum):
    """Status of a task; the numbers are those of the records."""

    CREATED = Task.CREATED
    RUNNING = Task.RUNNING
    SUCCEEDED = Task.SUCCEEDED
    FAILED = Task.FAILED
    CANCELLED = Task.CANCELLED

    @classmethod
    def _missing_(cls, value: object) -> State | None:
        """Return the status of a number that only a newer release knows: called by that number."""
        if not isinstance(value, int):
            return None
        unknown = int.__new__(cls, value)
        unknown._name_, unknown._value_ = str(value), value  # type: ignore[assignment]
        return unknown

    @property
    def word(self) -> str:
        """As a word: "created", "running", "succeeded", "failed" or "cancelled"; of a newer release's, its number."""
        return self.name.lower()

    def __str__(self) -> str:
        return f"State.{self.name}"

    __format__ = Enum.__format__  # else it would be a number there


@dataclass(frozen=True, slots=True)
class Moment:
    """A moment in wall time and simulated time."""

    wall_ns: int  # nanoseconds since the Unix epoch
    sim_step: int = 0  # steps of 1/240 s that the world had simulated
    world: str = ""  # the world that was current, "" if there was none
    #: Nanoseconds since the recording began, by a clock that nobody sets; 0 where that isn't recorded.
    monotonic_ns: int = 0

    @property
    def sim_seconds(self) -> float:
        """Simulated time in s."""
        return self.sim_step / STEPS_PER_SECOND


def _moment(record: Task) -> Moment:
    if record.began_ns:  # before the recording, whose clock it doesn't have
        return Moment(record.began_ns, record.sim_step, record.world)
    return Moment(record.wall_time_ns, record.sim_step, record.world, record.monotonic_ns)


@dataclass(slots=True, eq=False)
class Node:
    """A task."""

    #: The record of its start; if it never started, that of its being asked for; if both are lost, that of its end.
    started: Task
    parent: Node | None = None  # the task that it is part of; None for an outermost one
    asked: Task | None = None  # the record of its being asked for; None if it started at once
    finished: Task | None = None  # the record of its end; None if it has not ended
    forgotten: int = 0  # number of its children that the tree of a long-running plan has dropped
    #: With which it chose what to do; only of a recording, on the path to the failure.
    choices: list[Query] = field(default_factory=list)
    size: int = 0  # bytes of its own records, where the tree has a limit for these
    parts: dict[int, Node] = field(default_factory=dict)  # its children, by their ids

    @property
    def id(self) -> int:
        """Its number: unique in its process, from 1."""
        return self.started.task

    @property
    def kind(self) -> str:
        """Such as motion, process-module, block, branch, failure-handling, attempt, timeout, cleanup, ..."""
        return self.started.kind

    @property
    def name(self) -> str:
        """What people call it."""
        return self.started.name

    @property
    def attempt(self) -> int:
        """Number of the attempt, from 1; 0 if it is none."""
        return self.started.attempt

    @property
    def parameters(self) -> dict[str, Plain]:
        """What it was given, by name, as recorded."""
        return argument_values(self.started.parameters)

    @property
    def solution(self) -> dict[str, Plain]:
        """How that was resolved; empty unless it was recorded."""
        return argument_values(self.finished.solution if self.finished is not None else ())

    @property
    def decision(self) -> Decision | None:
        """How it was decided, if it is a motion or a process module and that was recorded."""
        records = (each for each in (self.finished, self.started) if each is not None and each.HasField("decision"))
        return next((record.decision for record in records), None)

    @property
    def status(self) -> State:
        """Its status; RUNNING if the recording ends before it does."""
        if self.finished is not None:
            return State(self.finished.status)
        return State.CREATED if self.started.phase == Task.ASKED else State.RUNNING

    @property
    def failed(self) -> bool:
        """Whether it failed."""
        return self.finished is not None and self.finished.status == Task.FAILED

    @property
    def is_origin(self) -> bool:
        """Whether a failure began in it: it failed, and none of its children did."""
        return self.failed and not any(child.failed for child in self.children)

    @property
    def failure(self) -> Failure | None:
        """What it failed with: type, message, data and, if it was recorded, the traceback."""
        return self.finished.failure if self.finished is not None and self.finished.HasField("failure") else None

    @property
    def error(self) -> tuple[str, str] | None:
        """Type and message of what it failed with; None if it didn't fail."""
        return (self.finished.failure.type, self.finished.failure.message) if self.finished and self.failed else None

    @property
    def origin(self) -> Node:
        """The task in which its failure began: down the children with the same error, else the last that failed."""
        node = self
        while failed := [child for child in node.children if child.failed]:
            node = next((child for child in reversed(failed) if child.error == node.error), failed[-1])
        return node

    @property
    def outermost_failed(self) -> Node:
        """The outermost task around it that failed too, without one between them that didn't."""
        node = self
        while node.parent is not None and node.parent.failed:
            node = node.parent
        return node

    @property
    def motion(self) -> Node:
        """The motion that it is part of, or is; itself if there is none."""
        return next((node for node in self.around() if node.kind == "motion"), self)

    @property
    def last_step(self) -> int:
        """The step of its end; of its start if it has not ended."""
        return (self.finished or self.started).seq

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
        """Its direct children, in the order in which they were asked for."""
        return [child for _, child in sorted(self.parts.items())]

    @property
    def attempts(self) -> list[Node]:
        """Its children that are attempts."""
        return [child for child in self.children if child.attempt]

    @property
    def dealt_with(self) -> bool:
        """Whether a task around it ended without failing: then its failure decided nothing."""
        return any(node.finished is not None and not node.failed for node in self.around())

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
        """This task and all below it with their depth from 0, each before its children."""
        stack = [(0, self)]
        while stack:
            depth, node = stack.pop()
            yield depth, node
            stack += [(depth + 1, child) for child in reversed(node.children)]

    def __repr__(self) -> str:
        return f"Node({self.id}, {self.kind} {self.name!r}, {self.status.word}, {len(self.parts)} parts)"


def decisive(origins: Sequence[Node]) -> Node | None:
    """The task whose failure decides a plan, of those in which failures began, in the order of their ends.

    It is the last that nothing around it dealt with, else the last.
    """
    return next((task for task in reversed(origins) if not task.dealt_with), origins[-1] if origins else None)


def walk(roots: Iterable[Node]) -> Iterator[tuple[int, Node]]:
    """Trees with their depth from 0, each task before its children."""
    for root in roots:
        yield from root.walk()


_parsed = lru_cache(64)(Task.FromString)  # who looks at a task asks for several of its fields


class PackedTask:
    """A record of a task as its bytes, which take a fifth of the memory; it has the attributes of :class:`Task`.

    It is parsed whenever somebody looks at it. Later changes of the packed record are not seen.
    """

    __slots__ = ("_payload",)
    __hash__ = None  # type: ignore[assignment]  # as records

    def __init__(self, record: Task) -> None:
        self._payload = record.SerializeToString()

    def __getattr__(self, name: str) -> Any:
        return getattr(_parsed(self._payload), name)

    def __eq__(self, other: object) -> bool:
        return _parsed(self._payload) == (_parsed(other._payload) if isinstance(other, PackedTask) else other)


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
        return tuple(sorted(self._roots.values(), key=attrgetter("id")))

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
