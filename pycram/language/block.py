"""Blocks: what they have in common, and what makes ``par`` another thing than ``pursue``.

The whole difference between the five blocks is their :class:`Policy`: whether branches run side by side, and which end
of a branch decides the block. A block that is decided cancels its other branches; it ends when all of them have ended,
and as its deciding branch did. One that nothing decided failed if any of its branches did.

A plan failure in the body ends the body and is one of the block's failures: it decides the block where a failure of a
branch would, and never turns one that is decided. What is asked for when the block is decided isn't run: its future
says so.

Two things come out of any block, however it is decided. A usage error, in a branch or in the body, ends it and comes
out as it is: it is never collected, retried or outvoted. A branch that could not clean up when it was told to stop has
left the world in a state that nobody reckons with, and fails the block.

A block in the body of another one, its *host*, counts as one branch there:

- In ``try_in_order`` it is one of the things to try: it runs where it stands, and its failure is kept for the host,
  which goes on with what follows.
- In a concurrent block it is to run beside its siblings, but a ``with`` statement runs where it stands. So its body is
  only *read* there: what it asks for is done by a branch of the host, while the statements after it are read. Whoever
  looks at a future in that body waits for its result. An attempt, a timeout, a cleanup or the wait for a fluent in that
  body runs where it stands, when what was asked for before it in a sequence is done.

Code in a body asks the block around it, which its context carries, for branches. In a branch there is none, and things
happen one after the other. A decided ``try_in_order`` ends its body at the next block in it; variables that this would
have set are not set then.
"""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from pycram.foundation.error_chain import chained, raise_unchanged
from pycram.foundation.failures import BadArgument, PlanFailure, UsageError
from pycram.language.actions import Result, name_of, run
from pycram.language.attempts import Retry
from pycram.language.body import current_block, in_block, leave_body
from pycram.language.branch import Branch
from pycram.language.failures import BranchesFailed, leaves_uncleaned
from pycram.scheduling.cancellation import (
    Cancelled,
    CancelScope,
    current_scope,
    enter,
    entered,
    join,
    raise_if_cancelled,
    wait,
)
from pycram.scheduling.future import Future
from pycram.scheduling.locks import LockHeld, refuse_held
from pycram.scheduling.schedule import Condition, scheduler
from recorder.tasks import State
from recorder.threads import current_branch, enter_branch
from recorder.tracing import interrupts
from recorder.tracing.span import Span, current_call_stack

if TYPE_CHECKING:
    from collections.abc import Callable
    from contextlib import AbstractContextManager
    from types import TracebackType
    from typing import Self


class BlockClosed(UsageError):
    """A branch was asked of a block that has ended.

    Attributes:
        block: what the block is.
        branch: what was asked for.
    """

    def __init__(self, block: str, branch: str) -> None:
        super().__init__(f"{branch} can't be a branch of this {block} block: the block has ended")
        self.block = block
        self.branch = branch


@dataclass(frozen=True, slots=True)
class Policy:
    """What makes one kind of block another than the others.

    Attributes:
        name: what it is called.
        concurrent: whether its branches run side by side.
        decided_by: a branch that ends so decides the block.
    """

    name: str
    concurrent: bool
    decided_by: frozenset[State]

    @property
    def propagates(self) -> bool:
        """Whether a failure rises through the body as in plain Python, where it ends the block unless it is handled."""
        return not self.concurrent and State.FAILED in self.decided_by

    @property
    def first_success(self) -> bool:
        """Whether one success is enough."""
        return State.SUCCEEDED in self.decided_by


