"""Blocks of the plan language (docs/guides/plan_language.md); the five kinds differ only in their :class:`Policy`.

Two errors fail any block, even after the block's decision: a usage error, and a failed cleanup of a cancelled branch,
because the state of the world is then unknown. A block in the body of another block, its *host*, is a branch of the
host. In ``try_in_order``, the inner block runs in place. In a concurrent host, a branch runs it (:class:`ReadBlock`).
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from typing import Final, Self, TypeAlias, cast, overload

from pycram.foundation.errors import OnError, chained, raise_unchanged
from pycram.foundation.failures import BadArgument, PlanFailure
from pycram.language.branch import Branch, Result, call_label, current_block, label_of, name_of, run
from pycram.language.failures import BlockClosed, BranchesFailed, OutlivesTimeout, Retry, RunsEarly, leaves_uncleaned
from pycram.language.nesting import Scope, in_block, leave_body
from pycram.scheduling.cancellation import CancelScope, current_scope, enter, entered, join, raise_if_cancelled, wait
from pycram.scheduling.future import Future, branch_of
from pycram.scheduling.order import DeadlockedBranches
from pycram.scheduling.schedule import Condition, LockHeld, refuse_held, scheduler
from recorder.tasks import State
from recorder.tracing import interrupts
from recorder.tracing.context import current_branch, current_name, enter_branch
from recorder.tracing.span import Cancelled, Span, current_call_stack

Action: TypeAlias = Callable[..., Result]


@dataclass(frozen=True, slots=True)
class Policy:
    """The rules of a kind of block."""

    name: str  # the word that opens the block, such as "par".
    concurrent: bool  # whether branches run concurrently
    decided_by: frozenset[State]  # final states of a branch that decide the block

    @property
    def propagates(self) -> bool:
        """Whether a branch's failure propagates through the body, as an error does in plain Python."""
        return not self.concurrent and State.FAILED in self.decided_by


