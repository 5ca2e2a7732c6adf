"""Blocks: their branches, their bodies and their ends.

The five kinds of blocks differ in their :class:`Policy` only: whether branches run concurrently, and which outcome of a
branch decides the block. A decided block cancels its other branches, ends when all have ended, and has the outcome of
the deciding one. A block that nothing decided failed if any branch failed.

A plan failure of the body ends the body and counts as one of the block's failures: it decides the block where a
branch's failure would, and never overturns a decision. A branch that is added to a decided block is cancelled.

Two things fail any block, decided or not: a usage error, in a branch or in the body, which is raised as it is, and
never collected, retried or outvoted; and the failed cleanup of a cancelled branch, as the state of the world is then
unknown.

A block in the body of another one, its *host*, is one of the host's branches. In ``try_in_order`` it runs where it
stands; the host keeps its failure and goes on with what follows. In a concurrent block a branch runs it
(:mod:`pycram.language.read_block`).

Code in a body adds branches to the block around it, which its context carries. A branch's context carries none, and
actions run in order. A decided ``try_in_order`` ends its body at the next block in it; variables that this block would
have set are not set then.
"""

from __future__ import annotations

import threading
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from pycram.foundation.error_chain import chained, raise_unchanged
from pycram.foundation.failures import BadArgument, PlanFailure
from pycram.language.actions import Result, name_of, run
from pycram.language.attempts import Retry
from pycram.language.body import current_block, in_block, leave_body
from pycram.language.branch import Branch
from pycram.language.failures import BlockClosed, BranchesFailed, OutlivesTimeout, leaves_uncleaned
from pycram.scheduling.cancellation import CancelScope, current_scope, enter, entered, join, raise_if_cancelled
from pycram.scheduling.future import Future
from pycram.scheduling.locks import LockHeld, refuse_held
from pycram.scheduling.schedule import Condition, scheduler
from recorder.tasks import State
from recorder.tracing import interrupts
from recorder.tracing.context import current_branch, enter_branch
from recorder.tracing.span import Cancelled, Span, current_call_stack

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import TracebackType
    from typing import Self


@dataclass(frozen=True, slots=True)
class Policy:
    """What one kind of block differs in from the others.

    Attributes:
        name: "par", ...
        concurrent: Whether its branches run concurrently.
        decided_by: The states of an ended branch that decide the block.
    """

    name: str
    concurrent: bool
    decided_by: frozenset[State]

    @property
    def propagates(self) -> bool:
        """Whether a failure rises through the body as in plain Python; unless handled there, it ends the block."""
        return not self.concurrent and State.FAILED in self.decided_by

    @property
    def first_success(self) -> bool:
        """Whether one success is enough."""
        return State.SUCCEEDED in self.decided_by


