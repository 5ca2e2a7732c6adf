"""Pulses: something happened to a fluent, whether or not that changed its value.

What pulses a term pulses all that is made of it. An account counts them until somebody handles them; each change counts
once, however many ways lead from what changed to the account.
"""

from __future__ import annotations

import weakref
from enum import Enum
from typing import TYPE_CHECKING, cast

from pycram.fluents.expressions import Ended, Leaf, lock, wake

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable

    from pycram.fluents.expressions import State, Term, Value


class Behavior(Enum):
    """What becomes of pulses that come while the body of a ``whenever`` is busy with an earlier one."""

    NEVER = 1
    """They are ignored."""
    ONCE = 2
    """The body runs once more for all of them."""
    ALWAYS = 3
    """The body runs once more for each of them."""


class Account(Leaf):
    """Counts the pulses of a term that nobody has handled; its value is True while there are any, else None.

    Attributes:
        missed: what becomes of pulses that come while an earlier one is handled.
    """

    __slots__ = ("missed",)

    def __init__(self, of: Term, missed: Behavior) -> None:
        super().__init__((of,), 0)
        self.missed = missed
        with lock:
            for term in _below(of):
                known = term.accounts if isinstance(term.accounts, weakref.WeakSet) else weakref.WeakSet()
                known.add(self)
                term.accounts = known

    def value(self, state: State) -> Value:
        """True if there are pulses to handle, else None."""
        return True if super().value(state) else None

    def text(self, depth: int = 0) -> str:
        """The text of its term, and that it is pulsed."""
        return f"{self.operands[0].text(depth + 1)}.pulsed({self.missed.name})"

    def take(self) -> None:
        """Begins to handle a pulse; without one nothing happens."""
        self._change(lambda count: max(count - 1, 0))

    def settle(self) -> None:
        """Ends what :meth:`take` began: decides about the pulses that came meanwhile."""
        if self.missed is not Behavior.ALWAYS:
            most = 1 if self.missed is Behavior.ONCE else 0
            self._change(lambda count: min(count, most))

    def _change(self, pulses: Callable[[int], int]) -> None:
        with lock:
            if not isinstance(self.held, Ended):
                self.held = pulses(self.held)
                wake((self,))


def _below(term: Term) -> list[Term]:
    """A term and all terms that its value comes from, each once; accounts have their own pulses."""
    found = {term: None}
    queue = [term]
    for one in queue:
        if not isinstance(one, Account):
            new = [operand for operand in one.operands if operand not in found]
            found.update(dict.fromkeys(new))
            queue += new
    return queue


def accounts_on(pulsed: Iterable[Term]) -> list[Account]:
    """The accounts that get a pulse when these terms do, each once; also those on accounts that get one by that."""
    queue = list(pulsed)
    given = len(queue)
    reached = set(queue)
    for term in queue:
        new = [account for account in term.accounts if account not in reached]
        reached.update(new)
        queue += new
    return cast("list[Account]", queue[given:])


def pulse(pulsed: Collection[Term]) -> None:
    """Counts one pulse in every account on these terms, and wakes who watches; the lock is held."""
    accounts = [account for account in accounts_on(pulsed) if not isinstance(account.held, Ended)]
    for account in accounts:
        account.held += 1
    wake((*pulsed, *accounts))
