"""Printed and logged lines of a plan as records. Each record has a line, and the place in the plan that printed it.

Output of native code isn't recorded. Parts of a line are joined, separately for each thread and branch. If a progress
bar overwrites a line, only the line's last text is recorded. Messages of ``logging`` are recorded once.
"""

from __future__ import annotations

import logging
import re
import sys
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from contextvars import ContextVar
from typing import Any, Final, TextIO, TypeAlias

from recorder.errors import discard
from recorder.records import Output, escaped, format_error
from recorder.records.tracebacks import result_or
from recorder.tracing import context, journal
from recorder.tracing.call_stack import CallSite, call_site
from recorder.tracing.context import current_ident, current_name
from recorder.tracing.journal import Journal

MAX_CHARACTERS: Final = 10_000  # maximum number of characters in a record; longer lines are split into several records

_Origin: TypeAlias = tuple[CallSite, int]  # the plan's line that began an output line, and the task's id
_CONTROL: Final = re.compile(r"\x1b\[[0-?]*[ -/]*[@-~]")  # escape sequences of terminals, such as colours
#: Whether handlers of logging are printing a message, which is already recorded.
_logging: ContextVar[bool] = ContextVar("pycram_logging", default=False)


@contextmanager
def recorded_output(log: Journal) -> Iterator[None]:
    """Record the lines that are printed and logged in the block."""
    with ExitStack() as restoring:
        for name in ("stdout", "stderr"):
            if getattr(sys, name) is not None:
                restoring.enter_context(_replaced(name, log))
        restoring.enter_context(_logged(log))
        yield


@contextmanager
def _replaced(name: str, log: Journal) -> Iterator[None]:
    stream = getattr(sys, name)
    recorded = RecordedStream(stream, name, log)
    setattr(sys, name, recorded)
    try:
        yield
    finally:
        if getattr(sys, name) is recorded:  # if not, the plan has set another stream
            setattr(sys, name, stream)
        recorded.end()


@contextmanager
def _logged(log: Journal) -> Iterator[None]:
    """Record messages before loggers call handlers. A handler of our own would change the effect of ``basicConfig``."""
    before = logging.Logger.callHandlers
    ended = False

    def call_handlers(self: logging.Logger, record: logging.LogRecord) -> None:
        if not ended and not _logging.get():
            _append(log, _logged_line(record), _here())
        token = _logging.set(True)
        try:
            before(self, record)
        finally:
            _logging.reset(token)

    logging.Logger.callHandlers = call_handlers  # type: ignore[method-assign]
    try:
        yield
    finally:
        ended = True
        if logging.Logger.callHandlers is call_handlers:  # otherwise a later replacement still calls this function
            logging.Logger.callHandlers = before  # type: ignore[method-assign]


def _logged_line(message: logging.LogRecord) -> Output:
    text = result_or(message.getMessage, lambda _: str(message.msg))
    if message.exc_info and message.exc_info[1] is not None:
        text = f"{text}: {format_error(message.exc_info[1])}"
    return Output(
        stream="logging", text=escaped(text[:MAX_CHARACTERS]), level=message.levelname, logger=escaped(message.name)
    )


def _here() -> _Origin:
    return call_site(), journal.announced_task_id()


class RecordedStream:
    """A text stream that passes all text to another stream, and records the lines.

    All other attributes are attributes of the other stream. If the output's reader has gone, as after ``| head``, lines
    are only recorded.
    """

    def __init__(self, stream: TextIO, name: str, log: Journal) -> None:
        self._stream, self._name, self._log = stream, name, log
        self._begun: dict[int, tuple[str, _Origin]] = {}  # incomplete lines, by thread or branch
        self._ended = False

    def write(self, text: str) -> int:
        """Write a text, and record the lines that it completes."""
        try:
            count = self._stream.write(text)
        except BrokenPipeError:
            discard(self._stream)
            count = len(text)
        if not (self._ended or _logging.get()) and journal.records_here(self._log):
            key = current_ident()
            begun, origin = self._begun.pop(key, ("", None))
            *lines, rest = (begun + text).split("\n")
            if origin is None:
                origin = _here()
            for line in lines:
                self._record(line, origin)
            if lines and rest:
                origin = _here()
            rest = _visible(rest)
            whole = max(0, len(rest) - 1) // MAX_CHARACTERS * MAX_CHARACTERS
            if whole:
                self._record(rest[:whole], origin)
            if rest := _visible(rest[whole:]):
                self._begun[key] = rest, origin
        return count

    def writelines(self, lines: Iterable[str]) -> None:
        """Write several texts."""
        for line in lines:
            self.write(line)

    def flush(self) -> None:
        """Flush the other stream."""
        try:
            self._stream.flush()
        except BrokenPipeError:
            discard(self._stream)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def __iter__(self) -> Iterator[str]:
        return iter(self._stream)

    @property  # type: ignore[misc]  # isinstance() looks for this method here
    def __class__(self) -> type:
        return type(self._stream)

    def end(self) -> None:
        """Record the incomplete lines. From now on, the stream records nothing."""
        self._ended = True
        for text, origin in self._begun.values():
            self._record(text, origin)
        self._begun.clear()

    def _record(self, line: str, origin: _Origin) -> None:
        text = _CONTROL.sub("", _visible(line).rstrip("\r")).rstrip()
        for at in range(0, len(text), MAX_CHARACTERS):
            _append(self._log, Output(stream=self._name, text=escaped(text[at : at + MAX_CHARACTERS])), origin)


def _visible(text: str) -> str:
    """Return the text that a terminal shows for a line with carriage returns. The line may be incomplete."""
    if "\r" not in text:
        return text
    last = next((part for part in reversed(text.split("\r")) if part), "")
    return f"{last}\r" if last and text.endswith("\r") else last


def _append(log: Journal, record: Output, origin: _Origin) -> None:
    if not journal.records_here(log):
        return
    context.require_stack_room(context.FOR_RECORD)
    record.world, record.sim_step = journal.current_world()
    (record.source_file, record.source_line), record.task = origin
    record.thread = current_name()
    log.append(record)