class Block:
    """A block: ``s`` in ``with par as s``. The list ``failures`` gets its failures; without a list, the block fails."""

    def __init__(self, policy: Policy, failures: list[BaseException] | None = None) -> None:
        self.policy = policy
        self.name = policy.name
        self.immediate = policy.concurrent  # whether an action starts regardless of earlier actions
        self.reads_blocks = policy.concurrent  # whether each inner block is run by a branch
        self.adds_actions = not policy.propagates  # whether actions in the body become branches
        self.branches: list[Branch] = []  # the branches in the order in which the plan added them
        self.scope = CancelScope(current_scope())  # the scope that is cancelled when the block is decided
        self.decider: Branch | None = None  # the branch that decided the block
        self.state = State.CREATED
        self._around = current_scope()
        self._opened_in = current_branch()
        self._collected = failures
        self._host = current_block()
        self._changed = Condition()  # notified when a branch ends, or when Python has read more of a body
        self._closing = threading.Lock()  # threads of the plan may add branches while the block ends
        self._scheduler = scheduler()
        self._own: Branch | None = None  # the host's branch that runs this block
        self._taken = 0  # number of started branches, for names of branches
        self._joined = 0  # number of branches at the beginning of ``branches`` that have ended
        self._decided = False  # whether a branch or a failure of the body has decided the block
        self._body_failures: list[PlanFailure] = []
        self._deadlock: DeadlockedBranches | None = None  # if branches waited for ever
        self._entered = ExitStack()  # the contexts that end with the body
        self._span = Span("block", policy.name)

    @property
    def failures(self) -> tuple[PlanFailure, ...]:
        """The failures of the branches and of the body until now."""
        errors = [branch.error for branch in list(self.branches)] if not self.policy.propagates else []
        failures = [error for error in errors if isinstance(error, PlanFailure)]
        known = {id(failure) for failure in failures}
        return (*failures, *[failure for failure in self._body_failures if id(failure) not in known])

    def await_turn(self) -> None:
        """Wait until the body's own code may act; a body that runs in place never waits."""

    def before_change(self, change: str) -> None:
        """Reject a premature change of a world by the body's own code; a body that runs in place is never premature."""
        self._refuse_early(f"{change} in the world", None)

    def _refuse_early(self, what: str, outer: Block | None) -> None:
        """Raise RunsEarly if the body's earlier actions haven't ended; ``what`` may change an ``outer`` block."""

    def __call__(self, action: Callable[..., Result], *args: object, **kwargs: object) -> Future:
        """Add a branch that calls a function; return a future of the result.

        Raises:
            BadArgument: The action isn't callable.
            BlockClosed: The block has ended.
            OutlivesTimeout: The body adds the branch inside a timeout, and the branch would outlive the timeout.
            RunsEarly: Earlier actions of the sequence have not ended.
            PlanFailure: In a ``seq`` block, the function failed.
        """
        if not callable(action):
            raise BadArgument("action", action, "a function to run as a branch")

        def act() -> Result:
            raise_if_cancelled()
            return run(action, *args, **kwargs)

        return self.start(name_of(action), act, label=partial(label_of, action, args, kwargs))

    def start(
        self,
        name: str,
        action: Callable[[], Result],
        *,
        ordered: bool = False,
        dropped: Callable[[], None] = lambda: None,
        span: Span | None = None,
        label: Callable[[], str] | None = None,
    ) -> Future:
        """Add a branch, and return a future of its result; ``label`` returns the branch's name for messages."""
        self._refuse_in_timeout(name)
        host = current_block()
        if host is not None and host is not self:
            host._refuse_early(f"call {name} directly in the {self.name} block", self)  # noqa: SLF001  same class
        own = span if span is not None else Span("branch", name)
        branch = Branch(name, action, self._changed, own, ordered=ordered, dropped=dropped)
        branch.span.source = current_call_stack()
        branch.label = label or partial(call_label, branch.name, tuple(branch.span.parameters.values()), {})
        self._add(branch)
        return Future(branch)

    def _refuse_in_timeout(self, name: str) -> None:
        scope = current_scope()
        if scope is None or scope is self.scope or current_branch() is not self._opened_in:
            return
        within = (scope, *scope.around)
        if self.scope in within and any(each.deadline is not None for each in within[: within.index(self.scope)]):
            raise OutlivesTimeout(self.name, name)

    def _add(self, branch: Branch) -> None:
        with self._closing:
            if self.state is State.RUNNING:
                self.branches.append(branch)
        self._take(branch)

    def _take(self, branch: Branch) -> None:
        """Schedule a branch; in a sequential block, run the branch here; in a decided block, cancel the branch."""
        branch.span.parent = self._span.id
        self._taken += 1
        if self.state is not State.RUNNING:
            branch.settle(State.CANCELLED)
            raise BlockClosed(self.name, branch.name)
        with OnError(branch.abandon):  # a signal handler may raise an error
            if self._decided or self.scope.is_cancelled:
                branch.settle(State.CANCELLED)
                branch.span.announce()
                branch.span.finish(Cancelled())
            elif self.policy.concurrent:
                name = f"{self.name}-{self._taken} {branch.name}"
                site = branch.span.source.line if branch.span.source is not None else ("", 0)
                branch.runs_in = name
                number = self._taken
                label = lambda: f"{self.name}-{number} {branch.label()}"  # noqa: E731  short
                self._scheduler.begin(name, branch.context, partial(self._run, branch), branch.abandon, site, label)
            else:
                branch.runs_in = current_name()
                branch.context.run(enter_branch, current_branch())  # another branch may have added this branch
                branch.context.run(self._run, branch)
        ends_body = self.policy.propagates or not isinstance(branch.error, PlanFailure)
        if branch.error is not None and ends_body and not self.policy.concurrent:
            raise branch.error
        if self._around is not None and self._around.is_cancelled:
            raise Cancelled

    def _run(self, branch: Branch) -> None:
        """Run a branch in its own context, in which actions run in order; store the outcome instead of raising."""
        result: Result = None
        try:
            leave_body()
            enter(self.scope)
            with branch.span:
                branch.span.result = result = branch.begin()
        except Cancelled:
            self._settle(branch, State.CANCELLED)
        except BaseException as error:  # noqa: BLE001  the error is raised where the block was opened
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
        self._body_failures.append(failure)
        if not self._decided and State.FAILED in self.policy.decided_by:
            self._decided = True
            self.scope.cancel()

    def _add_ended(self, nested: str, raised: BaseException | None) -> None:
        state = State.SUCCEEDED if raised is None else State.FAILED
        if isinstance(raised, Cancelled):
            state, raised = State.CANCELLED, None
        branch = Branch(nested, lambda: None, self._changed, Span("branch", nested))
        self.branches.append(branch)
        self._settle(branch, state, error=raised)

    def __enter__(self) -> Self:
        if self.policy.concurrent:  # __exit__ waits, and must succeed
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

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> bool:
        with self._entered:  # the end fails if it can't wait for the branches, or if the block began in another context
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
        """Wait for the branches, set the outcome, and return the error to raise."""
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
        if bugs:  # the program has an error, or the user interrupts the program
            self.state = State.FAILED
            bugs.sort(key=lambda bug: isinstance(bug, Retry))  # if the Retry came first, it would hide the other errors
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
            return chained(failed, [self._deadlock] if self._deadlock else [])
        self._span.error = failed  # this error appears only in the task tree
        return None

    def _outcome(self, error: BaseException | None, failures: tuple[PlanFailure, ...]) -> State:
        """Return the final state of the block, given the error of its body; the caller handles usage errors."""
        if any(leaves_uncleaned(failure) for failure in failures):
            return State.FAILED
        if self.decider is not None:
            return self.decider.state
        cancelled = isinstance(error, Cancelled) or any(branch.state is State.CANCELLED for branch in self.branches)
        if cancelled and not (self._body_failures or self._deadlock):  # an outer block cancelled this block
            return State.CANCELLED
        return State.FAILED if failures else State.SUCCEEDED

    def _record_body_failures(self) -> None:
        """Record the failures of the body that don't belong to a branch."""
        for failure in self._body_failures:
            if not any(branch.error is failure for branch in self.branches):
                body = Span("branch", "body", parent=self._span.id)
                body.ask()
                body.finish(failure)

    def _join(self, interrupt: BaseException | None) -> BaseException | None:
        """Wait for all branches. After an error, cancel the branches; return the last error, or else ``interrupt``."""
        own = self._scheduler
        while True:
            joining, own.joining = own.joining, own.joining or interrupt is not None
            try:
                join(self._changed, self._all_ended, self._reason)
            except LockHeld:  # after another wait, the same failure would follow
                raise
            except DeadlockedBranches as deadlock:
                self._deadlock = deadlock
                if not self.failures:  # otherwise the others wait for what a failed branch would have done
                    interrupt = deadlock
                self.scope.cancel()
                continue
            except BaseException as error:  # noqa: BLE001  the interrupt is returned after the end of the branches
                interrupt = error
                self.scope.cancel()
                continue
            finally:
                own.joining = joining
            if interrupt is not None:
                interrupts.drop_pending()
            with self._closing:
                if self._all_ended():  # otherwise a thread of the plan has added a branch
                    self.state = State.CANCELLED  # no branch can be added any more, and _close() sets the final state
                    return interrupt

    def _reason(self) -> tuple[str, str, list[str]]:
        return f"the end of {self.name}", "", [branch.runs_in for branch in self.branches if not branch.done]

    def _all_ended(self) -> bool:
        while self._joined < len(self.branches) and self.branches[self._joined].done:
            self._joined += 1
        return self._joined == len(self.branches)