class Block:
    """A block: ``s`` in ``with par as s``.

    Attributes:
        policy: what kind of block it is.
        branches: its branches, in the order in which they were asked for.
        scope: in which its body and its branches run; told to stop when the block is decided.
        decider: the branch that decided it; None as long as none has.
        state: how far it is, or how it ended.
    """

    def __init__(self, policy: Policy, failures: list[BaseException] | None = None) -> None:
        """Makes a block for a body that begins here; its failures go into the list, or are raised."""
        self.policy = policy
        self.branches: list[Branch] = []
        self.scope = CancelScope(current_scope())
        self.decider: Branch | None = None
        self.state = State.CREATED
        self._around = current_scope()
        self._collected = failures
        self._host = host = current_block()
        self._is_read: bool = host is not None and (host.policy.concurrent or host._is_read)  # noqa: SLF001  same class
        self._changed = Condition()  # notified when a branch ends, and of all that a body that is read waits for
        self._closing = threading.Lock()  # a plan's own threads may ask for branches while it ends
        self._scheduler = scheduler()
        self._numbers = 0
        self._joined = 0
        self._decided = False  # by its decider, or by a failure of the body
        self._body_failures: list[PlanFailure] = []
        self._bindings: tuple[AbstractContextManager[None], ...] = ()  # what holds as long as its body runs
        self._span = Span("block", policy.name)
        # of a body that is read
        self._asked: deque[Branch] = deque()
        self._dropping = False
        self._body_ended = False
        self._body_error: Exception | None = None

    @property
    def name(self) -> str:
        """What it is: "par", ..."""
        return self.policy.name

    @property
    def immediate(self) -> bool:
        """Whether an action begins at once, whatever was asked for before it."""
        return self.policy.concurrent and not self._is_read

    @property
    def failures(self) -> tuple[PlanFailure, ...]:
        """The failures of its branches and of its body so far."""
        errors = [branch.error for branch in list(self.branches)] if not self.policy.propagates else []
        failures = [one for one in errors if isinstance(one, PlanFailure)]
        known = {id(failure) for failure in failures}
        return (*failures, *[failure for failure in self._body_failures if id(failure) not in known])

    # --- branches ---------------------------------------------------------------------------------------------------

    def __call__(self, action: Callable[..., Result], *args: object, **kwargs: object) -> Future:
        """Asks for a branch that calls a function; gives a future that serves as its result.

        Raises:
            BadArgument: it can't be called.
            BlockClosed: the block has ended.
            PlanFailure: the function failed, in a ``seq`` block.
        """
        if not callable(action):
            raise BadArgument("action", action, "a function to run as a branch")

        def act() -> Result:
            raise_if_cancelled()  # before it began
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
        """Asks for a branch.

        Args:
            name: what it is called.
            action: what it does.
            ordered: whether it waits only for what was asked for before it.
            dropped: called once if it is never begun.
            span: its node of the task tree, if it isn't just a branch.

        Returns:
            A future that serves as its result.
        """
        branch = Branch(name, action, self._changed, ordered=ordered, dropped=dropped, span=span)
        branch.span.source = current_call_stack()
        if self._is_read:
            self.branches.append(branch)
            self._asked.append(branch)
            self._changed.notify_all()
            if self._dropping:  # nobody does it any more
                self._drop()
        else:
            self._take(branch)
        return Future(branch)

    def _take(self, branch: Branch) -> None:
        """Runs a branch, unless the block is decided: on its own stack in its turn or, in a sequential block, here.

        Raises:
            BlockClosed: the block has ended.
            PlanFailure: it failed, where that ends the body.
            Cancelled: the block around this one is cancelled.
        """
        branch.span.parent = self._span.id
        with self._closing:
            closed = self.state is not State.RUNNING
            if not closed and not self._is_read:
                self.branches.append(branch)
            self._numbers += 1
        if closed:
            branch.settle(State.CANCELLED)
            raise BlockClosed(self.name, branch.name)
        if self._decided or self.scope.is_cancelled:
            branch.settle(State.CANCELLED)
            branch.span.ask()
            branch.span.finish(Cancelled())
        elif self.policy.concurrent:
            name = f"{self.name}-{self._numbers} {branch.name}"
            self._scheduler.begin(name, branch.context, partial(self._run, branch))
        else:
            branch.context.run(enter_branch, current_branch())  # it was asked for in another one where the body is read
            branch.context.run(self._run, branch)
            error = branch.error
            if error is not None and (self.policy.propagates or not isinstance(error, PlanFailure)):
                raise error
        if self._around is not None and self._around.is_cancelled:
            raise Cancelled

    def _run(self, branch: Branch) -> None:
        """Runs a branch in its own context, in which actions happen one after the other; its errors are its own."""
        result: Result = None
        try:
            leave_body()
            enter(self.scope)
            with branch.span:
                branch.span.result = result = branch.begin()
        except Cancelled:
            self._settle(branch, State.CANCELLED)
        except BaseException as error:  # noqa: BLE001  the block raises it where it was opened
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
        """Takes a failure of the body, which has ended with it."""
        self._body_failures.append(failure)
        if not self._decided and State.FAILED in self.policy.decided_by:
            self._decided = True
            self.scope.cancel()

    def _add(self, nested: str, raised: BaseException | None) -> None:
        """Takes the outcome of a block in its body, which counts as one branch."""
        state = State.SUCCEEDED if raised is None else State.FAILED
        if isinstance(raised, Cancelled):
            state, raised = State.CANCELLED, None
        branch = Branch(nested, lambda: None, self._changed)
        self.branches.append(branch)
        self._settle(branch, state, error=raised)

    # --- from its beginning to its end --------------------------------------------------------------------------------

    def __enter__(self) -> Self:
        if self.policy.concurrent:  # its end gives way, and must not fail
            refuse_held()
        if self._is_read and self._host is not None:
            try:
                self._host.start(self.name, self._work, dropped=self._drop, span=self._span)
            except BaseException:  # told to stop: there will be no body
                self._body_ended = True
                self._changed.notify_all()
                raise
            self._bind(self._span.entered(), entered(self.scope), in_block(self))
        else:
            raise_if_cancelled()
            self._span.__enter__()
            self._bind(entered(self.scope), in_block(None if self.policy.propagates else self))
            self.state = State.RUNNING
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool:
        if self._is_read:
            return self._end_body(error)
        ended = error
        try:
            try:
                raised = ended = self._close(error)
            finally:
                self._unbind()
        except BaseException as wrong:  # it can't wait for its branches, or this is another context than it began in
            ended = wrong
            raise
        finally:
            self._span.__exit__(type(ended) if ended is not None else None, ended, None)
        if self._host is not None:
            self._host._add(self.name, raised)  # noqa: SLF001  same class
            if isinstance(raised, PlanFailure):
                return True
        if raised is not None and raised is not error:
            raise_unchanged(raised)
        return raised is None

    def _bind(self, *bindings: AbstractContextManager[None]) -> None:
        """From here on the context is that of its body."""
        self._bindings = bindings
        for binding in bindings:
            binding.__enter__()

    def _unbind(self) -> None:
        bindings, self._bindings = self._bindings, ()
        for binding in reversed(bindings):
            binding.__exit__(None, None, None)

    def _close(self, error: BaseException | None) -> BaseException | None:
        """Waits for the branches, says how the block ended, and gives what is to be raised."""
        ended = self._end(error)
        if ended is None and self.state is State.FAILED:  # collected instead of raised; the tree tells it
            self._span.error = BranchesFailed(self.name, self.failures)
        return ended

    def _end(self, error: BaseException | None) -> BaseException | None:
        if isinstance(error, PlanFailure):
            self._body_failed(error)
        elif error is not None:
            self.scope.cancel()
        pressed = self._join(error if isinstance(error, KeyboardInterrupt) else None)
        if isinstance(pressed, PlanFailure):
            self._body_failed(pressed)
        errors = (pressed, error if error is not pressed else None, *[branch.error for branch in self.branches])
        failures = self.failures
        bugs = [one for one in errors if one is not None and not isinstance(one, (PlanFailure, Cancelled))]
        if bugs:  # the program is wrong, or the user wants out
            self.state = State.FAILED
            bugs.sort(key=lambda one: isinstance(one, Retry))  # trying again would hide the others
            return chained(bugs[0], [*bugs[1:], *failures])
        self.state = self._outcome(error, failures)
        if self._collected is not None:
            self._collected.extend(failures)
        if self.state is State.CANCELLED:
            return chained(error if isinstance(error, Cancelled) else Cancelled(), failures)
        if self.state is State.SUCCEEDED:
            for failure in self._body_failures:
                self._note_down(failure)
            return None
        return None if self._collected is not None else BranchesFailed(self.name, failures)

    def _outcome(self, error: BaseException | None, failures: tuple[PlanFailure, ...]) -> State:
        """How the block ended, where the program is right; the error came out of the body."""
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

    def _join(self, pressed: BaseException | None) -> BaseException | None:
        """Waits for all branches; those of a block in which things happen in order have ended anyway.

        Args:
            pressed: Ctrl-C that ended the body; another one is no news then.

        Returns:
            The same; or Ctrl-C, or what a handler of another signal raised, that came meanwhile and has stopped them.
        """
        here = scheduler()
        while True:
            joining, here.joining = here.joining, here.joining or pressed is not None
            try:
                join(self._changed, self._all_ended)
            except LockHeld:  # it would be refused again
                raise
            except BaseException as interrupt:  # noqa: BLE001  raised when the branches have ended
                pressed = interrupt
                self.scope.cancel()
                continue
            finally:
                here.joining = joining
            if pressed is not None:
                interrupts.drop_pending()
            with self._closing:
                if self._all_ended():  # else a thread of the plan's own has asked for another one
                    self.state = State.CANCELLED  # closed; what it really is comes next
                    return pressed

    def _all_ended(self) -> bool:
        while self._joined < len(self.branches) and self.branches[self._joined].done:
            self._joined += 1
        return self._joined == len(self.branches)

    # --- a body that is read ------------------------------------------------------------------------------------------

    def await_turn(self) -> None:
        """Waits until the body itself may act: where it is read, when what was asked for before it in order is done.

        Raises:
            Cancelled: the block is decided, or told to stop.
        """
        if self._is_read:
            wait(self._changed, lambda: self.state is not State.CREATED)
            if not self.policy.concurrent:
                for branch in self.branches:
                    branch.wait()

    def _end_body(self, error: BaseException | None) -> bool:
        """Takes the end of a body that was read; returns whether what came out of it is taken care of."""
        self._unbind()
        if error is not None and not isinstance(error, (PlanFailure, Cancelled)):
            self.scope.cancel()  # the program is wrong, or the user wants out
        self._body_error = error if isinstance(error, Exception) else None
        self._body_ended = True
        self._changed.notify_all()
        if isinstance(error, Cancelled):  # by its own block, which is decided: the body around it goes on
            return self._around is None or not self._around.is_cancelled
        return error is None or isinstance(error, PlanFailure)

    def _work(self) -> None:
        """Does what the body asks for, in a branch of the host."""
        stopped: BaseException | None = None
        enter(self.scope)
        self.state = State.RUNNING
        self._changed.notify_all()
        try:
            while self._next_asked():
                self._take(self._asked.popleft())
        except BaseException as error:  # noqa: BLE001  raised below
            self.scope.cancel()  # there is no use in reading on
            stopped = error
        self._drop()
        join(self._changed, lambda: self._body_ended)  # what the body does itself is part of this block too
        wrong = self._body_error
        if isinstance(wrong, PlanFailure):
            self._body_failed(wrong)
            wrong = None
        raised = self._close(wrong or stopped)
        if raised is not None:
            raise_unchanged(raised)

    def _next_asked(self) -> bool:
        """Waits for the next branch that the body asks for; False when it has ended."""
        wait(self._changed, lambda: bool(self._asked) or self._body_ended)
        return bool(self._asked)

    def _drop(self) -> None:
        """Nothing more will be done; drops what has not been."""
        self._dropping = True
        if self.state is State.CREATED:  # nor has anything been
            self.state = State.CANCELLED
        while self._asked:
            self._asked.popleft().settle(State.CANCELLED)
