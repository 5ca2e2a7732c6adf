"""The way through the plan's code to a task: the lines that called one another, outermost first.

A thread that runs part of a task has its own stack: its way goes on from where that task was asked for. So each way
begins where the plan does, whoever goes it.
"""

from __future__ import annotations

import re
import sys
from contextlib import suppress
from enum import Enum, auto
from inspect import CO_ASYNC_GENERATOR, CO_COROUTINE, CO_GENERATOR
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple, TypeAlias

from recorder import threads
from recorder.records import SourceLine
from recorder.records.asset import AssetFile
from recorder.tracing import journal

if TYPE_CHECKING:
    from types import FrameType

Place: TypeAlias = "tuple[str, int]"  # a file and a line of it, from 1

#: Of a longer way, the lines in its middle are left out.
MOST: Final = 32
#: Frames of these packages are the machinery; the plan's lines are outside of them.
_MACHINERY: Final = frozenset({"pycram", "recorder", "contextlib", "threading", "concurrent", "contextvars"})
#: So many ways are remembered as they were told.
_KNOWN: Final = 4096
#: The frames of these can be left in the middle, and come back from elsewhere.
_LEFT_AND_RESUMED: Final = CO_GENERATOR | CO_COROUTINE | CO_ASYNC_GENERATOR
#: Modules that run a plan as a program: who calls them is no part of it.
_RUNNERS: Final = frozenset({"pycram.cli", "replay.restore.session"})
#: Python's own files, installed packages and their commands: they may call plans, but are none.
_FOREIGN: Final = re.compile(
    r"^<frozen|[/\\][Ll]ib(?:64)?[/\\](?:python3(?:\.\d+)?|site-packages)[/\\]|[/\\](?:bin|Scripts)[/\\][^/\\.]+$"
)


class CallStack(NamedTuple):
    """A way; there is one for each task, so it is the cheapest sort of object.

    Attributes:
        lines: of the plan, outermost first; one that calls itself again and again stands once. Where nothing is
            recorded only the innermost, which costs less to find.
        before: those of them that ran in other threads, which this one goes on from.
        thread: identifies the thread that came this way.
        callers: all lines but the innermost, as records tell them.
        recording: number of the recording that it was looked for in; 0 where nothing was recorded.
    """

    lines: tuple[Place, ...]
    before: tuple[Place, ...]
    thread: int
    callers: tuple[SourceLine, ...] = ()
    recording: int = 0

    @property
    def line(self) -> Place:
        """The innermost line; ("", 0) if none is known."""
        return self.lines[-1] if self.lines else ("", 0)

    def turned(self, number: int) -> CallStack | None:
        """The way to another line of the code at its end, which runs still; None if it must be walked again.

        Args:
            number: of the line.
        """
        lines, before, thread, callers, recording = self
        file, latest = lines[-1]
        if recording != journal.openings() or lines[-2:-1] == ((file, number),):  # which would stand once
            return None
        return (
            self if number == latest else CallStack((*lines[:-1], (file, number)), before, thread, callers, recording)
        )


