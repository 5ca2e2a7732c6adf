"""Claims: which parts of the robot a motion needs, and the queue in which motions wait for them.

A robot's resources are its base, head, arms and grippers. A motion *moves* some of them, and needs some others *at
rest*: what it does would come out differently if they moved meanwhile. Two motions conflict if one moves what the other
moves or needs. A motion takes its place in the queue when it is asked for, gets all its claims at once, and gets them
as soon as no earlier motion conflicts with it. So conflicting motions run in the order in which the plan asks for them,
whichever thread is quicker; others run side by side; since each waits for earlier ones only, there is no deadlock.

What a motion needs is known for sure when it is resolved and its process module is chosen, which is when its turn has
come. Until then it claims what its designator says, or the whole robot if that says nothing. Then it puts its claims
right, *before* it moves anything. Where it needs more than it had, it gives up what it has, keeps its place, and waits
also for those later ones that run already. These wait for nobody here, so there is no deadlock in that either.

What this means for a ``par`` block as in the thesis' Listing 5.3 (park the arms, move the base, look at a place,
detect): the base starts when the arms are parked, since their posture decides whether the robot fits there; the head is
turned when the base has arrived, since it is to look at a place in the world; and detecting, which needs the whole
robot at rest, sees what the robot sees when all that was asked for before it is done. The order of the listing is its
meaning.
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

#: Stands among claims for all resources that there are, also those that nobody has named.
WHOLE: Final = "the whole robot"


class ClaimError(UsageError):
    """A motion that is part of another one wants more of the robot than that one has.

    It would have to wait while the outer motion holds the rest, and two of that kind would wait for each other for
    ever.

    Attributes:
        motion: what wants it.
        moves: what it moves and the outer motion doesn't.
        at_rest: what it needs at rest and the outer motion hasn't claimed at all.
        held: what the outer motion has.
    """

    def __init__(self, motion: str, beyond: Claims, held: Claims) -> None:
        super().__init__(
            f"{motion} {beyond}, but the motion that it is part of {held}; "
            "perform it before that one, or have claims() of that one's process module give the claims of both"
        )
        self.motion = motion
        self.moves = sorted(beyond.moves)
        self.at_rest = sorted(beyond.at_rest)
        self.held = held


@dataclass(frozen=True, slots=True)
class Claims:
    """What a motion needs of the robot.

    Attributes:
        moves: resources that it moves: "base", "head", "left-arm", "right-gripper", ..., or :data:`WHOLE`.
        at_rest: resources that must not move meanwhile.

    Raises:
        BadArgument: something else than names.
    """

    moves: AbstractSet[str] = frozenset()
    at_rest: AbstractSet[str] = frozenset()

    def __post_init__(self) -> None:
        """Takes any collection of names."""
        for field in ("moves", "at_rest"):
            names = getattr(self, field)
            if isinstance(names, str) or not isinstance(names, Iterable) or not all(isinstance(n, str) for n in names):
                raise BadArgument(field, names, 'names of resources, such as {"base", "left-arm"}')
            object.__setattr__(self, field, frozenset(names))

    def conflicts(self, other: Claims) -> bool:
        """Whether the two can't be granted at the same time."""
        return _meet(self.moves, other.moves | other.at_rest) or _meet(other.moves, self.at_rest)

    def beyond(self, outer: Claims) -> Claims:
        """What it needs and ``outer`` doesn't give."""
        return Claims(_without(self.moves, outer.moves), _without(self.at_rest, outer.moves | outer.at_rest))

    def __bool__(self) -> bool:
        return bool(self.moves or self.at_rest)

    def __str__(self) -> str:
        parts = (("moves", self.moves), ("needs at rest", self.at_rest))
        return " and ".join(f"{verb} {', '.join(sorted(names))}" for verb, names in parts if names) or "claims nothing"


EVERYTHING: Final = Claims(moves=frozenset({WHOLE}))
"""What a motion claims of which nothing is known."""


def _meet(one: AbstractSet[str], other: AbstractSet[str]) -> bool:
    return bool(one and other) if WHOLE in one or WHOLE in other else bool(one & other)


def _without(wanted: AbstractSet[str], given: AbstractSet[str]) -> AbstractSet[str]:
    return frozenset() if WHOLE in given else wanted - given


