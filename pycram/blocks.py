"""Blocks: what they have in common, and what makes ``par`` another thing than ``pursue``.

The whole difference between the five blocks is their :class:`Rule`: whether branches run side by side, and which end of
a branch decides the block. A block that is decided cancels its other branches; it ends when all its threads have ended,
and as its deciding branch did. One that nothing decided failed if any of its branches did.

A plan failure in the body ends the body and is one of the block's failures: it decides the block where a failure of a
branch would, and never turns one that is decided. What is asked for when the block is decided isn't run: its handle
says so.

Two things come out of any block, however it is decided. A usage error, in a branch or in the body, ends it and comes
out as it is: it is never collected, retried or outvoted. A branch that could not clean up when it was told to stop has
left the world in a state that nobody reckons with, and fails the block.
"""

from __future__ import annotations

import sys
import threading
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from pycram.attempts import Retry
from pycram.cancellation import Cancelled, Scope, checkpoint, current_scope, entered
from pycram.failed_blocks import BranchesFailed, leaves_uncleaned
from pycram.foundation.error_chain import chained, raise_unchanged
from pycram.foundation.failures import PlanFailure
from pycram.open_block import BlockClosed, OpenBlock, enter_branch, hosted
from recorder.tasks import State
from recorder.tracing.interrupts import Uninterrupted
from recorder.tracing.span import Span

