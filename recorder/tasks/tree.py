"""The tree of tasks: the parts and the outcome of each task, and the path to the task that failed.

A tree is computed from task records. Plans and readers use the same class, so their trees are equal.
"""

from __future__ import annotations

import json
import math
import threading
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from enum import Enum, IntEnum
from operator import attrgetter
from typing import TypeAlias

from recorder import html, notebook
from recorder.records import STEPS_PER_SECOND, Decision, Failure, Output, Plain, Query, Task, argument_values
from recorder.tasks import rendering


class State(IntEnum):
    """The status of a task, with the number that it has in records."""

    CREATED = Task.CREATED
    RUNNING = Task.RUNNING
    SUCCEEDED = Task.SUCCEEDED
    FAILED = Task.FAILED
    CANCELLED = Task.CANCELLED

    @classmethod
    def _missing_(cls, value: object) -> State | None:
        """Return a status that only a newer release knows; the number is also the name."""
        if not isinstance(value, int):
            return None
        unknown = int.__new__(cls, value)
        unknown._name_, unknown._value_ = str(value), value  # type: ignore[assignment]
        return unknown

    @property
    def word(self) -> str:
        """The status as a word, such as "running" or "succeeded"; a number if only a newer release knows it."""
        return self.name.lower()

    def __str__(self) -> str:
        return f"State.{self.name}"

    __format__ = Enum.__format__  # otherwise the status would be formatted as a number


@dataclass(frozen=True, slots=True)
class Moment:
    """A moment in wall time and simulated time."""

    wall_ns: int  # ns since the Unix epoch
    sim_step: int = 0  # number of simulated steps of 1/240 s
    world: str = ""  # name of the current world; "" if no world is open
    monotonic_ns: int = 0  # time since the beginning of the recording in ns, by a steady clock; 0 if unknown

    @property
    def sim_seconds(self) -> float:
        """Simulated time in s."""
        return self.sim_step / STEPS_PER_SECOND


def _moment(record: Task) -> Moment:
    if record.began_ns:  # text for a task that began before the recording
        return Moment(record.began_ns, record.sim_step, record.world)
    return Moment(record.wall_time_ns, record.sim_step, record.world, record.monotonic_ns)


