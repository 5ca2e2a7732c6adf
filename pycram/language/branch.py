"""Branches: the actions of a block, and their outcomes.

An action is a plain function of the plan. A coroutine function or a generator function is rejected, because its call
would succeed without running its code.
"""

from __future__ import annotations

import ast
import linecache
import reprlib
from collections.abc import Callable, Mapping
from contextlib import suppress
from contextvars import Context, copy_context
from dataclasses import KW_ONLY, dataclass, field
from functools import partial
from inspect import GEN_CREATED, getgeneratorstate
from types import AsyncGeneratorType, CoroutineType, FunctionType, GeneratorType, MethodType
from typing import TYPE_CHECKING, Any, Final, TypeAlias, TypeVar, cast

from pycram.foundation.failures import BadArgument, UsageError
from pycram.scheduling.cancellation import body, raise_if_cancelled, wait
from pycram.scheduling.future import branch_of, unwrap
from pycram.scheduling.schedule import Condition, scheduler
from recorder.tasks import State
from recorder.tracing.span import Cancelled, Span

if TYPE_CHECKING:
    from pycram.language.block import Block

Result: TypeAlias = Any  # the result of an action: the value that its process module or function returns
Function = TypeVar("Function", bound="Callable[..., Result]")

_LAZY: Final = "__pycram_lazy__"
_NOT_BEGUN: Final = "a plain function; a generator function runs only when its values are read: use `lambda: [*f()]`"
_EMPTY_CONTEXT: Final = Context()
_MAX_LABEL: Final = 60  # maximum length of a lambda's body in a label


class NoResult(UsageError):
    """A plan used the result of a branch that was cancelled, because its block was decided."""

    def __init__(self, branch: str) -> None:
        super().__init__(
            f"{branch} has no result: this branch was cancelled when another decided the block; see s.branches"
        )
        self.branch = branch  # name of the branch


def _nothing() -> None:
    """Replace the action of an ended branch."""


@dataclass(eq=False, repr=False)
class Branch:
    """One action of a block, and its outcome.

    A branch runs in a copy of the context that added the branch. At its end, a branch releases its action and its
    context, because both may refer to the block.
    """

    name: str
    action: Callable[[], Result]
    changed: Condition  # condition of the block, notified when the branch ends
    span: Span  # node of the task tree
    _: KW_ONLY
    ordered: bool = False  # whether the branch waits only for earlier branches
    dropped: Callable[[], None] = _nothing  # called once if the branch never starts; must not raise an error
    context: Context = field(default_factory=copy_context, init=False)
    state: State = field(default=State.CREATED, init=False)
    error: BaseException | None = field(default=None, init=False)  # None after success or cancellation
    label: Callable[[], str] = field(init=False)  # returns the branch's name with its arguments, for messages
    #: Recorded name of the concurrent branch or thread that runs this branch; "" before its start.
    runs_in: str = field(default="", init=False)
    _begun: bool = field(default=False, init=False)
    _result: Result = field(default=None, init=False)

    def __post_init__(self) -> None:
        self.label = partial(str, self.name)

    @property
    def done(self) -> bool:
        """Whether the branch has ended."""
        return self.state not in (State.CREATED, State.RUNNING)

    def begin(self) -> Result:
        """Run the action, and return its result."""
        self._begun = True
        self.state = State.RUNNING
        result = unwrap(self.action())
        if (error := scheduler().take_failure()) is not None:  # a failure that hasn't been raised at any checkpoint
            raise error
        return result

    def settle(self, state: State, result: Result = None, error: BaseException | None = None) -> None:
        """Set the outcome; called once."""
        if not self._begun:
            self.dropped()
            self.span.finish(error or Cancelled())  # the request of the span may already be on record
        self.action, self.context, self.dropped = _nothing, _EMPTY_CONTEXT, _nothing
        self.label = partial(str, self.name)
        self._result, self.error = result, error
        self.state = state  # set after the outcome, because other threads read this value
        self.changed.notify_all()

    def abandon(self, error: BaseException) -> None:
        """Fail a branch that couldn't end because of an error, such as an error of a signal handler."""
        if not self.done:
            self.settle(State.FAILED, error=error)

    def wait(self, timeout: float | None = None) -> bool:
        """Wait for the branch; return whether it ends within the timeout (s). Raise Cancelled in a cancelled branch."""
        return wait(self.changed, lambda: self.done, timeout, lambda: (f"the end of {self.name}", "", [self.runs_in]))

    def result(self, timeout: float | None = None) -> Result:
        """Wait for the end of the branch; return its result, or raise its error. The timeout is in s.

        Raises:
            TimeoutError: The branch still runs after the timeout.
            Cancelled: The waiting branch is cancelled.
            NoResult: This branch was cancelled.
        """
        if not self.wait(timeout):
            raise TimeoutError(f"{self.name} still runs after {timeout} s")
        if self.state is State.CANCELLED:
            raise_if_cancelled()
            raise NoResult(self.name)
        if self.error is not None:
            raise self.error
        return self._result

    def __repr__(self) -> str:
        return f"Branch({self.name!r}, {self.state.word})"


