"""Resources: the parts of the robot that a motion needs, and the queue in which motions wait for them.

A robot's resources are its base, head, arms and grippers. A motion *moves* some of them, and needs some others *at
rest*: its outcome would differ if they moved meanwhile. Two motions conflict if one moves what the other moves or
needs. A motion takes its place in the queue when it is requested, and is granted all its resources at once, as soon as
no earlier motion conflicts with it. So conflicting motions run in the order of the plan, others run concurrently, and
as each waits for earlier ones only, there is no deadlock.

The needs of a motion are certain when it is resolved and its process module is chosen, which is when its turn has come.
Until then it has those of its designator, or the whole robot if these are unknown. Then its resources are corrected,
*before* it moves anything. If it needs more, it releases what it has, keeps its place, and also waits for later motions
that run already. These wait for nothing in this queue, so there is still no deadlock.

Each world has a queue of its own, and a motion may perform others in another world. Where such motions would wait for
each other, the last one is refused.

In a ``par`` block as in the thesis' Listing 5.3 (park the arms, move the base, look at a place, detect), the base
starts when the arms are parked, as their posture decides whether the robot fits there; the head turns when the base
has arrived, as it looks at a place in the world; and detecting, which needs the whole robot at rest, comes last.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from pycram.foundation.failures import BadArgument, UsageError
from pycram.scheduling.cancellation import Binding, wait
from pycram.scheduling.schedule import Condition

if TYPE_CHECKING:
    from collections.abc import Iterator, Set as AbstractSet

#: Stands for all resources, also unnamed ones.
WHOLE_ROBOT: Final = "the whole robot"


class ResourceError(UsageError):
    """A motion that is part of another one needs more of the robot than that one has.

    If it waited for the rest, two such motions could wait for each other for ever.

    Attributes:
        motion: Name of the inner motion.
        moves: What it moves and the outer motion doesn't.
        at_rest: What it needs at rest and the outer motion doesn't have.
        held: The outer motion's resources.
    """

    def __init__(self, motion: str, excess: Resources, held: Resources) -> None:
        super().__init__(
            f"{motion} {excess}, but the motion that it is part of {held}; "
            "perform it before that one, or have resources() of that one's process module return those of both"
        )
        self.motion = motion
        self.moves = sorted(excess.moves)
        self.at_rest = sorted(excess.at_rest)
        self.held = held


class Deadlock(UsageError):
    """A motion waits for one that waits, in another world, for a motion that the first one is part of.

    Attributes:
        motion: Name of the motion that would wait.
        blocker: Name of the one that it would wait for.
    """

    def __init__(self, motion: str, blocker: str) -> None:
        super().__init__(
            f"{motion} can't wait for {blocker}, which waits for what {motion} is part of: each performs motions in "
            "the other's world; perform them there before or after the motion, or in a world that none else uses"
        )
        self.motion = motion
        self.blocker = blocker


@dataclass(frozen=True, slots=True)
class Resources:
    """What a motion needs of the robot.

    Attributes:
        moves: Names such as "base", "head", "left-arm", "right-gripper", ..., or :data:`WHOLE_ROBOT`.
        at_rest: Names of what must not move meanwhile.

    Raises:
        BadArgument: They aren't names.
    """

    moves: AbstractSet[str] = frozenset()
    at_rest: AbstractSet[str] = frozenset()

    def __post_init__(self) -> None:
        """Accepts any collection of names."""
        for field in ("moves", "at_rest"):
            names = getattr(self, field)
            if isinstance(names, str) or not isinstance(names, Iterable) or not all(isinstance(n, str) for n in names):
                raise BadArgument(field, names, 'names of resources, such as {"base", "left-arm"}')
            object.__setattr__(self, field, frozenset(names))

    def conflicts(self, other: Resources) -> bool:
        """Whether the two can't be granted at the same time."""
        return _overlap(self.moves, other.moves | other.at_rest) or _overlap(other.moves, self.at_rest)

    def beyond(self, outer: Resources) -> Resources:
        """Return what these have and ``outer`` doesn't."""
        return Resources(_without(self.moves, outer.moves), _without(self.at_rest, outer.moves | outer.at_rest))

    def __bool__(self) -> bool:
        return bool(self.moves or self.at_rest)

    def __str__(self) -> str:
        parts = (("moves", self.moves), ("needs at rest", self.at_rest))
        return " and ".join(f"{verb} {', '.join(sorted(names))}" for verb, names in parts if names) or "needs nothing"


EVERYTHING: Final = Resources(moves=frozenset({WHOLE_ROBOT}))
"""Resources of a motion of unknown needs."""


def _overlap(a: AbstractSet[str], b: AbstractSet[str]) -> bool:
    return bool(a and b) if WHOLE_ROBOT in a or WHOLE_ROBOT in b else bool(a & b)


