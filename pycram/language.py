"""The plan language (thesis 3.5.3, table 3.4): what runs at the same time, and what becomes of failures.

``par`` runs its branches side by side and fails if any of them fails::

    with par as s:
        ProcessModule.perform(parking)
        ProcessModule.perform(moving)
        s(function, argument)

Each ``perform`` and each ``s(...)`` is one branch in a thread of its own and gives a handle that serves as its result.
The block ends when all its threads have ended. Branches that need the same part of the robot queue in the order in
which they are asked for (:mod:`pycram.claims`).
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any, TypeAlias, cast

from pycram.branch import Branch, Handle, State
from pycram.cancellation import Cancelled, Scope, checkpoint, current_scope, entered
from pycram.error_chain import chained
from pycram.event import qualified_name
from pycram.failures import BadArgument, BranchesFailed, PlanFailure
from recorder.span import span

if TYPE_CHECKING:
    from types import TracebackType

    from typing_extensions import Self

    from recorder.span import Span

__all__ = ["State", "par"]

Result: TypeAlias = Any
Action: TypeAlias = Callable[..., Result]

_block: ContextVar[Block | None] = ContextVar("pycram_block", default=None)


def current_block() -> Block | None:
    """The block whose body is being run here; None inside of a branch, where things happen one after the other."""
    return _block.get()


class Block:
    """A concurrent block while it is open.

    Attributes:
        name: "par".
        state: how far it is, or how it ended.
        branches: its branches in the order in which they were asked for.
    """

    def __init__(self, name: str, failures: list[BaseException] | None = None) -> None:
        """Makes a block.

        Args:
            name: what it is called in the task tree.
            failures: where failures of its branches go; None to raise them.
        """
        self.name = name
        self.state = State.CREATED
        self.branches: list[Branch] = []
        self._failures = failures
        self._scope = Scope(current_scope())
        self._exits = ExitStack()
        self._span: Span | None = None

    def __call__(self, action: Action, *args: object, **kwargs: object) -> Handle:
        """Starts a branch.

        Args:
            action: a function.
            args: its arguments.
            kwargs: its named arguments.

        Returns:
            A handle that serves as its result.

        Raises:
            BadArgument: it can't be called.
        """
        if not callable(action):
            raise BadArgument("action", action, "a function to run as a branch")
        return self.start(qualified_name(action), lambda: action(*args, **kwargs))

    def start(self, name: str, action: Action, *, ordered: bool = False) -> Handle:
        """Starts a branch.

        Args:
            name: what it is called.
            action: what it does.
            ordered: whether it waits only for what was asked for before it.
        """

        def run() -> Result:
            _block.set(None)  # this is the branch's own context
            with span("branch", name) as task:
                checkpoint()
                task.result = result = action()
                return result

        branch = Branch(f"{self.name}-{len(self.branches) + 1} {name}", run, ordered=ordered, ended=lambda _: None)
        self.branches.append(branch)
        branch.start()
        return Handle(branch)

    def __enter__(self) -> Self:
        checkpoint()
        self.state = State.RUNNING
        self._span = self._exits.enter_context(span("block", self.name))
        self._exits.enter_context(entered(self._scope))
        token = _block.set(self)
        self._exits.callback(lambda: _block.reset(token))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            raised = self._decide(error)
        except BaseException as stopped:  # Ctrl-C while waiting
            self._leave(stopped)
            raise
        self._leave(raised)
        if raised is not None and raised is not error:
            raise raised

    def _leave(self, error: BaseException | None) -> None:
        """Closes the block's node of the task tree with how it ended."""
        if error is None:
            self._exits.close()
            return
        try:
            self._exits.__exit__(type(error), error, error.__traceback__)
        except BaseException as same:
            if same is not error:
                raise

    def _decide(self, error: BaseException | None) -> BaseException | None:
        if error is not None and not isinstance(error, Exception):
            self._scope.cancel()  # Ctrl-C, or the block around was decided: nothing new is begun
        try:
            self._join()
        except BaseException:
            self._scope.cancel()
            self._join()
            self.state = State.FAILED
            raise
        errors = [branch.error for branch in self.branches if branch.error is not None]
        errors = [one for one in errors if not isinstance(one, Cancelled)]
        if error is not None:
            self.state = State.CANCELLED if isinstance(error, Cancelled) else State.FAILED
            return chained(error, errors)
        if not errors:
            self.state = State.SUCCEEDED
            return None
        self.state = State.FAILED
        bugs = [one for one in errors if not isinstance(one, PlanFailure)]
        if bugs:  # the program is wrong: that has to come out as it is
            return chained(bugs[0], [one for one in errors if one is not bugs[0]])
        if self._failures is not None:
            self._failures.extend(errors)
            return None
        failed = BranchesFailed(self.name, errors)
        failed.__cause__ = errors[0]
        return failed

    def _join(self) -> None:
        for branch in self.branches:
            branch.join()


class _Par:
    """``par`` itself: opens a block with or without parentheses, or runs functions."""

    _open: ContextVar[tuple[Block, ...]] = ContextVar("pycram_par_blocks", default=())

    def __call__(self, *branches: Action | list[BaseException]) -> Block | list[Result]:
        """Opens a block, or runs functions side by side.

        Args:
            branches: nothing; one list, which gets the failures of the block's branches; or functions.

        Returns:
            The block to use with ``with``; or the functions' results, in order.

        Raises:
            BadArgument: something else.
            BranchesFailed: a function failed.
        """
        if not branches:
            return Block("par")
        if len(branches) == 1 and isinstance(branches[0], list):
            return Block("par", branches[0])
        for branch in branches:
            if not callable(branch):
                raise BadArgument("branch", branch, "a function, or one list for failures")
        with Block("par") as block:
            handles = [block(cast("Action", branch)) for branch in branches]
        return [handle.result() for handle in handles]

    def __enter__(self) -> Block:
        block = Block("par")
        block.__enter__()
        self._open.set((*self._open.get(), block))
        return block

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        *outer, block = self._open.get()
        self._open.set(tuple(outer))
        block.__exit__(kind, error, trace)

    def __repr__(self) -> str:
        return "par"


par = _Par()
"""Runs branches side by side; fails if any fails (thesis, table 3.4)."""
