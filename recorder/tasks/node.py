"""A node of the task tree: a task's kind, name, status, times and failure, from its records.

Children are in the order in which they were requested, which is that of their ids.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum, IntEnum
from functools import lru_cache
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Final

from recorder.records import STEPS_PER_SECOND, Task, argument_values

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from recorder.records import Decision, Failure, Plain, Query


BY_ID: Final = attrgetter("id")


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