def _without(needed: AbstractSet[str], given: AbstractSet[str]) -> AbstractSet[str]:
    return frozenset() if WHOLE_ROBOT in given else needed - given


class ResourceQueue:
    """Motions that wait for resources of one robot, in order of arrival.

    Args:
        outer: Resources of the motion that the queued ones are parts of.
    """

    def __init__(self, outer: Resources = EVERYTHING) -> None:
        self.changed = Condition()
        self.lock = threading.Lock()
        self.tickets: list[Ticket] = []
        self._outer = outer

    def within(self, resources: Resources | None, motion: str) -> Resources:
        """Return what a motion gets that requests resources; None requests all.

        Raises:
            ResourceError: The outer motion doesn't hold all of this.
            BadArgument: They aren't resources.
        """
        if resources is None:
            return self._outer
        if not isinstance(resources, Resources):
            raise BadArgument(f"resources of {motion}", resources, "Resources, or None for all that there is")
        excess = resources.beyond(self._outer)
        if excess:
            raise ResourceError(motion, excess, self._outer)
        return resources


#: The tickets that running code is part of, from the outside in.
_around: ContextVar[tuple[Ticket, ...]] = ContextVar("pycram_tickets", default=())


def forget_tickets() -> None:
    """Make this context part of no motion."""
    _around.set(())


class Ticket:
    """A motion's place in a queue, taken with :meth:`enqueue` and given up with :meth:`leave`.

    Args:
        queue: The queue.
        resources: What the motion needs; None for all.
        motion: Its name, for messages.

    Attributes:
        resources: What it requests.
        granted: Whether its turn has come.

    Raises:
        ResourceError: The outer motion doesn't hold all of this.
    """

    def __init__(self, queue: ResourceQueue, resources: Resources | None, motion: str = "the motion") -> None:
        self.resources = queue.within(resources, motion)
        self.granted = False
        self._queue = queue
        self._motion = motion
        self._outer = _around.get()
        self._waiting: dict[Ticket, None] = {}  # parts of this motion that wait for their turn

    def enqueue(self) -> None:
        """Take the last place, unless it has one, without waiting; leave it also if Ctrl-C interrupts this."""
        with self._queue.lock:
            if self not in self._queue.tickets:
                self._queue.tickets.append(self)

    @contextmanager
    def turn(self) -> Iterator[None]:
        """Enqueue if need be, wait for the turn, run the ``with`` block, and leave.

        Raises:
            Deadlock: It would wait for ever.
            Cancelled: The branch was cancelled while it waited.
        """
        try:
            self.enqueue()
            self._wait()
            with Binding(_around, (*self._outer, self)):
                yield
        finally:
            self.leave()

    def correct(self, resources: Resources | None) -> None:
        """Change the resources of a granted ticket before anything has moved; wait again if need be.

        Raises:
            ResourceError: The outer motion doesn't hold all of this.
            Deadlock: It would wait for ever.
            Cancelled: The branch was cancelled while it waited.
        """
        given = self._queue.within(resources, self._motion)
        if given != self.resources:
            with self._queue.lock:
                self.resources, self.granted = given, False
            self._queue.changed.notify_all()
            self._wait()

    def leave(self) -> None:
        """Give up the place, if it has one."""
        with self._queue.lock:
            queued = self in self._queue.tickets
            if queued:
                self._queue.tickets.remove(self)
        if queued:
            self._queue.changed.notify_all()

    def _wait(self) -> None:
        """Wait until no earlier ticket conflicts, and no granted later one."""
        for outer in self._outer:
            outer._waiting[self] = None  # noqa: SLF001  same class
        try:
            if not self._grant():
                self._refuse_deadlock()
                wait(self._queue.changed, self._grant)
        finally:
            for outer in self._outer:
                outer._waiting.pop(self, None)  # noqa: SLF001  same class

    def _grant(self) -> bool:
        with self._queue.lock:  # of two that conflict with each other only, one is granted
            self.granted = next(self._blockers(), None) is None
            return self.granted

    def _blockers(self) -> Iterator[Ticket]:
        """Yield the tickets that it has to wait for."""
        earlier = True
        for known in list(self._queue.tickets):
            if known is self:
                earlier = False
            elif (earlier or known.granted) and known.resources.conflicts(self.resources):
                yield known

    def _refuse_deadlock(self) -> None:
        reached = dict.fromkeys(self._blockers())
        pending = list(reached)
        for blocker in pending:
            if blocker is self or blocker in self._outer:
                raise Deadlock(self._motion, pending[0]._motion)  # noqa: SLF001  same class
            parts = list(blocker._waiting)  # noqa: SLF001  same class
            further = [ticket for part in parts for ticket in part._blockers() if ticket not in reached]  # noqa: SLF001
            reached.update(dict.fromkeys(further))
            pending += further