def walk(frame: FrameType | None, outer: CallStack | None = None) -> tuple[CallStack, FrameType | None]:
    """The way to some code.

    Args:
        frame: the code, or what it has called.
        outer: the way to the task which this is part of.

    Returns:
        The way; and the code at its end, if a way to what begins there later, as long as that runs, is this one but for
        the last line: see :meth:`CallStack.turned`. Else None.
    """
    frame, line = _innermost(frame)
    recording = journal.openings() if journal.recording() else 0
    thread = threads.ident()
    before: tuple[Place, ...] = ()
    if outer is not None:
        before = outer.before if outer.thread == thread else outer.lines
    innermost = (line,) if line is not None else ()
    if not recording:
        return CallStack(innermost or before[-1:], before[-1:], thread), None
    here = _outwards(frame.f_back) if frame is not None else ()
    around = (*before, *(here[1:] if here[:1] == before[-1:] else here))
    once = around[-1:] == innermost  # a lambda begins where it was asked for
    lines = around if once else (*around, *innermost)
    if len(lines) > MOST:
        lines = (*lines[: MOST // 2], *lines[-MOST // 2 :])
    stays = frame is not None and not once and not is_resumable(frame)
    return CallStack(lines, before, thread, _told.callers(lines), recording), frame if stays else None


def is_resumable(frame: FrameType) -> bool:
    """Whether code can be left in the middle and gone on with from elsewhere, as generators can.

    Args:
        frame: the code.
    """
    return bool(frame.f_code.co_flags & _LEFT_AND_RESUMED)


def call_site() -> Place:
    """The innermost line of the plan that led here; ("", 0) if there is none."""
    return _innermost(sys._getframe(1))[1] or ("", 0)  # noqa: SLF001  as inspect.currentframe() has it


def _innermost(frame: FrameType | None) -> tuple[FrameType | None, Place | None]:
    """The plan's next frame from a frame on outwards, and its line; without any, None and a foreign one's."""
    frame, foreign = plan_frame(frame)
    return frame, _place(frame or foreign)


def _outwards(frame: FrameType | None) -> tuple[Place, ...]:
    """The plan's lines from a frame on, outermost first."""
    found: list[Place] = []
    while (frame := plan_frame(frame)[0]) is not None:
        place = frame.f_code.co_filename, frame.f_lineno
        if not found or place != found[-1]:
            found.append(place)
        frame = frame.f_back
    found.reverse()
    return tuple(found)


def _place(frame: FrameType | None) -> Place | None:
    return (frame.f_code.co_filename, frame.f_lineno) if frame is not None else None


def plan_frame(frame: FrameType | None) -> tuple[FrameType | None, FrameType | None]:
    """The plan's next frame from a frame on outwards; and the first foreign one up to there.

    Args:
        frame: where to begin; not left out itself.
    """
    foreign = None
    known, plan, elsewhere, runner = _kinds.get, _Kind.PLAN, _Kind.FOREIGN, _Kind.RUNNER  # there are many frames
    while frame is not None:
        file = frame.f_code.co_filename
        kind = known(file) or _kind(file, str(frame.f_globals.get("__name__", "")))
        if kind is plan:
            return frame, foreign
        if kind is elsewhere:
            foreign = foreign or frame
        elif kind is runner:
            break
        frame = frame.f_back
    return None, foreign


class _Kind(Enum):
    """Whose a frame is."""

    PLAN = auto()
    MACHINERY = auto()
    FOREIGN = auto()
    RUNNER = auto()


_kinds: Final[dict[str, _Kind]] = {}  # by file


def _kind(file: str, module: str) -> _Kind:
    if module in _RUNNERS:
        kind = _Kind.RUNNER
    elif module.partition(".")[0] in _MACHINERY and Path(file).parent.name != "demos":
        kind = _Kind.MACHINERY
    else:
        kind = _Kind.FOREIGN if _FOREIGN.search(file) else _Kind.PLAN
    if file.startswith("<frozen") or not file.startswith("<"):  # many modules share "<string>" and the like
        _kinds[file] = kind
    return kind


class _Told:
    """What recordings are told of ways: the lines, and once each file that they are in."""

    def __init__(self) -> None:
        self._callers: dict[tuple[Place, ...], tuple[SourceLine, ...]] = {}
        self._attached: set[str] = set()
        self._openings = 0

    def callers(self, lines: tuple[Place, ...]) -> tuple[SourceLine, ...]:
        """All lines of a way but the innermost; the same again for the same way."""
        if self._openings != journal.openings():  # a new recording has none of them
            self._openings = journal.openings()
            self._attached.clear()
            self._callers.clear()
        told = self._callers.get(lines)
        if told is None:
            for file in sorted({file for file, _ in lines} - self._attached):
                self._attached.add(file)
                with suppress(OSError):  # typed at a prompt, or gone
                    journal.attach([AssetFile(Path(file).name, Path(file).read_bytes(), "text/x-python")])
            innermost = lines[-1][0] if lines else ""
            told = tuple([SourceLine(file=file if file != innermost else "", line=at) for file, at in lines[:-1]])
            if len(self._callers) >= _KNOWN:
                self._callers.clear()
            self._callers[lines] = told
        return told


_told: Final = _Told()
