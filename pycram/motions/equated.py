"""Equating: things that describe the same over time form a chain, from the first to the current one (thesis 3.5.1).

Chains of different things get joined, so one lock guards them all; it is held for a few steps at most, and never while
other code runs.
"""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

from pycram.foundation.failures import BadArgument

if TYPE_CHECKING:
    from typing import Self

_lock = threading.Lock()


class Equated:
    """A link of such a chain; alone at first."""

    def __init__(self: Self) -> None:
        """Begins a chain of its own."""
        self._chain: list[Self] = [self]

    def equate(self, other: Self) -> None:
        """Says that this describes the same as another one, and is newer than all that are equated with that.

        Args:
            other: any; nothing happens if they are equated already.

        Raises:
            BadArgument: it is something else.
        """
        if not isinstance(other, Equated):
            raise BadArgument("other", other, "something to equate with, such as a designator")
        with _lock:
            own, theirs = self._chain, other._chain
            if own is theirs:
                return
            place = own.index(self)
            theirs[:0] = own[:place]  # what this was equated with comes before all of the other's
            theirs += own[place:]
            for one in own:
                one._chain = theirs  # noqa: SLF001  same class

    def chain(self) -> list[Self]:
        """All that are equated with this one, and itself, the oldest first."""
        with _lock:
            return list(self._chain)

    def equal(self, other: Self) -> bool:
        """Whether another one is equated with this one."""
        with _lock:
            return isinstance(other, Equated) and self._chain is other._chain

    def first(self) -> Self:
        """The oldest of those that are equated with this one."""
        return self.chain()[0]

    def current(self) -> Self:
        """The newest of those that are equated with this one."""
        return self.chain()[-1]
