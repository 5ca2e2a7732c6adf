"""The plan's frames: call stacks of tasks, and local variables where an error was raised.

A call stack has the plan's lines that called one another, outermost first. A thread that runs part of a task has a
stack of its own: its call stack continues that of the code which requested the task. So each call stack begins where
the plan does, in whatever thread it ends.

Local variables are described without calling code of users: values of Python's own types are written out, an object of
a world by its name, any other by the name of its type.
"""

from __future__ import annotations

import enum
import re
import sys
from contextlib import suppress
from enum import Enum, auto
from inspect import CO_ASYNC_GENERATOR, CO_COROUTINE, CO_GENERATOR
from itertools import islice
from pathlib import Path, PurePosixPath
from types import BuiltinFunctionType, FunctionType, ModuleType
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeAlias

from recorder.records import SourceLine, StackFrame, Variable, escaped, failure
from recorder.records.tracebacks import MAX_ERRORS
from recorder.records.values import LEFT_OUT, AssetFile, is_secret
from recorder.tracing import journal
from recorder.tracing.context import current_ident

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping
    from types import CodeType, FrameType

    from recorder.records import Failure


CallSite: TypeAlias = "tuple[str, int]"  # a file and a line of it, from 1

#: A longer call stack is truncated in the middle.
MAX_LINES: Final = 32
#: Frames of these packages are left out: the plan's lines are outside of them.
_MACHINERY: Final = frozenset({"pycram", "recorder", "replay", "contextlib", "threading", "concurrent", "contextvars"})
#: Modules that run a plan as a program: their callers are left out, too.
_RUNNERS: Final = frozenset({"pycram.cli", "pycram.running", "replay.cli.restore", "replay.retrace.guided_run"})
#: Python's own files, installed packages and their commands: they may call plans, but are none.
_FOREIGN: Final = re.compile(
    r"^<frozen|[/\\][Ll]ib(?:64)?[/\\](?:python3(?:\.\d+)?|site-packages)[/\\]|[/\\](?:bin|Scripts)[/\\][^/\\.]+$"
)
_MAX_CACHED: Final = 4096  # call stacks, and lines
_RESUMABLE: Final = CO_GENERATOR | CO_COROUTINE | CO_ASYNC_GENERATOR


class CallStack(NamedTuple):
    """The plan's lines that led to a task; there is one for each task, so it is the cheapest type of object."""

    #: Outermost first; those of a recursion stand once. Where nothing is recorded only the innermost.
    lines: tuple[CallSite, ...]
    #: Those of them that another thread's call stack ends with, which this one continues.
    inherited: tuple[CallSite, ...]
    thread: int  # identifies the thread that it ends in
    callers: tuple[SourceLine, ...] = ()  # all lines but the innermost, as records hold them
    recording: int = 0  # number of the recording that it was made for; 0 where nothing was recorded

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
    """Return the call stack of some code, and the plan's innermost frame or None.

    The frame is given if :meth:`CallStack.at_line` gives the call stacks of its other lines as long as it runs.

    Args:
        frame: of the code, or of what it has called.
        outer: call stack of the task that the code is part of.
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


def _lines_from(frame: FrameType | None) -> tuple[CallSite, ...]:
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


MAX_FRAMES: Final = 16  # innermost ones
MAX_VARIABLES: Final = 20  # of a frame
MAX_CHARACTERS: Final = 80  # of a value

_MAX_ITEMS: Final = 6  # of a list
_MAX_DEPTH: Final = 3  # of lists within lists
_MAX_BITS: Final = 256  # of an integer
_ELLIPSIS: Final = "..."
_MARK: Final = "_pycram_frames"  # an error's attribute: the recording and the frames that its records hold already
_IGNORED: Final = (ModuleType, FunctionType, BuiltinFunctionType, type)  # a module's imports and definitions
_TYPE_ALONE: Final = re.compile(r"<[\w.]+>")
_EXACT: Final = frozenset({type(None), bool, int, float, complex, range, type(Path()), PurePosixPath})
_BRACKETS: Final[Mapping[type, tuple[str, str]]] = {
    list: ("[", "]"),
    tuple: ("(", ")"),
    set: ("{", "}"),
    frozenset: ("frozenset({", "})"),
    dict: ("{", "}"),
}


def failure_with_frames(error: BaseException, *, errors: int = MAX_ERRORS) -> Failure:
    """An error as :func:`failure` has it, with the plan's frames if they are recorded."""
    record = failure(error, errors=errors)
    if journal.keeps_local_variables():
        with suppress(Exception):  # of an error's own methods
            record.frames.extend(_new_frames(error))
    return record


