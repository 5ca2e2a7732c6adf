"""Resources: the parts of the robot that a motion needs, and the queue in which motions wait for these parts.

A motion *moves* some resources, and needs other resources *at rest*. Two motions conflict if one moves a resource that
the other moves or needs. A motion gets all its resources together, as soon as no earlier motion conflicts with it. So
conflicting motions run in the order of the plan, and no two motions of a queue wait for each other.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable, Iterator, Set as AbstractSet
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Final

from pycram.foundation.failures import BadArgument, UsageError
from pycram.scheduling.cancellation import Binding, wait
from pycram.scheduling.schedule import Condition
from recorder.tracing.context import current_name

WHOLE_ROBOT: Final = "the whole robot"  # the name that represents all resources of a robot


class ResourceError(UsageError):
    """An inner motion needs resources that the outer motion doesn't hold; waiting for them could be a deadlock."""

    def __init__(self, motion: str, excess: Resources, held: Resources) -> None:
        super().__init__(
            f"{motion} {excess}, but its outer motion {held}; perform {motion} before the outer motion, "
            "or let resources() of the outer motion's process module return the resources of both"
        )
        self.motion = motion  # name of the inner motion
        self.moves = sorted(excess.moves)  # resources that the inner motion moves and the outer motion doesn't hold
        self.at_rest = sorted(excess.at_rest)  # resources needed at rest by the inner motion only
        self.held = held  # the outer motion's resources


class Deadlock(UsageError):
    """A motion would wait for a motion in another world that waits for the outer motion of the first."""

    def __init__(self, motion: str, blocker: str) -> None:
        super().__init__(
            f"{motion} can't wait for {blocker}, which waits for the outer motion of {motion}: each outer motion "
            "performs a motion in the other's world; perform these motions before or after the outer motions, or in "
            "another world"
        )
        self.motion = motion  # name of the rejected motion
        self.blocker = blocker  # name of the motion for which the rejected motion would wait


@dataclass(frozen=True, slots=True)
class Resources:
    """The names of the resources that a motion needs; raises BadArgument for other values."""

    moves: AbstractSet[str] = frozenset()  # "base", "head", "left-arm", "right-gripper", ..., or WHOLE_ROBOT
    at_rest: AbstractSet[str] = frozenset()  # resources that must not move during the motion

    def __post_init__(self) -> None:
        for field in ("moves", "at_rest"):
            names = getattr(self, field)
            if isinstance(names, str) or not isinstance(names, Iterable) or not all(isinstance(n, str) for n in names):
                raise BadArgument(field, names, 'names of resources, such as {"base", "left-arm"}')
            object.__setattr__(self, field, frozenset(names))

    def conflicts(self, other: Resources) -> bool:
        """Return whether two motions with these resources can't run concurrently."""
        return _overlap(self.moves, other.moves | other.at_rest) or _overlap(other.moves, self.at_rest)

    def beyond(self, outer: Resources) -> Resources:
        """Return the resources that ``outer`` doesn't have."""
        return Resources(_without(self.moves, outer.moves), _without(self.at_rest, outer.moves | outer.at_rest))

    def __bool__(self) -> bool:
        return bool(self.moves or self.at_rest)

    def __str__(self) -> str:
        parts = (("moves", self.moves), ("needs at rest", self.at_rest))
        return " and ".join(f"{verb} {', '.join(sorted(names))}" for verb, names in parts if names) or "needs nothing"


EVERYTHING: Final = Resources(moves=frozenset({WHOLE_ROBOT}))  # the resources of a motion with unknown needs


def _overlap(a: AbstractSet[str], b: AbstractSet[str]) -> bool:
    return bool(a and b) if WHOLE_ROBOT in a or WHOLE_ROBOT in b else bool(a & b)


def _without(needed: AbstractSet[str], given: AbstractSet[str]) -> AbstractSet[str]:
    return frozenset() if WHOLE_ROBOT in given else needed - given


class ResourceQueue:
    """Motions that wait for resources of one robot, in order of arrival, within the resources ``outer``."""

    def __init__(self, outer: Resources = EVERYTHING) -> None:
        self.changed = Condition()
        self.lock = threading.Lock()
        self.tickets: list[Ticket] = []
        self._outer = outer

    def within(self, resources: Resources | None, motion: str) -> Resources:
        """Return the resources that a motion gets for its request; None stands for all resources.

        Raises:
            ResourceError: The outer motion doesn't hold all requested resources.
            BadArgument: ``resources`` has another type.
        """
        if resources is None:
            return self._outer
        if not isinstance(resources, Resources):
            raise BadArgument(f"resources of {motion}", resources, "Resources, or None for all resources")
        if WHOLE_ROBOT not in self._outer.moves and (excess := resources.beyond(self._outer)):
            raise ResourceError(motion, excess, self._outer)
        return resources


