"""Blocks: what they have in common, and what makes ``par`` another thing than ``pursue``.

The whole difference between the five blocks is their :class:`Rule`: whether branches run side by side, and which end of
a branch decides the block. A block that is decided cancels its other branches; it ends when all its threads have ended,
and as its deciding branch did. One that nothing decided failed if any of its branches did.

A plan failure in the body ends the body and is one of the block's failures. What is asked for when the block is decided
isn't run: its handle says so. A usage error, in a branch or in the body, ends any block and comes out as it is: it is
never collected, retried or outvoted.
"""

from __future__ import annotations

import threading
from contextlib import ExitStack
from typing import TYPE_CHECKING

from pycram.cancellation import Cancelled, Scope, checkpoint, current_scope, entered
from pycram.error_chain import chained, raise_unchanged
from pycram.failures import BranchesFailed, PlanFailure
from pycram.open_block import BlockClosed, OpenBlock, hosted
from recorder.interrupts import Uninterrupted
from recorder.span import Span
from recorder.tasks import State

if TYPE_CHECKING:
    from types import TracebackType

    from typing_extensions import Self

    from pycram.branch import Branch, Result
    from pycram.open_block import Rule


class Block(OpenBlock):
    """A block that runs its branches itself.

    Attributes:
        scope: in which its body and its branches run; told to stop when the block is decided.
        decider: the branch that decided it; None as long as none has.
    """

    def __init__(self, rule: Rule, failures: list[BaseException] | None = None, span: Span | None = None) -> None:
        """Makes a block.

        Args:
            rule: what kind.
            failures: where its failures go; None to raise them.
            span: its node of the task tree, if somebody else begins and ends that.
        """
        super().__init__(rule)
        self._collected = failures
        self._outer = current_scope()
        self.scope = Scope(self._outer)
        self.decider: Branch | None = None
        self._lock = threading.Lock()
        self._state = State.CREATED
        self._running: list[tuple[Branch, threading.Thread]] = []
        self._body_failure: PlanFailure | None = None
        self._exits = ExitStack()
        self._span = span if span is not None else Span("block", rule.name)
        self._owns_span = span is None

    @property
    def state(self) -> State:
        """How far it is, or how it ended."""
        return self._state

    @property
    def prompt(self) -> bool:
        """Whether an action begins at once, whatever was asked for before it."""
        return self.rule.concurrent

    @property
    def failures(self) -> tuple[PlanFailure, ...]:
        """The failures of its branches and of its body so far."""
        errors = [branch.error for branch in list(self.branches)] if not self.rule.plain else []
        if not any(error is self._body_failure for error in errors):
            errors.append(self._body_failure)
        return tuple(error for error in errors if isinstance(error, PlanFailure))

    # --- branches ---------------------------------------------------------------------------------------------------

    def take(self, branch: Branch) -> None:
        """Runs a branch: in a thread of its own or, in a sequential block, here.

        Args:
            branch: one that has not begun; dropped if the block is decided.

        Raises:
            BlockClosed: the block has ended.
            PlanFailure: it failed, where that ends the body.
        """
        branch.span.parent = self._span.id
        with self._lock:
            closed = self._state is not State.RUNNING
            if not closed:
                self.branches.append(branch)
        if closed:
            branch.settle(State.CANCELLED)
            raise BlockClosed(self.name, branch.name)
        if self.decider is not None or self.scope.cancelled:
            branch.settle(State.CANCELLED)
            branch.span.ask()
            branch.span.finish(Cancelled())
        elif self.rule.concurrent:
            self._begin(branch)
        else:
            branch.context.run(self._run, branch)
            error = branch.error
            if error is not None and (self.rule.plain or not isinstance(error, PlanFailure)):
                raise error
        if self._outer is not None and self._outer.cancelled:
            raise Cancelled

    def _begin(self, branch: Branch) -> None:
        name = f"{self.name}-{len(self._running) + 1} {branch.name}"
        thread = threading.Thread(target=branch.context.run, args=(self._run, branch), name=name)
        try:
            branch.span.ask()
            with Uninterrupted(), self._lock:  # a thread has started and is waited for, or neither
                thread.start()
                self._running.append((branch, thread))
        except Exception as error:  # noqa: BLE001  no more threads, or a full disk: the block raises it
            branch.span.finish(error)
            self._settle(branch, State.FAILED, error=error)

    def _run(self, branch: Branch) -> None:
        """Runs a branch in this thread; its errors are its own."""
        result: Result = None
        try:
            with hosted(None), entered(self.scope), branch.span:
                checkpoint()
                branch.span.result = result = branch.begin()
        except Cancelled:
            self._settle(branch, State.CANCELLED)
        except BaseException as error:  # noqa: BLE001  the block raises it in the thread that opened it
            self._settle(branch, State.FAILED, error=error)
        else:
            self._settle(branch, State.SUCCEEDED, result)

    def _settle(self, branch: Branch, state: State, result: Result = None, error: BaseException | None = None) -> None:
        with self._lock:
            decides = self.decider is None and state in self.rule.decided_by and not self.rule.plain
            if decides:
                self.decider = branch
        branch.settle(state, result, error)
        if decides or (error is not None and not isinstance(error, PlanFailure)):
            self.scope.cancel()

    def report(self, branch: Branch, state: State, error: BaseException | None = None) -> None:
        """Takes what became of a branch that was run by its own means.

        Args:
            branch: the branch.
            state: how it ended.
            error: what it raised.
        """
        with self._lock:
            self.branches.append(branch)
        self._settle(branch, state, error=error)

    # --- from its beginning to its end --------------------------------------------------------------------------------

    def __enter__(self) -> Self:
        checkpoint()
        if self._owns_span:
            self._exits.enter_context(self._span)
        self._exits.enter_context(entered(self.scope))
        self._exits.enter_context(hosted(None if self.rule.plain else self))
        self._state = State.RUNNING
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool:
        try:
            raised = self._close(error)
        except BaseException as stopped:  # Ctrl-C while waiting
            self._state = State.FAILED
            self._leave(stopped)
            raise
        self._leave(raised)
        if raised is not None and raised is not error:
            raise_unchanged(raised)
        return raised is None

    def _close(self, error: BaseException | None) -> BaseException | None:
        """Waits for the branches, says how the block ended, and gives what is to be raised."""
        if isinstance(error, PlanFailure):
            self._body_failure = error
        if error is not None and (self.rule.decided_by or not isinstance(error, PlanFailure)):
            self.scope.cancel()  # only the branches of a par block go on when its body failed
        try:
            self._join()
        except BaseException:
            self.scope.cancel()
            self._join()
            raise
        failures = self.failures
        wrong = [error, *(branch.error for branch in self.branches)]
        bugs = [one for one in wrong if one is not None and not isinstance(one, (PlanFailure, Cancelled))]
        if bugs:  # the program is wrong, or the user wants out
            self._state = State.FAILED
            return chained(bugs[0], [*bugs[1:], *failures])
        if self.decider is None and self._body_failure is None:
            cancelled = [branch for branch in self.branches if branch.state is State.CANCELLED]
            if error is not None or cancelled:  # told to stop by a block around it
                self._state = State.CANCELLED
                return chained(error or Cancelled(), failures)
        if self._collected is not None:
            self._collected.extend(failures)
        succeeded = not failures if self.decider is None else self.decider.state is State.SUCCEEDED
        self._state = State.SUCCEEDED if succeeded and self._body_failure is None else State.FAILED
        if self._state is State.SUCCEEDED or self._collected is not None:
            return None
        return BranchesFailed(self.name, failures)

    def _join(self) -> None:
        joined = 0
        while True:
            while joined < len(self._running):
                branch, thread = self._running[joined]
                branch.outlast()  # first: Thread.join takes a thread for ended when Ctrl-C breaks it off
                thread.join()
                joined += 1
            with self._lock:  # a branch may have asked for another one
                if joined == len(self._running):
                    self._state = State.CANCELLED  # closed; what it really is comes next
                    return

    def _leave(self, error: BaseException | None) -> None:
        """Ends the block's node of the task tree as the block ended."""
        if error is None and self._state is State.FAILED:  # collected instead of raised; the tree tells it
            self._span.error = BranchesFailed(self.name, self.failures)
        self._exits.__exit__(type(error) if error is not None else None, error, None)