class ReadBlock(Block):
    """A block in the body of a concurrent block: its body is read in place, and a branch of its host runs its actions.

    The block runs concurrently with its siblings, but Python runs a ``with`` statement in place. Python therefore only
    *reads* the body: each action goes into a queue, and the branch runs the queue while Python reads the next actions.
    Attempts, timeouts, cleanups and waits for a fluent run in place, after the earlier actions of a sequence.
    """

    def __init__(self, policy: Policy, host: Block, failures: list[BaseException] | None = None) -> None:
        super().__init__(policy, failures)
        self.immediate, self.reads_blocks, self.adds_actions = False, True, True
        self._host = None  # the block is already a branch of its host
        self._run_by = host
        self._pending: deque[Branch] = deque()
        self._dropping = False
        self._body_ended = False
        self._body_error: Exception | None = None

    def await_turn(self) -> None:
        """Wait until the body's own code may act: in a sequence, after the earlier actions."""
        wait(self._changed, lambda: self.state is not State.CREATED)
        if not self.policy.concurrent:
            for branch in self.branches:
                branch.wait()

    def _refuse_early(self, what: str, outer: Block | None) -> None:
        block: Block = self
        above: Branch | None = None  # only branches before this branch count; None for all branches
        while isinstance(block, ReadBlock) and block is not outer:
            if not block.policy.concurrent:
                earlier = block.branches if above is None else block.branches[: block.branches.index(above)]
                pending = [branch.name for branch in earlier if not branch.done]
                if pending:
                    raise RunsEarly(what, block.name, pending)
            block, above = block._run_by, block._own  # noqa: SLF001  same class

    def _begin(self, entering: ExitStack) -> None:
        entering.callback(self._stop_reading)
        started = self._run_by.start(self.name, self._work, dropped=self._drop, span=self._span)
        self._own = cast("Branch", branch_of(started))
        entering.enter_context(self._span.entered())

    def _add(self, branch: Branch) -> None:
        self.branches.append(branch)
        self._pending.append(branch)
        self._changed.notify_all()
        if self._dropping:  # no branch can start any more
            self._drop()

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> bool:
        if error is not None and not isinstance(error, (PlanFailure, Cancelled)):
            self.scope.cancel()  # the program has an error, or the user interrupts the program
        self._body_error = error if isinstance(error, Exception) else None
        self._entered.close()
        if isinstance(error, Cancelled):  # if the decided block cancelled its body, the plan continues after the block
            return self._around is None or not self._around.is_cancelled
        return error is None or isinstance(error, PlanFailure)

    def _stop_reading(self) -> None:
        self._body_ended = True
        self._changed.notify_all()

    def _work(self) -> None:
        stopped: BaseException | None = None
        enter(self.scope)
        self.state = State.RUNNING
        self._changed.notify_all()
        try:
            while not self._body_ended or self._pending:
                if self._pending:
                    self._take(self._pending.popleft())
                wait(self._changed, lambda: bool(self._pending) or self._body_ended, reason=self._reason_to_read)
        except BaseException as stop:  # noqa: BLE001  raised below
            self.scope.cancel()  # ends the reading
            stopped = stop
        self._drop()
        join(self._changed, lambda: self._body_ended, self._reason_to_read)  # the code of the body itself may still act
        error = self._body_error
        if isinstance(error, PlanFailure):
            self._body_failed(error)
            error = None
        raised = self._close(error or stopped)
        if raised is not None:
            raise_unchanged(raised)

    def _reason_to_read(self) -> tuple[str, str, tuple[str, ...]]:
        return f"the body of {self.name}", "", ()

    def _drop(self) -> None:
        self._dropping = True
        if self.state is State.CREATED:
            self.state = State.CANCELLED
        while self._pending:
            self._pending.popleft().settle(State.CANCELLED)