#: The tickets of the motions that this context runs, from the outermost to the innermost.
_around: ContextVar[tuple[Ticket, ...]] = ContextVar("pycram_tickets", default=())


def forget_tickets() -> None:
    """Forget the motions that this context runs."""
    _around.set(())


class Ticket:
    """A motion's place in a queue. :meth:`enqueue` takes a place in the queue, and :meth:`leave` gives the place up.

    The motion needs ``resources``; None stands for all resources. If the outer motion doesn't hold all needed
    resources, ResourceError is raised.
    """

    def __init__(self, queue: ResourceQueue, resources: Resources | None, motion: str = "the motion") -> None:
        self.resources = queue.within(resources, motion)
        self.granted = False  # whether the motion has its resources
        self._queue = queue
        self._motion = motion
        self._outer = _around.get()
        self._waiting: dict[Ticket, None] = {}  # parts of this motion that wait for their turn
        self._branch = current_name()  # name of the branch or thread that performs the motion

    def enqueue(self) -> None:
        """Take the last place in the queue, unless the motion already has a place; don't wait."""
        with self._queue.lock:
            if self not in self._queue.tickets:
                self._queue.tickets.append(self)

    @contextmanager
    def turn(self) -> Iterator[None]:
        """Enqueue if necessary, wait for the turn, run the ``with`` block, and leave.

        Raises:
            Deadlock: The motion would wait forever.
            Cancelled: The branch was cancelled during the wait.
        """
        try:
            self.enqueue()
            self._wait()
            with Binding(_around, (*self._outer, self)):
                yield
        finally:
            self.leave()

    def correct(self, resources: Resources | None) -> None:
        """Change the resources of a granted ticket before anything moves; if necessary, wait as :meth:`turn` does.

        The exact needs of a motion are known at its turn, when it is resolved and its process module is chosen.
        """
        given = self._queue.within(resources, self._motion)
        if given != self.resources:
            with self._queue.lock:
                self.resources, self.granted = given, False
            self._queue.changed.notify_all()
            self._wait()

    def leave(self) -> None:
        """Give up the place, if the motion has a place."""
        with self._queue.lock:
            queued = self in self._queue.tickets
            if queued:
                self._queue.tickets.remove(self)
        if queued:
            self._queue.changed.notify_all()

    def _wait(self) -> None:
        """Wait until no earlier ticket conflicts, nor a later ticket that already has its resources.

        Running motions don't wait for tickets of this queue, so there is no deadlock.
        """
        for outer in self._outer:
            outer._waiting[self] = None  # noqa: SLF001  same class
        try:
            if not self._grant():
                reached = dict.fromkeys(self._blockers())  # motions that must end before this motion can begin
                pending = list(reached)
                for blocker in pending:
                    if blocker is self or blocker in self._outer:
                        raise Deadlock(self._motion, pending[0]._motion)  # noqa: SLF001  same class
                    parts = list(blocker._waiting)  # noqa: SLF001  same class
                    further = [ticket for part in parts for ticket in part._blockers() if ticket not in reached]  # noqa: SLF001
                    reached.update(dict.fromkeys(further))
                    pending += further
                wait(self._queue.changed, self._grant, reason=self._reason)
        finally:
            for outer in self._outer:
                outer._waiting.pop(self, None)  # noqa: SLF001  same class

    def _grant(self) -> bool:
        with self._queue.lock:  # then only one of two conflicting tickets gets its resources
            self.granted = next(self._blockers(), None) is None
            return self.granted

    def _blockers(self) -> Iterator[Ticket]:
        earlier = True
        for known in list(self._queue.tickets):
            if known is self:
                earlier = False
            elif (earlier or known.granted) and known.resources.conflicts(self.resources):
                yield known

    def _reason(self) -> tuple[str, str, list[str]]:
        blockers = list(self._blockers())
        names = ", ".join(dict.fromkeys(blocker._motion for blocker in blockers))  # noqa: SLF001  same class
        what = f"the end of {names}, as {self._motion} {self.resources}"
        return what, "in", [blocker._branch for blocker in blockers]  # noqa: SLF001  as above
