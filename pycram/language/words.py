"""The five words of the plan language: each opens a block, or runs functions as its branches."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any, Final, TypeAlias, overload

from pycram.foundation.failures import BadArgument
from pycram.language.block import Block, Policy
from pycram.language.body import current_block
from pycram.language.nesting import Scope
from pycram.language.read_block import ReadBlock
from recorder.tasks import State
from recorder.tracing.call_stack import call_site

Result: TypeAlias = Any
Action: TypeAlias = Callable[..., Result]


class NeverOpened(RuntimeWarning):
    """A block got a list for failures, and no body."""


class Opening(Scope[Block]):
    """Opens a block at the start of a ``with`` statement; reusable, in other threads and within itself.

    Warns with NeverOpened if it is to collect failures, and no ``with`` statement ever used it.

    Args:
        policy: The kind of block.
        failures: Collects the failures of the branches; without a list, they are raised.
    """

    def __init__(self, policy: Policy, failures: list[BaseException] | None = None) -> None:
        super().__init__(policy.name)
        self._policy = policy
        self._failures = failures
        self._unused_at = None if failures is None else call_site()

    def _opened(self) -> Block:
        self._unused_at = None
        host = current_block()
        if host is not None and host.reads_blocks:
            return ReadBlock(self._policy, host, self._failures)
        return Block(self._policy, self._failures)

    def __del__(self) -> None:
        if self._unused_at is not None:
            text = f"{self._policy.name}(failures) opens no block; write `with {self._policy.name}(failures) as s:`"
            warnings.warn_explicit(text, NeverOpened, *self._unused_at)


class Nothing(Opening, list[Result]):
    """Value of ``par()``: opens a block, and is the empty list of the results of ``par(*[])``."""

    def __init__(self, policy: Policy) -> None:
        list.__init__(self)
        super().__init__(policy)


class Kind(Opening):
    """One of the five words: opens a block with or without parentheses, or runs functions."""

    @overload
    def __call__(self) -> Opening: ...
    @overload
    def __call__(self, failures: list[BaseException], /) -> Opening: ...
    @overload
    def __call__(self, *branches: Action) -> Result: ...
    def __call__(self, *branches: Action | list[BaseException]) -> Result:
        """Open a block, or run functions as its branches.

        Args:
            branches: Nothing; one list, which collects the failures of the block's branches; or functions.

        Returns:
            Without functions, a context manager. With functions, the list of their results; for ``pursue``, ``try_all``
            and ``try_in_order`` the result of the deciding one; in the body of a block, a future for that.

        Raises:
            BadArgument: A branch isn't one of these.
            BranchesFailed: The block failed.
        """
        if not branches:
            return Nothing(self._policy)
        if len(branches) == 1 and isinstance(branches[0], list):
            return Opening(self._policy, branches[0])
        actions = [branch for branch in branches if callable(branch)]
        if len(actions) != len(branches):
            wrong = next(branch for branch in branches if not callable(branch))
            raise BadArgument("branch", wrong, "a function, or one list for failures")
        host = current_block()
        return self._run(actions) if host is None else host.start(self._policy.name, lambda: self._run(actions))

    def _run(self, actions: list[Action]) -> Result:
        with self as block:
            futures = [block(action) for action in actions]
        if self._policy.first_success:
            return block.decider.result() if block.decider is not None else None
        return [future.result() for future in futures]

    def __repr__(self) -> str:
        return self._policy.name


par: Final = Kind(Policy("par", concurrent=True, decided_by=frozenset()))
"""Run branches concurrently to their ends; fail if any fails."""

pursue: Final = Kind(Policy("pursue", concurrent=True, decided_by=frozenset({State.SUCCEEDED, State.FAILED})))
"""Run branches concurrently; the first that ends decides, the others are cancelled."""

try_all: Final = Kind(Policy("try_all", concurrent=True, decided_by=frozenset({State.SUCCEEDED})))
"""Run branches concurrently; the first that succeeds decides, the others are cancelled."""

seq: Final = Kind(Policy("seq", concurrent=False, decided_by=frozenset({State.FAILED})))
"""Run branches in order up to the first that fails."""

try_in_order: Final = Kind(Policy("try_in_order", concurrent=False, decided_by=frozenset({State.SUCCEEDED})))
"""Run branches in order up to the first that succeeds."""
