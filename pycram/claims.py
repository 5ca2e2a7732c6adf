"""Claims: which parts of the robot a motion needs, and the queue in which motions wait for them.

A robot's resources are its base, head, arms and grippers. A motion *moves* some of them, and needs some others *at
rest*: what it does would come out differently if they moved meanwhile. Two motions conflict if one moves what the other
moves or needs. A motion takes its place in the queue when it is asked for, gets all its claims at once, and gets them
as soon as no earlier motion conflicts with it. So conflicting motions run in the order in which the plan asks for them,
whichever thread is quicker; others run side by side; since each waits for earlier ones only, there is no deadlock.

What this means for a ``par`` block as in the thesis' Listing 5.3 (park the arms, move the base, look at a place,
detect): the base starts when the arms are parked, since their posture decides whether the robot fits there; the head is
turned when the base has arrived, since it is to look at a place in the world; and detecting, which needs the whole
robot at rest, sees what the robot sees when all that was asked for before it is done. The order of the listing is its
meaning.
"""

from __future__ import annotations

import itertools
import threading
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pycram.cancellation import wait
from pycram.failures import UsageError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator


class ClaimError(UsageError):
    """A motion that is part of another one wants more of the robot than that one has.

    It would have to wait while the outer motion holds the rest, and two of that kind would wait for each other for
    ever.

    Attributes:
        motion: what wants it.
        wanted: the resources that the outer motion doesn't have.
        held: those that it has.
    """

    def __init__(self, motion: str, wanted: Iterable[str], held: Claims) -> None:
        self.motion = motion
        self.wanted = sorted(wanted)
        self.held = sorted(held.moves | held.at_rest)
        super().__init__(
            f"{motion} needs {', '.join(self.wanted)}, but the motion that it is part of has claimed only "
            f"{', '.join(self.held)}; perform it before, or give the outer designator the claims of both"
        )


@dataclass(frozen=True, slots=True)
class Claims:
    """What a motion needs of the robot.

    Attributes:
        moves: resources that it moves ("base", "head", "left-arm", "right-gripper", ...).
        at_rest: resources that must not move meanwhile.
    """

    moves: frozenset[str] = frozenset()
    at_rest: frozenset[str] = frozenset()

    def conflicts(self, other: Claims) -> bool:
        """Whether the two can't be granted at the same time."""
        return bool(self.moves & (other.moves | other.at_rest) or other.moves & self.at_rest)

    def beyond(self, outer: Claims) -> frozenset[str]:
        """The resources that it needs and that ``outer`` doesn't give."""
        return (self.moves - outer.moves) | (self.at_rest - outer.at_rest - outer.moves)

    def __bool__(self) -> bool:
        return bool(self.moves or self.at_rest)


class Ticket:
    """A place in a queue, taken; leave it when done, however that ended."""

    def __init__(self, queue: ResourceQueue, number: int, claims: Claims) -> None:
        self.claims = claims
        self.number = number
        self._queue = queue

    @contextmanager
    def granted(self) -> Iterator[None]:
        """Waits for its turn, runs its block, and leaves the queue.

        Raises:
            Cancelled: the branch has been told to stop while it waited; the place is given up then.
        """
        try:
            self._queue.wait(self)
            yield
        finally:
            self.leave()

    def leave(self) -> None:
        """Gives the place up; nothing happens if that was done already."""
        self._queue.leave(self)


class ResourceQueue:
    """Those who wait for parts of one robot, in order of arrival."""

    def __init__(self, outer: Claims | None = None) -> None:
        """Makes an empty queue.

        Args:
            outer: for the motions that one motion is made of: what that one holds. None: the whole robot.
        """
        self._outer = outer
        self._changed = threading.Condition()
        self._numbers = itertools.count()
        self._tickets: list[Ticket] = []

    def arrive(self, claims: Claims, motion: str = "the motion") -> Ticket:
        """Takes the next place; doesn't wait.

        Args:
            claims: what is needed.
            motion: for what, in messages.

        Returns:
            The place; wait with :meth:`Ticket.granted`.

        Raises:
            ClaimError: it is part of a motion that doesn't hold all of this.
        """
        if self._outer is not None and (missing := claims.beyond(self._outer)):
            raise ClaimError(motion, missing, self._outer)
        with self._changed:
            ticket = Ticket(self, next(self._numbers), claims)
            self._tickets.append(ticket)
        return ticket

    def wait(self, ticket: Ticket) -> None:
        """Waits until no earlier ticket conflicts.

        Args:
            ticket: a place in this queue.

        Raises:
            Cancelled: the branch has been told to stop.
        """
        wait(self._changed, lambda: self._free(ticket))

    def _free(self, ticket: Ticket) -> bool:
        for earlier in self._tickets:
            if earlier is ticket:
                return True
            if earlier.claims.conflicts(ticket.claims):
                return False
        return True

    def leave(self, ticket: Ticket) -> None:
        """Gives a place up.

        Args:
            ticket: a place in this queue, or one that was.
        """
        with self._changed:
            if ticket in self._tickets:
                self._tickets.remove(ticket)
                self._changed.notify_all()
