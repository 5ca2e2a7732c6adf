"""The data of an explained failure: what :func:`replay.explain.causes.why.why` returns."""

from __future__ import annotations

import builtins
import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

    from recorder.geometry import Pose
    from recorder.records import Failure, Query, Run
    from recorder.tasks import Node
    from replay.compare.states import Difference
    from replay.explain.causes.cause import Cause
    from replay.explain.tried import TriedAction
    from replay.history.source import Line, ParsedException
    from replay.history.summary import Summary
    from replay.state.state import Attachment, Body, World


@dataclass(frozen=True, slots=True)
class InvolvedBody:
    """The robot, or a body that a failed task was about, at the moment of the failure.

    Attributes:
        body: its state.
        held: how it is carried; None if it isn't.
        holds: what it carries.
        is_robot: whether it is the robot.
        hands: by what it is held, or holds with: the names of the robot's arms, by the held bodies' names.
        links: poses of those of its links that the failure names, by their names.
        joints: values of those of its joints that the failure names, rad or m.
        distance: on the ground, from the robot's base, m; None for the robot itself, or without one.
        bearing: its direction from the robot's heading, rad, to the left; None as well.
    """

    body: Body
    held: Attachment | None
    holds: tuple[Attachment, ...]
    is_robot: bool
    distance: float | None
    bearing: float | None
    hands: Mapping[str, str] = field(default_factory=dict)
    links: Mapping[str, Pose] = field(default_factory=dict)
    joints: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class FailedBranch:
    """Another part of the same block in which a failure began, too.

    Attributes:
        task: that task.
        line: the plan's line that asked for it; None if that isn't known.
        bodies: the robot, and what that failure was about, at its moment.
        causes: of that failure.
    """

    task: Node
    line: Line | None
    bodies: tuple[InvolvedBody, ...]
    causes: tuple[Cause, ...]


@dataclass(frozen=True, slots=True)
class Attempt:
    """One attempt at the failed task.

    Attributes:
        task: the part of it in which its failure began.
        robot: the robot before it; None if there was none. Of many attempts only the first and the last have it.
    """

    task: Node
    robot: Body | None


@dataclass(frozen=True, slots=True)
class RelevantQuery:
    """A query that the plan relied on.

    Attributes:
        query: its record.
        moved: names of its bodies that have moved between it and the failure.
        removed: names of its bodies that were removed since.
        world: the world that it was asked in, where that isn't the one of the failure; "" where it is.
    """

    query: Query
    moved: tuple[str, ...] = ()
    removed: tuple[str, ...] = ()
    world: str = ""

    @property
    def holds(self) -> bool:
        """Whether its bodies were the same at the failure, and had not changed."""
        return not (self.moved or self.removed or self.world)


@dataclass(frozen=True, slots=True)
class ChangesSince:
    """What has changed since a task succeeded.

    Attributes:
        task: the task that succeeded.
        difference: between the states after it and before the failure.
    """

    task: Node
    difference: Difference


@dataclass(frozen=True, slots=True)
class Why:
    """The explanation of a failure.

    Attributes:
        run: how the whole run ended.
        step: the moment that is explained: that in which it failed.
        failure: what the plan failed with, or the task; None if nothing failed.
        thread: name of the plan's own thread that failed while the plan went on; "" if the plan did.
        causes: what made it fail, those that explain most first.
        branches: the other failures that failed the same block.
        exceptions: those that led to the plan's failure, causes first, with the plan's lines.
        task: the task in which it began; None if the plan's own code failed.
        call_stack: the plan's lines that led to that task, outermost first.
        variables: local variables of the plan's functions at the failure, by file and line: names, and values as text.
        world: the world that the task was about; None if none was open.
        is_default: whether that is the world that is meant where none is named.
        bodies: the robot, and the bodies that the task was about.
        removed: names of such bodies that were removed before the failure.
        attempts: all attempts of the same with the same objects, this one last.
        other_failures: number of other tasks that failed before.
        forgotten: number of failures before those, which weren't looked at, as there are too many.
        choices: the queries with which the failed motion's process module chose what to do, in their order.
        tried: what the action tried that the task is a part of; None if it is part of none.
        queries: those that the plan relied on, in their order.
        earlier_queries: number of further queries about the same.
        since_same_success: changes since the same kind of task succeeded for the last time; None if it never did.
        since_last_success: changes since anything succeeded for the last time.
        unfinished: the innermost tasks that have not ended, of a recording that was cut.
        endless: the innermost tasks without an end, where that may be among records that are lost.
        failed_threads: the records of other threads of the plan's own that failed.
    """

    run: Summary
    step: int
    failure: Failure | None
    causes: tuple[Cause, ...] = ()
    branches: tuple[FailedBranch, ...] = ()
    thread: str = ""
    exceptions: tuple[ParsedException, ...] = ()
    task: Node | None = None
    call_stack: tuple[Line, ...] = ()
    variables: Mapping[tuple[str, int], Mapping[str, str]] = field(default_factory=dict)
    world: World | None = None
    is_default: bool = True
    bodies: tuple[InvolvedBody, ...] = ()
    removed: tuple[str, ...] = ()
    attempts: tuple[Attempt, ...] = ()
    other_failures: int = 0
    forgotten: int = 0
    choices: tuple[Query, ...] = ()
    tried: TriedAction | None = None
    queries: tuple[RelevantQuery, ...] = ()
    earlier_queries: int = 0
    since_same_success: ChangesSince | None = None
    since_last_success: ChangesSince | None = None
    unfinished: tuple[Node, ...] = ()
    endless: tuple[Node, ...] = ()
    failed_threads: tuple[Run, ...] = ()

    @property
    def is_python_error(self) -> bool:
        """Whether the plan's code itself is wrong, rather than the world not being as it should be."""
        return self.task is None and self.failure is not None and hasattr(builtins, self.failure.type)

    @property
    def warning(self) -> Query | None:
        """The last query of the plan whose answer was no, and whose bodies have not changed since."""
        within = self.task.id if self.task is not None and self.task.kind == "process-module" else None  # its own
        still_true = (relevant.query for relevant in reversed(self.queries) if relevant.holds)
        return next(
            (query for query in still_true if query.answer_json == "false" and query.task != within),
            None,
        )


def heading(body: Body) -> float:
    """Return the direction that a body faces on the ground, rad from the world's x axis."""
    x, y, z, w = body.orientation
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