if TYPE_CHECKING:
    from types import FrameType, TracebackType
    from typing import Self

    from pycram.actions import Result
    from pycram.binding import Binding
    from pycram.branch import Branch
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
        self._decided = False  # by that, or by a failure of the body
        self._state = State.CREATED
        self._body_failures: list[PlanFailure] = []
        self._inside: tuple[Binding[Any], ...] = ()  # what holds as long as its body runs
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
        return self._failures_among([branch.error for branch in list(self.branches)])

    def _failures_among(self, errors: list[BaseException | None]) -> tuple[PlanFailure, ...]:
        """The block's failures.

        Args:
            errors: of its branches.
        """
        failures = [one for one in errors if isinstance(one, PlanFailure)] if not self.rule.plain else []
        known = {id(failure) for failure in failures}
        return (*failures, *[failure for failure in self._body_failures if id(failure) not in known])

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
        with Uninterrupted():  # what is noted has begun, or is settled
            begins_here = self._admit(branch)
        if begins_here:
            branch.context.run(self._run, branch)
            error = branch.error
            if error is not None and (self.rule.plain or not isinstance(error, PlanFailure)):
                raise error
        if self._outer is not None and self._outer.cancelled:
            raise Cancelled

    def _admit(self, branch: Branch) -> bool:
        """Notes a branch, and begins it in a thread of its own; returns whether it is to be run here instead."""
        with self.changed:
            closed = self._state is not State.RUNNING
            if not closed:
                self.branches.append(branch)
        if closed:
            branch.settle(State.CANCELLED)
            raise BlockClosed(self.name, branch.name)
        if self._decided or self.scope.cancelled:
            branch.settle(State.CANCELLED)
            branch.span.ask()
            branch.span.finish(Cancelled())
            return False
        if self.rule.concurrent:
            self._begin(branch)
        return not self.rule.concurrent

    def _begin(self, branch: Branch) -> None:
        name = f"{self.name}-{len(self.branches)} {branch.name}"
        try:
            branch.thread = threading.Thread(target=branch.context.run, args=(self._run, branch), name=name)
            branch.thread.start()
        except Exception as error:  # noqa: BLE001  no more threads, or a full disk: the block raises it
            branch.thread = None
            with suppress(OSError):  # a full disk, again
                branch.span.ask()
            branch.span.finish(error)
            self._settle(branch, State.FAILED, error=error)

    def _run(self, branch: Branch) -> None:
        """Runs a branch in this thread and in its own context; its errors are its own."""
        result: Result = None
        try:
            enter_branch(self.scope)
            with branch.span:
                checkpoint()
                branch.span.result = result = branch.begin()
        except Cancelled:
            self._settle(branch, State.CANCELLED)
        except BaseException as error:  # noqa: BLE001  the block raises it in the thread that opened it
            self._settle(branch, State.FAILED, error=error)
        else:
            self._settle(branch, State.SUCCEEDED, result)

    def _settle(self, branch: Branch, state: State, result: Result = None, error: BaseException | None = None) -> None:
        decides = False
        if state in self.rule.decided_by and not self.rule.plain:
            with self.changed:
                decides, self._decided = not self._decided, True
                if decides:
                    self.decider = branch
                branch.settle(state, result, error)
        else:
            branch.settle(state, result, error)
        if decides or (error is not None and not isinstance(error, PlanFailure)):
            self.scope.cancel()

    def body_failed(self, failure: PlanFailure) -> None:
        """Takes a failure of the body, which has ended with it.

        Args:
            failure: the failure.
        """
        with self.changed:
            self._body_failures.append(failure)
            decides = not self._decided and State.FAILED in self.rule.decided_by
            self._decided = self._decided or decides
        if decides:
            self.scope.cancel()

    def report(self, branch: Branch, state: State, error: BaseException | None = None) -> None:
        """Takes what became of a branch that was run by its own means.

        Args:
            branch: the branch.
            state: how it ended.
            error: what it raised.
        """
        with self.changed:
            self.branches.append(branch)
        self._settle(branch, state, error=error)

    # --- from its beginning to its end --------------------------------------------------------------------------------

    def __enter__(self) -> Self:
        checkpoint()
        try:
            with Uninterrupted():  # what has begun is known to be
                if self._owns_span:
                    self._span.__enter__()
                self._inside = (entered(self.scope), hosted(None if self.rule.plain else self))
                for binding in self._inside:
                    binding.__enter__()
                self._state = State.RUNNING
        except BaseException as stopped:  # Ctrl-C: there will be no body
            self._leave(stopped)
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool:
        try:
            raised = self._close(error)
            self._leave(raised)
        except BaseException as stopped:  # Ctrl-C
            self._state = State.FAILED
            self._leave(stopped)
            raise
        if raised is not None and raised is not error:
            raise_unchanged(raised)
        return raised is None

    def _close(self, error: BaseException | None) -> BaseException | None:
        """Waits for the branches, says how the block ended, and gives what is to be raised."""
        if isinstance(error, PlanFailure):
            self.body_failed(error)
        elif error is not None:
            self.scope.cancel()
        try:
            self._end_readings()
            self._join()
        except BaseException:
            with _Waiting(self):  # no thread outlives its block, however often somebody presses Ctrl-C
                self.scope.cancel()
                self._end_readings()
                self._join()
            raise
        errors = [branch.error for branch in self.branches]
        failures = self._failures_among(errors)
        bugs = [one for one in (error, *errors) if one is not None and not isinstance(one, (PlanFailure, Cancelled))]
        if bugs:  # the program is wrong, or the user wants out
            self._state = State.FAILED
            bugs.sort(key=lambda one: isinstance(one, Retry))  # trying again would hide the others
            return chained(bugs[0], [*bugs[1:], *failures])
        self._state = self._outcome(error, failures)
        if self._collected is not None:
            self._collected.extend(failures)
        if self._state is State.CANCELLED:
            return chained(error if isinstance(error, Cancelled) else Cancelled(), failures)
        if self._state is State.SUCCEEDED:
            for failure in self._body_failures:
                self._note_down(failure)
            return None
        return None if self._collected is not None else BranchesFailed(self.name, failures)

    def _outcome(self, error: BaseException | None, failures: tuple[PlanFailure, ...]) -> State:
        """How the block ended, where the program is right.

        Args:
            error: what came out of the body.
            failures: the block's.
        """
        if any(leaves_uncleaned(failure) for failure in failures):
            return State.FAILED
        if self.decider is not None:
            return self.decider.state
        stopped = isinstance(error, Cancelled) or any(branch.state is State.CANCELLED for branch in self.branches)
        if stopped and not self._body_failures:  # by a block around it
            return State.CANCELLED
        return State.FAILED if failures else State.SUCCEEDED

    def _note_down(self, failure: PlanFailure) -> None:
        """Puts a failure of the body on record that is neither raised nor that of a branch."""
        if not any(branch.error is failure for branch in self.branches):
            body = Span("branch", "body", parent=self._span.id)
            body.ask()
            body.finish(failure)

    def _end_readings(self) -> None:
        """Says to the blocks in its body that this has ended."""
        for end in self.readings:
            end()

    def _join(self) -> None:
        """Waits for all branches; those of a block in which things happen in order have ended anyway."""
        ended = 0
        while True:
            while self.rule.concurrent and ended < len(self.branches):
                branch = self.branches[ended]
                if not branch.done:
                    branch.outlast()  # first: Thread.join takes a thread for ended when Ctrl-C breaks it off
                if branch.thread is not None:
                    branch.thread.join()
                    branch.thread = None  # handles live longer
                ended += 1
            with self.changed:  # a branch may have asked for another one
                if ended == len(self.branches) or not self.rule.concurrent:
                    self._state = State.CANCELLED  # closed; what it really is comes next
                    return

    def _leave(self, error: BaseException | None) -> None:
        """Ends the block's node of the task tree as the block ended."""
        if error is None and self._state is State.FAILED:  # collected instead of raised; the tree tells it
            self._span.error = BranchesFailed(self.name, self.failures)
        with Uninterrupted():  # what has begun to end does
            inside, self._inside = self._inside, ()
            try:
                for binding in reversed(inside):
                    binding.__exit__()
            except ValueError as wrong:  # this is another context than it began in
                error = wrong
                raise
            finally:
                if inside and self._owns_span:
                    self._span.__exit__(type(error) if error is not None else None, error, None)


class _Waiting(Uninterrupted):
    """Notes Ctrl-C, and says what the user has to wait for."""

    __slots__ = ("_block",)

    def __init__(self, block: Block) -> None:
        self._block = block

    def _note(self, number: int, frame: FrameType | None) -> None:
        super()._note(number, frame)
        threads = [branch.thread for branch in self._block.branches if not branch.done]
        busy = [thread.name for thread in threads if thread is not None]
        if busy and sys.stderr is not None:
            told = f"waiting for {', '.join(busy)} to get to the next action; Ctrl-\\ ends the process at once\n"
            sys.stderr.write(told)
