"""Resources: which parts of the robot a motion needs, and the queue in which motions wait for them.

A robot's resources are its base, head, arms and grippers. A motion *moves* some of them, and needs some others *at
rest*: it would come out differently if they moved meanwhile. Two motions conflict if one moves what the other moves or
needs. A motion takes its place in the queue when it is asked for, gets all its resources at once, and gets them as soon
as no earlier motion conflicts with it. So conflicting motions run in the order in which the plan asks for them, others
run concurrently, and since each waits for earlier ones only, there is no deadlock.

What a motion needs is certain when it is resolved and its process module is chosen, which is when its turn has come.
Until then it has what its designator says, or the whole robot if that says nothing. Then its resources are corrected,
*before* it moves anything. Where it needs more than it had, it gives up what it has, keeps its place, and waits also
for those later ones that run already. These wait for nobody here, so there is no deadlock in that either.

For a ``par`` block as in the thesis' Listing 5.3 (park the arms, move the base, look at a place, detect) this means:
the base starts when the arms are parked, since their posture decides whether the robot fits there; the head turns when
the base has arrived, since it is to look at a place in the world; and detecting, which needs the whole robot at rest,
sees what the robot sees when all that was asked for before is done. The order of the listing is its meaning.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from pycram.foundation.failures import BadArgument, UsageError
from pycram.scheduling.cancellation import Condition, wait

if TYPE_CHECKING:
    from collections.abc import Iterator
    from collections.abc import Set as AbstractSet

#: Stands for all resources, also those that nobody has named.
WHOLE_ROBOT: Final = "the whole robot"


class ResourceError(UsageError):
    """A motion that is part of another one needs more of the robot than that one has.

    It would have to wait while the outer motion holds the rest, and two of that kind would wait for each other for
    ever.

    Attributes:
        motion: what needs it.
        moves: what it moves and the outer motion doesn't.
        at_rest: what it needs at rest and the outer motion hasn't got at all.
        held: what the outer motion has.
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


@dataclass(frozen=True, slots=True)
class Resources:
    """What a motion needs of the robot.

    Attributes:
        moves: what it moves: "base", "head", "left-arm", "right-gripper", ..., or :data:`WHOLE_ROBOT`.
        at_rest: what must not move meanwhile.

    Raises:
        BadArgument: something else than names.
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
        """What is in these and not in ``outer``."""
        return Resources(_without(self.moves, outer.moves), _without(self.at_rest, outer.moves | outer.at_rest))

    def __bool__(self) -> bool:
        return bool(self.moves or self.at_rest)

    def __str__(self) -> str:
        parts = (("moves", self.moves), ("needs at rest", self.at_rest))
        return " and ".join(f"{verb} {', '.join(sorted(names))}" for verb, names in parts if names) or "needs nothing"


EVERYTHING: Final = Resources(moves=frozenset({WHOLE_ROBOT}))
"""What a motion has of which nothing is known."""


def _overlap(a: AbstractSet[str], b: AbstractSet[str]) -> bool:
    return bool(a and b) if WHOLE_ROBOT in a or WHOLE_ROBOT in b else bool(a & b)


def _without(needed: AbstractSet[str], given: AbstractSet[str]) -> AbstractSet[str]:
    return frozenset() if WHOLE_ROBOT in given else needed - given


class ResourceQueue:
    """Motions that wait for parts of one robot, in order of arrival.

    Args:
        outer: for the motions that one motion is made of: what that one holds.
    """

    def __init__(self, outer: Resources = EVERYTHING) -> None:
        self.changed = Condition()
        self.lock = threading.Lock()
        self.tickets: list[Ticket] = []
        self._outer = outer

    def within(self, resources: Resources | None, motion: str) -> Resources:
        """What a motion gets that asks for resources.

        Args:
            resources: what it needs; None if nobody knows, for all that there is.
            motion: its name, in messages.

        Raises:
            ResourceError: it is part of a motion that doesn't hold all of this.
            BadArgument: something else than resources.
        """
        if resources is None:
            return self._outer
        if not isinstance(resources, Resources):
            raise BadArgument(f"resources of {motion}", resources, "Resources, or None for all that there is")
        excess = resources.beyond(self._outer)
        if excess:
            raise ResourceError(motion, excess, self._outer)
        return resources


class Ticket:
    """A place in a queue, taken with :meth:`enqueue`; leave it when done, however that ended.

    Args:
        queue: the queue.
        resources: what is needed; None if nobody knows, for all that there is.
        motion: for what, in messages.

    Attributes:
        resources: what it stands for.
        granted: whether its turn has come.

    Raises:
        ResourceError: it is for part of a motion that doesn't hold all of this.
    """

    def __init__(self, queue: ResourceQueue, resources: Resources | None, motion: str = "the motion") -> None:
        self.resources = queue.within(resources, motion)
        self.granted = False
        self._queue = queue
        self._motion = motion

    def enqueue(self) -> None:
        """Take the next place, unless it has one; doesn't wait.

        Leave it also where Ctrl-C keeps this from returning.
        """
        with self._queue.lock:
            if self not in self._queue.tickets:
                self._queue.tickets.append(self)

    @contextmanager
    def turn(self) -> Iterator[None]:
        """Take its place if it has none, wait for its turn, run the block, and leave the queue.

        Raises:
            Cancelled: the branch was cancelled while it waited; the place is given up then.
        """
        try:
            self.enqueue()
            self._wait()
            yield
        finally:
            self.leave()

    def correct(self, resources: Resources | None) -> None:
        """Change its resources when its turn has come and nothing has been done yet; waits again if need be.

        Args:
            resources: what is needed; None if nobody knows, for all that there is.

        Raises:
            ResourceError: it is for part of a motion that doesn't hold all of this.
            Cancelled: the branch was cancelled while it waited.
        """
        given = self._queue.within(resources, self._motion)
        if given != self.resources:
            with self._queue.lock:
                self.resources, self.granted = given, False
            self._queue.changed.notify_all()
            self._wait()

    def leave(self) -> None:
        """Give the place up; nothing happens if it has none."""
        with self._queue.lock:
            known = self in self._queue.tickets
            if known:
                self._queue.tickets.remove(self)
        if known:
            self._queue.changed.notify_all()

    def _wait(self) -> None:
        """Wait until no earlier ticket conflicts, and no later one that has been granted."""
        wait(self._queue.changed, self._grant)

    def _grant(self) -> bool:
        earlier = True
        with self._queue.lock:  # of two that fit to all others and not to each other one gets in
            for other in self._queue.tickets:
                if other is self:
                    earlier = False
                elif (earlier or other.granted) and other.resources.conflicts(self.resources):
                    return False
            self.granted = True
        return True
