"""The plan language (thesis 3.5.3, table 3.4): what runs at the same time, and what becomes of failures.

================ ========== =========================================== ===========================================
block            branches   is decided by                               fails with
================ ========== =========================================== ===========================================
``par``          at once    nothing: all run to their end               the failures of all that failed
``pursue``       at once    the first that ends, well or badly          the failure of that one
``try_all``      at once    the first that succeeds                     the failures of all, when all have failed
``seq``          in order   the first that fails                        the failure of that one
``try_in_order`` in order   the first that succeeds                     the failures of all, when all have failed
================ ========== =========================================== ===========================================

Each can be written in four ways::

    with par as s:                       # or par()
        ProcessModule.perform(parking)   # a branch
        s(function, argument)            # another one
        with seq:                        # a third one, in which things happen in order
            ProcessModule.perform(moving)
            ProcessModule.perform(looking)

    with par(failures) as s:             # failures go into a list; s.state tells whether there were any
        ...

    par(function, other)                 # the results, as a list

Each action, each block in the body and each ``s(...)`` is a branch. In a concurrent block and in ``try_in_order`` it
gives a handle that serves as its result (:mod:`pycram.handle`). In ``seq`` a failure rises through the body as in plain
Python, which may handle it. A block that is decided tells its other branches to stop: they do so at their next action
or wait, and the block ends when all its threads have. An empty block succeeds. A failure in the body ends the body; it
decides ``pursue``, and is one more of the failures elsewhere.

A failed block raises :class:`~pycram.failures.BranchesFailed` with all failures; usage errors come out as they are.
A block, a timeout, an attempt or a cleanup ends where it began, in the order of ``with`` statements
(:mod:`pycram.nesting`): a generator may yield in its body only to what is over when the generator goes on, as a context
manager's does.
Branches that need the same part of the robot queue in the order in which they are asked for (:mod:`pycram.claims`).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any, Final, TypeAlias, overload

from pycram.attempts import retry
from pycram.blocks import Block
from pycram.cleanup import finally_
from pycram.foundation.failures import BadArgument
from pycram.nested_blocks import nested
from pycram.nesting import Nested
from pycram.open_block import OpenBlock, Rule, current_block
from pycram.retries import failure_handling
from pycram.timeouts import timeout
from recorder.tasks import State
from recorder.tracing.call_site import call_site

__all__ = [
    "State",
    "failure_handling",
    "finally_",
    "par",
    "pursue",
    "retry",
    "seq",
    "timeout",
    "try_all",
    "try_in_order",
]

Result: TypeAlias = Any
Action: TypeAlias = Callable[..., Result]


class NeverOpened(RuntimeWarning):
    """A block was given a list for failures, and no body."""


class Opening(Nested[OpenBlock]):
    """Opens a block when a ``with`` statement begins; may be used again, in other threads and within itself."""

    def __init__(self, rule: Rule, failures: list[BaseException] | None = None) -> None:
        """Makes an opening.

        Args:
            rule: what kind of block.
            failures: where failures of its branches go; None to raise them.
        """
        super().__init__(rule.name)
        self._rule = rule
        self._failures = failures

    def _opened(self) -> OpenBlock:
        host = current_block()
        return Block(self._rule, self._failures) if host is None else nested(host, self._rule, self._failures)


class Collecting(Opening):
    """Opens a block whose failures go into a list; one that never does is a ``with`` that somebody forgot."""

    def __init__(self, rule: Rule, failures: list[BaseException]) -> None:
        """Makes an opening; see :class:`Opening`."""
        super().__init__(rule, failures)
        self._asked_for = call_site()
        self._used = False

    def __enter__(self) -> OpenBlock:
        self._used = True
        return super().__enter__()

    def __del__(self) -> None:
        if not self._used:
            told = f"{self._rule.name}(failures) opens no block; write `with {self._rule.name}(failures) as s:`"
            warnings.warn_explicit(told, NeverOpened, *self._asked_for)


class Nothing(Opening, list[Result]):
    """What ``par()`` gives: it opens a block; and it is the empty list of the results of ``par(*[])``."""

    def __init__(self, rule: Rule) -> None:
        """Makes an opening; see :class:`Opening`."""
        list.__init__(self)
        super().__init__(rule)


class Kind(Opening):
    """One of the five words: opens a block with or without parentheses, or runs functions."""

    @overload
    def __call__(self) -> Opening: ...
    @overload
    def __call__(self, failures: list[BaseException], /) -> Opening: ...
    @overload
    def __call__(self, *branches: Action) -> Result: ...
    def __call__(self, *branches: Action | list[BaseException]) -> Result:
        """Opens a block, or runs functions as its branches.

        Args:
            branches: nothing; one list, which gets the failures of the block's branches; or functions.

        Returns:
            What to use with ``with``; or the functions' results as a list, of ``pursue``, ``try_all`` and
            ``try_in_order`` the result of the one that decided it; in the body of a block a handle for that. Without
            functions what is given serves as both, as an empty list of results.

        Raises:
            BadArgument: something else.
            BranchesFailed: the block failed.
        """
        if not branches:
            return Nothing(self._rule)
        if len(branches) == 1 and isinstance(branches[0], list):
            return Collecting(self._rule, branches[0])
        actions = [branch for branch in branches if callable(branch)]
        if len(actions) != len(branches):
            wrong = next(branch for branch in branches if not callable(branch))
            raise BadArgument("branch", wrong, "a function, or one list for failures")
        host = current_block()
        return self._run(actions) if host is None else host.start(self._rule.name, lambda: self._run(actions))

    def _run(self, actions: list[Action]) -> Result:
        with Block(self._rule) as block:
            handles = [block(action) for action in actions]
        if self._rule.takes_one:
            return block.decider.result() if block.decider is not None else None
        return [handle.result() for handle in handles]

    def __repr__(self) -> str:
        return self._rule.name


par: Final = Kind(Rule("par", concurrent=True, decided_by=frozenset()))
"""Runs branches side by side to their ends; fails if any fails."""

pursue: Final = Kind(Rule("pursue", concurrent=True, decided_by=frozenset({State.SUCCEEDED, State.FAILED})))
"""Runs branches side by side; the first that ends decides, the others are cancelled."""

try_all: Final = Kind(Rule("try_all", concurrent=True, decided_by=frozenset({State.SUCCEEDED})))
"""Runs branches side by side; the first that succeeds decides, the others are cancelled."""

seq: Final = Kind(Rule("seq", concurrent=False, decided_by=frozenset({State.FAILED})))
"""Runs branches in order up to the first that fails."""

try_in_order: Final = Kind(Rule("try_in_order", concurrent=False, decided_by=frozenset({State.SUCCEEDED})))
"""Runs branches in order up to the first that succeeds."""
