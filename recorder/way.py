"""The way through the plan's code to a task: the lines that called one another, outermost first.

A thread that runs part of a task has its own stack: its way goes on from where that task was asked for. So each way
begins where the plan does, whoever goes it.
"""

from __future__ import annotations

import re
import sys
import threading
from contextlib import suppress
from enum import Enum, auto
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple, TypeAlias

from recorder import journal
from recorder.asset import AssetFile
from recorder.records import SourceLine

if TYPE_CHECKING:
    from collections.abc import Iterable
    from types import FrameType

Place: TypeAlias = "tuple[str, int]"  # a file and a line of it, from 1

#: Of a longer way, the lines in its middle are left out.
MOST: Final = 32
#: Frames of these packages are the machinery; the plan's lines are outside of them.
_MACHINERY: Final = frozenset({"pycram", "recorder", "contextlib", "threading", "concurrent", "contextvars"})
#: Modules that run a plan as a program: who calls them is no part of it.
_RUNNERS: Final = frozenset({"pycram.cli", "replay.session"})
#: Python's own files, installed packages and their commands: they may call plans, but are none.
_FOREIGN: Final = re.compile(
    r"^<frozen|[/\\][Ll]ib(?:64)?[/\\](?:python3(?:\.\d+)?|site-packages)[/\\]|[/\\](?:bin|Scripts)[/\\][^/\\.]+$"
)


class Way(NamedTuple):
    """A way; there is one for each task, so it is the cheapest sort of object.

    Attributes:
        lines: of the plan, outermost first; one that calls itself again and again stands once.
        before: those of them that ran in other threads, which this one goes on from.
        thread: identifies the thread that came this way.
    """

    lines: tuple[Place, ...]
    before: tuple[Place, ...]
    thread: int

    @property
    def line(self) -> Place:
        """The innermost line; ("", 0) if none is known."""
        return self.lines[-1] if self.lines else ("", 0)


def way_here(outer: Way | None = None) -> Way:
    """The way to the caller.

    Args:
        outer: that of the task which this is part of.

    Returns:
        The way, whole where it is recorded; else only its innermost line, which costs less.
    """
    thread = threading.get_ident()
    before: tuple[Place, ...] = ()
    if outer is not None:
        before = outer.before if outer.thread == thread else outer.lines
    if not journal.recording():
        return Way(tuple(_lines(1)) or before[-1:], before[-1:], thread)
    here = _lines(sys.maxsize)
    lines = (*before, *(here[1:] if here[:1] == [*before[-1:]] else here))  # a lambda begins where it was asked for
    if len(lines) > MOST:
        lines = (*lines[: MOST // 2], *lines[-MOST // 2 :])
    _sources.attach(lines)
    return Way(lines, before, thread)


def plan_line() -> Place:
    """The innermost line of the plan that led here; ("", 0) if there is none."""
    return next(iter(_lines(1)), ("", 0))


def _lines(most: int) -> list[Place]:
    """The plan's innermost lines on this thread's stack, outermost first; without any, the innermost foreign one."""
    found: list[Place] = []
    last = foreign = None
    known, plan, elsewhere, runner = _kinds.get, _Kind.PLAN, _Kind.FOREIGN, _Kind.RUNNER  # there are many frames
    frame: FrameType | None = sys._getframe(2)  # noqa: SLF001  inspect.stack() reads source files: 100 times slower
    while frame is not None:
        file = frame.f_code.co_filename
        kind = known(file) or _kind(file, str(frame.f_globals.get("__name__", "")))
        if kind is plan:
            place = file, frame.f_lineno
            if place != last:
                found.append(place)
                last = place
                if len(found) == most:
                    break
        elif kind is elsewhere:
            if foreign is None:
                foreign = file, frame.f_lineno
        elif kind is runner:
            break
        frame = frame.f_back
    if not found and foreign is not None:
        return [foreign]
    found.reverse()
    return found


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


@lru_cache(maxsize=4096)
def callers(lines: tuple[Place, ...]) -> tuple[SourceLine, ...]:
    """All lines of a way but the innermost, as records tell them.

    Args:
        lines: outermost first.
    """
    return tuple([SourceLine(file=file if file != lines[-1][0] else "", line=at) for file, at in lines[:-1]])


class _Sources:
    """Attaches the files that ways lead through to recordings: each once."""

    def __init__(self) -> None:
        self._attached: set[str] = set()
        self._openings = 0

    def attach(self, lines: Iterable[Place]) -> None:
        if self._openings != journal.openings():  # a new recording has none of them
            self._openings = journal.openings()
            self._attached.clear()
        for file, _ in lines:
            if file not in self._attached:
                self._attached.add(file)
                with suppress(OSError):  # typed at a prompt, or gone
                    journal.attach([AssetFile(Path(file).name, Path(file).read_bytes(), "text/x-python")])


_sources: Final = _Sources()