def _new_frames(error: BaseException) -> list[StackFrame]:
    """The plan's frames that led to an error, outermost first, without those that an earlier record of it holds."""
    recording, known = vars(error).get(_MARK, (0, frozenset()))
    if recording != journal.recording_number():
        known = frozenset()
    frames = [(frame, line) for frame, line in _frames(error) if id(frame) not in known][-MAX_FRAMES:]
    vars(error)[_MARK] = journal.recording_number(), known.union(id(frame) for frame, _ in frames)
    return [
        StackFrame(
            file=escaped(frame.f_code.co_filename),
            line=line,
            function=escaped(frame.f_code.co_name),
            variables=[Variable(name=name, value=value) for name, value in _variables(frame)],
        )
        for frame, line in frames
    ]


def _frames(error: BaseException) -> list[tuple[FrameType, int]]:
    """The plan's frames of the traceback, and those that were running around them, with their lines."""
    trace = error.__traceback__
    outer: list[tuple[FrameType, int]] = []
    around = trace.tb_frame.f_back if trace is not None else None
    while (around := plan_frame(around)[0]) is not None:
        outer.append((around, around.f_lineno))
        around = around.f_back
    inner = []
    while trace is not None:
        if is_plan(trace.tb_frame):
            inner.append((trace.tb_frame, trace.tb_lineno))
        trace = trace.tb_next
    return [*reversed(outer), *inner]


def _variables(frame: FrameType) -> Iterator[tuple[str, str]]:
    """Names and values, in the order of their first assignment.

    Of a module, that has many and imports some, the last ones that have more to show than their type.
    """
    try:
        values = {
            name: value
            for name, value in list(frame.f_locals.items())
            if type(name) is str and name.isidentifier() and name[:2] != "__" and not issubclass(type(value), _IGNORED)
        }
    except RuntimeError:  # another thread is changing them
        return
    texts = [(name, LEFT_OUT if is_secret(name) else described(value)) for name, value in values.items()]
    if frame.f_locals is frame.f_globals:
        texts = [(name, text) for name, text in texts if not _TYPE_ALONE.fullmatch(text)][-MAX_VARIABLES:]
    for name, text in texts[:MAX_VARIABLES]:
        yield name, text if len(text) <= MAX_CHARACTERS else text[: MAX_CHARACTERS - len(_ELLIPSIS)] + _ELLIPSIS


def described(value: Any, depth: int = 0) -> str:
    """A value in a few words, without calling any code but Python's and PyCRAM's own."""
    kind = type(value)
    if kind is str or kind is bytes:
        return repr(value[: MAX_CHARACTERS + 1])
    if kind is int and value.bit_length() > _MAX_BITS:
        return f"<int of {value.bit_length()} bits>"
    if kind in _EXACT:
        return repr(value)
    return _collection(value, depth) if kind in _BRACKETS else _other(value)


def _other(value: Any) -> str:
    kind = type(value)
    module, name = (str(type.__getattribute__(kind, each)) for each in ("__module__", "__qualname__"))
    if module == "numpy":
        return _of_numpy(value, name)
    if issubclass(kind, enum.Enum):
        return f"{name}.{object.__getattribute__(value, '_name_')}"
    if module.startswith("pycram.world.") and type(own := getattr(value, "name", None)) is str:
        return f"<{name} {own}>"
    return f"<{name}>"


def _collection(value: Any, depth: int) -> str:
    kind = type(value)
    before, after = _BRACKETS[kind]
    if not value:
        return f"{before}{after}" if kind not in (set, frozenset) else f"{kind.__name__}()"
    if depth >= _MAX_DEPTH:
        return f"{before}{_ELLIPSIS}{after}"
    try:
        some: Iterable[Any] = list(islice(value.items() if kind is dict else value, _MAX_ITEMS))
    except RuntimeError:  # another thread is changing it
        some = ()
    if kind is dict:
        texts = [
            f"{described(key, depth + 1)}: "
            + (LEFT_OUT if type(key) is str and is_secret(key) else described(item, depth + 1))
            for key, item in some
        ]
    else:
        texts = [described(item, depth + 1) for item in some]
    if len(value) > len(texts):
        texts.append(_ELLIPSIS)
    return f"{before}{', '.join(texts)}{',' if kind is tuple and len(value) == 1 else ''}{after}"


def _of_numpy(value: Any, name: str) -> str:
    """A number or a small array of NumPy's by its values, a larger array by its shape."""
    dtype = getattr(value, "dtype", None)
    if dtype is None or dtype.kind not in "biuf":
        return f"<{name}>"
    if name != "ndarray":
        return repr(value.item())
    shape = "x".join(map(str, value.shape))
    return f"array({described(value.tolist())})" if value.size <= _MAX_ITEMS * 2 else f"<array {shape} of {dtype.name}>"