class Block:
    """A block: ``s`` in ``with par as s``.

    Args:
        policy: Its kind.
        failures: Collects its failures; without a list, they are raised.

    Attributes:
        name: Its kind: "par", ...
        immediate: Whether an action starts regardless of those added before it.
        reads_blocks: Whether branches of it run the blocks in its body.
        adds_actions: Whether actions in its body become branches; else they run in order, and their failures rise.
        branches: Its branches, in the order in which they were added.
        scope: Cancel scope of its body and its branches; cancelled when the block is decided.
        decider: The branch that decided it; None as long as none has.
        state: How far it is, or how it ended.
    """

    def __init__(self, policy: Policy, failures: list[BaseException] | None = None) -> None:
        self.policy = policy
        self.name = policy.name
        self.immediate = self.reads_blocks = policy.concurrent
        self.adds_actions = not policy.propagates
        self.branches: list[Branch] = []
        self.scope = CancelScope(current_scope())
        self.decider: Branch | None = None
        self.state = State.CREATED
        self._around = current_scope()
        self._opened_in = current_branch()
        self._collected = failures
        self._host = current_block()
        self._changed = Condition()  # notified when a branch ends, and of the progress of a body that is read
        self._closing = threading.Lock()  # a plan's own threads may add branches while it ends
        self._scheduler = scheduler()
        self._own: Branch | None = None  # of its host, if a branch of that runs it
        self._taken = 0  # number of branches so far, for their names
        self._joined = 0  # number of leading branches known to have ended
        self._decided = False  # by its decider, or by a failure of the body
        self._body_failures: list[PlanFailure] = []
        self._entered = ExitStack()  # what its body runs in
        self._span = Span("block", policy.name)

    @property
    def failures(self) -> tuple[PlanFailure, ...]:
        """The failures of its branches and of its body so far."""
        errors = [branch.error for branch in list(self.branches)] if not self.policy.propagates else []
        failures = [error for error in errors if isinstance(error, PlanFailure)]
        known = {id(failure) for failure in failures}
        return (*failures, *[failure for failure in self._body_failures if id(failure) not in known])

    def await_turn(self) -> None:
        """Wait until its body itself may act; where it runs as it stands, that is always so."""

    def before_change(self, change: str) -> None:
        """Refuse a change of a world by its body that would come too early; where it runs as it stands, none does."""

    def _refuse_early(self, what: str, outer: Block | None) -> None:
        """Refuse what its body would do in a block around it while actions that stand above that are pending."""

    # --- branches ---------------------------------------------------------------------------------------------------

    def __call__(self, action: Callable[..., Result], *args: object, **kwargs: object) -> Future:
        """Add a branch that calls a function; return a future of its result.

        Raises:
            BadArgument: The action isn't callable.
            BlockClosed: The block has ended.
            OutlivesTimeout: The body adds it in a timeout that it would outlive.
            RunsEarly: Actions that stand above this one, in a sequence that is read, have not ended.
            PlanFailure: The function failed, in a ``seq`` block.
        """
        if not callable(action):
            raise BadArgument("action", action, "a function to run as a branch")

        def act() -> Result:
            raise_if_cancelled()  # before it starts
            return run(action, *args, **kwargs)

        return self.start(name_of(action), act)

    def start(
        self,
        name: str,
        action: Callable[[], Result],
        *,
        ordered: bool = False,
        dropped: Callable[[], None] = lambda: None,
        span: Span | None = None,
    ) -> Future:
        """Add a branch, with the arguments of a :class:`Branch`; return a future of its result."""
        self._refuse_in_timeout(name)
        host = current_block()
        if host is not None and host is not self:
            host._refuse_early(f"add {name} to the {self.name} block around it", self)  # noqa: SLF001  same class
        branch = Branch(name, action, self._changed, ordered=ordered, dropped=dropped, span=span)
        branch.span.source = current_call_stack()
        self._add(branch)
        return Future(branch)

    def _refuse_in_timeout(self, name: str) -> None:
        """Refuse a branch that the body adds in a timeout within it; branches may add others as they like."""
        scope = current_scope()
        if scope is None or scope is self.scope or current_branch() is not self._opened_in:
            return
        within = (scope, *scope.around)
        if self.scope in within and any(each.has_deadline for each in within[: within.index(self.scope)]):
            raise OutlivesTimeout(self.name, name)

    def _add(self, branch: Branch) -> None:
        with self._closing:
            if self.state is State.RUNNING:
                self.branches.append(branch)
        self._take(branch)

    def _take(self, branch: Branch) -> None:
        """Schedule a branch or, in a sequential block, run it here; a decided block cancels it instead.

        Raises:
            BlockClosed: The block has ended.
            PlanFailure: The branch failed, where that ends the body.
            Cancelled: The block around this one is cancelled.
        """
        branch.span.parent = self._span.id
        self._taken += 1
        if self.state is not State.RUNNING:
            branch.settle(State.CANCELLED)
            raise BlockClosed(self.name, branch.name)
        try:
            if self._decided or self.scope.is_cancelled:
                branch.settle(State.CANCELLED)
                branch.span.ask()
                branch.span.finish(Cancelled())
            elif self.policy.concurrent:
                name = f"{self.name}-{self._taken} {branch.name}"
                site = branch.span.source.line if branch.span.source is not None else ("", 0)
                self._scheduler.begin(name, branch.context, partial(self._run, branch), branch.abandon, site)
            else:
                branch.context.run(enter_branch, current_branch())  # a read body added it in another branch
                branch.context.run(self._run, branch)
        except BaseException as error:
            branch.abandon(error)
            raise
        ends_body = self.policy.propagates or not isinstance(branch.error, PlanFailure)
        if branch.error is not None and ends_body and not self.policy.concurrent:
            raise branch.error
        if self._around is not None and self._around.is_cancelled:
            raise Cancelled

    def _run(self, branch: Branch) -> None:
        """Run a branch in its own context, in which actions run in order; settle it instead of raising."""
        result: Result = None
        try:
            leave_body()
            enter(self.scope)
            with branch.span:
                branch.span.result = result = branch.begin()
        except Cancelled:
            self._settle(branch, State.CANCELLED)
        except BaseException as error:  # noqa: BLE001  raised where the block was opened
            self._settle(branch, State.FAILED, error=error)
        else:
            self._settle(branch, State.SUCCEEDED, result)

    def _settle(self, branch: Branch, state: State, result: Result = None, error: BaseException | None = None) -> None:
        decides = state in self.policy.decided_by and not self.policy.propagates and not self._decided
        if decides:
            self._decided, self.decider = True, branch
        branch.settle(state, result, error)
        if decides or (error is not None and not isinstance(error, PlanFailure)):
            self.scope.cancel()

    def _body_failed(self, failure: PlanFailure) -> None:
        """Note the failure that ended the body."""
        self._body_failures.append(failure)
        if not self._decided and State.FAILED in self.policy.decided_by:
            self._decided = True
            self.scope.cancel()

    def _add_ended(self, nested: str, raised: BaseException | None) -> None:
        """Add a block of its body that has ended, as a branch."""
        state = State.SUCCEEDED if raised is None else State.FAILED
        if isinstance(raised, Cancelled):
            state, raised = State.CANCELLED, None
        branch = Branch(nested, lambda: None, self._changed)
        self.branches.append(branch)
        self._settle(branch, state, error=raised)

    # --- beginning and end --------------------------------------------------------------------------------------------

    def __enter__(self) -> Self:
        if self.policy.concurrent:  # its end yields, and must not fail
            refuse_held()
        with ExitStack() as entering:
            self._begin(entering)
            entering.enter_context(entered(self.scope))
            entering.enter_context(in_block(self if self.adds_actions else None))
            self._entered = entering.pop_all()
        return self

    def _begin(self, entering: ExitStack) -> None:
        raise_if_cancelled()
        entering.enter_context(self._span)
        self.state = State.RUNNING

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool:
        with self._entered:  # fails where it can't wait for its branches, or in another context than it began in
            raised = self._close(error)
            self._span.error = raised or self._span.error
        if self._host is not None:
            self._host._add_ended(self.name, raised)  # noqa: SLF001  same class
            if isinstance(raised, PlanFailure):
                return True
        if raised is not None and raised is not error:
            raise_unchanged(raised)
        return raised is None

    def _close(self, error: BaseException | None) -> BaseException | None:
        """Wait for the branches, set the outcome, and return what is to be raised."""
        if isinstance(error, PlanFailure):
            self._body_failed(error)
        elif error is not None:
            self.scope.cancel()
        interrupt = self._join(error if isinstance(error, KeyboardInterrupt) else None)
        if isinstance(interrupt, PlanFailure):
            self._body_failed(interrupt)
        errors = (interrupt, error if error is not interrupt else None, *[branch.error for branch in self.branches])
        failures = self.failures
        bugs = [e for e in errors if e is not None and not isinstance(e, (PlanFailure, Cancelled))]
        if bugs:  # the program is wrong, or the user interrupts it
            self.state = State.FAILED
            bugs.sort(key=lambda bug: isinstance(bug, Retry))  # a retry would hide the others
            return chained(bugs[0], [*bugs[1:], *failures])
        self.state = self._outcome(error, failures)
        if self._collected is not None:
            self._collected.extend(failures)
        if self.state is State.CANCELLED:
            return chained(error if isinstance(error, Cancelled) else Cancelled(), failures)
        if self.state is State.SUCCEEDED:
            self._record_body_failures()
            return None
        failed = BranchesFailed(self.name, failures)
        if self._collected is None:
            return failed
        self._span.error = failed  # not raised, but in the task tree
        return None

    def _outcome(self, error: BaseException | None, failures: tuple[PlanFailure, ...]) -> State:
        """Return the block's final state, given the error of its body; usage errors are handled before."""
        if any(leaves_uncleaned(failure) for failure in failures):
            return State.FAILED
        if self.decider is not None:
            return self.decider.state
        cancelled = isinstance(error, Cancelled) or any(branch.state is State.CANCELLED for branch in self.branches)
        if cancelled and not self._body_failures:  # by a block around it
            return State.CANCELLED
        return State.FAILED if failures else State.SUCCEEDED

    def _record_body_failures(self) -> None:
        """Record the failures of the body that are neither raised nor a branch's."""
        for failure in self._body_failures:
            if not any(branch.error is failure for branch in self.branches):
                body = Span("branch", "body", parent=self._span.id)
                body.ask()
                body.finish(failure)

    def _join(self, interrupt: BaseException | None) -> BaseException | None:
        """Wait for all branches; those of a sequential block have ended already.

        Args:
            interrupt: The KeyboardInterrupt that ended the body.

        Returns:
            The last interrupt: that one; or a KeyboardInterrupt, or another signal handler's error, that was raised
            meanwhile and has cancelled the branches.
        """
        own = self._scheduler
        while True:
            joining, own.joining = own.joining, own.joining or interrupt is not None
            try:
                join(self._changed, self._all_ended)
            except LockHeld:  # it would be refused again
                raise
            except BaseException as error:  # noqa: BLE001  raised when the branches have ended
                interrupt = error
                self.scope.cancel()
                continue
            finally:
                own.joining = joining
            if interrupt is not None:
                interrupts.drop_pending()
            with self._closing:
                if self._all_ended():  # else a thread of the plan's own has added another one
                    self.state = State.CANCELLED  # closed; the final state is set next
                    return interrupt

    def _all_ended(self) -> bool:
        while self._joined < len(self.branches) and self.branches[self._joined].done:
            self._joined += 1
        return self._joined == len(self.branches)
