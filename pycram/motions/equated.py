"""Equated designators: descriptions of the same thing over time form a chain, oldest first (thesis 3.5.1).

Chains of different things get joined, so one lock guards them all; no other code runs while it is held.
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
        self._chain: list[Self] = [self]

    def equate(self, other: Self) -> None:
        """State that this describes the same as another one, and is newer than all of the other's chain.

        Raises:
            BadArgument: The other can't be equated.
        """
        if not isinstance(other, Equated):
            raise BadArgument("other", other, "something to equate with, such as a designator")
        with _lock:
            own, theirs = self._chain, other._chain
            if own is theirs:
                return
            index = own.index(self)
            theirs[:0] = own[:index]  # this one's predecessors come before all of the other's
            theirs += own[index:]
            for link in own:
                link._chain = theirs  # noqa: SLF001  same class

    def chain(self) -> list[Self]:
        """Return all that are equated with this one, and itself, the oldest first."""
        with _lock:
            return list(self._chain)

    def equal(self, other: Self) -> bool:
        """Whether another one is equated with this one."""
        with _lock:
            return isinstance(other, Equated) and self._chain is other._chain

    def first(self) -> Self:
        """Return the oldest of the chain."""
        return self.chain()[0]

    def current(self) -> Self:
        """Return the newest of the chain."""
        return self.chain()[-1]
