"""Blocks in the bodies of others, where they count as one branch each.

- In ``try_in_order`` a block is one of the things to try: it runs where it stands, and its failure is kept for the
  outer block, which goes on with what follows.
- In a concurrent block it is to run beside its siblings, but a ``with`` statement runs where it stands. So its body is
  only *read* there: what it asks for is done by the block itself, in a thread of its own, while the statements after it
  are read. Its actions give handles. Whoever looks at a handle in that body waits for its result. An attempt, a
  timeout, a cleanup or the wait for a fluent in that body runs where it stands, when what was asked for before it in a
  sequence is done.

A decided ``try_in_order`` ends its body at the next block in it; variables that this would have set are not set then.
"""

from __future__ import annotations

import threading
from collections import deque
from contextlib import ExitStack
from typing import TYPE_CHECKING

from pycram.blocks import Block
from pycram.branch import Branch
from pycram.cancellation import Cancelled, current_scope, entered, wait
from pycram.foundation.failures import PlanFailure
from pycram.open_block import OpenBlock, hosted
from recorder.tasks import State
from recorder.tracing.interrupts import Uninterrupted
from recorder.tracing.span import Span

if TYPE_CHECKING:
    from collections.abc import Iterator
    from types import TracebackType
    from typing import Self

    from pycram.open_block import Rule


def nested(host: OpenBlock, rule: Rule, failures: list[BaseException] | None) -> OpenBlock:
    """A block that is to be opened in the body of another one.

    Args:
        host: the block around it.
        rule: what kind it is.
        failures: where its failures go; None to raise them.
    """
    if isinstance(host, Block) and not host.rule.concurrent:
        return Alternative(rule, failures, host)
    return Deferred(rule, failures, host)


class Alternative(Block):
    """A block in the body of ``try_in_order``: its plan failures don't end that body."""

    def __init__(self, rule: Rule, failures: list[BaseException] | None, host: Block) -> None:
        super().__init__(rule, failures)
        self._around = host

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool:
        branch = Branch(self.name, lambda: None, self.changed)
        try:
            swallowed = super().__exit__(kind, error, trace)
        except PlanFailure as failure:
            self._around.report(branch, State.FAILED, failure)
            return True
        except BaseException as raised:
            self._tell(branch, raised)
            raise
        if swallowed:
            self._around.report(branch, State.SUCCEEDED)
        else:
            self._tell(branch, error)
        return swallowed

    def _tell(self, branch: Branch, error: BaseException | None) -> None:
        cancelled = isinstance(error, Cancelled)
        self._around.report(branch, State.CANCELLED if cancelled else State.FAILED, None if cancelled else error)


class Deferred(OpenBlock):
    """A block in the body of a concurrent one: read here, done there."""

    def __init__(self, rule: Rule, failures: list[BaseException] | None, host: OpenBlock) -> None:
        super().__init__(rule)
        self._around = host
        self._outer = current_scope()
        self._span = Span("block", rule.name)
        self._block = Block(rule, failures, self._span)
        self._asked = _Asked()
        self._begun = False
        self._begun_changed = threading.Condition()
        self._exits = ExitStack()
        self.readings = host.readings

    @property
    def state(self) -> State:
        """How far it is, or how it ended."""
        return self._block.state

    @property
    def prompt(self) -> bool:
        """Never: it may be the turn of what was asked for before."""
        return False

    @property
    def failures(self) -> tuple[PlanFailure, ...]:
        """The failures of its branches and of its body so far."""
        return self._block.failures

    def take(self, branch: Branch) -> None:
        """Has a branch done when it is its turn.

        Args:
            branch: one that has not begun; dropped if the block is decided.
        """
        self.branches.append(branch)
        self._asked.put(branch)

    def catch_up(self) -> None:
        """Waits until this block has begun and, if things happen in order in it, what was asked for before is done.

        Raises:
            Cancelled: it is decided, or told to stop.
        """
        wait(self._begun_changed, lambda: self._begun)
        if not self.rule.concurrent:
            for branch in self.branches:
                branch.wait()

    def _work(self) -> None:
        """Does what the body asks for."""
        with self._block as block:
            stopped: BaseException | None = None
            try:
                with self._begun_changed:
                    self._begun = True
                    self._begun_changed.notify_all()
                for branch in self._asked:
                    block.take(branch)
            except BaseException as error:  # noqa: BLE001  raised below
                block.scope.cancel()  # there is no use in reading on
                stopped = error
            self._asked.close()
            wrong = self._asked.outcome()  # what the body does itself is part of this block too
            if isinstance(wrong, PlanFailure):
                block.body_failed(wrong)
            elif wrong is not None:
                raise wrong
            if stopped is not None:
                raise stopped

    def __enter__(self) -> Self:
        self.readings.append(self._asked.end)
        try:
            self._around.start(self.name, self._work, dropped=self._asked.close, span=self._span)
            with Uninterrupted():
                self._exits.enter_context(self._span.entered())
                self._exits.enter_context(entered(self._block.scope))
                self._exits.enter_context(hosted(self))
        except BaseException:  # told to stop, or Ctrl-C: there will be no body
            self._leave()
            self._asked.end()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool:
        self._leave()
        if error is not None and not isinstance(error, (PlanFailure, Cancelled)):
            self._block.scope.cancel()  # the program is wrong, or the user wants out
        self._asked.end(error if isinstance(error, Exception) else None)
        if isinstance(error, Cancelled):  # by its own block, which is decided: the outer body goes on
            return self._outer is None or not self._outer.cancelled
        return error is None or isinstance(error, PlanFailure)

    def _leave(self) -> None:
        with Uninterrupted():
            self._exits.close()


class _Asked:
    """What a body asks for, in order, until it ends.

    The body's side of it holds Ctrl-C back: a condition that is broken off while it takes or gives back its lock keeps
    it, and the other side would wait for ever.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._branches: deque[Branch] = deque()
        self._ended = False
        self._error: Exception | None = None
        self._closed = False

    def put(self, branch: Branch) -> None:
        """Adds a branch; drops it if nobody is going to do it any more."""
        with Uninterrupted(), self._changed:
            if not self._closed:
                self._branches.append(branch)
                self._changed.notify_all()
                return
        branch.settle(State.CANCELLED)

    def end(self, error: Exception | None = None) -> None:
        """The body has ended; nothing happens if that was said before.

        Args:
            error: what it raised.
        """
        with Uninterrupted(), self._changed:
            if not self._ended:
                self._ended = True
                self._error = error
                self._changed.notify_all()

    def outcome(self) -> Exception | None:
        """Waits until the body has ended, whoever is told to stop; what it raised."""
        with self._changed:
            self._changed.wait_for(lambda: self._ended)
            return self._error

    def close(self) -> None:
        """Nothing more will be done; drops what has not been."""
        with self._changed:
            self._closed = True
            left = list(self._branches)
            self._branches.clear()
        for branch in left:
            branch.settle(State.CANCELLED)

    def __iter__(self) -> Iterator[Branch]:
        """The branches as they come, until the body has ended."""
        while True:
            wait(self._changed, lambda: bool(self._branches) or self._ended)
            with self._changed:
                if not self._branches:
                    return
                branch = self._branches.popleft()
            yield branch