@dataclass(slots=True, eq=False)
class Node:
    """A task."""

    started: Task  # the record of the start, or else of the request, or else of the end
    parent: Node | None = None  # the task around this task; None for an outermost task
    asked: Task | None = None  # the record of the task's request; None if the task started immediately
    finished: Task | None = None  # the record of the task's end; None before the end
    forgotten: int = 0  # number of children that were dropped
    #: The queries that chose the task's actions; only for tasks of a recording on the path to the failure.
    choices: list[Query] = field(default_factory=list)
    size: int = 0  # number of bytes of the task's own records, if the tree limits bytes
    parts: dict[int, Node] = field(default_factory=dict)  # children by id

    @property
    def id(self) -> int:
        """The number of the task, from 1. Each task of a process has its own number."""
        return self.started.task

    @property
    def kind(self) -> str:
        """The kind of the task, such as motion, process-module, block, branch, attempt, timeout or cleanup."""
        return self.started.kind

    @property
    def name(self) -> str:
        """The name of the task."""
        return self.started.name

    @property
    def attempt(self) -> int:
        """The number of the attempt, from 1; 0 if the task is no attempt."""
        return self.started.attempt

    @property
    def parameters(self) -> dict[str, Plain]:
        """The task's recorded parameters by name."""
        return argument_values(self.started.parameters)

    @property
    def solution(self) -> dict[str, Plain]:
        """The recorded solution of the task's designator by name; empty if there is none."""
        return argument_values(self.finished.solution if self.finished is not None else ())

    @property
    def decision(self) -> Decision | None:
        """The recorded decision of a motion or a process module."""
        records = (each for each in (self.finished, self.started) if each is not None and each.HasField("decision"))
        return next((record.decision for record in records), None)

    @property
    def status(self) -> State:
        """The status of the task; RUNNING if the recording ends before the task."""
        if self.finished is not None:
            return State(self.finished.status)
        return State.CREATED if self.started.phase == Task.ASKED else State.RUNNING

    @property
    def failed(self) -> bool:
        """Whether the task failed."""
        return self.finished is not None and self.finished.status == Task.FAILED

    @property
    def is_origin(self) -> bool:
        """Whether a failure began in this task: the task failed, and no child of the task failed."""
        return self.failed and not any(child.failed for child in self.children)

    @property
    def failure(self) -> Failure | None:
        """The failure of the task: type, message, data and traceback."""
        return self.finished.failure if self.finished is not None and self.finished.HasField("failure") else None

    @property
    def error(self) -> tuple[str, str] | None:
        """Type and message of the task's failure; None if the task didn't fail."""
        return (self.finished.failure.type, self.finished.failure.message) if self.finished and self.failed else None

    @property
    def origin(self) -> Node:
        """The task in which the failure began: the last failed descendant, preferably with the same error."""
        node = self
        while failed := [child for child in node.children if child.failed]:
            node = next((child for child in reversed(failed) if child.error == node.error), failed[-1])
        return node

    @property
    def outermost_failed(self) -> Node:
        """The outermost of the failed tasks around this task, up to a task that didn't fail."""
        node = self
        while node.parent is not None and node.parent.failed:
            node = node.parent
        return node

    @property
    def motion(self) -> Node:
        """The innermost motion among this task and the tasks around it; this task if there is no motion."""
        return next((node for node in self.around() if node.kind == "motion"), self)

    @property
    def last_step(self) -> int:
        """The step of the task's end, or of its start before the end."""
        return (self.finished or self.started).seq

    @property
    def created(self) -> Moment:
        """The moment of the task's request."""
        return _moment(self.asked or self.started)

    @property
    def start(self) -> Moment | None:
        """The moment of the task's start; None before the start."""
        return None if self.started.phase == Task.ASKED else _moment(self.started)

    @property
    def end(self) -> Moment | None:
        """The moment of the task's end; None before the end."""
        return _moment(self.finished) if self.finished is not None else None

    @property
    def seconds(self) -> float | None:
        """The task's duration in s by the clock; None before the end."""
        return self.finished.duration_ns / 1e9 if self.finished is not None else None

    @property
    def source(self) -> str:
        """The line of the plan that requested the task, "file:line" or "In [3], line 1"; "" if unknown."""
        record = self.asked or self.started
        return notebook.place(record.source_file, record.source_line) if record.source_file else ""

    @property
    def children(self) -> list[Node]:
        """The direct children of the task in the order of their requests."""
        return [child for _, child in sorted(self.parts.items())]

    @property
    def attempts(self) -> list[Node]:
        """The attempts among the task's children."""
        return [child for child in self.children if child.attempt]

    @property
    def dealt_with(self) -> bool:
        """Whether this task or a task around it ended without a failure, so that no failure here ended the plan."""
        return any(node.finished is not None and not node.failed for node in self.around())

    @property
    def path(self) -> str:
        """The names of the tasks from the outermost to this one, joined by "/"."""
        return "/".join(reversed([node.name for node in self.around()]))

    def around(self) -> Iterator[Node]:
        """Yield the task and the tasks around it, innermost first."""
        node: Node | None = self
        while node is not None:
            yield node
            node = node.parent

    def walk(self) -> Iterator[tuple[int, Node]]:
        """Yield the task and all tasks below it, with their depths from 0; each task comes before its children."""
        stack = [(0, self)]
        while stack:
            depth, node = stack.pop()
            yield depth, node
            stack += [(depth + 1, child) for child in reversed(node.children)]

    def __repr__(self) -> str:
        return f"Node({self.id}, {self.kind} {self.name!r}, {self.status.word}, {len(self.parts)} parts)"


def decisive(origins: Sequence[Node]) -> Node | None:
    """Return the last task that isn't dealt with, or else the last task. ``origins`` are in the order of their ends."""
    return next((task for task in reversed(origins) if not task.dealt_with), origins[-1] if origins else None)


def walk(roots: Iterable[Node]) -> Iterator[tuple[int, Node]]:
    """Yield all tasks of trees with their depths from 0, each task before its children."""
    for root in roots:
        yield from root.walk()


