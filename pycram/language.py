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
gives a handle that serves as its result (:mod:`pycram.branch`). In ``seq`` a failure rises through the body as in plain
Python, which may handle it. A block that is decided tells its other branches to
stop: they do so at their next action or wait, and the block ends when all its threads have. An empty block succeeds.

A failed block raises :class:`~pycram.failures.BranchesFailed` with all failures; usage errors come out as they are.
Branches that need the same part of the robot queue in the order in which they are asked for (:mod:`pycram.claims`).
"""

from __future__ import annotations

from collections.abc import Callable
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any, Final, TypeAlias, overload

from pycram.blocks import Block
from pycram.cleanup import finally_
from pycram.failures import BadArgument
from pycram.nested_blocks import nested
from pycram.open_block import OpenBlock, Rule, current_block
from pycram.retries import failure_handling, retry
from pycram.timeouts import timeout
from recorder.tasks import State

if TYPE_CHECKING:
    from types import TracebackType

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


class Opening:
    """Opens a block when a ``with`` statement begins; may be used again, in other threads and within itself."""

    _open: ContextVar[tuple[OpenBlock, ...]] = ContextVar("pycram_openings", default=())

    def __init__(self, rule: Rule, failures: list[BaseException] | None = None) -> None:
        """Makes an opening.

        Args:
            rule: what kind of block.
            failures: where failures of its branches go; None to raise them.
        """
        self._rule = rule
        self._failures = failures

    def __enter__(self) -> OpenBlock:
        host = current_block()
        block = Block(self._rule, self._failures) if host is None else nested(host, self._rule, self._failures)
        block.__enter__()
        self._open.set((*self._open.get(), block))
        return block

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool:
        *outer, block = self._open.get()
        self._open.set(tuple(outer))
        return block.__exit__(kind, error, trace)


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
            ``try_in_order`` the result of the one that decided it; in the body of a block a handle for that.

        Raises:
            BadArgument: something else.
            BranchesFailed: the block failed.
        """
        if not branches:
            return Opening(self._rule)
        if len(branches) == 1 and isinstance(branches[0], list):
            return Opening(self._rule, branches[0])
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
