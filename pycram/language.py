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
A block ends where it began, in the order of ``with`` statements: a generator may yield in its body only to what is over
when the generator goes on, as a context manager's does.
Branches that need the same part of the robot queue in the order in which they are asked for (:mod:`pycram.claims`).
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from contextvars import ContextVar
from inspect import CO_ASYNC_GENERATOR, CO_COROUTINE, CO_GENERATOR
from typing import TYPE_CHECKING, Any, Final, TypeAlias, overload

from pycram.blocks import Block
from pycram.cleanup import finally_
from pycram.failures import BadArgument, UsageError
from pycram.nested_blocks import nested
from pycram.open_block import OpenBlock, Rule, current_block
from pycram.retries import failure_handling, retry
from pycram.timeouts import timeout
from recorder.tasks import State
from recorder.way import plan_line

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


#: The frames of these can be left in the middle of a block and come back later.
_LEFT_AND_RESUMED: Final = CO_GENERATOR | CO_COROUTINE | CO_ASYNC_GENERATOR


class BlocksMixed(UsageError):
    """A block was ended while another one was open that had been opened after it.

    Attributes:
        block: what kind it is.
    """

    def __init__(self, block: str) -> None:
        super().__init__(
            f"a {block} block ends while one that was opened after it is open, or in another thread than it began; "
            "a generator that yields in the body of a block has to get to the block's end before others go on"
        )
        self.block = block


class NeverOpened(RuntimeWarning):
    """A block was given a list for failures, and no body."""


class Opening:
    """Opens a block when a ``with`` statement begins; may be used again, in other threads and within itself."""

    _open: ContextVar[tuple[tuple[int, OpenBlock], ...]] = ContextVar("pycram_openings", default=())

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
        try:
            self._open.set((*self._open.get(), (_generator(), block)))
        except BaseException as stopped:  # Ctrl-C: there will be no body
            block.__exit__(type(stopped), stopped, stopped.__traceback__)
            raise
        return block

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool:
        opened, generator = self._open.get(), _generator()
        if not opened or opened[-1][0] != generator:
            return self._end_mixed(opened, generator, error)
        self._open.set(opened[:-1])
        return opened[-1][1].__exit__(kind, error, trace)

    def _end_mixed(
        self, opened: tuple[tuple[int, OpenBlock], ...], generator: int, error: BaseException | None
    ) -> bool:
        """Ends all blocks up to the one that was opened here, and refuses what the plan does."""
        wrong = BlocksMixed(self._rule.name)
        place = max((place for place, (opener, _) in enumerate(opened) if opener == generator), default=len(opened))
        for kept, (_, block) in reversed(list(enumerate(opened[place:], place))):
            self._open.set(opened[:kept])
            block.__exit__(BlocksMixed, wrong, None)
        if error is not None and place == len(opened):  # one that was ended like that before
            return False
        raise wrong


def _generator() -> int:
    """Which generator's code opens or ends a block; 0 for code that is never left in the middle."""
    frame = sys._getframe(2)  # noqa: SLF001  inspect.currentframe() gives no other
    while frame.f_back is not None and frame.f_globals.get("__name__") == "contextlib":  # ExitStack
        frame = frame.f_back
    return id(frame) if frame.f_code.co_flags & _LEFT_AND_RESUMED else 0


class Collecting(Opening):
    """Opens a block whose failures go into a list; one that never does is a ``with`` that somebody forgot."""

    def __init__(self, rule: Rule, failures: list[BaseException]) -> None:
        """Makes an opening; see :class:`Opening`."""
        super().__init__(rule, failures)
        self._asked_for = plan_line()
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
