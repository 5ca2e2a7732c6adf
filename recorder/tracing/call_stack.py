"""Call stacks of tasks: the plan's lines that called one another, outermost first.

A thread that runs part of a task has a stack of its own: its call stack continues that of the code which asked for the
task. So each call stack begins where the plan does, in whatever thread it ends.
"""

from __future__ import annotations

import re
import sys
from contextlib import suppress
from enum import Enum, auto
from inspect import CO_ASYNC_GENERATOR, CO_COROUTINE, CO_GENERATOR
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple, TypeAlias

from recorder.records import SourceLine, escaped
from recorder.records.asset import AssetFile
from recorder.tracing import journal
from recorder.tracing.branch_identity import current_ident

if TYPE_CHECKING:
    from collections.abc import Iterator
    from types import CodeType, FrameType

CallSite: TypeAlias = "tuple[str, int]"  # a file and a line of it, from 1

#: A longer call stack is truncated in the middle.
MAX_LINES: Final = 32
#: Frames of these packages are left out: the plan's lines are outside of them.
_MACHINERY: Final = frozenset({"pycram", "recorder", "replay", "contextlib", "threading", "concurrent", "contextvars"})
#: Modules that run a plan as a program: their callers are left out, too.
_RUNNERS: Final = frozenset({"pycram.cli", "pycram.running", "replay.restore.shell", "replay.retrace.guided_run"})
#: Python's own files, installed packages and their commands: they may call plans, but are none.
_FOREIGN: Final = re.compile(
    r"^<frozen|[/\\][Ll]ib(?:64)?[/\\](?:python3(?:\.\d+)?|site-packages)[/\\]|[/\\](?:bin|Scripts)[/\\][^/\\.]+$"
)
_MAX_CACHED: Final = 4096  # call stacks, and lines
_RESUMABLE: Final = CO_GENERATOR | CO_COROUTINE | CO_ASYNC_GENERATOR


class CallStack(NamedTuple):
    """The plan's lines that led to a task; there is one for each task, so it is the cheapest type of object.

    Attributes:
        lines: outermost first; those of a recursion stand once. Where nothing is recorded only the innermost.
        inherited: those of them that another thread's call stack ends with, which this one continues.
        thread: identifies the thread that it ends in.
        callers: all lines but the innermost, as records hold them.
        recording: number of the recording that it was made for; 0 where nothing was recorded.
    """

    lines: tuple[CallSite, ...]
    inherited: tuple[CallSite, ...]
    thread: int
    callers: tuple[SourceLine, ...] = ()
    recording: int = 0

    @property
    def line(self) -> CallSite:
        """The innermost line; ("", 0) if none is known."""
        return self.lines[-1] if self.lines else ("", 0)

    def at_line(self, number: int) -> CallStack | None:
        """The same call stack with another line of its innermost function; None if the stack must be walked again."""
        lines, inherited, thread, callers, recording = self
        file, latest = lines[-1]
        if recording != journal.recording_number() or lines[-2:-1] == ((file, number),):  # which would stand once
            return None
        if number == latest:
            return self
        return CallStack((*lines[:-1], (file, number)), inherited, thread, callers, recording)