class Tree:
    """All tasks of a plan or recording. Trees of the same records are equal. All methods are thread-safe.

    With more than ``limit`` tasks or ``size`` bytes of records, the tasks that ended first are dropped.
    """

    __hash__ = None  # type: ignore[assignment]  # mutable

    def __init__(self, limit: int | None = None, size: int | None = None) -> None:
        self.began: int | None = None  # task in which the plan's failure began; 0: outside of tasks; None: unknown
        self.output: dict[int, list[Output]] = {}  # printed and logged lines by task; empty for a running plan
        self._limit = math.inf if limit is None else limit
        self._size_limit = math.inf if size is None else size
        self._size = 0
        self._lock = threading.Lock()
        self._roots: dict[int, Node] = {}
        self._ended: deque[int] = deque()
        self.nodes: dict[int, Node] = {}  # all tasks, by id

    @property
    def roots(self) -> tuple[Node, ...]:
        """The outermost tasks, in the order of their start."""
        return tuple(sorted(self._roots.values(), key=attrgetter("id")))

    def apply(self, record: Task) -> Node:
        """Add the next record, and return its task."""
        number, phase, above = record.task, record.phase, record.parent
        size = record.ByteSize() if self._size_limit < math.inf else 0
        with self._lock:
            node = self.nodes.get(number)
            if node is None:
                parent = self.nodes.get(above)
                node = self.nodes[number] = Node(record, parent, record if phase == Task.ASKED else None)
                (self._roots if parent is None else parent.parts)[number] = node
            elif phase == Task.STARTED:
                node.started = record
            if phase == Task.FINISHED:
                node.finished = record
                self._ended.append(number)
            node.size += size
            self._size += size
            while (len(self.nodes) > self._limit or self._size > self._size_limit) and self._ended:
                self._forget(self._ended.popleft())
            return node

    def forget(self) -> None:
        """Drop the outermost tasks that have ended, with all tasks below them."""
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
        """Yield all tasks with their depths from 0, each task before its children."""
        return walk(self.roots)

    def find(self, *, kind: str | None = None, name: str | None = None, status: State | None = None) -> list[Node]:
        """Return the tasks with a kind, name and status, each task before its children. None matches everything."""
        return [
            node
            for _, node in self.walk()
            if kind in (None, node.kind) and name in (None, node.name) and status in (None, node.status)
        ]

    def failure_path(self) -> list[Node]:
        """Return the path to the failure that ended the plan, outermost task first; empty if there is none."""
        if self.began is not None:
            began = self.nodes.get(self.began)
        else:
            with self._lock:
                ended = [self.nodes[number] for number in self._ended if number in self.nodes]
            began = decisive([node for node in ended if node.is_origin])
        return list(began.around())[::-1] if began is not None else []

    def lines(self, depth: int | None = None, *, whole: bool = False) -> Iterator[str]:
        """Yield the lines of :func:`recorder.tasks.rendering.lines`."""
        return rendering.lines(self, depth, whole=whole)

    def text(self, depth: int | None = None, *, whole: bool = False) -> str:
        """Return the lines as a single string."""
        return "\n".join(self.lines(depth, whole=whole))

    def facts(self, depth: int | None = None) -> Iterator[dict[str, object]]:
        """Yield all tasks down to a depth as data for JSON; each task comes before its children."""
        return rendering.facts(self, depth)

    def to_json(self) -> str:
        """Return all tasks as JSON."""
        return json.dumps(list(self.facts()), ensure_ascii=False)

    def to_dot(self) -> str:
        """Return a graph for Graphviz."""
        return rendering.dot(self)

    def to_svg(self, depth: int | None = None, *, whole: bool = False) -> str:
        """Return a picture of the tree with its times as SVG."""
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

    def _repr_html_(self) -> str:
        return html.page(f"{len(self)} tasks", self.to_svg(rendering.depth_of(self, html.MAX_ROWS * 2)))


Lane: TypeAlias = tuple[int, int]  # depth of its tasks from 1, and number among the lanes of this depth from 0


class Lanes:
    """The lanes of the running tasks."""

    def __init__(self) -> None:
        self._running: dict[int, Lane] = {}
        self._taken: dict[int, set[int]] = {}  # occupied numbers of lanes, by depth

    def follow(self, record: Task) -> Lane | None:
        """Return the lane of a task at the task's start or end; None for other records."""
        if record.phase == Task.STARTED:
            parent = self._running.get(record.parent)
            depth = parent[0] + 1 if parent is not None else 1
            taken = self._taken.setdefault(depth, set())
            slot = next(slot for slot in range(len(taken) + 1) if slot not in taken)
            taken.add(slot)
            self._running[record.task] = depth, slot
            return depth, slot
        if record.phase == Task.FINISHED and (ended := self._running.pop(record.task, None)) is not None:
            self._taken[ended[0]].discard(ended[1])
            return ended
        return None