def name_of(action: Callable[..., Result]) -> str:
    """Return the qualified name of a function, without its module and without an enclosing function."""
    return str(getattr(action, "__qualname__", None) or type(action).__qualname__).rpartition("<locals>.")[2]


def label_of(action: Callable[..., Result], args: tuple[object, ...], kwargs: Mapping[str, object]) -> str:
    """Return the text of a call, such as "fetch(milk)", without waiting for futures or calling code of the plan."""
    if isinstance(action, partial):
        return label_of(action.func, (*action.args, *args), {**action.keywords, **kwargs})
    if isinstance(action, MethodType):
        return call_label(f"{_value_label(action.__self__)}.{action.__name__}", args, kwargs)
    if isinstance(action, FunctionType) and action.__name__ == "<lambda>":
        return _lambda_label(action, args) or call_label("<lambda>", args, kwargs)
    return call_label(name_of(action), args, kwargs)


def call_label(name: str, args: tuple[object, ...], kwargs: Mapping[str, object]) -> str:
    """Return the text of a call; without arguments, only the name."""
    shown = [*map(_value_label, args), *[f"{key}={_value_label(value)}" for key, value in kwargs.items()]]
    return f"{name}({', '.join(shown)})" if shown else name


def _value_label(value: object) -> str:
    kind = type(value)
    if kind in (str, int, float, bool, type(None)):
        return reprlib.repr(value)
    if (branch := branch_of(value)) is not None:
        return branch.name
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(_value_label, value[:3]))}{', ...' if value[3:] else ''}]"
    name = getattr(value, "name", None) if kind.__module__.startswith("pycram.") else getattr(value, "__name__", None)
    return name if isinstance(name, str) else kind.__name__


def _lambda_label(function: FunctionType, args: tuple[object, ...]) -> str:
    """Return the body of a one-line lambda, with the values of variables in its calls; "" if its source is unknown."""
    code = function.__code__
    places = [each for each in code.co_positions() if each[0] == each[1] and each[3]]
    if len({each[0] for each in places}) != 1:
        return ""
    line = linecache.getline(code.co_filename, places[0][0] or 0).encode()
    text = line[min(each[2] or 0 for each in places) : max(each[3] or 0 for each in places)].decode(errors="replace")
    names = [*code.co_varnames[: code.co_argcount]]
    defaults = function.__defaults__ or ()
    values = dict(zip(names[len(names) - len(defaults) :], defaults, strict=True)) | dict(
        zip(names, args, strict=False)
    )
    for name, cell in zip(code.co_freevars, function.__closure__ or (), strict=True):
        with suppress(ValueError):  # a variable may have no value yet
            values[name] = cell.cell_contents
    try:
        body = ast.parse(text.strip(), mode="eval").body
    except SyntaxError:
        return ""
    for call in ast.walk(body):
        if isinstance(call, ast.Call):
            call.args = [
                ast.Name(_value_label(values[arg.id])) if isinstance(arg, ast.Name) and arg.id in values else arg
                for arg in call.args
            ]
    text = ast.unparse(body)
    return text if len(text) <= _MAX_LABEL else f"{text[: _MAX_LABEL - 3]}..."


def current_block() -> Block | None:
    """Return the block to which the present context adds actions; None if actions run in order."""
    return cast("Block | None", body.get())


def run(action: Callable[..., Result], *args: object, **kwargs: object) -> Result:
    """Call an action, and return its result; raise BadArgument for a coroutine function or a generator function."""
    result = action(*args, **kwargs)
    kind = type(result)  # isinstance() would wait for a future
    if kind is CoroutineType or kind is AsyncGeneratorType:
        if kind is CoroutineType:
            result.close()  # otherwise Python warns that the coroutine was never awaited
        expected = "a plain function; `lambda: asyncio.run(...)` runs an async function"
        raise BadArgument("action", name_of(action), expected)
    if kind is GeneratorType and getgeneratorstate(result) == GEN_CREATED:
        function = _unwrapped(action)
        if hasattr(function, _LAZY) or getattr(function, "__code__", None) is result.gi_code:
            raise BadArgument("action", name_of(action), getattr(function, _LAZY, _NOT_BEGUN))
    return result


def lazy(instead: str) -> Callable[[Function], Function]:
    """Decorate a function that returns a generator for its work, and is no action; ``instead`` is the remedy."""

    def mark(function: Function) -> Function:
        setattr(function, _LAZY, instead)
        return function

    return mark


def _unwrapped(action: Callable[..., Result]) -> object:
    """Return the function that partials, methods, decorators or callable objects finally call."""
    function: Any = action
    while True:
        if isinstance(function, partial):
            function = function.func
        elif isinstance(function, MethodType):
            function = function.__func__
        elif hasattr(function, "__wrapped__"):  # a decorator has set it
            function = function.__wrapped__
        elif isinstance(function, FunctionType) or not isinstance(type(function).__call__, FunctionType):
            return function
        else:
            function = type(function).__call__
