"""The plan's frames: call stacks of tasks, and the local variables of raised errors.

A call stack contains the plan's lines that called one another, outermost first. In a thread that runs a part of a task,
the call stack continues the request's call stack, and so begins where the plan begins. Local variables are described
without calling users' code.
"""

from __future__ import annotations

import enum
import re
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from enum import Enum, auto
from itertools import groupby, islice
from linecache import getlines
from pathlib import Path, PurePosixPath
from types import BuiltinFunctionType, FrameType, FunctionType, ModuleType
from typing import Any, Final, NamedTuple, TypeAlias

from recorder import notebook
from recorder.records import Failure, SourceLine, StackFrame, Variable, escaped, failure
from recorder.records.tracebacks import MAX_ERRORS, entries
from recorder.records.values import LEFT_OUT, AssetFile, is_secret
from recorder.tracing import journal
from recorder.tracing.context import current_ident

CallSite: TypeAlias = "tuple[str, int]"  # a file and a line number, from 1

MAX_LINES: Final = 32  # maximum number of lines of a call stack; the middle of a longer call stack is left out
#: Packages whose frames are left out of call stacks, because they aren't the plan's code.
_MACHINERY: Final = frozenset({"pycram", "recorder", "replay", "contextlib", "threading", "concurrent", "contextvars"})
#: Modules that run a plan as a program. Call stacks leave out the frames that call these modules.
_RUNNERS: Final = frozenset({"pycram.cli", "pycram.running", "replay.cli.restore", "replay.retrace.guided_run"})
#: Pattern for files of Python, installed packages and commands, which aren't part of a plan.
_FOREIGN: Final = re.compile(
    r"^<frozen|[/\\][Ll]ib(?:64)?[/\\](?:python3(?:\.\d+)?|site-packages)[/\\]|[/\\](?:bin|Scripts)[/\\][^/\\.]+$"
)


class CallStack(NamedTuple):
    """The plan's lines that led to a task."""

    lines: tuple[CallSite, ...]  # outermost first, without repetitions; only the innermost without a recording
    inherited: tuple[CallSite, ...]  # the first lines, which are the call stack of another thread
    thread: int  # ident of the thread or branch of the innermost line
    callers: tuple[SourceLine, ...] = ()  # all lines except the innermost line, for records

    @property
    def line(self) -> CallSite:
        """The innermost line; ("", 0) if there is none."""
        return self.lines[-1] if self.lines else ("", 0)