class Opening(Scope[Block]):
    """Opens a block at the start of a ``with`` statement; several statements and threads may use the same object."""

    def __init__(self, policy: Policy, failures: list[BaseException] | None = None) -> None:
        super().__init__(policy.name)
        self._policy = policy
        self._failures = failures

    def _opened(self) -> Block:
        host = current_block()
        if host is not None and host.reads_blocks:
            return ReadBlock(self._policy, host, self._failures)
        return Block(self._policy, self._failures)


class Nothing(Opening, list[Result]):
    """The value of ``par()``: it opens a block, and is also an empty list, like the result of ``par(*[])``."""

    def __init__(self, policy: Policy) -> None:
        list.__init__(self)
        super().__init__(policy)


class Kind(Opening):
    """One of the five words, which open a block with or without parentheses, or run functions."""

    @overload
    def __call__(self) -> Opening: ...
    @overload
    def __call__(self, failures: list[BaseException], /) -> Opening: ...
    @overload
    def __call__(self, *branches: Action) -> Result: ...
    def __call__(self, *branches: Action | list[BaseException]) -> Result:
        """Open a block, or run functions as its branches.

        Args:
            branches: Functions, or one list to which the block adds the failures of its branches; none to open a block.

        Returns:
            Without functions, a context manager. With functions, a list of the results; ``pursue``, ``try_all`` and
            ``try_in_order`` return the result of the deciding branch. In the body of a block, the result is a future of
            this value.

        Raises:
            BadArgument: An argument isn't a function, or a list isn't the only argument.
            BranchesFailed: The block failed.
        """
        if not branches:
            return Nothing(self._policy)
        if len(branches) == 1 and isinstance(branches[0], list):
            return Opening(self._policy, branches[0])
        actions = [branch for branch in branches if callable(branch)]
        if len(actions) != len(branches):
            wrong = next(branch for branch in branches if not callable(branch))
            raise BadArgument("branch", wrong, "a function, or a single list that collects failures")
        host = current_block()
        return self._run(actions) if host is None else host.start(self._policy.name, lambda: self._run(actions))

    def _run(self, actions: list[Action]) -> Result:
        with self as block:
            futures = [block(action) for action in actions]
        if State.SUCCEEDED in self._policy.decided_by:
            return block.decider.result() if block.decider is not None else None
        return [future.result() for future in futures]

    def __repr__(self) -> str:
        return self._policy.name


par: Final = Kind(Policy("par", concurrent=True, decided_by=frozenset()))
"""Run branches concurrently until all have ended; fail if any branch fails."""

pursue: Final = Kind(Policy("pursue", concurrent=True, decided_by=frozenset({State.SUCCEEDED, State.FAILED})))
"""Run branches concurrently; the first that ends decides the outcome, and the others are cancelled."""

try_all: Final = Kind(Policy("try_all", concurrent=True, decided_by=frozenset({State.SUCCEEDED})))
"""Run branches concurrently; the first that succeeds decides the outcome, and the others are cancelled."""

seq: Final = Kind(Policy("seq", concurrent=False, decided_by=frozenset({State.FAILED})))
"""Run branches in order until one fails."""

try_in_order: Final = Kind(Policy("try_in_order", concurrent=False, decided_by=frozenset({State.SUCCEEDED})))
"""Run branches in order until one succeeds."""
