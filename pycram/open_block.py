"""What a plan sees of a block: the body's side of it.

Code in the body of a block asks the block around it, its *host*, for branches. Which one that is, the context carries:
in a branch there is none, and things happen one after the other.
"""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pycram.actions import Result, name_of, run
from pycram.binding import Binding
from pycram.branch import Branch
from pycram.cancellation import checkpoint, enter
from pycram.foundation.failures import BadArgument, PlanFailure, UsageError
from pycram.handle import Handle
from pycram.nesting import nothing_open
from recorder.tasks import State
from recorder.tracing.span import current_call_stack

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import TracebackType
    from typing import Self

    from pycram.cancellation import Scope
    from recorder.tracing.span import Span


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
class Rule:
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
    def plain(self) -> bool:
        """Whether a failure rises through the body as in plain Python, where it ends the block unless it is handled."""
        return not self.concurrent and State.FAILED in self.decided_by

    @property
    def takes_one(self) -> bool:
        """Whether one success is enough."""
        return State.SUCCEEDED in self.decided_by


_host: ContextVar[OpenBlock | None] = ContextVar("pycram_block", default=None)


def current_block() -> OpenBlock | None:
    """The block whose branches are the actions here; None where actions happen one after the other and raise."""
    return _host.get()


def hosted(host: OpenBlock | None) -> Binding[OpenBlock | None]:
    """Makes actions in its block branches of a block.

    Args:
        host: the block; None lets actions happen one after the other.
    """
    return Binding(_host, host)


def enter_branch(scope: Scope) -> None:
    """Makes the context that of a branch, in which actions happen one after the other.

    Args:
        scope: its block's.
    """
    _host.set(None)
    nothing_open()
    enter(scope)


def await_turn() -> None:
    """Waits until the code here may act itself: in a body that is only read, that is when its turn has come.

    Raises:
        Cancelled: the block around it is decided, or told to stop.
    """
    host = current_block()
    if host is not None:
        host.catch_up()


@contextmanager
def alone() -> Iterator[Callable[[], None]]:
    """Runs its block in the thread of the body, one thing after the other; failures rise in it as in plain Python.

    Yields:
        What to call at the block's end: waits for what it asked of a sequence around it.

    Raises:
        Cancelled: the block around it is decided, or told to stop.
    """
    await_turn()
    checkpoint()
    host = current_block()
    with hosted(None):
        yield host.catch_up if host is not None else lambda: None


class OpenBlock(ABC):
    """What the plan has of a block: ``s`` in ``with par as s``.

    Attributes:
        rule: what kind of block it is.
        branches: its branches, in the order in which they were asked for.
        changed: notified when one of them ends; guards what it knows of them.
        readings: to be called when its body has ended: each says so to a block that is read in it, however deep. Ctrl-C
            between two statements may have kept that one from knowing.
    """

    def __init__(self, rule: Rule) -> None:
        """Makes a block.

        Args:
            rule: what kind.
        """
        self.rule = rule
        self.branches: list[Branch] = []
        self.changed = threading.Condition()
        self.readings: list[Callable[[], None]] = []

    @property
    def name(self) -> str:
        """What it is: "par", ..."""
        return self.rule.name

    @property
    @abstractmethod
    def state(self) -> State:
        """How far it is, or how it ended."""

    @property
    @abstractmethod
    def failures(self) -> tuple[PlanFailure, ...]:
        """The failures of its branches and of its body so far."""

    @property
    @abstractmethod
    def prompt(self) -> bool:
        """Whether an action begins at once, whatever was asked for before it."""

    def __call__(self, action: Callable[..., Result], *args: object, **kwargs: object) -> Handle:
        """Asks for a branch.

        Args:
            action: a function.
            args: its arguments.
            kwargs: its named arguments.

        Returns:
            A handle that serves as its result.

        Raises:
            BadArgument: it can't be called.
            BlockClosed: the block has ended.
            PlanFailure: the function failed, in a ``seq`` block.
        """
        if not callable(action):
            raise BadArgument("action", action, "a function to run as a branch")
        return self.start(name_of(action), lambda: run(action, *args, **kwargs))

    def start(
        self,
        name: str,
        action: Callable[[], Result],
        *,
        ordered: bool = False,
        dropped: Callable[[], None] = lambda: None,
        span: Span | None = None,
    ) -> Handle:
        """Asks for a branch.

        Args:
            name: what it is called.
            action: what it does.
            ordered: whether it waits only for what was asked for before it.
            dropped: called once if it is never begun.
            span: its node of the task tree, if it isn't just a branch.

        Returns:
            A handle that serves as its result.
        """
        branch = Branch(name, action, self.changed, ordered=ordered, dropped=dropped, span=span)
        branch.span.source = current_call_stack()
        self.take(branch)
        return Handle(branch)

    @abstractmethod
    def take(self, branch: Branch) -> None:
        """Runs a branch, now or later, here or in another thread.

        Args:
            branch: one that has not begun.
        """

    def catch_up(self) -> None:  # noqa: B027  most blocks have nothing to wait for
        """Waits until the body itself may act: in a block whose body is only read, that is when its turn has come."""

    @abstractmethod
    def __enter__(self) -> Self:
        """Begins it; what its body asks for are its branches."""

    @abstractmethod
    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool:
        """Ends it; returns whether what came out of the body is taken care of."""
