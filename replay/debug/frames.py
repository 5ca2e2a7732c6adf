"""The plan's frames where it is stopped, and what is in them."""

from __future__ import annotations

import inspect
import pprint
import rlcompleter
import sys
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from itertools import islice
from types import BuiltinFunctionType, FunctionType, ModuleType
from typing import TYPE_CHECKING, Final, NamedTuple

from pycram.scheduling.schedule import scheduler
from recorder.records import format_error
from recorder.tracing import journal
from recorder.tracing.call_stack import is_plan, plan_frames

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from types import FrameType, TracebackType

_IGNORED: Final = (ModuleType, FunctionType, BuiltinFunctionType, type)  # a module's imports and definitions
_MAX_NAMES: Final = 200  # that complete a text


class PlanFrame(NamedTuple):
    """A frame of the plan, and the line that it is at."""

    frame: FrameType
    line: int

    def facts(self, moved: tuple[str, str] | None) -> dict[str, object]:
        """Return file, line, function and its first line; the file by the folder that the plan was moved from."""
        code = self.frame.f_code
        return {
            "file": code.co_filename.replace(*moved or ("", "")),
            "line": self.line,
            "function": code.co_name,
            "first": code.co_firstlineno,
        }


def stack(frame: FrameType | None, parents: Mapping[int, int], *, failing: bool) -> list[PlanFrame]:
    """Return the plan's frames, innermost first; those of a branch are followed by those of the code that waits for it.

    Args:
        frame: the innermost one.
        parents: what each task is part of, by their ids.
        failing: whether an error is on its way out: then frames that it has left come first.
    """
    own = [PlanFrame(each, each.f_lineno) for each in plan_frames(frame)]
    error = sys.exception() if failing else None
    if error is not None and error.__traceback__ is not None:
        left = list(_traceback(error.__traceback__))
        lines = dict(left)
        running = {each for each, _ in own}
        own = [PlanFrame(each, lines.get(each, line)) for each, line in own]
        own = [*(each for each in reversed(left) if each.frame not in running), *own]
    waiting = {}
    for suspended, context in scheduler().suspended():
        task = context.get(journal.current_task)
        waiting[task.id if task is not None else 0] = suspended
    number: int | None = journal.task_id()
    while number is not None:  # 0: outside of all tasks
        number = parents.get(number)
        if number in waiting:
            own += [PlanFrame(each, each.f_lineno) for each in plan_frames(waiting[number])]
    return own


def _traceback(trace: TracebackType | None) -> Iterator[PlanFrame]:
    while trace is not None:
        if is_plan(trace.tb_frame):
            yield PlanFrame(trace.tb_frame, trace.tb_lineno)
        trace = trace.tb_next


def variables(frame: FrameType, *, arguments: bool = False) -> list[tuple[str, str]]:
    """Return the names and values of a frame's variables, or only of its arguments; of modules no definitions."""
    values = dict(frame.f_locals)
    if arguments:
        info = inspect.getargvalues(frame)
        names = [*info.args, *filter(None, (info.varargs, info.keywords))]
        values = {name: values[name] for name in names if name in values}
    elif frame.f_locals is frame.f_globals:
        values = {name: each for name, each in values.items() if not issubclass(type(each), _IGNORED)}
    return [(name, _repr(value)) for name, value in values.items() if not (name[:2] == "__" == name[-2:])]


def evaluate(frame: FrameType, expression: str, *, pretty: bool = False) -> dict[str, str]:
    """Return an expression's value in a frame, or the error that it raised, and what it printed."""
    printed = StringIO()
    answer: dict[str, str] = {}
    with redirect_stdout(printed), redirect_stderr(printed):
        try:
            value = value_of(frame, expression)
            answer["value"] = pprint.pformat(value) if pretty else repr(value)
        except BaseException as error:  # noqa: BLE001  whatever the user's expression raises
            answer["error"] = format_error(error)
    return {**answer, "printed": printed.getvalue()}


def value_of(frame: FrameType, expression: str) -> object:
    """Return an expression's value in a frame."""
    return eval(expression, {**frame.f_globals, **frame.f_locals})  # noqa: S307  the user's own, as in any debugger


def completions(frame: FrameType, text: str) -> list[str]:
    """Return what a text may be the beginning of, in a frame."""
    completer = rlcompleter.Completer({**frame.f_globals, **frame.f_locals})
    found = (completer.complete(text, number) for number in range(_MAX_NAMES))
    return [each for each in islice(found, _MAX_NAMES) if each is not None]


def _repr(value: object) -> str:
    try:
        return repr(value)
    except Exception as error:  # noqa: BLE001  of a user's own type
        return f"<{type(value).__name__}: {format_error(error)}>"
