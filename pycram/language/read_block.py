"""Blocks in the body of a concurrent block: one part of the plan reads their actions, another one runs them.

Such a block runs beside its siblings, but a ``with`` statement runs where it stands. So its body is only *read* there,
and a branch of its host runs the actions while the statements after it are read. Using a future in that body waits for
its result. An attempt, a timeout, a cleanup or the wait for a fluent in that body runs where it stands, after the
actions before it in a sequence. A change of a world there, or a branch that is added to a block around it, would come
before the actions above it that have not ended, and is refused then (RunsEarly).
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, cast

from pycram.foundation.error_chain import raise_unchanged
from pycram.foundation.failures import PlanFailure
from pycram.language.block import Block
from pycram.language.failures import RunsEarly
from pycram.scheduling.cancellation import enter, join, wait
from pycram.scheduling.future import branch_of
from recorder.tasks import State
from recorder.tracing.span import Cancelled

if TYPE_CHECKING:
    from contextlib import ExitStack
    from types import TracebackType

    from pycram.language.block import Policy
    from pycram.language.branch import Branch


class ReadBlock(Block):
    """A block whose body is read where it stands.

    Args:
        policy: Its kind.
        host: The block around it, a branch of which runs this one.
        failures: Collects its failures; without a list, they are raised.
    """

    def __init__(self, policy: Policy, host: Block, failures: list[BaseException] | None = None) -> None:
        super().__init__(policy, failures)
        self.immediate, self.reads_blocks, self.adds_actions = False, True, True
        self._host = None  # not to be added as a branch at its end: it is one from its beginning
        self._run_by = host
        self._pending: deque[Branch] = deque()
        self._dropping = False
        self._body_ended = False
        self._body_error: Exception | None = None

    def await_turn(self) -> None:
        """Wait until the body itself may act: in a sequence, after the actions before.

        Raises:
            Cancelled: The block is cancelled.
        """
        wait(self._changed, lambda: self.state is not State.CREATED)
        if not self.policy.concurrent:
            for branch in self.branches:
                branch.wait()

    def before_change(self, change: str) -> None:
        """Refuse a change of a world by the body itself while actions that stand above it have not ended."""
        self._refuse_early(f"{change} in the world", None)

    def _refuse_early(self, what: str, outer: Block | None) -> None:
        block: Block = self
        above: Branch | None = None  # of which those before are meant; None for all
        while isinstance(block, ReadBlock) and block is not outer:
            if not block.policy.concurrent:
                earlier = block.branches if above is None else block.branches[: block.branches.index(above)]
                pending = [branch.name for branch in earlier if not branch.done]
                if pending:
                    raise RunsEarly(what, block.name, pending)
            block, above = block._run_by, block._own  # noqa: SLF001  same class

    # --- reading ------------------------------------------------------------------------------------------------------

    def _begin(self, entering: ExitStack) -> None:
        entering.callback(self._stop_reading)
        started = self._run_by.start(self.name, self._work, dropped=self._drop, span=self._span)
        self._own = cast("Branch", branch_of(started))
        entering.enter_context(self._span.entered())

    def _add(self, branch: Branch) -> None:
        self.branches.append(branch)
        self._pending.append(branch)
        self._changed.notify_all()
        if self._dropping:  # nothing runs it any more
            self._drop()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool:
        if error is not None and not isinstance(error, (PlanFailure, Cancelled)):
            self.scope.cancel()  # the program is wrong, or the user interrupts it
        self._body_error = error if isinstance(error, Exception) else None
        self._entered.close()
        if isinstance(error, Cancelled):  # by its own block, which is decided: the body around it goes on
            return self._around is None or not self._around.is_cancelled
        return error is None or isinstance(error, PlanFailure)

    def _stop_reading(self) -> None:
        self._body_ended = True
        self._changed.notify_all()

    # --- running ------------------------------------------------------------------------------------------------------

    def _work(self) -> None:
        """Run the branches, in a branch of the host."""
        stopped: BaseException | None = None
        enter(self.scope)
        self.state = State.RUNNING
        self._changed.notify_all()
        try:
            while not self._body_ended or self._pending:
                if self._pending:
                    self._take(self._pending.popleft())
                wait(self._changed, lambda: bool(self._pending) or self._body_ended)
        except BaseException as stop:  # noqa: BLE001  raised below
            self.scope.cancel()  # reading on is pointless
            stopped = stop
        self._drop()
        join(self._changed, lambda: self._body_ended)  # actions of the body itself are part of this block too
        error = self._body_error
        if isinstance(error, PlanFailure):
            self._body_failed(error)
            error = None
        raised = self._close(error or stopped)
        if raised is not None:
            raise_unchanged(raised)

    def _drop(self) -> None:
        """Cancel the branches that haven't started; no more will run."""
        self._dropping = True
        if self.state is State.CREATED:
            self.state = State.CANCELLED
        while self._pending:
            self._pending.popleft().settle(State.CANCELLED)