def walk(frame: FrameType | None, outer: CallStack | None = None) -> CallStack:
    """Return the call stack of running code, from the frame of the code or of a function that the code called."""
    frame, line = _innermost(frame)
    thread = current_ident()
    inherited: tuple[CallSite, ...] = ()
    if outer is not None:
        inherited = outer.inherited if outer.thread == thread else outer.lines
    innermost = (line,) if line is not None else ()
    if not journal.recording():
        return CallStack(innermost or inherited[-1:], inherited[-1:], thread)
    sites = [_site(each) for each in plan_frames(frame and frame.f_back)]
    own = tuple(each for each, _ in groupby(reversed(sites)))
    around = (*inherited, *(own[1:] if own[:1] == inherited[-1:] else own))
    lines = around if around[-1:] == innermost else (*around, *innermost)  # a lambda is in the line that requests it
    if len(lines) > MAX_LINES:
        lines = (*lines[: MAX_LINES // 2], *lines[-MAX_LINES // 2 :])
    attached = _attached.setdefault(journal.recording_number(), set())
    for file in sorted({file for file, _ in lines} - attached):
        attached.add(file)
        source = Path(_unescaped.get(file, file))
        is_cell = notebook.is_cell(file)
        with suppress(OSError):  # the code has no file, or the file was deleted
            text = "".join(getlines(str(source))).encode("utf-8", "replace") if is_cell else source.read_bytes()
            journal.attach([AssetFile(file if is_cell else source.name, text, "text/x-python")])
    file = lines[-1][0] if lines else ""
    callers = tuple([SourceLine(file=each if each != file else "", line=number) for each, number in lines[:-1]])
    return CallStack(lines, inherited, thread, callers)


def call_site() -> CallSite:
    """Return the innermost line of the plan that led to the present call; ("", 0) if there is none."""
    return _innermost(sys._getframe(1))[1] or ("", 0)  # noqa: SLF001  like inspect.currentframe()


def _innermost(frame: FrameType | None) -> tuple[FrameType | None, CallSite | None]:
    """Return the plan's innermost frame and its line; if no plan runs, None and the innermost line of other code."""
    frame, foreign = plan_frame(frame)
    innermost = frame or foreign
    return frame, _site(innermost) if innermost is not None else None


def _site(frame: FrameType) -> CallSite:
    return recorded_file(frame.f_code.co_filename), frame.f_lineno


def recorded_file(file: str) -> str:
    """Return the name of a code's file in records. The name of a notebook's cell is "In [3]"."""
    named = notebook.cell_of(file) or escaped(file)
    if named != file:
        _unescaped[named] = file
    return named


def plan_frame(frame: FrameType | None) -> tuple[FrameType | None, FrameType | None]:
    """Return the plan's innermost frame among a frame and its callers, and the innermost foreign frame within it."""
    foreign = None
    known, plan, elsewhere, runner = _origins.get, _Origin.PLAN, _Origin.FOREIGN, _Origin.RUNNER  # faster than globals
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
    """Yield the plan's frames among a frame and its callers, innermost first."""
    while (frame := plan_frame(frame)[0]) is not None:
        yield frame
        frame = frame.f_back


def is_plan(frame: FrameType) -> bool:
    """Return whether a frame runs the plan's own code."""
    return _origin_of(frame) is _Origin.PLAN


def is_machinery(frame: FrameType) -> bool:
    """Return whether a frame runs PyCRAM's code, or code with which PyCRAM runs plans."""
    return _origin_of(frame) is _Origin.MACHINERY


def _origin_of(frame: FrameType) -> _Origin:
    file = frame.f_code.co_filename
    return _origins.get(file) or _origin(file, str(frame.f_globals.get("__name__", "")))


class _Origin(Enum):
    PLAN = auto()
    MACHINERY = auto()
    FOREIGN = auto()
    RUNNER = auto()


_origins: Final[dict[str, _Origin]] = {}  # origins of code, by file
_unescaped: Final[dict[str, str]] = {}  # real file names, if the recorded names differ: cells, names that aren't UTF-8


def _origin(file: str, module: str) -> _Origin:
    if module in _RUNNERS:
        origin = _Origin.RUNNER
    elif module.startswith("namedtuple_"):  # the module of a named tuple has a special file name
        origin = _Origin.FOREIGN
    elif module.partition(".")[0] in _MACHINERY and Path(file).parent.name != "demos":
        origin = _Origin.MACHINERY
    else:
        origin = _Origin.FOREIGN if _FOREIGN.search(file) else _Origin.PLAN
    if file.startswith("<frozen") or not file.startswith("<"):  # many modules have the file name "<string>"
        _origins[file] = origin
    return origin


_attached: Final[dict[int, set[str]]] = {}  # attached files, by number of the recording


MAX_FRAMES: Final = 16  # maximum number of frames of an error; the innermost frames are kept
MAX_VARIABLES: Final = 20  # maximum number of variables of a frame
MAX_CHARACTERS: Final = 80  # maximum number of characters of a value

_MAX_ITEMS: Final = 6  # maximum number of items of a list
_MAX_DEPTH: Final = 3  # maximum depth of nested lists
_MAX_BITS: Final = 256  # maximum number of bits of an integer
_ELLIPSIS: Final = "..."
_MARK: Final = "_pycram_frames"  # attribute of an error: a recording's number, and the frames in this recording
#: Types of variables that are imports and definitions, which aren't recorded.
_IGNORED: Final = (ModuleType, FunctionType, BuiltinFunctionType, type)
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
    """Return the failure of an error, with the plan's frames if the recording keeps local variables."""
    record = failure(error, errors=errors)
    if journal.keeps_local_variables():
        with suppress(Exception):  # methods of the error may raise any error
            record.frames.extend(_new_frames(error))
    return record


def _new_frames(error: BaseException) -> list[StackFrame]:
    """Return the plan's frames that led to an error, outermost first, without frames that are already recorded."""
    recording, known = vars(error).get(_MARK, (0, frozenset()))
    if recording != journal.recording_number():
        known = frozenset()
    trace = error.__traceback__
    around = plan_frames(trace.tb_frame.f_back if trace is not None else None)
    inner = [(each.tb_frame, each.tb_lineno) for each in entries(trace) if is_plan(each.tb_frame)]
    led = [*[(frame, frame.f_lineno) for frame in around][::-1], *inner]
    frames = [(frame, line) for frame, line in led if id(frame) not in known][-MAX_FRAMES:]
    vars(error)[_MARK] = journal.recording_number(), known.union(id(frame) for frame, _ in frames)
    return [
        StackFrame(
            file=recorded_file(frame.f_code.co_filename),
            line=line,
            function=escaped(frame.f_code.co_name),
            variables=[Variable(name=name, value=value) for name, value in _variables(frame)],
        )
        for frame, line in frames
    ]


def _variables(frame: FrameType) -> Iterator[tuple[str, str]]:
    """Yield names and values in the order of their first assignment, without IPython's own variables.

    A module has many variables, so only its last variables with a visible value are kept.
    """
    hidden = notebook.own_variables() if frame.f_locals is frame.f_globals else {}
    try:
        values = {
            name: value
            for name, value in list(frame.f_locals.items())
            if type(name) is str and name.isidentifier() and name[:2] != "__" and not issubclass(type(value), _IGNORED)
            if name not in hidden or hidden[name] is not value
        }
    except RuntimeError:  # another thread may be changing the variables
        return
    texts = [(name, LEFT_OUT if is_secret(name) else described(value)) for name, value in values.items()]
    if frame.f_locals is frame.f_globals:
        texts = [(name, text) for name, text in texts if not _TYPE_ALONE.fullmatch(text)][-MAX_VARIABLES:]
    for name, text in texts[:MAX_VARIABLES]:
        yield name, text if len(text) <= MAX_CHARACTERS else text[: MAX_CHARACTERS - len(_ELLIPSIS)] + _ELLIPSIS


def described(value: Any, depth: int = 0) -> str:
    """Return a short text for a value, without calling users' code."""
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
    except RuntimeError:  # another thread may be changing the value
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
    """Return the value of NumPy's number or small array, and the shape of a larger array."""
    dtype = getattr(value, "dtype", None)
    if dtype is None or dtype.kind not in "biuf":
        return f"<{name}>"
    if name != "ndarray":
        return repr(value.item())
    shape = "x".join(map(str, value.shape))
    return f"array({described(value.tolist())})" if value.size <= _MAX_ITEMS * 2 else f"<array {shape} of {dtype.name}>"
