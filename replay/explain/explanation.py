"""An explanation of a failure: what :func:`replay.explain.why.why` finds, for others to tell."""

from __future__ import annotations

import builtins
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from recorder.records import Failure, Query, Run
    from replay.explain.failed_tasks import Attempt
    from replay.explain.parsed_traceback import ParsedException
    from replay.explain.source import Line
    from replay.explain.summary import Summary
    from replay.state.diff import Difference
    from replay.state.state import Attachment, Body, World


@dataclass(frozen=True, slots=True)
class Thing:
    """A body that matters, at the moment that matters.

    Attributes:
        body: its state.
        held: how it is carried; None if it isn't.
        holds: what it carries.
        robot: whether it is the robot.
        distance: on the ground, from the robot's base, m; None for the robot itself, or without one.
        bearing: its direction from the robot's heading, rad, to the left; None as well.
    """

    body: Body
    held: Attachment | None
    holds: tuple[Attachment, ...]
    robot: bool
    distance: float | None
    bearing: float | None


@dataclass(frozen=True, slots=True)
class Try:
    """One time that something was tried.

    Attributes:
        task: the attempt.
        robot: the robot as it stood then; None if there was none. Of many attempts only the first and the last have it.
    """

    task: Attempt
    robot: Body | None


@dataclass(frozen=True, slots=True)
class Asked:
    """A query that the plan rested on.

    Attributes:
        query: its record.
        moved: what it was about and has moved between it and the failure.
        gone: what it was about and was removed since.
        world: the world that it was asked in, where that isn't the one of the failure; "" where it is.
    """

    query: Query
    moved: tuple[str, ...] = ()
    gone: tuple[str, ...] = ()
    world: str = ""

    @property
    def holds(self) -> bool:
        """Whether it is about what there was at the failure, and nothing of that has changed since."""
        return not (self.moved or self.gone or self.world)


@dataclass(frozen=True, slots=True)
class Since:
    """What has changed since something went well.

    Attributes:
        task: what went well.
        difference: of the states after it and before the failure.
    """

    task: Attempt
    difference: Difference


@dataclass(frozen=True, slots=True)
class Why:
    """The explanation of a failure.

    Attributes:
        run: how the whole run ended.
        step: the moment that is explained: that in which it failed.
        failure: what the plan failed with, or the task; None if nothing failed.
        thread: name of the plan's own thread that failed with it while the plan went on; "" if the plan did.
        raised: the exceptions that led to the plan's failure, causes first, with the plan's lines.
        task: the task in which it began; None if the plan's own code did it.
        way: the plan's lines that led to that task, outermost first.
        world: the world that it was about; None if none was open.
        is_default: whether that is the one that is meant where no world is named.
        things: the robot, and the bodies that it was about.
        absent: names of such bodies that weren't there any more.
        tries: all attempts of the same with the same objects, this one last.
        others: how many other tasks failed before.
        asked: the queries that it rested on, in their order.
        earlier: how many more queries were about the same.
        same: since the same kind of task went well for the last time; None if it never did.
        last: since anything went well for the last time.
        running: the innermost tasks that have not ended, of a recording that was cut.
        threads: the records of other threads of the plan's own that failed.
    """

    run: Summary
    step: int
    failure: Failure | None
    thread: str = ""
    raised: tuple[ParsedException, ...] = ()
    task: Attempt | None = None
    way: tuple[Line, ...] = ()
    world: World | None = None
    is_default: bool = True
    things: tuple[Thing, ...] = ()
    absent: tuple[str, ...] = ()
    tries: tuple[Try, ...] = ()
    others: int = 0
    asked: tuple[Asked, ...] = ()
    earlier: int = 0
    same: Since | None = None
    last: Since | None = None
    running: tuple[Attempt, ...] = ()
    threads: tuple[Run, ...] = ()

    @property
    def is_of_python(self) -> bool:
        """Whether the plan's code itself is wrong, rather than that something in the world was not as it should be."""
        return self.task is None and self.failure is not None and hasattr(builtins, self.failure.type)

    @property
    def warning(self) -> Query | None:
        """The last query that said no, and still was so: nothing that it was about has moved since."""
        told = (asked.query for asked in reversed(self.asked) if asked.holds)
        return next((query for query in told if query.answer_json == "false"), None)


def heading(body: Body) -> float:
    """Where a body faces on the ground, rad from the world's x axis.

    Args:
        body: its state.
    """
    x, y, z, w = body.orientation
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