class Ticket:
    """A place in a queue; leave it when done, however that ended.

    Attributes:
        claims: what it stands for.
        motion: for what, in messages.
        granted: whether its turn has come.
    """

    def __init__(self, queue: ResourceQueue, claims: Claims, motion: str) -> None:
        """Makes a place that isn't taken yet; :meth:`ResourceQueue.ticket` does so."""
        self.claims = claims
        self.motion = motion
        self.granted = False
        self._queue = queue

    def arrive(self) -> None:
        """Takes the next place; doesn't wait. Leave it also where Ctrl-C keeps this from returning."""
        self._queue.arrive(self)

    @contextmanager
    def turn(self) -> Iterator[None]:
        """Takes its place if it has none, waits for its turn, runs its block, and leaves the queue.

        Raises:
            Cancelled: the branch has been told to stop while it waited; the place is given up then.
        """
        try:
            self.arrive()
            self._queue.wait(self)
            yield
        finally:
            self.leave()

    def change(self, claims: Claims | None) -> None:
        """Puts its claims right when its turn has come and nothing has been done yet; waits again if need be.

        Args:
            claims: what is needed; None: nobody knows, all that there is.

        Raises:
            ClaimError: it is part of a motion that doesn't hold all of this.
            Cancelled: the branch has been told to stop while it waited.
        """
        self._queue.change(self, claims)

    def leave(self) -> None:
        """Gives the place up; nothing happens if that was done already."""
        self._queue.leave(self)


class ResourceQueue:
    """Those who wait for parts of one robot, in order of arrival."""

    def __init__(self, outer: Claims = EVERYTHING) -> None:
        """Makes an empty queue.

        Args:
            outer: for the motions that one motion is made of: what that one holds.
        """
        self._outer = outer
        self._changed = Condition()
        self._lock = threading.Lock()
        self._tickets: list[Ticket] = []

    def ticket(self, claims: Claims | None, motion: str = "the motion") -> Ticket:
        """A place that isn't taken yet.

        Args:
            claims: what is needed; None: nobody knows, all that there is.
            motion: for what, in messages.

        Returns:
            The place; take it with :meth:`Ticket.arrive`, and wait with :meth:`Ticket.turn`.

        Raises:
            ClaimError: it is part of a motion that doesn't hold all of this.
        """
        return Ticket(self, self._given(claims, motion), motion)

    def arrive(self, ticket: Ticket) -> None:
        """Gives a ticket the next place, unless it has one; see :meth:`Ticket.arrive`."""
        with self._lock:
            if ticket not in self._tickets:
                self._tickets.append(ticket)

    def _given(self, claims: Claims | None, motion: str) -> Claims:
        if claims is None:
            return self._outer
        if not isinstance(claims, Claims):
            raise BadArgument(f"claims of {motion}", claims, "Claims, or None for all that there is")
        beyond = claims.beyond(self._outer)
        if beyond:
            raise ClaimError(motion, beyond, self._outer)
        return claims

    def wait(self, ticket: Ticket) -> None:
        """Waits until no earlier ticket conflicts, and no later one that has been granted.

        Args:
            ticket: a place in this queue.

        Raises:
            Cancelled: the branch has been told to stop.
        """
        wait(self._changed, lambda: self._grant(ticket))

    def _grant(self, ticket: Ticket) -> bool:
        earlier = True
        with self._lock:  # of two that fit to all others and not to each other one gets in
            for other in self._tickets:
                if other is ticket:
                    earlier = False
                elif (earlier or other.granted) and other.claims.conflicts(ticket.claims):
                    return False
            ticket.granted = True
        return True

    def change(self, ticket: Ticket, claims: Claims | None) -> None:
        """Gives a ticket other claims, in its place; see :meth:`Ticket.change`."""
        given = self._given(claims, ticket.motion)
        if given != ticket.claims:
            with self._lock:
                ticket.claims, ticket.granted = given, False
            self._changed.notify_all()
            self.wait(ticket)

    def leave(self, ticket: Ticket) -> None:
        """Gives a place up.

        Args:
            ticket: a place in this queue, or one that was.
        """
        with self._lock:
            known = ticket in self._tickets
            if known:
                self._tickets.remove(ticket)
        if known:
            self._changed.notify_all()