def walk(frame: FrameType | None, outer: CallStack | None = None) -> tuple[CallStack, FrameType | None]:
    """Finds the call stack of some code.

    Args:
        frame: of the code, or of what it has called.
        outer: call stack of the task which this is part of.

    Returns:
        The call stack; and the plan's innermost frame, if :meth:`CallStack.at_line` gives the call stacks of its other
        lines as long as it runs, else None.
    """
    frame, line = _innermost(frame)
    recording = journal.recording_number() if journal.recording() else 0
    thread = current_ident()
    inherited: tuple[CallSite, ...] = ()
    if outer is not None:
        inherited = outer.inherited if outer.thread == thread else outer.lines
    innermost = (line,) if line is not None else ()
    if not recording:
        return CallStack(innermost or inherited[-1:], inherited[-1:], thread), None
    own = _lines_from(frame.f_back) if frame is not None else ()
    around = (*inherited, *(own[1:] if own[:1] == inherited[-1:] else own))
    repeated = around[-1:] == innermost  # a lambda begins where it was asked for
    lines = around if repeated else (*around, *innermost)
    if len(lines) > MAX_LINES:
        lines = (*lines[: MAX_LINES // 2], *lines[-MAX_LINES // 2 :])
    stays = frame is not None and not repeated and not is_resumable(frame)
    return CallStack(lines, inherited, thread, _callers.of(lines), recording), frame if stays else None


def is_resumable(frame: FrameType) -> bool:
    """Whether it is the frame of a generator or coroutine, which others may resume."""
    return bool(frame.f_code.co_flags & _RESUMABLE)


def call_site() -> CallSite:
    """The innermost line of the plan that led here; ("", 0) if there is none."""
    return _innermost(sys._getframe(1))[1] or ("", 0)  # noqa: SLF001  as inspect.currentframe() has it


def _innermost(frame: FrameType | None) -> tuple[FrameType | None, CallSite | None]:
    """The plan's innermost frame and its line; without any, None and the line of the innermost foreign frame."""
    frame, foreign = plan_frame(frame)
    innermost = frame or foreign
    return frame, _site(innermost)[1] if innermost is not None else None


def is_of_plan(frame: FrameType) -> bool:
    """Whether a frame runs the plan's own code."""
    return _site(frame)[0] is _Origin.PLAN


def _lines_from(frame: FrameType | None) -> tuple[CallSite, ...]:
    """The plan's lines up to a frame, outermost first."""
    lines: list[CallSite] = []
    known, plan, runner = _sites.get, _Origin.PLAN, _Origin.RUNNER  # for speed
    last = None
    while frame is not None:
        origin, line, _ = known((id(frame.f_code), frame.f_lasti)) or _site(frame)
        if origin is plan:
            if line != last:
                lines.append(line)
                last = line
        elif origin is runner:
            break
        frame = frame.f_back
    lines.reverse()
    return tuple(lines)


def _site(frame: FrameType) -> tuple[_Origin, CallSite, CodeType]:
    """Whose code a frame runs, at which line: cached, as frames decode lines from their whole tables."""
    code = frame.f_code
    key = id(code), frame.f_lasti  # its hash would be that of all its instructions; it is kept, and so its id
    site = _sites.get(key)
    if site is None:
        file = code.co_filename
        origin = _origins.get(file) or _origin(file, str(frame.f_globals.get("__name__", "")))
        if len(_sites) >= _MAX_CACHED:
            _sites.clear()
        named = escaped(file)
        if named != file:
            _unescaped[named] = file
        site = _sites[key] = origin, (named, frame.f_lineno), code
    return site


def plan_frame(frame: FrameType | None) -> tuple[FrameType | None, FrameType | None]:
    """The plan's innermost frame from this one on outwards; and the first foreign one up to there."""
    foreign = None
    known, plan, elsewhere, runner = _origins.get, _Origin.PLAN, _Origin.FOREIGN, _Origin.RUNNER  # for speed
    while frame is not None:
        file = frame.f_code.co_filename
        origin = known(file) or _origin(file, str(frame.f_globals.get("__name__", "")))
        if origin is plan:
            return frame, foreign
        if origin is elsewhere:
            foreign = foreign or frame
        elif origin is runner:
            break
        frame = frame.f_back
    return None, foreign


def plan_frames(frame: FrameType | None) -> Iterator[FrameType]:
    """The plan's frames from this one on outwards."""
    while (frame := plan_frame(frame)[0]) is not None:
        yield frame
        frame = frame.f_back


def is_plan(frame: FrameType) -> bool:
    """Whether a frame is the plan's."""
    file = frame.f_code.co_filename
    return (_origins.get(file) or _origin(file, str(frame.f_globals.get("__name__", "")))) is _Origin.PLAN


class _Origin(Enum):
    """Whose code a frame runs."""

    PLAN = auto()
    MACHINERY = auto()
    FOREIGN = auto()
    RUNNER = auto()


_origins: Final[dict[str, _Origin]] = {}  # by file
_unescaped: Final[dict[str, str]] = {}  # files whose names aren't UTF-8, by these as they are recorded
_sites: Final[dict[tuple[int, int], tuple[_Origin, CallSite, CodeType]]] = {}  # by a code's id and its instruction


def _origin(file: str, module: str) -> _Origin:
    if module in _RUNNERS:
        origin = _Origin.RUNNER
    elif module.startswith("namedtuple_"):  # generated by collections for a type of ours or of the plan's
        origin = _Origin.FOREIGN
    elif module.partition(".")[0] in _MACHINERY and Path(file).parent.name != "demos":
        origin = _Origin.MACHINERY
    else:
        origin = _Origin.FOREIGN if _FOREIGN.search(file) else _Origin.PLAN
    if file.startswith("<frozen") or not file.startswith("<"):  # many modules share "<string>" and the like
        _origins[file] = origin
    return origin


class _Callers:
    """Callers as records hold them, cached; attaches each file of a plan once to a recording."""

    def __init__(self) -> None:
        self._cache: dict[tuple[CallSite, ...], tuple[SourceLine, ...]] = {}
        self._attached: set[str] = set()
        self._recording = 0

    def of(self, lines: tuple[CallSite, ...]) -> tuple[SourceLine, ...]:
        """All lines of a call stack but the innermost."""
        if self._recording != journal.recording_number():
            self._recording = journal.recording_number()
            self._attached.clear()
            self._cache.clear()
        callers = self._cache.get(lines)
        if callers is None:
            for file in sorted({file for file, _ in lines} - self._attached):
                self._attached.add(file)
                source = Path(_unescaped.get(file, file))
                with suppress(OSError):  # typed at a prompt, or gone
                    journal.attach([AssetFile(source.name, source.read_bytes(), "text/x-python")])
            innermost = lines[-1][0] if lines else ""
            callers = tuple([SourceLine(file=file if file != innermost else "", line=at) for file, at in lines[:-1]])
            if len(self._cache) >= _MAX_CACHED:
                self._cache.clear()
            self._cache[lines] = callers
        return callers


_callers: Final = _Callers()
